"""The format of an exported file, which follows from its suffix."""

from pathlib import Path
from typing import Literal, get_args

from clothtrack.errors import InvalidConfigError

Format = Literal["obj", "ply", "glb", "npz", "sheet", "mp4"]
FORMATS: dict[str, Format] = {".npz": "npz", ".png": "sheet", ".mp4": "mp4"}
"""The formats that are one file, by suffix."""
FOLDERS: tuple[Format, ...] = ("obj", "ply", "glb")
"""The formats that are a folder with one file per frame."""


def export_format(output: Path, wanted: str | None = None) -> Format:
    """Return the format of an exported file or folder.

    Args:
        output: its name. Without a suffix it is a folder of OBJ files, unless another format is
            wanted, whose suffix is added then.
        wanted: the requested format.

    Raises:
        InvalidConfigError: the format is unknown, or the suffix belongs to another one or to none.
    """
    if wanted is not None:
        _named(wanted)
    suffix = output.suffix.lower()
    told = FORMATS.get(suffix)
    if told is None and suffix[1:] in FOLDERS:
        raise InvalidConfigError(
            f"{output}: {suffix[1:]} is one file per frame, in a folder; leave out {suffix} and "
            f"add --format {suffix[1:]}"
        )
    # A folder may be called run.2; a suffix of letters means a kind of file.
    if told is None and suffix[1:].isalpha():
        raise InvalidConfigError(
            f"{output}: nothing is exported as {suffix}; end the name in {', '.join(FORMATS)}, or "
            "name a folder without a suffix"
        )
    if told is not None and wanted is not None and told != wanted:
        raise InvalidConfigError(
            f"{output}: --format {wanted} contradicts {suffix}, which is {told}; leave out one of "
            "them"
        )
    return told or _named(wanted or "obj")


def _named(wanted: str) -> Format:
    """Return the format of a name."""
    for one in get_args(Format):
        if one == wanted:
            return one
    raise InvalidConfigError(f"format is {wanted!r}; choose one of {', '.join(get_args(Format))}")
