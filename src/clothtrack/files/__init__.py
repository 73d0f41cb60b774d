"""Files as all rooms write them: whole or not at all, with the settings they were made with."""

from typing import TYPE_CHECKING

from clothtrack._lazy import lazy_names

if TYPE_CHECKING:
    from clothtrack.files.atomic_write import (
        content_hash,
        name_problem,
        storage,
        whole_file,
        whole_folder,
        write_file,
    )
    from clothtrack.files.provenance import made_with
    from clothtrack.files.run_manifest import claim, require_same
    from clothtrack.files.settings import with_settings
    from clothtrack.files.worker_pool import finished_in_workers, require_workers
else:
    __getattr__, __dir__ = lazy_names(__name__)

__all__ = [
    "claim",
    "content_hash",
    "finished_in_workers",
    "made_with",
    "name_problem",
    "require_same",
    "require_workers",
    "storage",
    "whole_file",
    "whole_folder",
    "with_settings",
    "write_file",
]
