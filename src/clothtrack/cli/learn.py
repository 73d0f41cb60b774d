"""The verbs of learning: label, pretrain, finetune, reconstruct. They need the extra [learn]."""

import json as json_module
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional, arg

from clothtrack.cli.options import (
    AsJson,
    Device,
    Ray,
    Seed,
    Settings,
    ShowSettings,
    list_settings,
)
from clothtrack.cli.terminal import TERMINATED, complain, progress, say, say_result
from clothtrack.errors import InvalidConfigError
from clothtrack.front.learning_extra import require_learning

if TYPE_CHECKING:
    from clothtrack.reconstruction.learning_outcome import LearningOutcome

GarmentChoice = Literal["as recorded", "towel", "tshirt", "trousers"]


def label(
    tracked: Positional[tuple[Path, ...]],
    *,
    recordings: Path,
    output: Path,
    garment: GarmentChoice = "as recorded",
    weighted: Annotated[bool, arg(help="let labels of any quality count alike")] = True,
    flat_weight: float = 1.0,
    workers: int = 1,
    ray: Ray = "",
    device: Device = "cpu",
    json: AsJson = False,
) -> int:
    """Make pseudo-labels of tracked trajectories: the data set that `finetune` learns from.

    Labels that a person rejected (`clothtrack view`, NAME.review.json) are left out.

    Args:
        tracked: NAME.zarr folders that `track` wrote.
        recordings: the recording, or the folder in which recordings lie by name.
        output: folder that gets one NAME.labels.npz per trajectory; those that are there from the
            same trajectory, review and options are kept.
        garment: what it is, where the recording does not say or says otherwise.
        weighted: weigh each label by its quality.
        flat_weight: weight of the first frame, before any action; 0 leaves it out.
        workers: processes.
        ray: address of Ray, which is to do it.
        device: where to compute.
        json: machine-readable.
    """
    require_learning()
    from clothtrack.front.many import label_many
    from clothtrack.reconstruction.data.pseudo_labels import read_labels

    if not tracked:
        complain("no tracked trajectory given; name at least one NAME.zarr")
        return 2
    options = {
        "garment": None if garment == "as recorded" else garment,
        "weighted": weighted,
        "flat_weight": flat_weight,
        "device": device,
    }
    files = label_many(
        tracked, recordings, output, options, workers=workers, ray=ray, progress=progress
    )
    rows = []
    for file in files:
        labels = read_labels(file)
        weights = [picture.weight for picture in labels.pictures]
        rejected = len(labels.provenance["rejected_actions"])
        rows.append(
            {"labels": str(file), "frames": labels.frames, "weights": weights, "rejected": rejected}
        )
        if not json:
            text = " ".join(f"{weight:.2f}" for weight in weights)
            left_out = f"; {rejected} rejected in review left out" if rejected else ""
            say(f"{file}   {len(weights)} labels, weights {text}{left_out}")
    if json:
        say(json_module.dumps(rows, indent=2))
    return 0


def pretrain(
    states: Positional[tuple[Path, ...]],
    *,
    output: Path | None = None,
    network: str = "tokens",
    start: Path | None = None,
    hours: float | None = None,
    settings: Settings = (),
    show_settings: ShowSettings = False,
    device: Device = "cpu",
    seed: Seed = 0,
    json: AsJson = False,
) -> int:
    """Train the network on simulated states (`simulate --states`), from nothing or further.

    The same command goes on where an interrupted one stopped, to the same bits. The token network
    learns for as long as it is given time; folders of states may be added then. Its rate falls
    once, at the end: --set tokens.fall_examples=100000. Several processes or GPUs:
    torchrun --nproc-per-node N --module clothtrack.cli pretrain ... --device cuda

    Args:
        states: folders of states; of one kind of garment for a published network.
        output: folder for progress, scalars and model.safetensors.
        network: tokens, for every garment; or a published network (the extra published), in the
            size for two processor cores (small) or as published (reference).
        start: model.safetensors to begin with; a token network may have fewer layers and
            hypotheses, a published one is of the same garment and sizes.
        hours: of wall time after which the token network's training pauses.
        settings: changes, such as tokens.high_rate=5e-4 or network.width=192.
        show_settings: list them all with their values and do nothing else.
        device: where to compute.
        seed: of weights, order, cameras and noise.
        json: machine-readable.
    """
    require_learning()
    from clothtrack.files.settings import with_settings
    from clothtrack.reconstruction.data.state_store import open_states
    from clothtrack.reconstruction.model_loading import design_named

    design = design_named(network)
    config = with_settings(design.configuration("pretrain", network=network, seed=seed), settings)
    if show_settings:
        return list_settings(config)
    if output is None:
        complain("no place for the results; name a folder with --output")
        return 2
    if not states:
        complain("no states given; make some with: clothtrack simulate OUT --states N")
        return 2
    sets = [open_states(folder) for folder in states]
    learn = partial(design.pretrain, sets, config, output, start=start, hours=hours)
    return _learn(learn, device, json=json)


def finetune(
    weights: Positional[Path],
    labels: Positional[tuple[Path, ...]],
    *,
    output: Path,
    training: Literal["finetune_short", "finetune", "paper"] = "finetune_short",
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
        training: briefly at a high rate, slowly until nothing improves, or the paper's 1,000 and
            2,000 epochs.
        old: folder of simulated states to mix in, against forgetting.
        old_share: how often an example is one of these, if they are given.
        settings: changes, such as tokens.high_rate=1e-4.
        device: where to compute.
        seed: of order and augmentation.
        json: machine-readable.
    """
    require_learning()
    from clothtrack.files.settings import with_settings
    from clothtrack.reconstruction.data.pseudo_labels import read_labels
    from clothtrack.reconstruction.data.state_store import open_states
    from clothtrack.reconstruction.model_loading import design_of
    from clothtrack.reconstruction.training.checkpoint import load_weights

    files = [
        file
        for path in labels
        for file in (sorted(path.glob("*.labels.npz")) if path.is_dir() else [path])
    ]
    if not files:
        complain("no labels given; make some with: clothtrack label TRACKED... --output FOLDER")
        return 2
    start = load_weights(weights)
    design = design_of(start)
    config = with_settings(design.configuration(training, seed=seed), settings)
    if old is not None:
        config = config.mixing(old_share)
    old_states = [] if old is None else [open_states(old)]
    labelled = [read_labels(file) for file in files]
    learn = partial(design.finetune, start, labelled, config, output, old=old_states)
    return _learn(learn, device, json=json)


def reconstruct(
    depth: Positional[Path],
    *,
    output: Path | None = None,
    garment: GarmentChoice = "as recorded",
    size: Annotated[tuple[float, float] | None, arg(metavar="WIDTH LENGTH")] = None,
    template: Path | None = None,
    weights: Path | None = None,
    method: Literal["template", "implicit"] = "template",
    refined: Annotated[bool, arg(help="leave the mesh unfitted, as the network makes it")] = True,
    frame: int | None = None,
    mask: Path | None = None,
    depth_unit: float | None = None,
    focal: float | None = None,
    principal_point: Annotated[tuple[float, float] | None, arg(metavar="COLUMN ROW")] = None,
    table_distance: float | None = None,
    force: bool = False,
    device: Device = "cpu",
    json: AsJson = False,
) -> int:
    """Reconstruct the whole cloth, hidden layers included, from one depth picture.

    Args:
        depth: a 16-bit depth PNG of a camera that looks down on a table, or a recording.
        output: mesh file to write: .obj, .ply or .stl [m], table at z = 0 for a PNG; by default
            out/NAME.obj, after the picture or recording, with its frame if one is named.
        garment: what it is; must be said for a PNG, unless a template says so.
        size: width and length of the flat garment [m]; several are tried where nobody says. Of
            trousers it also says whether they are short.
        template: the flat garment itself, instead of a size.
        weights: model.safetensors; the ones that come with clothtrack by default.
        method: the garment's own mesh laid into the picture, or the surface of the predicted
            winding number, which may find none.
        refined: fine-tune the mesh to the picture.
        frame: of a recording; the first by default.
        mask: picture of where the cloth is, for a PNG; else what stands out of the table.
        depth_unit: metres per unit of a PNG; 0.001 if not given.
        focal: focal length of a PNG's camera [pixels]; 0.94 of its width if not given.
        principal_point: its column and row [pixels]; the middle of the PNG if not given.
        table_distance: from a PNG's camera, looking straight down, to the table [m]; if not given,
            the table's plane is fitted to the depth.
        force: replace the mesh file that is there.
        device: where to compute.
        json: machine-readable, with the garment's size, cut and turn, and the runners-up.
    """
    require_learning()
    from clothtrack.front.learning import reconstructed
    from clothtrack.reconstruction.from_picture import figures_of
    from clothtrack.recordings.mesh_file import require_mesh_format, write_mesh

    output = output or _mesh_of(depth, frame)
    require_mesh_format(output)
    if output.exists() and not force:
        raise InvalidConfigError(
            f"{output}: is there already; give another --output, or replace it with --force"
        )
    mesh, network, picture = reconstructed(
        depth, None if garment == "as recorded" else garment, frame=frame, size_m=size,
        template=template, weights=weights, method=method, refined=refined, device=device,
        mask=mask, depth_unit_m=depth_unit,
        focal=focal, principal_point=principal_point, table_distance_m=table_distance,
    )  # fmt: skip
    write_mesh(mesh, output, expected_error_m=network.spread_m)
    report = {"mesh": str(output), **figures_of(network, mesh, picture)}
    summary = "{mesh}   {vertices} vertices, ".format(**report)
    summary += f"{1e3 * report['cloud_to_mesh_m']:.1f} mm from the cloud"
    if report["expected_error_m"] is not None:
        summary += f", expected error {1e3 * report['expected_error_m']:.0f} mm"
    if network.choices and size is None and template is None and picture.size_m is None:
        width, length = network.choices[0].size_m
        # The name of a towel is that of the rectangle that the search began with.
        cut = "" if picture.kind == "towel" else f"{network.choices[0].cut} of "
        summary += f", taken for {cut}{width:.2f} x {length:.2f} m"
    if network.scale != 1.0:
        summary += f", seen as if {network.scale:g} times as large"
    say_result(summary, report, json=json)
    if not report["trusted"]:
        complain(
            f"{depth}: do not trust this mesh: {report['why_not']}. Is the garment, its size, its "
            "mask or the depth's unit another?"
        )
    return 0


def _mesh_of(picture: Path, frame: int | None) -> Path:
    """Where the mesh of a picture, or of a recording's frame, goes when nobody says."""
    name = picture.resolve().name if picture.is_dir() else picture.stem
    return Path("out") / (f"{name}.obj" if frame is None else f"{name}_{frame:06d}.obj")


def _learn(learn: "Callable[..., LearningOutcome]", device: str, *, json: bool) -> int:
    """Learn with the processes that there are, say how it went, and give the exit code."""
    from clothtrack.reconstruction.training.processes import joined

    with joined(device) as processes:
        shown = progress if processes.writes else None
        outcome = learn(processes=processes, progress=shown)
    if not processes.writes:
        return 0
    lines = [
        f"{name}  {stage.status} after {stage.steps} steps; best held-out error "
        f"{stage.best_score:.4g} {stage.unit} after {stage.best_step}"
        for name, stage in outcome.stages.items()
    ]
    if outcome.model is not None:
        lines.append(str(outcome.model))
    say_result("\n".join(lines), asdict(outcome), json=json)
    if outcome.model is None:
        complain("interrupted; the same command goes on from there")
        return TERMINATED
    return 0
