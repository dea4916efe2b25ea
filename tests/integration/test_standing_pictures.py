# SPDX-License-Identifier: MIT
"""What does not change costs nothing: pictures that stand, objects and cameras at rest."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from helpers.encoded_scenes import (
    FRAMES,
    MASKS,
    THRESHOLD,
    WHOLE,
    batches,
    config,
    decoded,
    encoded,
    pose_headers,
    scene,
    stream,
)
from helpers.streams import ListSequence
from threedvc.config import ColorVideo, EncoderConfig, Motion, SegmentationConfig, Sensor
from threedvc.decoder.decoder import Decoder
from threedvc.encoder.pipeline.encoder import Encoder
from threedvc.encoder.rate.rate_control import stream_bytes
from threedvc.stream.packets import Packet, PacketType
from threedvc.stream.sensor_description import nearest_multiple

pytestmark = pytest.mark.usefixtures("quick_av1")


def size_of(packets: Iterable[Packet]) -> int:
    return sum(len(packet.payload) for packet in packets)


def posed_frames(packets: Sequence[Packet], number: int) -> list[int]:
    heads = [head for head in pose_headers(packets) if head.object_id == number]
    return [head.frame + step for head in heads for step in range(head.count)]


def repeated(sequence: ListSequence, index: int, count: int) -> ListSequence:
    """Return a sequence that goes up to a frame and shows it `count` more times."""
    last, period = sequence[index], 1e9 / sequence.info.fps
    more = [replace(last, index=index + k, timestamp_ns=round((index + k) * period)) for k in range(1, count + 1)]
    return ListSequence([*sequence.frames[: index + 1], *more], replace(sequence.info, frame_count=index + 1 + count))


def without_reports(members: Iterable[Packet]) -> list[Packet]:
    return [member for member in members if member.type != PacketType.META]


@pytest.mark.parametrize(("name", "segmentation"), [("paper", THRESHOLD), ("room", WHOLE)])
def test_a_standing_picture_costs_no_packet(name: str, segmentation: SegmentationConfig) -> None:
    sequence = repeated(scene(name), 0, 11)
    _, packets = encoded(sequence, config(segmentation=segmentation))
    later = {frame: without_reports(members) for frame, members in batches(packets).items() if frame}
    assert not any(later.values())
    assert len(decoded(packets)[1]) == 12


def test_repeating_the_last_frame_costs_only_the_report() -> None:
    sizes = {}
    for count in (8, 40):
        sequence = repeated(scene("paper"), FRAMES - 1, count)
        _, packets = encoded(sequence, config(segmentation=THRESHOLD))
        posed = posed_frames(packets, 1)
        assert max(posed) <= FRAMES - 1
        content = batches(packets)
        sizes[count] = size_of(without_reports(member for members in content.values() for member in members))
        # Nothing stands after the moving part but the batch with the report.
        assert sum(frame >= FRAMES for frame in content) <= 1
    # What the model knows of the last view settles, so a few cells may differ.
    assert abs(sizes[40] - sizes[8]) <= 0.08 * sizes[8]


def test_live_a_standing_picture_settles() -> None:
    sequence = repeated(scene("room"), 0, 29)
    _, packets = encoded(sequence, config(causal=True, batch_frames=1))
    decoder, contents = Decoder(), list[dict[tuple[int, ...], tuple[int, ...]]]()
    for _ in decoder.frames(packets):
        cells, colors = decoder.models[0].cells()
        contents.append(dict(zip(map(tuple, cells.tolist()), map(tuple, colors.tolist()), strict=True)))
    # Confidence grows from frame to frame, but nothing is sent twice.
    for before, after in pairwise(contents):
        assert before.items() <= after.items()
    assert len(contents[15]) > 0.98 * len(contents[-1])


def test_live_what_stops_falls_silent() -> None:
    sequence = repeated(scene("paper"), FRAMES - 1, 50)
    _, packets = encoded(sequence, config(segmentation=THRESHOLD, causal=True, batch_frames=1))
    assert max(posed_frames(packets, 1)) == FRAMES - 1
    updates = {frame: size_of(without_reports(members)) for frame, members in batches(packets).items()}
    assert sum(size for frame, size in updates.items() if frame > FRAMES + 20) < 0.06 * sum(updates.values())


def test_an_object_that_rests_has_no_poses_while_others_move() -> None:
    # Object 1 stands still from frame 45 of the scene on, objects 2 and 3 do not.
    sequence = scene("objects", 5, first=46)
    _, packets = encoded(sequence, config(segmentation=MASKS))
    assert posed_frames(packets, 0) == []
    assert posed_frames(packets, 1) == [0]
    for number in (2, 3):
        assert posed_frames(packets, number) == list(range(5))


@pytest.mark.long
@pytest.mark.parametrize("motion", [Motion.KNOWN, pytest.param(Motion.TRACK, marks=pytest.mark.long)])
def test_repeating_the_last_frame_costs_next_to_nothing(motion: Motion) -> None:
    sequence = scene("room")
    last, fps = sequence.frames[-1], int(sequence.info.fps)
    again = [
        replace(last, index=index, timestamp_ns=nearest_multiple(index, 10**9, fps))
        for index in range(last.index + 1, last.index + 101)
    ]
    sizes = []
    for frames in (sequence.frames, [*sequence.frames, *again]):
        encoder = Encoder(sequence.info, EncoderConfig(color_video=ColorVideo.OFF, motion=motion, threads=1))
        sizes.append(stream_bytes(list(encoder.packets(ListSequence(frames, sequence.info)))))
    assert sizes[1] - sizes[0] < 100


def test_live_a_rest_costs_next_to_nothing() -> None:
    room = scene("room")
    settled, rested = (
        encoded(repeated(room, FRAMES - 1, count), config(causal=True, batch_frames=10))[1] for count in (30, 330)
    )
    assert stream_bytes(rested) - stream_bytes(settled) < 100
    decoder = Decoder()
    assert sum(1 for _ in decoder.frames(rested)) == FRAMES + 330
    assert decoder.report is not None
    assert len(decoder.report.status) == FRAMES + 330


@pytest.mark.parametrize("refine", [False, True])
def test_a_tracked_camera_that_only_trembles_stands_still(refine: bool) -> None:
    rng = np.random.default_rng(5)
    still = [
        replace(frame, depth=(frame.depth * (1 + rng.normal(0, 0.004, frame.depth.shape))).astype(np.float32))
        for frame in [scene("room")[0]] * 5
    ]
    frames = [
        replace(frame, index=k, timestamp_ns=k * 33_333_333, T_world_camera=None) for k, frame in enumerate(still)
    ]
    info = replace(scene("room").info, has_camera_poses=False, frame_count=len(frames))
    settings = config(motion=Motion.TRACK, sensor=Sensor.KINECT1, refine=refine)
    encoder, packets = encoded(ListSequence(frames, info), settings)
    assert encoder.scene.objects[0].at_rest
    assert not pose_headers(packets)


def test_a_tracked_camera_that_moves_does_not_rest() -> None:
    encoder, packets = stream("room", motion=Motion.TRACK)
    assert not encoder.scene.objects[0].at_rest
    assert pose_headers(packets)
