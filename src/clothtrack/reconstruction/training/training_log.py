"""The log of a training run's scalars: one JSON object per line, and TensorBoard if installed."""

import json
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

from clothtrack.errors import StorageError
from clothtrack.files.atomic_write import atomic_file

SCALARS = "scalars.jsonl"


class TrainingLog:
    """Log of scalars; a resumed run continues it from the saved progress.

    Args:
        last_step: step of the saved progress; lines after it belong to lost work and are removed.
    """

    def __init__(self, folder: Path, *, last_step: int = 0) -> None:
        self.path = folder / SCALARS
        try:
            _cut(self.path, last_step)
            self._file = self.path.open("a", encoding="utf-8")
        except OSError as error:
            raise StorageError.of(error) from error
        self._board = _tensorboard(folder, last_step)

    def __enter__(self) -> "TrainingLog":
        """Return the log itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the files."""
        self._file.close()
        if self._board is not None:
            self._board.close()

    def write(self, split: str, step: int, epoch: int, scalars: Mapping[str, float]) -> None:
        """Write the scalars of one step."""
        line = {"step": step, "epoch": epoch, "split": split, **scalars}
        self._file.write(json.dumps(line) + "\n")
        self._file.flush()
        if self._board is not None:
            for name, value in scalars.items():
                self._board.add_scalar(f"{split}/{name}", value, step)


def read_scalars(folder: Path) -> list[dict[str, Any]]:
    """Return the lines that a run has written, in order, without one truncated by a kill."""
    lines = []
    for text in (folder / SCALARS).read_text(encoding="utf-8").splitlines():
        try:
            lines.append(json.loads(text))
        except (ValueError, RecursionError):
            break
    return lines


def _cut(path: Path, last_step: int) -> None:
    """Keep the lines up to a step."""
    if not path.exists():
        return
    kept = [line for line in read_scalars(path.parent) if line["step"] <= last_step]
    with atomic_file(path) as temporary:
        temporary.write_text("".join(json.dumps(line) + "\n" for line in kept), encoding="utf-8")


def _tensorboard(folder: Path, last_step: int) -> Any:
    """Return TensorBoard's writer, or None if it is not installed."""
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        return None
    # Hide events that a lost run wrote after this step.
    return SummaryWriter(str(folder), purge_step=last_step + 1)
