"""What the command line says, where it says it, and with which code it ends.

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
"""The exit codes of wrong usage, and of a verb that Ctrl-C or SIGTERM has ended (see any shell)."""

_SAME_REQUEST_S = 1.0

_LONGEST_LINE = 1_000
"""Characters of a complaint."""

_CONTROL = re.compile(r"[\x00-\x1f\x7f]")

_LONG_WORD = re.compile(r"\S{301,}")
_WORD_END = 80
"""Characters that are shown of each end of a word that is longer than any path one would write."""

progress = ProgressLine()
"""Says how far the verb is (`clothtrack.files.progress`), on standard error."""


def say(text: str) -> None:
    """Write a result."""
    progress.clear()
    # What a terminal cannot show is escaped, as standard error does of itself.
    encoding = sys.stdout.encoding or "utf-8"
    sys.stdout.write(text.encode(encoding, "backslashreplace").decode(encoding) + "\n")
    # Whoever reads a pipe wants the address of a page before the page is closed.
    sys.stdout.flush()


def say_result(text: str, document: object, *, json: bool) -> None:
    """Write a result in words, or as the JSON document that holds the same."""
    say(json_module.dumps(document, indent=2, default=str) if json else text)


def complain(text: str) -> None:
    """Write one clear line of what is wrong; of what is very long the beginning and the end."""
    progress.clear()
    # A line break in the name of a file, or what moves a cursor, would make more than one line.
    text = _CONTROL.sub(lambda character: ascii(character[0])[1:-1], text)
    text = _LONG_WORD.sub(lambda word: f"{word[0][:_WORD_END]}...{word[0][-_WORD_END:]}", text)
    if len(text) > _LONGEST_LINE:
        # What stands in a file may be of any length; what to do stands at the end.
        text = f"{text[: _LONGEST_LINE // 2]} ... {text[-_LONGEST_LINE // 2 :]}"
    sys.stderr.write(f"clothtrack: {text}\n")


def exit_code(run: Callable[[], int]) -> int:
    """Run a verb; its exit code, or one clear line and another code.

    That code is 1 when something a person can mend fails, 130 after Ctrl-C and 143 after SIGTERM.
    """
    progress.begin()
    with _sigterm_as_ctrl_c() as terminations:
        return _exit_code(run, terminations)


def _exit_code(run: Callable[[], int], terminations: list[float]) -> int:
    try:
        try:
            return run()
        finally:
            # What a reader that went away did not take is noticed here, not when Python ends.
            sys.stdout.flush()
    except WrongUsageError as wrong:
        complain(str(wrong))
        return WRONG_USAGE
    except ClothTrackError as error:
        # Whoever read a file may have taken any refusal of the system for a damaged file.
        refused = error.__cause__
        forbidden = isinstance(refused, PermissionError) and refused.filename
        complain(str(StorageError.of(refused) if forbidden else error))
    except BrokenPipeError:
        # The reader of our output went away (`| head`): nothing is wrong, nothing more to say.
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
    """End this process as Ctrl-C ends one that takes no care of it: shells tell that by 130.

    A loop of a shell goes on after a program that only exits with 130.
    """
    sys.stdout.flush()
    sys.stderr.flush()
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    os.kill(os.getpid(), signal.SIGINT)


@contextmanager
def _sigterm_as_ctrl_c() -> Iterator[list[float]]:
    """While the block runs, SIGTERM clears away as Ctrl-C does; gives the times [s] it came at."""
    times: list[float] = []

    def interrupt(number: int, frame: FrameType | None) -> None:
        times.append(time.monotonic())
        # `timeout` tells a process, then its group: one request comes twice.
        if len(times) == 1 or times[-1] - times[-2] > _SAME_REQUEST_S:
            signal.default_int_handler(number, frame)

    try:
        before = signal.signal(signal.SIGTERM, interrupt)
    except ValueError:
        # Not the main thread: whoever started us takes care of signals.
        yield times
        return
    try:
        yield times
    finally:
        signal.signal(signal.SIGTERM, before)
