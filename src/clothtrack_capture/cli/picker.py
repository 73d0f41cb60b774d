"""The verb that finds what moved the cloth: find-picker."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, UseAppendAction, arg

from clothtrack.cli.options import AsJson
from clothtrack.cli.terminal import complain, say, say_result
from clothtrack_capture.cli.capture import written

if TYPE_CHECKING:
    from clothtrack.geometry.camera import Camera
    from clothtrack.recordings.recording import Recording

TipClick = Annotated[
    tuple[int, int, int] | None,
    arg(metavar="FRAME COLUMN ROW", help="a click on the tip, in place of a colour name"),
]

Clicks = Annotated[
    tuple[tuple[int, int, int], ...], arg(metavar="FRAME COLUMN ROW"), UseAppendAction
]


def find_picker(
    recording: Positional[Path],
    *,
    tip_color: str = "",
    tip_click: TipClick = None,
    by_hand: bool = False,
    pick: Clicks = (),
    place: Clicks = (),
    name: str = "",
    camera: str = "",
    force: bool = False,
    port: int | None = None,
    json: AsJson = False,
) -> int:
    """Find what moved the cloth, and its pick-and-places: a coloured tip, or a hand, by clicks.

    Args:
        recording: folder with a recording.json that has a table (see calibrate-camera).
        tip_color: name of the colour of the tool's tip, such as pink.
        tip_click: a click on the tip, in place of a colour name.
        by_hand: a bare hand moved it; a page opens to click picks and places on.
        pick: where and in which frame a hand took the cloth, in place of the page; repeatable.
        place: where and in which frame it let go, one for each --pick.
        name: what to call the picker; "tip" or "hand" by default.
        camera: which one to look through, when there are several.
        force: replace the picker paths and actions that the recording has.
        port: of the page's server, which listens on this machine only; any free one by default.
        json: machine-readable.
    """
    from clothtrack.recordings.store import read_recording
    from clothtrack_capture.camera_pose import camera_named
    from clothtrack_capture.picker_detection import require_unmeasured

    clicked = by_hand or bool(pick or place)
    if [bool(tip_color), tip_click is not None, clicked].count(True) != 1:
        complain(
            "say what moved the cloth: --by-hand, --tip-color NAME, or --tip-click FRAME COLUMN ROW"
        )
        return 2
    if len(pick) != len(place):
        complain(f"there are {len(pick)} --pick and {len(place)} --place; give one for the other")
        return 2
    source = read_recording(recording)
    chosen = camera_named(source, camera)
    require_unmeasured(source, force=force)
    if clicked:
        return _by_hand(source, chosen, name or "hand", (pick, place), port, json=json)
    return _by_tip(source, chosen, name or "tip", tip_color or tip_click, json=json)


def _by_tip(
    recording: "Recording",
    camera: "Camera",
    name: str,
    tip: str | tuple[int, int, int] | None,
    *,
    json: bool,
) -> int:
    """Picks and places from a coloured tip."""
    from clothtrack_capture.picker_detection import find_picker as find
    from clothtrack_capture.picker_detection import keep_picker, tip_members

    picker = find(recording, camera, tip_members(recording, camera, tip), name=name)
    vertex = keep_picker(recording, picker, name, tip if isinstance(tip, str) else "clicked")
    report = {
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
        written(recording.folder),
    ]
    say_result("\n".join(lines), report, json=json)
    return 0


def _by_hand(
    recording: "Recording",
    camera: "Camera",
    name: str,
    clicks: tuple[Clicks, Clicks],
    port: int | None,
    *,
    json: bool,
) -> int:
    """Picks and places from clicks, given or made on a page."""
    from clothtrack_capture.clicked_picking import ClickedPicking
    from clothtrack_capture.cloth_views import Click

    picking = ClickedPicking(recording, camera)
    for ends in zip(*clicks, strict=True):
        for end in ends:
            picking.add(Click(*end))
    if picking.clicks:
        kept = picking.keep(name)
    else:
        from clothtrack_capture.picking_page import pick_live

        tell = complain if json else say
        kept = pick_live(
            picking, name, port, opened=lambda at: tell(f"click what it did: {at}   Ctrl-C ends")
        )
    if kept is None:
        say_result("nothing was saved", {"picker": name, "actions": []}, json=json)
        return 0
    rows = [
        {"first_frame": span.first_frame, "last_frame": span.last_frame, **picking.summary(action)}
        for action, span in kept
    ]
    report = {"picker": name, "actions": rows}
    lines = [
        f"action {number}: frames {row['first_frame']} to {row['last_frame']}, picks in "
        f"{row['pick']}, has let go in {row['release']}, lifted by {row['lift_mm']} mm"
        + ("" if row["seen"] else " (as clicked: the cloth's rise was not seen)")
        for number, row in enumerate(rows, start=1)
    ]
    lines.append(written(recording.folder))
    say_result("\n".join(lines), report, json=json)
    return 0
