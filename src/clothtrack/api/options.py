"""Types of arguments that several verbs share, with their names on the command line."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from tyro.conf import UseAppendAction, arg

from clothtrack.errors import InvalidConfigError
from clothtrack.files.extras import require_extra

Function = TypeVar("Function", bound=Callable[..., Any])

Garment = Literal["towel", "tshirt", "trousers"]
Mode = Literal["default", "paper", "open_loop"]
DepthUnit = Annotated[float | None, arg(name="depth-unit")]
TableDistance = Annotated[float | None, arg(name="table-distance")]
Ray = Annotated[str, arg(metavar="ADDRESS")]
Settings = Annotated[Sequence[str], arg(name="set", metavar="NAME=VALUE"), UseAppendAction]


def configured_by(make: Callable[..., Any]) -> Callable[[Function], Function]:
    """Declare which function makes the configuration that the `settings` of another one change.

    The command line lists that configuration with --show-settings.

    Args:
        make: takes some of the arguments of the function, under the same names.
    """

    def note(function: Function) -> Function:
        function.__dict__["configuration"] = make
        return function

    return note


def require_file(path: Path | str | None, kind: str) -> None:
    """Refuse a missing file.

    Args:
        path: its name, if one was given.
        kind: kind of file, such as "weights".

    Raises:
        InvalidConfigError: naming the file.
    """
    if path is not None and not Path(path).is_file():
        raise InvalidConfigError(f"{path}: there is no such {kind} file; check the name")


def require_learning() -> None:
    """Check that the extra [learn] is installed.

    Raises:
        InvalidConfigError: it is missing; the message has the command that installs it.
    """
    from clothtrack.reconstruction.availability import EXTRA

    require_extra("learn", EXTRA, "learning")
