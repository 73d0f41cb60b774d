"""The first frame of every real recording that has depth, reconstructed: pictures to look at.

    python experiments real_reconstruction --data DIR --weights TOWEL TSHIRT --images OUT

No true mesh is known, so there is no number but the distance to the measured points. Where a cloth
hangs in front of its camera, the network's world is turned so that the camera looks down on it: the
network knows nothing else. A set that is not in DIR, or has no depth, is skipped and says why;
recordings in clothtrack's own format (recording.json) in DIR are taken too.
"""

import argparse
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import _path  # noqa: F401
import numpy as np
from real import hanging_cloth, robot_clouds, tshirt_pair
from shared.figures import say, write_json, write_png
from shared.learning_experiment import refined, tiny_network
from shared.learning_runs import Reconstructor, kind_of
from shared.reconstruction_pictures import (
    HEIGHT,
    WIDTH,
    canonical_picture,
    depth_picture,
    line,
    mesh_picture,
)

from clothtrack.errors import ClothTrackError, InvalidRecordingError
from clothtrack.geometry import Camera, one_way, quiet_warp
from clothtrack.reconstruction import DepthInput, load_model
from clothtrack.reconstruction.data.pseudo_labels import cloth_picture
from clothtrack.reconstruction.from_picture import observation_of
from clothtrack.recordings import read_recording
from clothtrack.report.viewpoint import three_quarter_view
from clothtrack_lab.world import SMALL_WORLD, simulate

LEVEL_DEG = 20.0


@dataclass(frozen=True)
class RealSet:
    """A recorded set that is not in clothtrack's own format.

    Attributes:
        name: of its folder.
        kind: the garment; empty when the set has no depth pictures of a cloth.
        convert: writes it as a recording.
        why_not: why it is skipped though it may be there.
    """

    name: str
    kind: str = ""
    convert: Callable[..., Path] | None = None
    why_not: str = ""


SETS = (
    RealSet(hanging_cloth.NAME, "towel", hanging_cloth.convert),
    RealSet(tshirt_pair.NAME, "tshirt", tshirt_pair.convert),
    RealSet(robot_clouds.NAME, why_not="it has clouds and no depth picture"),
    RealSet("realsense-d435-bag", why_not="a bag of a sensor and no recording of a cloth"),
)


def looking_down(picture: DepthInput) -> DepthInput:
    """The same picture in a world in which its camera looks down, the farthest cloth at z = 0."""
    camera = picture.camera
    axis = camera.world_from_camera[:3, 2]
    if picture.table is not None and axis[2] < -np.cos(np.radians(LEVEL_DEG)):
        return picture
    farthest = float(picture.depth_m[picture.mask].max())
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[2, 3] = farthest
    turned: Camera = replace(camera, world_from_camera=pose)
    return replace(picture, camera=turned, table=None)


def reconstructed(folder: Path, kind: str, weights: Path, image: Path) -> dict[str, object]:
    """Draw the first frame of a recording, without and with fine-tuning; its figures."""
    recording = read_recording(folder)
    depth, mask, camera = cloth_picture(recording, recording.frames[0])
    if not mask.any():
        raise InvalidRecordingError(f"{folder}: no cloth is found in frame 0; look at its mask")
    given = looking_down(DepthInput(depth, mask, camera, recording.table, kind))
    model = load_model(kind, weights)
    plain = Reconstructor("network", weights)
    points = observation_of(given).points
    view = three_quarter_view(points, width=WIDTH, height=HEIGHT)
    pictures, figures = [depth_picture(depth, mask)], {}
    for how in (plain, refined(plain, "fine-tuned at test time")):
        found = model.mesh(given, kind, refined=how.refined)
        if how is plain:
            pictures.append(canonical_picture(found.reconstruction, kind))
        status = found.reconstruction.status
        pictures.append(mesh_picture(found.mesh, view, given.table, status))
        figures[how.name] = (
            None if found.mesh is None
            else one_way(points, found.mesh.vertices.astype(np.float64))
        )  # fmt: skip
    words = f"{recording.name} ({kind}): depth, canonical, network, fine-tuned at test time"
    write_png(image, line(pictures, (words, "")))
    return {"image": image.name, "kind": kind, "cloud_to_vertices_m2": figures}


def recordings_in(data: Path, temporary: Path) -> dict[str, tuple[Path, str] | str]:
    """By name: each recording with its garment, or why it is skipped."""
    found: dict[str, tuple[Path, str] | str] = {}
    for one in SETS:
        folder = data / one.name
        if not folder.is_dir():
            found[one.name] = f"there is no {folder}"
        elif one.convert is None:
            found[one.name] = one.why_not
        else:
            found[one.name] = one.convert(folder, temporary / one.name, frames=2), one.kind
    for document in sorted(data.glob("**/recording.json")):
        recording = read_recording(document.parent)
        kind = recording.cloth.kind
        if not recording.frames[0].depth:
            found[recording.name] = "its first frame has no depth picture"
        elif kind not in ("towel", "tshirt"):
            found[recording.name] = f"cloth.kind is {kind!r}"
        else:
            found[recording.name] = document.parent, kind
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the experiment; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, help="folder that holds the sets")
    parser.add_argument("--weights", type=Path, nargs="+", default=[], help="one per garment")
    parser.add_argument("--images", type=Path, help="folder of the pictures (DATA/reconstructed)")
    parser.add_argument("--smoke", action="store_true", help="a filmed towel, a tiny network")
    options = parser.parse_args(arguments)
    if not options.smoke and (options.data is None or not options.weights):
        parser.error("give --data DIR and --weights FILE... (one per garment), or --smoke")
    quiet_warp()
    with tempfile.TemporaryDirectory(prefix="real-reconstruction-") as name:
        temporary = Path(name)
        data = options.data
        weights = {kind_of(path): path for path in options.weights}
        if options.smoke:
            if data is None:
                data = temporary / "data"
                simulate(data, "towel", 1, config=SMALL_WORLD)
            weights = weights or {"towel": tiny_network(temporary / "tiny.safetensors")}
        images = options.images or data / "reconstructed"
        report = {}
        for title, found in recordings_in(data, temporary / "converted").items():
            report[title] = _judged(title, found, weights, images)
            text = report[title].get("skipped") or report[title].get("error")
            say(f"{title}: {f'skipped, {text}' if text else images / report[title]['image']}\n")
        write_json(images / "real_reconstruction.json", report)
    return 1 if any("error" in one for one in report.values()) else 0


def _judged(
    title: str, found: tuple[Path, str] | str, weights: dict[str, Path], images: Path
) -> dict[str, object]:
    if isinstance(found, str):
        return {"skipped": found}
    folder, kind = found
    if kind not in weights:
        return {"skipped": f"no weights for a {kind} are given"}
    try:
        return reconstructed(folder, kind, weights[kind], images / f"{title}.png")
    except ClothTrackError as error:
        return {"error": str(error)}


if __name__ == "__main__":
    sys.exit(main())
