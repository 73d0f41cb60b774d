"""The whole reconstruction, from one depth picture to the full mesh."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from clothtrack.errors import InvalidConfigError, InvalidRecordingError, InvalidResultError
from clothtrack.geometry.camera import Camera
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.reconstruction.alignment_frame import Alignment
from clothtrack.reconstruction.data.view import (
    ClothPixels,
    CroppedView,
    cloth_pixels,
    crop,
    points_of,
)
from clothtrack.reconstruction.from_picture import Method, Reconstruction
from clothtrack.reconstruction.seen_points import SeenPoints
from clothtrack.reconstruction.training.checkpoint import Weights, check_tensors
from clothtrack.recordings.recording import Table
from clothtrack_lab.published_networks.canonical_frame import (
    CanonicalFrame,
    canonical_frame,
    conventional,
)
from clothtrack_lab.published_networks.canonicalisation import Canonicaliser
from clothtrack_lab.published_networks.completion import Completion, WarpField, observe_pictures
from clothtrack_lab.published_networks.network_config import PRESETS, NetworkConfig
from clothtrack_lab.published_networks.surface import extract_surface, field_grid
from clothtrack_lab.published_networks.template_fit import (
    NO_CANONICAL,
    TemplateFitConfig,
    fit_template,
    template_of,
)


class MeshReconstructor(nn.Module):
    """Canonicaliser, completion and warp field, with two methods to make a mesh.

    Attributes:
        frame: canonical cube of its category.
    """

    def __init__(self, config: NetworkConfig, kind: str) -> None:
        """Make untrained networks for one category."""
        super().__init__()
        self.config = config
        self.frame: CanonicalFrame = canonical_frame(kind)
        self.canonicaliser = Canonicaliser(config)
        self.completion = Completion(config, self.canonicaliser.channels)
        self.warp = WarpField(config)

    @property
    def device(self) -> torch.device:
        """Device of the weights."""
        return next(self.parameters()).device

    def reconstruct(
        self,
        depth_m: Sequence[Float[np.ndarray, "height width"]],
        cameras: Sequence[Camera] | Camera,
        kind: str,
        *,
        masks: Sequence[Bool[np.ndarray, "height width"] | None] | None = None,
        method: Method = "template",
        template: ClothMesh | None = None,
        table: Table | None = None,
        fit: TemplateFitConfig | None = None,
    ) -> tuple[Reconstruction, ...]:
        """Return the full mesh for each depth picture, as one batch.

        Args:
            depth_m: measured depth [m]; 0 where nothing was measured.
        """
        if kind != self.frame.kind:
            raise InvalidConfigError(
                f"kind is {kind!r}, but these weights are for {self.frame.kind!r}; "
                "load the weights of the category"
            )
        if not depth_m:
            return ()
        views = _views(depth_m, cameras, masks, self.config)
        observed = self.observe(views)
        if method == "implicit":
            meshes = self._from_field(observed)
        else:
            fit = fit or TemplateFitConfig()
            meshes = [self._from_template(each, template, table, fit) for each in observed]
        return tuple(
            _reconstruction(one, *found, self.config)
            for one, found in zip(observed, meshes, strict=True)
        )

    @torch.inference_mode()
    def observe(self, views: Sequence[CroppedView]) -> list["ObservedCloth"]:
        """Return canonical coordinates and the completed volume for each picture."""
        self.eval()
        found = [cloth_pixels(view.depth, self.config) for view in views]
        points = [
            points_of(view.depth, view.camera, each.sources)
            for view, each in zip(views, found, strict=True)
        ]
        depth = torch.from_numpy(np.stack([view.depth for view in views])[:, None])
        picture = np.repeat(np.arange(len(views)), [len(each.pixels) for each in found])
        pixels = np.column_stack([picture, np.concatenate([each.pixels for each in found])])
        observed = observe_pictures(
            self.canonicaliser,
            self.frame,
            depth.to(self.device),
            torch.from_numpy(pixels.astype(np.int64)).to(self.device),
            np.concatenate(points),
        )
        volume = self.completion(observed.points)
        least = observed.points.confidence.double().cpu().numpy().min(axis=1)
        least = np.split(least, np.flatnonzero(np.diff(picture)) + 1)
        return [
            ObservedCloth(*each)
            for each in zip(
                views, found, observed.seen, least, observed.alignments, volume.split(1),
                strict=True,
            )
        ]  # fmt: skip

    @torch.inference_mode()
    def carried(
        self, observed: "ObservedCloth", canonical: Float[np.ndarray, "places 3"]
    ) -> Float[np.ndarray, "places 3"]:
        """Return the positions of canonical points [m] in the world [m] by the warp field."""
        unit = torch.from_numpy(self.frame.to_unit(canonical)).float().to(self.device)
        moved = self.warp(observed.volume, unit[None])[0].double().cpu().numpy()
        return observed.alignment.to_world(canonical + moved)

    def _from_template(
        self,
        observed: "ObservedCloth",
        template: ClothMesh | None,
        table: Table | None,
        fit: TemplateFitConfig,
    ) -> "_Found":
        if template is None:
            template = template_of(self.frame, observed.seen, vertex_count=fit.vertex_count)
        if template.canonical is None:
            raise InvalidConfigError(NO_CANONICAL)
        canonical = conventional(template.canonical, self.frame.kind)
        asked = replace(template, canonical=canonical)
        warp = self.carried(observed, canonical) if fit.warp_weight > 0 else None
        fitted = fit_template(asked, observed.seen, fit, warp=warp, table=table)
        return template.with_vertices(fitted.vertices), "template", template

    @torch.inference_mode()
    def _from_field(self, observed: Sequence["ObservedCloth"]) -> "list[_Found]":
        grid = field_grid(self.frame, self.config)
        nodes = torch.from_numpy(grid.nodes).float().to(self.device)
        meshes: list[_Found] = []
        for one in observed:
            field = self.completion.field(one.volume, nodes)[0].float().cpu().numpy()
            surface = extract_surface(field.reshape(grid.shape), self.frame, self.config)
            mesh = surface.mesh
            if mesh is not None:
                mesh = mesh.with_vertices(self.carried(one, mesh.vertices))
            meshes.append((mesh, surface.status, None))
        return meshes


@dataclass(frozen=True, eq=False)
class ObservedCloth:
    """One picture and the networks' outputs for it.

    Attributes:
        found: cloth pixels of the picture.
        seen: their positions and canonical positions.
        confidence: confidence of the least certain axis of each pixel.
        alignment: transform between the world and the canonical frame.
    """

    view: CroppedView
    found: ClothPixels
    seen: SeenPoints
    confidence: Float[np.ndarray, " pixels"]
    alignment: Alignment
    volume: Float[Tensor, "1 channels x y z"]


def _views(
    depth_m: Sequence[Float[np.ndarray, "height width"]],
    cameras: Sequence[Camera] | Camera,
    masks: Sequence[Bool[np.ndarray, "height width"] | None] | None,
    config: NetworkConfig,
) -> list[CroppedView]:
    count = len(depth_m)
    cameras = [cameras] * count if isinstance(cameras, Camera) else list(cameras)
    masks = [None] * count if masks is None else masks
    if not len(cameras) == len(masks) == count:
        raise InvalidRecordingError(
            f"{count} depth pictures, {len(cameras)} cameras and {len(masks)} masks; "
            "give one of each per picture, or one camera for all"
        )
    return [crop(*each, config) for each in zip(depth_m, masks, cameras, strict=True)]


_Found = tuple[ClothMesh | None, str, ClothMesh | None]
"""A mesh, the method that found it, and the flat garment that it was made from."""


def _reconstruction(
    observed: ObservedCloth,
    mesh: ClothMesh | None,
    status: str,
    rest: ClothMesh | None,
    config: NetworkConfig,
) -> Reconstruction:
    size = config.output_size
    canonical = np.full((size, size, 3), np.nan, dtype=np.float32)
    confidence = np.zeros((size, size), dtype=np.float32)
    rows, columns = observed.found.pixels.T
    canonical[rows, columns] = observed.seen.canonical
    confidence[rows, columns] = observed.confidence
    camera = observed.view.camera
    return Reconstruction(mesh, status, camera, canonical, confidence, observed.seen, rest)


_FORMER = {"encoder": "unet", "depth_channels": 3, "head_width": 0, "output_stride": 2}
"""Sizes that weights name and that no network varies any more."""


def network_of(weights: Weights) -> NetworkConfig:
    """Return the configuration of the networks for weights of both stages.

    The weights are compared with it before any network is built. So the network is as large as the
    weights in the file, not as large as the file claims.
    """
    try:
        values = {
            name: tuple(value) if isinstance(value, list) else value
            for name, value in weights.network.items()
            if _FORMER.get(name) != value
        }
        network = NetworkConfig(**values)
        with torch.device("meta"):
            shapes = MeshReconstructor(network, weights.kind)
    except (TypeError, InvalidConfigError) as error:
        raise InvalidResultError(
            f"{weights.path}: its network is none that this version knows ({error}); give weights "
            f"of one of {', '.join(PRESETS)}"
        ) from error
    check_tensors(shapes, weights.tensors, weights.path)
    return network
