# SPDX-License-Identifier: MIT
"""The picture of the background, as it is coded now and as it was before."""

from __future__ import annotations

import numpy as np
import pytest

from helpers.earlier_pictures import STILLS, digest_of
from threedvc.coding.video.av1 import can_encode_av1
from threedvc.coding.video.still import CodedStill, encode_still
from threedvc.decoder.decoder import Decoder
from threedvc.errors import CorruptStream, UnsupportedVersion
from threedvc.model.decoded_model import models_digest
from threedvc.stream.batch import pack_batch
from threedvc.stream.headers import BackdropHeader, BackgroundHeader, BatchHeader, EndHeader, StreamHeader
from threedvc.stream.packets import Packet

pytestmark = [
    pytest.mark.skipif(not can_encode_av1(), reason="this build of PyAV has no AV1"),
    pytest.mark.usefixtures("quick_av1"),
]

WIDTH, HEIGHT = 16, 12
STREAM = StreamHeader(
    color_camera=(WIDTH, HEIGHT, 10, 10, 7.5, 5.5, 0, 0, 0, 0, 0),
    depth_scale=1000.0,
    period_num=100,
    translation_step_m=0.001,
    rotation_step_rad=0.001,
)


@pytest.fixture(scope="module")
def picture() -> np.ndarray:
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    return np.stack([12 * x, 200 - 9 * y, 60 + 5 * (x + y)], axis=-1).astype(np.uint8)


@pytest.fixture(scope="module")
def still(picture: np.ndarray, quick_av1: None) -> CodedStill:
    return encode_still(picture, 10, False)


def shown(member: Packet) -> np.ndarray:
    """Return the picture that a frame's background has by a packet."""
    packets = [
        STREAM.packet(),
        pack_batch(BatchHeader(frame=0, count=1), [member]),
        EndHeader(frames=1, digest=models_digest({})).packet(),
    ]
    (state,) = Decoder().frames(packets)
    assert state.backdrop is not None
    return state.backdrop.picture


def test_a_background_is_shown_as_it_was_sent(still: CodedStill, picture: np.ndarray) -> None:
    got = shown(BackgroundHeader(frame=0, magnified=still.magnified).packet(still.payload))
    assert got.shape == picture.shape
    assert np.abs(got.astype(int) - picture).mean() < 5


def test_a_backdrop_of_before_is_shown_as_it_was() -> None:
    earlier = STILLS["magnified"]
    assert digest_of(shown(BackdropHeader(frame=0).packet(earlier.payload))) == earlier.digest


def test_an_unknown_codec_is_refused(still: CodedStill) -> None:
    with pytest.raises(UnsupportedVersion, match="background is coded by codec 9, unknown to this version"):
        shown(BackgroundHeader(frame=0, codec=9).packet(still.payload))


@pytest.mark.parametrize("bits", [8, 16])
def test_other_bits_than_the_header_says_are_refused(still: CodedStill, bits: int) -> None:
    with pytest.raises(CorruptStream, match=f"of 10 bits should have 16x12 of {bits} bits"):
        shown(BackgroundHeader(frame=0, bits=bits).packet(still.payload))


def test_another_size_than_the_cameras_is_refused(picture: np.ndarray) -> None:
    larger = encode_still(np.pad(picture, ((0, 2), (0, 0), (0, 0))), 30, False)
    with pytest.raises(CorruptStream, match="a video of 16x14 samples"):
        shown(BackgroundHeader(frame=0).packet(larger.payload))


def test_no_picture_is_refused(still: CodedStill) -> None:
    for payload in (b"", still.payload[:-3], still.payload[: still.payload[0] + 2]):
        with pytest.raises(CorruptStream, match="the stream is damaged"):
            shown(BackgroundHeader(frame=0).packet(payload))
