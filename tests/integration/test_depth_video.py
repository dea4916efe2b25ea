# SPDX-License-Identifier: MIT
"""Depth as filmed: what its samples show, when it is worth its bytes, and its way through a stream."""

from __future__ import annotations

import io
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from numpy.typing import NDArray

import threedvc
import threedvc.encoder.pipeline.encoder as encoder_module
from helpers.earlier_pictures import RUNS, digest_of
from helpers.nonrigid_scene import nonrigid_sequence
from helpers.streams import ListSequence
from threedvc.cli.main import main
from threedvc.coding.video.av1 import Av1Settings, can_encode_av1, encode_av1
from threedvc.coding.video.planes import Samples, VideoFormat, gray_planes
from threedvc.config import ColorVideo, DepthVideo, EncoderConfig, Motion, RenderConfig
from threedvc.decoder import packet_handlers
from threedvc.decoder.decoder import Decoder
from threedvc.decoder.verification import verified
from threedvc.encoder.packetizer.captured import depth_video as video_choice
from threedvc.encoder.pipeline.encoder import Encoder
from threedvc.encoder.rate.rate_control import stream_bytes
from threedvc.errors import ConfigError, CorruptStream, LimitExceeded
from threedvc.formats.container import StreamReader
from threedvc.frames.multi_sensor import MergedSequence
from threedvc.render.captured_depth import EDGE, CapturedDepth, depth_levels
from threedvc.stream.batch import pack_batch, unpack_batch
from threedvc.stream.captured_headers import DepthVideoHeader, VideoHeader
from threedvc.stream.headers import BatchHeader
from threedvc.stream.packets import Packet, PacketType
from threedvc.synthesis import SyntheticSequence, make_scene

with_video = pytest.mark.skipif(not can_encode_av1(), reason="this build of PyAV has no AV1")
FRAMES = 12
LEVELS = depth_levels(0.5, 1.0025, 10)
CONFIG = EncoderConfig(
    color_video=ColorVideo.OFF, motion=Motion.KNOWN, depth_video=DepthVideo.ON, refine=False, threads=1
)
MODELS = RenderConfig(captured_depth=False, threads=1)
pytestmark = pytest.mark.usefixtures("quick_av1")


def filmed(samples: Samples, *, complete: bool = True) -> CapturedDepth:
    return CapturedDepth(samples=samples, levels=LEVELS, complete=complete)


def test_levels_rise_by_their_ratio() -> None:
    assert LEVELS.shape == (1024,)
    np.testing.assert_allclose(LEVELS, 0.5 * 1.0025 ** np.arange(1024), rtol=1e-11)
    np.testing.assert_allclose(depth_levels(0.5, 1.01, 8), 0.5 * 1.01 ** np.arange(256), rtol=1e-12)


def test_samples_of_full_size_are_shown_as_they_are(rng: np.random.Generator) -> None:
    samples = (400 + rng.integers(0, 20, (30, 40))).astype(np.uint16)
    shown = filmed(samples).shown(np.zeros((30, 40), dtype=np.float32), 2)
    np.testing.assert_allclose(shown, LEVELS[samples], rtol=1e-6)


def test_a_slope_stays_straight_when_magnified() -> None:
    samples = np.tile(np.arange(240, 400, 8, dtype=np.uint16), (16, 1))
    shown = filmed(samples).shown(np.zeros((64, 80), dtype=np.float32), 1)
    middle = np.log(shown[20, 8:-8] / 0.5) / np.log(1.0025)
    np.testing.assert_allclose(np.diff(middle), 2, atol=0.04)
    np.testing.assert_array_equal(shown[8:-8], np.tile(shown[20], (48, 1)))


def test_depth_does_not_depend_on_the_threads(rng: np.random.Generator) -> None:
    samples = rng.integers(0, 1024, (17, 23)).astype(np.uint16)
    drawn = rng.uniform(0.5, 5, (51, 70)).astype(np.float32)
    np.testing.assert_array_equal(filmed(samples).shown(drawn, 1), filmed(samples).shown(drawn, 5))


def test_where_surfaces_meet_the_models_tell_where() -> None:
    samples = np.full((20, 20), 200, dtype=np.uint16)
    samples[:, 10:] = 480
    near, far = LEVELS[200], LEVELS[480]
    assert far > EDGE * near
    drawn = np.where(np.arange(80) < 41, near * 1.001, far * 0.999).astype(np.float32)[None].repeat(80, axis=0)
    shown = filmed(samples).shown(drawn, 2)
    np.testing.assert_array_equal(shown[:, 38:42], drawn[:, 38:42])
    np.testing.assert_allclose(shown[:, :30], near, rtol=1e-6)
    # What is drawn off both surfaces is no witness.
    wrong = filmed(samples).shown(np.full_like(drawn, 10 * far), 2)
    assert wrong.max() < 1.1 * far


@pytest.mark.parametrize("complete", [False, True])
def test_what_is_not_drawn_is_shown_if_the_video_is_complete(complete: bool) -> None:
    drawn = np.full((20, 20), 0.8, dtype=np.float32)
    drawn[5:9] = 0
    shown = filmed(np.full((5, 5), 120, dtype=np.uint16), complete=complete).shown(drawn, 1)
    assert (shown[5:9] > 0).all() == complete
    assert (shown[10:] > 0).all()


def video_of(packets: list[Packet]) -> list[Packet]:
    members = [member for packet in packets if packet.type == PacketType.BATCH for member in unpack_batch(packet)]
    return [member for member in members if member.type == PacketType.DEPTH_VIDEO]


def small_room() -> ListSequence:
    return nonrigid_sequence(FRAMES, (64, 48))


@cache
def stream(video: DepthVideo = DepthVideo.ON) -> bytes:
    """Return a stream with a video or without, encoded once."""
    sink = io.BytesIO()
    threedvc.encode(nonrigid_sequence(FRAMES), sink, replace(CONFIG, depth_video=video))
    return sink.getvalue()


def packets_of(data: bytes) -> list[Packet]:
    return list(StreamReader(io.BytesIO(data), "stream"))


def with_video_replaced(header: DepthVideoHeader | VideoHeader, payload: bytes) -> list[Packet]:
    """Return the packets of the stream with another video in place of its own."""

    def changed(packet: Packet) -> Packet:
        members = [
            header.packet(payload, critical=False) if member.type == PacketType.DEPTH_VIDEO else member
            for member in unpack_batch(packet)
        ]
        return pack_batch(BatchHeader.from_map(packet.header), members)

    return [changed(each) if each.type == PacketType.BATCH else each for each in packets_of(stream())]


def blank(count: int, rows: int, columns: int) -> bytes:
    """Return the payload of pictures that show the same depth everywhere."""
    video = VideoFormat(width=columns, height=rows, bits=10, gray=True)
    planes = gray_planes(np.full((rows, columns), 36, dtype=np.uint16), video)
    return encode_av1([planes] * count, video, Av1Settings(crf=30, preset=10, threads=1, depth=True))


def saved(sequence: ListSequence, config: EncoderConfig, path: Path) -> Path:
    threedvc.encode(sequence, path, config)
    return path


def within_one_per_cent(data: bytes, sequence: ListSequence, render: RenderConfig | None = None) -> float:
    shares = []
    for drawn, given in zip(threedvc.decode(io.BytesIO(data), render=render), sequence, strict=True):
        valid = given.depth > 0
        shares.append(np.mean(np.abs(drawn.depth - given.depth)[valid] <= 0.01 * given.depth[valid]))
    return float(np.mean(shares))


@with_video
def test_a_video_shows_depth_that_no_rigid_model_can() -> None:
    sequence = nonrigid_sequence(FRAMES)
    models = within_one_per_cent(stream(), sequence, MODELS)
    assert within_one_per_cent(stream(), sequence) > max(0.6, 1.5 * models)
    assert within_one_per_cent(stream(DepthVideo.OFF), sequence) == pytest.approx(models, abs=1e-9)


@with_video
def test_groups_of_frames_have_a_video_each() -> None:
    sequence = small_room()
    encoder = Encoder(sequence.info, replace(CONFIG, batch_frames=5))
    packets = list(verified(encoder.packets(sequence)))
    headers = [DepthVideoHeader.from_map(member.header) for member in video_of(packets)]
    assert [(header.frame, header.count) for header in headers] == [(0, 5), (5, 5), (10, 2)]
    assert not any(member.critical for member in video_of(packets))
    states = list(Decoder().frames(packets))
    assert all(state.captured_depth is not None for state in states)


@pytest.mark.long
@with_video
@pytest.mark.parametrize("noise", ["ideal", "kinect"])
def test_rigid_depth_gets_none(noise: str) -> None:
    source = SyntheticSequence(make_scene("room", frames=FRAMES, size=(96, 72)), noise, seed=3)
    sequence = ListSequence(list(source), source.info)
    encoder = Encoder(sequence.info, replace(CONFIG, depth_video=DepthVideo.AUTO, refine=True))
    assert not video_of(list(encoder.packets(sequence)))


@with_video
def test_a_rate_is_met_with_a_video() -> None:
    sequence = small_room()
    rate = 60_000.0
    encoder = Encoder(sequence.info, replace(CONFIG, bitrate_bps=rate))
    packets = list(encoder.packets(sequence))
    assert video_of(packets)
    assert stream_bytes(packets) <= rate * FRAMES / sequence.info.fps / 8


@pytest.mark.long
@with_video
def test_a_rate_is_met_with_many_videos() -> None:
    sequence = nonrigid_sequence(FRAMES)
    rate = 250_000.0
    encoder = Encoder(sequence.info, replace(CONFIG, bitrate_bps=rate, batch_frames=2))
    packets = list(encoder.packets(sequence))
    assert len(video_of(packets)) == FRAMES // 2
    assert stream_bytes(packets) <= rate * FRAMES / sequence.info.fps / 8


@with_video
def test_a_rate_that_leaves_no_room_is_kept_without() -> None:
    sequence = small_room()
    target = 12_000.0 * FRAMES / sequence.info.fps / 8
    encoder = Encoder(sequence.info, replace(CONFIG, bitrate_bps=12_000.0))
    packets = list(encoder.packets(sequence))
    assert stream_bytes(packets) <= max(target, stream_bytes(without(packets)))


def without(packets: list[Packet]) -> list[Packet]:
    def bare(packet: Packet) -> Packet:
        if packet.type != PacketType.BATCH:
            return packet
        members = [member for member in unpack_batch(packet) if member.type != PacketType.DEPTH_VIDEO]
        return pack_batch(BatchHeader.from_map(packet.header), members)

    return [bare(packet) for packet in packets]


@pytest.mark.long
@with_video
def test_a_file_takes_one_by_itself_where_it_is_worth_it() -> None:
    sequence = nonrigid_sequence(16, (128, 96))
    config = replace(CONFIG, depth_video=DepthVideo.AUTO, refine=True)
    assert video_of(list(Encoder(sequence.info, config).packets(sequence)))


@with_video
def test_frames_without_depth_have_no_picture() -> None:
    sequence = small_room()
    kept = [
        replace(frame, depth=np.zeros_like(frame.depth)) if frame.index in (3, 4, 9) else frame for frame in sequence
    ]
    packets = list(Encoder(sequence.info, CONFIG).packets(ListSequence(kept, sequence.info)))
    headers = [DepthVideoHeader.from_map(member.header) for member in video_of(packets)]
    assert [(header.frame, header.count) for header in headers] == [(0, 3), (5, 4), (10, 2)]
    states = list(Decoder().frames(packets))
    assert [state.index for state in states if state.captured_depth is None] == [3, 4, 9]


@with_video
def test_where_hardly_anything_was_measured_the_models_stay(tmp_path: Path) -> None:
    sequence = small_room()
    kept = []
    for frame in sequence:
        depth = frame.depth.copy()
        if frame.index > 0:  # one frame of 12 is less than are_measured() asks for
            depth[:, :27] = 0
        kept.append(replace(frame, depth=depth))
    path = saved(ListSequence(kept, sequence.info), CONFIG, tmp_path / "half.3dvc")
    models = [frame.depth for frame in threedvc.decode(path, render=MODELS)]
    film = [frame.depth for frame in threedvc.decode(path)]
    for shown, drawn in list(zip(film, models, strict=True))[4:]:
        here = drawn[:, :21] > 0
        assert np.median(np.abs(shown[:, :21] - drawn[:, :21])[here] / drawn[:, :21][here]) < 0.02
        assert (shown[drawn == 0] == 0).all()


@with_video
def test_holes_show_what_is_around_them() -> None:
    sequence = small_room()
    frames = [replace(frame, depth=frame.depth.copy()) for frame in sequence]
    for frame in frames:
        frame.depth[:] = 1.0
        frame.depth[20:40, 30:50] = 0 if frame.index % 2 else 0.6
    *_, last = Decoder().frames(Encoder(sequence.info, CONFIG).packets(ListSequence(frames, sequence.info)))
    assert last.captured_depth is not None
    shown = last.captured_depth.shown(np.full_like(frames[-1].depth, 2.0), 1)
    assert np.median(shown[22:38, 32:48]) > 0.9


@with_video
def test_large_pictures_are_filmed_as_large_as_is_allowed(monkeypatch: pytest.MonkeyPatch) -> None:
    sequence = small_room()
    most = FRAMES * 24 * 18
    monkeypatch.setattr(video_choice, "MAX_SEQUENCE_SAMPLES", most)
    packets = list(Encoder(sequence.info, CONFIG).packets(sequence))
    (video,) = video_of(packets)
    header = DepthVideoHeader.from_map(video.header)
    assert 16 <= header.columns <= 24
    assert header.count * header.columns * header.rows <= most


@pytest.mark.long
@with_video
def test_sensors_have_videos_of_their_own(tmp_path: Path) -> None:
    calm, other = nonrigid_sequence(FRAMES), nonrigid_sequence(FRAMES, share=0.031)
    merged = MergedSequence([calm, other], [np.eye(4)])
    path = tmp_path / "two.3dvc"
    threedvc.encode(merged, path, CONFIG)
    pictures = {0: calm, 1: other}
    shares: dict[int, list[float]] = {0: [], 1: []}
    models: dict[int, list[float]] = {0: [], 1: []}
    for found, render in ((shares, None), (models, MODELS)):
        for drawn in threedvc.decode(path, render=render):
            given = pictures[drawn.sensor][drawn.number].depth
            found[drawn.sensor].append(float(np.mean(np.abs(drawn.depth - given) < 0.01 * given)))
    for sensor in (0, 1):
        assert np.mean(shares[sensor]) > 1.2 * np.mean(models[sensor])


@with_video
def test_who_cannot_decode_it_says_so_and_shows_the_models(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.3dvc"
    path.write_bytes(stream())
    models = [frame.depth for frame in threedvc.decode(path, render=MODELS)]
    monkeypatch.setattr(packet_handlers, "can_decode_av1", lambda: False)
    shown = threedvc.open_stream(path)
    np.testing.assert_array_equal([frame.depth for frame in shown], models)
    assert shown.unread_codecs == {"depth": 1}
    result = CliRunner().invoke(main, ["decode", str(path), str(tmp_path / "out")])
    assert result.exit_code == 0
    assert "cannot decode its depth video (codec 1), so the pictures show the models' depth" in result.stderr
    assert threedvc.statistics(path).frames == FRAMES


@with_video
def test_videos_of_an_unknown_codec_are_passed_over() -> None:
    header = DepthVideoHeader.from_map(video_of(packets_of(stream()))[0].header)
    decoder = Decoder()
    states = list(decoder.frames(with_video_replaced(replace(header, codec=3), b"what nobody knows")))
    assert all(state.captured_depth is None for state in states)
    assert decoder.unread_codecs == {"depth": 3}


@with_video
def test_videos_of_eight_bits_as_they_were_written_before_are_shown() -> None:
    run = RUNS["run"]
    header = VideoHeader(frame=1, count=run.count, columns=run.width, rows=run.height, nearest_m=0.5, ratio=1.01)
    packets = with_video_replaced(header, run.payload)
    states = list(Decoder().frames(packets))
    assert [state.index for state in states if state.captured_depth is not None] == list(range(1, 1 + run.count))
    shown = [state.captured_depth.samples for state in states if state.captured_depth is not None]
    assert digest_of(np.stack(shown).astype(np.uint8)) == run.digest
    with pytest.raises(CorruptStream):
        list(Decoder().frames(with_video_replaced(replace(header, count=run.count - 1), run.payload)))


@with_video
def test_a_stream_does_not_depend_on_threads() -> None:
    sequence, many = small_room(), io.BytesIO()
    few = io.BytesIO()
    threedvc.encode(sequence, few, CONFIG)
    threedvc.encode(sequence, many, replace(CONFIG, threads=3))
    assert few.getvalue() == many.getvalue()


def test_what_cannot_have_a_video_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ConfigError, match="a live stream cannot have a depth video"):
        replace(CONFIG, causal=True)
    sequence = small_room()
    with pytest.raises(ConfigError, match="frames that can be read again"):
        list(Encoder(sequence.info, CONFIG).packets(iter(sequence)))
    monkeypatch.setattr(encoder_module, "can_encode_av1", lambda: False)
    with pytest.raises(ConfigError, match="install av"):
        list(Encoder(sequence.info, CONFIG).packets(sequence))


@with_video
def test_videos_of_too_many_samples_are_refused() -> None:
    payload = blank(1, 16, 16)
    packets = packets_of(stream(DepthVideo.OFF))
    header = DepthVideoHeader(frame=0, columns=4096, rows=4096, nearest_m=1.0, ratio=1.01)
    earlier = VideoHeader(frame=0, columns=4096, rows=4096, nearest_m=1.0, ratio=1.01)
    more = [replace(header, frame=frame).packet(payload, critical=False) for frame in range(3)]
    more += [replace(earlier, frame=frame).packet(payload, critical=False) for frame in range(2)]
    at = next(at for at, packet in enumerate(packets) if packet.type == PacketType.BATCH)
    packets[at] = pack_batch(BatchHeader.from_map(packets[at].header), [*unpack_batch(packets[at]), *more])
    with pytest.raises(LimitExceeded, match="videos of 83886080 samples"):
        list(Decoder().frames(packets))


@pytest.mark.parametrize("complete", [False, True])
@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (16, 16), (23, 5)])
def test_magnified_pictures_are_those_of_a_slow_reference(
    shape: tuple[int, int], complete: bool, rng: np.random.Generator
) -> None:
    samples = rng.choice([0, 28, 32, 36, 480, 1000, 1023], shape).astype(np.uint16)
    drawn = rng.choice([0, 0.5, 0.52, 1.6, 6.0], (31, 40)).astype(np.float32)
    shown = filmed(samples, complete=complete).shown(drawn, 2)
    np.testing.assert_allclose(shown, slowly_magnified(samples, drawn, complete), rtol=1e-6)


def slowly_magnified(samples: Samples, drawn: NDArray[np.float32], complete: bool) -> NDArray[np.float32]:
    """Do what docs/drawing.md says, pixel by pixel."""
    rows, columns = samples.shape
    height, width = drawn.shape
    result = np.zeros_like(drawn)
    for y, x in np.ndindex(height, width):
        if drawn[y, x] == 0 and not complete:
            continue
        v, u = (y + 0.5) * rows / height - 0.5, (x + 0.5) * columns / width - 0.5
        i, j = int(np.floor(v)), int(np.floor(u))
        there = samples[np.clip(np.arange(i - 1, i + 3), 0, rows - 1)][
            :, np.clip(np.arange(j - 1, j + 3), 0, columns - 1)
        ].astype(float)
        down, across = (
            np.array([f * (f * (2 - f) - 1), f * f * (3 * f - 5) + 2, f * (f * (4 - 3 * f) + 1), f * f * (f - 1)]) / 2
            for f in (v - i, u - j)
        )
        s = np.clip(down @ (there @ across), 0, 1023)
        k = min(int(s), 1022)
        least, greatest = (LEVELS[int(end)] for end in (there[1:3, 1:3].min(), there[1:3, 1:3].max()))
        meeting = greatest > 1.1 * least and least <= drawn[y, x] <= greatest
        result[y, x] = drawn[y, x] if meeting else LEVELS[k] + (s - k) * (LEVELS[k + 1] - LEVELS[k])
    return result


@pytest.mark.long
@with_video
def test_other_views_show_the_models(tmp_path: Path) -> None:
    sequence = nonrigid_sequence(FRAMES)
    path = saved(sequence, CONFIG, tmp_path / "a.3dvc")
    models = [frame.depth for frame in threedvc.decode(path, render=MODELS)]
    film = [frame.depth for frame in threedvc.decode(path)]
    alone = [frame.depth for frame in threedvc.decode(path, objects=[0])]
    there = [frame.T_world_camera for frame in threedvc.decode(path)]
    again = [frame.depth for frame in threedvc.decode(path, camera_path=there)]
    assert not np.array_equal(film[3], models[3])
    np.testing.assert_array_equal(alone[3], models[3])
    np.testing.assert_allclose(again[3], models[3], atol=1e-3)
    larger = [frame.depth for frame in threedvc.decode(path, size=(192, 144))]
    halved = larger[3].reshape(72, 2, 96, 2).mean((1, 3))
    assert np.mean(np.abs(halved - film[3]) < 0.01 * film[3]) > 0.9


@with_video
def test_a_video_of_the_wrong_frames_is_refused() -> None:
    (video,) = video_of(packets_of(stream()))

    def told(header: DepthVideoHeader, payload: bytes) -> None:
        list(Decoder().frames(with_video_replaced(header, payload)))

    header = DepthVideoHeader.from_map(video.header)
    told(header, video.payload)
    with pytest.raises(CorruptStream):
        told(replace(header, count=FRAMES + 1), video.payload)
    with pytest.raises(CorruptStream):
        told(replace(header, count=FRAMES - 1), video.payload)
    with pytest.raises(CorruptStream):
        told(replace(header, columns=header.columns + 1), video.payload)
    with pytest.raises(CorruptStream, match="names sensor 3"):
        told(replace(header, sensor=3), video.payload)
    with pytest.raises(CorruptStream):
        told(header, video.payload[: len(video.payload) // 2])
    with pytest.raises(CorruptStream, match="of 10 bits should have"):
        told(replace(header, bits=16), video.payload)
    with pytest.raises(CorruptStream):
        told(header, b"")
    told(header, blank(FRAMES, header.rows, header.columns))
