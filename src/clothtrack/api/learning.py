"""Learn from runs, and reconstruct from one picture. All of it needs the extra [learn]."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

from tyro.conf import arg

from clothtrack.api.options import (
    DepthUnit,
    Garment,
    Settings,
    TableDistance,
    configured_by,
    require_file,
    require_learning,
)
from clothtrack.errors import InvalidConfigError, InvalidResultError

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import Float

    from clothtrack.api.reconstructed_mesh import ReconstructedMesh
    from clothtrack.api.run import Run
    from clothtrack.files.progress import Progress
    from clothtrack.geometry.mesh import ClothMesh
    from clothtrack.reconstruction.depth_input import DepthInput
    from clothtrack.reconstruction.learning_outcome import LearningOutcome

_SIDES_M = (0.05, 5.0)
"""Sides of a garment that the network is queried with [m]; larger ones are in other units."""

TERMINATED = 143
"""Exit code of a training that was interrupted, as shells number SIGTERM."""


@dataclass(frozen=True)
class Training:
    """The outcome of a training.

    Attributes:
        outcome: outcome of each stage, and the weights.
    """

    outcome: "LearningOutcome"

    @property
    def doubts(self) -> tuple[str, ...]:
        """What to do after an interrupt."""
        if self.outcome.model is not None:
            return ()
        return ("interrupted; the same command goes on from there",)

    @property
    def exit_code(self) -> int:
        """143 after an interrupt."""
        return TERMINATED if self.doubts else 0

    def text(self) -> str:
        """Return a line per stage, and the path of the weights."""
        lines = [
            f"{name}  {stage.status} after {stage.steps} steps; best held-out error "
            f"{stage.best_score:.4g} {stage.unit} after {stage.best_step}"
            for name, stage in self.outcome.stages.items()
        ]
        model = self.outcome.model
        return "\n".join(lines if model is None else [*lines, str(model)])

    def as_dict(self) -> dict[str, Any]:
        """Return the same as JSON-compatible values."""
        return asdict(self.outcome)


def label(
    run: "Run | Path | str",
    output: Path | str,
    *,
    garment: Garment | None = None,
    device: str = "cpu",
    provenance: Mapping[str, Any] | None = None,
) -> Path:
    """Write the pseudo-labels of a run, for `clothtrack finetune` (needs the extra [learn]).

    The labels are the first frame and the end of every action, all treated alike. Labels that were
    rejected (`view`) are left out, and so are those without an observation to judge them by.

    Args:
        run: what `track` or `load` returned, or NAME.zarr.
        output: file to write, NAME.labels.npz.
        garment: kind of garment, if the recording does not give it or gives another.
        device: "cpu" or "cuda:0", for visibility.
        provenance: stored with the labels, beside that of the run.

    Raises:
        InvalidResultError: the mesh has no canonical coordinates.
        InvalidConfigError: the kind of garment is not known.
    """
    require_learning()
    from clothtrack.api.look import review_of
    from clothtrack.api.run import load, recording_of
    from clothtrack.evaluation.label_quality import judge_labels
    from clothtrack.evaluation.label_review import pseudo_labels_of
    from clothtrack.geometry.devices import quiet_warp
    from clothtrack.reconstruction.data.pseudo_labels import label_recording, write_labels

    quiet_warp()
    run = load(run) if isinstance(run, Path | str) else run
    source, rejected = recording_of(run), review_of(run).rejected
    judged = judge_labels(run, source, device=device)
    labels = pseudo_labels_of(run, judged, rejected)
    if run.mesh.canonical is None:
        raise InvalidResultError(
            f"{run.path or run.name}: its first mesh has no canonical coordinates; track the "
            "recording again from a template that has them"
        )
    kind = _kind(garment or source.cloth.kind, run.name)
    stored = {
        **(provenance or {}),
        "tracked": dict(run.provenance),
        "rejected_actions": sorted(rejected),
    }
    write_labels(
        label_recording(source, run.mesh, labels, kind=kind, provenance=stored), Path(output)
    )
    return Path(output)


def _pretraining_config(
    network: str = "tokens", settings: Sequence[str] = (), *, seed: int = 0
) -> Any:
    """Return the configuration of `pretrain` with some settings changed.

    Raises:
        InvalidConfigError: an unknown network, setting or value.
    """
    require_learning()
    from clothtrack.files.settings import with_settings
    from clothtrack.reconstruction.model_loading import design_named

    return with_settings(
        design_named(network).configuration("pretrain", network=network, seed=seed), settings
    )


@configured_by(_pretraining_config)
def pretrain(
    states: Sequence[Path | str],
    *,
    output: Path | str,
    network: str = "tokens",
    start: Path | str | None = None,
    hours: float | None = None,
    settings: Settings = (),
    device: str = "cpu",
    seed: int = 0,
    progress: "Progress | None" = None,
) -> Training | None:
    """Train the network on simulated states (`simulate --states`), from scratch or from weights.

    The same command resumes an interrupted training, bit for bit. The token network trains for as
    long as it is given time; folders of states may be added when it resumes. Its learning rate
    falls once, at the end: --set tokens.fall_examples=100000. Several processes or GPUs:
    torchrun --nproc-per-node N --module -- clothtrack.cli pretrain ... --device cuda

    Args:
        states: folders of states; of one kind of garment for a published network.
        output: folder for progress, scalars and model.safetensors.
        network: tokens, for every garment; or a published network (the extra published), in the
            size for two processor cores (small) or as published (reference).
        start: model.safetensors to begin with; a token network may have fewer layers and
            hypotheses, a published one is of the same garment and sizes.
        hours: wall time [hours] after which the training of the token network pauses.
        settings: changes, such as tokens.high_rate=5e-4 or network.width=192.
        device: where to compute: cpu, or cuda:0.
        seed: random seed of weights, order, cameras and noise.
        progress: called after every step.

    Raises:
        InvalidConfigError: a setting is wrong, or contradicts the network.
        InvalidResultError: states or weights cannot be read.
    """
    require_learning()
    from clothtrack.reconstruction.data.state_store import open_states
    from clothtrack.reconstruction.model_loading import design_named

    output, start = Path(output), start and Path(start)
    config = _pretraining_config(network, settings, seed=seed)
    sets = [open_states(Path(folder)) for folder in states]
    learn = partial(design_named(network).pretrain, sets, config, output, start=start, hours=hours)
    return _learn(learn, device, progress)


def finetune(
    weights: Path | str,
    labels: Sequence[Path | str],
    *,
    output: Path | str,
    training: Literal["finetune_short", "finetune", "paper"] = "finetune_short",
    settings: Settings = (),
    device: str = "cpu",
    seed: int = 0,
    progress: "Progress | None" = None,
) -> Training | None:
    """Fine-tune a network on pseudo-labels; held-out trajectories decide when to stop.

    Args:
        weights: model.safetensors to begin with.
        labels: NAME.labels.npz files that `label` wrote, or folders of them.
        output: folder for progress, scalars and model.safetensors.
        training: briefly at a high rate, slowly until nothing improves, or the paper's 1,000 and
            2,000 epochs.
        settings: changes, such as tokens.high_rate=1e-4.
        device: where to compute: cpu, or cuda:0.
        seed: random seed of order and augmentation.
        progress: called after every step.

    Raises:
        InvalidConfigError: a setting is wrong, or there are no labels.
        InvalidResultError: weights or labels cannot be read.
    """
    require_learning()
    from clothtrack.files.settings import with_settings
    from clothtrack.reconstruction.data.pseudo_labels import read_labels
    from clothtrack.reconstruction.model_loading import design_of
    from clothtrack.reconstruction.training.checkpoint import load_weights

    files = [
        file
        for path in map(Path, labels)
        for file in (sorted(path.glob("*.labels.npz")) if path.is_dir() else [path])
    ]
    if not files:
        named = ", ".join(map(str, labels)) or "no folder given"
        raise InvalidConfigError(
            f"{named}: no *.labels.npz; make some with: clothtrack label TRACKED... --output FOLDER"
        )
    start = load_weights(Path(weights))
    design = design_of(start)
    config = with_settings(design.configuration(training, seed=seed), settings)
    labeled = [read_labels(file) for file in files]
    learn = partial(design.finetune, start, labeled, config, Path(output))
    return _learn(learn, device, progress)


def _learn(
    learn: "Callable[..., LearningOutcome]", device: str, progress: "Progress | None"
) -> Training | None:
    """Train with the processes of this run; one returns the outcome, the others None."""
    from clothtrack.reconstruction.training.processes import joined

    with joined(device) as processes:
        outcome = learn(processes=processes, progress=progress if processes.writes else None)
    return Training(outcome) if processes.writes else None


def reconstruct(
    picture: 'Path | str | Float[np.ndarray, "height width"]',
    garment: Garment | None = None,
    *,
    output: Path | str | None = None,
    size_m: Annotated[tuple[float, float] | None, arg(name="size", metavar="WIDTH LENGTH")] = None,
    template: "ClothMesh | Path | str | None" = None,
    weights: Path | str | None = None,
    refined: Annotated[bool, arg(help="leave the mesh unfitted, as the network makes it")] = True,
    frame: int | None = None,
    mask: Path | str | None = None,
    depth_unit_m: DepthUnit = None,
    focal: float | None = None,
    table_distance_m: TableDistance = None,
    force: bool = False,
    device: str = "cpu",
) -> "ReconstructedMesh":
    """Reconstruct the whole cloth, hidden layers included, from one depth picture.

    Args:
        picture: a 16-bit depth PNG of a camera that looks down on a table, or a recording; in
            Python also the depth [m] itself, 0 where nothing was measured.
        garment: kind of garment; required for a PNG unless a template gives it.
        output: mesh file to write: .obj, .ply, .stl or .glb [m], table at z = 0 for a PNG. The
            command line writes out/NAME.obj by default, Python nothing.
        size_m: width and length of the flat garment [m]; several are tried if it is not given. For
            trousers it also tells whether they are short.
        template: the flat garment itself, instead of a size.
        weights: model.safetensors; those shipped with clothtrack by default.
        refined: fit the mesh to the picture.
        frame: frame of a recording; the first by default.
        mask: mask picture of the cloth, for a PNG; by default, what stands out of the table.
        depth_unit_m: meters per unit of a PNG; 0.001 if not given.
        focal: focal length of a PNG's camera [pixels]; 0.94 of its width if not given.
        table_distance_m: distance from a PNG's camera, looking straight down, to the table [m]; if
            not given, the table's plane is fitted to the depth.
        force: replace an existing mesh file.
        device: where to compute: cpu, or cuda:0.

    Returns:
        The mesh in the world [m]; the table is at z = 0 for a picture. It is a `ClothMesh`.

    Raises:
        InvalidRecordingError: the picture cannot be read or shows no cloth.
        InvalidConfigError: the kind of garment is not known, an option does not apply to such a
            picture, there is no such device, or the file exists already.
        InvalidResultError: weights are missing, or no mesh was found.
    """
    require_learning()
    from clothtrack.recordings.mesh_file import require_mesh_format, write_mesh

    if output is not None:
        require_mesh_format(Path(output))
        if Path(output).exists() and not force:
            raise InvalidConfigError(
                f"{output}: is there already; give another --output, or replace it with --force"
            )
    mesh = _reconstructed(
        picture, garment, frame=frame, size_m=size_m, template=template, weights=weights,
        refined=refined, device=device,
        of_picture={
            "mask": mask and Path(mask), "depth_unit_m": depth_unit_m, "focal": focal,
            "table_distance_m": table_distance_m,
        },
    )  # fmt: skip
    if output is not None:
        write_mesh(mesh, Path(output), expected_error_m=mesh.network.spread_m)
        object.__setattr__(mesh, "path", Path(output))
    return mesh


def default_mesh(picture: Path, frame: int | None = None) -> Path:
    """Return where the command line writes the mesh of a picture or of a recording's frame."""
    name = picture.resolve().name if picture.is_dir() else picture.stem
    return Path("out") / (f"{name}.obj" if frame is None else f"{name}_{frame:06d}.obj")


def _reconstructed(
    picture: 'Path | str | Float[np.ndarray, "height width"]',
    garment: str | None,
    *,
    frame: int | None,
    size_m: tuple[float, float] | None,
    template: "ClothMesh | Path | str | None",
    weights: Path | str | None,
    refined: bool,
    device: str,
    of_picture: Mapping[str, Any],
) -> "ReconstructedMesh":
    from dataclasses import replace

    from clothtrack.api.reconstructed_mesh import ReconstructedMesh
    from clothtrack.geometry.devices import quiet_warp
    from clothtrack.reconstruction.model_loading import load_model
    from clothtrack.reconstruction.training.processes import require_torch_device
    from clothtrack.recordings.template_file import read_template

    quiet_warp()
    require_torch_device(device)
    if size_m is not None and not all(_SIDES_M[0] <= side <= _SIDES_M[1] for side in size_m):
        raise InvalidConfigError(
            f"the size is {size_m[0]:g} x {size_m[1]:g} m; give width and length in meters, "
            f"{_SIDES_M[0]:g} to {_SIDES_M[1]:g}"
        )
    named = str(picture) if isinstance(picture, Path | str) else "the depth array"
    shown = _depth_input(picture, named, frame, of_picture)
    if size_m is not None and template is not None:
        raise InvalidConfigError("a template has its size; give either a size or a template")
    flat = read_template(Path(template)) if isinstance(template, str | Path) else template
    kind = _kind(garment or shown.kind or _kind_of(flat), named)
    model = load_model(kind, weights and Path(weights), device=device)
    network = model.mesh(
        shown,
        kind,
        size_m=size_m or shown.size_m,
        template=flat,
        refined=refined,
        untangle=refined,
        device=device,
    )
    if network.mesh is None:
        raise InvalidResultError(f"{named}: no mesh ({network.reconstruction.status})")
    # A recording says its masks itself, and maybe the size.
    recorded = isinstance(picture, Path | str) and Path(picture).is_dir()
    known = {
        "size": size_m or shown.size_m, "template": template,
        "mask": recorded or of_picture["mask"],
    }  # fmt: skip
    given = frozenset(name for name, one in known.items() if one)
    return ReconstructedMesh.of(network, replace(shown, kind=kind), given)


def _depth_input(
    picture: 'Path | str | Float[np.ndarray, "height width"]',
    named: str,
    frame: int | None,
    of_picture: Mapping[str, Any],
) -> "DepthInput":
    """Return the depth, and what is known of its camera and its garment."""
    from clothtrack.reconstruction import depth_input

    options = {name: value for name, value in of_picture.items() if value is not None}
    if isinstance(picture, Path | str) and Path(picture).is_dir():
        _refuse(options, f"{named} is a recording, which says itself")
        return depth_input.from_recording(Path(picture), frame or 0)
    _refuse({} if frame is None else {"frame": frame}, f"{named} is not a recording")
    require_file(options.get("mask"), "mask")
    if isinstance(picture, Path | str):
        require_file(picture, "picture")
        return depth_input.from_picture(Path(picture), **options)
    return depth_input.from_depth(picture, named, **options)


def _kind_of(flat: "ClothMesh | None") -> Garment | None:
    """Return the kind of a template: T-shirt for two layers, towel for one."""
    import numpy as np

    if flat is None or flat.canonical is None:
        return None
    return "tshirt" if np.ptp(flat.canonical[:, 2]) > 0.0 else "towel"


def _kind(garment: str | None, source: str) -> Garment:
    for kind in get_args(Garment):
        if kind == garment:
            return kind
    kinds = get_args(Garment)
    raise InvalidConfigError(
        f"{source}: what garment it shows is {garment or 'not said'}; add --garment with one of "
        f"{', '.join(kinds)} (in Python garment={kinds[0]!r})"
    )


def _refuse(options: Mapping[str, object], why: str) -> None:
    """Refuse options that do not apply here instead of ignoring them."""
    if options:
        names = " and ".join(f"--{name.removesuffix('_m').replace('_', '-')}" for name in options)
        raise InvalidConfigError(f"{names}: {why}; leave it out")
