"""Every verb that writes, as a small command line: for kills, full disks and read-only folders."""

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from clothtrack.recordings import shipped_recording
from shared.proof_stage import (
    FAST,
    ROLL_OUTS,
    SMALL_NETWORK,
    STATES,
    TOWEL,
    TRAINING,
    settings,
    small_garments,
)


@dataclass(frozen=True)
class Verb:
    """A command line that writes.

    Attributes:
        name: of the row in the table.
        words: after `clothtrack`, from the folder of the small world and that of the results.
        copied: what is copied into the folder of the results first, from the small world, and
            under which name: verbs that change what they are given.
        keeps: whether the same command keeps what is finished; the others make it again, or
            refuse to replace it.
        dear: costs more than a few seconds of CPU time.
    """

    name: str
    words: Callable[[Path, Path], list[object]]
    copied: tuple[str, str] | None = None
    keeps: bool = True
    dear: bool = False

    def fresh(self, stage: Path, out: Path) -> None:
        """Make the folder of the results as it is before the verb runs."""
        shutil.rmtree(out, ignore_errors=True)
        out.mkdir(parents=True)
        if self.copied is not None:
            shutil.copytree(stage / self.copied[0], out / self.copied[1])


before = small_garments
"""Called in the child before each of these verbs."""


def _towels(stage: Path) -> list[Path]:
    return [stage / "world" / "recordings" / f"towel_{number:04d}" for number in (1, 2)]


def _tracked(stage: Path) -> list[Path]:
    return [stage / "tracked" / f"towel_{number:04d}.zarr" for number in (1, 2)]


def _at(stage: Path) -> list[object]:
    return ["--recordings", stage / "world" / "recordings"]


FLAT = ("world/recordings/towel_0001", "recording")

VERBS = (
    Verb("track", lambda s, o: ["track", *_towels(s), "--output", o, *settings(*FAST)]),
    Verb("label", lambda s, o: ["label", *_tracked(s), *_at(s), "--output", o]),
    Verb("evaluate", lambda s, o: [
        "evaluate", *_tracked(s), *_at(s), "--truth", s / "world" / "truth", "--output",
        o / "measures.json"]),
    Verb("simulate", lambda _, o: [
        "simulate", o, "--trajectories", 2, "--actions", 1, "--seed", 5, *settings(*TOWEL)]),
    Verb("simulate --states", lambda _, o: [
        "simulate", o, "--states", 8, "--seed", 2, *settings(*STATES)]),
    Verb("bench", lambda _, o: ["bench", o, "--split", "dev"]),
    Verb("import (MCAP)", lambda s, o: ["import", s / "bags" / "mcap", o / "recording"],
         keeps=False),
    Verb("import (ROS 1)", lambda s, o: ["import", s / "bags" / "ros1.bag", o / "recording"],
         keeps=False),
    Verb("flatten", lambda _, o: [
        "flatten", o, "--policy", "heuristic", "--actions", 2, "--seed", 3]),
    Verb("train-dynamics", lambda _, o: [
        "train-dynamics", o, "--garment", "towel", "--roll-outs", 6, "--only-roll-outs",
        *settings(*ROLL_OUTS)]),
    Verb("pretrain", lambda s, o: [
        "pretrain", s / "states", "--output", o, *settings(*TRAINING, *SMALL_NETWORK)]),
    Verb("finetune", lambda s, o: [
        "finetune", s / "network" / "model.safetensors", s / "labels", "--output", o,
        *settings(*TRAINING)]),
    Verb("export .npz", lambda s, o: ["export", _tracked(s)[0], "--output", o / "mesh.npz"]),
    Verb("export folder", lambda s, o: ["export", _tracked(s)[0], "--output", o / "meshes"],
         keeps=False),
    Verb("export .png", lambda s, o: [
        "export", _tracked(s)[0], "--output", o / "sheet.png", *_at(s)]),
    Verb("view --html", lambda s, o: ["view", _tracked(s)[0], "--html", o / "v.html", *_at(s)]),
    Verb("segment", lambda _, o: [
        "segment", o / "recording", "--click", 40, 30, "--sheet", o / "masks.png"], copied=FLAT),
    Verb("calibrate-camera", lambda _, o: [
        "calibrate-camera", o / "recording", "--keep-world"], copied=FLAT),
    Verb("calibrate-camera --output", lambda s, o: [
        "calibrate-camera", _towels(s)[0], "--keep-world", "--output", o / "camera.json"]),
    Verb("garment", lambda _, o: [
        "garment", shipped_recording(), "--kind", "tshirt", "--vertices", 200, "--output",
        o / "shirt.npz"]),
    Verb("reconstruct", lambda s, o: [
        "reconstruct", _towels(s)[0], "--weights", s / "network" / "model.safetensors",
        "--no-refined", "--output", o / "mesh.obj"], keeps=False, dear=True),
)  # fmt: skip
"""The verbs that write, but for those that wait for a person or a camera (record, find-picker,
calibrate-hand-eye), and `demo`, which is `track` and `view`."""
