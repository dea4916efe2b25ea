# SPDX-License-Identifier: MIT
"""Runs of pictures as AV1, whole and damaged."""

from __future__ import annotations

import os
import tracemalloc
from base64 import b64decode
from collections.abc import Iterator

import numpy as np
import pytest

from threedvc.coding.video import av1, scheduling
from threedvc.coding.video.av1 import Av1Settings, can_encode_av1, decode_av1, encode_av1
from threedvc.coding.video.av1_units import pack_units, read_sequence_header, unpack_units
from threedvc.coding.video.planes import Planes, VideoFormat
from threedvc.errors import CorruptStream, UnsupportedVersion
from threedvc.stream.wire import pack_varint

pytestmark = pytest.mark.skipif(not can_encode_av1(), reason="this build of PyAV has no AV1")

SIZE = VideoFormat(width=70, height=50, bits=10)
COUNT = 9
LARGER = b64decode(
    "DAAAAAf4AigBiJXygICcARIAAfwA/IXAAAAAAIBfOHb9woU455IbJSRNHfmDQETepY5dd+rVeFeM3+GqhtxV37+wuiVu26V3GwhXGnM0MwraQD/h"
    "XC3hl1Z+ZzQBIn7/Gtvd1412ZdH0MevObVnapgtGfJK2YBcpWvOg4yLw19I+8wOgnwRyYJB5xgwBr8QwfQqbxRTCP/qwnxw6TpVf/Syt1m5DNx/7"
    "bHT8nLg="
)
"""A video whose sequence header says 70x50, and its frame 128x64."""


def moving(video: VideoFormat, count: int) -> list[Planes]:
    rows, columns = video.chroma_shape
    y, x = np.mgrid[: video.height, : video.width]
    unit = 1 << (video.bits - 8)
    return [
        Planes(
            np.rint(unit * (120 + 60 * np.sin((x + 2 * k) / 9) + 40 * np.cos((y - k) / 7))).astype(np.uint16),
            *(np.rint(unit * (128 + 30 * np.sin((x + k + c) / 8)))[:rows, :columns].astype(np.uint16) for c in (0, 9)),
        )
        for k in range(count)
    ]


def encoded(video: VideoFormat, count: int, crf: float = 20, threads: int = 1) -> bytes:
    return encode_av1(moving(video, count), video, Av1Settings(crf=crf, preset=10, threads=threads))


def decoded(payload: bytes, count: int = COUNT, video: VideoFormat = SIZE) -> list[Planes]:
    return list(decode_av1(payload, count, video))


@pytest.fixture(scope="module")
def payload() -> bytes:
    return encoded(SIZE, COUNT)


@pytest.mark.parametrize("bits", [8, 10])
@pytest.mark.parametrize(("width", "height", "count"), [(1, 1, 1), (3, 2, 2), (37, 23, 5), (64, 48, 1), (70, 50, 40)])
def test_any_number_and_size_come_back(width: int, height: int, count: int, bits: int) -> None:
    video = VideoFormat(width=width, height=height, bits=bits)
    got = decoded(encoded(video, count), count, video)
    assert len(got) == count
    for planes, wanted in zip(got, moving(video, count), strict=True):
        for plane, other in zip(planes, wanted, strict=True):
            assert plane.shape == other.shape
            assert plane.dtype == np.uint16
            assert np.abs(plane.astype(int) - other).mean() < 3 << (bits - 8)


def interrupted() -> Iterator[Planes]:
    yield from moving(SIZE, 3)
    raise KeyboardInterrupt


def test_payloads_do_not_depend_on_threads(payload: bytes) -> None:
    assert encoded(SIZE, COUNT, threads=3) == encoded(SIZE, COUNT, threads=2) == payload


def test_finer_is_larger() -> None:
    sizes = [len(encoded(SIZE, COUNT, crf)) for crf in (15, 40, 40.5, 70)]
    assert sizes == sorted(sizes, reverse=True)
    assert len(set(sizes)) == 4


def test_nothing_is_said_on_the_way(payload: bytes, capfd: pytest.CaptureFixture[str]) -> None:
    encoded(SIZE, 2)
    with pytest.raises(KeyboardInterrupt):
        encode_av1(interrupted(), SIZE, Av1Settings(crf=30, preset=10, threads=2))
    decoded(payload)
    with pytest.raises(CorruptStream):
        decoded(payload[:300] + bytes(len(payload) - 300))
    assert capfd.readouterr() == ("", "")


@pytest.mark.skipif(not hasattr(os, "sched_getscheduler"), reason="no scheduling classes")
def test_no_thread_gets_another_scheduling_class() -> None:
    """As root the encoder takes the real-time class, in which it would leave nothing to others."""
    before = os.sched_getscheduler(0)
    found: set[int] = set()

    def watched() -> Iterator[Planes]:
        for planes in moving(SIZE, COUNT):
            yield planes
            found.add(os.sched_getscheduler(0))
            found.update(os.sched_getscheduler(int(task)) for task in os.listdir(scheduling.TASKS))

    encode_av1(watched(), SIZE, Av1Settings(crf=20, preset=10, threads=2))
    assert found == {before}
    assert os.sched_getscheduler(0) == before


def test_truncated_payloads_are_refused(payload: bytes) -> None:
    for size in range(0, len(payload), 7):
        with pytest.raises(CorruptStream, match="the stream is damaged"):
            decoded(payload[:size])


def test_no_damage_does_worse_than_spoil_pictures(payload: bytes) -> None:
    rng = np.random.default_rng(3)
    refused = 0
    for _ in range(200):
        damaged = bytearray(payload)
        for at in rng.integers(0, len(payload), rng.integers(1, 4)):
            damaged[at] = rng.integers(256)
        try:
            assert len(decoded(bytes(damaged))) == COUNT
        except CorruptStream:
            refused += 1
    assert refused > 20


@pytest.mark.parametrize("count", [COUNT + 1, 1 << 20])
def test_missing_pictures_are_noticed(payload: bytes, count: int) -> None:
    with pytest.raises(CorruptStream, match=f"a video of 9 pictures should be one of {count}"):
        decode_av1(payload, count, SIZE)


@pytest.mark.parametrize("count", [0, 1, COUNT - 1])
def test_more_pictures_are_noticed(payload: bytes, count: int) -> None:
    with pytest.raises(CorruptStream, match=f"a video of {count} pictures has more"):
        decode_av1(payload, count, SIZE)


@pytest.mark.parametrize("unit", [b"\0\x10", b"\0\0"], ids=["shown", "not shown"])
def test_many_small_units_are_not_read_to_their_end(payload: bytes, unit: bytes) -> None:
    tracemalloc.start()
    with pytest.raises(CorruptStream, match="or one of more than 32 units"):
        decode_av1(payload + unit * (1 << 20), COUNT, SIZE)
    assert tracemalloc.get_traced_memory()[1] < 8 << 20
    tracemalloc.stop()


@pytest.mark.parametrize(("width", "height", "bits"), [(72, 50, 10), (70, 48, 10), (50, 70, 10), (70, 50, 8)])
def test_another_format_is_refused(payload: bytes, width: int, height: int, bits: int) -> None:
    with pytest.raises(CorruptStream, match="a video of 70x50 samples of 10 bits should have"):
        decode_av1(payload, COUNT, VideoFormat(width=width, height=height, bits=bits))


def test_frames_of_another_size_are_refused(payload: bytes) -> None:
    other = unpack_units(encoded(VideoFormat(width=40, height=50, bits=10), COUNT))[1]
    header, _ = unpack_units(payload)
    frames = [unit[2 + len(header) :] if k == 0 else unit for k, unit in enumerate(other)]
    mixed = pack_units([b"\x0a" + pack_varint(len(header)) + header, *frames])
    with pytest.raises(CorruptStream, match="the stream is damaged"):
        decoded(mixed)


def test_frames_that_say_they_are_larger_are_refused() -> None:
    with pytest.raises(CorruptStream, match="picture 0 of a video cannot be decoded"):
        decoded(LARGER, 1)


def test_a_missing_frame_is_refused(payload: bytes) -> None:
    _, pictures = unpack_units(payload)
    for missing in range(COUNT):
        kept = [unit for k, unit in enumerate(pictures) if k != missing]
        with pytest.raises((CorruptStream, ValueError), match=r"damaged|sequence headers"):
            decoded(pack_units(kept))


def test_sequence_headers_tell_the_format(payload: bytes) -> None:
    header, pictures = unpack_units(payload)
    assert len(pictures) == COUNT
    assert read_sequence_header(header) == (70, 50, 10, False, False)
    for size in range(len(header) - 1):
        with pytest.raises(CorruptStream, match="cut short"):
            read_sequence_header(header[:size])
    with pytest.raises(CorruptStream, match="unknown make"):
        read_sequence_header(b"\x10" + header[1:])


def test_videos_with_noise_to_be_added_are_refused(payload: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(av1, "SETTINGS", av1.SETTINGS.replace("film-grain=0", "film-grain=20"))
    assert read_sequence_header(unpack_units(encoded(SIZE, COUNT))[0]).grain
    with pytest.raises(CorruptStream, match="no noise added"):
        decode_av1(encoded(SIZE, COUNT), COUNT, SIZE)


def test_units_of_other_kinds_are_not_written() -> None:
    with pytest.raises(ValueError, match="unit 0x2a"):
        pack_units([b"\x2a\x01\x00"])
    with pytest.raises(ValueError, match="0 sequence headers"):
        pack_units([b"\x12\x00"])


def test_builds_without_av1_say_so(payload: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(av1, "_decoder_name", lambda: None)
    with pytest.raises(UnsupportedVersion, match="install av"):
        decode_av1(payload, COUNT, SIZE)
    monkeypatch.setattr(av1, "can_encode_av1", lambda: False)
    with pytest.raises(UnsupportedVersion, match="install av"):
        encoded(SIZE, COUNT)
