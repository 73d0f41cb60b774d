"""All checks of the geometry, in the order in which one finding explains the next."""

from clothtrack.recordings.geometry_checks.camera_checks import camera_findings
from clothtrack.recordings.geometry_checks.cloth_checks import cloth_findings
from clothtrack.recordings.geometry_checks.finding import Finding, ObservedFrames
from clothtrack.recordings.geometry_checks.picker_checks import picker_findings
from clothtrack.recordings.geometry_checks.picker_clock import clock_findings
from clothtrack.recordings.recording import Recording


def check_geometry(recording: Recording) -> tuple[Finding, ...]:
    """Where what a recording says contradicts what its pictures show; empty for a right one.

    What stands in a wrong world is wrong for that reason alone: where a camera is doubted, cloth
    and picker are not looked at, nor the path of a picker whose clock is.
    """
    cameras = camera_findings(recording)
    if cameras:
        return tuple(cameras)
    frames = ObservedFrames(recording)
    cloth = cloth_findings(recording, frames)
    if any(finding.check in ("depth unit", "cloth height") for finding in cloth):
        return tuple(cloth)
    clock = clock_findings(recording, frames)
    return (*cloth, *(clock or picker_findings(recording, frames)))
