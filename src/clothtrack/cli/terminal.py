"""The messages of the command line, their streams, and its exit codes.

Results go to standard output, everything else to standard error.
"""

import json as json_module
import os
import re
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

from clothtrack.cli.progress_line import ProgressLine
from clothtrack.errors import ClothTrackError, StorageError, WrongUsageError

WRONG_USAGE = 2
INTERRUPTED = 128 + signal.SIGINT
TERMINATED = 128 + signal.SIGTERM
"""The exit codes of wrong usage and of a verb ended by Ctrl-C or SIGTERM, as in any shell."""

_SAME_REQUEST_S = 1.0

_LONGEST_LINE = 1_000
"""Longest error line [characters]."""

_CONTROL = re.compile(r"[\x00-\x1f\x7f]")

_LONG_WORD = re.compile(r"\S{301,}")
_WORD_END = 80
"""Characters shown of each end of a word that is too long to be a path."""

progress = ProgressLine()
"""Shows the progress of the verb (`clothtrack.files.progress`) on standard error."""


def say(text: str) -> None:
    """Print a result."""
    progress.clear()
    # Escape what the terminal cannot show, as standard error does by default.
    encoding = sys.stdout.encoding or "utf-8"
    sys.stdout.write(text.encode(encoding, "backslashreplace").decode(encoding) + "\n")
    # The reader of a pipe needs the address of a page while the page is open.
    sys.stdout.flush()


def say_result(text: str, document: object, *, json: bool) -> None:
    """Print a result as text, or as the equivalent JSON document."""
    say(json_module.dumps(document, indent=2, default=str) if json else text)


def complain(text: str) -> None:
    """Print one error line; a very long one is shortened to its beginning and end."""
    progress.clear()
    # A line break or a cursor control in a file name would make more than one line.
    text = _CONTROL.sub(lambda character: ascii(character[0])[1:-1], text)
    text = _LONG_WORD.sub(lambda word: f"{word[0][:_WORD_END]}...{word[0][-_WORD_END:]}", text)
    if len(text) > _LONGEST_LINE:
        # A value from a file may have any length; the remedy is at the end.
        text = f"{text[: _LONGEST_LINE // 2]} ... {text[-_LONGEST_LINE // 2 :]}"
    sys.stderr.write(f"clothtrack: {text}\n")


def exit_code(run: Callable[[], int]) -> int:
    """Run a verb and return its exit code; a failure prints one line and has another code.

    That code is 1 after an error that the user can fix, 130 after Ctrl-C and 143 after SIGTERM.
    """
    progress.begin()
    with _sigterm_as_ctrl_c() as terminations:
        return _exit_code(run, terminations)


def _exit_code(run: Callable[[], int], terminations: list[float]) -> int:
    try:
        try:
            return run()
        finally:
            # A pipe whose reader has gone is noticed here, not when Python ends.
            sys.stdout.flush()
    except WrongUsageError as wrong:
        complain(str(wrong))
        return WRONG_USAGE
    except ClothTrackError as error:
        # The reader of a file may have reported denied access as a damaged file.
        refused = error.__cause__
        forbidden = isinstance(refused, PermissionError) and refused.filename
        complain(str(StorageError.of(refused) if forbidden else error))
    except BrokenPipeError:
        # The reader of the output has gone (`| head`): this is no error, and nothing is left to do.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        complain(str(StorageError.of(error)))
    except KeyboardInterrupt:
        complain(
            "interrupted; what was finished is whole, nothing half-written keeps its name. "
            "The same command keeps it and does the rest"
        )
        return TERMINATED if terminations else INTERRUPTED
    return 1


def end_by_interrupt() -> None:
    """End this process by SIGINT, as if it had no handler; shells report that as 130.

    A shell loop would continue after a program that only exits with 130.
    """
    sys.stdout.flush()
    sys.stderr.flush()
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    os.kill(os.getpid(), signal.SIGINT)


@contextmanager
def _sigterm_as_ctrl_c() -> Iterator[list[float]]:
    """Treat SIGTERM as Ctrl-C during the block; yield the times [s] at which it arrived."""
    times: list[float] = []

    def interrupt(number: int, frame: FrameType | None) -> None:
        times.append(time.monotonic())
        # `timeout` signals a process and then its group, so one request arrives twice.
        if len(times) == 1 or times[-1] - times[-2] > _SAME_REQUEST_S:
            signal.default_int_handler(number, frame)

    try:
        before = signal.signal(signal.SIGTERM, interrupt)
    except ValueError:
        # Not the main thread: the caller handles signals.
        yield times
        return
    try:
        yield times
    finally:
        signal.signal(signal.SIGTERM, before)
