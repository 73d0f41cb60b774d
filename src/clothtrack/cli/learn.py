"""The verbs of learning: label, pretrain, finetune, reconstruct. They need the extra [learn]."""

import json as json_module
import logging
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tyro.conf import Positional

from clothtrack.cli.options import AsJson, Device, Seed, Settings
from clothtrack.cli.terminal import TERMINATED, complain, end_progress, progress, say, say_result
from clothtrack.errors import InvalidConfigError, InvalidResultError
from clothtrack.files.extras import install_command
from clothtrack.reconstruction.availability import EXTRA, missing_modules
from clothtrack.tracking.artefacts import load_tracked, recording_of

if TYPE_CHECKING:
    from clothtrack.reconstruction.two_stages import LearningConfig, LearningOutcome

logger = logging.getLogger(__name__)


def label(
    tracked: Positional[tuple[Path, ...]],
    *,
    recordings: Path,
    output: Path,
    garment: Literal["as recorded", "towel", "tshirt"] = "as recorded",
    weighted: bool = True,
    flat_weight: float = 1.0,
    device: Device = "cpu",
    json: AsJson = False,
) -> int:
    """Make pseudo-labels of tracked trajectories: the data set that `finetune` learns from.

    Labels that a person rejected (`clothtrack view`, NAME.review.json) are left out.

    Args:
        tracked: NAME.zarr folders that `track` wrote.
        recordings: the recording, or the folder in which recordings lie by name.
        output: folder that gets one NAME.labels.npz per trajectory.
        garment: what it is, where the recording does not say or says otherwise.
        weighted: weigh each label by its quality; otherwise all count alike.
        flat_weight: weight of the first frame, before any action; 0 leaves it out.
        device: where to compute.
        json: machine-readable.
    """
    require_learning()
    from clothtrack.evaluation.label_quality import judge_labels
    from clothtrack.evaluation.label_review import read_review, review_path
    from clothtrack.evaluation.label_selection import pseudo_labels_of
    from clothtrack.reconstruction.data.pseudo_labels import label_recording, write_labels

    if not tracked:
        complain("no tracked trajectory given; name at least one NAME.zarr")
        return 2
    if not 0.0 <= flat_weight <= 1.0:
        raise InvalidConfigError(f"flat_weight is {flat_weight}; it must be in 0..1")
    rows = []
    for path in tracked:
        result = load_tracked(path)
        recording = recording_of(result, recordings, path)
        rejected = read_review(review_path(path), result).rejected
        judged = judge_labels(result, recording, device=device)
        chosen = pseudo_labels_of(
            result, judged, rejected, weighted=weighted, flat_weight=flat_weight
        )
        if result.mesh.canonical is None:
            raise InvalidResultError(
                f"{path}: its first mesh has no canonical coordinates; track the recording again "
                "from a template that has them"
            )
        labelled = label_recording(
            recording,
            result.mesh,
            chosen,
            kind=_kind(garment, recording.cloth.kind, path),
            provenance={
                "tracked": dict(result.provenance),
                "weighted": weighted,
                "rejected_actions": sorted(rejected),
            },
        )
        file = output / f"{result.name}.labels.npz"
        write_labels(labelled, file)
        weights = [one.weight for one in chosen]
        row = {"labels": str(file), "frames": labelled.frames, "weights": weights}
        rows.append({**row, "rejected": len(rejected)})
        if not json:
            text = " ".join(f"{weight:.2f}" for weight in weights)
            left_out = f"; {len(rejected)} rejected in review left out" if rejected else ""
            say(f"{file}   {len(weights)} labels, weights {text}{left_out}")
    if json:
        say(json_module.dumps(rows, indent=2))
    return 0


def pretrain(
    states: Positional[tuple[Path, ...]],
    *,
    output: Path,
    network: Literal["small", "reference"] = "small",
    start: Path | None = None,
    settings: Settings = (),
    device: Device = "cpu",
    seed: Seed = 0,
    json: AsJson = False,
) -> int:
    """Train the network on simulated states (`simulate --states`), from nothing or further.

    The same command goes on where an interrupted one stopped, to the same bits. For several GPUs:
    torchrun --nproc-per-node N --module clothtrack.cli pretrain ... --device cuda

    Args:
        states: folders of states, all of one kind of garment.
        output: folder for progress, scalars and model.safetensors.
        network: its sizes: small for two processor cores, reference as published.
        start: model.safetensors of the same garment and sizes to begin with.
        settings: changes, such as canonicalisation.epochs=20 or completion.batch_size=8.
        device: where to compute.
        seed: of weights, order, cameras and noise.
        json: machine-readable.
    """
    require_learning()
    from clothtrack.reconstruction.data.state_store import open_states
    from clothtrack.reconstruction.networks.network_config import preset
    from clothtrack.reconstruction.training.processes import joined
    from clothtrack.reconstruction.two_stages import pretrain as learn

    if not states:
        complain("no states given; make some with: clothtrack simulate OUT --states N")
        return 2
    name = "pretrain" if network == "small" else "pretrain_reference"
    config = _learning_config(name, settings, seed=seed)
    sets = [open_states(folder) for folder in states]
    with joined(device) as processes:
        shown = progress if processes.writes else None
        outcome = learn(
            sets,
            preset(network),
            config,
            output,
            start=start,
            processes=processes,
            progress=shown,
        )
    return _told(outcome, json=json) if processes.writes else 0


def finetune(
    weights: Positional[Path],
    labels: Positional[tuple[Path, ...]],
    *,
    output: Path,
    training: Literal["finetune", "finetune_short", "paper"] = "finetune",
    old: Path | None = None,
    old_share: float = 0.25,
    settings: Settings = (),
    device: Device = "cpu",
    seed: Seed = 0,
    json: AsJson = False,
) -> int:
    """Train a network further on pseudo-labels, held-out trajectories deciding when to stop.

    Args:
        weights: model.safetensors to begin with.
        labels: NAME.labels.npz files that `label` wrote, or folders of them.
        output: folder for progress, scalars and model.safetensors.
        training: until nothing improves, briefly at a higher rate, or the paper's 1,000 and 2,000
            epochs.
        old: folder of simulated states to mix in, against forgetting.
        old_share: how often an example is one of these, if they are given.
        settings: changes, such as canonicalisation.high_rate=1e-4.
        device: where to compute.
        seed: of order and augmentation.
        json: machine-readable.
    """
    require_learning()
    from clothtrack.reconstruction.data.pseudo_labels import read_labels
    from clothtrack.reconstruction.data.state_store import open_states
    from clothtrack.reconstruction.training.processes import joined
    from clothtrack.reconstruction.two_stages import finetune as learn

    files = [
        file
        for path in labels
        for file in (sorted(path.glob("*.labels.npz")) if path.is_dir() else [path])
    ]
    if not files:
        complain("no labels given; make some with: clothtrack label TRACKED... --output FOLDER")
        return 2
    config = _learning_config(training, settings, seed=seed)
    if old is not None:
        config = replace(
            config,
            canonicalisation=replace(config.canonicalisation, old_share=old_share),
            completion=replace(config.completion, old_share=old_share),
        )
    old_states = [] if old is None else [open_states(old)]
    labelled = [read_labels(file) for file in files]
    with joined(device) as processes:
        shown = progress if processes.writes else None
        outcome = learn(
            weights,
            labelled,
            config,
            output,
            old=old_states,
            processes=processes,
            progress=shown,
        )
    return _told(outcome, json=json) if processes.writes else 0


def reconstruct(
    depth: Positional[Path],
    *,
    output: Path = Path("out/mesh.obj"),
    garment: Literal["as recorded", "towel", "tshirt"] = "as recorded",
    weights: Path | None = None,
    method: Literal["template", "implicit"] = "template",
    refined: bool = True,
    frame: int | None = None,
    mask: Path | None = None,
    depth_unit: float | None = None,
    focal: float | None = None,
    table_distance: float | None = None,
    device: Device = "cpu",
    json: AsJson = False,
) -> int:
    """Reconstruct the whole cloth, hidden layers included, from one depth picture.

    Args:
        depth: a 16-bit depth PNG of a camera that looks straight down, or a recording.
        output: mesh file to write: .obj, .ply or .stl [m]; table at z = 0 for a PNG.
        garment: what it is; must be said for a PNG.
        weights: model.safetensors; the ones that come with clothtrack by default.
        method: the garment's own mesh laid into the picture, or the surface of the predicted
            winding number, which may find none.
        refined: fine-tune the mesh to the picture.
        frame: of a recording; the first by default.
        mask: picture of where the cloth is, for a PNG; else what stands out of the table.
        depth_unit: metres per unit of a PNG; 0.001 if not given.
        focal: focal length of a PNG's camera [pixels]; 0.94 of its width if not given.
        table_distance: from a PNG's camera to the table [m]; the most frequent depth by default.
        device: where to compute.
        json: machine-readable.
    """
    require_learning()
    from clothtrack.reconstruction import depth_input
    from clothtrack.reconstruction.from_picture import LOOSE_FIT_M, figures_of, network_mesh
    from clothtrack.reconstruction.load_model import load_model
    from clothtrack.reconstruction.refinement import RefinementConfig
    from clothtrack.reconstruction.training.processes import require_torch_device
    from clothtrack.recordings.mesh_file import require_mesh_format, write_mesh

    require_torch_device(device)
    require_mesh_format(output)
    of_picture = {
        "mask": mask, "depth_unit_m": depth_unit,
        "focal": focal, "table_distance_m": table_distance,
    }  # fmt: skip
    text = {name: value for name, value in of_picture.items() if value is not None}
    if depth.is_dir():
        _refuse(text, f"{depth} is a recording, which says itself")
        given = depth_input.from_recording(depth, frame or 0)
    else:
        _refuse({} if frame is None else {"frame": frame}, f"{depth} is not a recording")
        given = depth_input.from_picture(depth, **text)
    kind = _kind(garment, given.kind, depth)
    model = load_model(kind, weights, device=device)
    refinement = RefinementConfig() if refined else None
    made = network_mesh(model, given, kind, method=method, refinement=refinement)
    if made.mesh is None:
        complain(f"{depth}: no mesh ({made.reconstruction.status}); try --method template")
        return 1
    write_mesh(made.mesh, output)
    report = {"mesh": str(output), **figures_of(made, made.mesh, given)}
    apart_mm = 1e3 * report["cloud_to_mesh_m"]
    summary = "{mesh}   {vertices} vertices, confidence {confidence:.2f}, ".format(**report)
    summary += f"{apart_mm:.1f} mm from the cloud"
    if made.scale != 1.0:
        summary += f", seen as if {made.scale:g} times as large"
    say_result(summary, report, json=json)
    if apart_mm > 1e3 * LOOSE_FIT_M:
        complain(
            f"{depth}: the mesh is {apart_mm:.0f} mm from what was measured (more than "
            f"{1e3 * LOOSE_FIT_M:.0f}): do not trust it. The network knows a {kind} on a table, of "
            "the sizes in its model card; is the garment, its mask or the depth's unit another?"
        )
    return 0


def require_learning() -> None:
    """Check that the extra [learn] is installed.

    Raises:
        InvalidConfigError: with the command that installs it.
    """
    missing = missing_modules(EXTRA)
    if missing:
        raise InvalidConfigError(
            f"learning needs {', '.join(missing)}, which tracking does not; install with: "
            f"{install_command('learn')}"
        )


def _kind(told: str, recorded: str | None, source: Path) -> str:
    """The garment as the command line tells it, or else the recording."""
    kind = recorded if told == "as recorded" else told
    if kind not in ("towel", "tshirt"):
        raise InvalidConfigError(
            f"{source}: what garment it shows is {kind or 'not said'}; add --garment towel or "
            "--garment tshirt"
        )
    return kind


def _refuse(options: Mapping[str, object], why: str) -> None:
    """Refuse options that would mean nothing here, rather than leave them out silently."""
    if options:
        names = " and ".join(f"--{name.removesuffix('_m').replace('_', '-')}" for name in options)
        raise InvalidConfigError(f"{names}: {why}; leave it out")


def _learning_config(name: str, settings: Sequence[str], *, seed: int) -> "LearningConfig":
    from clothtrack.files.settings import with_settings
    from clothtrack.reconstruction.two_stages import LearningConfig

    return with_settings(LearningConfig.preset(name, seed=seed), settings)


def _told(outcome: "LearningOutcome", *, json: bool) -> int:
    """Say how it went; the exit code."""
    end_progress()
    lines = [
        f"{name}  {one.status} after {one.steps} steps; best held-out error "
        f"{one.best_score:.1f} mm after {one.best_step}"
        for name, one in outcome.stages.items()
    ]
    if outcome.model is not None:
        lines.append(str(outcome.model))
    say_result("\n".join(lines), asdict(outcome), json=json)
    if outcome.model is None:
        complain("interrupted; the same command goes on from there")
        return TERMINATED
    return 0
