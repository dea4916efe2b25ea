# SPDX-License-Identifier: MIT
"""Random updates and poses pass through their payloads unchanged, whatever the state."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from threedvc.coding.color import ColorSettings
from threedvc.coding.depth_picture import MAX_SAMPLE, DepthPicture, DepthSteps, decode_depths, encode_depths, grid_shape
from threedvc.coding.morton import morton_order
from threedvc.coding.poses import PoseCoder
from threedvc.coding.update import decode_update, encode_update_with_result
from threedvc.coding.video.av1 import Av1Settings, can_encode_av1, decode_av1, encode_av1
from threedvc.coding.video.planes import VideoFormat, gray_planes
from threedvc.geometry.pose import make_pose, rotation_from_vector
from threedvc.model.model_update import ModelUpdate

Cells = NDArray[np.int32]


@st.composite
def cell_sets(draw: st.DrawFn) -> Cells:
    """Return distinct cells in Morton order: scattered, a dense block, a surface, or clusters far apart."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    side = draw(st.sampled_from([1, 2, 5, 30, 3000]))
    count = draw(st.integers(0, 200))
    kind = draw(st.sampled_from(["scattered", "block", "surface", "clusters"]))
    if kind == "block":
        cells = np.indices((min(side, 8),) * 3).reshape(3, -1).T
    elif kind == "surface":
        flat = rng.integers(-20, 20, size=(count, 2))
        cells = np.column_stack([flat, (flat[:, 0] * 2 + flat[:, 1]) // 7])
    else:
        cells = rng.integers(-side, side, size=(count, 3))
        if kind == "clusters":
            cells = cells % 4 + rng.integers(2, size=(count, 1)) * np.array([[90000, -3, 70000]])
    offset = draw(st.tuples(*[st.integers(-300000, 300000)] * 3))
    cells = np.unique(cells + np.array(offset), axis=0).astype(np.int32).reshape(-1, 3)
    return cells[morton_order(cells)]


def without(cells: Cells, others: Cells) -> Cells:
    """Return the cells that are not among others, in order."""
    taken = set(map(tuple, others.tolist()))
    return np.array([c for c in cells.tolist() if tuple(c) not in taken], dtype=np.int32).reshape(-1, 3)


@st.composite
def updates(draw: st.DrawFn) -> tuple[ModelUpdate, Cells, NDArray[np.int16]]:
    """Return an update with the state that it applies to."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    state = draw(cell_sets())
    added = without(draw(cell_sets()), state)
    if len(state) and len(added) and np.ptp(np.concatenate([state, added]), axis=0).max() >= 1 << 20:
        added = added[:0]
    fate = rng.random(len(state))
    split = draw(st.sampled_from([(0.0, 0.0), (0.1, 0.2), (0.0, 1.0), (1.0, 1.0)]))
    removed, recolored = state[fate < split[0]], state[(fate >= split[0]) & (fate < split[1])]
    base = rng.integers(0, 256, size=3)
    spread = draw(st.sampled_from([0, 20, 255]))

    def colors(count: int) -> NDArray[np.int16]:
        return (base + rng.integers(-spread, spread + 1, size=(count, 3))).astype(np.int16)

    update = ModelUpdate(
        added=added,
        added_colors=colors(len(added)),
        removed=removed,
        recolored=recolored,
        recolored_colors=colors(len(recolored)),
    )
    return update, state, colors(len(state))


@given(updates(), st.booleans(), st.sampled_from([(1.0, 1.0), (16.0, 24.0), (200.0, 255.0)]))
def test_update_round_trip(
    sample: tuple[ModelUpdate, Cells, NDArray[np.int16]], gray: bool, steps: tuple[float, float]
) -> None:
    update, cells, colors = sample
    settings = ColorSettings(luma_step=steps[0], chroma_step=steps[1], gray=gray)
    payload, expected = encode_update_with_result(update, cells, colors, settings)
    decoded = decode_update(payload, cells, colors)
    for name in ("added", "removed", "recolored"):
        assert np.array_equal(getattr(decoded, name), getattr(update, name))
    for name in ("added_colors", "recolored_colors"):
        assert np.array_equal(getattr(decoded, name), getattr(expected, name))
        if gray:
            assert np.all(getattr(decoded, name) == getattr(decoded, name)[:, :1])
        elif steps == (1.0, 1.0):
            assert np.all(np.abs(getattr(decoded, name) - getattr(update, name)) <= 8)


@given(
    st.lists(st.tuples(*[st.floats(-50, 50)] * 3, *[st.floats(-7, 7)] * 3), max_size=20),
    st.lists(st.booleans(), min_size=20, max_size=20),
    st.integers(1, 7),
)
def test_pose_round_trip(numbers: list[tuple[float, ...]], repeat: list[bool], group: int) -> None:
    poses = [make_pose(rotation_from_vector(np.array(n[3:])), np.array(n[:3])) for n in numbers]
    for k in range(1, len(poses)):
        if repeat[k]:
            poses[k] = poses[k - 1]
    encoder, decoder = PoseCoder(0.0005, 0.00025), PoseCoder(0.0005, 0.00025)
    for start in range(0, len(poses), group):
        part = poses[start : start + group]
        decoded = decoder.decode(encoder.encode(part), len(part))
        assert np.array_equal(decoded, encoder.decoded)
        for given_pose, seen in zip(part, decoded, strict=True):
            assert np.abs(given_pose - seen)[:3, 3].max() <= 0.00026
            assert np.abs(given_pose - seen)[:3, :3].max() <= 0.0005


@given(
    st.integers(0, 2**32 - 1),
    st.tuples(st.integers(1, 60), st.integers(1, 60)),
    st.integers(1, 7),
    st.integers(0, 6),
    st.sampled_from([1, 5, 300, 100_000]),
)
def test_depths_pass_through(seed: int, size: tuple[int, int], spacing: int, levels: int, step: int) -> None:
    rng = np.random.default_rng(seed)
    shape = grid_shape(*size, spacing)
    samples = rng.integers(0, rng.choice([3, 5000, MAX_SAMPLE + 1]), shape)
    samples[rng.random(shape) < rng.choice([0, 0.5])] = 0
    wanted = DepthPicture(samples=samples, spacing=spacing, scale_bits=9)
    payload, sent = encode_depths(wanted, DepthSteps(step=step, levels=levels, halvings=2, dead_zone=0))
    got = decode_depths(payload, *size)
    np.testing.assert_array_equal(got.samples, sent.samples)
    np.testing.assert_array_equal(got.samples > 0, samples > 0)
    there = samples > 0
    assert np.all(np.abs(got.samples - samples)[there] <= step)


@pytest.mark.skipif(not can_encode_av1(), reason="this build of PyAV has no AV1")
@settings(max_examples=10)
@given(st.integers(1, 40), st.integers(1, 40), st.integers(1, 12), st.sampled_from([8, 10]), st.integers(0, 2**32 - 1))
def test_depth_video_round_trip(width: int, height: int, count: int, bits: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    last = (1 << bits) - 1
    slope, start = rng.uniform(-3, 3, 3), rng.uniform(0.2, 0.8) * last
    k, y, x = np.mgrid[:count, :height, :width]
    wanted = np.clip(np.rint(start + slope[0] * x + slope[1] * y + slope[2] * k), 0, last).astype(np.uint16)
    video = VideoFormat(width=width, height=height, bits=bits, gray=True)
    run = [
        encode_av1(
            (gray_planes(each, video) for each in wanted),
            video,
            Av1Settings(crf=10, preset=10, threads=threads, depth=True),
        )
        for threads in (1, 2)
    ]
    assert run[0] == run[1]
    got = np.stack([planes.luma for planes in decode_av1(run[0], count, video)])
    assert got.shape == wanted.shape
    assert np.abs(got.astype(int) - wanted).mean() < 4 << (bits - 8)
