"""Sizes of the reconstruction network."""

from dataclasses import dataclass

from clothtrack.errors import InvalidConfigError

_COUNTS = {
    "image_size": (1, 1024),
    "widths": (1, 2048),
    "decoder_width": (1, 2048),
    "bins": (1, 1024),
    "window": (0, 64),
    "volume": (1, 128),
    "volume_depth": (1, 128),
    "volume_channels": (1, 1024),
    "point_hidden": (1, 4096),
    "volume_widths": (1, 2048),
    "decoder_hidden": (1, 4096),
    "grid": (2, 256),
    "grid_margin": (0, 128),
    "surface_vertices": (4, 1_000_000),
}
"""Bounds of each count. Weights files state the size of their network, and the bounds keep a
malicious one from using up all memory."""

_PER_LEVEL = ("widths", "volume_widths")
_LEVELS = 8
_NUMBERS = ("field_of_view_deg", "view_margin", "least_view_m", "trim", "trim_sigma", "short_edge")


@dataclass(frozen=True)
class NetworkConfig:
    """The sizes of the networks and of the extracted surface.

    Attributes:
        image_size: width and height of the network's depth picture [pixels].
        field_of_view_deg: field of view of the virtual camera that takes it [deg]; 45 as in MEDOR.
        view_margin: free border around the cloth, as a share of its longer side.
        least_view_m: shortest side of the square shown in the picture [m], so that a bunched cloth
            is not magnified further.
        widths: channels of the encoder at each resolution, halved from one to the next.
        decoder_width: channels of a pixel's feature.
        bins: number of bins per canonical axis.
        window: bins on either side of the best one over which a coordinate is averaged.
        volume: cells along each edge of the cube in the feature volume.
        volume_depth: cells along z; fewer than `volume` leave out the cube's front and back, where
            no garment is (a T-shirt fills 0.2 of it). The U-Net's time is proportional to it.
        volume_channels: channels of a cell.
        point_hidden: width of the point network before the volume.
        volume_widths: channels of the 3-D U-Net at each resolution.
        decoder_hidden: width of the two hidden layers of the winding and the warp decoder.
        grid: nodes along each edge of the cube; the winding number is decoded only at those that
            the category's garments can reach, a third of them or less.
        grid_margin: nodes decoded beyond the largest garment of the category.
        trim: change of the winding number per node below which faces are openings; 0.25 suits only
            perfect fields, 0.1 tolerates a field blurred by two cells.
        trim_sigma: width of the Gaussian filter of the trim's gradient [nodes].
        short_edge: share of the grid's spacing below which edges of the surface are collapsed.
        surface_vertices: approximate number of vertices down to which edges are collapsed; the
            paper's meshes have 3,906 on average.
    """

    image_size: int = 128
    field_of_view_deg: float = 45.0
    view_margin: float = 0.08
    least_view_m: float = 0.15
    widths: tuple[int, ...] = (32, 64, 96, 128, 160)
    decoder_width: int = 64
    bins: int = 64
    window: int = 2
    volume: int = 32
    volume_depth: int = 8
    volume_channels: int = 32
    point_hidden: int = 64
    volume_widths: tuple[int, ...] = (16, 32, 64)
    decoder_hidden: int = 128
    grid: int = 96
    grid_margin: int = 4
    trim: float = 0.1
    trim_sigma: float = 0.5
    short_edge: float = 0.5
    surface_vertices: int = 4000

    def __post_init__(self) -> None:
        """Refuse a configuration from which networks cannot be built.

        Raises:
            InvalidConfigError: with the field, its value and the limit.
        """
        _check_numbers(self)
        if self.image_size % self.output_stride:
            raise InvalidConfigError(
                f"NetworkConfig.image_size is {self.image_size}; it must be a multiple of "
                f"output_stride ({self.output_stride})"
            )
        levels = 2 ** (len(self.volume_widths) - 1)
        for name in ("volume", "volume_depth"):
            if getattr(self, name) % levels:
                raise InvalidConfigError(
                    f"NetworkConfig.{name} is {getattr(self, name)}; {len(self.volume_widths)} "
                    f"resolutions need a multiple of {levels}"
                )
        if self.volume_depth > self.volume:
            raise InvalidConfigError(
                f"NetworkConfig.volume_depth is {self.volume_depth}; it must be volume "
                f"({self.volume}) or less"
            )

    @property
    def output_stride(self) -> int:
        """Input pixels per output pixel."""
        return 2

    @property
    def volume_cells(self) -> tuple[int, int, int]:
        """Cells of the feature volume along x, y and z."""
        return self.volume, self.volume, self.volume_depth

    @property
    def output_size(self) -> int:
        """Width and height of the canonical picture [pixels]."""
        return self.image_size // self.output_stride


def _check_numbers(config: NetworkConfig) -> None:
    for name, (least, most) in _COUNTS.items():
        given = getattr(config, name)
        if name in _PER_LEVEL and not (isinstance(given, tuple) and 1 <= len(given) <= _LEVELS):
            raise InvalidConfigError(
                f"NetworkConfig.{name} is {given!r}; it must be 1 to {_LEVELS} numbers"
            )
        counts = given if name in _PER_LEVEL else (given,)
        if not all(type(one) is int and least <= one <= most for one in counts):
            raise InvalidConfigError(
                f"NetworkConfig.{name} is {given!r}; it must be whole, from {least} to {most}"
            )
    for name in _NUMBERS:
        given = getattr(config, name)
        if type(given) not in (int, float) or not 0.0 <= given < 180.0:
            raise InvalidConfigError(
                f"NetworkConfig.{name} is {given!r}; it must be a number from 0 to 180"
            )


PRESETS: dict[str, NetworkConfig] = {
    # For two processor cores; docs/method.md lists the cost of each size.
    "small": NetworkConfig(),
}
"""Network configurations by name."""

TINY_NETWORK = NetworkConfig(
    image_size=64,
    widths=(8, 16),
    decoder_width=16,
    bins=16,
    volume=8,
    volume_channels=8,
    point_hidden=16,
    volume_widths=(8, 16),
    decoder_hidden=16,
    grid=8,
)
"""A network that runs in milliseconds and learns nothing, for smoke runs and tests."""


def preset(name: str) -> NetworkConfig:
    """Return the sizes of a named network."""
    if name not in PRESETS:
        raise InvalidConfigError(
            f"there is no network {name!r}; choose one of {', '.join(PRESETS)}"
        )
    return PRESETS[name]
