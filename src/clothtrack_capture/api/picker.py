"""Find the picker's path and its pick-and-places."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import UseAppendAction, arg

from clothtrack.api.results import Result
from clothtrack.errors import WrongUsageError

if TYPE_CHECKING:
    from clothtrack.geometry.camera import Camera
    from clothtrack.recordings.recording import Recording

Place = tuple[int, int, int]
Clicks = Annotated[Sequence[Place], arg(metavar="FRAME COLUMN ROW"), UseAppendAction]


def find_picker(
    recording: "Recording | Path | str",
    *,
    tip_color: str = "",
    tip_click: Annotated[Place | None, arg(metavar="FRAME COLUMN ROW")] = None,
    by_hand: bool = False,
    pick: Clicks = (),
    place: Clicks = (),
    camera: str = "",
    force: bool = False,
    opened: "Callable[[str], None] | None" = None,
) -> "Recording | Result":
    """Find pick-and-places of a colored tip automatically, or of a bare hand from clicks.

    Of a `Recording`, nothing is written; a new one with path and actions is returned.

    Args:
        recording: folder with a recording.json that has a table (see calibrate-camera).
        tip_color: color name of the tool's tip, such as pink.
        tip_click: click on the tip, instead of a color name.
        by_hand: a bare hand moved the cloth; a page opens for clicking picks and places.
        pick: frame and pixel at which a hand took the cloth, instead of the page; repeatable.
        place: frame and pixel at which it let go, one for each --pick.
        camera: name of the camera, if there are several.
        force: replace the recording's picker paths and actions.
        opened: function called with the page's address.

    Raises:
        InvalidConfigError: the options contradict each other, or there is no such camera.
        InvalidRecordingError: the recording has no table, or nothing is found.
    """
    from clothtrack_capture.amendment import opened_recording, place_of, reported
    from clothtrack_capture.camera_pose import camera_named
    from clothtrack_capture.picker_detection import require_unmeasured

    clicked = by_hand or bool(pick or place)
    if [bool(tip_color), tip_click is not None, clicked].count(True) != 1:
        raise WrongUsageError(
            "say what moved the cloth, one of: --by-hand, --tip-color NAME, or --tip-click FRAME "
            "COLUMN ROW"
        )
    if len(pick) != len(place):
        raise WrongUsageError(
            f"there are {len(pick)} --pick and {len(place)} --place; give one for the other"
        )
    source = opened_recording(recording)
    chosen = camera_named(source, camera)
    require_unmeasured(source, force=force)
    if clicked:
        changed, lines, report = _by_hand(source, chosen, (pick, place), opened)
    else:
        changed, lines, report = _by_tip(source, chosen, tip_color or tip_click)
    if changed is not source and not source.in_memory:
        folder = place_of(recording)
        lines.append(f"written to {folder / 'picker.csv'} and {folder / 'recording.json'}")
    return reported(recording, changed, Result("\n".join(lines), report))


def _by_tip(
    recording: "Recording", camera: "Camera", tip: str | Place | None
) -> "tuple[Recording, list[str], dict[str, Any]]":
    """Return the recording with picks and places of a colored tip, in words and in numbers."""
    from clothtrack_capture.picker_detection import find_picker as find
    from clothtrack_capture.picker_detection import first_pick_vertex, keep_picker, tip_members

    name = "tip"
    picker = find(recording, camera, tip_members(recording, camera, tip), name=name)
    changed = keep_picker(recording, picker, name, tip if isinstance(tip, str) else "clicked")
    vertex = first_pick_vertex(recording, picker)
    report: dict[str, Any] = {
        "picker": name,
        "seen": int(picker.seen.sum()),
        "frames": len(picker.seen),
        "closed_by": picker.by,
        "first_pick_vertex": vertex,
        "actions": [
            {"first_frame": action.first_frame, "pick": pick, "release": release,
             "last_frame": action.last_frame}
            for action, pick, release in zip(
                picker.actions, picker.picks, picker.releases, strict=True
            )
        ],
    }  # fmt: skip
    lines = [
        f"the tip is seen in {report['seen']} of {report['frames']} frames; closed by {picker.by}",
        *(
            f"action {number}: frames {action['first_frame']} to {action['last_frame']}, picks in "
            f"{action['pick']}, has let go in {action['release']}"
            for number, action in enumerate(report["actions"], start=1)
        ),
        *([] if vertex is None else [f"the first pick takes vertex {vertex} of the template"]),
    ]
    return changed, lines, report


def _by_hand(
    recording: "Recording",
    camera: "Camera",
    clicks: tuple[Sequence[Place], Sequence[Place]],
    opened: Callable[[str], None] | None,
) -> "tuple[Recording, list[str], dict[str, Any]]":
    """Return the recording with picks and places from clicks, given or made on a page."""
    from clothtrack_capture.clicked_picking import ClickedPicking
    from clothtrack_capture.cloth_views import Click

    name = "hand"
    picking = ClickedPicking(recording, camera)
    for ends in zip(*clicks, strict=True):
        for end in ends:
            picking.add(Click(*end))
    if picking.clicks:
        kept = picking.keep(name)
    else:
        from clothtrack_capture.click_pages import pick_live

        kept = pick_live(picking, name, opened=opened)
    if kept is None:
        return recording, ["nothing was saved"], {"picker": name, "actions": []}
    rows = [
        {"first_frame": span.first_frame, "last_frame": span.last_frame, **picking.summary(action)}
        for action, span in zip(picking.actions(), kept.actions, strict=True)
    ]
    lines = [
        f"action {number}: frames {row['first_frame']} to {row['last_frame']}, picks in "
        f"{row['pick']}, has let go in {row['release']}, lifted by {row['lift_mm']} mm"
        + ("" if row["seen"] else " (as clicked: the cloth's rise was not seen)")
        for number, row in enumerate(rows, start=1)
    ]
    return kept, lines, {"picker": name, "actions": rows}
