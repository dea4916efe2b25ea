# SPDX-License-Identifier: MIT
"""Views to record next: how they are judged and chosen, and what following them brings."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from helpers.streams import FRAMES, INFO, ListSequence, gradient_frame, packed_stream, toy_pose
from reference.exploration import best_visibility
from threedvc.config import (
    AppearanceConfig,
    ColorVideo,
    EncoderConfig,
    ExplorationConfig,
    Motion,
    SegmentationConfig,
    SegmentationMode,
    Sensor,
)
from threedvc.decoder.decoder import Decoder
from threedvc.decoder.frame_state import FrameState
from threedvc.errors import ConfigError, SequenceError
from threedvc.formats.container import StreamReader
from threedvc.formats.encoding import encode
from threedvc.formats.view_planning import explore
from threedvc.frames.sensor_model import SENSORS
from threedvc.frames.sequence import FrameSequence
from threedvc.geometry.camera import Camera, CameraRig
from threedvc.geometry.pose import compose, identity, inverse, make_pose, rotation_from_vector
from threedvc.kernels.encoder.exploration import look_at_cells
from threedvc.synthesis import SyntheticSequence, make_scene
from threedvc.view_planning.occupancy_field import OccupancyField
from threedvc.view_planning.planner import propose
from threedvc.view_planning.targets import Target, ViewSampling, downsampled_frames, draw_frames, targets_of

CAMERA = Camera(width=16, height=12, fx=15.0, fy=15.0, cx=7.5, cy=5.5)
KINECT = SENSORS[Sensor.KINECT1]
SAMPLING = ViewSampling.of(CAMERA, 3.0, KINECT)
CHOICES = ExplorationConfig(candidates=150, best=2)
Poses = Sequence[NDArray[np.float64]]


def box(cell_m: float = 0.1) -> OccupancyField:
    return OccupancyField(-np.ones(3), np.ones(3), finest_m=cell_m, half_m=0.4, threads=1)


def random_view(rng: np.random.Generator) -> NDArray[np.float64]:
    return make_pose(rotation_from_vector(rng.normal(0, 1.5, 3)), rng.normal(0, 1, 3))


def target_of(field: OccupancyField, candidates: Poses, number: int = 0) -> Target:
    return Target(
        number=number,
        field=field,
        recorded=identity()[None],
        candidates=np.stack(candidates),
        T_world_field=identity(),
        sampling=SAMPLING,
    )


def state_at(index: int) -> FrameState:
    decoder = Decoder()
    states = list(decoder.frames(StreamReader(io.BytesIO(packed_stream()), "stream")))
    return replace(states[0], index=index)


class TestLooks:
    def test_equal_the_slow_ones(self, rng: np.random.Generator) -> None:
        field = OccupancyField(-np.ones(3), np.array([1.0, 0.6, 0.9]), finest_m=0.2, half_m=0.4, threads=1)
        field.log_odds[...] = rng.choice([-4, -1, 0, 0, 0.5, 3], field.log_odds.shape)
        views = np.stack([field.cells_from(random_view(rng)) for _ in range(12)])
        entropy, opacity = field.entropy(), field.opacity()
        explained = rng.choice([0, 0.3], entropy.shape).astype(np.float32)
        slopes = SAMPLING.slopes[::5] + 1e-4
        seen, gains = np.zeros_like(entropy), np.zeros(12)
        look_at_cells(
            0, 12, views, slopes, field.cell_m, entropy, explained, opacity, KINECT.parameters(), 2.0, seen, gains
        )
        visible = [best_visibility(view, slopes, field.cell_m, opacity, KINECT, 2.0) for view in views]
        assert np.abs(np.max(visible, axis=0) - seen).max() < 1e-4
        assert np.allclose([(np.maximum(each - explained, 0) * entropy).sum() for each in visible], gains, rtol=1e-4)
        assert gains.max() > 5

    def test_along_an_axis_and_on_the_faces_of_cells(self) -> None:
        field = box()
        views = np.stack([field.cells_from(identity()), field.cells_from(make_pose(np.eye(3), np.array([0, 0, -1.0])))])
        seen, gains = np.zeros_like(field.entropy()), np.zeros(2)
        look_at_cells(
            0, 2, views, np.zeros((1, 2)), 0.1, field.entropy(), np.zeros_like(seen), field.opacity(),
            KINECT.parameters(), 9.0, seen, gains,
        )  # fmt: skip
        assert set(zip(*np.nonzero(seen)[:2], strict=True)) == {(10, 10)}
        assert np.all(np.diff(seen[10, 10, 1:10]) < 0)
        assert 0 < gains[0] < gains[1]

    def test_a_look_ends_at_a_wall_and_at_the_reach(self) -> None:
        field = box()
        field.log_odds[:, :, 12] = 4
        seen, gains = np.zeros_like(field.entropy()), np.zeros(1)
        arguments = (field.entropy(), np.zeros_like(seen), field.opacity(), KINECT.parameters())
        view = field.cells_from(make_pose(np.eye(3), np.array([0, 0, -0.5])))[None]
        look_at_cells(0, 1, view, SAMPLING.slopes, 0.1, *arguments, 9.0, seen, gains)
        assert seen[:, :, 12].any()
        assert not seen[:, :, 13:].any()
        near = np.zeros_like(seen)
        look_at_cells(0, 1, view, SAMPLING.slopes, 0.1, *arguments, 0.3, near, gains)
        assert near[:, :, :8].any()
        assert not near[:, :, 9:].any()


class TestProposals:
    def views(self, rng: np.random.Generator, count: int = 20) -> list[NDArray[np.float64]]:
        return [random_view(rng) for _ in range(count)]

    def test_are_those_of_a_plain_greedy_search(self, rng: np.random.Generator) -> None:
        field, views = box(0.2), self.views(rng)
        field.log_odds[...] = rng.choice([-4, 0, 0, 3], field.log_odds.shape)
        visible = [
            best_visibility(
                field.cells_from(view), SAMPLING.slopes, field.cell_m, field.opacity(), KINECT, SAMPLING.reach_m
            )
            for view in views
        ]
        proposals, _ = propose([target_of(field, views)], 4, 1)
        explained = np.zeros(field.log_odds.shape)
        for proposal in proposals:
            gains = [(np.maximum(each - explained, 0) * field.entropy()).sum() for each in visible]
            assert proposal.gain_bits == pytest.approx(max(gains), rel=1e-3)
            assert np.array_equal(proposal.T_field_camera, views[int(np.argmax(gains))])
            explained = np.maximum(explained, visible[int(np.argmax(gains))])

    def test_differ_and_gain_ever_less(self, rng: np.random.Generator) -> None:
        views = self.views(rng)
        proposals, in_sight = propose([target_of(box(), views + views)], 40, 1)
        gains = [proposal.gain_bits for proposal in proposals]
        assert gains == sorted(gains, reverse=True)
        assert len({proposal.T_field_camera.tobytes() for proposal in proposals}) == len(proposals) <= 20
        assert sum(gains) == pytest.approx(in_sight[0], rel=1e-4)
        assert sum(proposal.share for proposal in proposals) == pytest.approx(1, rel=1e-4)

    def test_threads_do_not_matter(self, rng: np.random.Generator) -> None:
        target = target_of(box(), self.views(rng))
        one, many = propose([target], 5, 1), propose([target], 5, 3)
        assert one[1] == many[1]
        assert [item.gain_bits for item in one[0]] == [item.gain_bits for item in many[0]]

    def test_several_targets_compete(self, rng: np.random.Generator) -> None:
        known = box()
        known.log_odds[:, :, 4:] = -8
        targets = [target_of(known, self.views(rng), 1), target_of(box(), self.views(rng), 2)]
        proposals, _ = propose(targets, 3, 1)
        assert proposals[0].number == 2

    def test_nothing_is_proposed_where_nothing_is_to_be_seen(self) -> None:
        away = make_pose(np.eye(3), np.array([0, 0, 5.0]))
        assert propose([target_of(box(), [away])], 3, 1) == ([], [0.0])


class TestThinned:
    def test_few_frames_all_stay(self) -> None:
        states = [state_at(index) for index in range(7)]
        assert downsampled_frames(states, 4) == states
        assert downsampled_frames([], 4) == []

    @pytest.mark.parametrize("count", [8, 9, 33, 100])
    def test_many_frames_at_equal_steps_with_the_last(self, count: int) -> None:
        state = state_at(0)
        kept = [item.index for item in downsampled_frames((replace(state, index=index) for index in range(count)), 4)]
        steps = np.diff(kept)
        assert 4 <= len(kept) <= 9
        assert (kept[0], kept[-1]) == (0, count - 1)
        assert len(set(steps[:-1])) == 1


class TestTargets:
    def test_before_a_fixed_camera_what_moves(self) -> None:
        report = explore(io.BytesIO(packed_stream()), CHOICES)
        assert [item.id for item in report.objects] == [1]
        assert {item.number for item in report.proposals} == {1}
        for item in report.to_map()["proposals"]:
            T_world_object = compose(np.array(item["T_world_camera"]), np.array(item["T_camera_object"]))
            assert np.allclose(T_world_object, toy_pose(3), atol=2e-3)

    def test_the_world_when_asked_for(self) -> None:
        report = explore(io.BytesIO(packed_stream()), replace(CHOICES, objects=(0, 1)))
        assert [item.id for item in report.objects] == [0, 1]
        assert report.candidates == 2 * CHOICES.candidates

    def test_one_frame_is_explored_as_a_room(self) -> None:
        decoder, states = room_from(ROOM.T_world_camera[:1])
        target = target_in(decoder, states, 0)
        proposals, _ = propose([target], 2, 1)
        assert len(proposals) == 2
        assert all(target.field.cells_at(item.T_field_camera[None, :3, 3]).size for item in proposals)

    def test_what_rests_is_part_of_the_world(self) -> None:
        sequence = ListSequence([replace(gradient_frame(index), mask=half_mask()) for index in range(FRAMES)])
        moved = replace(INFO, has_masks=True, has_camera_poses=True, has_object_poses=True)
        poses = [frame.T_world_camera for frame in sequence.frames if frame.T_world_camera is not None]
        sequence.frames = [
            replace(frame, T_camera_object={1: inverse(pose)})
            for frame, pose in zip(sequence.frames, poses, strict=True)
        ]
        sequence.info = moved
        decoder, states = recorded(sequence, 0.1, SegmentationMode.MASKS)
        assert set(decoder.models) == {0, 1}
        target_in(decoder, states, 0)


def half_mask() -> NDArray[np.uint8]:
    mask = np.zeros((CAMERA.height, CAMERA.width), dtype=np.uint8)
    mask[4:8, 4:12] = 1
    return mask


class TestChoices:
    @pytest.mark.parametrize(
        ("choices", "message"),
        [
            ({"candidates": 0}, r"number of candidates 0 must be within 1\.\.100000"),
            ({"best": 0}, "number of proposals 0 must be at least 1"),
            ({"sensor": Sensor.AUTO}, "a stream does not tell the sensor of views to come; name one"),
            ({"threads": 0}, "number of threads 0 must be at least 1"),
        ],
    )
    def test_impossible_ones(self, choices: dict[str, object], message: str) -> None:
        with pytest.raises(ConfigError, match=message):
            ExplorationConfig(**choices)  # type: ignore[arg-type]

    def test_object_that_is_not_there(self) -> None:
        with pytest.raises(
            ConfigError, match=r"object 7 is not there to be explored, or rests as part of 0; choose of 0"
        ):
            explore(io.BytesIO(packed_stream()), replace(CHOICES, objects=(7,)))

    def test_no_surface(self) -> None:
        with pytest.raises(SequenceError, match="no frame shows a surface, so there is nothing to explore"):
            targets_of({}, [CameraRig.registered_to(CAMERA)], [], CHOICES)


# What follows encodes: a part is recorded, advice is followed, and what that brought is measured.

START, STEPS, DRAWS = 3, 3, 3
ROOM = make_scene("room", frames=START, size=(64, 48))
TOY = replace(make_scene("paper", frames=21, size=(64, 64)), background=())


def recorded(sequence: FrameSequence, voxel_size_m: float, mode: SegmentationMode) -> tuple[Decoder, list[FrameState]]:
    """Return what a stream of a sequence decodes to."""
    config = EncoderConfig(
        color_video=ColorVideo.OFF,
        voxel_size_m=voxel_size_m,
        motion=Motion.KNOWN,
        refine=False,
        appearance=AppearanceConfig(rounds=0, relief_bits=0),
        segmentation=SegmentationConfig(mode=mode),
    )
    stream = io.BytesIO()
    encode(sequence, stream, config)
    stream.seek(0)
    decoder = Decoder()
    return decoder, downsampled_frames(decoder.frames(StreamReader(stream, "stream")))


def room_from(path: Poses) -> tuple[Decoder, list[FrameState]]:
    scene = replace(ROOM, T_world_camera=np.stack(path))
    return recorded(SyntheticSequence(scene), 0.08, SegmentationMode.NONE)


def toy_from(path: Poses) -> tuple[Decoder, list[FrameState]]:
    """Record the toy from poses T_object_camera of the fixed camera."""
    count, fixed = len(path), TOY.T_world_camera[0]
    script = np.stack([compose(fixed, inverse(view)) for view in path])
    body = replace(TOY.bodies[0], T_world_body=script)
    scene = replace(TOY, bodies=(body,), T_world_camera=np.repeat(fixed[None], count, axis=0))
    return recorded(SyntheticSequence(scene), 0.02, SegmentationMode.MASKS)


def target_in(decoder: Decoder, states: list[FrameState], number: int) -> Target:
    assert decoder.header is not None
    targets = targets_of(decoder.models, decoder.rigs, states, CHOICES)
    assert [target.number for target in targets] == [number]
    return targets[0]


def entropy_left(decoder: Decoder, states: list[FrameState]) -> float:
    """Return the entropy of the inside of the whole room, in cells that are always the same ones."""
    assert decoder.header is not None
    field = OccupancyField(np.array([-2.3, -2.2, -0.1]), np.array([2.3, 2.0, 2.6]), finest_m=0.1, half_m=0.5)
    for frame in draw_frames(decoder.models, decoder.rigs, states, 2):
        T_camera_world = inverse(frame.state.T_world_camera)
        field.observe(frame.depth, frame.depth > 0, frame.camera, T_camera_world, SENSORS[Sensor.IDEAL])
    return field.bits


@cache
def room_explored() -> tuple[list[float], list[int], list[float], list[int]]:
    """Return entropy and cells after each step of advice, and after as many random views, several times."""
    path = list(ROOM.T_world_camera)
    result = room_from(path)
    first = target_in(*result, 0)
    bits, cells = [entropy_left(*result)], [result[0].models[0].cell_count]
    for _ in range(STEPS):
        path.append(propose([target_in(*result, 0)], 1, 2)[0][0].T_world_camera)
        result = room_from(path)
        bits.append(entropy_left(*result))
        cells.append(result[0].models[0].cell_count)
    rng = np.random.default_rng(1)
    random_bits, random_cells = [], []
    for _ in range(DRAWS):
        picks = rng.choice(len(first.candidates), STEPS, replace=False)
        result = room_from([*ROOM.T_world_camera, *first.candidates[picks]])
        random_bits.append(entropy_left(*result))
        random_cells.append(result[0].models[0].cell_count)
    return bits, cells, random_bits, random_cells


class TestAdvice:
    @pytest.mark.long
    def test_views_of_a_room_take_away_more_entropy_than_random_ones(self) -> None:
        bits, _, random_bits, _ = room_explored()
        assert bits == sorted(bits, reverse=True)
        assert bits[0] - bits[-1] > 2 * (bits[0] - np.mean(random_bits))
        assert bits[-1] < min(random_bits)

    @pytest.mark.long
    def test_views_of_a_room_find_more_surfaces_than_random_ones(self) -> None:
        _, cells, _, random_cells = room_explored()
        assert cells[-1] - cells[0] > 2 * (np.mean(random_cells) - cells[0])

    def test_a_view_of_a_toy_shows_more_of_it_than_random_ones(self) -> None:
        views = [inverse(TOY.object_poses(index)[1]) for index in (0, 10, 20)]
        result = toy_from(views)
        target = target_in(*result, 1)
        (best,), _ = propose([target], 1, 2)
        rng = np.random.default_rng(1)
        seen = result[0].models[1].cell_count
        advised = toy_from([*views, best.T_field_camera])[0].models[1].cell_count
        picks = rng.choice(len(target.candidates), DRAWS, replace=False)
        others = [toy_from([*views, target.candidates[pick]])[0].models[1].cell_count for pick in picks]
        assert advised - seen > 2 * (np.mean(others) - seen)
