# SPDX-License-Identifier: MIT
"""Synthetic sequences: frames, sensor noise, and the command that writes them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from threedvc.cli.synth import NOISES, SCENES, synth
from threedvc.errors import ConfigError
from threedvc.formats.sources.opening import open_sequence
from threedvc.geometry.camera import Camera, CameraRig
from threedvc.synthesis import SCENES as CORE_SCENES
from threedvc.synthesis import Noise, SyntheticSequence, make_scene, shapes, textures
from threedvc.synthesis.noise import depth_edges, kinect_depth, quantized_depth
from threedvc.synthesis.renderer import SceneRenderer
from threedvc.synthesis.scene import Scene
from threedvc.synthesis.shapes import Part, at


def test_frames_carry_what_the_scene_knows() -> None:
    objects, room = (SyntheticSequence(make_scene(name, frames=4, size=(16, 12))) for name in ("objects", "room"))
    frame = objects[2]
    assert frame.index == 2
    assert frame.timestamp_ns == 66_666_667
    assert set(frame.T_camera_object) == {1, 2, 3}
    assert frame.mask is not None
    assert frame.T_world_camera is None
    assert (objects.info.has_object_poses, objects.info.has_masks, objects.info.has_camera_poses) == (True, True, False)
    assert (room.info.has_object_poses, room.info.has_masks, room.info.has_camera_poses) == (False, False, True)
    np.testing.assert_array_equal(room[3].T_world_camera, room.scene.T_world_camera[3])
    assert room[3].mask is None
    assert (objects.info.fps, objects.info.depth_scale, objects.info.frame_count) == (30.0, 1000.0, 4)


def test_sequence_reads_like_a_list_and_more_than_once() -> None:
    sequence = SyntheticSequence(make_scene("paper", frames=3, size=(10, 10)), "kinect", seed=4)
    assert [frame.index for frame in sequence] == [0, 1, 2]
    last, again = sequence[-1], sequence[2]
    assert last.index == 2
    np.testing.assert_array_equal(last.depth, again.depth)
    with pytest.raises(IndexError, match="frame 3 is not within the 3 frames of scene paper"):
        sequence[3]


def test_ideal_depth_is_exact_to_half_a_millimeter() -> None:
    sequence = SyntheticSequence(make_scene("room", frames=2, size=(40, 30)))
    frame, exact = sequence[1], sequence.picture(1)
    assert frame.depth.dtype == np.float32
    np.testing.assert_allclose(frame.depth, exact.depth, atol=0.5001e-3)
    np.testing.assert_allclose(frame.depth * 1000, np.rint(frame.depth * 1000), atol=1e-3)
    np.testing.assert_array_equal(frame.color, exact.color)


def test_depth_beyond_16_bits_is_no_measurement() -> None:
    np.testing.assert_array_equal(quantized_depth(np.array([[0.0, 1.2344, 65.535, 65.536]]), 1000.0)[0],
                                  np.array([0, 1.234, 65.535, 0], np.float32))  # fmt: skip


@pytest.mark.parametrize("z", [0.7, 1.0, 2.0, 3.5])
def test_kinect_noise_grows_with_the_square_of_depth(z: float, rng: np.random.Generator) -> None:
    depth = np.full((200, 200), z)
    measured = kinect_depth(depth, np.zeros(depth.shape, bool), rng)
    step = 0.125 * z * z / 43.5
    expected = np.hypot(0.0012 * z * z, step / np.sqrt(12))
    assert measured.std() == pytest.approx(expected, rel=0.06)
    assert measured.mean() == pytest.approx(z, abs=0.2 * step)
    levels = 43.5 / np.unique(measured)
    np.testing.assert_allclose(levels * 8, np.rint(levels * 8), atol=1e-9)


def test_kinect_measures_nothing_out_of_range_or_unlit(rng: np.random.Generator) -> None:
    depth = np.array([[0.0, 0.39, 0.41, 5.99, 6.01, 1.0]])
    hidden = np.array([[False, False, False, False, False, True]])
    measured = kinect_depth(np.repeat(depth, 50, axis=0), np.repeat(hidden, 50, axis=0), rng)
    assert not measured[:, [0, 1, 4, 5]].any()
    assert (measured[:, [2, 3]] > 0).mean() > 0.85


def test_kinect_drops_one_in_twenty_pixels_at_edges(rng: np.random.Generator) -> None:
    depth = np.where(np.arange(400) % 8 < 4, 1.0, 2.0) * np.ones((300, 1))
    edges = depth_edges(depth)
    assert edges[5, :9].tolist() == [False, False, False, True, True, False, False, True, True]
    measured = kinect_depth(depth, np.zeros(depth.shape, bool), rng)
    assert (measured[edges] == 0).mean() == pytest.approx(0.05, abs=0.005)
    assert (measured[~edges] > 0).all()


def test_slanted_surface_is_no_edge() -> None:
    depth = np.tile(np.linspace(1.0, 2.0, 200), (5, 1))
    assert not depth_edges(depth).any()


def test_projector_shadow_lies_to_the_left_of_near_things() -> None:
    camera = Camera(width=120, height=9, fx=100, fy=100, cx=59.5, cy=4)
    texture = textures.plain((200, 200, 200))
    wall = Part(shape=shapes.rectangle(20, 20), texture=texture, T_body_part=at(0, 0, 2))
    post = Part(shape=shapes.box(0.2, 20, 0.001), texture=texture, T_body_part=at(0, 0, 1))
    scene = Scene(
        name="post", rig=CameraRig.registered_to(camera), background=(wall, post), bodies=(),
        T_world_camera=np.eye(4)[None], camera_moves=False, lights=(),
    )  # fmt: skip
    renderer = SceneRenderer(scene)
    depth, _ = renderer.depth(0)
    hidden = renderer.hidden_from(0, depth, np.array([0.075, 0.0, 0.0]))
    # The post spans x in -0.1..0.1 at 1 m; from 75 mm to the right its shadow on the wall is x in -0.275..0.125.
    x = 2.0 * camera.rays()[..., 0]
    expected = (depth > 1.5) & (x > -0.275) & (x < 0.125)
    np.testing.assert_array_equal(hidden, expected)
    assert hidden[4, :60].any()
    assert not hidden[4, 60:].any()


def test_noise_of_a_frame_does_not_depend_on_the_others() -> None:
    scene = make_scene("objects", frames=5, size=(40, 30))
    forward = [frame.depth for frame in SyntheticSequence(scene, "kinect", 7)]
    backward = SyntheticSequence(scene, Noise.KINECT, 7)
    for index in reversed(range(5)):
        np.testing.assert_array_equal(backward[index].depth, forward[index])
    assert not np.array_equal(SyntheticSequence(scene, "kinect", 8)[0].depth, forward[0])
    exact = backward.picture(0).depth
    share = (forward[0] > 0).mean()
    assert 0.75 < share < 0.999
    measured = forward[0] > 0
    error = np.abs(forward[0] - exact)[measured] / exact[measured] ** 2
    assert np.percentile(error, 99) < 0.006


def test_unknown_noise_is_refused() -> None:
    scene = make_scene("paper", frames=1, size=(2, 2))
    with pytest.raises(ConfigError, match="no noise 'snow'; choose one of ideal, kinect"):
        SyntheticSequence(scene, "snow")
    with pytest.raises(ConfigError, match="seed -2 must not be negative"):
        SyntheticSequence(scene, seed=-2)


def test_command_offers_every_scene_and_noise() -> None:
    assert list(SCENES) == list(CORE_SCENES)
    assert list(NOISES) == list(Noise)


@pytest.mark.parametrize("name", SCENES)
def test_command_writes_what_the_sequence_holds(name: str, tmp_path: Path) -> None:
    folder = tmp_path / "out"
    options = ["--scene", name, "--frames", "3", "--size", "20x14", "--noise", "kinect", "--seed", "5"]
    result = CliRunner().invoke(synth, [str(folder), *options], catch_exceptions=False)
    assert result.exit_code == 0
    assert "3 frames" in result.stderr
    expected = SyntheticSequence(make_scene(name, frames=3, size=(20, 14), seed=5), "kinect", 5)
    written = open_sequence(folder)
    assert len(written) == 3
    assert written.info.rig.color == expected.info.rig.color
    assert written.info.gray == expected.info.gray
    for want, got in zip(expected, written, strict=True):
        assert got.timestamp_ns == want.timestamp_ns
        np.testing.assert_array_equal(got.color, want.color)
        np.testing.assert_array_equal(got.depth, want.depth)
        assert (got.mask is None) == (want.mask is None)
        if want.mask is not None:
            np.testing.assert_array_equal(got.mask, want.mask)
        assert set(got.T_camera_object) == set(want.T_camera_object)
        for label, pose in want.T_camera_object.items():
            np.testing.assert_allclose(got.T_camera_object[label], pose, atol=1e-12)
        if want.T_world_camera is not None:
            np.testing.assert_allclose(got.T_world_camera, want.T_world_camera, atol=1e-9)
