"""Bags, folders and logs as people have them, by `clothtrack import`: right, or a line that helps.

The pixel (0, 0) of depth picture k is 800 + 3k in `cases/`, so that a lost or swapped one shows.
"""

import json
import re
import shlex
import shutil
import subprocess
import sys
from itertools import count
from pathlib import Path

import cv2
import numpy as np
import pytest
from import_makers import (
    OPTICAL,
    START_NS,
    Film,
    Messages,
    color_of,
    depth_of,
    lens_file,
    png,
    stream,
    write_folder,
    write_kinect,
    write_ros1,
    write_ros2,
)

from clothtrack.cli import command_line as cli

CASES = Path(__file__).with_name("cases")
ROS2, ROS1 = Messages(cdr=True), Messages(cdr=False)
DEPTH, COLOR = "/camera/aligned_depth_to_color/image_raw", "/camera/color/image_raw"
PERIOD_NS = 33_333_333


@pytest.fixture
def run(tmp_path, capsys):
    """Run `clothtrack import SOURCE out WORDS...`, which ends with a code; return what it said."""

    def one(source, *words, code=0):
        shutil.rmtree(tmp_path / "out", ignore_errors=True)
        done = cli.main(["import", str(source), str(tmp_path / "out"), *map(str, words)])
        told = capsys.readouterr()
        assert done == code, told
        if code:
            assert told.err.count("\n") == 1, told.err
            assert "recording.json" not in told.err
            assert not (tmp_path / "out").exists()
        return told.out + told.err

    return one


@pytest.fixture
def bag(tmp_path):
    """Write messages, or those of a film, as a ROS 2 bag."""
    written = count()

    def one(entries=None, film=None):
        entries = stream(film or film_of(), ROS2) if entries is None else entries
        return write_ros2(tmp_path / f"bag{next(written)}", entries, ROS2)

    return one


@pytest.fixture
def out(tmp_path):
    return tmp_path / "out"


def advised(text, option):
    """The option with its value as the text advises it."""
    found = re.search(rf"{option}( [^\s,;]+)?", text)
    assert found, text
    return shlex.split(found[0])


def says(told, *words):
    """Check that all of the words were said."""
    assert not [word for word in words if word not in told], told


def moments(out):
    return [frame["time_s"] for frame in json.loads((out / "recording.json").read_text())["frames"]]


def actions(out):
    document = json.loads((out / "recording.json").read_text())
    return [(one["first_frame"], one["last_frame"]) for one in document["actions"]]


def film_of(frames=6, first=0):
    """Pictures like those of `cases/`: smooth, picture k with 800 + 3k at (0, 0)."""
    film = Film(frames=frames, width=64, height=48, f=60.0)
    rows, columns = np.mgrid[:48, :64]
    film.depth = (800 + rows // 4 + columns // 4)[None] + 3 * np.arange(first, first + frames)[
        :, None, None
    ]
    film.depth = film.depth.astype(np.uint16)
    return film


def restamped(film, stamps, written, *, color=None, messages=ROS2):
    """The messages of a camera with other stamps [ns] and times of writing."""
    color = stamps if color is None else color
    for k, log in enumerate(written):
        for topic in (DEPTH, COLOR):
            yield topic.rpartition("/")[0] + "/camera_info", log, messages.info(stamps[k], film)
        yield DEPTH, log, messages.image(stamps[k], film.depth[k], "16UC1")
        yield COLOR, log, messages.image(color[k], film.color[k], "rgb8")


def test_a_simulator_that_was_reset_is_noticed_and_the_times_of_writing_help(run, out):
    told = run(CASES / "clock-restart", code=1)
    says(told, "picture 6 has 1.007 s", "picture 5")
    told = run(CASES / "clock-restart", *advised(told, "--stamps"))
    takes = [first + 3 * k for first in (800, 1000) for k in range(6)]
    assert depth_of(out)[:, 0, 0].tolist() == takes
    assert moments(out)[6] == pytest.approx(5.0)


@pytest.mark.parametrize(
    "back_ns", [6 * PERIOD_NS, 100 * 10**9, 3 * PERIOD_NS], ids=["to the start", "far", "a little"]
)
@pytest.mark.parametrize("write", ["ros2", "sqlite", "ros1"])
def test_stamps_that_run_backwards(write, back_ns, run, out, tmp_path):
    film = film_of(12)
    written = film.times
    stamps = np.where(np.arange(12) < 6, film.times, film.times - back_ns)
    messages = ROS1 if write == "ros1" else ROS2
    entries = restamped(film, stamps, written, messages=messages)
    if write == "ros1":
        source = write_ros1(tmp_path / "film.bag", entries, messages)
    else:
        storage = "sqlite3" if write == "sqlite" else "mcap"
        source = write_ros2(tmp_path / "film", entries, messages, storage=storage)
    told = run(source, code=1)
    says(told, "picture 6", "picture 5")
    run(source, *advised(told, "--stamps"))
    assert depth_of(out)[:, 0, 0].tolist() == [800 + 3 * k for k in range(12)]


def test_a_clock_of_everything_set_back_keeps_the_order_of_writing(run, bag, out):
    film = film_of(12)
    times = np.where(np.arange(12) < 6, film.times, film.times - 50 * 10**9)
    source = bag(restamped(film, times, times))
    told = run(source, code=1)
    run(source, *advised(told, "--stamps"))
    assert depth_of(out)[:, 0, 0].tolist() == [800 + 3 * k for k in range(12)]


def test_messages_that_were_written_in_another_order_are_sorted(run, bag, out):
    film = film_of(12)
    order = [0, 2, 1, 3, 4, 7, 5, 6, 8, 9, 11, 10]
    stamps = film.times[order]
    film.depth, film.color = film.depth[order], film.color[order]
    source = bag(restamped(film, stamps, START_NS + PERIOD_NS * np.arange(12)))
    run(source)
    assert depth_of(out)[:, 0, 0].tolist() == [800 + 3 * k for k in range(12)]


def test_a_clock_that_was_set_forward_is_named(run, bag):
    told = run(CASES / "clock-set-forward")
    says(told, "jump", "between pictures 14 and 15", "86400.0 s")
    # Where the times of writing do not jump, they are the remedy.
    film = film_of(12)
    stamps = np.where(np.arange(12) < 6, film.times, film.times + 3600 * 10**9)
    source = bag(restamped(film, stamps, film.times))
    told = run(source)
    assert "jump" in told
    told = run(source, *advised(told, "--stamps"))
    assert "jump" not in told


def test_pictures_without_a_stamp_are_placed_and_named(run, bag, out):
    film = film_of(12)
    stamps = np.where(np.isin(np.arange(12), (4, 5)), 0, film.times)
    written = film.times + 20_000_000
    source = bag(restamped(film, stamps, written, color=film.times))
    assert "2 pictures of depth have no time stamp (the first is number 4" in run(source)
    assert np.allclose(moments(out), np.arange(12) / 30, atol=1e-6)


@pytest.mark.parametrize("offset_s", [3.0, -3600.0])
def test_depth_and_color_on_two_clocks(offset_s, run, bag, out):
    film = film_of(120)
    color = film.times + round(offset_s * 1e9)
    source = bag(restamped(film, film.times, film.times, color=color))
    told = run(source, code=1)
    says(told, "two clocks", f"{abs(offset_s):.3f} s")
    for option in ("--stamps", "--color-offset-s"):
        run(source, *advised(told, option))
        assert np.array_equal(color_of(out), film.color)


def test_lists_on_two_clocks_are_told_the_offset(run, out, tmp_path):
    film = film_of()
    source = write_folder(tmp_path / "film", film, "tum")
    lines = (source / "rgb.txt").read_text().splitlines()
    lines = [re.sub(r"^\d+", lambda found: str(int(found[0]) - 7200), line) for line in lines]
    (source / "rgb.txt").write_text("\n".join(lines))
    words = ["--intrinsics", lens_file(tmp_path / "lens.json", film), "--depth-unit-m", "0.001"]
    told = run(source, *words, code=1)
    assert "--tolerance-s" not in told
    run(source, *words, *advised(told, "--color-offset-s"))
    assert np.array_equal(color_of(out), film.color)


@pytest.mark.parametrize("names", ["suffixed", "prefixed"])
def test_names_that_differ_are_paired(names, run, out):
    told = run(CASES / "names-differ" / names)
    assert depth_of(out)[:, 0, 0].tolist() == [800, 803, 806, 809, 812, 815]
    assert len(color_of(out)) == 6
    assert np.allclose(moments(out), np.arange(6) / 30, atol=1e-6)
    assert "names of depth and color differ" in told


def renamed(tmp_path, depth, color, *, frames=6):
    """A folder in Open3D style with other names of the pictures."""
    film = film_of(frames)
    source = write_folder(tmp_path / "film", film, "open3d")
    for kind, name in (("depth", depth), ("color", color)):
        for k in range(frames):
            (source / kind / f"{k:06d}.png").rename(source / kind / f"{name(k)}.png")
    return source, film


@pytest.mark.parametrize(
    ("depth", "color"),
    [
        (lambda k: f"frame-{k:06d}.depth", lambda k: f"frame-{k:06d}.color"),
        (lambda k: f"{k}", lambda k: f"{k:04d}"),
        (lambda k: f"{k}", lambda k: f"{k + 1}"),
        (lambda k: f"D{k:03d}_a", lambda k: "abcdef"[k]),
        (lambda k: f"cam1_{k:04d}_depth", lambda k: f"cam1_{k:04d}_rgb"),
        (lambda k: f"{10 * k + 3}", lambda k: f"{10 * k + 4}"),
    ],
)
def test_siblings_of_names(depth, color, run, out, tmp_path):
    source, film = renamed(tmp_path, depth, color)
    told = run(source)
    assert np.array_equal(depth_of(out), film.depth)
    assert np.array_equal(color_of(out), film.color)
    assert "names of depth and color differ" in told


def test_two_series_of_names_are_refused(run, tmp_path):
    source, _ = renamed(tmp_path, lambda k: f"d{k:04d}", lambda k: f"c{k:04d}", frames=12)
    for kind in ("depth", "color"):
        shutil.copy(next((source / kind).iterdir()), source / kind / "take2_0001.png")
    assert "1 agree of 13 depth and 13 color" in run(source, code=1)


def test_names_that_do_not_match_in_number_are_asked_for(run, tmp_path):
    source, _ = renamed(tmp_path, lambda k: f"d{k}x", lambda k: "abcdef"[k])
    (source / "color" / "a.png").unlink()
    says(run(source, code=1), "6 depth and 5 color", "associations.txt")


@pytest.mark.parametrize(
    "name",
    [
        lambda ns: f"{ns // 10**9}.{ns % 10**9:09d}", str,
        lambda ns: str(ns // 1000), lambda ns: str(ns // 10**6),
        lambda ns: f"{ns // 10**9}_{ns % 10**9:09d}",
    ],
)  # fmt: skip
def test_names_that_are_times_give_the_times(name, run, out, tmp_path):
    film = film_of()
    times = film.times + 5_000_000 * np.array([0, 1, 0, 2, 0, 1])
    source, _ = renamed(tmp_path, lambda k: name(int(times[k])), lambda k: name(int(times[k])))
    assert "names of the pictures are their times" in run(source)
    assert np.allclose(moments(out), (times - times[0]) / 1e9, atol=1.1e-3)


def test_a_list_of_associations_is_the_list(run, out, tmp_path):
    film = film_of()
    source = write_folder(tmp_path / "film", film, "tum")
    depth, color = (sorted((source / kind).iterdir()) for kind in ("depth", "rgb"))
    lines = [f"{k}.01 rgb/{color[k].name} {k}.00 depth/{depth[k].name}" for k in (0, 2, 3)]
    (source / "associations.txt").write_text("# rgb, depth\n" + "\n".join(lines) + "\nnonsense\n")
    words = ["--intrinsics", lens_file(tmp_path / "lens.json", film), "--depth-unit-m", "0.001"]
    told = run(source, *words)
    assert np.array_equal(depth_of(out), film.depth[[0, 2, 3]])
    assert moments(out) == [0.0, 2.0, 3.0]
    says(told, "1 lines are not", "nonsense")


def test_masks_are_imported(run, out, tmp_path):
    film = film_of()
    source = write_folder(tmp_path / "film", film, "open3d")
    (source / "mask").mkdir()
    marked = np.zeros((48, 64), np.uint8)
    marked[10:20, 5:30] = 1
    for k in range(6):
        (source / "mask" / f"{k:06d}.png").write_bytes(png(marked if k != 2 else 255 * marked))
    told = run(source)
    assert "which pixels are cloth" not in told
    assert "6 files" in told
    masks = [cv2.imread(str(file), -1) for file in sorted((out / "mask").iterdir())]
    assert len(masks) == 6
    assert all(np.array_equal(mask, 255 * marked) for mask in masks)
    for file in (source / "mask").iterdir():
        file.rename(file.with_name(file.stem + "_mask.png"))
    run(source)
    assert len(list((out / "mask").iterdir())) == 6
    (source / "mask" / "000003_mask.png").unlink()
    (source / "mask" / "000004_mask.png").rename(source / "mask" / "other.png")
    told = run(source)
    assert "masks" in told or "of mask" in told


def test_what_is_not_recognized_in_a_folder_is_named(run, tmp_path):
    source = write_folder(tmp_path / "film", film_of(), "open3d")
    (source / "poses.txt").write_text("0 0 0\n")
    (source / "infrared").mkdir()
    (source / "depth" / "000006.tiff").write_bytes(b"II*")
    told = run(source)
    for word in ("poses.txt", "infrared/", "000006.tiff"):
        assert word in told


def test_lossless_compressed_depth_is_imported(run, out):
    for words in ([], ["--depth-topic", DEPTH], ["--depth-topic", DEPTH + "/compressed"]):
        run(CASES / "depth-compressed-png", *words)
        assert depth_of(out)[:, 0, 0].tolist() == [800, 803, 806, 809, 812, 815]


def test_lossy_compressed_depth_is_called_so(run, bag):
    film = film_of()
    jpeg = cv2.imencode(".jpg", (film.depth[0] // 4).astype(np.uint8))[1].tobytes()
    lossy = (
        "/camera/depth/image_raw/compressed",
        lambda _, time: ROS2.compressed(time, jpeg, "16UC1; jpeg compressed"),
    )
    entries = pictures(film, more=[lossy])
    says(
        run(bag(one for one in entries if one[0] != "/depth"), code=1),
        "changes depth",
        "compressedDepth",
    )


@pytest.mark.parametrize(
    "case",
    [
        ([], "time,x,y,z,qx,force\n0,0,0,0.5,1,2\n0.1,0,0,0.5,1,2\n", "not used: qx, force", 0),
        ([], "time,x,y,z,closed\n0,0,0,0.5,3\n0.1,0,0,0.5,255\n", "from 3 to 255", 1),
        ([], "time,x,y,z,closed\n0,0,0,0.5,0\n0.1,0,0,0.5,0.08\n", "from 0 to 0.08", 1),
        ([], "time,x,y,z\n0,0,0,500\n0.1,0,0,500\n", "log.csv", 1),
        (["--cloth-color", "mauve"], "", "--cloth-color", 1),
        (["--fps", "15"], "", "--fps not used", 0),
        (["--color-offset-s", "nan"], "", "below 1e9", 1),
        (["--color-offset-s", "1", "--without-color"], "", "no color", 1),
        (["--picker-csv", "k.csv", "--gripper-topic", "/g"], "", "column `closed`", 1),
        (["--color-topic", DEPTH], "", "topic of depth", 1),
        (["--depth-topic", COLOR], "", "no depth", 1),
        (["--world-frame", "a", "--world-from-camera", "b.json"], "", "give one of them", 1),
    ],
)
def test_words_and_logs_that_do_not_fit_are_named(run, bag, tmp_path, case):
    words, log, told, code = case
    if log:
        (tmp_path / "log.csv").write_text(log)
        words = ["--picker-csv", tmp_path / "log.csv"]
    assert told in run(bag(), *words, code=code)


def test_an_option_of_bags_is_not_used_for_folders(run, tmp_path):
    source = write_folder(tmp_path / "film", film_of(), "open3d")
    assert "--depth-topic" in run(source, "--depth-topic", "/x")


def test_floats_in_millimeters_are_told_and_imported(run, out):
    told = run(CASES / "float-millimeters", code=1)
    assert "831 units" in told
    run(CASES / "float-millimeters", *advised(told, "--depth-unit-m"))
    assert depth_of(out)[:, 0, 0].tolist() == [8000 + 30 * k for k in range(6)]


@pytest.mark.parametrize("unit", [1e-3, 1e-4, 2.5e-4])
def test_a_given_unit_that_cannot_be_is_told_with_the_median(unit, run, bag):
    film = film_of()
    source = bag(film=film)
    told = run(source, "--depth-unit-m", unit * 1000, code=1)
    assert "given by --depth-unit-m" in told
    run(source, *advised(told.partition("; give")[2], "--depth-unit-m"))


def test_a_scale_in_meters_per_unit_is_named(run, out):
    told = run(CASES / "depth-scale", code=1)
    assert "depth_scale 0.001 in intrinsics.json" in told
    run(CASES / "depth-scale", *advised(told, "--depth-unit-m"))
    assert depth_of(out)[0, 0, 0] == 800


@pytest.mark.parametrize("kind", ["message", "files"])
def test_a_wrong_byte_order_is_exchanged_and_said(kind, run, bag, out, tmp_path):
    film, swapped = film_of(), film_of()
    swapped.depth = film.depth.byteswap()
    if kind == "message":
        source = bag(pictures(swapped))
    else:
        source = write_folder(tmp_path / "film", swapped, "open3d")
    assert "order" in run(source)
    assert np.array_equal(depth_of(out), film.depth)


def test_the_only_other_pictures_are_the_color(run, out):
    assert "/rgb" in run(CASES / "color-not-named")
    assert len(color_of(out)) == 6


def test_pictures_and_topics_that_are_left_out_are_named(run, bag):
    film = film_of()
    shown = dict.fromkeys(
        ("/front", "/side"), lambda k, time: ROS2.image(time, film.color[k], "rgb8")
    )
    shown["/weather"] = lambda _, time: ROS2.value("Float32", 20.0)
    source = bag(pictures(film, more=shown.items()))
    told = run(source)
    for word in ("/front", "/side", "--color-topic", "/weather"):
        assert word in told
    assert "/side" in run(source, "--color-topic", "/front")


def test_an_infrared_picture_is_no_color(run, bag):
    film = film_of()
    infrared = ("/infra1", lambda k, time: ROS2.image(time, film.color[k][..., 0], "mono8"))
    assert "left out: /infra1" in run(bag(pictures(film, more=[infrared])))


def test_the_gripper_among_the_joints_of_an_arm(run, out):
    words = ["--picker-topic", "/tool", "--gripper-topic", "/joint_states",
             "--gripper-closed-below", "0.03"]  # fmt: skip
    assert "finger_joint1, finger_joint2" in run(CASES / "joints-of-the-arm", *words)
    assert actions(out) == [(10, 21)]


def jointed(names, values, *, alone=False):
    """A tool and the joints of an arm; value per frame of each joint."""
    film = film_of(30)
    entries = list(stream(film, ROS2))
    for k, time in enumerate(film.times.tolist()):
        entries.append(("/tool", time, ROS2.pose(time, OPTICAL, (0.01 * k, 0, 0.7))))
        now = [one[k] for one in values]
        groups = zip(names, now, strict=True) if alone else [(names, now)]
        entries += [("/joint_states", time, joints(time, *group)) for group in groups]
    return sorted(entries, key=lambda one: one[1])


def joints(time, names, values):
    return ROS2.make(
        "sensor_msgs/msg/JointState", header=ROS2.header(time, ""), name=[*np.atleast_1d(names)],
        position=np.atleast_1d(values), velocity=np.zeros(0), effort=np.zeros(0),
    )  # fmt: skip


@pytest.mark.parametrize("alone", [False, True])
def test_joints_that_no_name_tells_are_asked_for(alone, run, bag, out):
    closed = np.where((np.arange(30) >= 10) & (np.arange(30) < 20), 0.0, 0.08)
    names = ["j1", "j2", "j3", "j4", "m1"]
    source = bag(jointed(names, [np.full(30, 0.5)] * 4 + [closed], alone=alone))
    words = ["--picker-topic", "/tool", "--gripper-topic", "/joint_states",
             "--gripper-closed-below", "0.03"]  # fmt: skip
    if not alone:
        told = run(source, *words, code=1)
        says(told, "j1, j2, j3, j4, m1", "--gripper-joints")
    run(source, *words, "--gripper-joints", "m1")
    assert actions(out) == [(10, 20)]
    told = run(source, *words, "--gripper-joints", "m9", code=1)
    assert "m9" in told


@pytest.mark.parametrize("kind", ["apart", "overlapping", "twice"])
def test_two_takes_in_a_folder_are_listed(kind, run, out, tmp_path):
    folder = CASES / "two-takes-in-a-folder"
    if kind != "apart":
        folder = tmp_path / "takes"
        folder.mkdir()
        for number in range(2):
            film = film_of(90)
            film.times = film.times + (1_500_000_000 * number if kind == "overlapping" else 0)
            one = write_ros2(tmp_path / f"take{number}", stream(film, ROS2), ROS2)
            next(one.glob("*.mcap")).rename(folder / f"take{number}.mcap")
    told = run(folder, code=1)
    names = sorted(file.name for file in folder.glob("*.mcap"))
    assert all(name in told for name in names)
    run(re.search(r"such as (\S+)", told)[1])


def test_parts_are_ordered_by_time_whatever_their_names(run, out, tmp_path):
    folder = tmp_path / "parts"
    folder.mkdir()
    for name, first in (("b", 0), ("a", 6)):
        film = film_of(6, first)
        film.times = film.times + first * PERIOD_NS
        one = write_ros2(tmp_path / f"part{first}", stream(film, ROS2), ROS2)
        next(one.glob("*.mcap")).rename(folder / f"{name}.mcap")
    run(folder)
    assert depth_of(out)[:, 0, 0].tolist() == [800 + 3 * k for k in range(12)]


def test_a_log_of_coarse_times(run, out):
    log = CASES / "robot-log"
    says(
        run(log / "bag", "--picker-csv", log / "coarse_times.csv"), "7 rows", "resolution of 0.1 s"
    )
    lines = (out / "picker.csv").read_text().splitlines()[1:]
    assert [line.split(",")[2] for line in lines] == ["0.02", "0.07", "0.09"]


LOGS = {
    "semicolons": "time;x;y;z;closed\n0;0;0;0.5;0\n0.05;0.1;0;0.5;1\n0.15;0.2;0;0.5;0\n",
    "other units": "time_ms,x_mm,y_mm,z_mm,closed\n0,0,0,500,0\n50,100,0,500,1\n150,200,0,500,0\n",
    "remarks": "# Größe\ntime,x,y,z,closed\n0,0,0,0.5,0\n# später\n"
    "0.05,0.1,0,0.5,1\n0.15,0.2,0,0.5,0\n",
    "a header in a remark": "# time x y z\n".replace(" ", ",").replace("#,", "# ")
    + "0,0,0,0.5\n0.05,0.1,0,0.5\n0.15,0.2,0,0.5\n",
}


@pytest.mark.parametrize("encoding", ["utf-8", "latin-1", "utf-16"])
@pytest.mark.parametrize("kind", LOGS)
def test_logs_of_other_programs(kind, encoding, run, bag, out):
    log = out.with_name("log.csv")
    log.write_text(LOGS[kind], encoding=encoding)
    source = bag()
    run(source, "--picker-csv", log)
    lines = [line.split(",") for line in (out / "picker.csv").read_text().splitlines()[1:]]
    assert [float(line[2]) for line in lines] == [0.0, 0.1, 0.2]
    assert [float(line[0]) for line in lines] == [0.0, 0.05, 0.15]


def test_a_log_on_the_other_clock_is_told_the_option_that_fits(run, bag, tmp_path):
    film = film_of()
    source = bag(film=film)
    log = tmp_path / "log.csv"
    rows = [f"{time / 1e9:.6f},0,0,0.5" for time in film.times]
    log.write_text("\n".join(["time,x,y,z", *rows]))
    told = run(source, "--picker-csv", log, code=1)
    run(source, "--picker-csv", log, *advised(told, "--picker-clock"))
    log.write_text("time,x,y,z\n50,0,0,0.5\n51,0,0,0.5\n")
    for words in ([], ["--picker-clock", "source"]):
        told = run(source, "--picker-csv", log, *words, code=1)
        assert "--picker-clock" not in told


LENS = [60.0, 0, 31.5, 0, 60.0, 23.5, 0, 0, 1]
LENSES = {
    "by rows": {"width": 64, "height": 48, "intrinsic_matrix": LENS},
    "by columns": {"width": 64, "height": 48,
                   "intrinsic_matrix": np.reshape(LENS, (3, 3)).T.ravel().tolist()},
    "three rows": {"width": 64, "height": 48, "K": np.reshape(LENS, (3, 3)).tolist()},
    "nested": {"intrinsics": {"width": 64, "height": 48, "fx": 60, "fy": 60, "cx": 31.5,
                              "cy": 23.5}, "serial": "1"},
    "RealSense": {"width": 64, "height": 48, "fx": 60, "fy": 60, "ppx": 31.5, "ppy": 23.5,
                  "coeffs": [0, 0, 0, 0, 0]},
    "RealSense, with its model": {"color": {
        "width": 64, "height": 48, "fx": 60, "fy": 60, "ppx": 31.5, "ppy": 23.5,
        "model": "distortion.inverse_brown_conrady", "coeffs": [0.0] * 5}},
    "ROS": {"image_width": 64, "image_height": 48, "distortion_model": "plumb_bob",
            "camera_matrix": {"rows": 3, "cols": 3, "data": LENS}},
}  # fmt: skip


@pytest.mark.parametrize("kind", LENSES)
def test_lenses_of_other_programs(kind, run, out, tmp_path):
    source = write_folder(tmp_path / "film", film_of(), "bop")
    lens = tmp_path / "lens.json"
    lens.write_text(json.dumps(LENSES[kind]))
    run(source, "--intrinsics", lens, "--fps", "30", "--depth-unit-m", "0.001")
    camera = json.loads((out / "recording.json").read_text())["cameras"][0]
    assert [camera[name] for name in ("fx", "fy", "cx", "cy")] == [60.0, 60.0, 31.5, 23.5]


@pytest.mark.parametrize(
    ("change", "words"),
    [({"fy": None, "cy": None}, "fy, cy missing"),
     ({"model": "inverse_brown_conrady", "coeffs": [0.1, 0, 0, 0, 0]}, "rectify"),
     ({"width": 32, "height": 24}, "correct width and height in"), ({"skew": 0.1}, "skew")],
)  # fmt: skip
def test_a_lens_that_cannot_be_used_is_named(change, words, run, bag, tmp_path):
    lens = lens_file(tmp_path / "lens.json", film_of(), **change)
    told = run(bag(), "--intrinsics", lens, code=0 if "skew" in change else 1)
    assert words in told
    assert "width" not in change or (str(lens) in told and "--intrinsics" not in told)


def test_a_lens_that_changes_is_refused_with_both(run, bag, tmp_path):
    film, later = film_of(), film_of()
    later.f = 45.0
    source = bag(pictures(film, lens=lambda k: film if k < 3 else later))
    says(run(source, code=1), "60.0", "45.0")
    run(source, "--intrinsics", lens_file(tmp_path / "lens.json", film))


def test_a_camera_that_moves_is_refused_or_said(run, bag):
    film = film_of()
    entries = list(stream(film, ROS2))
    for k, time in enumerate(film.times.tolist()):
        entries.append(("/tf", time, ROS2.tf(time, "base", OPTICAL, (0.05 * k, 0, 1.0))))
    entries.sort(key=lambda one: one[1])
    source = bag(entries)
    told = run(source, "--world-frame", "base", code=1)
    assert "0.250 m" in told
    told = run(source)
    assert "0.250 m" in told


def test_a_scene_whose_camera_moves_is_refused(run, tmp_path):
    source = write_folder(tmp_path / "film", film_of(), "bop")
    content = json.loads((source / "scene_camera.json").read_text())
    for key, entry in content.items():
        entry |= {"depth_scale": 1.0, "cam_t_w2c": [100.0 * int(key), 0, 0]}
    (source / "scene_camera.json").write_text(json.dumps(content))
    assert "0.500 m" in run(source, "--fps", "30", code=1)


def test_an_encoding_that_changes_costs_those_frames_and_is_said(run, bag):
    film = film_of()
    meters = [*pictures(film, shown=(film.depth / 1000).astype(np.float32), encoding="32FC1")]
    assert "2 frames: depth of float32" in run(bag([*pictures(film)][:8] + meters[8:]))


def test_a_wrong_unit_of_a_kinect_file_is_told(run, tmp_path):
    rng = np.random.default_rng(0)
    depth = rng.integers(500, 900, (3, 288, 320)).astype(np.uint16)
    source = write_kinect(tmp_path / "film.mkv", depth, None, PERIOD_NS * np.arange(3))
    told = run(source, "--depth-unit-m", "1", code=1)
    run(source, *advised(told.partition("; give")[2], "--depth-unit-m"))


def test_a_name_that_is_no_text_is_refused_in_one_line(tmp_path, capsys):
    source = tmp_path / "take\udcff1"
    write_folder(source, film_of(), "open3d")
    assert cli.main(["import", str(source), str(tmp_path / "out")]) == 1
    told = capsys.readouterr().err
    assert "UTF-8" in told
    assert told.count("\n") == 1
    assert not (tmp_path / "out").exists()


def drawn(film, *, stamps=None, written=None, color=None, more=()):
    """The messages of a camera and of a robot in the order of writing."""
    written = film.times if written is None else written
    stamps = film.times if stamps is None else stamps
    return sorted([*restamped(film, stamps, written, color=color), *more], key=lambda one: one[1])


def test_names_without_trailing_zeros_are_in_order(run, out, tmp_path):
    source, film = renamed(
        tmp_path, lambda k: str(1700000000 + k / 5), lambda k: str(1700000000 + k / 5)
    )
    run(source)
    assert np.array_equal(depth_of(out), film.depth)
    assert np.allclose(moments(out), np.arange(6) / 5, atol=1e-6)


@pytest.mark.parametrize("off_s", [1.0, -1.2])
@pytest.mark.parametrize("kind", ["tool", "gripper", "tf"])
def test_a_robot_with_a_clock_of_its_own_is_refused(kind, off_s, run, bag, out):
    film = film_of(60)
    more = []
    for k, time in enumerate(film.times.tolist()):
        there = {one: int(time + off_s * 1e9 * (one == kind)) for one in ("tool", "gripper", "tf")}
        more.append(("/tool", time, ROS2.pose(there["tool"], OPTICAL, (0.005 * k, 0, 0.7))))
        joint = joints(there["gripper"], "finger", 0.0 if 20 <= k < 40 else 0.08)
        more.append(("/joints", time, joint))
        more.append(("/tf", time, ROS2.tf(there["tf"], OPTICAL, "hand", (0.005 * k, 0, 0.7))))
    source = bag(drawn(film, more=more))
    words = ["--gripper-topic", "/joints", "--gripper-closed-below", "0.03"]
    words += ["--picker-frame", "hand"] if kind == "tf" else ["--picker-topic", "/tool"]
    told = run(source, *words, code=1)
    says(told, "two clocks", f"{abs(off_s):.3f} s")
    run(source, *words, *advised(told, "--stamps"))
    assert actions(out) == [(20, 40)]


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_bag_that_was_written_topic_by_topic(storage, run, out, tmp_path):
    film = film_of(90)
    entries = sorted(restamped(film, film.times, film.times), key=lambda one: one[0])
    run(write_ros2(tmp_path / "bag", entries, ROS2, storage=storage))
    assert np.array_equal(depth_of(out), film.depth)
    assert np.array_equal(color_of(out), film.color)


def test_stamps_of_color_that_drift_or_are_late_are_named(run, bag):
    film = film_of(90)
    for shift_s, word in ((0.3, "0.300 s"), (np.linspace(0, 0.9, 90), "drifts")):
        color = film.times + np.asarray(shift_s * 1e9).astype(np.int64)
        source = bag(drawn(film, color=color))
        says(run(source), word, "--stamps written")
    source = bag(drawn(film, written=film.times + 200_000_000))
    assert "note" not in run(source)


def test_what_a_camera_writes_where_nothing_was_measured(run, bag, out):
    film, far = film_of(), film_of()
    film.depth[:, :30] = 65535
    run(bag(film=film))
    assert (depth_of(out)[:, :30] == 0).all()
    assert np.array_equal(depth_of(out)[:, 30:], film.depth[:, 30:])
    meters = (far.depth / 1000).astype(np.float32)
    meters[:, :30] = 1e4
    run(bag(pictures(far, shown=meters, encoding="32FC1")))
    assert depth_of(out)[0, 40, 0] == 10 * far.depth[0, 40, 0]


def test_depth_that_is_empty_or_changes_its_unit_is_called_so(run, bag, out):
    film = film_of()
    film.depth[0] = 0
    assert "0 everywhere" in run(bag(film=film))
    assert np.array_equal(depth_of(out), film.depth[1:])
    film.depth[:] = 0
    assert "all 6 depth pictures are 0 everywhere" in run(bag(film=film), code=1)
    film = film_of(12)
    film.depth[6:] *= 10
    assert "in picture 6" in run(bag(film=film), code=1)


def test_positions_that_are_lost_are_left_out(run, bag):
    film = film_of(12)
    more = [("/tool", time, ROS2.pose(time, OPTICAL, (np.nan if k < 3 else 0.01 * k, 0, 0.7)))
            for k, time in enumerate(film.times.tolist())]  # fmt: skip
    source = bag(drawn(film, more=more))
    assert "3 poses" in run(source, "--picker-topic", "/tool")


def test_masks_that_are_numbered_from_one_belong_to_their_moments(run, out, tmp_path):
    source = write_folder(tmp_path / "film", film_of(), "open3d")
    (source / "mask").mkdir()
    for k in range(6):
        marked = np.zeros((48, 64), np.uint8)
        marked[: k + 1] = 255
        (source / "mask" / f"{k + 1:06d}.png").write_bytes(png(marked))
    run(source)
    masks = [cv2.imread(str(file), -1) for file in sorted((out / "mask").iterdir())]
    assert [int((mask > 0).any(1).sum()) for mask in masks] == [1, 2, 3, 4, 5, 6]


def test_masks_with_the_names_of_color_pictures_that_were_taken_later(run, out, tmp_path):
    film = film_of()
    source = write_folder(tmp_path / "film", film, "tum")
    for file in sorted((source / "rgb").iterdir()):
        file.rename(file.with_name(f"c{file.name}"))
    lines = (source / "rgb.txt").read_text().replace("rgb/", "rgb/c").splitlines()
    lines = [re.sub(r"^(\d+\.\d)\d", r"\g<1>1", line) for line in lines]
    (source / "rgb.txt").write_text("\n".join(lines))
    shutil.copytree(source / "rgb", source / "mask")
    words = ["--intrinsics", lens_file(tmp_path / "lens.json", film), "--depth-unit-m", "0.001"]
    told = run(source, *words, "--tolerance-s", "0.1")
    frames = len(moments(out))
    assert len(list((out / "mask").iterdir())) == frames
    assert (f"{6 - frames} masks belong to no frame" in told) == (frames < 6)


def test_a_cut_out_of_the_sensor_moves_the_center(run, bag, out):
    entries = list(pictures(film_of()))
    for _, _, info in entries[::2]:
        info.width, info.height = 128, 96
        info.k[[2, 5]] = 63.5, 47.5
        info.roi.x_offset, info.roi.y_offset, info.roi.width, info.roi.height = 32, 24, 64, 48
    run(bag(entries))
    camera = json.loads((out / "recording.json").read_text())["cameras"][0]
    assert (camera["width"], camera["cx"], camera["cy"]) == (64, 31.5, 23.5)


def test_pictures_need_no_library_of_bags(tmp_path, out):
    source = write_folder(tmp_path / "film", film_of(), "open3d")
    bag = write_ros1(tmp_path / "film.bag", stream(film_of(), ROS1), ROS1)
    program = """
import sys
for name in ("lz4", "mcap", "rosbags", "zstandard", "av"):
    sys.modules[name] = None
from clothtrack.cli.command_line import main
sys.exit(main(sys.argv[1:]))
"""
    words = [sys.executable, "-c", program, "import"]
    done = subprocess.run([*words, source, out], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    done = subprocess.run(
        [*words, bag, tmp_path / "two"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 1
    assert "install with" in done.stderr
    assert done.stderr.count("\n") == 1


def pictures(film, *, shown=None, encoding="16UC1", lens=None, more=(), **attributes):
    """The messages of depth alone, and of `more` (topic, message of k and time)."""
    for k, time in enumerate(film.times.tolist()):
        yield "/camera_info", time, ROS2.info(time, lens(k) if lens else film)
        image = ROS2.image(time, (film.depth if shown is None else shown)[k], encoding)
        for name, value in attributes.items():
            setattr(image, name, value)
        yield "/depth", time, image
        for topic, message in more:
            yield topic, time, message(k, time)
