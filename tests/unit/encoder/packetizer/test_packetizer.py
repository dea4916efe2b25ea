# SPDX-License-Identifier: MIT
"""Packets of poses and time, made of scripts without any model."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from threedvc.coding.gains import NEUTRAL
from threedvc.config import EncoderConfig, PoseConfig
from threedvc.decoder.decoder import Decoder
from threedvc.decoder.frame_state import FrameState
from threedvc.encoder.fusion.evidence_model import EvidenceModel
from threedvc.encoder.packetizer.packetizer import Packetizer
from threedvc.encoder.reconstruction.frame_intake import FrameRecord
from threedvc.frames.frame import SensorInfo, SequenceInfo
from threedvc.geometry.camera import Camera, CameraRig
from threedvc.geometry.pose import Pose, compose, inverse, make_pose, rotation_angle, rotation_from_vector
from threedvc.stream.batch import unpack_batch
from threedvc.stream.headers import BatchHeader, ClockHeader, ObjectHeader, PoseHeader
from threedvc.stream.notes.frame_report import FrameReport
from threedvc.stream.packets import Packet, PacketType
from threedvc.stream.pose_status import PoseStatus

RIG = CameraRig.registered_to(Camera(width=8, height=6, fx=10, fy=10, cx=3.5, cy=2.5))
INFO = SequenceInfo(name="script", rig=RIG, depth_scale=1000.0, fps=30.0, frame_count=None)
STEPS = PoseConfig(translation_step_m=0.0005, rotation_step_rad=0.00025)
START_NS = 1_700_000_000_000_000_000
Script = Sequence[Pose]


@dataclass
class ScriptedObject:
    """An object that goes where it is told, and has no cells."""

    poses: Sequence[Pose]
    born: int | None = 0
    passing: bool = False
    evidence: EvidenceModel = field(default_factory=lambda: EvidenceModel(0.01))
    in_sight: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=bool))


@dataclass
class ScriptedScene:
    """What the packetizer asks of a scene, see `SceneSource`: scripts, empty models, times."""

    objects: Mapping[int, ScriptedObject]
    timestamps: Sequence[int]  # of frames that one sensor took, unless `order` tells the sensor of each
    info: SequenceInfo = INFO
    distance_m: float = 1.0
    order: Sequence[int] = ()

    @property
    def records(self) -> Sequence[FrameRecord]:
        order = self.order or [0] * len(self.timestamps)
        return [
            FrameRecord(
                timestamp_ns=time,
                color_offset_ns=0,
                sensor=sensor,
                synchronized=False,
                repeated=False,
                blind=False,
                gain=NEUTRAL,
            )
            for time, sensor in zip(self.timestamps, order, strict=True)
        ]


def scene_of(
    scripts: dict[int, Script], times: Sequence[int] | None = None, born: dict[int, int] | None = None
) -> ScriptedScene:
    """Return a scene of scripts; it takes 30 frames a second unless `times` are given."""
    frames = len(next(iter(scripts.values())))
    objects = {number: ScriptedObject(list(script), (born or {}).get(number, 0)) for number, script in scripts.items()}
    times = [START_NS + round(frame * 1e9 / 30) for frame in range(frames)] if times is None else times
    return ScriptedScene(objects, times)


def packetized(scene: ScriptedScene, group: int = 10, config: EncoderConfig | None = None) -> list[Packet]:
    packetizer, frames = Packetizer(scene, config or EncoderConfig(pose=STEPS)), len(scene.timestamps)
    starts = range(0, frames, group)
    batches = (packetizer.batch(k, min(k + group, frames), [], last=k + group >= frames) for k in starts)
    packets = [*packetizer.stream_headers(), *(batch for batch in batches if batch is not None)]
    return [*packets, packetizer.end()]


def members(packets: Sequence[Packet], kind: PacketType) -> Iterator[Packet]:
    for packet in packets:
        if packet.type == PacketType.BATCH:
            yield from (member for member in unpack_batch(packet) if member.type == kind)


def posed_frames(packets: Sequence[Packet], number: int) -> list[int]:
    """Return the frames in which the stream carries a pose of an object."""
    headers = [PoseHeader.from_map(packet.header) for packet in members(packets, PacketType.POSE)]
    return [
        frame for head in headers if head.object_id == number for frame in range(head.frame, head.frame + head.count)
    ]


def decoded(packets: Sequence[Packet]) -> list[FrameState]:
    return list(Decoder().frames(packets))


def place(turn: Sequence[float], shift: Sequence[float]) -> Pose:
    return make_pose(rotation_from_vector(np.array(turn, dtype=np.float64)), np.array(shift, dtype=np.float64))


def still(frames: int, pose: Pose | None = None) -> list[Pose]:
    return [np.eye(4) if pose is None else pose] * frames


def walk(frames: int, speed: float = 0.01) -> list[Pose]:
    return [
        place((0, speed * k, 0.3 * np.sin(speed * k)), (speed * k, 0, 1 - speed * k * k / 50)) for k in range(frames)
    ]


def assert_follows(states: Sequence[FrameState], scripts: dict[int, Script]) -> None:
    """Check decoded poses to the quantization of a pose, or of two where the camera's comes in."""
    for state in states:
        for number, script in scripts.items():
            error = compose(inverse(script[state.index]), state.T_camera_object[number])
            limit = 1 if number == 0 else 2
            reach = np.linalg.norm(script[state.index][:3, 3])
            assert STEPS.rotation_step_rad
            assert STEPS.translation_step_m
            assert rotation_angle(error) < 2.5 * limit * STEPS.rotation_step_rad
            assert (
                np.abs(error[:3, 3]).max()
                < 2 * limit * STEPS.translation_step_m + 3 * limit * STEPS.rotation_step_rad * reach
            )


@pytest.mark.parametrize("group", [1, 7, 40, 100])
def test_decoded_poses_are_those_of_the_script(group: int) -> None:
    scripts = {0: walk(40, 0.004), 3: walk(40)}
    packets = packetized(scene_of(scripts), group)
    states = decoded(packets)
    assert [state.index for state in states] == list(range(40))
    assert_follows(states, scripts)


@st.composite
def scripts_with_rests(draw: st.DrawFn) -> dict[int, Script]:
    """Return scripts of a camera and an object that drift, jump and rest."""
    frames = draw(st.integers(1, 25))
    paces = st.lists(st.sampled_from([0.0, 0.0, 1e-4, 3e-4, 0.004, 0.3]), min_size=frames, max_size=frames)
    scripts: dict[int, Script] = {}
    for number in (0, 1):
        way = np.cumsum(draw(paces))
        scripts[number] = [place((0.1 * d, 0.2 * d, -0.1 * d), (d, -d, 1 + 0.5 * d)) for d in way]
    return scripts


@given(scripts_with_rests(), st.integers(1, 12))
def test_any_script_is_followed(scripts: dict[int, Script], group: int) -> None:
    assert_follows(decoded(packetized(scene_of(scripts), group)), scripts)


def test_what_stands_still_has_one_pose_at_most() -> None:
    scripts = {0: still(30), 1: still(30, place((0.1, 0, 0), (0, 0, 1))), 2: walk(30)}
    packets = packetized(scene_of(scripts))
    assert posed_frames(packets, 0) == []
    assert posed_frames(packets, 1) == [0]
    assert posed_frames(packets, 2) == list(range(30))


def test_a_rest_has_no_poses() -> None:
    script = [*walk(10), *still(30, walk(10)[-1]), *(compose(place((0, 0, 0), (0.1, 0, 0)), pose) for pose in walk(10))]
    packets = packetized(scene_of({0: still(50), 1: script}), 10)
    assert posed_frames(packets, 1) == [*range(10), *range(40, 50)]
    # Groups in which nothing happens have no batch.
    batches = [BatchHeader.from_map(packet.header).frame for packet in packets if packet.type == PacketType.BATCH]
    assert batches == [0, 40]
    assert_follows(decoded(packets), {0: still(50), 1: script})


def test_noise_below_the_quantization_is_rest(rng: np.random.Generator) -> None:
    pose = place((0.3, 0.2, 0.1), (0.1, 0.2, 0.9))
    noisy = [compose(pose, place(rng.uniform(-2e-5, 2e-5, 3), rng.uniform(-5e-5, 5e-5, 3))) for _ in range(40)]
    assert posed_frames(packetized(scene_of({0: still(40), 1: noisy})), 1) == [0]


def test_slow_drift_is_not_rest() -> None:
    script = [place((0, 0, 0), (1e-4 * frame, 0, 1)) for frame in range(60)]
    packets = packetized(scene_of({0: still(60), 1: script}))
    assert_follows(decoded(packets), {1: script})


def test_what_rests_in_the_room_costs_nothing_while_the_camera_moves() -> None:
    T_camera_world = walk(40, 0.0137)
    T_world_object = place((0.1, 0.2, 0.3), (0.3, 0.2, 2.5))
    scripts = {0: T_camera_world, 1: [compose(T, T_world_object) for T in T_camera_world]}
    packets = packetized(scene_of(scripts))
    assert posed_frames(packets, 0) == list(range(40))
    assert posed_frames(packets, 1) == [0]
    assert_follows(decoded(packets), scripts)


def test_a_smooth_motion_costs_few_bytes() -> None:
    packets = packetized(scene_of({0: walk(300, 0.002)}), 30)
    payloads = sum(len(member.payload) for member in members(packets, PacketType.POSE))
    assert payloads < 300 * 4


def test_an_object_is_introduced_in_the_group_of_its_birth() -> None:
    scripts = {0: still(30), 5: walk(30)}
    packets = packetized(scene_of(scripts, born={5: 14}))
    (birth,) = [
        BatchHeader.from_map(packet.header).frame
        for packet in packets
        if packet.type == PacketType.BATCH
        and any(
            member.type == PacketType.OBJECT and ObjectHeader.from_map(member.header).object_id == 5
            for member in unpack_batch(packet)
        )
    ]
    assert birth == 10
    states = decoded(packets)
    assert all(5 not in state.T_camera_object for state in states[:10])
    assert_follows(states[10:], {5: scripts[5]})


@pytest.mark.parametrize(
    "jitter",
    [
        lambda frame: 0,
        lambda frame: 1 if frame == 7 else 0,
        lambda frame: (-1) ** frame * frame * 12_345,
        lambda frame: frame * 10**12,
        lambda frame: -(10**15) if frame else 0,
    ],
    ids=["regular", "one off by a nanosecond", "jitter", "wrong rate", "backwards"],
)
def test_times_are_exact(jitter: Callable[[int], int]) -> None:
    times = [START_NS + round(frame * 1e9 / 30) + jitter(frame) for frame in range(25)]
    packets = packetized(scene_of({0: still(25)}, times))
    assert [state.timestamp_ns for state in decoded(packets)] == times
    clocks = [ClockHeader.from_map(member.header).frame for member in members(packets, PacketType.CLOCK)]
    # Only groups whose times are off carry them.
    off = {frame // 10 * 10 for frame in range(25) if jitter(frame)}
    assert clocks == sorted(off)


def test_a_regular_clock_costs_nothing() -> None:
    packets = packetized(scene_of({0: still(100)}))
    assert [packet.type for packet in packets] == [PacketType.STREAM, PacketType.BATCH, PacketType.END]
    assert not list(members(packets, PacketType.CLOCK))


def test_an_endless_rest_is_broken_in_time_for_readers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("threedvc.encoder.packetizer.packetizer.MAX_IDLE_FRAMES", 20)
    monkeypatch.setattr("threedvc.decoder.decoder.MAX_COUNT", 40)
    packets = packetized(scene_of({0: still(200)}), 5)
    assert len(decoded(packets)) == 200
    empty = [packet for packet in packets if packet.type == PacketType.BATCH and not packet.payload]
    assert 5 <= len(empty) <= 10


def test_reports_travel_with_the_batch() -> None:
    scene = scene_of({0: still(4)})
    packetizer = Packetizer(scene, EncoderConfig())
    told = [FrameReport(index=k, timestamp_ns=k, status=PoseStatus.KNOWN, entropy_bits=64.0) for k in range(4)]
    batch = packetizer.batch(0, 4, told, last=True)
    assert batch is not None
    decoder = Decoder()
    list(decoder.frames([*packetizer.stream_headers(), batch, packetizer.end()]))
    assert decoder.report.entropy_bits == (64.0,) * 4


@pytest.mark.parametrize("fps", [30.0, 29.97, 24000 / 1001, 0.1, 1000.0])
def test_the_nominal_clock_is_that_of_the_frame_rate(fps: float) -> None:
    scene = scene_of({0: still(1000)}, [0] * 1000)
    scene.info = SequenceInfo(name="clock", rig=RIG, depth_scale=1000.0, fps=fps, frame_count=None)
    packetizer = Packetizer(scene, EncoderConfig())
    times = [state.timestamp_ns for state in decoded([*packetizer.stream_headers(), packetizer.end()])]
    np.testing.assert_allclose(np.diff(times), 1e9 / fps, atol=1, rtol=1e-6)


def test_a_sensor_that_begins_after_the_head_was_sent_keeps_its_times() -> None:
    sensor = SensorInfo(name="one of two", rig=RIG, depth_scale=1000.0, fps=30.0)
    info = replace(INFO, sensors=(sensor, replace(sensor, name="the other")))
    times = [START_NS + 10_000_000 * frame for frame in range(8)]
    order = [0, 0, 0, 0, 0, 1, 0, 1]
    scene = ScriptedScene({0: ScriptedObject(still(8))}, times[:4], info, order=order[:4])
    packetizer = Packetizer(scene, EncoderConfig(causal=True, pose=STEPS))
    head, first = packetizer.stream_headers(), packetizer.batch(0, 4, [], last=False)
    scene.timestamps, scene.order = times, order
    packets = [*head, first, packetizer.batch(4, 8, [], last=True), packetizer.end()]
    assert [state.timestamp_ns for state in decoded([each for each in packets if each is not None])] == times
