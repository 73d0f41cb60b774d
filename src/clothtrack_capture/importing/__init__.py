"""Import of other programs' files as recordings."""

from typing import TYPE_CHECKING

from clothtrack._lazy import lazy_names

if TYPE_CHECKING:
    from clothtrack_capture.importing.import_options import ImportOptions
    from clothtrack_capture.importing.import_recording import open_source
    from clothtrack_capture.importing.import_report import ImportReport
else:
    __getattr__, __dir__ = lazy_names(__name__)

__all__ = [
    "ImportOptions",
    "ImportReport",
    "open_source",
]
