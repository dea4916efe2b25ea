# SPDX-License-Identifier: MIT
"""The color transform against floats, and coding of colors."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from reference.coding import orthonormal_energy
from threedvc.coding.color import ColorSettings, code_cell_colors
from threedvc.coding.entropy.range_coder import RangeReader, RangeWriter
from threedvc.coding.morton import morton_codes
from threedvc.coding.octree import Octree
from threedvc.errors import ConfigError, CorruptStream
from threedvc.kernels.coding.color_transform import (
    FRACTION_BITS,
    from_luma_chroma,
    integer_root,
    merge_importance,
    merge_pairs,
    split_pairs,
    step_of_pair,
    sum_children,
    to_luma_chroma,
)

NO_COLORS = np.empty((0, 3), dtype=np.int16)
DEPTH = 5


def surface(rng: np.random.Generator) -> tuple[Octree, NDArray[np.int16]]:
    """Return a wavy sheet of cells and smooth colors with an edge."""
    x, y = np.meshgrid(np.arange(30), np.arange(30))
    z = np.round(10 + 3 * np.sin(x / 6) + 2 * np.cos(y / 5)).astype(int)
    codes = morton_codes(np.stack([x, y, z], axis=-1).reshape(-1, 3).astype(np.int32), (0, 0, 0))
    shade = 60 + 4 * x + np.where(y > 14, 50, 0)
    colors = np.stack([shade, shade - 20, 200 - shade], axis=-1).reshape(-1, 3) + rng.normal(0, 2, (900, 3))
    order = np.argsort(codes)
    return Octree(codes[order], DEPTH), np.round(colors[order]).astype(np.int16)


def empty() -> Octree:
    """Return a tree without cells."""
    return Octree(np.empty(0, dtype=np.int64), DEPTH)


def coded(
    tree: Octree,
    colors: NDArray[np.int16],
    settings: ColorSettings,
    state: tuple[Octree, NDArray[np.int16]] | None = None,
    importance: NDArray[np.float32] | None = None,
) -> tuple[int, NDArray[np.int16]]:
    """Return the size of coded colors and the colors both sides see."""
    before, known = state or (empty(), NO_COLORS)
    writer = RangeWriter()
    decoded = code_cell_colors(writer, tree, colors, before, known, settings, importance=importance)
    payload = writer.finish()
    reader = RangeReader(payload)
    again = code_cell_colors(reader, tree, np.zeros_like(colors), before, known, settings)
    reader.finish()
    assert np.array_equal(again, decoded)
    return len(payload), decoded


def test_integer_root_is_exact() -> None:
    values = [0, 1, 2, 3, 4, 15, 16, 17, 2**52 - 1, 2**60, 2**60 - 1, (2**31 - 1) ** 2]
    assert [integer_root(v) ** 2 <= v < (integer_root(v) + 1) ** 2 for v in values] == [True] * len(values)


def test_luma_chroma_comes_back_exactly(rng: np.random.Generator) -> None:
    colors = rng.integers(-100, 400, size=(500, 3)).astype(np.int16)
    values, back = np.empty((500, 3), dtype=np.int64), np.empty((500, 3), dtype=np.int16)
    to_luma_chroma(colors, values)
    from_luma_chroma(values, back)
    assert np.array_equal(back, colors)


def test_pairs_split_into_what_was_merged(rng: np.random.Generator) -> None:
    for mask in range(1, 256):
        weights = np.where(mask >> np.arange(8) & 1, rng.integers(1, 50, 8), 0).astype(np.int64)
        means = np.where(weights[:, None] > 0, rng.integers(-(10**6), 10**6, (8, 3)), 0).astype(np.int64)
        block, share, left, right = means.copy(), weights.copy(), np.zeros(8, np.int64), np.zeros(8, np.int64)
        merge_pairs(block, share, left, right)
        assert np.all(np.abs(block[0] - (means * weights[:, None]).sum(axis=0) / weights.sum()) <= 2)
        split_pairs(block, left, right)
        assert np.abs(block - means)[weights > 0].max() <= 3


def test_importance_of_a_difference_is_that_of_the_error_it_makes(rng: np.random.Generator) -> None:
    for mask in range(3, 256):
        weights = np.where(mask >> np.arange(8) & 1, rng.integers(1, 50, 8), 0).astype(np.int64)
        important = np.where(weights > 0, rng.uniform(0, 4, 8), 0)
        share, left, right = weights.copy(), np.zeros(8, np.int64), np.zeros(8, np.int64)
        merge_pairs(np.zeros((8, 1), np.int64), share, left, right)
        merged = important.copy()
        merge_importance(merged, left, right)
        for place in range(1, 8):
            if not (left[place] and right[place]):
                continue
            block = np.zeros((8, 1), np.int64)
            block[place] = error = 1_000_000
            split_pairs(block, left, right)
            made = (weights * important * block[:, 0].astype(float) ** 2).sum()
            orthonormal = error**2 * left[place] * right[place] / (left[place] + right[place])
            assert merged[place] * orthonormal == pytest.approx(made, rel=1e-4)


def test_transform_keeps_energy(rng: np.random.Generator) -> None:
    cells = np.unique(rng.integers(8, size=(200, 3)), axis=0).astype(np.int32)
    values = rng.normal(0, 50, len(cells))
    energy, total = orthonormal_energy({(x, y, z): v for (x, y, z), v in zip(cells.tolist(), values, strict=True)})
    assert energy == pytest.approx(total)


def test_integer_transform_matches_float_transform(rng: np.random.Generator) -> None:
    """Steps by weight are those of the orthonormal transform: coefficients have the same sum of squares."""
    cells = np.unique(rng.integers(8, size=(200, 3)), axis=0).astype(np.int32)
    codes = morton_codes(cells, (0, 0, 0))
    order = np.argsort(codes)
    gray = rng.integers(0, 256, len(cells))
    expected, _ = orthonormal_energy({(x, y, z): float(v) for (x, y, z), v in zip(cells.tolist(), gray, strict=True)})
    sums, weights = (gray[order] << FRACTION_BITS)[:, None], np.ones(len(cells), dtype=np.int64)
    energy, unit = 0.0, 1000 << FRACTION_BITS
    for level in reversed(Octree(codes[order], 3).levels):
        means, shares = sums / weights[:, None], weights
        sums, weights = np.zeros((len(level.codes), 1), np.int64), np.zeros(len(level.codes), np.int64)
        sum_children(level.masks, (means * shares[:, None]).round().astype(np.int64), shares, sums, weights)
        child = 0
        for mask in level.masks.tolist():
            block, share, left, right = (
                np.zeros((8, 1), np.int64),
                np.zeros(8, np.int64),
                np.zeros(8, int),
                np.zeros(8, int),
            )
            for octant in range(8):
                if mask >> octant & 1:
                    block[octant], share[octant] = np.round(means[child]), shares[child]
                    child += 1
            merge_pairs(block, share, left, right)
            for place in range(1, 8):
                if left[place] and right[place]:
                    step = step_of_pair(unit, left[place], right[place])
                    energy += (float(block[place, 0]) / step * 1000) ** 2
    energy += float(sums[0, 0]) ** 2 / weights[0] / 4**FRACTION_BITS
    assert energy == pytest.approx(expected, rel=1e-3)


def test_fine_steps_give_the_colors_back(rng: np.random.Generator) -> None:
    tree, colors = surface(rng)
    _, decoded = coded(tree, colors, ColorSettings(luma_step=0.5, chroma_step=0.5))
    assert np.abs(decoded - colors).max() <= 1


def test_coarser_steps_cost_less_and_lose_more(rng: np.random.Generator) -> None:
    tree, colors = surface(rng)
    sizes, errors = [], []
    for step in (4, 12, 36, 100):
        size, decoded = coded(tree, colors, ColorSettings(luma_step=step, chroma_step=step))
        sizes.append(size)
        errors.append(float(np.square(decoded - colors).mean()))
    assert sizes == sorted(sizes, reverse=True)
    assert errors == sorted(errors)
    assert sizes[3] < 60


def test_bits_go_where_errors_count(rng: np.random.Generator) -> None:
    tree, colors = surface(rng)
    settings = ColorSettings(luma_step=30, chroma_step=30)
    near = np.arange(len(colors)) < len(colors) // 3
    alike, uneven = np.ones(len(colors), np.float32), np.where(near, 3, 0.05).astype(np.float32)
    sizes, errors = [], []
    for importance in (alike, uneven):
        size, decoded = coded(tree, colors, settings, importance=importance)
        square = np.square(decoded - colors).mean(axis=1)
        sizes.append(size)
        errors.append((square[near].mean(), square[~near].mean()))
    assert errors[1][0] < errors[0][0]
    assert errors[1][1] > errors[0][1]
    assert sizes[1] < sizes[0]
    assert coded(tree, colors, settings)[0] == sizes[0]


def test_plain_color_costs_next_to_nothing(rng: np.random.Generator) -> None:
    tree, colors = surface(rng)
    plain = np.full_like(colors, 90)
    size, decoded = coded(tree, plain, ColorSettings(luma_step=16, chroma_step=16))
    assert size <= 12
    assert np.abs(decoded - plain).max() <= 1


def test_gray_has_no_chroma(rng: np.random.Generator) -> None:
    tree, colors = surface(rng)
    gray = np.repeat(colors[:, :1], 3, axis=1)
    size, decoded = coded(tree, gray, ColorSettings(luma_step=8, gray=True))
    assert np.all(decoded == decoded[:, :1])
    assert size < coded(tree, colors, ColorSettings(luma_step=8, chroma_step=8))[0]


def test_state_predicts_what_is_next_to_it(rng: np.random.Generator) -> None:
    tree, colors = surface(rng)
    known = np.arange(len(colors)) % 3 > 0
    state = Octree(tree.codes[known], DEPTH), colors[known]
    rest = Octree(tree.codes[~known], DEPTH)
    settings = ColorSettings(luma_step=12, chroma_step=12)
    assert coded(rest, colors[~known], settings, state)[0] < 0.8 * coded(rest, colors[~known], settings)[0]


def test_one_cell(rng: np.random.Generator) -> None:
    tree = Octree(np.array([77], dtype=np.int64), DEPTH)
    _, decoded = coded(tree, np.array([[250, 3, 120]], dtype=np.int16), ColorSettings(luma_step=4, chroma_step=4))
    assert np.abs(decoded - [[250, 3, 120]]).max() <= 6


@pytest.mark.parametrize("step", [0, -1.0, 256, float("nan")])
def test_impossible_steps_are_refused(step: float) -> None:
    with pytest.raises(ConfigError, match="must be within"):
        ColorSettings(luma_step=step)


def test_settings_pass_through_the_payload() -> None:
    for given in (ColorSettings(luma_step=23.99, chroma_step=36.0), ColorSettings(luma_step=8, gray=True)):
        writer = RangeWriter()
        seen = given.code(writer)
        assert ColorSettings().code(RangeReader(writer.finish())) == seen
        assert seen.luma_step == pytest.approx(given.luma_step, abs=1 / 32)


def test_too_short_payload_is_noticed(rng: np.random.Generator) -> None:
    tree, colors = surface(rng)
    writer = RangeWriter()
    code_cell_colors(writer, tree, colors, empty(), NO_COLORS, ColorSettings(luma_step=8))
    reader = RangeReader(writer.finish()[:40])
    with pytest.raises(CorruptStream, match="end too early"):
        code_cell_colors(reader, tree, colors, empty(), NO_COLORS, ColorSettings(luma_step=8))
