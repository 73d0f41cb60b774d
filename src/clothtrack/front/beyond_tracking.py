"""Learn from runs, reconstruct from one picture, flatten, and simulate what is not filmed."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from jaxtyping import Float

from clothtrack.errors import InvalidConfigError, InvalidResultError
from clothtrack.files.settings import with_settings
from clothtrack.front.run import Run, recording_of
from clothtrack.geometry.devices import quiet_warp
from clothtrack.geometry.mesh import ClothMesh

if TYPE_CHECKING:
    from clothtrack.planning.episode_store import EpisodeStore
    from clothtrack.planning.flatten_config import FlattenConfig

Garment = Literal["towel", "tshirt"]


def label(
    run: Run,
    output: Path | str,
    *,
    garment: Garment | None = None,
    weighted: bool = True,
    flat_weight: float = 1.0,
    device: str = "cpu",
) -> Path:
    """Write the pseudo-labels of a run, for `clothtrack finetune` (needs the extra [learn]).

    Args:
        run: what `track` or `load` returned.
        output: file to write, NAME.labels.npz.
        garment: what it is, where the recording does not say.
        weighted: weigh each label by its quality; otherwise all count alike.
        flat_weight: weight of the first frame, before any action; 0 leaves it out.
        device: "cpu" or "cuda:0", for visibility.

    Raises:
        InvalidResultError: the mesh has no canonical coordinates, or no label is left.
        InvalidConfigError: what garment it is is not known.
    """
    from clothtrack.evaluation.label_quality import judge_labels
    from clothtrack.evaluation.label_selection import pseudo_labels_of
    from clothtrack.reconstruction.data.pseudo_labels import label_recording, write_labels

    quiet_warp()
    source = recording_of(run)
    if run.mesh.canonical is None:
        raise InvalidResultError(
            f"{run.name}: its mesh has no canonical coordinates; track it from a template with them"
        )
    chosen = pseudo_labels_of(
        run, judge_labels(run, source, device=device), (), weighted=weighted,
        flat_weight=flat_weight,
    )  # fmt: skip
    kind = _kind(garment or source.cloth.kind, run.name)
    made = {"tracked": dict(run.provenance), "weighted": weighted}
    write_labels(
        label_recording(source, run.mesh, chosen, kind=kind, provenance=made), Path(output)
    )
    return Path(output)


def reconstruct(
    picture: Path | str | Float[np.ndarray, "height width"],
    garment: Garment | None = None,
    *,
    frame: int = 0,
    weights: Path | str | None = None,
    method: Literal["template", "implicit"] = "template",
    refined: bool = True,
    device: str = "cpu",
    **of_picture: Any,
) -> ClothMesh:
    """The whole cloth, hidden layers included, from one depth picture (needs the extra [learn]).

    Args:
        picture: depth [m] of a camera that looks straight down on a table, 0 where nothing was
            measured; a 16-bit depth PNG of one; or the folder of a recording.
        garment: what it is; a recording may say so itself.
        frame: of a recording.
        weights: model.safetensors; the ones that come with clothtrack by default.
        method: the garment's own mesh laid into the picture, or the surface of the predicted
            winding number, which may find none.
        refined: fine-tune the mesh to the picture.
        device: "cpu" or "cuda:0".
        **of_picture: `mask` (file), `focal` [pixels], `table_distance_m` and, for a PNG,
            `depth_unit_m`.

    Returns:
        The mesh in the world [m]; the table is at z = 0 for a picture.

    Raises:
        InvalidRecordingError: the picture cannot be read or shows no cloth.
        InvalidConfigError: what garment it is is not known.
        InvalidResultError: weights are missing, or no mesh was found.
    """
    from clothtrack.reconstruction import depth_input
    from clothtrack.reconstruction.from_picture import network_mesh
    from clothtrack.reconstruction.load_model import load_model
    from clothtrack.reconstruction.refinement import RefinementConfig

    quiet_warp()
    if isinstance(picture, np.ndarray):
        given = depth_input.from_depth(picture, "the depth array", **of_picture)
    elif Path(picture).is_dir():
        given = depth_input.from_recording(Path(picture), frame)
    else:
        given = depth_input.from_picture(Path(picture), **of_picture)
    named = "the depth array" if isinstance(picture, np.ndarray) else str(picture)
    kind = _kind(garment or given.kind, named)
    model = load_model(kind, weights and Path(weights), device=device)
    refinement = RefinementConfig() if refined else None
    made = network_mesh(model, given, kind, method=method, refinement=refinement, device=device)
    if made.mesh is None:
        raise InvalidResultError(
            f"{named}: no mesh ({made.reconstruction.status}); try method='template'"
        )
    return made.mesh


def flatten(
    output: Path | str,
    garment: Garment = "towel",
    *,
    config: "FlattenConfig | None" = None,
    settings: Sequence[str] = (),
    seed: int = 0,
    device: str = "cpu",
) -> "EpisodeStore":
    """Flatten a crumpled garment of the simulated world: perceive, plan, act, and look again.

    Args:
        output: folder for the episode, its recording and its truth; an interrupted episode goes on.
        garment: what lies on the table.
        config: how; `settings` change it.
        settings: such as "actions=3" or "planner.candidates=300".
        seed: of garment, start, noise and candidates.
        device: "cpu" or "cuda:0".

    Returns:
        The episode on disk: its steps and its status.
    """
    from clothtrack.baselines.flattening_policies import POLICIES
    from clothtrack.planning.flatten_config import FlattenConfig
    from clothtrack.world.simulated_episodes import (
        EpisodeParts,
        SimulatedEpisode,
        flatten_simulated,
    )

    quiet_warp()
    changed = with_settings(config or FlattenConfig(), settings)
    parts = EpisodeParts(propose=POLICIES.get(changed.policy))
    episode = SimulatedEpisode(garment, seed)
    return flatten_simulated(Path(output), episode, changed, parts=parts, device=device)


def simulate(
    output: Path | str,
    garment: Garment = "towel",
    trajectories: int = 1,
    *,
    seed: int = 0,
    small: bool = False,
    settings: Sequence[str] = (),
    workers: int = 1,
) -> list[Path]:
    """Record pick-and-places in a simulated world that knows the truth.

    Args:
        output: folder for recordings/ and truth/; what is finished there is kept.
        garment: what lies on the table.
        trajectories: how many recordings, with the seeds `seed`, `seed` + 1 and so on.
        seed: of garment, pose, actions, camera and noise.
        small: one action with a napkin before a small camera, in a few seconds.
        settings: changes to what is recorded, such as "sensor.width=320" or "actions=2".
        workers: processes.

    Returns:
        The folders of the recordings.
    """
    from clothtrack.world.episodes import SMALL_WORLD, EpisodeConfig
    from clothtrack.world.episodes import simulate as record

    quiet_warp()
    config = with_settings(SMALL_WORLD if small else EpisodeConfig(), settings)
    return record(Path(output), garment, trajectories, seed=seed, config=config, processes=workers)


def _kind(garment: str | None, source: str) -> str:
    if garment not in ("towel", "tshirt"):
        raise InvalidConfigError(
            f"{source}: what garment it shows is {garment or 'not said'}; add garment='towel' or "
            "garment='tshirt'"
        )
    return garment
