# SPDX-License-Identifier: MIT
"""Depth within a bound of what was measured: its way through a stream, what is shown where, and what damage does."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner
from numpy.typing import NDArray

import threedvc
from helpers.packet_changes import members_of, with_changed, written
from helpers.streams import ListSequence
from threedvc.cli.main import main
from threedvc.coding.video.ffv1 import can_encode_ffv1
from threedvc.config import ColorVideo, DepthErrorConfig, DepthErrorKind, EncoderConfig, Motion, RenderConfig
from threedvc.decoder.decoder import Decoder
from threedvc.encoder.pipeline.encoder import Encoder
from threedvc.errors import ConfigError, CorruptStream, LimitExceeded
from threedvc.formats.sinks import PlainSink
from threedvc.frames.multi_sensor import MergedSequence
from threedvc.geometry.pose import identity
from threedvc.stream.captured_headers import ResidualHeader
from threedvc.stream.packets import Packet, PacketType
from threedvc.synthesis import SyntheticSequence, make_scene

FRAMES = 7
LOSSLESS = DepthErrorConfig(kind=DepthErrorKind.LOSSLESS)
CONFIG = EncoderConfig(
    voxel_size_m=0.06,
    motion=Motion.KNOWN,
    color_video=ColorVideo.OFF,
    depth_error=LOSSLESS,
    refine=False,
    batch_frames=4,
    threads=2,
)


@pytest.fixture(scope="module")
def sequence() -> ListSequence:
    source = SyntheticSequence(make_scene("room", frames=FRAMES, size=(64, 48)), "kinect")
    return ListSequence(list(source), source.info)


def encoded(sequence: ListSequence | MergedSequence, **changes: object) -> list[Packet]:
    return list(Encoder(sequence.info, replace(CONFIG, **changes)).packets(sequence))


@pytest.fixture(scope="module")
def packets(sequence: ListSequence) -> list[Packet]:
    return encoded(sequence)


@pytest.fixture(scope="module")
def path(packets: list[Packet], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(packets, tmp_path_factory.mktemp("depth") / "room.3dvc")


def raw(depth: NDArray[np.float32], scale: float) -> NDArray[np.int64]:
    return np.rint(depth.astype(np.float64) * scale).astype(np.int64)


def residuals(packets: list[Packet]) -> list[ResidualHeader]:
    return [ResidualHeader.from_map(each.header) for each in members_of(packets) if each.type == PacketType.RESIDUAL]


def test_every_value_comes_back(path: Path, packets: list[Packet], sequence: ListSequence) -> None:
    assert [(head.frame, head.count, head.kind) for head in residuals(packets)] == [(0, 4, 3), (4, 3, 3)]
    scale = sequence.info.depth_scale
    for got, frame in zip(threedvc.decode(path), sequence, strict=True):
        np.testing.assert_array_equal(raw(got.depth, scale), raw(frame.depth, scale))


@pytest.mark.parametrize(
    ("error", "most"),
    [
        (DepthErrorConfig(kind=DepthErrorKind.ABSOLUTE, size=0.005), lambda measured: 0.005),
        (DepthErrorConfig(kind=DepthErrorKind.RELATIVE, size=0.01), lambda measured: 0.01 * measured),
    ],
    ids=["5 mm", "1 %"],
)
def test_errors_keep_within_the_bound(
    error: DepthErrorConfig, most: object, path: Path, sequence: ListSequence, tmp_path: Path
) -> None:
    bounded = written(encoded(sequence, depth_error=error), tmp_path / "bounded.3dvc")
    assert bounded.stat().st_size < path.stat().st_size
    for got, frame in zip(threedvc.decode(bounded), sequence, strict=True):
        np.testing.assert_array_equal(got.depth > 0, frame.depth > 0)
        assert (np.abs(got.depth - frame.depth) <= most(frame.depth) + 1e-6).all()  # type: ignore[operator]


def test_one_level_off_is_a_neighbor(sequence: ListSequence, tmp_path: Path) -> None:
    level = written(encoded(sequence, depth_error=DepthErrorConfig(kind=DepthErrorKind.LEVEL)), tmp_path / "a.3dvc")
    scale = sequence.info.depth_scale
    levels = np.unique(np.concatenate([raw(frame.depth, scale).ravel() for frame in sequence]))
    for got, frame in zip(threedvc.decode(level), sequence, strict=True):
        places = [np.searchsorted(levels, raw(depth, scale)) for depth in (got.depth, frame.depth)]
        assert np.abs(places[0] - places[1]).max() <= 1


def test_elsewhere_and_at_other_sizes_models_are_shown(path: Path) -> None:
    models = RenderConfig(captured_depth=False)
    for other in ({"size": (32, 24)}, {"camera_path": [identity()]}, {"objects": [0]}):
        shown = [list(threedvc.decode(path, render=render, **other)) for render in (None, models)]
        np.testing.assert_array_equal(*([frame.depth for frame in frames] for frames in shown))


def test_a_part_of_the_frames(path: Path) -> None:
    whole = [frame.depth for frame in threedvc.decode(path)]
    np.testing.assert_array_equal([frame.depth for frame in threedvc.decode(path, frames=(3, 6))], whole[3:6])


def test_bytes_do_not_depend_on_threads(packets: list[Packet], sequence: ListSequence) -> None:
    assert [each.payload for each in encoded(sequence, threads=1)] == [each.payload for each in packets]


def test_every_sensor_has_its_own(sequence: ListSequence, tmp_path: Path) -> None:
    frames = [replace(frame, depth=frame.depth[:, ::-1].copy()) for frame in sequence]
    merged = MergedSequence([sequence, ListSequence(frames, sequence.info)], [identity()])
    path = written(encoded(merged), tmp_path / "two.3dvc")
    for sensor, measured in enumerate((list(sequence), frames)):
        for got, frame in zip(threedvc.decode(path, sensor=sensor), measured, strict=True):
            np.testing.assert_allclose(got.depth, frame.depth, atol=1e-6)


def damaged(packets: list[Packet], **changes: object) -> list[Packet]:
    """Return the packets with those of measured depth changed."""
    return with_changed(packets, PacketType.RESIDUAL, lambda packet: replace(packet, **changes))  # type: ignore[arg-type]


@pytest.mark.parametrize("payload", [b"", b"\x05abc", bytes(40)])
def test_damage_is_one_error(payload: bytes, packets: list[Packet], tmp_path: Path) -> None:
    path = written(damaged(packets, payload=payload), tmp_path / "damaged.3dvc")
    with pytest.raises(CorruptStream):
        list(threedvc.decode(path))
    assert len(list(threedvc.decode(path, what=frozenset({"color"})))) == FRAMES


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"n": 0}, "'n'"),
        ({"k": 4}, "'k'"),
        ({"e": -1}, "'e'"),
        ({"s": 1}, "names sensor 1, but the stream has 1"),
        ({"n": 2}, "goes on after its end"),
        ({"n": 5}, "stands in the BATCH of frames"),
        ({"f": 3}, "stands in the BATCH of frames"),
        ({"u": True}, "saturated"),
        ({"u": 1}, "'u'"),
    ],
)
def test_headers_that_lie_are_one_error(change: dict[str, int], message: str, packets: list[Packet]) -> None:
    changed = with_changed(packets, PacketType.RESIDUAL, lambda packet: replace(packet, header=packet.header | change))
    with pytest.raises(CorruptStream, match=message) as raised:
        list(Decoder().frames(changed))
    assert "\n" not in str(raised.value)


def test_runs_of_too_many_samples_are_refused(packets: list[Packet]) -> None:
    header = next(each.header for each in members_of(packets) if each.type == PacketType.RESIDUAL)
    with pytest.raises((CorruptStream, LimitExceeded)):
        list(Decoder().frames(damaged(packets, header=header | {"n": 1 << 20})))


@pytest.fixture(scope="module")
def folder(sequence: ListSequence, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write the frames as a recording."""
    folder = tmp_path_factory.mktemp("frames") / "room"
    with PlainSink(folder, sequence.info, threads=1) as sink:
        for frame in sequence:
            sink.write_frame(frame)
    return folder


@pytest.mark.skipif(not can_encode_ffv1(), reason="this build of PyAV has no FFV1")
def test_lossless_gives_back_every_picture(folder: Path, tmp_path: Path) -> None:
    stream = str(tmp_path / "a.3dvc")
    options = ["--lossless", "--preset", "fast", "--voxel-size", "6cm"]
    assert CliRunner().invoke(main, ["encode", str(folder), stream, *options]).exit_code == 0
    assert CliRunner().invoke(main, ["decode", stream, str(tmp_path / "out")]).exit_code == 0
    for kind in ("color", "depth"):
        names = sorted(path.name for path in (folder / kind).iterdir())
        assert names == sorted(path.name for path in (tmp_path / "out" / kind).iterdir())
        for name in names:
            given, back = (cv2.imread(str(place / kind / name), -1) for place in (folder, tmp_path / "out"))
            np.testing.assert_array_equal(back, given)
    report = CliRunner().invoke(main, ["stats", stream, "--reference", str(folder)]).stdout
    assert "exact               color lossless, depth lossless\n" in report


@pytest.fixture(scope="module")
def saturated(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a recording whose sensor says 65535 for some of what it does not measure, and 0 for the rest."""
    copy = tmp_path_factory.mktemp("saturated") / "room"
    shutil.copytree(folder, copy)
    for number, path in enumerate(sorted((copy / "depth").iterdir())):
        depth = cv2.imread(str(path), -1)
        depth[:9, : 6 * number] = 65535
        depth[20:24, 30:] = 0
        cv2.imwrite(str(path), depth)
    return copy


@pytest.mark.skipif(not can_encode_ffv1(), reason="this build of PyAV has no FFV1")
@pytest.mark.parametrize(("error", "exact"), [("lossless", True), ("1mm", False)])
def test_saturated_values_come_back(error: str, exact: bool, saturated: Path, tmp_path: Path) -> None:
    stream, out = str(tmp_path / "a.3dvc"), tmp_path / "out"
    options = ["--depth-error", error, "--color-video", "off", "--preset", "fast", "--voxel-size", "6cm"]
    assert CliRunner().invoke(main, ["encode", str(saturated), stream, *options]).exit_code == 0
    assert CliRunner().invoke(main, ["decode", stream, str(out)]).exit_code == 0
    for path in (saturated / "depth").iterdir():
        given, back = (cv2.imread(str(place), -1) for place in (path, out / "depth" / path.name))
        np.testing.assert_array_equal(back[back < 65535] > 0, given[back < 65535] % 65535 > 0)
        assert np.array_equal(back, given) or not exact
    report = CliRunner().invoke(main, ["stats", stream, "--reference", str(saturated)]).stdout
    assert ("depth lossless" in report) == exact
    shown = [frame.depth for frame in threedvc.decode(stream)]
    assert max(float(depth.max()) for depth in shown) < 10
    if exact:
        small = list(threedvc.decode(stream, size=(32, 24)))
        assert all(frame.saturated is None for frame in small)


@pytest.mark.parametrize(
    "other", [["--bitrate", "50k"], ["--preset", "live"], ["--color-video", "off"], ["--depth-error", "5mm"]]
)
def test_lossless_contradicts_what_loses(other: list[str], folder: Path, tmp_path: Path) -> None:
    result = CliRunner().invoke(main, ["encode", str(folder), str(tmp_path / "a.3dvc"), "--lossless", *other])
    assert (result.exit_code, "--lossless and" in result.output) == (2, True)


def test_a_rate_contradicts_a_bound(sequence: ListSequence, folder: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="follow from it"):
        encoded(sequence, bitrate_bps=50_000.0)
    options = ["encode", str(folder), str(tmp_path / "a.3dvc"), "--depth-error", "5mm"]
    result = CliRunner().invoke(main, [*options, "--bitrate", "50k"])
    assert (result.exit_code, "--depth-error and --bitrate contradict each other" in result.output) == (2, True)
    result = CliRunner().invoke(main, [*options[:-1], "5 apples"])
    assert (result.exit_code, "is no bound" in result.output) == (2, True)
    result = CliRunner().invoke(main, [*options[:-1], "70%"])
    assert (result.exit_code, "must be more than 0 and at most 0.5" in result.output) == (1, True)
