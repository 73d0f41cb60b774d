"""Learn from runs, and reconstruct from one picture."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from jaxtyping import Float

from clothtrack.errors import InvalidConfigError, InvalidResultError
from clothtrack.evaluation.label_quality import judge_labels
from clothtrack.evaluation.label_selection import pseudo_labels_of
from clothtrack.front.learning_extra import require_learning
from clothtrack.front.look import review_of
from clothtrack.front.run import Run, recording_of
from clothtrack.garments.garment_meshes import ClothKind
from clothtrack.geometry.devices import quiet_warp
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.recordings.template_file import read_template

if TYPE_CHECKING:
    from clothtrack.reconstruction.depth_input import DepthInput
    from clothtrack.reconstruction.from_picture import NetworkMesh


def label(
    run: Run,
    output: Path | str,
    *,
    garment: ClothKind | None = None,
    weighted: bool = True,
    flat_weight: float = 1.0,
    device: str = "cpu",
    provenance: Mapping[str, Any] | None = None,
) -> Path:
    """Write the pseudo-labels of a run, for `clothtrack finetune` (needs the extra [learn]).

    Labels that were rejected (`view`) are left out.

    Args:
        run: what `track` or `load` returned.
        output: file to write, NAME.labels.npz.
        garment: what it is, where the recording does not say or says otherwise.
        weighted: weigh each label by its quality; otherwise all count alike.
        flat_weight: weight of the first frame, before any action, 0 to 1; 0 leaves it out.
        device: "cpu" or "cuda:0", for visibility.
        provenance: stored with the labels, beside that of the run.

    Raises:
        InvalidResultError: the mesh has no canonical coordinates, or no label is left.
        InvalidConfigError: what garment it is is not known, or the weight is not in 0..1.
    """
    require_learning()
    from clothtrack.reconstruction.data.pseudo_labels import label_recording, write_labels

    if not 0.0 <= flat_weight <= 1.0:
        raise InvalidConfigError(f"flat_weight is {flat_weight}; it must be in 0..1")
    quiet_warp()
    source, rejected = recording_of(run), review_of(run).rejected
    judged = judge_labels(run, source, device=device)
    labels = pseudo_labels_of(run, judged, rejected, weighted=weighted, flat_weight=flat_weight)
    if run.mesh.canonical is None:
        raise InvalidResultError(
            f"{run.path or run.name}: its first mesh has no canonical coordinates; track the "
            "recording again from a template that has them"
        )
    kind = _kind(garment or source.cloth.kind, run.name)
    stored = {
        **(provenance or {}),
        "tracked": dict(run.provenance),
        "weighted": weighted,
        "rejected_actions": sorted(rejected),
    }
    write_labels(
        label_recording(source, run.mesh, labels, kind=kind, provenance=stored), Path(output)
    )
    return Path(output)


def reconstruct(
    picture: Path | str | Float[np.ndarray, "height width"],
    garment: ClothKind | None = None,
    *,
    frame: int | None = None,
    size_m: tuple[float, float] | None = None,
    template: ClothMesh | Path | str | None = None,
    weights: Path | str | None = None,
    method: Literal["template", "implicit"] = "template",
    refined: bool = True,
    device: str = "cpu",
    **of_picture: Any,
) -> ClothMesh:
    """The whole cloth, hidden layers included, from one depth picture (needs the extra [learn]).

    Args:
        picture: depth [m] of a camera that looks down on a table, 0 where nothing was
            measured; a 16-bit depth PNG of one; or the folder of a recording.
        garment: what it is; a recording may say so itself.
        frame: of a recording; the first by default.
        size_m: width and length of the flat garment [m]; a recording may say so itself. Several
            are tried where nobody does.
        template: the flat garment itself, or its file (`clothtrack garment`), instead of a size.
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
        InvalidConfigError: what garment it is is not known, an option means nothing for such a
            picture, or there is no such device.
        InvalidResultError: weights are missing, or no mesh was found.
    """
    return reconstructed(
        picture, garment, frame=frame, size_m=size_m, template=template, weights=weights,
        method=method, refined=refined, device=device, **of_picture,
    )[0]  # fmt: skip


def reconstructed(
    picture: Path | str | Float[np.ndarray, "height width"],
    garment: ClothKind | None,
    *,
    frame: int | None,
    size_m: tuple[float, float] | None,
    template: ClothMesh | Path | str | None,
    weights: Path | str | None,
    method: Literal["template", "implicit"],
    refined: bool,
    device: str,
    **of_picture: Any,
) -> "tuple[ClothMesh, NetworkMesh, DepthInput]":
    """The mesh of `reconstruct`, how it came about, and the picture with its garment."""
    require_learning()
    from clothtrack.reconstruction import depth_input
    from clothtrack.reconstruction.model_loading import load_model
    from clothtrack.reconstruction.training.processes import require_torch_device

    quiet_warp()
    require_torch_device(device)
    options = {name: value for name, value in of_picture.items() if value is not None}
    named = "the depth array" if isinstance(picture, np.ndarray) else str(picture)
    if not isinstance(picture, np.ndarray) and Path(picture).is_dir():
        _refuse(options, f"{named} is a recording, which says itself")
        shown = depth_input.from_recording(Path(picture), frame or 0)
    else:
        _refuse({} if frame is None else {"frame": frame}, f"{named} is not a recording")
        if isinstance(picture, np.ndarray):
            shown = depth_input.from_depth(picture, named, **options)
        else:
            shown = depth_input.from_picture(Path(picture), **options)
    if size_m is not None and not all(0.0 < side < float("inf") for side in size_m):
        raise InvalidConfigError(
            f"the size is {size_m[0]:g} x {size_m[1]:g} m; give width and length in metres, above 0"
        )
    if size_m is not None and template is not None:
        raise InvalidConfigError("a template has its size; give either a size or a template")
    flat = read_template(Path(template)) if isinstance(template, str | Path) else template
    kind = _kind(garment or shown.kind or _kind_of(flat), named)
    model = load_model(kind, weights and Path(weights), device=device)
    network = model.mesh(
        shown,
        kind,
        method=method,
        size_m=size_m or shown.size_m,
        template=flat,
        refined=refined,
        untangle=refined,
        device=device,
    )
    if network.mesh is None:
        raise InvalidResultError(
            f"{named}: no mesh ({network.reconstruction.status}); try --method template"
        )
    return network.mesh, network, replace(shown, kind=kind)


def _kind_of(flat: ClothMesh | None) -> ClothKind | None:
    """What a template is: of two layers, or of one."""
    if flat is None or flat.canonical is None:
        return None
    return "tshirt" if np.ptp(flat.canonical[:, 2]) > 0.0 else "towel"


def _kind(garment: str | None, source: str) -> ClothKind:
    for kind in get_args(ClothKind):
        if kind == garment:
            return kind
    kinds = get_args(ClothKind)
    raise InvalidConfigError(
        f"{source}: what garment it shows is {garment or 'not said'}; add --garment with one of "
        f"{', '.join(kinds)} (in Python garment={kinds[0]!r})"
    )


def _refuse(options: Mapping[str, object], why: str) -> None:
    """Refuse options that would mean nothing here, rather than leave them out silently."""
    if options:
        names = " and ".join(f"--{name.removesuffix('_m').replace('_', '-')}" for name in options)
        raise InvalidConfigError(f"{names}: {why}; leave it out")
