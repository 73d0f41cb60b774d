"""Files as all rooms write them: whole or not at all, with the settings they were made with."""

from typing import TYPE_CHECKING

from clothtrack._lazy import lazy_names

if TYPE_CHECKING:
    from clothtrack.files.atomic_write import (
        atomic_file,
        atomic_folder,
        content_hash,
        name_problem,
        storage,
        write_file,
    )
    from clothtrack.files.provenance import made_with
    from clothtrack.files.run_manifest import begin_run, require_same
    from clothtrack.files.settings import with_settings
    from clothtrack.files.worker_pool import finished_in_workers, require_workers
else:
    __getattr__, __dir__ = lazy_names(__name__)

__all__ = [
    "atomic_file",
    "atomic_folder",
    "begin_run",
    "content_hash",
    "finished_in_workers",
    "made_with",
    "name_problem",
    "require_same",
    "require_workers",
    "storage",
    "with_settings",
    "write_file",
]
