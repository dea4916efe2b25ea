# SPDX-License-Identifier: MIT
"""Damaged and random payloads end in an error of ours, or decode to something lawful; quickly."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from helpers.earlier_pictures import RUNS, STILLS
from threedvc.coding.color import ColorSettings
from threedvc.coding.depth_cells import spread
from threedvc.coding.depth_picture import MAX_SAMPLE, DepthPicture, DepthSteps, decode_depths, encode_depths
from threedvc.coding.filters import MAX_FACTOR, decode_filter
from threedvc.coding.measured_depth.saturated import SaturatedPixels
from threedvc.coding.morton import morton_order
from threedvc.coding.poses import PoseCoder
from threedvc.coding.relief import decode_relief, encode_relief
from threedvc.coding.update import decode_update, encode_update_with_result
from threedvc.coding.video.av1 import Av1Settings, can_encode_av1, decode_av1, encode_av1
from threedvc.coding.video.earlier import decode_earlier_run, decode_earlier_still
from threedvc.coding.video.jpeg import decode_jpeg_files
from threedvc.coding.video.parts import pack_parts
from threedvc.coding.video.planes import VideoFormat, gray_planes
from threedvc.coding.video.still import decode_still, encode_still
from threedvc.errors import FormatError
from threedvc.geometry.camera import Camera
from threedvc.geometry.pose import identity
from threedvc.model.decoded_model import DecodedModel
from threedvc.model.model_update import ModelUpdate
from threedvc.stream.compressed_payload import compress
from threedvc.stream.wire import ByteReader, pack_varint

NO_CELLS = np.empty((0, 3), dtype=np.int32)
needs_av1 = pytest.mark.skipif(not can_encode_av1(), reason="this build of PyAV has no AV1")
NO_COLORS = np.empty((0, 3), dtype=np.int16)


def state() -> tuple[NDArray[np.int32], NDArray[np.int16]]:
    """Return a bent sheet of cells and its colors."""
    x, y = np.meshgrid(np.arange(-12, 13), np.arange(-12, 13))
    cells = np.stack([x, y, x * y // 20], axis=-1).reshape(-1, 3).astype(np.int32)
    cells = cells[morton_order(cells)]
    return cells, (cells * 9 + 100).astype(np.int16)


CELLS, COLORS = state()
NEW = CELLS + np.array([25, 0, 0], dtype=np.int32)
UPDATE = ModelUpdate(
    added=NEW[morton_order(NEW)],
    added_colors=COLORS,
    removed=CELLS[::50],
    recolored=CELLS[7::50],
    recolored_colors=COLORS[7::50] + np.int16(70),
)


@cache
def update_payload() -> bytes:
    return encode_update_with_result(UPDATE, CELLS, COLORS, ColorSettings(luma_step=10, chroma_step=20))[0]


def places(payload: Callable[[], bytes]) -> st.SearchStrategy[int]:
    """Draw a place in a payload, which is made once a test asks for it."""
    return st.deferred(lambda: st.integers(0, len(payload()) - 1))


def decode_lawfully(payload: bytes, cells: NDArray[np.int32], colors: NDArray[np.int16]) -> None:
    """Decode; either a FormatError is raised or the update is one that fits the state."""
    try:
        update = decode_update(payload, cells, colors)
    except FormatError:
        return
    there = set(map(tuple, cells.tolist()))
    sets = [set(map(tuple, part.tolist())) for part in (update.added, update.removed, update.recolored)]
    assert not sets[0] & there
    assert sets[1] | sets[2] <= there
    assert not sets[1] & sets[2]
    assert len(update.added_colors) == len(update.added) == len(sets[0])
    assert len(update.recolored_colors) == len(update.recolored)
    assert all(np.all((c >= -256) & (c <= 511)) for c in (update.added_colors, update.recolored_colors))


@given(st.binary(max_size=200))
def test_random_bytes(payload: bytes) -> None:
    decode_lawfully(payload, NO_CELLS, NO_COLORS)
    decode_lawfully(payload, CELLS, COLORS)


@given(places(update_payload), st.integers(1, 255))
def test_changed_byte(position: int, change: int) -> None:
    damaged = bytearray(update_payload())
    damaged[position] ^= change
    decode_lawfully(bytes(damaged), CELLS, COLORS)


@given(places(update_payload))
def test_cut_payload(length: int) -> None:
    decode_lawfully(update_payload()[:length], CELLS, COLORS)


@given(st.integers(1, 255), st.integers(0, 60))
def test_long_runs_of_one_byte(byte: int, length: int) -> None:
    decode_lawfully(bytes([byte]) * length * 20, CELLS, COLORS)


def bare_model() -> DecodedModel:
    """Return a sheet of cells whose relief is not told yet."""
    model = DecodedModel(0.02, relief_bits=2)
    sheet = ModelUpdate(
        added=CELLS, added_colors=COLORS, removed=NO_CELLS, recolored=NO_CELLS, recolored_colors=NO_COLORS
    )
    model.apply(sheet)
    return model


@cache
def relief_payload() -> bytes:
    crossings = np.random.default_rng(1).uniform(-0.6, 0.6, (len(CELLS), 3)).astype(np.float32)
    return encode_relief(bare_model(), crossings)


def shape_lawfully(payload: bytes) -> None:
    """Decode a relief; either a FormatError is raised, or every cell has a level of its own."""
    model = bare_model()
    try:
        decode_relief(payload, model)
    except FormatError:
        return
    assert not len(model.cells_without_offset()[0])
    model.fit_planes()
    assert np.all(model.planes.reshape(-1, 4)[:, 3] <= 127)


@given(st.binary(max_size=200))
def test_random_relief(payload: bytes) -> None:
    shape_lawfully(payload)


@given(places(relief_payload), st.integers(1, 255))
def test_changed_byte_of_a_relief(position: int, change: int) -> None:
    damaged = bytearray(relief_payload())
    damaged[position] ^= change
    shape_lawfully(bytes(damaged))


@given(places(relief_payload))
def test_cut_relief(length: int) -> None:
    shape_lawfully(relief_payload()[:length])


SMALL = Camera(width=20, height=15, fx=20.0, fy=20.0, cx=9.5, cy=7.0)


@cache
def depth_payload() -> bytes:
    """Return the payload of a bent wall with a hole."""
    x, y = np.meshgrid(np.arange(20), np.arange(15))
    samples = 3000 + 40 * x + np.where(x > 9, 25 * y, 900)
    samples[3:7, 4:8] = 0
    steps = DepthSteps(step=20, levels=3, halvings=1)
    return encode_depths(DepthPicture(samples=samples, spacing=1, scale_bits=12), steps)[0]


def spread_lawfully(payload: bytes) -> None:
    """Decode a depth picture and make cells of it; either a FormatError is raised, or each has a relief."""
    model = DecodedModel(0.1, relief_bits=3)
    try:
        picture = decode_depths(payload, SMALL.width, SMALL.height)
        assert np.all((picture.samples >= 0) & (picture.samples <= MAX_SAMPLE))
        spread(picture, model, SMALL, identity())
    except FormatError:
        return
    assert not len(model.cells_without_offset()[0])


@settings(deadline=None)
@given(st.binary(max_size=100))
def test_random_depths(payload: bytes) -> None:
    spread_lawfully(payload)


@settings(deadline=None)
@given(places(depth_payload), st.integers(1, 255))
def test_changed_byte_of_depths(position: int, change: int) -> None:
    damaged = bytearray(depth_payload())
    damaged[position] ^= change
    spread_lawfully(bytes(damaged))


@settings(deadline=None)
@given(places(depth_payload))
def test_cut_depths(length: int) -> None:
    spread_lawfully(depth_payload()[:length])


@given(st.binary(max_size=120), st.booleans())
def test_random_filter(payload: bytes, gray: bool) -> None:
    try:
        filters = decode_filter(payload, gray)
    except FormatError:
        return
    assert np.abs([filters.luma, filters.chroma]).max() <= MAX_FACTOR


@cache
def jpeg_payload() -> bytes:
    x, y = np.meshgrid(np.arange(40), np.arange(24))
    picture = np.stack([6 * x, 9 * y, 120 + x + y], axis=-1).astype(np.uint8)
    progressive = [cv2.IMWRITE_JPEG_PROGRESSIVE, 1]
    return pack_parts([bytes(cv2.imencode(".jpg", picture, choices)[1]) for choices in ([], progressive)])


def show_lawfully(payload: bytes) -> None:
    """Decode two JPEG files; either a FormatError is raised, or both have the size they should."""
    try:
        pictures = list(decode_jpeg_files(payload, 2, VideoFormat(width=40, height=24, bits=8)))
    except FormatError:
        return
    assert [picture.shape for picture in pictures] == [(24, 40, 3)] * 2


@given(st.lists(st.tuples(places(jpeg_payload), st.integers(1, 255)), min_size=1, max_size=4))
def test_changed_bytes_of_jpeg_files(changes: list[tuple[int, int]]) -> None:
    damaged = bytearray(jpeg_payload())
    for position, change in changes:
        damaged[position] ^= change
    show_lawfully(bytes(damaged))


@given(places(jpeg_payload), st.integers(0, 40), st.binary(max_size=20))
def test_lost_and_added_bytes_of_jpeg_files(position: int, taken: int, put: bytes) -> None:
    payload = jpeg_payload()
    show_lawfully(payload[:position] + put + payload[position + taken :])


@given(st.binary(max_size=60), st.integers(0, 80))
def test_random_marks_of_saturated_pixels(payload: bytes, missing: int) -> None:
    depth = np.arange(80).reshape(8, 10).astype(np.uint16)
    depth[depth < missing] = 0
    for data in (payload, pack_varint(len(compress(payload))) + compress(payload)):
        try:
            pixels = SaturatedPixels(ByteReader(data), depth.size)
            found = pixels.of(depth)
            pixels.finish()
        except FormatError:
            continue
        assert not found[depth > 0].any()


@given(st.binary(max_size=60), st.integers(0, 40))
def test_random_poses(payload: bytes, count: int) -> None:
    try:
        poses = PoseCoder(0.0005, 0.00025).decode(payload, count)
    except FormatError:
        return
    assert poses.shape == (count, 4, 4)
    assert np.all(np.isfinite(poses))


SEEN = VideoFormat(width=37, height=23, bits=10, gray=True)


@cache
def depth_video_payload() -> bytes:
    """Return the payload of five depth pictures."""
    y, x = np.mgrid[:23, :37]
    pictures = (gray_planes((300 + 9 * x + 4 * y + 5 * k).astype(np.uint16), SEEN) for k in range(5))
    return encode_av1(pictures, SEEN, Av1Settings(crf=25, preset=10, threads=1, depth=True))


@cache
def still_payload() -> bytes:
    """Return the payload of a picture."""
    y, x = np.mgrid[:23, :37]
    return encode_still(np.stack([5 * x, 9 * y, 3 * (x + y)], axis=-1).astype(np.uint8), 30, False, thorough=False)[0]


def film_lawfully(payload: bytes, count: int = 5) -> None:
    """Decode a depth video as it is coded now and as it was before; either a FormatError is raised, or it is whole."""
    for decoded in (
        lambda: [planes.luma for planes in decode_av1(payload, count, SEEN)],
        lambda: list(decode_earlier_run(payload, count, 37, 23)),
    ):
        try:
            pictures = decoded()
        except FormatError:
            continue
        assert [picture.shape for picture in pictures] == [(23, 37)] * count
        assert max(picture.max() for picture in pictures) < 1 << SEEN.bits


def picture_lawfully(payload: bytes) -> None:
    """Decode a still as it is coded now and as it was before; either a FormatError is raised, or it is whole."""
    for decoded in (
        lambda: decode_still(payload, replace(SEEN, gray=False)),
        lambda: decode_earlier_still(payload, 37, 23, False),
        lambda: decode_earlier_still(payload, 33, 31, False),
    ):
        try:
            picture = decoded()
        except FormatError:
            continue
        assert picture.shape in {(23, 37, 3), (31, 33, 3)}


@needs_av1
@given(st.binary(max_size=120), st.integers(0, 6))
def test_random_videos_and_stills(payload: bytes, count: int) -> None:
    film_lawfully(payload, count)
    picture_lawfully(payload)


@needs_av1
@given(places(depth_video_payload), places(lambda: RUNS["run"].payload), st.integers(1, 255))
def test_changed_byte_of_a_depth_video(position: int, earlier: int, change: int) -> None:
    for payload, place in ((depth_video_payload(), position), (RUNS["run"].payload, earlier)):
        damaged = bytearray(payload)
        damaged[place] ^= change
        film_lawfully(bytes(damaged))
        film_lawfully(bytes(damaged), 9)


@needs_av1
@given(places(still_payload), places(lambda: STILLS["color"].payload), st.integers(1, 255))
def test_changed_byte_of_a_still(position: int, earlier: int, change: int) -> None:
    for payload, place in ((still_payload(), position), (STILLS["color"].payload, earlier)):
        damaged = bytearray(payload)
        damaged[place] ^= change
        picture_lawfully(bytes(damaged))


@needs_av1
@given(places(depth_video_payload), places(still_payload))
def test_cut_videos_and_stills(video: int, still: int) -> None:
    film_lawfully(depth_video_payload()[:video])
    picture_lawfully(still_payload()[:still])
