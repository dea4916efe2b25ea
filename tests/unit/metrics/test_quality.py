# SPDX-License-Identifier: MIT
"""Measures: against slow references, closed forms and the numbers of the paper."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from reference.metrics import slow_ssim
from threedvc.metrics.depth_errors import DepthErrors, depth_units
from threedvc.metrics.entropy import bernoulli_entropy_bits
from threedvc.metrics.paper_accounting import PaperAccounting
from threedvc.metrics.picture_quality import MAX_PSNR_DB, ColorQuality, luma, mean_color_quality, psnr, psnr_y, ssim_y

SMALL = st.integers(0, 2**32 - 1)


def picture(rng: np.random.Generator, height: int = 24, width: int = 30) -> NDArray[np.uint8]:
    return rng.integers(0, 256, (height, width, 3), dtype=np.uint8)


def noisy(rng: np.random.Generator, source: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return np.clip(source + rng.normal(0, 20, source.shape), 0, 255).astype(np.uint8)


class TestColor:
    def test_equal_pictures_reach_the_cap(self, rng: np.random.Generator) -> None:
        one = picture(rng)
        assert psnr(one, one) == psnr_y(one, one) == MAX_PSNR_DB
        assert ssim_y(one, one) == pytest.approx(1.0)

    def test_psnr_of_a_constant_difference(self) -> None:
        dark = np.full((4, 5, 3), 100, dtype=np.uint8)
        assert psnr(dark, dark + np.uint8(10)) == pytest.approx(20 * math.log10(25.5))
        assert psnr_y(dark, dark + np.uint8(10)) == pytest.approx(20 * math.log10(25.5), abs=1e-5)

    def test_psnr_does_not_wrap_around(self) -> None:
        black, white = np.zeros((2, 2, 3), dtype=np.uint8), np.full((2, 2, 3), 255, dtype=np.uint8)
        assert psnr(black, white) == psnr(white, black) == pytest.approx(0.0)

    def test_psnr_y_sees_luma_only(self) -> None:
        one = np.array([[[100, 100, 100]]], dtype=np.uint8)
        red = np.array([[[110, 100, 100]]], dtype=np.uint8)
        assert psnr_y(one, red) == pytest.approx(20 * math.log10(255 / 2.99), abs=1e-4)
        assert psnr(one, red) == pytest.approx(10 * math.log10(255**2 * 3 / 100))

    def test_ssim_agrees_with_the_slow_reference(self, rng: np.random.Generator) -> None:
        first = picture(rng)
        second = noisy(rng, first)
        expected = slow_ssim(luma(first).astype(np.float64), luma(second).astype(np.float64))
        assert ssim_y(first, second) == pytest.approx(expected, abs=1e-9)

    def test_ssim_takes_views(self, rng: np.random.Generator) -> None:
        first, second = picture(rng, 40, 60)[::2, ::2], picture(rng, 40, 60)[::2, ::2]
        assert ssim_y(first, second) == ssim_y(first.copy(), second.copy())

    def test_ssim_of_flat_pictures_compares_their_means(self) -> None:
        first, second = np.full((11, 11, 3), 50, dtype=np.uint8), np.full((11, 11, 3), 100, dtype=np.uint8)
        assert ssim_y(first, second) == pytest.approx((2 * 5000 + 2.55**2) / (2500 + 10000 + 2.55**2), abs=1e-6)

    @pytest.mark.parametrize("shape", [(10, 40), (40, 10), (1, 1)])
    def test_ssim_needs_room_for_a_window(self, rng: np.random.Generator, shape: tuple[int, int]) -> None:
        assert math.isnan(ssim_y(picture(rng, *shape), picture(rng, *shape)))

    def test_mean_is_taken_over_frames(self) -> None:
        frames = [ColorQuality(psnr_rgb=20, psnr_y=22, ssim_y=0.5), ColorQuality(psnr_rgb=30, psnr_y=24, ssim_y=0.7)]
        assert mean_color_quality(frames) == ColorQuality(psnr_rgb=25, psnr_y=23, ssim_y=0.6)


class TestDepthUnits:
    @pytest.mark.parametrize("scale", [1000.0, 5000.0, 8192.0])
    def test_every_value_of_a_picture_survives_meters(self, scale: float) -> None:
        units = np.arange(1, 65535, dtype=np.uint16)
        assert np.array_equal(depth_units((units / scale).astype(np.float32), scale), units)

    def test_what_a_picture_cannot_hold_is_no_measurement(self) -> None:
        depth = np.array([0.0, -1.0, 0.0004, 65.535, 70.0, np.inf, np.nan], dtype=np.float32)
        assert not depth_units(depth, 1000.0).any()


def random_depth(rng: np.random.Generator, count: int = 400) -> NDArray[np.uint16]:
    depth = rng.integers(500, 3000, count).astype(np.uint16)
    depth[rng.random(count) < 0.2] = 0
    return depth


class TestDepth:
    def test_every_measure_by_hand(self) -> None:
        reference = np.array([1000, 1000, 2000, 3000, 0, 0, 500], dtype=np.uint16)
        decoded = np.array([1010, 1011, 2020, 0, 700, 0, 500], dtype=np.uint16)
        assert DepthErrors.measure(reference, decoded, 1.0).quality() == {
            "depth_rmse_mm": pytest.approx(math.sqrt((100 + 121 + 400) / 4)),
            "depth_median_mm": 10,
            "depth_within_10mm": 2 / 5,
            "depth_within_1pct": 3 / 5,
            "depth_p99_mm": 20,
            "depth_max_mm": 20,
            "depth_lost": 1 / 5,
            "depth_invented": 1 / 2,
        }

    def test_unit_of_the_pictures(self) -> None:
        reference, decoded = np.array([5000, 5000], dtype=np.uint16), np.array([5050, 5051], dtype=np.uint16)
        quality = DepthErrors.measure(reference, decoded, 0.2).quality()
        assert quality["depth_within_10mm"] == 0.5
        assert quality["depth_max_mm"] == pytest.approx(10.2)

    @given(SMALL)
    def test_pooling_frames_is_measuring_them_at_once(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        reference, decoded = random_depth(rng), random_depth(rng)
        whole = DepthErrors.measure(reference, decoded, 1.0)
        parts = [DepthErrors.measure(reference[part], decoded[part], 1.0) for part in (slice(0, 150), slice(150, None))]
        assert (parts[0] + parts[1]).quality() == whole.quality()

    @given(SMALL)
    def test_agrees_with_the_definition(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        reference, decoded = random_depth(rng), random_depth(rng)
        both = (reference > 0) & (decoded > 0)
        errors = np.sort(np.abs(reference[both].astype(float) - decoded[both]))
        quality = DepthErrors.measure(reference, decoded, 1.0).quality()
        assert quality["depth_rmse_mm"] == pytest.approx(float(np.sqrt(np.mean(errors**2))))
        assert quality["depth_median_mm"] == errors[math.ceil(len(errors) / 2) - 1]
        assert quality["depth_p99_mm"] == errors[math.ceil(0.99 * len(errors)) - 1]
        assert quality["depth_max_mm"] == errors[-1]

    def test_nothing_to_compare(self) -> None:
        empty, full = np.zeros(3, dtype=np.uint16), np.ones(3, dtype=np.uint16)
        quality = DepthErrors.measure(full, empty, 1.0).quality()
        assert (quality["depth_lost"], quality["depth_within_10mm"], quality["depth_invented"]) == (1, 0, 0)
        assert math.isnan(quality["depth_rmse_mm"])
        assert math.isnan(quality["depth_max_mm"])


class TestEntropy:
    def test_unknown_occupancy_is_one_bit(self) -> None:
        assert bernoulli_entropy_bits(0.0) == pytest.approx(1.0)

    @given(st.floats(-30, 30))
    def test_occupancy_follows_the_definition(self, log_odds: float) -> None:
        p = 1 / (1 + math.exp(-abs(log_odds)))
        q = math.exp(-abs(log_odds)) / (1 + math.exp(-abs(log_odds)))
        assert bernoulli_entropy_bits(log_odds) == pytest.approx(-p * math.log2(p) - q * math.log2(q), abs=1e-12)

    def test_certain_occupancy_has_none(self) -> None:
        assert np.array_equal(bernoulli_entropy_bits([-1e6, 1e6]), [0.0, 0.0])


class TestPaper:
    @pytest.mark.parametrize(
        ("cells", "frames", "pose_frames", "ratio"),
        [
            (3962, 150, 150, 77.13),
            (3962, 1800, 1800, 304.8),
            (1056, 150, 45, 282.8),
            (1056, 150, 50, 276.6),
            (1056, 1800, 540, 1047),
            (1056, 1800, 600, 966.5),
        ],
    )
    def test_published_ratios(self, cells: int, frames: int, pose_frames: int, ratio: float) -> None:
        accounting = PaperAccounting(cells=cells, pose_frames=pose_frames, frames=frames)
        assert accounting.ratio == pytest.approx(ratio, rel=5e-4)

    def test_equations(self) -> None:
        accounting = PaperAccounting(cells=10, pose_frames=2, frames=3, pixels=20)
        assert (accounting.coded_bytes, accounting.raw_bytes) == (88, 60)

    def test_nothing_sent(self) -> None:
        assert PaperAccounting(cells=0, pose_frames=0, frames=1).ratio == math.inf
