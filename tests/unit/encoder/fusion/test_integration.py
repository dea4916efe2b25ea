# SPDX-License-Identifier: MIT
"""Fusion: kernels against the slow reference, and what it must do with simple scenes."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from reference.fusion import cells_of, expected_color, expected_depth
from threedvc.config import FusionConfig, Sensor
from threedvc.encoder.fusion.evidence_model import EvidenceModel
from threedvc.encoder.fusion.integration import Observation, free_space_log_odds, fuse, observe
from threedvc.encoder.fusion.model_entropy import EntropyMeter
from threedvc.errors import LimitExceeded
from threedvc.frames.frame import Frame
from threedvc.frames.sensor_model import SENSORS, SensorModel
from threedvc.geometry.camera import Camera, CameraRig
from threedvc.geometry.pose import Pose, identity, make_pose, rotation_from_vector

CAMERA = Camera(width=48, height=36, fx=50.0, fy=52.0, cx=23.0, cy=18.0)
BENT = replace(CAMERA, distortion=(0.3, -0.2, 0.01, -0.008, 0.05))
IDEAL = SENSORS[Sensor.IDEAL]
KINECT = SENSORS[Sensor.KINECT1]
CONFIG = FusionConfig()
CELL = 0.02
Floats = NDArray[np.float64]


def rig_with(color: Camera, depth: Camera, shift: tuple[float, float, float] = (0, 0, 0)) -> CameraRig:
    return CameraRig(color=color, depth=depth, T_color_depth=make_pose(np.eye(3), np.array(shift, dtype=np.float64)))


REGISTERED = CameraRig.registered_to(CAMERA)
RIGS = {
    "registered": REGISTERED,
    "distorted": CameraRig.registered_to(BENT),
    "two cameras": rig_with(BENT.resized(80, 64), CAMERA, (0.05, -0.02, 0.01)),
}


def frame_of(
    depth: NDArray[np.float32], color: NDArray[np.uint8] | None = None, index: int = 0, rig: CameraRig = REGISTERED
) -> Frame:
    if color is None:
        color = np.full((rig.color.height, rig.color.width, 3), 128, dtype=np.uint8)
    return Frame(index=index, timestamp_ns=index, color=color, depth=depth)


def flat(z: float, camera: Camera = CAMERA) -> NDArray[np.float32]:
    return np.full((camera.height, camera.width), z, dtype=np.float32)


def seen_from(frame: Frame, rig: CameraRig = REGISTERED) -> Observation:
    return observe(frame, rig, rig.depth.rays())


def everywhere(camera: Camera = CAMERA) -> NDArray[np.bool_]:
    return np.ones((camera.height, camera.width), dtype=bool)


def fused(
    model: EvidenceModel,
    frame: Frame,
    *,
    rig: CameraRig = REGISTERED,
    mask: NDArray[np.bool_] | None = None,
    T: Pose | None = None,
    sensor: SensorModel = IDEAL,
    config: FusionConfig = CONFIG,
    threads: int = 1,
) -> NDArray[np.int64]:
    mask = everywhere(rig.depth) if mask is None else mask
    return fuse(model, seen_from(frame, rig), mask, identity() if T is None else T, sensor, config, threads)


def values_at(values: NDArray[np.float32], model: EvidenceModel, points: Floats) -> NDArray[np.float32]:
    """Return the values of the cells that hold points (n, 3) in the object's frame."""
    positions = model.index.locate(np.floor(points / model.voxel_size_m).astype(np.int32))
    assert np.all(positions >= 0)
    return values.reshape(-1)[positions]


def along_the_axis(model: EvidenceModel, values: NDArray[np.float32]) -> dict[float, float]:
    """Return the values of the cells around the optical axis by the depth of their centers."""
    cells = cells_of(model)
    column = np.flatnonzero((cells[:, 0] == 0) & (cells[:, 1] == 0))
    depths = (cells[column, 2] + 0.5) * model.voxel_size_m
    return dict(sorted(zip(depths.round(6).tolist(), values.reshape(-1)[column].tolist(), strict=True)))


def zero_crossing(profile: dict[float, float]) -> float:
    """Return where a profile over depth falls from positive to negative values."""
    steps = list(profile.items())
    for (z0, d0), (z1, d1) in pairwise(steps):
        if d0 > 0 >= d1:
            return z0 + (z1 - z0) * d0 / (d0 - d1)
    raise AssertionError(f"no surface in {profile}")


# --- The kernels against the reference -------------------------------------------------------------------------------


def bumpy(camera: Camera, rng: np.random.Generator) -> NDArray[np.float32]:
    """Return depth with a slope, steps, noise and holes."""
    v, u = np.mgrid[0 : camera.height, 0 : camera.width]
    depth = 0.7 + 0.004 * u + 0.15 * (v > camera.height // 2) + rng.normal(0, 0.004, u.shape)
    depth[rng.random(u.shape) < 0.1] = 0
    depth[2:5, 3:9] = 0
    return depth.astype(np.float32)


def view(turn: tuple[float, float, float], shift: tuple[float, float, float]) -> Pose:
    return make_pose(rotation_from_vector(np.array(turn)), np.array(shift))


SENSORS_TRIED = {
    "ideal": IDEAL,
    "kinect": KINECT,
    "coarse": SensorModel(s0_m=0.05, s1=0.02, outlier=0.2),
}


@pytest.mark.parametrize("sensor", SENSORS_TRIED.values(), ids=SENSORS_TRIED)
@pytest.mark.parametrize("rig", RIGS.values(), ids=RIGS)
def test_equals_the_reference(rig: CameraRig, sensor: SensorModel, rng: np.random.Generator) -> None:
    model = EvidenceModel(CELL)
    shape = (rig.color.height, rig.color.width, 3)
    fused(model, frame_of(bumpy(rig.depth, rng), rng.integers(0, 256, shape, dtype=np.uint8)), rig=rig, sensor=sensor)
    T = view((0.1, -0.2, 0.05), (0.05, 0.02, -0.06))
    mask = rng.random((rig.depth.height, rig.depth.width)) < 0.8
    seen = seen_from(frame_of(bumpy(rig.depth, rng), rng.integers(0, 256, shape, dtype=np.uint8), 3), rig)
    # Both sides start with the same blocks.
    model.allocate(blocks_after(model, seen, mask, T, sensor))
    before = deepcopy(model)
    numbers = fuse(model, seen, mask, T, sensor, CONFIG, 1)
    cells = cells_of(model)
    chosen = rng.choice(len(cells), 500, replace=False)
    for position in np.concatenate([chosen, rng.choice(numbers, 300) * 512 + rng.integers(0, 512, 300)]):
        expected = expected_depth(before, cells[position], seen, mask, T, sensor, CONFIG)
        odds = np.clip(before.log_odds.flat[position] + expected.log_odds, -CONFIG.max_log_odds, CONFIG.max_log_odds)
        assert model.log_odds.flat[position] == pytest.approx(odds, abs=2e-5)
        assert model.distance.flat[position] == pytest.approx(expected.distance, abs=1e-6)
        assert model.distance_weight.flat[position] == pytest.approx(expected.distance_weight, rel=1e-5)
        assert model.first_seen.flat[position] == expected.first_seen
        color, weight = expected_color(before, cells[position], seen, mask, T, sensor)
        assert model.color.reshape(-1, 3)[position] == pytest.approx(color, abs=2e-3)
        assert model.color_weight.flat[position] == pytest.approx(weight, rel=1e-5)


def blocks_after(
    model: EvidenceModel, seen: Observation, mask: NDArray[np.bool_], T: Pose, sensor: SensorModel
) -> NDArray[np.int32]:
    twin = deepcopy(model)
    fuse(twin, seen, mask, T, sensor, CONFIG, 1)
    return twin.index.coords[: twin.index.count]


@pytest.mark.parametrize("case", ["no depth", "one pixel", "no mask", "behind the camera", "touching the camera"])
def test_degenerate_frames(case: str, rng: np.random.Generator) -> None:
    model = EvidenceModel(CELL)
    fused(model, frame_of(flat(1.0)))
    depth, mask, T = flat(1.0), everywhere(), identity()
    if case == "no depth":
        depth[:] = 0
    elif case == "one pixel":
        depth[:] = 0
        depth[18, 23] = 0.9
    elif case == "no mask":
        mask[:] = False
    elif case == "behind the camera":
        T = view((0, np.pi, 0), (0, 0, 0))
    else:
        T = view((0, 0, 0), (0, 0, -0.99))
    seen = seen_from(frame_of(depth, index=1))
    model.allocate(blocks_after(model, seen, mask, T, IDEAL))
    before = deepcopy(model)
    fuse(model, seen, mask, T, IDEAL, CONFIG, 1)
    cells = cells_of(model)
    for position in rng.choice(len(cells), 400, replace=False):
        expected = expected_depth(before, cells[position], seen, mask, T, IDEAL, CONFIG)
        odds = np.clip(before.log_odds.flat[position] + expected.log_odds, -CONFIG.max_log_odds, CONFIG.max_log_odds)
        assert model.log_odds.flat[position] == pytest.approx(odds, abs=2e-5)
        assert model.distance.flat[position] == pytest.approx(expected.distance, abs=1e-6)


def test_views_of_larger_arrays_are_taken(rng: np.random.Generator) -> None:
    depth = bumpy(CAMERA, rng)
    wide = np.zeros((CAMERA.height, 2 * CAMERA.width), dtype=np.float32)
    wide[:, ::2] = depth
    plain, strided = EvidenceModel(CELL), EvidenceModel(CELL)
    fused(plain, frame_of(depth))
    fused(strided, frame_of(wide[:, ::2]))
    np.testing.assert_array_equal(plain.log_odds, strided.log_odds)


def test_threads_do_not_matter(rng: np.random.Generator) -> None:
    models = []
    depth = [bumpy(CAMERA, rng) for _ in range(3)]
    color = rng.integers(0, 256, (CAMERA.height, CAMERA.width, 3), dtype=np.uint8)
    for threads in (1, 2, 5):
        model = EvidenceModel(0.01)
        for index in range(3):
            T = view((0, 0.05 * index, 0), (0.02 * index, 0, 0))
            fused(model, frame_of(depth[index], color, index), T=T, threads=threads)
        models.append(model)
    for other in models[1:]:
        for name in ("log_odds", "distance", "distance_weight", "color", "color_weight", "first_seen"):
            np.testing.assert_array_equal(getattr(models[0], name), getattr(other, name))


# --- What fusion must do ---------------------------------------------------------------------------------------------


def test_a_plane_is_occupied_and_what_lies_before_it_empty() -> None:
    model = EvidenceModel(CELL)
    for index in range(5):
        fused(model, frame_of(flat(1.01), index=index))
    odds = along_the_axis(model, model.log_odds)
    assert odds[1.01] > 3
    assert all(value < -3 for z, value in odds.items() if z < 0.96)
    assert all(value == 0 for z, value in odds.items() if z > 1.06)
    assert zero_crossing(along_the_axis(model, model.distance)) == pytest.approx(1.01, abs=1e-4)


def test_storage_follows_the_surface() -> None:
    model = EvidenceModel(CELL)
    fused(model, frame_of(flat(3.0)))
    blocks = model.index.coords[: model.index.count]
    assert 0 < model.index.count < 800
    assert np.all(np.abs(blocks[:, 2] * 8 * CELL - 3.0) < 0.5)


@pytest.mark.parametrize("z", [0.3, 1.7, 6.0])
def test_every_measured_point_gets_storage(z: float, rng: np.random.Generator) -> None:
    depth = (flat(z) + rng.uniform(-0.1, 0.1, flat(z).shape)).astype(np.float32)
    T = view((0.3, -0.5, 0.2), (1.0, -2.0, 0.5))
    model = EvidenceModel(CELL)
    fused(model, frame_of(depth), T=T)
    slopes = CAMERA.rays()
    points = np.concatenate([slopes, np.ones((*depth.shape, 1))], axis=-1) * depth[..., None]
    in_object = (points.reshape(-1, 3) - T[:3, 3]) @ T[:3, :3]
    assert np.all(model.index.locate(np.floor(in_object / CELL).astype(np.int32)) >= 0)


def test_a_thing_that_vanishes_is_emptied() -> None:
    model = EvidenceModel(CELL)
    with_box = flat(1.5)
    with_box[10:26, 14:34] = 0.81
    for index in range(6):
        fused(model, frame_of(with_box, index=index))
    front = np.array([[0.0, 0.0, 0.81]])
    assert values_at(model.log_odds, model, front)[0] > 3
    for index in range(6, 12):
        fused(model, frame_of(flat(1.5), index=index))
    box = (cells_of(model)[:, 2] + 0.5) * CELL < 1.2
    assert np.all(model.log_odds.reshape(-1)[: len(box)][box] <= 0)
    assert values_at(model.log_odds, model, front)[0] < -1


def test_change_stays_possible_after_very_many_frames() -> None:
    model = EvidenceModel(0.05)
    for index in range(200):
        fused(model, frame_of(flat(1.0), index=index))
    assert np.abs(model.log_odds).max() <= CONFIG.max_log_odds
    for index in range(200, 210):
        fused(model, frame_of(flat(2.0), index=index))
    assert values_at(model.log_odds, model, np.array([[0.01, 0.01, 0.999]]))[0] < 0


def test_free_space_evidence_is_that_of_the_ray_sum() -> None:
    # The limit of the exact sum for an equiprobable cell that is empty if the reading, far behind it, is right.
    expected = np.log(0.02 / (0.02 + 0.5 * 0.98))
    assert free_space_log_odds(SensorModel(outlier=0.02)) == pytest.approx(expected)
    assert free_space_log_odds(SensorModel(outlier=0.3)) > free_space_log_odds(SensorModel(outlier=0.02))


@pytest.mark.parametrize("order", [("good", "poor"), ("poor", "good")])
def test_of_two_sensors_the_better_one_decides(order: tuple[str, str]) -> None:
    good, poor = SENSORS[Sensor.IDEAL], SensorModel(s0_m=0.03, outlier=0.1)
    frames: dict[str, tuple[SensorModel, Floats]] = {
        "good": (good, np.array([1.51, 1.51])),
        "poor": (poor, np.array([1.55, 1.57, 1.54, 1.58])),
    }
    model = EvidenceModel(CELL)
    for name in order:
        sensor, readings = frames[name]
        for reading in readings:
            fused(model, frame_of(flat(reading)), sensor=sensor)
    assert zero_crossing(along_the_axis(model, model.distance)) == pytest.approx(1.51, abs=0.002)
    odds = along_the_axis(model, model.log_odds)
    assert max(odds, key=odds.__getitem__) == pytest.approx(1.51)


def test_two_sensors_with_their_own_cameras_meet_in_one_object() -> None:
    """A Kinect and an ideal sensor look at the same wall from two places through different lenses."""
    model = EvidenceModel(CELL)
    side = view((0, 0, 0), (0.1, 0, 0.2))
    fused(model, frame_of(flat(1.5)), sensor=IDEAL)
    other = CameraRig.registered_to(BENT.resized(64, 48))
    fused(model, frame_of(flat(1.7, other.depth), rig=other), rig=other, sensor=KINECT, T=side)
    assert zero_crossing(along_the_axis(model, model.distance)) == pytest.approx(1.5, abs=0.002)
    assert along_the_axis(model, model.log_odds)[1.49] + along_the_axis(model, model.log_odds)[1.51] > 1


def stripes(x: Floats) -> Floats:
    """Return a smooth shade over the x of the wall, so that a shift of a few millimeters shows."""
    return 128 + 100 * np.sin(9 * x)


def picture_of_wall(rig: CameraRig, z: float) -> NDArray[np.uint8]:
    """Paint the wall at depth z of the depth camera as the color camera sees it."""
    shift = rig.T_color_depth[:3, 3]
    x = rig.color.rays()[..., 0] * (z + shift[2]) - shift[0]
    return np.repeat(np.rint(stripes(x))[..., None], 3, axis=-1).astype(np.uint8)


@pytest.mark.parametrize("rig", RIGS.values(), ids=RIGS)
def test_colors_land_where_they_belong(rig: CameraRig) -> None:
    model = EvidenceModel(CELL)
    depth = flat(1.21, rig.depth)
    fused(model, frame_of(depth, picture_of_wall(rig, 1.21), rig=rig), rig=rig)
    cells = cells_of(model)
    colored = np.flatnonzero((model.color_weight.reshape(-1)[: len(cells)] > 1e-3) & (cells[:, 2] == 60))
    assert len(colored) > 500
    error = model.color.reshape(-1, 3)[colored, 1] - stripes((cells[colored, 0] + 0.5) * CELL)
    assert np.abs(error).max() < 8


def test_depth_through_a_lens_is_straight_again() -> None:
    model = EvidenceModel(CELL)
    rig = RIGS["distorted"]
    slope = rig.depth.rays()[..., 0]
    fused(model, frame_of((1.2 / (1 - 0.3 * slope)).astype(np.float32), rig=rig), rig=rig)
    cells = cells_of(model)
    near = np.flatnonzero(
        (np.abs(model.distance.reshape(-1)[: len(cells)]) < CELL)
        & (model.distance_weight.reshape(-1)[: len(cells)] > 0)
    )
    centers = (cells[near] + 0.5) * CELL
    assert len(near) > 800
    # Along a viewing ray the way to a slanted wall is longer by its slope.
    away = (1.2 + 0.3 * centers[:, 0] - centers[:, 2]) / (1 - 0.3 * centers[:, 0] / centers[:, 2])
    np.testing.assert_allclose(model.distance.reshape(-1)[near], away, atol=0.01)


def test_a_mask_hides_the_object_but_not_the_free_space_before_it() -> None:
    model = EvidenceModel(CELL)
    for index in range(3):
        fused(model, frame_of(flat(0.81), index=index))
    mask = everywhere()
    mask[:, 24:] = False
    others = np.full_like(flat(1.5), 1.51)
    for index in range(3, 9):
        fused(model, frame_of(others, index=index), mask=mask)
    left, right = np.array([[-0.2, 0.0, 0.81]]), np.array([[0.2, 0.0, 0.81]])
    # What hides behind foreign pixels is gone too, but the surface there is somebody else's.
    assert values_at(model.log_odds, model, left)[0] < 0
    assert values_at(model.log_odds, model, right)[0] < 0
    cells, odds = cells_of(model), model.log_odds.reshape(-1)
    far = (cells[:, 2] + 0.5) * CELL > 1.3
    assert np.any(odds[: len(cells)][far & (cells[:, 0] < -2)] > 1)
    assert not np.any(odds[: len(cells)][far & (cells[:, 0] > 2)] > 0)
    assert not np.any(model.color_weight.reshape(-1)[: len(cells)][far & (cells[:, 0] > 2)])


def test_a_nearer_stranger_teaches_nothing() -> None:
    model = EvidenceModel(CELL)
    fused(model, frame_of(flat(1.0)))
    before = deepcopy(model)
    fused(model, frame_of(flat(0.6), index=1), mask=~everywhere())
    np.testing.assert_array_equal(model.log_odds[: before.index.count], before.log_odds[: before.index.count])
    assert model.index.count == before.index.count


def test_unknown_cells_stay_equiprobable_and_uncolored() -> None:
    model = EvidenceModel(CELL)
    fused(model, frame_of(flat(1.0)))
    hidden = (cells_of(model)[:, 2] + 0.5) * CELL > 1.06
    count = len(hidden)
    for values in (model.log_odds, model.distance_weight, model.color_weight):
        assert not np.any(values.reshape(-1)[:count][hidden])
    assert np.all(model.first_seen.reshape(-1)[:count][hidden] == EvidenceModel.NEVER)


def test_first_sight_is_kept() -> None:
    model = EvidenceModel(CELL)
    for index in (4, 5, 6):
        fused(model, frame_of(flat(1.0), index=index))
    assert set(np.unique(model.first_seen[: model.index.count])) == {4, EvidenceModel.NEVER}


def test_entropy_falls_with_every_frame(rng: np.random.Generator) -> None:
    model = EvidenceModel(CELL)
    meter = EntropyMeter(model)
    depth, color = flat(1.01), rng.integers(0, 256, (CAMERA.height, CAMERA.width, 3), dtype=np.uint8)
    bits = []
    for index in range(6):
        meter.update(fused(model, frame_of(depth, color, index)), 1)
        bits.append(meter.bits)
    assert bits[0] < model.index.count * 512 * 13
    assert bits == sorted(bits, reverse=True)
    assert len(set(bits)) == 6


def test_blocks_out_of_sight_are_not_reported() -> None:
    model = EvidenceModel(CELL)
    fused(model, frame_of(flat(1.0)))
    count = model.index.count
    away = view((0, np.pi, 0), (0, 0, 0))
    numbers = fused(model, frame_of(flat(1.0), index=1), T=away)
    assert len(numbers) == len(set(numbers.tolist()))
    assert np.all(numbers >= count)


def test_a_surface_out_of_range_is_refused() -> None:
    model = EvidenceModel(0.001)
    for place in (2e3, 2e4, 5e5, -5e5, 1e12, 0.008 * 2**21, -0.008 * 2**22):
        with pytest.raises(LimitExceeded, match=r"further than 2\^20 cells from the origin"):
            fused(model, frame_of(flat(1.0)), T=view((0, 0, 0), (place, 0, 0)))
        assert model.index.count == 0
