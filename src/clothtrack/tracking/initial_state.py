"""The initial state of tracking: the recording's template, the flat fit, or the network's mesh.

It depends on the recording alone, never on ground truth. PyTorch is imported only when the network
is used.
"""

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from clothtrack.errors import InvalidConfigError, InvalidRecordingError
from clothtrack.files.atomic_write import content_hash
from clothtrack.files.extras import install_command
from clothtrack.geometry.mesh import ClothMesh
from clothtrack.reconstruction.availability import missing_modules, shipped_weights
from clothtrack.reconstruction.first_mesh import front_up, laid_flat
from clothtrack.reconstruction.flat_fit import FITTED_KINDS, flat_fit
from clothtrack.recordings.point_cloud import Observation
from clothtrack.recordings.recording import Recording
from clothtrack.recordings.segmentation import Segmenter
from clothtrack.recordings.template_file import read_template
from clothtrack.simulation.parameters import RESTING_HEIGHT_M
from clothtrack.tracking.configuration import InitialStateConfig

logger = logging.getLogger(__name__)

FLAT_MISFIT_M = 0.01
"""If the outlines differ by more than this (root mean square) [m], the cloth is not flat or is of
another kind. Then the network is used, or a warning is given."""

LEVEL_DEG = 10.0
"""Largest table tilt [deg] for which the network is used, because it looks along the world's z."""


@dataclass(frozen=True, eq=False)
class InitialState:
    """The cloth at the first frame.

    Attributes:
        mesh: the flat cloth at rest, in the world [m]: its edges are the rest lengths.
        positions: its vertices at the first frame [m]; None: as in `mesh`.
    """

    mesh: ClothMesh
    positions: Float[np.ndarray, "vertices 3"] | None
    origin: Mapping[str, object]


def find_initial_state(
    recording: Recording,
    observation: Observation,
    config: InitialStateConfig,
    *,
    segmenter: Segmenter | None = None,
    device: str = "cpu",
) -> InitialState:
    """Return the cloth that tracking starts from."""
    template = recording.cloth.template
    if config.template and config.source in ("auto", "flat"):
        return _from_file(recording, observation, config)
    if config.source == "template" and template is None:
        raise InvalidRecordingError(
            f"{recording.folder}: initial_state.source is template, and the recording has none; "
            "give cloth.template, or initial_state.source=auto"
        )
    if template is not None and config.source in ("auto", "template"):
        if config.weights:
            logger.warning(
                "%s: the first mesh is the recording's template, and the network of %s is not "
                "asked; initial_state.source=network would ask it",
                recording.folder, config.weights,
            )  # fmt: skip
        return InitialState(template, None, {"source": "template"})
    _refuse_held_vertices(recording, f"initial_state.source is {config.source}")
    weights = None if config.source == "flat" else _weights(recording, config)
    if weights is None or not (config.source == "network" or config.weights):
        # The outline of a flat cloth determines all of it, so no network is needed.
        flat = flat_fit(recording, observation, vertex_count=config.vertex_count)
        lies_flat = flat.misfit_m <= FLAT_MISFIT_M
        if lies_flat or weights is None:
            if not lies_flat:
                _doubt(recording, flat.misfit_m)
            return InitialState(flat.mesh, None, {"source": "flat"})
        logger.info(
            "%s: the first cloud is not that of a flat %s, outlines differ by %.1f mm: the first "
            "mesh is the network's",
            recording.folder, recording.cloth.kind, 1e3 * flat.misfit_m,
        )  # fmt: skip
    return _from_network(
        recording, observation, config, weights, segmenter=segmenter, device=device
    )


def _from_file(
    recording: Recording, observation: Observation, config: InitialStateConfig
) -> InitialState:
    """Return this garment's own mesh, fitted flat to the first cloud."""
    path = Path(config.template)
    _refuse_held_vertices(recording, f"the template is {path}")
    fit = flat_fit(recording, observation, template=config.template)
    if fit.misfit_m > FLAT_MISFIT_M:
        logger.warning(
            "%s: the template %s does not match the first cloud, outlines differ by %.1f mm; "
            "flatten the cloth, its front up, or make its template again: clothtrack garment",
            recording.folder, path, 1e3 * fit.misfit_m,
        )  # fmt: skip
    origin = {"source": "file", "template": path.name, "template_sha256": content_hash(path)}
    return InitialState(fit.mesh, None, origin)


def _refuse_held_vertices(recording: Recording, why: str) -> None:
    if recording.cloth.held_vertices:
        raise InvalidRecordingError(
            f"{recording.folder}: cloth.held_vertices are numbers of the template's vertices, and "
            f"{why}; use initial_state.source=template, or take them out"
        )


def _doubt(recording: Recording, misfit_m: float) -> None:
    logger.warning(
        "%s: a flat %s does not match the first cloud, outlines differ by %.1f mm; flatten the "
        "cloth, check cloth.kind, or give cloth.template",
        recording.folder, recording.cloth.kind, 1e3 * misfit_m,
    )  # fmt: skip


def _weights(recording: Recording, config: InitialStateConfig) -> Path | None:
    """Return the network's weights, or None for the flat fit."""
    kind = recording.cloth.kind
    named = Path(config.weights) if config.weights else None
    asked = config.source == "network" or named is not None
    obstacle = _obstacle(recording)
    if asked and obstacle:
        raise InvalidRecordingError(
            f"{recording.folder}: {obstacle}, so that the network cannot be asked for the first "
            "mesh; use initial_state.source=flat, or give cloth.template"
        )
    missing = missing_modules()
    if asked and missing:
        raise InvalidConfigError(
            f"the first mesh is to come from the network, which needs {', '.join(missing)}; "
            f"install with: {install_command('learn')}, or use initial_state.source=flat"
        )
    weights = named or shipped_weights()
    if weights is None and asked:
        raise InvalidConfigError(
            f"initial_state.source is network, and no weights for {kind!r} come with this "
            "installation; name some with --weights, or use initial_state.source=flat"
        )
    if weights is None:
        obstacle = f"no weights for {kind!r} come with this installation"
    elif missing:
        obstacle = f"{', '.join(missing)} is not installed ({install_command('learn')})"
    if obstacle:
        logger.info("%s: the first mesh is fitted flat: %s", recording.folder, obstacle)
        return None
    return weights


def _obstacle(recording: Recording) -> str:
    """Return why the network cannot use this recording's first frame; empty if it can."""
    if recording.cloth.kind not in FITTED_KINDS:
        return f"cloth.kind is {recording.cloth.kind!r}"
    if not recording.frames or not (recording.frames[0].depth or recording.frames[0].cloud):
        return "its first frame has neither a depth picture nor a cloud"
    if recording.table is None:
        return "it has no table"
    upwards = float(recording.table.normal[2] / np.linalg.norm(recording.table.normal))
    tilt_deg = float(np.degrees(np.arccos(np.clip(upwards, -1.0, 1.0))))
    if tilt_deg > LEVEL_DEG:
        return f"its table tilts by {tilt_deg:.0f} degrees (at most {LEVEL_DEG:.0f})"
    return ""


def _from_network(
    recording: Recording,
    observation: Observation,
    config: InitialStateConfig,
    weights: Path,
    *,
    segmenter: Segmenter | None,
    device: str,
) -> InitialState:
    from clothtrack.reconstruction.data.pseudo_labels import cloth_picture
    from clothtrack.reconstruction.depth_input import DepthInput
    from clothtrack.reconstruction.model_loading import load_model

    kind, table = recording.cloth.kind, recording.table
    depth, mask, camera = cloth_picture(recording, recording.frames[0], segmenter)
    result = load_model(kind, weights, device=device).mesh(
        DepthInput(depth, mask, camera, table, kind),
        kind,
        size_m=recording.cloth.size_m,
        template=read_template(Path(config.template)) if config.template else None,
        vertex_count=config.vertex_count,
        refined=config.refined,
        observation=observation,
        device=device,
    )
    rest = result.reconstruction.rest
    if result.mesh is None or rest is None or table is None:
        raise InvalidRecordingError(
            f"{recording.folder}: the network makes no mesh of the first frame "
            f"({result.reconstruction.status}); use initial_state.source=flat"
        )
    positions = front_up(rest, result.mesh.vertices.astype(np.float64), kind)
    origin = {
        "source": "network",
        "weights": weights.name,
        "weights_sha256": content_hash(weights),
        "refined": result.refinement is not None and result.refinement.chosen > 0,
        "expected_error_m": result.expected_error_m,
    }
    if config.template:
        origin["template_sha256"] = content_hash(Path(config.template))
    mesh = laid_flat(rest, positions, table, RESTING_HEIGHT_M)
    return InitialState(mesh, positions, origin)
