# SPDX-License-Identifier: MIT
"""Several sensors that are mounted together: one sequence, one model, one stream, and every sensor's own pictures."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from helpers.streams import ListSequence
from threedvc.config import ColorVideo, EncoderConfig, Motion, Preset, with_preset
from threedvc.encoder.pipeline.encoder import Encoder
from threedvc.encoder.reconstruction.extrinsic_calibration import calibrate_extrinsics
from threedvc.encoder.reconstruction.scene import Scene
from threedvc.encoder.tracking.pose_fusion import PoseEstimate, fused_pose
from threedvc.errors import ConfigError, CorruptStream
from threedvc.formats.decoding import DecodedFrame, open_stream
from threedvc.formats.encoding import encode
from threedvc.formats.evaluation.statistics import statistics
from threedvc.frames.frame import Frame
from threedvc.frames.multi_sensor import MergedSequence
from threedvc.frames.sequence import FrameSequence, frame_sets
from threedvc.geometry.pose import Pose, identity, inverse, make_pose, rotation_angle, rotation_from_vector
from threedvc.metrics.trajectory import trajectory_error
from threedvc.stream.sensor_order import SensorSlot, pack_cycle, shortest_cycle, unpack_cycle
from threedvc.synthesis import SyntheticSequence, make_scene, mounted_sequences
from threedvc.units import NANOSECONDS

FRAMES = 8
PERIOD_NS = NANOSECONDS // 30
MS = NANOSECONDS // 1000
FAST = with_preset(
    EncoderConfig(color_video=ColorVideo.OFF, voxel_size_m=0.04, motion=Motion.TRACK, threads=1), Preset.FAST
)
pytestmark = pytest.mark.usefixtures("quick_av1")


def in_memory(sequence: FrameSequence, *, offset_ns: int = 0, step: int = 1, blind: bool = False) -> ListSequence:
    """Return every n-th frame of a sequence, later by an offset, and without depth if it is to be blind."""
    frames = [
        replace(
            frame,
            index=number,
            timestamp_ns=frame.timestamp_ns + offset_ns,
            depth=np.zeros_like(frame.depth) if blind and number else frame.depth,
        )
        for number, frame in enumerate(list(sequence)[::step])
    ]
    return ListSequence(frames, replace(sequence.info, fps=sequence.info.fps / step, frame_count=len(frames)))


@pytest.fixture(scope="module")
def room() -> tuple[list[ListSequence], Pose]:
    """What two sensors see of a room, and where the second one is."""
    (left, _), (right, T) = mounted_sequences(make_scene("room", frames=FRAMES, size=(96, 72)), 2, "kinect", threads=1)
    return [in_memory(left), in_memory(right)], T


def without_poses(sequence: ListSequence) -> ListSequence:
    frames = [replace(frame, T_world_camera=None) for frame in sequence.frames]
    return ListSequence(frames, replace(sequence.info, has_camera_poses=False))


def beginning(sequence: ListSequence, count: int) -> ListSequence:
    """Return the first frames."""
    return ListSequence(sequence.frames[:count], replace(sequence.info, frame_count=count))


def decoded(stream: bytes, **choices: object) -> list[DecodedFrame]:
    return list(open_stream(io.BytesIO(stream), **choices))  # type: ignore[arg-type]


def encoded(sequence: FrameSequence, config: EncoderConfig = FAST) -> bytes:
    sink = io.BytesIO()
    encode(sequence, sink, config, verify=True)
    return sink.getvalue()


@pytest.fixture(scope="module")
def stream(room: tuple[list[ListSequence], Pose], quick_av1: None) -> bytes:
    """Both sensors' frames, encoded."""
    (left, right), T = room
    return encoded(MergedSequence([left, right], [T]))


def within_1pct(drawn: Sequence[DecodedFrame], given: Sequence[Frame]) -> float:
    shares = []
    for one, other in zip(drawn, given, strict=True):
        seen = other.depth > 0
        shares.append(np.mean(np.abs(one.depth[seen] - other.depth[seen]) < 0.01 * other.depth[seen]))
    return float(np.mean(shares))


class TestMerging:
    def test_frames_come_in_order_of_time(self, room: tuple[list[ListSequence], Pose]) -> None:
        (left, right), T = room
        merged = MergedSequence([left, in_memory(right, offset_ns=PERIOD_NS // 3, step=2)], [T])
        frames = list(merged)
        assert [frame.sensor for frame in frames] == [0, 1, 0, 0, 1, 0, 0, 1, 0, 0, 1, 0]
        assert [frame.index for frame in frames] == list(range(12))
        times = [frame.timestamp_ns for frame in frames]
        assert times == sorted(times)
        assert not any(frame.synchronized for frame in frames)
        assert merged.info.fps == pytest.approx(45, rel=0.01)
        np.testing.assert_array_equal(merged[4].color, frames[4].color)

    def test_equal_times_are_one_moment(self, room: tuple[list[ListSequence], Pose]) -> None:
        (left, right), T = room
        merged = MergedSequence([left, in_memory(right, offset_ns=MS // 2)], [T])
        assert [frame.synchronized for frame in merged] == [False, True] * FRAMES
        assert [len(moment) for moment in frame_sets(merged, merged.info)] == [2] * FRAMES
        assert merged[1].timestamp_ns == MS // 2

    def test_a_delay_brings_clocks_together(self, room: tuple[list[ListSequence], Pose]) -> None:
        (left, right), T = room
        late = in_memory(right, offset_ns=5 * NANOSECONDS)
        assert [frame.synchronized for frame in MergedSequence([left, late], [T], [-5 * NANOSECONDS])] == [
            False, True
        ] * FRAMES  # fmt: skip

    def test_poses_of_one_sensor_serve_all(self, room: tuple[list[ListSequence], Pose]) -> None:
        (left, right), T = room
        merged = MergedSequence([left, without_poses(right)], [T])
        for given, frame in zip(right, list(merged)[1::2], strict=True):
            assert given.T_world_camera is not None
            assert frame.T_world_camera is not None
            np.testing.assert_allclose(frame.T_world_camera, given.T_world_camera, atol=1e-9)
        between = MergedSequence([left, in_memory(without_poses(right), offset_ns=PERIOD_NS // 2)], [T])[1]
        ends = [left[k].T_world_camera for k in (0, 1)]
        assert between.T_world_camera is not None
        middle = between.T_world_camera @ inverse(T)
        halfway = np.mean([end[:3, 3] for end in ends if end is not None], axis=0)
        np.testing.assert_allclose(middle[:3, 3], halfway, atol=1e-6)

    def test_wrong_numbers(self, room: tuple[list[ListSequence], Pose]) -> None:
        (left, right), T = room
        with pytest.raises(ConfigError, match="2 sensors need 1 extrinsics and delays, not 2 and 1"):
            MergedSequence([left, right], [T, T])
        with pytest.raises(ConfigError, match="1 recordings cannot be merged"):
            MergedSequence([left], [])


class TestJointPose:
    def test_each_tells_what_it_knows(self) -> None:
        along_x, along_y = (np.diag([1e4, 1e4, 1e4, *place]) for place in ([1e6, 1.0, 1e6], [1.0, 1e6, 1e6]))
        places = make_pose(np.eye(3), np.array([0.01, 0.5, 0.0])), make_pose(np.eye(3), np.array([0.3, 0.02, 0.0]))
        found = fused_pose(
            [PoseEstimate(pose, identity(), say) for pose, say in zip(places, (along_x, along_y), strict=True)]
        )
        np.testing.assert_allclose(found[:3, 3], [0.01, 0.02, 0.0], atol=1e-3)

    def test_directions_are_those_of_each_view(self) -> None:
        quarter = make_pose(rotation_from_vector(np.array([0.0, 0.0, np.pi / 2])), np.zeros(3))
        sure_of_x = np.diag([1e4, 1e4, 1e4, 1e6, 1.0, 1.0])
        one, other = (make_pose(np.eye(3), np.array(place)) for place in ([0.1, 0.2, 0.0], [0.3, 0.4, 0.0]))
        found = fused_pose([PoseEstimate(one, identity(), sure_of_x), PoseEstimate(other, quarter, sure_of_x)])
        np.testing.assert_allclose(found[:3, 3], [0.1, 0.4, 0.0], atol=1e-3)

    def test_what_nobody_knows_follows_the_first(self) -> None:
        nothing = np.zeros((6, 6))
        pose = make_pose(rotation_from_vector(np.array([0.1, 0.0, 0.2])), np.array([1.0, 2.0, 3.0]))
        np.testing.assert_allclose(fused_pose([PoseEstimate(pose, identity(), nothing)] * 2), pose, atol=1e-12)


class TestTurns:
    def test_the_shortest_cycle(self) -> None:
        turns = [SensorSlot(sensor, synchronized=False) for sensor in (0, 1, 0, 0, 1, 0, 0, 1)]
        assert shortest_cycle(turns) == tuple(turns[:3])
        assert shortest_cycle(turns[:1]) == (turns[0],)

    def test_round_trip(self) -> None:
        cycle = (
            SensorSlot(0, synchronized=False),
            SensorSlot(200, synchronized=True),
            SensorSlot(3, synchronized=False),
        )
        assert unpack_cycle(pack_cycle(cycle), 201) == cycle

    @pytest.mark.parametrize(("payload", "message"), [(b"", "no turns"), (b"\x04", "sensor 2, but the stream has 2")])
    def test_damage(self, payload: bytes, message: str) -> None:
        with pytest.raises(CorruptStream, match=message):
            unpack_cycle(payload, 2)


class TestStream:
    @pytest.mark.parametrize("offset_ns", [0, PERIOD_NS // 3], ids=["synchronized", "apart"])
    @pytest.mark.parametrize("preset", ["live", "fast", pytest.param("medium", marks=pytest.mark.long)])
    def test_every_sensor_gets_its_pictures(
        self, room: tuple[list[ListSequence], Pose], offset_ns: int, preset: str
    ) -> None:
        (left, right), T = room
        count = 5
        left, right = beginning(left, count), beginning(in_memory(right, offset_ns=offset_ns), count)
        config = with_preset(replace(FAST, voxel_size_m=0.03), Preset(preset))
        stream = encoded(MergedSequence([without_poses(left), without_poses(right)], [T]), config)
        frames = decoded(stream)
        for sensor, given in enumerate((left, right)):
            own = [frame for frame in frames if frame.sensor == sensor]
            assert [frame.number for frame in own] == list(range(count))
            assert [frame.timestamp_ns for frame in own] == [frame.timestamp_ns for frame in given]
            assert within_1pct(own, given.frames) > 0.6
            true = [frame.T_world_camera for frame in given if frame.T_world_camera is not None]
            error = trajectory_error(true, [frame.T_world_camera for frame in own], list(range(count)))
            assert error.ate_rmse_mm < 20
        for one, other in zip(*([f for f in frames if f.sensor == sensor] for sensor in (0, 1)), strict=True):
            if not offset_ns:
                np.testing.assert_allclose(inverse(one.T_world_camera) @ other.T_world_camera, T, atol=1e-9)

    def test_sensors_may_differ(self, room: tuple[list[ListSequence], Pose]) -> None:
        (left, _), T = room
        count = 4
        left = beginning(left, count)
        scene = replace(make_scene("room", frames=count, size=(64, 80)), gray=True)
        (_, _), (other, T) = mounted_sequences(scene, 2, threads=1)
        other = in_memory(other, offset_ns=PERIOD_NS // 4, step=2)
        other.info = replace(other.info, depth_scale=500.0)
        stream = encoded(MergedSequence([left, other], [T]))
        opened = open_stream(io.BytesIO(stream))
        assert [(info.rig.depth.width, info.depth_scale, info.gray) for info in opened.infos] == [
            (96, 1000.0, False), (64, 500.0, True)
        ]  # fmt: skip
        shapes = [frame.depth.shape for frame in opened]
        assert shapes.count((72, 96)) == count
        assert shapes.count((80, 64)) == count // 2

    def test_one_sensor_of_several(self, stream: bytes) -> None:
        everything = [frame for frame in decoded(stream) if frame.sensor == 1]
        only = decoded(stream, sensor=1, frames=(2, 5))
        assert [frame.number for frame in only] == [2, 3, 4]
        for frame in only:
            np.testing.assert_array_equal(frame.color, everything[frame.number].color)
        with pytest.raises(ConfigError, match="has no sensor 2; choose from 0 to 1"):
            decoded(stream, sensor=2)

    def test_a_free_view_has_one_camera(self, stream: bytes) -> None:
        frames = decoded(stream, camera_path=[identity()])
        assert [(frame.sensor, frame.number) for frame in frames] == [(0, number) for number in range(FRAMES)]
        for frame in frames:
            np.testing.assert_array_equal(frame.T_world_camera, identity())

    def test_poses_are_sent_once_a_moment(self, stream: bytes) -> None:
        synchronized = statistics(io.BytesIO(stream))
        assert synchronized.objects[0].poses <= FRAMES
        assert synchronized.packets["SENSOR"].count == synchronized.packets["ORDER"].count == 1
        assert [sensor.frames for sensor in synchronized.sensors] == [FRAMES, FRAMES]
        assert synchronized.duration_s == pytest.approx(FRAMES / 30)

    def test_statistics_compare_every_sensor(self, room: tuple[list[ListSequence], Pose], stream: bytes) -> None:
        (left, right), _ = room
        report = statistics(io.BytesIO(stream), [left, right])
        assert report.camera is not None
        assert report.camera.frames == FRAMES
        assert all(frame.quality for frame in report.per_frame)
        with pytest.raises(ConfigError, match="has 2 sensors and 1 references"):
            statistics(io.BytesIO(stream), left)


BEHIND = make_pose(rotation_from_vector(np.array([0.0, 2.4, 0.0])), np.zeros(3))


@cache
def ahead_and_behind() -> tuple[ListSequence, ListSequence]:
    """Return what two sensors see that look away from one another."""
    scene = make_scene("room", frames=2 * FRAMES, size=(96, 72))
    views = SyntheticSequence(scene, "kinect", threads=1), SyntheticSequence(scene.seen_from(BEHIND), "kinect", 1, 1)
    ahead, behind = (in_memory(view) for view in views)
    return ahead, behind


class TestTracking:
    def test_a_blind_sensor_is_carried_along(self, room: tuple[list[ListSequence], Pose]) -> None:
        (left, right), T = room
        merged = MergedSequence([without_poses(in_memory(left, blind=True)), without_poses(right)], [T])
        scene = Scene(merged.info, FAST)
        status = [scene.add(*moment) for moment in frame_sets(merged, merged.info)]
        assert set(status) == {"tracked"}
        true = [frame.T_world_camera for frame in left if frame.T_world_camera is not None]
        found = [inverse(pose) for pose in scene.objects[0].poses[::2]]
        assert trajectory_error(true, found, list(range(FRAMES))).ate_rmse_mm < 20

    @pytest.mark.parametrize("offset_ns", [0, PERIOD_NS // 2], ids=["synchronized", "apart"])
    def test_sensors_that_see_nothing_in_common(self, offset_ns: int) -> None:
        ahead, away = ahead_and_behind()
        left = in_memory(ahead, step=2)
        # The scene's time goes on between the frames of the one and of the other.
        later = away.frames[bool(offset_ns) :: 2]
        frames = [
            replace(frame, index=k, timestamp_ns=left[k].timestamp_ns + (left[1].timestamp_ns // 2 if offset_ns else 0))
            for k, frame in enumerate(later)
        ]
        right = ListSequence(frames, left.info)
        merged = MergedSequence([without_poses(left), without_poses(right)], [BEHIND])
        tracked = Scene(merged.info, FAST)
        status = [tracked.add(*moment) for moment in frame_sets(merged, merged.info)]
        assert "lost" not in status
        own = [k for k, record in enumerate(tracked.records) if record.sensor == 1]
        true = [frame.T_world_camera for frame in right if frame.T_world_camera is not None]
        found = [inverse(merged.info.rigs[1].at_sensor(tracked.objects[0].poses[k])) for k in own]
        assert trajectory_error(true, found, list(range(FRAMES))).ate_rmse_mm < 20

    def test_sensors_of_a_moment_share_their_pose(self, room: tuple[list[ListSequence], Pose]) -> None:
        (left, right), T = room
        merged = MergedSequence([without_poses(left), without_poses(right)], [T])
        scene = Scene(merged.info, FAST)
        for moment in frame_sets(merged, merged.info):
            scene.add(*moment)
        poses = scene.objects[0].poses
        for one, other in zip(poses[::2], poses[1::2], strict=True):
            np.testing.assert_array_equal(one, other)
        assert rotation_angle(poses[-1]) > 0.01

    @pytest.mark.long
    @pytest.mark.parametrize("motion", [Motion.KNOWN, Motion.TRACK])
    def test_a_wrong_mounting_is_corrected(self, room: tuple[list[ListSequence], Pose], motion: Motion) -> None:
        (left, right), T = room
        off = make_pose(rotation_from_vector(np.array([0.012, -0.015, 0.01])), np.array([0.012, -0.01, 0.015]))
        merged = MergedSequence([left, without_poses(right)], [off @ T])
        encoder = Encoder(merged.info, with_preset(replace(FAST, motion=motion, voxel_size_m=0.02), Preset.MEDIUM))
        list(encoder.packets(merged))
        error = inverse(T) @ inverse(encoder.scene.info.rigs[1].T_depth_rig)
        assert np.degrees(rotation_angle(error)) < 0.3
        assert np.linalg.norm(error[:3, 3]) < 0.008

    def test_a_right_mounting_stays(self, room: tuple[list[ListSequence], Pose]) -> None:
        (left, right), T = room
        merged = MergedSequence([left, right], [T])
        scene = Scene(merged.info, replace(FAST, motion=Motion.KNOWN))
        for moment in frame_sets(merged, merged.info):
            scene.add(*moment)
        assert calibrate_extrinsics(scene, merged) is None

    def test_motion_cannot_divide_frames_of_several(self, room: tuple[list[ListSequence], Pose]) -> None:
        from threedvc.config import SegmentationConfig, SegmentationMode

        (left, right), T = room
        config = replace(FAST, segmentation=SegmentationConfig(mode=SegmentationMode.MOTION))
        with pytest.raises(ConfigError, match="--segment motion divides the frames of one sensor"):
            Scene(MergedSequence([left, right], [T]).info, config)
