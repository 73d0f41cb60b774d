"""Record the example that is shipped with clothtrack, small enough for the package.

A two-layer T-shirt is folded twice in the simulated world, seen by a noisy depth camera with the
tool in view. The shipped copy leaves out the truth (it goes to OUT/world/truth, for judging
results), depth farther than 12 pixels from the cloth, and the two lowest bits of each color.

    python experiments shipped_recording --output OUT

OUT/fold_the_tshirt is then byte for byte `src/clothtrack/shipped/fold_the_tshirt`, with the
versions of constraints.txt.
"""

import argparse
from pathlib import Path

import _path  # noqa: F401
import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8
from shared.figures import say

from clothtrack.reconstruction.data.sensor_noise import SensorConfig
from clothtrack.recordings.pictures import read_color, read_depth
from clothtrack.recordings.recording import Frame, Recording
from clothtrack.recordings.segmentation import default_segmenter
from clothtrack.recordings.store import RecordingWriter, read_recording
from clothtrack.simulation.pick_and_place import ActionConfig
from clothtrack_lab.world.episodes import EpisodeConfig, TemplateConfig, simulate_trajectory

NAME = "fold_the_tshirt"
SEED = 4
MARGIN_PX = 12
COLOR_STEP = 4
FILTERS = (
    cv2.IMWRITE_PNG_FILTER_NONE,
    cv2.IMWRITE_PNG_FILTER_SUB,
    cv2.IMWRITE_PNG_FILTER_UP,
    cv2.IMWRITE_PNG_FILTER_PAETH,
    cv2.IMWRITE_PNG_ALL_FILTERS,
)
WORLD = EpisodeConfig(
    vertex_count=700,
    actions=2,
    template=TemplateConfig(vertex_count=1000),
    action=ActionConfig(
        distance_m=(0.14, 0.24), lift_m=(0.06, 0.1), both_layers=1.0, frame_rate=10.0
    ),
    sensor=SensorConfig(width=320, height=240, focal=300.0, step_m=0.001),
)


def make(output: Path) -> Path:
    """Record the world and write the small copy; return the folder of the copy."""
    world = output / "world"
    filmed = world / "recordings" / f"tshirt_{SEED:04d}"
    if not filmed.exists():
        simulate_trajectory("tshirt", SEED, world, config=WORLD)
    copied = shrink(read_recording(filmed), output / NAME)
    for picture in sorted(copied.rglob("*.png")):
        pack(picture)
    return copied


def shrink(recording: Recording, folder: Path) -> Path:
    """Return a copy with coarser color and no depth far from the cloth."""
    (camera,) = recording.cameras
    provenance = {
        **recording.provenance,
        "made_by": "python experiments shipped_recording --output OUT",
        "left_out": f"depth farther than {MARGIN_PX} pixels from the cloth; "
        f"colors are multiples of {COLOR_STEP}",
    }
    with RecordingWriter(
        folder,
        recording.cameras,
        recording.depth_units_m,
        table=recording.table,
        cloth=recording.cloth,
        provenance=provenance,
    ) as writer:
        for frame in recording.frames:
            color = read_color(frame.color[camera.name])
            depth = read_depth(frame.depth[camera.name], recording.depth_units_m[camera.name])
            near = neighborhood(recording, frame, color, depth)
            writer.add_frame(
                frame.time_s,
                color={camera.name: color // COLOR_STEP * COLOR_STEP},
                depth={camera.name: np.where(near, depth, 0.0)},
            )
        for action in recording.actions:
            writer.add_action(action.first_frame, action.last_frame, action.pickers)
        for name, path in recording.picker_paths.items():
            writer.set_picker_path(name, path)
    return folder


def neighborhood(
    recording: Recording,
    frame: Frame,
    color: UInt8[np.ndarray, "height width 3"],
    depth: Float[np.ndarray, "height width"],
) -> Bool[np.ndarray, "height width"]:
    """Return pixels of the cloth and those within `MARGIN_PX` of them."""
    (camera,) = recording.cameras
    cloth = default_segmenter(recording, frame, camera)(color, depth, camera, recording.table)
    side = 2 * MARGIN_PX + 1
    return cv2.dilate(cloth.astype(np.uint8), np.ones((side, side), np.uint8)) > 0


def pack(picture: Path) -> None:
    """Write a PNG file again, as small as it gets without loss."""
    pixels = cv2.imread(str(picture), cv2.IMREAD_UNCHANGED)
    options = [[cv2.IMWRITE_PNG_COMPRESSION, 9, cv2.IMWRITE_PNG_FILTER, one] for one in FILTERS]
    picture.write_bytes(
        min((cv2.imencode(".png", pixels, each)[1].tobytes() for each in options), key=len)
    )


def main() -> None:
    """Make the recording and say how large it is."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--output", type=Path, default=Path("out/shipped"))
    folder = make(parser.parse_args().output)
    size = sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())
    say(f"{folder}: {size / 1e6:.2f} MB\n")


if __name__ == "__main__":
    main()
