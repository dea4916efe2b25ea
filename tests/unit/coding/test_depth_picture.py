# SPDX-License-Identifier: MIT
"""Depth pictures: as payload, as cells, and as drawn."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from reference.coding import ExactCoder, ExactCounter, write_number
from reference.depths import DepthLayer, DepthWriter
from threedvc.coding.depth_cells import spread
from threedvc.coding.depth_picture import DepthPicture, DepthSteps, decode_depths, encode_depths, grid_shape
from threedvc.coding.poses import PoseCoder
from threedvc.config import RenderConfig
from threedvc.decoder.decoder import Decoder
from threedvc.encoder.appearance.background.background_depth import (
    CodedDepthMap,
    averaged_inverse_depth,
    cheapest_depth_map,
)
from threedvc.errors import CorruptStream, LimitExceeded
from threedvc.geometry.camera import Camera, CameraRig
from threedvc.geometry.pose import Pose, identity, make_pose, rotation_from_vector
from threedvc.model.decoded_model import DecodedModel, models_digest
from threedvc.render.render_model import RenderModel
from threedvc.render.renderer import Renderer
from threedvc.stream.batch import pack_batch
from threedvc.stream.headers import BatchHeader, DepthHeader, EndHeader, ObjectHeader, PoseHeader, StreamHeader
from threedvc.stream.packets import Packet

CAMERA = Camera(width=48, height=36, fx=40.0, fy=42.0, cx=23.5, cy=17.5)
SCALE_BITS = 14
STEPS = DepthSteps(step=60, levels=3, halvings=2)
Floats = NDArray[np.float64]


def corner(box: bool = False, hole: bool = False, camera: Camera = CAMERA) -> Floats:
    """Inverse depths (h, w) of two walls, with a box before them and a hole if wanted."""
    x, y = np.moveaxis(camera.rays(), -1, 0)
    w = np.maximum(0.45 + 0.3 * x, 0.5 - 0.25 * x + 0.05 * y)
    if box:
        w[20:, 8:24] = 0.75 + 0.1 * y[20:, 8:24]
    if hole:
        w[5:12, 30:40] = 0
    return np.asarray(w)


def picture(w: Floats, spacing: int) -> DepthPicture:
    rows, columns = grid_shape(w.shape[1], w.shape[0], spacing)
    y, x = np.minimum(np.arange(rows) * spacing, len(w) - 1), np.minimum(np.arange(columns) * spacing, w.shape[1] - 1)
    samples = np.rint(w[np.ix_(y, x)] * 2**SCALE_BITS).astype(np.int64)
    return DepthPicture(samples=samples, spacing=spacing, scale_bits=SCALE_BITS)


@pytest.mark.parametrize("spacing", [1, 2, 5])
@pytest.mark.parametrize("hole", [False, True])
def test_a_picture_passes_through_its_payload(spacing: int, hole: bool) -> None:
    wanted = picture(corner(box=True, hole=hole), spacing)
    payload, sent = encode_depths(wanted, STEPS)
    got = decode_depths(payload, CAMERA.width, CAMERA.height)
    assert (got.spacing, got.scale_bits) == (spacing, SCALE_BITS)
    np.testing.assert_array_equal(got.samples, sent.samples)
    np.testing.assert_array_equal(got.samples > 0, wanted.samples > 0)
    assert np.abs(got.samples - wanted.samples).max() <= STEPS.step * STEPS.dead_zone / 256


def test_planes_cost_next_to_nothing() -> None:
    camera = Camera(width=320, height=240, fx=260.0, fy=260.0, cx=159.5, cy=119.5)
    wanted = picture(corner(camera=camera), 2)
    payload, _ = encode_depths(wanted, DepthSteps(step=80, levels=5, halvings=1))
    assert len(payload) < 100


def test_what_is_not_there_is_not_invented() -> None:
    nothing = DepthPicture(samples=np.zeros((9, 12), dtype=np.int64), spacing=4, scale_bits=3)
    payload, _ = encode_depths(nothing, STEPS)
    assert not decode_depths(payload, 45, 33).samples.any()


def exact_payload(wanted: DepthPicture, steps: DepthSteps) -> tuple[bytes, NDArray[np.int64]]:
    coder, counters = ExactCoder(), dict[int, ExactCounter]()
    for value in (wanted.spacing, wanted.scale_bits, steps.levels, steps.step, steps.halvings):
        write_number(coder, counters, value, 255)
    complete = bool((wanted.samples > 0).all())
    coder.write(int(complete), 1 << 15)
    writer = DepthWriter(coder, wanted.samples, steps.all().tolist(), steps.dead_zone, complete)
    decoded = np.zeros_like(wanted.samples)
    for place, value in writer.run().items():
        decoded[place] = value
    return coder.finish(), decoded


def random_picture(rng: np.random.Generator, shape: tuple[int, int]) -> DepthPicture:
    samples = np.cumsum(rng.integers(-40, 41, shape), axis=1) + rng.choice([3000, 5000], shape, p=[0.9, 0.1])
    samples[rng.random(shape) < rng.choice([0, 0.2])] = 0
    return DepthPicture(samples=np.maximum(samples, 0), spacing=3, scale_bits=12)


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (7, 1), (9, 9), (13, 22)])
def test_payloads_match_the_slow_writer(rng: np.random.Generator, shape: tuple[int, int]) -> None:
    for steps in (DepthSteps(step=1, levels=0, halvings=0, dead_zone=0), DepthSteps(step=33, levels=4, halvings=2)):
        for wanted in (random_picture(rng, shape), random_picture(rng, shape)):
            payload, decoded = encode_depths(wanted, steps)
            expected, samples = exact_payload(wanted, steps)
            assert payload == expected
            np.testing.assert_array_equal(decoded.samples, samples)


def test_the_slow_writer_agrees_on_surfaces() -> None:
    wanted = picture(corner(box=True, hole=True), 1)
    assert encode_depths(wanted, STEPS)[0] == exact_payload(wanted, STEPS)[0]


def test_a_damaged_payload_is_refused() -> None:
    payload, _ = encode_depths(picture(corner(box=True), 1), DepthSteps(step=3, levels=3, halvings=0))
    for broken in (payload[: len(payload) // 2], payload + b"\x01\x02\x03\x04\x05\x06", b"\xff" * 40):
        with pytest.raises(CorruptStream):
            decode_depths(broken, CAMERA.width, CAMERA.height)


def test_a_picture_that_is_too_large_is_refused() -> None:
    payload, _ = encode_depths(picture(corner(), 1), STEPS)
    with pytest.raises(LimitExceeded, match="samples"):
        decode_depths(payload, 16384, 16384)


TILTED = make_pose(rotation_from_vector(np.array([0.2, -0.3, 0.1])), np.array([0.1, -0.05, 0.2]))


def layer(wanted: DepthPicture, size: float, pose: Pose, camera: Camera = CAMERA) -> DecodedModel:
    model = DecodedModel(size, relief_bits=3)
    spread(wanted, model, camera, pose)
    return model


@pytest.mark.parametrize("pose", [identity(), TILTED], ids=["straight", "tilted"])
@pytest.mark.parametrize(("spacing", "size"), [(4, 0.5), (8, 0.3)])
@pytest.mark.parametrize("odd", [False, True], ids=["walls", "box and hole"])
def test_cells_match_the_slow_search(pose: Pose, spacing: int, size: float, odd: bool) -> None:
    wanted = picture(corner(box=odd, hole=odd), spacing)
    model = layer(wanted, size, pose)
    cells, positions = model.index.flagged(model.occupied[: model.index.count])
    lens = [value / spacing for value in (CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy)]
    slow = DepthLayer(wanted.samples, 2.0**-SCALE_BITS, lens, pose, size)
    low, high = cells.min(axis=0) - 2, cells.max(axis=0) + 3
    everywhere = np.stack(np.meshgrid(*map(np.arange, low, high), indexing="ij"), axis=-1).reshape(-1, 3)
    expected = {tuple(cell): relief for cell in everywhere.tolist() if (relief := slow.relief(cell, 8))}
    got = dict(zip(map(tuple, cells.tolist()), model.relief.reshape(-1)[positions].tolist(), strict=True))
    assert got == expected


def drawn(model: DecodedModel, pose: Pose, camera: Camera = CAMERA) -> NDArray[np.float32]:
    shown = RenderModel(model)
    shown.refresh(1)
    rig = CameraRig.registered_to(camera)
    return Renderer(rig, RenderConfig(threads=1)).draw({0: shown}, {0: pose}, color=False).depth


@pytest.mark.parametrize("pose", [identity(), TILTED], ids=["straight", "tilted"])
def test_walls_are_drawn_where_they_are(pose: Pose) -> None:
    w = corner()
    depth = drawn(layer(picture(w, 2), 0.08, pose), pose)
    assert (depth > 0).all()
    assert np.abs(depth * w - 1).max() < 0.03
    assert np.median(np.abs(depth * w - 1)) < 0.002


def test_edges_and_holes_stay_where_they_are() -> None:
    w = corner(box=True, hole=True)
    depth = drawn(layer(picture(w, 1), 0.05, identity()), identity())
    assert (depth[w > 0] > 0).mean() > 0.99
    assert (depth[7:10, 32:38] == 0).all()
    error = np.abs(depth[w > 0] * w[w > 0] - 1)
    assert (error > 0.05).mean() < 0.03


def test_a_surface_does_not_tear_seen_from_aside() -> None:
    camera = Camera(width=24, height=18, fx=40.0, fy=42.0, cx=11.5, cy=8.5)
    model = layer(picture(corner(), 2), 0.06, identity())
    aside = make_pose(rotation_from_vector(np.array([0.0, 0.25, 0.0])), np.array([-0.5, 0.1, 0.3]))
    assert (drawn(model, aside, camera) > 0).mean() > 0.995


def test_cells_are_limited() -> None:
    with pytest.raises(LimitExceeded, match="larger"):
        layer(picture(corner(), 1), 1e-6, identity())
    far = DepthPicture(samples=np.ones((3, 3), dtype=np.int64), spacing=1, scale_bits=40)
    with pytest.raises(LimitExceeded, match="larger"):
        layer(far, 1e-6, identity())


def test_a_picture_is_for_an_object_without_cells() -> None:
    wanted = picture(corner(), 4)
    model = layer(wanted, 0.2, identity())
    with pytest.raises(CorruptStream, match="already"):
        spread(wanted, model, CAMERA, identity())
    with pytest.raises(CorruptStream, match="relief"):
        spread(wanted, DecodedModel(0.2), CAMERA, identity())


def stream_of(members: list[Packet], model: DecodedModel) -> list[Packet]:
    record = (CAMERA.width, CAMERA.height, CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy, 0, 0, 0, 0, 0)
    stream = StreamHeader(
        color_camera=record, depth_scale=1000, period_num=10**8, translation_step_m=0.001, rotation_step_rad=0.001
    )
    end = EndHeader(frames=1, digest=models_digest({0: model}))
    return [stream.packet(), pack_batch(BatchHeader(frame=0, count=1), members), end.packet()]


def test_a_decoder_looks_from_where_the_camera_stands() -> None:
    coder = PoseCoder(0.001, 0.001)
    payload, _ = encode_depths(picture(corner(), 2), STEPS)
    members = [
        ObjectHeader(object_id=0, voxel_size_m=0.08, relief_bits=3).packet(),
        PoseHeader(frame=0).packet(coder.encode([TILTED])),
        DepthHeader(frame=0).packet(payload),
    ]
    decoded = decode_depths(payload, CAMERA.width, CAMERA.height)
    decoder = Decoder()
    states = list(decoder.frames(stream_of(members, layer(decoded, 0.08, coder.decoded[0]))))
    assert decoder.complete
    assert (drawn(decoder.models[0], states[0].T_camera_object[0]) > 0).all()


@pytest.mark.parametrize(("relief", "count", "message"), [(0, 1, "relief"), (3, 2, "already")])
def test_a_decoder_refuses_a_picture_that_does_not_fit(relief: int, count: int, message: str) -> None:
    payload, _ = encode_depths(picture(corner(), 4), STEPS)
    introduction = ObjectHeader(object_id=0, voxel_size_m=0.2, relief_bits=relief).packet()
    members = [introduction, *[DepthHeader(frame=0).packet(payload)] * count]
    with pytest.raises(CorruptStream, match=message):
        list(Decoder().frames(stream_of(members, DecodedModel(0.2))))
    with pytest.raises(CorruptStream, match="not introduced"):
        list(Decoder().frames(stream_of(members[1:], DecodedModel(0.2))))


def test_depths_are_averaged_beside_objects(rng: np.random.Generator) -> None:
    w = corner(hole=True)
    frames = []
    for column in (0, 12, 24):
        depth = np.where(w > 0, 1 / np.maximum(w, 0.1), 0) * rng.normal(1, 0.002, w.shape)
        hidden = np.zeros(w.shape, dtype=bool)
        hidden[10:20, column : column + 8] = True
        depth[hidden] = 0.4
        frames.append((depth.astype(np.float32), hidden))
    found = averaged_inverse_depth(frames)
    np.testing.assert_array_equal(found > 0, w > 0)
    np.testing.assert_allclose(found[w > 0], w[w > 0], rtol=0.01)


def test_the_cheapest_coding_is_taken() -> None:
    def cost(choice: CodedDepthMap) -> float:
        model = choice.model(CAMERA, identity())
        return len(choice.payload) if model.cell_count else np.inf

    w = corner(box=True)
    best = cheapest_depth_map(w, CAMERA, cost)
    assert best is not None
    assert len(best.payload) < 120
    assert cheapest_depth_map(w, CAMERA, lambda _: np.inf) is None
    assert cheapest_depth_map(np.zeros_like(w), CAMERA, cost) is None
