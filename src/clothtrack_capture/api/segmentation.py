"""Segment the cloth in a recording from one click."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from clothtrack.api.results import Result


def segment(
    recording: Path | str,
    *,
    click: Annotated[tuple[int, int] | None, arg(metavar="COLUMN ROW")] = None,
    frame: int = 0,
    camera: str = "",
    keep: bool = False,
    sheet: Path | str = Path("masks.png"),
    opened: "Callable[[str], None] | None" = None,
) -> Result:
    """Mark the cloth pixels with one click, on a page or with --click.

    Args:
        recording: folder with a recording.json and color pictures.
        click: click on the cloth; without it a local page opens, where a box can be drawn too.
        frame: frame of the click.
        camera: name of the camera, if there are several.
        keep: write the masks into the recording; the page has a button for it.
        sheet: with a click, write a contact sheet of masks from the whole recording to this file.
        opened: function called with the page's address.

    Raises:
        InvalidConfigError: there is no such camera or frame.
        InvalidRecordingError: a picture cannot be read, or nothing is cloth.
    """
    from clothtrack.recordings.store import read_recording
    from clothtrack_capture.camera_pose import camera_named
    from clothtrack_capture.mask_summary import summary_of
    from clothtrack_capture.segmentation_setup import SegmentationSetup

    folder = Path(recording)
    source = read_recording(folder)
    setup = SegmentationSetup(source, camera_named(source, camera))
    lines = []
    if click is None:
        from clothtrack_capture.segmentation_page import segment_live

        kept = segment_live(setup, None, opened=opened)
        if kept is None:
            return Result("nothing was kept", {"masks": 0, "recording": folder})
    else:
        from clothtrack_capture.mask_pictures import write_mask_sheet

        setup.choose_click(frame, click)
        lines.append(f"{write_mask_sheet(setup, Path(sheet))}   (look at it)")
        kept = setup.keep() if keep else 0
    if kept:
        lines.append(f"{kept} masks are in {folder}")
    summary = summary_of(setup)
    report = {**summary.as_dict(), "masks": kept, "recording": folder}
    return Result("\n".join([str(summary), *lines]), report)
