"""Segment the cloth in a recording from one click."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import arg

from clothtrack.api.results import Result

if TYPE_CHECKING:
    from clothtrack.recordings.recording import Recording


def segment(
    recording: "Recording | Path | str",
    *,
    click: Annotated[tuple[int, int] | None, arg(metavar="COLUMN ROW")] = None,
    frame: int = 0,
    camera: str = "",
    sheet: Path | str | None = None,
    opened: "Callable[[str], None] | None" = None,
) -> "Recording | Result":
    """Mark the cloth pixels with one click, on a page or with --click.

    The masks replace those of the recording. Of a `Recording`, nothing is written; a new one with
    masks is returned.

    Args:
        recording: folder with a recording.json and color pictures.
        click: click on the cloth; without it a local page opens, where a box can be drawn too, and
            masks can be looked at before they are kept.
        frame: frame of the click.
        camera: name of the camera, if there are several.
        sheet: also write a picture with masks from the whole recording to this PNG file.
        opened: function called with the page's address.

    Raises:
        InvalidConfigError: there is no such camera or frame.
        InvalidRecordingError: a picture cannot be read, or nothing is cloth.
    """
    from clothtrack_capture.amendment import opened_recording, place_of, reported
    from clothtrack_capture.camera_pose import camera_named
    from clothtrack_capture.mask_pictures import summary_of
    from clothtrack_capture.segmentation_setup import SegmentationSetup

    source, place = opened_recording(recording), place_of(recording)
    setup = SegmentationSetup(source, camera_named(source, camera))
    if click is None:
        from clothtrack_capture.click_pages import segment_live

        kept = segment_live(setup, opened=opened)
    else:
        setup.choose_click(frame, click)
        kept = setup.keep()
    if kept is None:
        nothing = Result("nothing was kept", {"masks": 0, "recording": place})
        return reported(recording, source, nothing)
    summary = summary_of(kept, setup.camera)
    lines = [str(summary), f"{summary.frames} masks are in {place}"]
    if sheet is not None:
        from clothtrack_capture.mask_pictures import write_mask_sheet

        lines.append(f"{write_mask_sheet(setup, Path(sheet))}   (look at it)")
    report = {**summary.as_dict(), "masks": summary.frames, "recording": place}
    return reported(recording, kept, Result("\n".join(lines), report))
