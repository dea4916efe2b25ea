# SPDX-License-Identifier: MIT
"""Color as filmed: its way through a stream, what is shown where, and what damage does."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from numpy.typing import NDArray

import threedvc
import threedvc.encoder.pipeline.encoder as encoder_module
from helpers.nonrigid_scene import nonrigid_sequence
from helpers.packet_changes import members_of, with_changed, written
from helpers.streams import ListSequence
from threedvc.cli.main import main
from threedvc.coding.video.av1 import can_encode_av1
from threedvc.config import ColorVideo, DepthVideo, EncoderConfig, Motion, RenderConfig, VideoConfig, with_lossless
from threedvc.decoder import packet_handlers
from threedvc.decoder.decoder import Decoder
from threedvc.decoder.verification import verified
from threedvc.encoder.pipeline.encoder import Encoder
from threedvc.encoder.rate.rate_control import stream_bytes
from threedvc.errors import ConfigError, CorruptStream, LimitExceeded
from threedvc.formats.container import StreamReader
from threedvc.frames.multi_sensor import MergedSequence
from threedvc.geometry.pose import identity
from threedvc.stream.captured_headers import ColorVideoHeader
from threedvc.stream.packets import Packet, PacketType, type_name
from threedvc.synthesis import SyntheticSequence, make_scene

pytestmark = pytest.mark.skipif(not can_encode_av1(), reason="this build of PyAV has no AV1")

FRAMES = 8
CONFIG = EncoderConfig(
    voxel_size_m=0.06,
    motion=Motion.KNOWN,
    color_video=ColorVideo.ON,
    video=VideoConfig(coarseness=12, preset=10),
    refine=False,
    batch_frames=5,
    threads=2,
)
MODELS = RenderConfig(captured_color=False, threads=2)


@pytest.fixture(scope="module")
def sequence() -> SyntheticSequence:
    return SyntheticSequence(make_scene("room", frames=FRAMES, size=(64, 48)))


@pytest.fixture(scope="module")
def packets(sequence: SyntheticSequence) -> list[Packet]:
    return list(verified(Encoder(sequence.info, CONFIG).packets(sequence)))


@pytest.fixture(scope="module")
def path(packets: list[Packet], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(packets, tmp_path_factory.mktemp("video") / "room.3dvc")


def with_videos(packets: list[Packet], change: Callable[[Packet], Packet]) -> list[Packet]:
    """Return the packets with the videos in them changed."""
    return with_changed(packets, PacketType.COLOR_VIDEO, change)


def colors(path: Path, render: RenderConfig | None = None, **choices: object) -> list[NDArray[np.uint8]]:
    return [frame.color for frame in threedvc.decode(path, render=render, **choices)]  # type: ignore[arg-type]


def luma(picture: NDArray[np.uint8]) -> NDArray[np.float64]:
    return np.asarray(picture @ np.array([0.25, 0.5, 0.25]))


def test_frames_look_as_they_were_filmed(path: Path, sequence: SyntheticSequence) -> None:
    shown = colors(path)
    assert len(shown) == FRAMES
    errors = [luma(got) - luma(frame.color) for got, frame in zip(shown, sequence, strict=True)]
    assert max(np.square(error).mean() for error in errors) < 20


def test_every_batch_has_a_video_and_no_colors(packets: list[Packet]) -> None:
    members = members_of(packets)
    headers = [ColorVideoHeader.from_map(each.header) for each in members if each.type == PacketType.COLOR_VIDEO]
    assert [(header.frame, header.count) for header in headers] == [(0, 5), (5, 3)]
    assert {(header.columns, header.rows, header.bits) for header in headers} == {(64, 48, 10)}
    assert not any(each.critical for each in members if each.type == PacketType.COLOR_VIDEO)
    of_colors = {"GAIN", "SHIFT", "TEXTURE", "BACKDROP", "BACKGROUND", "FILTER", "LIGHT"}
    assert not of_colors & {type_name(each.type) for each in members}


def test_without_a_video_models_are_gray(path: Path) -> None:
    models = colors(path, MODELS)
    assert all((picture == 128).mean() > 0.9 for picture in models)
    for other in ({"camera_path": [identity()]}, {"objects": [0]}):
        assert all((picture == 128).mean() > 0.9 for picture in colors(path, MODELS, **other))
    depths = [frame.depth for frame in threedvc.decode(path, what=frozenset({"depth"}))]
    np.testing.assert_array_equal(depths, [frame.depth for frame in threedvc.decode(path)])


def test_elsewhere_models_have_the_colors_of_the_video(path: Path, sequence: SyntheticSequence) -> None:
    filmed = [frame.T_world_camera for frame in threedvc.decode(path)]
    again = colors(path, camera_path=filmed)
    for shown in (again, colors(path, objects=[0])):
        errors = [luma(got) - luma(frame.color) for got, frame in zip(shown, sequence, strict=True)]
        assert np.mean([np.square(error).mean() for error in errors]) < 500
    np.testing.assert_array_equal(colors(path, camera_path=filmed, frames=(3, None)), again[3:])
    small = colors(path, size=(32, 24))
    assert np.square(luma(small[-1]) - luma(sequence[FRAMES - 1].color[::2, ::2])).mean() < 900


def test_colors_elsewhere_do_not_depend_on_threads(path: Path) -> None:
    one, three = (colors(path, RenderConfig(threads=threads), size=(32, 24)) for threads in (1, 3))
    np.testing.assert_array_equal(one, three)


@pytest.mark.parametrize(("kbps", "filmed"), [(30, False), (150, True)])
def test_the_better_colors_are_chosen(kbps: int, filmed: bool, sequence: SyntheticSequence) -> None:
    config = replace(CONFIG, color_video=ColorVideo.AUTO, bitrate_bps=1000 * kbps)
    packets = list(Encoder(sequence.info, config).packets(sequence))
    found = any(each.type == PacketType.COLOR_VIDEO for each in members_of(packets))
    assert found == filmed
    assert stream_bytes(packets) <= 1.05 * 125 * kbps * FRAMES / sequence.info.fps


def test_pictures_do_not_depend_on_threads(path: Path) -> None:
    one, three = (colors(path, RenderConfig(threads=threads)) for threads in (1, 3))
    np.testing.assert_array_equal(one, three)


def test_streams_do_not_depend_on_threads(packets: list[Packet], sequence: SyntheticSequence) -> None:
    again = list(Encoder(sequence.info, replace(CONFIG, threads=1)).packets(sequence))
    assert [packet.payload for packet in again] == [packet.payload for packet in packets]


def test_its_bytes_are_counted(path: Path) -> None:
    report = threedvc.statistics(path)
    total = report.packets["COLOR_VIDEO"]
    assert total.count == 2
    assert total.bytes > 0.3 * report.file_bytes
    assert sum(frame.bytes for frame in report.per_frame) == report.file_bytes


@pytest.mark.parametrize("kbps", [50, 100])
def test_a_rate_is_kept(kbps: int, sequence: SyntheticSequence) -> None:
    config = replace(CONFIG, bitrate_bps=1000 * kbps, batch_frames=None)
    budget = 125 * kbps * FRAMES / sequence.info.fps
    assert 0.9 * budget < stream_bytes(list(Encoder(sequence.info, config).packets(sequence))) <= budget


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda video: replace(video, payload=video.payload[:-9]), "the stream is damaged"),
        (lambda video: replace(video, payload=b""), "incomplete"),
        (lambda video: replace(video, header=video.header | {"w": 66}), "should have 66x48"),
        (lambda video: replace(video, header=video.header | {"b": 8}), "of 8 bits"),
        (lambda video: replace(video, header=video.header | {"n": 2}), "a video of 2 pictures has more"),
        (lambda video: replace(video, header=video.header | {"b": 9}), "of 9 bits"),
    ],
)
def test_damage_is_one_error(
    change: Callable[[Packet], Packet], message: str, packets: list[Packet], tmp_path: Path
) -> None:
    path = written(with_videos(packets, change), tmp_path / "damaged.3dvc")
    with pytest.raises(CorruptStream, match=message):
        colors(path)
    assert len(colors(path, MODELS)) == FRAMES


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"n": 0}, "'n'"),
        ({"w": 0}, "'w'"),
        ({"h": 5000}, "'h'"),
        ({"c": 0}, "'c'"),
        ({"s": 1}, "names sensor 1, but the stream has 1"),
        ({"n": 6}, "stands in the BATCH of frames"),
        ({"f": 3}, "stands in the BATCH of frames"),
    ],
)
def test_headers_that_lie_are_one_error(change: dict[str, int], message: str, packets: list[Packet]) -> None:
    with pytest.raises(CorruptStream, match=message) as raised:
        list(Decoder().frames(with_videos(packets, lambda video: replace(video, header=video.header | change))))
    assert "\n" not in str(raised.value)


def test_videos_of_too_many_samples_are_refused(packets: list[Packet]) -> None:
    large = with_videos(packets, lambda video: replace(video, header=video.header | {"w": 4096, "h": 4096, "n": 200}))
    with pytest.raises(LimitExceeded, match="videos of 3355443200 samples"):
        list(Decoder().frames(large))


def test_what_cannot_be_decoded_is_said_and_models_are_drawn(
    path: Path, packets: list[Packet], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    newer = written(
        with_videos(packets, lambda video: replace(video, header=video.header | {"c": 200})), tmp_path / "newer.3dvc"
    )
    stream = threedvc.open_stream(newer)
    np.testing.assert_array_equal([frame.color for frame in stream], colors(path, MODELS))
    assert stream.unread_codecs == {"color": 200}
    result = CliRunner().invoke(main, ["decode", str(newer), str(tmp_path / "out")])
    assert result.exit_code == 0
    assert "cannot decode its color video (codec 200)" in result.stderr
    assert "color video" not in CliRunner().invoke(main, ["decode", str(path), str(tmp_path / "other")]).stderr
    monkeypatch.setattr(packet_handlers, "can_decode_av1", lambda: False)
    np.testing.assert_array_equal(colors(path), colors(path, MODELS))


def test_a_cut_stream_shows_its_complete_batches(path: Path, tmp_path: Path) -> None:
    with open(path, "rb") as file:
        batches = [each for each in StreamReader(file, "room").records() if each.packet.type == PacketType.BATCH]
    cut = tmp_path / "cut.3dvc"
    cut.write_bytes(path.read_bytes()[: batches[1].offset + 40])
    shown = []
    with pytest.raises(threedvc.TruncatedStream):
        shown.extend(frame.color for frame in threedvc.decode(cut))
    whole = colors(path)
    np.testing.assert_array_equal(colors(path, frames=(3, 7)), whole[3:7])


def test_every_sensor_has_a_video_of_its_own(sequence: SyntheticSequence, tmp_path: Path) -> None:
    frames = [replace(frame, color=frame.color[:, ::-1].copy()) for frame in sequence]
    merged = MergedSequence([sequence, ListSequence(frames, sequence.info)], [identity()])
    path = written(list(Encoder(merged.info, CONFIG).packets(merged)), tmp_path / "two.3dvc")
    for sensor, filmed in enumerate((sequence, frames)):
        for got, frame in zip(colors(path, sensor=sensor), filmed, strict=True):
            assert np.square(luma(got) - luma(frame.color)).mean() < 20


@pytest.mark.parametrize("config", [with_lossless(CONFIG), replace(CONFIG, bitrate_bps=5e6)], ids=["lossless", "rate"])
def test_a_gray_sensor_beside_one_in_color_comes_back(
    sequence: SyntheticSequence, tmp_path: Path, config: EncoderConfig
) -> None:
    gray = [replace(frame, color=np.repeat(frame.color[..., 1:2], 3, axis=2)) for frame in sequence]
    merged = MergedSequence([sequence, ListSequence(gray, replace(sequence.info, gray=True))], [identity()])
    path = written(list(Encoder(merged.info, config).packets(merged)), tmp_path / "gray.3dvc")
    for sensor, filmed in enumerate((sequence, gray)):
        np.testing.assert_array_equal(colors(path, sensor=sensor), [frame.color for frame in filmed])


def test_depth_that_bends_has_a_video_too(tmp_path: Path) -> None:
    bent = nonrigid_sequence(4)
    config = replace(CONFIG, voxel_size_m=None, depth_video=DepthVideo.ON)
    for rate in (None, 200_000):
        packets = list(Encoder(bent.info, replace(config, bitrate_bps=rate)).packets(bent))
        kinds = {type_name(each.type) for each in members_of(packets)}
        assert kinds >= {"DEPTH_VIDEO", "COLOR_VIDEO"}
        assert rate is None or stream_bytes(packets) <= rate / 8 * 4 / bent.info.fps


def test_what_cannot_have_a_video_says_so(sequence: SyntheticSequence, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ConfigError, match="a live stream cannot be lossless"):
        replace(CONFIG, causal=True, video=VideoConfig(lossless=True))
    with pytest.raises(ConfigError, match="frames that can be read again"):
        list(Encoder(sequence.info, CONFIG).packets(iter(sequence)))
    monkeypatch.setattr(encoder_module, "can_encode_av1", lambda: False)
    with pytest.raises(ConfigError, match="install av 14"):
        list(Encoder(sequence.info, CONFIG).packets(sequence))
