# SPDX-License-Identifier: MIT
"""What the plain sink writes, the plain reader reads back exactly."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from helpers.recorded_room import SMALL, color_picture, depth_picture, poses
from threedvc.errors import ConfigError, OutputError, SequenceError
from threedvc.formats.sinks import PlainSink
from threedvc.formats.sources import FolderSequence, open_sequence
from threedvc.frames.frame import Frame, SequenceInfo
from threedvc.geometry.camera import Camera, CameraRig
from threedvc.geometry.pose import identity, make_pose, rotation_from_vector

FRAMES = 4
SCALE = 5000.0
INFO = SequenceInfo(name="room", rig=CameraRig.registered_to(SMALL), depth_scale=SCALE, fps=29.97, frame_count=FRAMES)


def regular(index: int) -> int:
    return round(index * 1e9 / 29.97)


def frames(count: int = FRAMES) -> list[Frame]:
    return [
        Frame(
            index=k,
            timestamp_ns=regular(k),
            color=color_picture(SMALL, pose),
            depth=depth_picture(SMALL, pose, SCALE).astype(np.float32) / np.float32(SCALE),
            mask=np.full((SMALL.height, SMALL.width), k, np.uint8),
            T_world_camera=pose,
            T_camera_object={1: np.linalg.inv(pose), 7: pose},
        )
        for k, pose in enumerate(poses(count))
    ]


def written(folder: Path, given: list[Frame], info: SequenceInfo = INFO) -> FolderSequence:
    with PlainSink(folder, info) as sink:
        for frame in given:
            sink.write_frame(frame)
    return open_sequence(folder)


def assert_same(read: Frame, given: Frame) -> None:
    assert (read.timestamp_ns, read.color_timestamp_ns) == (given.timestamp_ns, given.color_timestamp_ns)
    assert np.array_equal(read.color, given.color)
    assert np.array_equal(read.depth, given.depth)
    assert read.mask is not None
    assert given.mask is not None
    assert np.array_equal(read.mask, given.mask)
    if given.T_world_camera is None:
        assert read.T_world_camera is None
    else:
        assert read.T_world_camera is not None
        assert np.allclose(read.T_world_camera, given.T_world_camera, atol=1e-9, rtol=0)
    assert read.T_camera_object.keys() == given.T_camera_object.keys()
    for label, pose in given.T_camera_object.items():
        assert np.allclose(read.T_camera_object[label], pose, atol=1e-9, rtol=0)


def test_round_trip(tmp_path: Path) -> None:
    sequence = written(tmp_path / "out", frames())
    for read, given in zip(sequence, frames(), strict=True):
        assert_same(read, given)
    info = sequence.info
    assert (info.depth_scale, info.fps, info.gray) == (SCALE, 29.97, False)
    assert (info.has_camera_poses, info.has_object_poses, info.has_masks) == (True, True, True)
    assert info.rig.registered
    assert info.rig.color == SMALL


def test_layout_on_disk(tmp_path: Path) -> None:
    folder = tmp_path / "deep" / "out"
    written(folder, frames(2))
    assert sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()) == [
        "color/000000.png",
        "color/000001.png",
        "depth/000000.png",
        "depth/000001.png",
        "intrinsics.json",
        "masks/000000.png",
        "masks/000001.png",
        "object_poses.json",
        "poses.txt",
    ]
    assert json.loads((folder / "intrinsics.json").read_text()) == {
        "width": 64,
        "height": 48,
        "fx": 60.0,
        "fy": 61.0,
        "cx": 31.0,
        "cy": 24.5,
        "depth_scale": 5000.0,
        "fps": 29.97,
        "written_by": "3dvc decode",
        "complete": True,
    }


def test_gray_stays_one_channel(tmp_path: Path) -> None:
    given = [replace(frame, color=np.repeat(frame.color[..., :1], 3, axis=2)) for frame in frames()]
    sequence = written(tmp_path, given, replace(INFO, gray=True))
    assert sequence.info.gray
    assert (tmp_path / "color" / "000000.png").read_bytes()[25] == 0  # PNG color type: gray
    for read, frame in zip(sequence, given, strict=True):
        assert_same(read, frame)


def test_two_distorted_cameras(tmp_path: Path) -> None:
    rig = CameraRig(
        color=Camera(
            width=80, height=50, fx=70.25, fy=71.5, cx=40.125, cy=25.0, distortion=(0.1, -0.2, 0.01, 0.02, 0.3)
        ),
        depth=SMALL,
        T_color_depth=make_pose(rotation_from_vector(np.array([0.01, 0.02, 0.03])), np.array([0.05, 0.01, 0.002])),
    )
    given = [replace(frame, color=np.zeros((50, 80, 3), np.uint8) + np.uint8(frame.index)) for frame in frames()]
    sequence = written(tmp_path, given, replace(INFO, rig=rig))
    assert (sequence.info.rig.color, sequence.info.rig.depth) == (rig.color, rig.depth)
    assert np.allclose(sequence.info.rig.T_color_depth, rig.T_color_depth, atol=1e-12)
    for read, frame in zip(sequence, given, strict=True):
        assert_same(read, frame)


def test_irregular_clock_is_kept(tmp_path: Path) -> None:
    start = 1_700_000_000_123_456_789
    given = [replace(frame, timestamp_ns=start + frame.index**2) for frame in frames()]
    given[2] = replace(given[2], color_timestamp_ns=start - 5)
    for read, frame in zip(written(tmp_path, given), given, strict=True):
        assert_same(read, frame)


def test_numbers_may_begin_anywhere_and_have_gaps(tmp_path: Path) -> None:
    given = [replace(frame, index=17 + 2 * frame.index, timestamp_ns=regular(2 * frame.index)) for frame in frames()]
    sequence = written(tmp_path, given)
    assert (tmp_path / "color" / "000023.png").is_file()
    assert not (tmp_path / "timestamps.txt").exists()
    for read, frame in zip(sequence, given, strict=True):
        assert_same(read, frame)


def test_poses_not_known(tmp_path: Path) -> None:
    given = frames()
    given[1] = replace(given[1], T_world_camera=None, T_camera_object={7: identity()})
    for read, frame in zip(written(tmp_path / "some", given), given, strict=True):
        assert_same(read, frame)
    given = [replace(frame, T_world_camera=None, T_camera_object={}) for frame in given]
    sequence = written(tmp_path / "none", given)
    assert not sequence.info.has_camera_poses
    assert not (tmp_path / "none" / "poses.txt").exists()
    assert not (tmp_path / "none" / "object_poses.json").exists()


def test_depth_that_16_bits_cannot_hold_is_no_measurement(tmp_path: Path) -> None:
    given = frames(1)[0]
    depth = given.depth.copy()
    depth[0, :5] = [np.nan, np.inf, -1.0, 65534 / SCALE, 65535 / SCALE]
    read = written(tmp_path, [replace(given, depth=depth)])[0]
    assert np.array_equal(read.depth[0, :5], np.array([0, 0, 0, 65534 / SCALE, 0], np.float32))
    assert np.array_equal(read.depth[1:], depth[1:])


def test_saturated_pixels_are_written_as_such(tmp_path: Path) -> None:
    given = frames(2)
    depth = given[0].depth.copy()
    depth[:3] = 0
    marks = np.zeros(depth.shape, dtype=np.bool_)
    marks[2:5] = True
    sequence = written(tmp_path, [replace(given[0], depth=depth, saturated=marks), given[1]])
    raw = cv2.imread(str(tmp_path / "depth" / "000000.png"), cv2.IMREAD_UNCHANGED)
    assert [int((raw[row] == 65535).sum()) for row in range(4)] == [0, 0, raw.shape[1], 0]
    assert np.array_equal(sequence[0].depth, depth)
    assert sequence[1].saturated is None


def test_arrays_may_be_reused_after_write(tmp_path: Path) -> None:
    given = frames()
    buffers = [given[0].color.copy(), given[0].depth.copy(), np.zeros((48, 64), np.uint8)]
    with PlainSink(tmp_path, INFO, threads=2) as sink:
        for frame in given:
            assert frame.mask is not None
            for buffer, content in zip(buffers, (frame.color, frame.depth, frame.mask), strict=True):
                buffer[...] = content
            color, depth, labels = buffers
            sink.write(frame.index, frame.timestamp_ns, color=color, depth=depth, labels=labels)
            for buffer in buffers:
                buffer[...] = 0
    for read, frame in zip(open_sequence(tmp_path), given, strict=True):
        assert np.array_equal(read.color, frame.color)
        assert np.array_equal(read.depth, frame.depth)


def test_bytes_do_not_depend_on_the_number_of_threads(tmp_path: Path) -> None:
    for threads in (1, 4):
        with PlainSink(tmp_path / str(threads), INFO, threads=threads) as sink:
            for frame in frames():
                sink.write_frame(frame)
    names = [path.relative_to(tmp_path / "1") for path in (tmp_path / "1").rglob("*") if path.is_file()]
    assert len(names) == 3 * FRAMES + 3
    for name in names:
        assert (tmp_path / "1" / name).read_bytes() == (tmp_path / "4" / name).read_bytes()


@pytest.mark.parametrize("what", [{"color"}, {"depth", "labels"}])
def test_only_what_is_asked_for(tmp_path: Path, what: set[str]) -> None:
    with PlainSink(tmp_path, INFO, what=what) as sink:
        sink.write_frame(frames(1)[0])
    folders = {"color": "color", "depth": "depth", "labels": "masks"}
    assert {path.name for path in tmp_path.iterdir() if path.is_dir()} == {folders[part] for part in what}


@pytest.mark.parametrize(("what", "named"), [({"sound", "depth"}, "sound"), (set(), "")])
def test_unknown_part(tmp_path: Path, what: set[str], named: str) -> None:
    with pytest.raises(ConfigError) as caught:
        PlainSink(tmp_path, INFO, what=what)
    assert str(caught.value) == f"--what {named}: choose from color,depth,labels"


def test_frames_come_in_order(tmp_path: Path) -> None:
    with PlainSink(tmp_path, INFO) as sink:
        sink.write_frame(frames()[1])
        with pytest.raises(ConfigError, match="frame 1 follows frame 1; write frames in order"):
            sink.write_frame(frames()[1])


def test_earlier_output_is_replaced_and_foreign_files_stay(tmp_path: Path) -> None:
    given = frames()
    written(tmp_path, [replace(frame, timestamp_ns=7 * frame.index) for frame in given])
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "color" / "thumbnail.txt").write_text("mine")
    bare = [replace(frame, mask=None, T_world_camera=None, T_camera_object={}) for frame in given[:2]]
    sequence = written(tmp_path, bare)
    assert len(sequence) == 2
    assert sequence[1].timestamp_ns == regular(1)
    assert not sequence.info.has_masks
    assert sorted(path.name for path in tmp_path.iterdir()) == ["color", "depth", "intrinsics.json", "notes.txt"]
    assert (tmp_path / "color" / "thumbnail.txt").read_text() == "mine"


@pytest.mark.parametrize("name", ["intrinsics.json", "poses.txt", "timestamps.txt"])
def test_a_recording_is_never_overwritten(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text("{}")
    with pytest.raises(OutputError) as caught:
        PlainSink(tmp_path, INFO)
    assert str(caught.value) == (
        f"{tmp_path}: holds a recording that 3dvc decode did not write; choose another folder, or give --force"
    )
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_recordings_of_other_commands_stay(tmp_path: Path) -> None:
    for maker in ("3dvc synth", "3dvc"):
        with PlainSink(tmp_path, INFO, writer=maker, force=True) as sink:
            sink.write_frame(frames(1)[0])
        before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
        with pytest.raises(OutputError) as caught:
            PlainSink(tmp_path, INFO)
        assert str(caught.value) == (
            f"{tmp_path}: holds a recording that {maker} wrote; choose another folder, or give --force"
        )
        assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


def test_force_leaves_no_picture_of_another_recording(tmp_path: Path) -> None:
    (tmp_path / "color").mkdir()
    for name in ("0000.png", "7.JPG", "notes.txt"):
        (tmp_path / "color" / name).write_bytes(b"mine")
    with PlainSink(tmp_path, INFO, force=True) as sink:
        sink.write_frame(frames(1)[0])
    assert sorted(path.name for path in (tmp_path / "color").iterdir()) == ["000000.png", "notes.txt"]
    assert len(open_sequence(tmp_path)) == 1


def test_nothing_is_touched_before_the_first_frame(tmp_path: Path) -> None:
    earlier, absent = tmp_path / "earlier", tmp_path / "absent"
    written(earlier, frames())
    before = {path: path.read_bytes() for path in earlier.rglob("*") if path.is_file()}
    for folder in (earlier, absent):
        with pytest.raises(ConfigError), PlainSink(folder, INFO):
            raise ConfigError("nothing comes")
    assert {path: path.read_bytes() for path in earlier.rglob("*") if path.is_file()} == before
    assert not absent.exists()


def test_two_sinks_in_one_folder(tmp_path: Path) -> None:
    first, second = PlainSink(tmp_path, INFO), PlainSink(tmp_path, INFO)
    first.write_frame(frames(1)[0])
    with pytest.raises(OutputError, match=r"is being written by another 3dvc; wait for it, or choose another folder$"):
        second.write_frame(frames(1)[0])
    first.close()
    assert len(open_sequence(tmp_path)) == 1


def test_foreign_files_alone_are_no_recording(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    assert len(written(tmp_path, frames())) == FRAMES


def test_target_is_a_file(tmp_path: Path) -> None:
    path = tmp_path / "out"
    path.write_text("mine")
    with pytest.raises(OutputError) as caught:
        PlainSink(path, INFO)
    assert str(caught.value) == f"{path}: is a file; choose another folder"


def test_unwritable_target(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    path = tmp_path / "file" / "out"
    sink = PlainSink(path, INFO)
    with pytest.raises(OutputError) as caught:
        sink.write_frame(frames(1)[0])
    assert str(caught.value) == (f"{path}: cannot be written (Not a directory); free space or choose another folder")


def test_failing_picture_is_reported(tmp_path: Path) -> None:
    sink = PlainSink(tmp_path, INFO)
    sink.write_frame(frames(2)[0])
    (tmp_path / "color" / "000001.png").mkdir(parents=True)
    sink.write_frame(frames(2)[1])
    with pytest.raises(OutputError) as caught:
        sink.close()
    assert str(caught.value) == (
        f"{tmp_path / 'color' / '000001.png'}: cannot be written (Is a directory); free space or choose another folder"
    )
    sink.close()
    assert json.loads((tmp_path / "intrinsics.json").read_text())["complete"] is False


def test_output_that_ends_early_is_valid_input(tmp_path: Path) -> None:
    def stop(sink: PlainSink) -> None:
        for frame in frames()[:3]:
            sink.write_frame(frame)
        raise SequenceError("the stream ends here")

    with pytest.raises(SequenceError, match="the stream ends here"), PlainSink(tmp_path, INFO) as sink:
        stop(sink)
    sequence = open_sequence(tmp_path)
    assert len(sequence) == 3
    for read, given in zip(sequence, frames(), strict=False):
        assert_same(read, given)
    assert json.loads((tmp_path / "intrinsics.json").read_text())["complete"] is False
    written(tmp_path, frames(1))
    assert len(open_sequence(tmp_path)) == 1
