"""Depth carried to another camera, against closed forms and a slow reference."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clothtrack_capture.importing.intrinsics import Intrinsics, StereoCalibration
from clothtrack_capture.importing.registration import Registration

DEPTH = Intrinsics(48, 36, 40.0, 40.0, 23.5, 17.5)


UNIT_M = 1e-3


def calibration(color, pose, depth=DEPTH):
    return StereoCalibration(depth, color, pose, "test")


def registered(color, pose, depth=DEPTH):
    return Registration(calibration(color, pose, depth), UNIT_M)


def shifted(x=0.0, y=0.0, z=0.0, turn=(0.0, 0.0, 0.0)):
    pose = np.eye(4)
    pose[:3, :3] = cv2.Rodrigues(np.array(turn, dtype=float))[0]
    pose[:3, 3] = x, y, z
    return pose


def test_a_plane_moves_by_its_disparity():
    """A plane at 1 m and a camera 10 cm to the left: fx * b / z = 4 pixels."""
    counts = np.full((36, 48), 1000, dtype=np.uint16)
    carried = registered(DEPTH, shifted(x=0.1)).depth(counts)
    assert (carried[:, 4:] == 1000).all()
    assert (carried[:, :4] == 0).all()


def test_the_nearest_wins_and_holes_stay():
    counts = np.full((36, 48), 2000, dtype=np.uint16)
    counts[:, 20:24] = 500
    counts[10:14, 30:34] = 0
    carried = registered(DEPTH, shifted(x=0.05)).depth(counts)
    # The bar moves by 4 pixels, the wall by 1; what was behind the bar is not known.
    assert (carried[:, 24:28] == 500).all()
    assert (carried[:, 21:24] == 0).all()
    assert (carried[10:14, 31:35] == 0).all()
    assert set(np.unique(carried)) == {0, 500, 2000}


def reference(counts, calibration):
    """Every pixel's corners through the formulas, one by one; exact rectangles only."""
    depth, color, pose = calibration.depth, calibration.color, calibration.color_from_depth
    result = np.full((color.height, color.width), 10**6)
    for v in range(depth.height):
        for u in range(depth.width):
            if not counts[v, u]:
                continue
            z = counts[v, u] * UNIT_M
            spots, depths = [], []
            for du in (-0.5, 0.5):
                ray = np.array([(u + du - depth.cx) / depth.fx, (v + du - depth.cy) / depth.fy, 1])
                x, y, w = pose[:3, :3] @ (ray * z) + pose[:3, 3]
                spots.append((color.fx * x / w + color.cx, color.fy * y / w + color.cy))
                depths.append(w)
            value = int(np.mean(depths) / UNIT_M + 0.5)
            (a, b), (c, d) = spots
            for y in range(
                max(int(np.ceil(min(b, d))), 0), min(int(np.ceil(max(b, d))), color.height)
            ):
                for x in range(
                    max(int(np.ceil(min(a, c))), 0), min(int(np.ceil(max(a, c))), color.width)
                ):
                    result[y, x] = min(result[y, x], value)
    return np.where(result == 10**6, 0, result)


@settings(max_examples=8, deadline=None)
@given(
    st.floats(-0.05, 0.05), st.floats(-0.05, 0.05), st.floats(-0.1, 0.1), st.floats(-0.1, 0.1),
    st.integers(0, 1000),
)  # fmt: skip
def test_against_the_slow_reference(x, y, tilt, roll, seed):
    counts = np.random.default_rng(seed).integers(500, 700, (36, 48)).astype(np.uint16)
    pose = shifted(x, y, 0.01, (tilt, 0.02, roll))

    def one(moved_px):
        color = Intrinsics(56, 40, 52.0, 51.0, 28.0 + moved_px, 19.0 + moved_px)
        return calibration(color, pose)

    expected, carried = reference(counts, one(0)), Registration(one(0), UNIT_M).depth(counts)
    # A center exactly on an edge may fall on either side of it in single precision. Such
    # pixels change when the picture moves by a thousandth of a pixel; they are not compared.
    certain = (reference(counts, one(-1e-3)) == expected) & (
        reference(counts, one(1e-3)) == expected
    )
    covered = (expected > 0) & certain
    assert certain.mean() > 0.8
    same = np.abs(carried.astype(int) - expected)[covered] <= 1
    assert same.mean() > 0.999


def test_distortion_is_taken_out_of_depth():
    """A wall at 1 m stays a wall at 1 m, wherever its lens bent the rays."""
    bent = Intrinsics(48, 36, 40.0, 40.0, 23.5, 17.5, (-0.2, 0.05, 1e-3, -1e-3, 0.0))
    counts = np.full((36, 48), 1000, dtype=np.uint16)
    for color in (None, Intrinsics(48, 36, 60.0, 60.0, 23.5, 17.5)):
        carried = registered(color, np.eye(4), bent).depth(counts)
        assert (carried[6:30, 6:42] == 1000).all()


@pytest.mark.parametrize(
    ("distortion", "fisheye"),
    [((-0.2, 0.05, 1e-3, -1e-3), False), ((0.4, -0.2, 1e-3, 0, 0.1, 0.3, -0.1, 0.05), False),
     ((0.05, -0.01, 0.002, 0.0), True)],
)  # fmt: skip
def test_corner_rays_lead_back_to_their_corners(distortion, fisheye):
    lens = Intrinsics(64, 48, 50.0, 50.0, 31.5, 23.5, distortion, fisheye)
    rays = lens.corner_rays().reshape(-1, 2).astype(float)
    points = np.concatenate([rays, np.ones((len(rays), 1))], 1)[:, None]
    project = cv2.fisheye.projectPoints if fisheye else cv2.projectPoints
    back = project(points, np.zeros(3), np.zeros(3), lens.matrix, np.array(distortion))[0]
    columns, rows = np.meshgrid(np.arange(65) - 0.5, np.arange(49) - 0.5)
    expected = np.stack([columns.ravel(), rows.ravel()], 1)
    known = np.isfinite(rays).all(axis=1)
    assert known.mean() > 0.9
    assert np.abs(back.reshape(-1, 2) - expected)[known].max() < 0.5


def test_a_color_picture_is_straightened():
    """A point that the lens bent to a pixel stands where the straight pinhole has it."""
    lens = Intrinsics(64, 48, 50.0, 50.0, 31.5, 23.5, (-0.15, 0.02, 0.0, 0.0))
    target = np.array([[[0.3, -0.2, 1.0]]])
    bent = cv2.projectPoints(target, np.zeros(3), np.zeros(3), lens.matrix,
                             np.array(lens.distortion))[0].ravel()  # fmt: skip
    columns, rows = np.meshgrid(np.arange(64.0), np.arange(48.0))
    spot = np.exp(-((columns - bent[0]) ** 2 + (rows - bent[1]) ** 2) / 8)
    picture = np.repeat((255 * spot).astype(np.uint8)[..., None], 3, axis=2)
    straight = registered(lens, np.eye(4), lens).color(picture)[..., 0].astype(float)
    center = [(straight * axis).sum() / straight.sum() for axis in (columns, rows)]
    assert center == pytest.approx([0.3 * 50 + 31.5, -0.2 * 50 + 23.5], abs=0.15)
