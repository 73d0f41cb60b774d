"""Look at what happened: stills, overlay video, one offline page."""

from typing import TYPE_CHECKING

from clothtrack._lazy import lazy_names

if TYPE_CHECKING:
    from clothtrack.report.artefact_pages import write_index, write_mesh_page, write_recording_page
    from clothtrack.report.exports import export, export_pictures
    from clothtrack.report.flattening_page import write_flattening_report
    from clothtrack.report.live import serve
    from clothtrack.report.overlay import (
        Overlay,
        OverlayConfig,
        write_contact_sheet,
        write_overlay_video,
    )
    from clothtrack.report.page import ReportConfig, write_report
else:
    __getattr__, __dir__ = lazy_names(__name__)

__all__ = [
    "Overlay",
    "OverlayConfig",
    "ReportConfig",
    "export",
    "export_pictures",
    "serve",
    "write_contact_sheet",
    "write_flattening_report",
    "write_index",
    "write_mesh_page",
    "write_overlay_video",
    "write_recording_page",
    "write_report",
]
