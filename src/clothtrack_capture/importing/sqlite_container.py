"""SQLite bags of ROS 2 and the RealSense SDK, opened read-only without temporary files."""

import sqlite3
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import quote

from clothtrack.errors import InvalidRecordingError, TruncatedError
from clothtrack_capture.importing.containers import MOST_BYTES, Container, Message, Place, Topic

MAGIC = b"SQLite format 3\x00"
_DAMAGE = (sqlite3.Error, ValueError, OverflowError, TypeError)


class SqliteContainer(Container):
    """A `.db3` file."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        log = path.with_name(path.name + "-wal")
        if log.exists() and log.stat().st_size:
            raise InvalidRecordingError(
                f"{path}: the recorder was cut off, and the last messages are in {log.name}; run "
                f"sqlite3 {path.name} 'PRAGMA wal_checkpoint' on a copy of both"
            )
        where = f"file:{quote(str(path.absolute()))}?mode=ro&immutable=1"
        self._base = sqlite3.connect(where, uri=True, check_same_thread=False)
        self.close = self._base.close
        try:
            self._base.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MOST_BYTES)
            self._base.execute("PRAGMA trusted_schema = OFF")
            self._base.execute("PRAGMA cell_size_check = ON")
            self._topics = {
                number: Topic(str(name), str(kind), form == "cdr")
                for number, name, kind, form in self._base.execute(
                    "SELECT id, name, type, serialization_format FROM topics"
                )
            }
            self._base.execute("SELECT topic_id, timestamp, data FROM messages LIMIT 0")
        except _DAMAGE as error:
            self.close()
            cause = " ".join(str(error).split())  # It may quote a table's definition.
            raise InvalidRecordingError(
                f"{path}: the data base cannot be read ({cause}); record or copy it again"
            ) from error

    def messages(self) -> Iterator[Message]:
        """Yield every message in write order."""
        last = -(2**63)
        try:
            rows = self._base.execute(
                "SELECT rowid, topic_id, timestamp, length(data) FROM messages ORDER BY rowid"
            )
            for row, topic, time, size in rows:
                if not (isinstance(row, int) and row > last):
                    raise TruncatedError(f"the rows after {last} run in circles")
                last = row
                if topic in self._topics and isinstance(time, int) and isinstance(size, int):
                    yield Message(self._topics[topic], time, Place(-1, row, size))
        except _DAMAGE as error:
            raise TruncatedError(f"after row {last}: {error}") from error

    def fetch(self, place: Place, most: int | None = None) -> bytes:
        """Return the bytes of a message, or only the first `most`."""
        try:
            with self._base.blobopen("messages", "data", place.offset, readonly=True) as blob:
                return blob.read(MOST_BYTES if most is None else most)
        except _DAMAGE as error:
            raise TruncatedError(f"row {place.offset}: {error}") from error
