# SPDX-License-Identifier: MIT
"""Runs of pictures in color, with half and with full chroma."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from threedvc.coding.video.av1 import Av1Settings, can_encode_av1, encode_av1
from threedvc.coding.video.color_runs import decode_color, encode_color
from threedvc.coding.video.parts import pack_parts, unpack_parts
from threedvc.coding.video.planes import Planes, VideoFormat, picture_of, planes_of
from threedvc.errors import CorruptStream

pytestmark = pytest.mark.skipif(not can_encode_av1(), reason="this build of PyAV has no AV1")

SIZE = 35, 21
COUNT = 4
SETTINGS = Av1Settings(crf=6, preset=10, threads=1)
HALF = VideoFormat(width=SIZE[0], height=SIZE[1], bits=10)
FULL = VideoFormat(width=SIZE[0], height=SIZE[1], bits=10, full_chroma=True)


def striped(count: int) -> list[NDArray[np.uint8]]:
    """Red and blue columns of one pixel, which halved chroma cannot tell apart."""
    columns = np.where(np.arange(SIZE[0])[:, None] % 2, (220, 20, 20), (20, 20, 220)).astype(np.uint8)
    return [np.roll(np.broadcast_to(columns, (SIZE[1], *columns.shape)), k, axis=1) for k in range(count)]


def errors(video: VideoFormat) -> list[float]:
    pictures = striped(COUNT)
    payload = encode_color((planes_of(picture, video) for picture in pictures), video, SETTINGS)
    shown = (picture_of(planes, video, *SIZE, 1) for planes in decode_color(payload, COUNT, video))
    return [float(np.abs(got.astype(int) - wanted).mean()) for got, wanted in zip(shown, pictures, strict=True)]


@pytest.fixture(scope="module")
def payload() -> bytes:
    return encode_color((planes_of(picture, FULL) for picture in striped(COUNT)), FULL, SETTINGS)


def test_full_chroma_tells_colors_of_single_columns() -> None:
    assert max(errors(FULL)) < 4
    assert min(errors(HALF)) > 40


def test_halved_chroma_is_plain_av1() -> None:
    planes = [planes_of(picture, HALF) for picture in striped(2)]
    assert encode_color(planes, HALF, SETTINGS) == encode_av1(planes, HALF, SETTINGS)


def test_planes_are_decoded_as_they_are_asked_for(payload: bytes) -> None:
    pictures = decode_color(payload, COUNT, FULL)
    assert isinstance(next(pictures), Planes)


@pytest.mark.parametrize(
    "damage",
    [
        lambda parts: parts[:2],
        lambda parts: [*parts, parts[0]],
        lambda parts: [parts[0][:60], *parts[1:]],
        lambda parts: [b"\0" * 40, *parts[1:]],
    ],
    ids=["missing", "surplus", "cut", "zeros"],
)
def test_damaged_payloads_are_refused(payload: bytes, damage: object) -> None:
    parts = unpack_parts(payload, 3, COUNT)
    assert callable(damage)
    with pytest.raises(CorruptStream, match="the stream is damaged"):
        list(decode_color(pack_parts(damage(parts)), COUNT, FULL))


def test_runs_of_other_lengths_are_refused(payload: bytes) -> None:
    shorter = encode_color((planes_of(picture, FULL) for picture in striped(COUNT - 1)), FULL, SETTINGS)
    parts = [*unpack_parts(payload, 3, COUNT)[:2], unpack_parts(shorter, 3, COUNT)[2]]
    with pytest.raises(CorruptStream, match=f"a video of {COUNT - 1} pictures should be one of {COUNT}"):
        list(decode_color(pack_parts(parts), COUNT, FULL))
