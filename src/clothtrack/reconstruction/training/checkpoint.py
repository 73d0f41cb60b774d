"""Weights on disk: safetensors for sharing, and the progress of a run for resuming it.

Neither file can run code. Safetensors holds numbers and text, and progress is read by the
restricted unpickler of PyTorch, which accepts only tensors and plain containers.
"""

import hashlib
import io
import json
import logging
import pickle
import warnings
import zipfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, nn

from clothtrack.errors import InvalidResultError, StorageError
from clothtrack.files.atomic_write import atomic_file, write_file

logger = logging.getLogger(__name__)

FORMAT = "clothtrack-weights"
_PROGRESS_FORMAT = "clothtrack-training-progress"
FORMAT_VERSION = 1
_DESCRIPTION = {"format", "version", "network", "kind", "provenance"}
PACKAGES = ("torch", "numpy", "safetensors", "warp-lang")
"""Distributions whose versions are stored with trained weights."""

START = "start"
"""Key of `data` in a provenance, for the runs that led to a training's start weights."""

DIGEST = "sha256"

_REMEDY = "train again, or fetch an undamaged copy"


@dataclass(frozen=True, eq=False)
class Weights:
    """Content of a weights file."""

    path: Path
    tensors: Mapping[str, Tensor]
    network: Mapping[str, Any]
    kind: str
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @property
    def runs(self) -> list[dict[str, Any]]:
        """Provenance of every run that led to these weights, in order."""
        return _runs(self.provenance)

    def load_into(self, module: nn.Module, *, prefix: str = "") -> None:
        """Load these weights into a module; tensor names must match exactly."""
        found = {
            name.removeprefix(prefix): value
            for name, value in self.tensors.items()
            if name.startswith(prefix)
        }
        load_tensors(module, found, self.path)


def _runs(provenance: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return earlier runs and the own run of weights as a flat list."""
    start = provenance.get("data", {}).get(START, [])
    # Older files store only the previous run, which contains the run before it, and so on.
    earlier = start if isinstance(start, list) else _runs(start)
    own = {**provenance, "data": without_start(provenance.get("data", {}))}
    if "phases" in own:
        own["phases"] = [{**one, "data": without_start(one["data"])} for one in own["phases"]]
    return [*earlier, own]


def without_start(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return the description of the training data, without the earlier runs."""
    return {name: value for name, value in data.items() if name != START}


def save_weights(
    path: Path,
    tensors: Mapping[str, Tensor],
    network: Any,
    *,
    kind: str,
    provenance: Mapping[str, Any] | None = None,
) -> None:
    """Write weights as safetensors atomically."""
    copies = {name: value.detach().to("cpu").contiguous() for name, value in tensors.items()}
    metadata = {
        "format": FORMAT,
        "version": str(FORMAT_VERSION),
        "network": json.dumps(asdict(network)),
        "kind": kind,
        "provenance": json.dumps(provenance or {}, default=str),
    }
    metadata[DIGEST] = weights_digest(copies, metadata)
    try:
        with atomic_file(path) as temporary:
            save_file(copies, temporary, metadata)
    except SafetensorError as error:
        raise StorageError(
            f"{path}: cannot be written ({error}); free some space or choose another folder"
        ) from error


def load_weights(path: Path) -> Weights:
    """Read a weights file; nothing in it is executed."""
    if not path.is_file():
        raise InvalidResultError(f"{path}: there is no such weights file; check the name")
    try:
        with safe_open(path, framework="pt", device="cpu") as file:
            metadata = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError, ValueError) as error:
        raise InvalidResultError(
            f"{path}: not a whole safetensors file ({error}); {_REMEDY}"
        ) from error
    if metadata.get("format") != FORMAT or metadata.get("version") != str(FORMAT_VERSION):
        raise InvalidResultError(
            f"{path}: format and version are {metadata.get('format')!r:.80}, "
            f"{metadata.get('version')!r:.80}, expected {FORMAT!r}, '{FORMAT_VERSION}'; give "
            "weights that clothtrack has written"
        )
    _check_digest(path, tensors, metadata)
    try:
        network, provenance = (json.loads(metadata[key]) for key in ("network", "provenance"))
        kind = metadata["kind"]
    except (KeyError, ValueError, RecursionError) as error:
        raise InvalidResultError(f"{path}: its description is damaged ({error}); {_REMEDY}") from (
            error
        )
    if not isinstance(network, dict) or not isinstance(provenance, dict):
        raise InvalidResultError(f"{path}: its description is not a list of settings; {_REMEDY}")
    return Weights(path, tensors, network, kind, provenance)


def weights_digest(tensors: Mapping[str, Tensor], metadata: Mapping[str, str]) -> str:
    """Return the SHA-256 of weights and their metadata, in hexadecimal digits."""
    described = {name: text for name, text in metadata.items() if name != DIGEST}
    digest = hashlib.sha256(json.dumps(described, sort_keys=True).encode())
    for name, value in sorted(tensors.items()):
        digest.update(f"{name} {value.dtype} {tuple(value.shape)}".encode())
        # As bytes, because NumPy lacks some number types of PyTorch.
        digest.update(value.contiguous().reshape(-1).view(torch.uint8).numpy().data)
    return digest.hexdigest()


def _check_digest(path: Path, tensors: Mapping[str, Tensor], metadata: Mapping[str, str]) -> None:
    if DIGEST in metadata:
        if weights_digest(tensors, metadata) != metadata[DIGEST]:
            raise InvalidResultError(
                f"{path}: is damaged (its SHA-256 differs from the one it was written with); "
                f"{_REMEDY}"
            )
    elif unknown := set(metadata) - _DESCRIPTION:
        # An unknown field may be a digest with a damaged name, so the file is not accepted.
        raise InvalidResultError(
            f"{path}: its description is damaged (a field is called {min(unknown)!r:.80}); "
            f"{_REMEDY}"
        )
    else:
        logger.info("%s: was written without SHA-256, damage may go unnoticed", path)


def load_tensors(module: nn.Module, tensors: Mapping[str, Tensor], path: Path) -> None:
    """Load weights into a module by name; the names must match exactly."""
    check_tensors(module, tensors, path)
    for name, value in tensors.items():
        if value.is_floating_point() and not bool(torch.isfinite(value).all()):
            raise InvalidResultError(f"{path}: {name} is not finite; {_REMEDY}")
    module.load_state_dict(dict(tensors))


def check_tensors(module: nn.Module, tensors: Mapping[str, Tensor], path: Path) -> None:
    """Refuse weights that are not exactly those of a module, which may be on the meta device."""
    wanted = module.state_dict()
    wrong = sorted(set(wanted) - set(tensors)) + sorted(set(tensors) - set(wanted))
    if wrong:
        what = "lacks" if wrong[0] in wanted else "has, and the network does not know,"
        raise InvalidResultError(
            f"{path} {what} {wrong[0]!r:.80} ({len(wrong)} names differ): it belongs to another "
            "preset or stage; give weights of this one"
        )
    for name, value in tensors.items():
        if value.shape != wanted[name].shape:
            raise InvalidResultError(
                f"{path}: {name} has shape {tuple(value.shape)}, the network's has "
                f"{tuple(wanted[name].shape)}: it belongs to another preset; give weights of "
                "this one"
            )


def save_progress(path: Path, document: Mapping[str, Any]) -> None:
    """Write tensors and plain values for `load_progress` atomically."""
    content = {"format": _PROGRESS_FORMAT, "version": FORMAT_VERSION, **document}
    # Save to memory first, because torch raises its own error on a full disk.
    whole = io.BytesIO()
    torch.save(content, whole)
    write_file(path, whole.getbuffer())


def load_progress(path: Path) -> dict[str, Any]:
    """Read what `save_progress` has written; nothing in it is executed."""
    try:
        with warnings.catch_warnings():
            # PyTorch warns about content that it then rejects.
            warnings.simplefilter("ignore")
            document = torch.load(path, map_location="cpu", weights_only=True)
    except (
        pickle.UnpicklingError,
        zipfile.BadZipFile,
        RuntimeError,
        ValueError,
        KeyError,
        AttributeError,
        TypeError,
        IndexError,
        EOFError,
        OSError,
    ) as error:
        reason = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
        raise InvalidResultError(
            f"{path}: not the progress of a training ({reason}); remove it to train from the start"
        ) from error
    if not isinstance(document, dict) or document.get("format") != _PROGRESS_FORMAT:
        raise InvalidResultError(
            f"{path}: not the progress of a training; remove it to train from the start"
        )
    if document.get("version") != FORMAT_VERSION:
        raise InvalidResultError(
            f"{path}: version {document.get('version')} (this clothtrack reads {FORMAT_VERSION}); "
            "remove it to train from the start"
        )
    return document
