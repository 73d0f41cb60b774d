"""The checks of the geometry: one table, and one loop that runs it."""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from string import Formatter
from typing import Any, Literal

from clothtrack.recordings.geometry_checks import cameras, cloth, color, picker
from clothtrack.recordings.geometry_checks.finding import Finding, Measured, ObservedFrames
from clothtrack.recordings.recording import Recording


@dataclass(frozen=True)
class Check:
    """One check: what is measured, and what is said where it is beyond its limit.

    Attributes:
        kind: of its findings.
        measure: yields values, and the words of the text.
        limit: largest value that is right, or least and largest; None where the measure yields
            only what is wrong, and says what was expected.
        text: with the fields of what was measured, `field`, and the limits.
        needs: what the recording must have, or the check is left out: names in `_HAS`.
        unless: findings that explain this one; the check is left out where one is there already.
    """

    kind: str
    measure: Callable[[ObservedFrames], Iterable[Measured]]
    limit: float | tuple[float, float] | None
    unit: str
    field: str
    text: str
    needs: Sequence[str] = ()
    unless: frozenset[str] = frozenset()
    severity: Literal["doubt", "note"] = "doubt"


_HAS: dict[str, Callable[[ObservedFrames], bool]] = {
    "table": lambda frames: frames.recording.table is not None,
    "depth": lambda frames: bool(frames.recording.frames[0].depth),
    "template": lambda frames: frames.recording.cloth.template is not None,
    "no size": lambda frames: frames.recording.cloth.size_m is None,
    "no template": lambda frames: frames.recording.cloth.template is None,
    "cloth": lambda frames: frames.at(0) is not None,
    "pictures": lambda frames: frames.small is not None,
}

_WORLD = frozenset({"depth_unit", "camera_pose", "scale"})
"""Where these are wrong, everything else in the world is wrong, too."""

_CLOTH = _WORLD | {"cloth_height"}
_PATH = _CLOTH | {"clock_unit", "picker_clock"}

_UNIT = "correct {field}, {unit_m:g} is likely to be {likely:g}"
_POSE = "correct {field}{cause}; clothtrack calibrate-camera finds it"
_PUSHED = "camera {camera!r} was pushed before frame {since}: "
_ALONE = "; keep the frames up to {last} alone, or record again"
_SCALE = " ({low:g} to {high:g} are usual), and no size or template confirms it: correct {field}"
_COLOR = "the color fits the depth when it is "
_REGISTERED = (
    " (correlation {fit:.2f} against {as_recorded:.2f} as recorded): give color pictures that are "
    "registered to the depth, or leave color and masks out"
)
_RULER = ", or give cloth.size_m, width and length as a ruler measures them"

UNIT_CHECKS = (
    Check(
        "clock_unit", picker.clock_units, None, "s", "frames: time_s",
        "the frames are {step_s:.3g} s apart{moves}: write time_s of frames and of picker.csv in "
        "seconds, by one clock{likely}",
    ),
    Check(
        "depth_unit", cameras.table_depths, None, "m", "cameras[{place}].depth_unit_m",
        "the depth of camera {camera!r} is {measured:.3g} m where the recorded table is {limit:.3g}"
        " m away: " + _UNIT, needs=["table"],
    ),
)  # fmt: skip
"""Where one of these fails, tracking would take hours."""

CHECKS = (
    *UNIT_CHECKS,
    Check(
        "clock_jump", picker.clock_jumps, None, "s", "frames[{next}]: time_s",
        "time_s steps by {measured:.6g} s from frame {frame} to frame {next} (at most {limit:.3g}):"
        " {remedy}", unless=frozenset({"clock_unit"}),
    ),
    Check(
        "frame_gap", picker.frame_gaps, None, "s", "frames[{next}]: time_s",
        "no frame for {measured:.2f} s after frame {frame} (at most {limit:.2f}), while the closed "
        "picker goes {gone_m:cm} cm: record without gaps, or end the action at the gap",
        unless=frozenset({"clock_unit"}),
    ),
    Check(
        "frame_spacing", picker.uneven_steps, 0.2, "", "frames: time_s",
        "{measured:pct} % of the times between frames differ by more than {most:pct} % from the "
        "middle one, {middle_s:.3g} s (at most {limit:pct} %): write the camera's own time stamps",
        unless=frozenset({"clock_unit"}), severity="note",
    ),
    Check(
        # Lenses of depth cameras are mounted to 2 %; another picture size is farther off.
        "principal_point", cameras.centers, 0.05, "", "cameras[{place}].cx, cy",
        "the principal point ({camera.cx:g}, {camera.cy:g}) of camera {camera.name!r} is "
        "{measured:pct} % of the picture from its middle ({x:g}, {y:g}) (at most {limit:pct} %): "
        "give fx, fy, cx and cy for pictures of {camera.width} x {camera.height} pixels; right "
        "only if these were cut out of larger ones",
    ),
    Check(
        # Pixels of sensors are square within 0.1 %; one real data set states 2.9 %.
        "focal_ratio", cameras.focal_ratios, 1.04, "", "cameras[{place}].fx, fy",
        "fx {camera.fx:g} and fy {camera.fy:g} of camera {camera.name!r} differ by {measured:more}"
        " % (at most {limit:more} %): pixels are square, correct the wrong one",
        unless=frozenset({"principal_point"}),
    ),
    Check(
        # A seam that was left open has less.
        "template_surface", cloth.double_vertices, 0.02, "", "cloth.template",
        "cloth.template is no surface of one cloth, {measured:pct} % of its vertices have a double "
        "within {weld:g} mm (at most {limit:pct} %), so its triangles are not joined: weld and "
        "repair it in a mesh editor (MeshLab: merge close vertices, remove duplicate faces), or "
        "leave it out", needs=["template"],
    ),
    Check(
        "camera_moved", cameras.table_motion, cameras.LARGEST_MOTION_M, "m", "frames",
        _PUSHED + "the table in its depth lies up to {measured:mm} mm from where it was at first "
        "(at most {limit:mm1} mm)" + _ALONE, needs=["table", "pictures"],
    ),
    Check(
        "camera_moved", cameras.picture_jumps, None, "px", "frames",
        _PUSHED + "the whole picture jumps by {measured:.0f} pixels there (at most {limit:.0f} "
        "pixels)" + _ALONE, needs=["pictures"], unless=frozenset({"camera_moved"}),
    ),
    Check(
        "color_turned", color.turns, None, "deg", "frames: color",
        _COLOR + "turned by {degrees:.0f} degrees (at most {limit:g})" + _REGISTERED,
        needs=["pictures"],
    ),
    Check(
        "color_shift", color.shifts, None, "px", "frames: color",
        _COLOR + "moved by ({x}, {y}) pixels (at most {limit:.0f})" + _REGISTERED,
        needs=["pictures"],
    ),
    Check(
        "camera_pose", cameras.table_tilts, cameras.LARGEST_TILT_DEG, "deg",
        "cameras[{place}].world_from_camera",
        "the table in the depth of camera {camera!r} is tilted by {measured:.1f} degrees against "
        "the recorded one (at most {limit:g}): " + _POSE,
        needs=["table"], unless=frozenset({"depth_unit"}),
    ),
    Check(
        "camera_pose", cameras.table_shifts, None, "m", "cameras[{place}].world_from_camera",
        "the table in the depth of camera {camera!r} is {measured:.3f} m under it, the recorded "
        "one {limit:.3f} m: " + _POSE + ", or correct the table",
        needs=["table"], unless=frozenset({"depth_unit"}),
    ),
    Check(
        "depth_unit", cloth.cloth_units, None, "m", "cameras[{place}].depth_unit_m",
        "the cloth is {measured:.3g} m long in the first frame and {limit:.3g} m by its size: "
        + _UNIT, needs=["depth", "cloth"], unless=_WORLD,
    ),
    Check(
        # From a cocktail napkin to a bath towel: a unit that is wrong by 4 makes 8 cm or 1.6 m of
        # a tea towel.
        "scale", cloth.longer_sides, (0.15, 1.3), "m", "cameras[0].depth_unit_m",
        "the cloth's longer side is {measured:.2g} m" + _SCALE + " ({unit_m:g})" + _RULER,
        needs=["table", "depth", "cloth", "no size", "no template"], unless=_WORLD,
    ),
    Check(
        # Depth cameras measure from 0.25 m on; at 2 m one pixel is as wide as a fold.
        "scale", cloth.camera_heights, (0.25, 2.0), "m", "cameras[0].depth_unit_m",
        "the camera is {measured:.2g} m above the table" + _SCALE + " ({unit_m:g})" + _RULER,
        needs=["table", "depth", "cloth", "no size", "no template"], unless=_WORLD,
    ),
    Check(
        # From the 94 degrees of an Azure Kinect to 39. Intrinsics of twice or half the picture
        # size lie outside, or nearly so.
        "scale", cloth.focal_lengths, (0.47, 1.4), "", "cameras[0].fx, fy",
        "fx and fy are {measured:.2g} of the picture's longer side" + _SCALE + _RULER,
        needs=["table", "depth", "cloth", "no size", "no template"], unless=_WORLD,
    ),
    Check(
        # On right recordings from -6 to 29 mm: clouds that were cut away above the table begin
        # higher.
        "cloth_height", cloth.lowest, (-0.02, 0.05), "m", "table",
        "the lowest part of the cloth is {measured:mm} mm above the table in the first frame "
        "({low:mm} to {high:mm}): correct table, or the world_from_camera of the cameras",
        needs=["table", "cloth"], unless=_WORLD,
    ),
    Check(
        "template", cloth.template_gaps, cloth.LARGEST_GAP_M, "m", "cloth.template",
        "the template lies {measured:mm} mm (rms) from the cloth of the first frame (at most "
        "{limit:mm}), whose middle is ({x:.2f} {y:.2f} {z:.2f}) m from its own: put cloth.template "
        "where the cloth is, in the world of the cameras, or leave it out",
        needs=["cloth", "template"], unless=_WORLD,
    ),
    Check(
        "template", cloth.template_sides, None, "m", "cloth.template",
        "the template is {sides[0]:.2f} x {sides[1]:.2f} m and the cloth of the first frame "
        "{seen[0]:.2f} x {seen[1]:.2f} m (a side may differ by {most:pct} %): scale "
        "cloth.template, or correct fx and fy of the camera",
        needs=["table", "cloth", "template"], unless=_WORLD | {"template"},
    ),
    Check(
        "template", cloth.template_fills, None, "", "cloth.template",
        "the cloth of the first frame covers {measured:pct} % of the rectangle around it, the "
        "template {limit:pct} % (they may differ by {most:pct} %): give the template of this "
        "garment (clothtrack garment makes it), or cloth.kind alone",
        needs=["table", "cloth", "template"], unless=_WORLD | {"template"},
    ),
    Check(
        # Below 4 mm on right recordings.
        "template", cloth.template_places, 0.012, "m",
        "cloth.template, cameras: world_from_camera",
        "the middle of the template is {measured:mm} mm beside that of the cloth in the first "
        "frame (at most {limit:mm}): put cloth.template where the cloth is; if it is right, the "
        "camera's pose is not (clothtrack calibrate-camera)",
        needs=["table", "cloth", "template"], unless=_WORLD | {"template"},
    ),
    Check(
        # Spread sleeves: 0.70 in simulation, and 0.76 of a boxy cut. A flat towel covers 1.02 to
        # 1.04, counted in whole squares.
        "garment_kind", cloth.shirt_fills, 0.92, "", "cloth.kind",
        "the cloth covers {measured:pct} % of the rectangle around it in the first frame, a "
        "T-shirt at most {limit:pct} %: correct cloth.kind, or begin with its sleeves spread out",
        needs=["table", "cloth", "no template"], unless=_CLOTH,
    ),
    Check(
        "size", cloth.flat_sizes, None, "m", "cloth.size_m",
        "the cloth of the first frame is {seen[0]:.2f} x {seen[1]:.2f} m and cloth.size_m says "
        "{size[0]:g} x {size[1]:g} m (a side may differ by {most:pct} %): correct cloth.size_m "
        "[width, length]{other}",
        needs=["table", "cloth"], unless=_CLOTH,
    ),
    Check(
        "cloth_over_edge", cloth.over_edge, cloth.LONGEST_AT_EDGE_M, "m", "frames[{frame}]",
        "{measured:cm} cm of the cloth's rim lie at the table's edge in frame {frame} (at most "
        "{limit:cm}), and what hangs over it is not tracked: keep the cloth on the table, or leave "
        "out the actions that move it there",
        needs=["table", "cloth", "pictures"], unless=_WORLD,
    ),
    Check(
        "picker_clock", picker.clock_lags, None, "s", "picker.csv: time_s",
        "the cloth moves {size:.2f} s {order} the closed picker does (at most {limit:.2f}): write "
        "time_s of picker.csv by the clock of the frames, {change} {size:.2f} s",
        unless=_PATH,
    ),
    Check(
        "picker_path", picker.never_closed, None, "", "picker.csv: closed",
        "picker {picker!r} is closed in no frame of action {action}: correct closed of picker.csv "
        "(1 while it holds cloth), or the frames of the action",
        unless=_PATH,
    ),
    Check(
        "picker_path", picker.closing_gaps, None, "m", "picker.csv: x_m, y_m, z_m",
        "picker {picker!r} closes {measured:mm} mm from the cloth at {time_s:g} s, in action "
        "{action} (at most {limit:mm}): write x_m, y_m, z_m of picker.csv in the world of the "
        "cameras, and closed as 1 while it holds cloth",
        unless=_PATH,
    ),
    Check(
        # On right recordings a quarter of the frames exceed 7 mm.
        "picker_path", picker.carried_gaps, 0.016, "m", "picker.csv: x_m, y_m, z_m",
        "no cloth is where picker {picker!r} carries it in action {action}, the nearest is "
        "{measured:mm} mm away (at most {limit:mm}): write x_m, y_m, z_m of picker.csv in the "
        "world of the cameras, and time_s by their clock",
        unless=_PATH,
    ),
)  # fmt: skip


def check_geometry(
    recording: Recording,
    frames: ObservedFrames | None = None,
    checks: Iterable[Check] = CHECKS,
) -> tuple[Finding, ...]:
    """Return where the pictures of a recording contradict it; empty for a right one.

    One error causes others, so a check is left out where what explains it has been found. What
    makes the world wrong comes first.
    """
    frames = frames or ObservedFrames(recording)
    found: list[Finding] = []
    for check in checks:
        explained = check.unless.intersection(one.kind for one in found)
        if not explained and all(_HAS[need](frames) for need in check.needs):
            found += [finding for each in check.measure(frames) for finding in _judged(check, each)]
    return tuple(sorted(found, key=lambda one: one.kind not in _CLOTH))


def _judged(check: Check, measured: Measured) -> Iterable[Finding]:
    """Yield the finding where a value is beyond its limit."""
    value = measured["measured"]
    if check.limit is not None:
        low, high = check.limit if isinstance(check.limit, tuple) else (-math.inf, check.limit)
        if low <= value <= high:
            return
        measured |= {"low": low, "high": high, "limit": low if value < low else high}
    field = check.field.format(**measured)
    yield Finding(
        check.kind, value, measured["limit"], measured.get("unit", check.unit), field,
        _Words().format(check.text, **measured, field=field),
        measured.get("severity", check.severity),
    )  # fmt: skip


_SHOWN: dict[str, Callable[[float], str]] = {
    "mm": lambda value: f"{1e3 * value:.0f}",
    "mm1": lambda value: f"{1e3 * value:.1f}",
    "cm": lambda value: f"{1e2 * value:.0f}",
    "pct": lambda value: f"{1e2 * value:.0f}",
    "more": lambda value: f"{1e2 * (value - 1):.0f}",
}
"""Lengths [m], shares, and by how much a ratio is over 1, as the texts show them."""


class _Words(Formatter):
    def format_field(self, value: Any, format_spec: str) -> str:
        """Return a value as a text shows it."""
        shown = _SHOWN.get(format_spec)
        return super().format_field(value, format_spec) if shown is None else shown(value)
