# SPDX-License-Identifier: MIT
"""Pictures as planes for video codecs: color, scaling, filling, inverse depth."""

from __future__ import annotations

import numpy as np
import pytest

import planes
from planes import InverseDepth, Kernel, filled, lanczos, resized, rgb_of, triangle, yuv_of
from threedvc.metrics.picture_quality import luma


def smooth_picture() -> np.ndarray:
    rows, columns = np.mgrid[0:48, 0:64]
    waves = [np.sin(columns / 9), np.cos(rows / 8), np.sin((rows + columns) / 12)]
    return np.stack([128 + 90 * wave for wave in waves], axis=-1).astype(np.uint8)


class TestColor:
    def test_luma_is_that_of_the_metrics(self, rng: np.random.Generator) -> None:
        picture = rng.integers(0, 256, (8, 12, 3), dtype=np.uint8)
        assert yuv_of(picture, (12, 8))[0] == pytest.approx(luma(picture), abs=1e-3)

    def test_gray_has_no_chroma(self, rng: np.random.Generator) -> None:
        picture = np.repeat(rng.integers(0, 256, (8, 12, 1), dtype=np.uint8), 3, axis=2)
        _, u, v = yuv_of(picture, (12, 8))
        assert u == pytest.approx(np.full((4, 6), 128), abs=1e-3)
        assert v == pytest.approx(np.full((4, 6), 128), abs=1e-3)

    def test_extremes_stay_within_eight_bits(self) -> None:
        corners = np.array(np.meshgrid([0, 255], [0, 255], [0, 255])).reshape(3, 8).T.astype(np.uint8)
        values = np.concatenate([plane.ravel() for plane in yuv_of(np.tile(corners[:, None], (1, 8, 1)), (8, 8))])
        assert values.min() > -0.01
        assert values.max() < 255.51

    def test_picture_comes_back(self) -> None:
        picture = smooth_picture()
        again = rgb_of(yuv_of(picture, (64, 48)), (64, 48))
        assert np.abs(again.astype(int) - picture)[6:-6, 6:-6].max() <= 2


class TestScaling:
    @pytest.mark.parametrize("kernel", [lanczos, triangle])
    @pytest.mark.parametrize("size", [(10, 6), (40, 30), (7, 50)])
    def test_flat_stays_flat(self, kernel: Kernel, size: tuple[int, int]) -> None:
        plane = resized(np.full((12, 20), 77, dtype=np.float32), size, kernel)
        assert plane == pytest.approx(np.full(size[::-1], 77), rel=1e-5)

    @pytest.mark.parametrize("kernel", [lanczos, triangle])
    def test_nothing_moves(self, kernel: Kernel) -> None:
        ramp = np.tile(np.arange(64, dtype=np.float32), (48, 1))
        half = resized(ramp, (32, 24), kernel)
        assert half[10, 8:24] == pytest.approx(2 * np.arange(8, 24) + 0.5, abs=1e-3)
        assert resized(half, (64, 48), kernel)[20, 20:40] == pytest.approx(np.arange(20, 40), abs=0.1)

    def test_smooth_picture_survives_half_size(self) -> None:
        plane = yuv_of(smooth_picture(), (64, 48))[0]
        error = resized(resized(plane, (32, 24), lanczos), (64, 48), lanczos) - plane
        assert np.abs(error[6:-6, 6:-6]).max() < 2

    def test_same_size_is_the_same_plane(self) -> None:
        plane = np.zeros((4, 6), dtype=np.float32)
        assert resized(plane, (6, 4), lanczos) is plane


class TestFilling:
    def test_known_values_stay(self, rng: np.random.Generator) -> None:
        values = rng.uniform(0, 100, (13, 22)).astype(np.float32)
        known = (rng.random((13, 22)) < 0.3).astype(np.float32)
        assert filled(values, known)[known > 0] == pytest.approx(values[known > 0])

    def test_hole_takes_values_from_around(self) -> None:
        values = np.full((16, 24), 50, dtype=np.float32)
        known = np.ones((16, 24), dtype=np.float32)
        values[4:12, 5:15], known[4:12, 5:15] = 999, 0
        assert filled(values, known) == pytest.approx(np.full((16, 24), 50), rel=1e-5)

    def test_range_is_kept(self, rng: np.random.Generator) -> None:
        values = rng.uniform(10, 20, (31, 17)).astype(np.float32)
        whole = filled(values, (rng.random((31, 17)) < 0.05).astype(np.float32))
        assert whole.min() > 9.99
        assert whole.max() < 20.01

    def test_nothing_known(self) -> None:
        nothing = np.zeros((5, 9), dtype=np.float32)
        assert np.isfinite(filled(nothing, nothing)).all()


class TestInverseDepth:
    def test_ends_and_error(self, rng: np.random.Generator) -> None:
        mapping = InverseDepth.covering(0.5, 8.0)
        depth = rng.uniform(0.5, 8, (20, 30)).astype(np.float32)
        depth[0, :2] = 8.0, 0.5
        numbers = np.rint(mapping.numbers(depth))
        assert numbers[0, :2].tolist() == [0, 1023]
        # Half a step of inverse depth.
        assert np.abs(1 / mapping.depth(numbers) - 1 / depth).max() <= (1 / 0.5 - 1 / 8) / 1023 / 2 * 1.001

    def test_single_depth(self) -> None:
        mapping = InverseDepth.covering(2.0, 2.0)
        assert mapping.depth(np.rint(mapping.numbers(np.full((4, 4), 2, dtype=np.float32)))) == pytest.approx(
            np.full((4, 4), 2.0)
        )

    def test_pixels_without_depth_are_filled(self) -> None:
        depth = np.full((8, 8), 3, dtype=np.float32)
        depth[2:5, 2:5] = 0
        mapping = planes.InverseDepth.covering(1.0, 5.0)
        assert mapping.depth(mapping.numbers(depth)) == pytest.approx(np.full((8, 8), 3.0), rel=1e-5)
