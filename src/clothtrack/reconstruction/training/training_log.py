"""Every scalar of a training run: one JSON object per line, and TensorBoard where it is there."""

import json
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

from clothtrack.errors import StorageError
from clothtrack.files.atomic_write import atomic_file

SCALARS = "scalars.jsonl"


class TrainingLog:
    """Writes scalars as they come; a resumed run continues where the saved progress was.

    Args:
        folder: of the run; gets `scalars.jsonl` and TensorBoard's event files.
        last_step: lines after this step are of work that was lost with a kill; they are removed.

    Raises:
        StorageError: when the disk refuses.
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
        """The log itself."""
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
        """Write the scalars of one step.

        Args:
            split: "train" or "held_out".
            step: steps done.
            epoch: the epoch that they were done in.
            scalars: by name.
        """
        line = {"step": step, "epoch": epoch, "split": split, **scalars}
        self._file.write(json.dumps(line) + "\n")
        self._file.flush()
        if self._board is not None:
            for name, value in scalars.items():
                self._board.add_scalar(f"{split}/{name}", value, step)


def read_scalars(folder: Path) -> list[dict[str, Any]]:
    """The lines that a run has written, in order; a line cut short by a kill is left out."""
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
    """TensorBoard's writer, or None where it is not installed."""
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        return None
    # Whatever a lost run has written after this step is not shown.
    return SummaryWriter(str(folder), purge_step=last_step + 1)
