"""Labeled pictures as examples of the token network, turned and mirrored anew in every epoch."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int

from clothtrack.errors import InvalidConfigError, InvalidRecordingError
from clothtrack.geometry.camera import Camera
from clothtrack.reconstruction.data.labeled_picture import LabeledPicture, faces_of_points
from clothtrack.reconstruction.data.pseudo_labels import LabeledRecording
from clothtrack.reconstruction.data.view import CroppedView, cloth_pixels, crop, points_of
from clothtrack.reconstruction.tokens.garment_tokens import GarmentTokens
from clothtrack.reconstruction.tokens.token_network import EMPTY, TokenNetworkConfig
from clothtrack.reconstruction.tokens.token_pictures import (
    CUT,
    PIXELS,
    SIZE_ERROR,
    TABLE_ERROR,
)
from clothtrack.reconstruction.tokens.token_stage import TokenExample
from clothtrack.reconstruction.training.batches import Draw
from clothtrack.simulation.parameters import RESTING_HEIGHT_M

_LEAST_NAMED = 0.05
"""Labels whose mesh is near a smaller share of the measured pixels are misplaced and dropped."""

LOWER_PART, BEYOND_LINE = 0.4, 0.2
"""Probability that low cloth is removed from a label's picture, and that cloth beyond a line is.

Labels come from few recordings. Other sensors may measure parts that theirs cut away, and the
reverse."""

MOST_LOW, MOST_BEYOND = 0.6, 0.3
"""Largest shares of the measured pixels that are removed then."""


class LabeledTokenExamples:
    """Examples from tracked recordings of any garments, each a function of index, epoch and seed.

    Labels whose mesh is away from the measured cloth are left out.

    Args:
        network: sizes of the network that the pictures are for.
    """

    def __init__(
        self, recordings: Sequence[LabeledRecording], network: TokenNetworkConfig, *, seed: int = 0
    ) -> None:
        self.network = network
        self.seed = seed
        self._recordings = recordings
        self._garments = [GarmentTokens.of(one.mesh) for one in recordings]
        self._places = [
            (number, picture)
            for number, one in enumerate(recordings)
            for picture in range(len(one.pictures))
            if self._named_share(number, picture) >= _LEAST_NAMED
        ]
        if not self._places:
            raise InvalidConfigError(
                "there is no labeled picture whose mesh lies where the cloth was measured; make "
                "some with: clothtrack label TRACKED..."
            )
        self.groups = [recordings[number].name for number, _ in self._places]

    def _named_share(self, number: int, picture: int) -> float:
        """Return the share of measured pixels near enough to the mesh for a correspondence."""
        one, cut_m = self._recordings[number], CUT * self._garments[number].size_m
        shown = one.pictures[picture]
        points = shown.camera.back_project(shown.depth_m, shown.mask)
        _, _, named = faces_of_points(points, shown, one.mesh.faces, cut_m=cut_m)
        return float(named.mean()) if len(named) else 0.0

    def __len__(self) -> int:
        """Return the number of labeled pictures."""
        return len(self._places)

    def __getitem__(self, draw: Draw) -> TokenExample:
        """Return the picture, augmented for this epoch."""
        index, epoch = draw
        number, picture = self._places[index]
        one = self._recordings[number]
        rng = np.random.default_rng([self.seed, epoch, index])
        # The first mesh lies flat on the table.
        table_m = float(np.percentile(one.mesh.vertices[:, 2], 5.0)) - RESTING_HEIGHT_M
        whole = one.pictures[picture]
        try:
            return self._drawn(number, with_parts_missing(whole, rng), table_m, rng)
        except InvalidRecordingError:
            # All pixels with a correspondence were removed.
            return self._drawn(number, whole, table_m, rng)

    def _drawn(
        self, number: int, picture: LabeledPicture, table_m: float, rng: np.random.Generator
    ) -> TokenExample:
        faces = self._recordings[number].mesh.faces
        return token_example(
            picture, faces, self._garments[number], self.network, rng, table_m=table_m
        )


def with_parts_missing(picture: LabeledPicture, rng: np.random.Generator) -> LabeledPicture:
    """Return a labeled picture from which part of the measured cloth may be removed."""
    rows, columns = np.nonzero(picture.mask & (picture.depth_m > 0))
    kept = np.ones(len(rows), bool)
    if len(rows) and rng.random() < LOWER_PART:
        measured = np.zeros_like(picture.mask)
        measured[rows, columns] = True
        height = picture.camera.back_project(picture.depth_m, measured)[:, 2]
        kept &= height >= np.quantile(height, rng.uniform(0.0, MOST_LOW))
    if len(rows) and rng.random() < BEYOND_LINE:
        angle = rng.uniform(0.0, 2.0 * np.pi)
        along = np.cos(angle) * columns + np.sin(angle) * rows
        kept &= along <= np.quantile(along, 1.0 - rng.uniform(0.0, MOST_BEYOND))
    mask = np.zeros_like(picture.mask)
    mask[rows[kept], columns[kept]] = True
    return replace(picture, mask=mask)


def token_example(
    picture: LabeledPicture,
    faces: Int[np.ndarray, "faces 3"],
    garment: GarmentTokens,
    network: TokenNetworkConfig,
    rng: np.random.Generator,
    *,
    table_m: float = 0.0,
) -> TokenExample:
    """Return a labeled picture as an example of the network, mirrored and turned at random.

    Args:
        table_m: height of the table in the world [m].
    """
    mirrored = rng.random() < 0.5
    if mirrored:
        picture = picture.mirrored()
    picture = picture.turned(rng.uniform(-np.pi, np.pi))
    view = crop(picture.depth_m, picture.mask, picture.camera, network)
    seen = cloth_pixels(view.depth, network)
    # Draw more than needed, because some lie off the mesh.
    chosen = rng.permutation(len(seen.pixels))[: 2 * PIXELS]
    pixels = seen.pixels[chosen]
    points = points_of(view.depth, view.camera, seen.sources[chosen])
    face, weights, known = faces_of_points(points, picture, faces, cut_m=CUT * garment.size_m)
    known = np.flatnonzero(known)
    if len(known) == 0:
        raise InvalidRecordingError("no pixel of the cloth is near its mesh; render it again")
    known = rng.choice(known, PIXELS, replace=len(known) < PIXELS)
    corners = faces[face[known]]
    tokens = garment.vertex_tokens[corners].reshape(PIXELS, -1)
    shares = garment.vertex_shares[corners] * weights[known][..., None]
    size_m = garment.size_m * float(np.exp(SIZE_ERROR * rng.standard_normal()))
    table_m += TABLE_ERROR * garment.size_m * rng.standard_normal()
    height, distance, origin = seen_by_network(view, size_m, table_m)
    places = (garment.places(picture.positions, faces) - origin) / size_m
    if mirrored:
        # The mirror image of a garment is a garment of the same kind with mirrored tokens.
        tokens, places = garment.mirror[tokens], places[garment.mirror]
    return TokenExample(
        height=height,
        distance=distance,
        features=garment.features,
        pixels=pixels[known],
        pixel_tokens=tokens,
        pixel_shares=shares.reshape(PIXELS, -1).astype(np.float32),
        places=places.astype(np.float32),
        labelings=garment.labelings,
        is_labeling=garment.is_labeling,
        neighbors=garment.neighbors,
        conventional=_conventional(places, garment),
        size_m=size_m,
    )


def seen_by_network(
    view: CroppedView, size_m: float, table_m: float
) -> tuple[Float[np.ndarray, "rows columns"], float, Float[np.ndarray, " 3"]]:
    """Return the network's input of a view.

    Args:
        size_m: longer side of the flat garment [m].
        table_m: height of the table in the world [m].

    Returns:
        Heights above the table and distance of the camera from it, in units of the size, and the
        origin of the picture's frame in the world [m].
    """
    camera: Camera = view.camera
    x, y, z = camera.position
    height = (z - table_m - view.depth) / size_m
    shown = np.where(view.depth > 0, height, EMPTY).astype(np.float32)
    return shown, float((z - table_m) / size_m), np.array([x, y, table_m])


def _conventional(
    places: Float[np.ndarray, "tokens 3"], garment: GarmentTokens
) -> Float[np.ndarray, " labelings"]:
    """Return how well the cloth's pose agrees with the flat garment's under each symmetry.

    A single sheet has its x to the right and its y up; a garment of two layers has its front above
    its back.
    """
    lying = garment.features[:, :2] if garment.layers == 1 else garment.features[:, 2:3]
    shown = places[:, :2] if garment.layers == 1 else places[:, 2:3]
    shown = shown - shown.mean(axis=0)
    return np.array([(shown * lying[name]).sum() for name in garment.labelings])
