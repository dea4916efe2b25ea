# SPDX-License-Identifier: MIT
"""Where a depth video is shown: in the tiles that models miss."""

from __future__ import annotations

from functools import partial
from operator import mul

import numpy as np
import pytest

from helpers.nonrigid_scene import nonrigid_sequence
from threedvc.coding.video.av1 import can_encode_av1, decode_av1
from threedvc.coding.video.planes import VideoFormat
from threedvc.config import ColorVideo, DepthVideo, EncoderConfig, Motion
from threedvc.encoder.packetizer.captured import depth_video
from threedvc.encoder.packetizer.captured.depth_run import DEPTH_BITS, PictureFormat, encode_depth_run
from threedvc.encoder.packetizer.captured.depth_tiles import are_measured, tile_misfits
from threedvc.encoder.packetizer.captured.depth_video import DepthVideoChoice, choose_depth_video
from threedvc.encoder.pipeline.encoder import Encoder
from threedvc.encoder.rate.objective import ColorCost
from threedvc.render.captured_depth import TILE, tile_grid, unpack_tiles
from threedvc.stream.captured_headers import DepthVideoHeader

with_video = pytest.mark.skipif(not can_encode_av1(), reason="this build of PyAV cannot write AV1")
PICTURES = PictureFormat(48, 36, 22)


def test_the_misfit_of_a_wrong_picture_is_one() -> None:
    measured = np.ones((72, 96), np.float32)
    misfits = tile_misfits([(2 * measured, measured), (0 * measured, measured)], PICTURES)
    assert misfits.shape == tile_grid(36, 48)
    assert misfits.sum() == pytest.approx(1, abs=1e-3)


def test_a_misfit_counts_in_the_tile_where_it_is() -> None:
    measured = np.ones((72, 96), np.float32)
    drawn = measured.copy()
    drawn[20:24, 40:44] = 1.5
    misfits = tile_misfits([(drawn, measured)], PICTURES)
    assert np.flatnonzero(misfits).tolist() == [10 // TILE * misfits.shape[1] + 20 // TILE]


def test_what_was_not_measured_does_not_count() -> None:
    drawn = np.ones((72, 96), np.float32)
    assert not tile_misfits([(drawn, 0 * drawn)], PICTURES).any()


def test_tiles_from_a_misfit_on_are_chosen() -> None:
    misfits, all_measured = np.array([[0.0, 0.02], [0.01, 0.03]]), np.ones((2, 2), np.bool_)
    choice = DepthVideoChoice(PICTURES, 0.02)
    np.testing.assert_array_equal(choice.tiles(misfits, all_measured), [[False, True], [False, True]])
    assert DepthVideoChoice(PICTURES).tiles(misfits, all_measured) is None
    half = np.array([[True, False], [True, True]])
    np.testing.assert_array_equal(DepthVideoChoice(PICTURES).tiles(misfits, half), half)


def test_tiles_that_the_sensor_hardly_ever_measured_are_left_out() -> None:
    depth = np.ones((72, 96), np.float32)
    depth[:, :31] = 0
    measured = are_measured([depth, depth, 0 * depth], PICTURES)
    np.testing.assert_array_equal(measured[0], [False, False, True, True, True, True])
    assert measured.shape == tile_grid(36, 48)


def test_a_sensor_that_measures_few_pixels_measures_everywhere() -> None:
    depth = (np.random.default_rng(1).random((72, 96)) < 0.1).astype(np.float32)
    assert are_measured([depth], PICTURES).all()


def test_steps_between_choices_stay_within_the_limits_and_lead_back() -> None:
    sizes = [(24, 18), (36, 27), (48, 36)]
    choice = DepthVideoChoice(PictureFormat(36, 27, 22), 0.125)
    larger = choice.traded(sizes, 12)
    assert larger.pictures == PictureFormat(48, 36, 34)
    assert larger.least_misfit == pytest.approx(choice.least_misfit * 36 * 27 / (48 * 36))
    assert larger.traded(sizes, 12) == larger
    smaller = larger.traded(sizes[::-1], -12)
    assert smaller.pictures == choice.pictures
    assert smaller.traded(sizes, 12) == larger
    assert choice.coarser(100).pictures.crf == depth_video.MAX_CRF
    assert choice.coarser(-100).pictures.crf == depth_video.MIN_CRF


@with_video
def test_outside_of_its_tiles_a_run_stands_still_and_takes_less() -> None:
    depth = [frame.depth for frame in nonrigid_sequence(6)]
    tiles = np.zeros(tile_grid(36, 48), np.bool_)
    tiles[:, :2] = True
    whole, part = (encode_depth_run(depth, PICTURES, each, thorough=False, threads=1) for each in (None, tiles))
    assert len(part.payload) < 0.75 * len(whole.payload)
    video = VideoFormat(width=48, height=36, bits=DEPTH_BITS, gray=True)
    first, *_, last = (planes.luma.astype(int) for planes in decode_av1(part.payload, 6, video))
    reference = [planes.luma.astype(int) for planes in decode_av1(whole.payload, 6, video)][-1]
    assert np.abs(last - reference)[:, : 2 * TILE - 2].mean() < 8
    assert np.abs(last - first)[:, 3 * TILE :].mean() < 2


@with_video
@pytest.mark.usefixtures("quick_av1")
def test_a_video_is_shown_where_something_bends() -> None:
    sequence = nonrigid_sequence(8, (128, 96), 0.1, 0.25)
    config = EncoderConfig(
        color_video=ColorVideo.OFF,
        motion=Motion.KNOWN,
        depth_video=DepthVideo.OFF,
        refine=False,
        voxel_size_m=0.0025,
        threads=1,
    )
    encoder = Encoder(sequence.info, config)
    packets = list(encoder.packets(sequence))
    cost = ColorCost.of_slope(20_000.0, 1.5, fixed=True)
    video, *others = choose_depth_video(encoder.scene, sequence, packets, cost, partial(mul, 4.0), 60, sure=False)
    assert not others
    header = DepthVideoHeader.from_map(video.header)
    tiles = unpack_tiles(header.tiles, header.rows, header.columns)
    assert tiles is not None
    half = tiles.shape[1] // 2
    assert tiles[:, :half].mean() > 2 * tiles[:, half:].mean()
