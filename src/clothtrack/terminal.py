"""What the command line says, where it says it, and with which code it ends.

Results go to standard output, everything else to standard error; progress is for people only, so
it is shown on a terminal and nowhere else.
"""

import os
import sys
from collections.abc import Callable

from clothtrack.errors import ClothTrackError, StorageError


def say(text: str) -> None:
    """Write a result."""
    end_progress()
    sys.stdout.write(text + "\n")


def complain(text: str) -> None:
    """Write one clear line of what is wrong."""
    end_progress()
    sys.stderr.write(f"clothtrack: {text}\n")


def progress(name: str, done: int, total: int) -> None:
    """Show how far we are, over the line that said it before."""
    if sys.stderr.isatty():
        sys.stderr.write(f"\r{name}  {done}/{total}\x1b[K")
        sys.stderr.flush()


def end_progress() -> None:
    """Take the line of progress away."""
    if sys.stderr.isatty():
        sys.stderr.write("\r\x1b[K")


def exit_code(run: Callable[[], int]) -> int:
    """Run a verb; its exit code, or 1 and one clear line when something a person can mend fails."""
    try:
        return run()
    except ClothTrackError as error:
        complain(str(error))
    except BrokenPipeError:
        # The reader of our output went away (`| head`): nothing is wrong, nothing more to say.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        complain(str(StorageError.of(error)))
    except KeyboardInterrupt:
        complain(
            "interrupted; what was finished is whole, nothing half-written keeps its name. "
            "The same command goes on from there"
        )
    return 1
