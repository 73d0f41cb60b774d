"""SQLite bags of ROS 2 and the RealSense SDK, opened read-only without temporary files."""

import sqlite3
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from urllib.parse import quote

from clothtrack.errors import InvalidRecordingError, TruncatedError
from clothtrack_capture.importing.containers import MOST_BYTES, MOST_TOPICS, Message, Place, Topic

MAGIC = b"SQLite format 3\x00"
# Largest number of SQLite VM steps for one row [millions]; a damaged tree with a cycle needs more.
_MOST_STEPS_M = 50


class SqliteContainer:
    """A `.db3` file."""

    def __init__(self, path: Path) -> None:
        """Open the database without locking or changing anything."""
        self.path, self._steps = path, 0
        log = path.with_name(path.name + "-wal")
        if log.exists() and log.stat().st_size:
            raise InvalidRecordingError(
                f"{path}: the recorder was cut off, and the last messages are in {log.name}; run "
                f"sqlite3 {path.name} 'PRAGMA wal_checkpoint' on a copy of both"
            )
        where = f"file:{quote(str(path.absolute()))}?mode=ro&immutable=1"
        self._base = sqlite3.connect(where, uri=True, check_same_thread=False)
        try:
            self._base.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MOST_BYTES)
            self._base.set_progress_handler(self._step, 1_000_000)
            self._base.execute("PRAGMA trusted_schema = OFF")
            self._base.execute("PRAGMA cell_size_check = ON")
            tables = dict(
                self._base.execute("SELECT name, sql FROM sqlite_master WHERE type='table'")
            )
            self._topics = self._read_topics()
        except (sqlite3.Error, ValueError, OverflowError) as error:
            self.close()
            cause = " ".join(str(error).split())  # It may quote a table's definition.
            raise InvalidRecordingError(
                f"{path}: the data base cannot be read ({cause}); record or copy it again"
            ) from error
        if "VIRTUAL" in str(tables.get("messages", "VIRTUAL")).upper():
            self.close()
            raise InvalidRecordingError(
                f"{path}: no table of messages, so it is no ROS 2 bag; tables: "
                f"{', '.join(map(str, tables)) or 'none'}"
            )

    def topics(self) -> list[Topic]:
        """Return every topic."""
        return list(self._topics.values())

    def messages(self) -> Iterator[Message]:
        """Yield every message in write order."""
        last = -(2**63)
        try:
            rows = self._base.execute(
                "SELECT rowid, topic_id, timestamp, length(data) FROM messages ORDER BY rowid"
            )
            for row, topic, time, size in rows:
                self._steps = 0
                if not (isinstance(row, int) and row > last):
                    raise TruncatedError(f"the rows after {last} run in circles")
                last = row
                if topic in self._topics and isinstance(time, int) and isinstance(size, int):
                    yield Message(self._topics[topic], time, Place(-1, row, size))
        except (sqlite3.Error, ValueError, OverflowError) as error:
            raise TruncatedError(f"after row {last}: {error}") from error

    def fetch(self, place: Place, most: int | None = None) -> bytes:
        """Return the bytes of a message, or only the first `most`."""
        self._steps = 0
        try:
            with self._base.blobopen("messages", "data", place.offset, readonly=True) as blob:
                return blob.read(min(len(blob), most if most is not None else MOST_BYTES))
        except (sqlite3.Error, ValueError, OverflowError, TypeError) as error:
            raise TruncatedError(f"row {place.offset}: {error}") from error

    def close(self) -> None:
        """Close the file."""
        with suppress(sqlite3.Error):
            self._base.close()

    def _read_topics(self) -> dict[int, Topic]:
        topics: dict[int, Topic] = {}
        for number, name, kind, form in self._base.execute(
            "SELECT id, name, type, serialization_format FROM topics"
        ):
            if len(topics) >= MOST_TOPICS:
                break
            topics[number] = Topic(str(name), str(kind), form == "cdr")
        return topics

    def _step(self) -> int:
        self._steps += 1
        return int(self._steps > _MOST_STEPS_M)
