"""Make a garment's template from a picture of it lying flat."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from tyro.conf import arg

from clothtrack.api.options import DepthUnit, require_file
from clothtrack.errors import InvalidConfigError

if TYPE_CHECKING:
    from clothtrack.garments.flat_template import FlatTemplate
    from clothtrack.geometry.mesh import ClothMesh

Kind = Literal["towel", "tshirt", "polo", "sweater", "trousers"]
_LEAST_VERTICES = 50
"""Smallest number of vertices of a template."""

_LEAST_HEM = 0.75
"""Least width of a flat shirt's hem over that between its armpits; drawn cuts have 0.87 to 1.15."""

_PLACE = re.compile(r"(-?\d+(?:\.\d+)?),(-?\d+(?:\.\d+)?)")


@dataclass(frozen=True)
class GarmentTemplate:
    """A garment's template with its measures.

    Attributes:
        template: its mesh [m], its measures and the named stretches of its outline.
        kind: kind of garment.
        output: the written file.
        as_it_lies: whether both halves were left as they lie on request.
    """

    template: "FlatTemplate"
    kind: Kind
    output: Path
    as_it_lies: bool

    @property
    def mesh(self) -> "ClothMesh":
        """The template [m], with its canonical coordinates."""
        return self.template.mesh

    @property
    def measures(self) -> dict[str, float]:
        """Width, length, and the mean length of each kind of stretch [m]; area [m^2]."""
        return dict(self.template.measures)

    @property
    def doubts(self) -> tuple[str, ...]:
        """Possible problems, with remedies."""
        found = []
        if self.kind not in ("towel", "trousers") and not self.template.neck_seen:
            found.append(
                "the neck's ends are a guess: no dip shows them; check the picture, or --openings"
            )
        if (share := self.template.hem_share) < _LEAST_HEM:
            found.append(
                f"the hem is {share:.2f} times as wide as the body between the armpits (at least "
                f"{_LEAST_HEM:g} when flat): the garment does not lie flat there, or the openings "
                "are wrong; smooth it out, and look at the picture of the outline"
            )
        if self.kind != "towel" and not (self.template.mirrored or self.as_it_lies):
            found.append(
                f"the halves differ by {1e3 * self.template.asymmetry_m:.0f} mm and are left as "
                "they lie; check the openings in the picture, and lay the garment out more evenly"
            )
        return tuple(found)

    def text(self) -> str:
        """Return its size, its lengths and its path."""
        measures = self.template.measures
        lengths = ", ".join(
            f"{name.removesuffix('_m').replace('_', ' ')} {100 * value:.1f}"
            for name, value in measures.items()
            if name not in ("width_m", "length_m", "area_m2")
        )
        size = f"{100 * measures['width_m']:.1f} x {100 * measures['length_m']:.1f} cm"
        return (
            f"{self.output}   {self.kind} of {size}, {1e4 * measures['area_m2']:.0f} cm2, "
            f"{self.mesh.vertex_count} vertices\n{lengths} cm\n"
            f"{_outline_path(self.output)}   (look at it)"
        )

    def as_dict(self) -> dict[str, Any]:
        """Return the same as JSON-compatible values."""
        return {
            "template": str(self.output),
            "outline": str(_outline_path(self.output)),
            "kind": self.kind,
            "vertices": self.template.mesh.vertex_count,
            "asymmetry_m": self.template.asymmetry_m,
            "mirrored": self.template.mirrored,
            "neck_seen": self.template.neck_seen,
            **self.template.measures,
        }


def garment_template(
    picture: Path | str,
    *,
    kind: Kind,
    output: Path | str,
    vertex_count: Annotated[int, arg(name="vertices")] = 1000,
    mask: Path | str | None = None,
    meters_per_pixel: float | None = None,
    depth_unit_m: DepthUnit = None,
    focal: float | None = None,
    frame: int | None = None,
    front_neck_m: Annotated[float | None, arg(name="front-neck")] = None,
    openings: Sequence[str] = (),
    as_it_lies: bool = False,
) -> GarmentTemplate:
    """Make a garment's template mesh from a picture of it lying flat, its front up.

    It also writes TEMPLATE.outline.png: check that picture before you use the template.

    Args:
        picture: a recording, a 16-bit depth PNG, or a color or mask PNG from straight above.
        kind: kind of garment.
        output: template to write: .npz, or .obj with its canonical coordinates beside it.
        vertex_count: approximate number of vertices.
        mask: mask picture of the garment, for a PNG.
        meters_per_pixel: scale on the table, for a color or mask PNG.
        depth_unit_m: meters per unit of a depth PNG; 0.001 if not given.
        focal: focal length of a depth PNG's camera [pixels]; 0.94 of its width if not given.
        frame: frame of a recording; the first by default.
        front_neck_m: how deep the front's neck is cut [m]; a tenth of the length if not given.
        openings: ends of the openings, if the guess is wrong: COLUMN,ROW of both ends of hem, cuff,
            neck, cuff, or of waist, cuff, cuff, once around the garment.
        as_it_lies: leave both halves as they lie; otherwise they are made mirror images.

    Raises:
        InvalidRecordingError: the picture cannot be read or does not show such a flat garment.
        InvalidConfigError: an option is wrong or does not apply to such a picture.
    """
    import numpy as np

    from clothtrack.files.atomic_write import write_file
    from clothtrack.garments.flat_template import make_template
    from clothtrack.reconstruction.flat_picture import flat_color, flat_depth, flat_recording
    from clothtrack.recordings.pictures import encode_png, read_header
    from clothtrack.recordings.template_file import require_template_format, write_template
    from clothtrack.report.outline_picture import outline_picture

    picture, output = Path(picture), Path(output)
    places = _places(openings)
    if vertex_count < _LEAST_VERTICES:
        raise InvalidConfigError(
            f"--vertices is {vertex_count}; it must be at least {_LEAST_VERTICES}"
        )
    if not picture.is_dir():
        require_file(picture, "picture")
    require_file(mask, "mask")
    require_template_format(output)
    options = _named(mask=mask and Path(mask), depth_unit_m=depth_unit_m, focal=focal)
    if picture.is_dir():
        _refuse(options | _named(meters_per_pixel=meters_per_pixel), f"{picture} is a recording")
        flat = flat_recording(picture, frame or 0)
    elif read_header(picture).bits == 16:
        _refuse(_named(frame=frame, meters_per_pixel=meters_per_pixel), f"{picture} has depth")
        flat = flat_depth(picture, **options)
    else:
        options.pop("mask", None)
        _refuse(options | _named(frame=frame), f"{picture} has no depth")
        if meters_per_pixel is None:
            raise InvalidConfigError(
                f"{picture}: a picture without depth does not say how large the garment is; add "
                "--meters-per-pixel, a known length on the table over its pixels"
            )
        flat = flat_color(picture, meters_per_pixel, mask=mask and Path(mask))
    template = make_template(
        flat.outline,
        kind,
        vertex_count=vertex_count,
        front_neck_m=front_neck_m,
        openings=np.array(places) if places else None,
        mirrored=not as_it_lies,
        name=flat.name,
    )
    write_template(template.mesh, output)
    write_file(_outline_path(output), encode_png(outline_picture(template, flat.shown)))
    return GarmentTemplate(template, kind, output, as_it_lies)


def _places(openings: Sequence[str]) -> list[tuple[float, float]]:
    """Return the pixels of the ends of openings."""
    places = []
    for text in openings:
        match = _PLACE.fullmatch(text)
        if match is None:
            raise InvalidConfigError(f"--openings has {text!r}; write pixels as COLUMN,ROW")
        places.append((float(match[1]), float(match[2])))
    return places


def _outline_path(output: Path) -> Path:
    """Return the path, beside a template, of the picture with its outline."""
    return output.with_suffix(".outline.png")


def _named(**options: object) -> dict[str, object]:
    return {name: value for name, value in options.items() if value is not None}


def _refuse(options: dict[str, object], why: str) -> None:
    """Refuse options that do not apply here instead of ignoring them."""
    if options:
        names = " and ".join(f"--{name.removesuffix('_m').replace('_', '-')}" for name in options)
        raise InvalidConfigError(f"{names}: {why}; leave it out")
