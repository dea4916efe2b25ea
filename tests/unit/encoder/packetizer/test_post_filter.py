# SPDX-License-Identifier: MIT
"""The filter of drawn pictures: its classes of pixels, its arithmetic, its payload and its fit."""

from __future__ import annotations

import io
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from helpers.streams import ListSequence, drawn
from threedvc.coding.entropy.range_coder import RangeWriter, new_counters
from threedvc.coding.filters import MAX_FACTOR, decode_filter, encode_filter
from threedvc.config import ColorVideo, EncoderConfig, FilterParts, Motion, Preset, RenderConfig, Sensor, with_preset
from threedvc.decoder.decoder import Decoder
from threedvc.encoder.packetizer.post_filter_fit import fit_post_filter
from threedvc.encoder.pipeline.encoder import Encoder
from threedvc.errors import CorruptStream
from threedvc.formats.container import StreamReader
from threedvc.formats.decoding import decode
from threedvc.formats.encoding import encode
from threedvc.kernels.coding.range_coder import NUMBER_COUNTERS
from threedvc.kernels.render.picture_filter import OFFSETS
from threedvc.model.post_filter import PAIRS, PIXEL_CLASSES, PostFilter, classify_pixels
from threedvc.stream.batch import pack_batch, unpack_batch
from threedvc.stream.headers import BatchHeader
from threedvc.stream.packets import Packet, PacketType
from threedvc.synthesis import SyntheticSequence, make_scene

FILE = EncoderConfig(color_video=ColorVideo.OFF, threads=1, sensor=Sensor.IDEAL, motion=Motion.KNOWN, voxel_size_m=0.04)
FRAMES = 5


def some_filter(seed: int = 1) -> PostFilter:
    rng = np.random.default_rng(seed)
    luma, chroma = (rng.integers(-30, 31, (PIXEL_CLASSES, PAIRS)).astype(np.int32) for _ in range(2))
    luma[4], chroma[4] = 0, 0
    return PostFilter(luma=luma, chroma=chroma)


def noise(height: int = 23, width: int = 31) -> NDArray[np.uint8]:
    return np.random.default_rng(5).integers(0, 256, (height, width, 3), dtype=np.uint8)


def filtered_by_definition(
    picture: NDArray[np.uint8], pixel_classes: NDArray[np.uint8], filters: PostFilter
) -> NDArray[np.uint8]:
    """Filter as docs/drawing.md says, in floats."""
    height, width, _ = picture.shape
    rgb = picture.astype(float)
    luma = rgb @ [0.25, 0.5, 0.25]
    result = np.empty_like(picture)
    for y in range(height):
        for x in range(width):
            value = rgb[y, x].copy()
            for pair, (dy, dx) in enumerate(OFFSETS.tolist()):
                one = min(max(y + dy, 0), height - 1), min(max(x + dx, 0), width - 1)
                two = min(max(y - dy, 0), height - 1), min(max(x - dx, 0), width - 1)
                of_luma, of_chroma = (
                    int(all_of[pixel_classes[y, x], pair]) / 64 for all_of in (filters.luma, filters.chroma)
                )
                value += of_chroma * (rgb[one] + rgb[two] - 2 * rgb[y, x])
                value += (of_luma - of_chroma) * (luma[one] + luma[two] - 2 * luma[y, x])
            result[y, x] = np.clip(np.floor(value + 0.5), 0, 255)
    return result


@pytest.mark.parametrize("threads", [1, 3])
def test_filter_is_that_of_the_definition(threads: int) -> None:
    picture, filters = noise(), some_filter()
    pixel_classes = np.random.default_rng(2).integers(0, PIXEL_CLASSES, picture.shape[:2], dtype=np.uint8)
    pixel_classes[:, 20:] = 4
    result = filters.apply(picture, pixel_classes, threads)
    np.testing.assert_array_equal(result, filtered_by_definition(picture, pixel_classes, filters))
    np.testing.assert_array_equal(result[:, 20:], picture[:, 20:])


def test_plain_areas_stay() -> None:
    plain = np.full((9, 12, 3), (10, 200, 90), np.uint8)
    pixel_classes = np.zeros((9, 12), np.uint8)
    np.testing.assert_array_equal(some_filter().apply(plain, pixel_classes, 1), plain)


def test_parts_can_be_switched() -> None:
    picture, filters = noise(), some_filter()
    pixel_classes = np.tile(np.arange(PIXEL_CLASSES, dtype=np.uint8), (23, 6))[:, :31]
    everywhere = filters.apply(picture, pixel_classes, 1)
    for parts, on in (
        (FilterParts.ALL, (0, 1, 2, 3, 4, 5)),
        (FilterParts.NONE, ()),
        (FilterParts.SILHOUETTES, (0, 1, 3, 4)),
        (FilterParts.SURFACES, (2, 5)),
    ):
        wanted = np.where(np.isin(pixel_classes, on)[..., None], everywhere, picture)
        np.testing.assert_array_equal(filters.of(parts).apply(picture, pixel_classes, 1), wanted)


def test_kinds_of_pixels() -> None:
    depth = np.full((30, 40), 1.0, np.float32)
    labels = np.zeros((30, 40), np.uint8)
    labels[:, 30:] = 2
    depth[:, :3] = 0
    depth[20:, 3:30] = 1.04
    edge = np.zeros((30, 40), dtype=bool)
    edge[:, :4] = edge[:, 29:31] = True
    pixel_classes = classify_pixels(depth, labels, False)
    columns = np.arange(40)
    away = np.abs(columns[:, None] - np.flatnonzero(edge[0])).min(axis=1)
    expected = np.where(away <= 1, 0, np.where(away <= 5, 1, 2))
    np.testing.assert_array_equal(pixel_classes, np.tile(expected, (30, 1)))
    np.testing.assert_array_equal(classify_pixels(depth, labels, True), pixel_classes + 3 * (labels == 0))
    depth[20:, 3:30] = 1.06
    assert classify_pixels(depth, labels, False)[19, 15] == 0


@pytest.mark.parametrize("gray", [False, True])
def test_payload_comes_back(gray: bool) -> None:
    filters = some_filter()
    if gray:
        filters = PostFilter(luma=filters.luma, chroma=filters.luma)
    again = decode_filter(encode_filter(filters, gray), gray)
    np.testing.assert_array_equal(again.luma, filters.luma)
    np.testing.assert_array_equal(again.chroma, filters.chroma)
    assert len(encode_filter(PostFilter.none(), gray)) < 4


def test_impossible_factors_are_refused() -> None:
    filters = some_filter()
    filters.luma[2, 3] = MAX_FACTOR + 1
    with pytest.raises(ValueError, match="within"):
        encode_filter(filters, False)
    writer, counters = RangeWriter(), new_counters(NUMBER_COUNTERS)
    writer.bit(True)
    writer.signed(MAX_FACTOR + 1, counters)
    with pytest.raises(CorruptStream, match="factors of a filter are out of range"):
        decode_filter(writer.finish(), True)
    with pytest.raises(CorruptStream, match="ends too early"):
        decode_filter(encode_filter(some_filter(), False)[:10], False)


@pytest.fixture(scope="module")
def sequence() -> ListSequence:
    source = SyntheticSequence(make_scene("room", frames=60, size=(96, 72)), threads=1)
    kept = [replace(source[index], index=index) for index in range(FRAMES)]
    return ListSequence(kept, replace(source.info, frame_count=FRAMES))


@pytest.fixture(scope="module")
def stream(sequence: ListSequence) -> bytes:
    sink = io.BytesIO()
    encode(sequence, sink, with_preset(FILE, Preset.FAST))
    return sink.getvalue()


@pytest.fixture(scope="module")
def packets(stream: bytes) -> list[Packet]:
    return list(StreamReader(io.BytesIO(stream), "room"))


def error(pictures: list[NDArray[np.uint8]], sequence: ListSequence) -> float:
    frames = zip(pictures, sequence.frames, strict=True)
    return float(np.mean([np.log(np.square(p.astype(float) - frame.color).mean()) for p, frame in frames]))


def without_filter(packets: list[Packet]) -> list[Packet]:
    rest = []
    for packet in packets:
        if packet.type == PacketType.BATCH:
            kept = [member for member in unpack_batch(packet) if member.type != PacketType.FILTER]
            packet = pack_batch(BatchHeader.from_map(packet.header), kept)
        rest.append(packet)
    return rest


def test_a_fitted_filter_mends_pictures(sequence: ListSequence, packets: list[Packet]) -> None:
    plain = without_filter(packets)
    assert len(plain) == len(packets)
    assert error(drawn(packets), sequence) < error(drawn(plain), sequence) - 0.02
    fitted = fit_post_filter(plain, sequence, 2)
    sent = next(state.filters for state in Decoder().frames(packets))
    assert fitted is not None
    assert sent is not None
    np.testing.assert_array_equal(fitted.luma, sent.luma)
    np.testing.assert_array_equal(fitted.chroma, sent.chroma)


def test_threads_do_not_change_the_fit(sequence: ListSequence, packets: list[Packet]) -> None:
    plain = without_filter(packets)
    one, two = (fit_post_filter(plain, sequence, threads) for threads in (1, 3))
    assert one is not None
    assert two is not None
    np.testing.assert_array_equal(one.luma, two.luma)
    np.testing.assert_array_equal(one.chroma, two.chroma)


def test_live_streams_have_no_filter(sequence: ListSequence) -> None:
    packets = list(Encoder(sequence.info, replace(FILE, causal=True)).packets(sequence))
    assert all(state.filters is None for state in Decoder().frames(packets))


def test_pictures_are_filtered_as_asked_and_only_as_filmed(stream: bytes) -> None:
    def pictures(parts: FilterParts = FilterParts.ALL, **choices: Any) -> list[NDArray[np.uint8]]:
        render = RenderConfig(filter_parts=parts, threads=1)
        return [frame.color for frame in decode(io.BytesIO(stream), render=render, **choices)]

    filtered, plain = pictures(), pictures(FilterParts.NONE)
    assert any((one != other).any() for one, other in zip(filtered, plain, strict=True))
    for choices in ({"size": (64, 48)}, {"camera_path": [np.eye(4)]}):
        for one, other in zip(pictures(**choices), pictures(FilterParts.NONE, **choices), strict=True):
            np.testing.assert_array_equal(one, other)
