"""A training's files in pieces of limited size, to be carried away and put together elsewhere.

manifest.json           name, size and SHA-256 of every file, and of every piece of it
progress.pt.0, .1 ...   a file that is too large, in pieces
model.safetensors       any other as it is
"""

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path

from clothtrack.errors import InvalidConfigError, InvalidResultError
from clothtrack.files.atomic_write import name_problem, storage, write_file

MANIFEST = "manifest.json"
FORMAT = "clothtrack-pieces"
VERSION = 1


def write_pieces(folder: Path, names: Sequence[str], output: Path, *, most_bytes: int) -> list[str]:
    """Copy files of a folder in pieces; earlier pieces that are no longer needed are removed.

    The manifest comes last: pieces of a copy that broke off do not fit the one before.

    Args:
        folder: of the files.
        names: of the files; those that are not there are left out.
        output: folder of the pieces.
        most_bytes: of a piece.

    Returns:
        Names of all files in the output.

    Raises:
        InvalidConfigError: the size is not positive.
        StorageError: the disk refuses.
    """
    if most_bytes < 1:
        raise InvalidConfigError(f"most_bytes is {most_bytes}; a piece has at least 1 byte")
    before = _listed(output)
    files, written = {}, []
    for name in names:
        if not (folder / name).is_file():
            continue
        with storage(folder / name):
            content = (folder / name).read_bytes()
        parts = [content[at : at + most_bytes] for at in range(0, len(content), most_bytes)]
        numbered = [f"{name}.{number}" for number in range(len(parts))]
        own = numbered if len(parts) > 1 else [name]
        parts = parts or [b""]
        for piece, part in zip(own, parts, strict=True):
            write_file(output / piece, part)
        pieces = [{"name": one, **_seal(part)} for one, part in zip(own, parts, strict=True)]
        files[name] = {**_seal(content), "pieces": pieces}
        written += own
    manifest = {"format": FORMAT, "version": VERSION, "files": files}
    write_file(output / MANIFEST, (json.dumps(manifest, indent=1) + "\n").encode())
    for name in set(before) - set(written):
        with storage(output / name):
            (output / name).unlink(missing_ok=True)
    return [*written, MANIFEST]


def join_pieces(pieces: Path, folder: Path) -> list[str]:
    """Put the files of `write_pieces` together, each whole or not at all.

    Args:
        pieces: folder of the pieces.
        folder: gets the files.

    Returns:
        Names of the files.

    Raises:
        InvalidResultError: a piece is missing or is not what was written.
        StorageError: the disk refuses.
    """
    joined = {}
    for name, described in _manifest(pieces).items():
        parts = []
        for piece in described["pieces"]:
            path = pieces / _entry(pieces, piece["name"])
            if not path.is_file():
                raise InvalidResultError(f"{path}: the piece is missing; fetch it again")
            with storage(path):
                parts.append(path.read_bytes())
            if _seal(parts[-1]) != {key: piece[key] for key in ("bytes", "sha256")}:
                raise InvalidResultError(
                    f"{path}: is not the piece that was written (its SHA-256 differs); fetch all "
                    "pieces of one run again"
                )
        joined[_entry(pieces, name)] = b"".join(parts)
    for name, content in joined.items():
        write_file(folder / name, content)
    return list(joined)


def _seal(content: bytes) -> dict[str, str | int]:
    return {"bytes": len(content), "sha256": hashlib.sha256(content).hexdigest()}


def _entry(pieces: Path, name: object) -> str:
    """A name of the manifest, if it names a file of its folder.

    Raises:
        InvalidResultError: it does not.
    """
    if problem := name_problem(name):
        raise InvalidResultError(
            f"{pieces / MANIFEST}: {name!r:.80} cannot be the name of a file ({problem}); fetch "
            "the pieces again"
        )
    return str(name)


def _manifest(pieces: Path) -> dict[str, dict]:
    path = pieces / MANIFEST
    if not path.is_file():
        raise InvalidResultError(f"{path}: there is no such file; name the folder of the pieces")
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        if (document["format"], document["version"]) != (FORMAT, VERSION):
            raise ValueError(f"it is {document['format']!r:.80}, version {document['version']}")
        for described in document["files"].values():
            if not all({"name", "bytes", "sha256"} <= set(one) for one in described["pieces"]):
                raise ValueError("a piece without its name, size or SHA-256")
    except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise InvalidResultError(
            f"{path}: not the list of a training's pieces ({error}); fetch the pieces again"
        ) from error
    return document["files"]


def _listed(output: Path) -> list[str]:
    """Pieces that an earlier manifest lists; none where there is none."""
    try:
        files = _manifest(output).values()
    except InvalidResultError:
        return []
    names = [one["name"] for described in files for one in described["pieces"]]
    return [name for name in names if not name_problem(name)]
