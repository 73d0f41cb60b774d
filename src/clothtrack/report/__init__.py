"""Reports: stills, overlay videos, and offline pages."""

from typing import TYPE_CHECKING

from clothtrack._lazy import lazy_names

if TYPE_CHECKING:
    from clothtrack.report.flattening_page import write_flattening_report
    from clothtrack.report.overlay import Overlay, OverlayConfig, write_contact_sheet
else:
    __getattr__, __dir__ = lazy_names(__name__)

__all__ = ["Overlay", "OverlayConfig", "write_contact_sheet", "write_flattening_report"]
