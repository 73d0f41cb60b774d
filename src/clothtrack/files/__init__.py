"""Shared file handling: atomic writes, and the settings that results were made with."""

from typing import TYPE_CHECKING

from clothtrack._lazy import lazy_names

if TYPE_CHECKING:
    from clothtrack.files.atomic_write import atomic_file, content_hash
    from clothtrack.files.settings import with_settings
    from clothtrack.files.worker_pool import finished_in_workers
else:
    __getattr__, __dir__ = lazy_names(__name__)

__all__ = ["atomic_file", "content_hash", "finished_in_workers", "with_settings"]
