# SPDX-License-Identifier: MIT
"""Scenes and their pictures: exact depth, labels, poses, light, and what each scene promises."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from reference import synthesis as reference
from threedvc.errors import ConfigError
from threedvc.frames.frame import Frame
from threedvc.geometry.camera import Camera, CameraRig
from threedvc.geometry.pose import inverse, make_pose, rotation_from_vector
from threedvc.synthesis import SCENES, SyntheticSequence, make_scene, shapes, textures
from threedvc.synthesis.motion import harmonics, look_at, phases, phases_with_pause
from threedvc.synthesis.renderer import SceneRenderer
from threedvc.synthesis.scene import Body, Light, Scene
from threedvc.synthesis.scenes import OBJECTS_PAUSE, PAPER_THRESHOLD_M, ROOM_PERIOD
from threedvc.synthesis.shapes import Part, at


def plain_scene(camera: Camera) -> Scene:
    """Return one of each primitive before a wall, without texture, two of them moving."""

    def part(shape: shapes.Shape, color: textures.RGB, x: float, y: float, z: float) -> Part:
        rotation = rotation_from_vector(np.array([x, 0.7, 2 * y]))
        return Part(shape=shape, texture=textures.plain(color, 0.0), T_body_part=at(x, y, z, rotation))

    wall = Part(shape=shapes.rectangle(9, 9), texture=textures.plain((200, 200, 190), 0.0), T_body_part=at(0, 0, 3))
    script = np.stack([at(0, 0, 0), at(0.1, -0.05, 0.2)])
    return Scene(
        name="plain",
        rig=CameraRig.registered_to(camera),
        background=(
            wall,
            part(shapes.box(0.5, 0.4, 0.3), (200, 60, 40), -0.7, -0.5, 2.2),
            part(shapes.torus(0.3, 0.1), (60, 160, 80), 0.6, -0.4, 2.0),
            part(shapes.frustum(0.3, 0.1, 0.5), (70, 90, 190), -0.6, 0.5, 2.1),
        ),
        bodies=(
            Body(
                label=3, parts=(part(shapes.ellipsoid(0.3, 0.2, 0.2), (220, 190, 60), 0, 0, 1.5),), T_world_body=script
            ),
            Body(label=7, parts=(part(shapes.capsule(0.15, 0.4), (160, 70, 150), 0.5, 0.4, 1.7),), T_world_body=script),
        ),
        T_world_camera=np.stack([np.eye(4), look_at(np.array([0.2, 0.1, 0.1]), np.array([0.0, 0.1, 2.0]))]),
        camera_moves=True,
        lights=(Light(position=(-0.6, -1.0, 0.4), strength=0.6), Light(position=(1.5, 0.2, 0.1), strength=0.2)),
    )


CAMERA = Camera(width=24, height=18, fx=18.0, fy=18.5, cx=11.2, cy=8.9)


@pytest.mark.parametrize("index", [0, 1])
def test_depth_and_labels_equal_the_reference(index: int) -> None:
    scene = plain_scene(CAMERA)
    depth, labels = SceneRenderer(scene).depth(index)
    expected_depth, expected_labels = reference.depth_and_labels(scene, index)
    np.testing.assert_allclose(depth, expected_depth, atol=1e-9)
    np.testing.assert_array_equal(labels, expected_labels)
    assert set(np.unique(labels)) == {0, 3, 7}


def test_color_equals_the_reference() -> None:
    scene = plain_scene(CAMERA)
    color = SceneRenderer(scene).color(1)
    np.testing.assert_allclose(color, reference.plain_color(scene, 1), atol=0.51)


def test_ray_that_meets_nothing_has_no_depth_and_no_color() -> None:
    scene = replace(plain_scene(CAMERA), background=(), bodies=())
    with_one = replace(scene, background=plain_scene(CAMERA).background[1:2])
    picture = SceneRenderer(with_one).picture(0)
    assert picture.depth[0, -1] == 0
    assert not picture.color[0, -1].any()
    assert (picture.depth > 0).any()


def test_color_and_depth_camera_may_differ() -> None:
    lens = Camera(width=30, height=20, fx=25, fy=25, cx=14, cy=9, distortion=(-0.05, 0.01, 0.001, -0.002, 0.0))
    T_color_depth = make_pose(rotation_from_vector(np.array([0.01, -0.02, 0.03])), np.array([-0.025, 0.001, 0.002]))
    scene = plain_scene(CAMERA)
    split = replace(scene, rig=CameraRig(color=lens, depth=CAMERA, T_color_depth=T_color_depth))
    picture = SceneRenderer(split).picture(1)
    assert picture.color.shape == (20, 30, 3)
    np.testing.assert_array_equal(picture.depth, SceneRenderer(scene).picture(1).depth)
    path = scene.T_world_camera @ inverse(T_color_depth)
    at_color = replace(scene, rig=CameraRig.registered_to(lens), T_world_camera=path)
    np.testing.assert_array_equal(picture.color, SceneRenderer(at_color).color(1))


@pytest.mark.parametrize("name", SCENES)
def test_depth_of_the_scenes_equals_the_reference(name: str) -> None:
    scene = make_scene(name, size=(9, 7))
    depth, labels = SceneRenderer(scene).depth(20)
    expected_depth, expected_labels = reference.depth_and_labels(scene, 20)
    np.testing.assert_allclose(depth, expected_depth, atol=1e-8)
    np.testing.assert_array_equal(labels, expected_labels)


def warped(scene: Scene, source: Frame, target: Frame) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Move every pixel of a frame by the poses; returns pixels (n, 2), depths (n,) and labels (n,) in the target."""
    camera = scene.rig.depth
    points = np.concatenate([camera.rays(), np.ones((camera.height, camera.width, 1))], axis=2)
    points *= source.depth[..., None].astype(np.float64)
    labels = np.zeros(source.depth.shape, np.uint8) if source.mask is None else source.mask
    moved = points.copy()
    for label in np.unique(labels):
        if label:
            T = target.T_camera_object[label] @ inverse(source.T_camera_object[label])
        elif source.T_world_camera is not None:
            T = inverse(target.T_world_camera) @ source.T_world_camera
        else:
            T = np.eye(4)
        moved[labels == label] = points[labels == label] @ T[:3, :3].T + T[:3, 3]
    pixels = np.rint(camera.project(moved)).astype(int)
    inside = (pixels >= 0).all(axis=2) & (pixels[..., 0] < camera.width) & (pixels[..., 1] < camera.height)
    return pixels[inside], moved[inside][:, 2], labels[inside]


@pytest.mark.parametrize(("name", "first", "second"), [("paper", 3, 12), ("objects", 4, 12), ("room", 10, 20)])
def test_points_warped_by_the_poses_land_on_the_surface(name: str, first: int, second: int) -> None:
    scene = make_scene(name, size=(200, 150))
    sequence = SyntheticSequence(scene)
    source, target = sequence[first], sequence[second]
    pixels, depth, labels = warped(scene, source, target)
    seen = target.depth[pixels[:, 1], pixels[:, 0]].astype(np.float64)
    close = np.abs(depth - seen) < 0.01 * seen
    assert close.mean() > 0.93
    if target.mask is not None:
        for label in source.T_camera_object:
            mine = labels == label
            hit = target.mask[pixels[mine, 1], pixels[mine, 0]] == label
            assert hit.mean() > 0.6
            assert close[mine].mean() > 0.6
    # A point may be hidden by what stands before it, but hardly ever float in front of what is seen.
    assert (depth < seen * 0.98).mean() < 0.03


def test_colors_of_a_still_scene_do_not_depend_on_the_viewpoint() -> None:
    scene = make_scene("room", size=(200, 150))
    source, target = SyntheticSequence(scene)[10], SyntheticSequence(scene)[13]
    camera = scene.rig.depth
    points = np.concatenate([camera.rays(), np.ones((150, 200, 1))], axis=2) * source.depth[..., None]
    T = inverse(target.T_world_camera) @ source.T_world_camera
    pixels = np.rint(camera.project(points @ T[:3, :3].T + T[:3, 3])).astype(int)
    inside = (pixels >= 0).all(axis=2) & (pixels[..., 0] < 200) & (pixels[..., 1] < 150)
    seen = target.color[pixels[inside][:, 1], pixels[inside][:, 0]].astype(float)
    error = np.abs(seen - source.color[inside]).mean(axis=1)
    unaligned = np.abs(target.color.astype(float) - source.color).mean(axis=2)
    assert np.median(error) < 10
    assert np.median(error) < 0.6 * np.median(unaligned)


def test_nearest_body_owns_the_pixel() -> None:
    scene = make_scene("objects", size=(80, 60))
    for index in (0, 30, 90):
        depth, labels = SceneRenderer(scene).depth(index)
        alone = {}
        for body in scene.bodies:
            only, mask = SceneRenderer(replace(scene, bodies=(body,))).depth(index)
            alone[body.label] = np.where(mask == body.label, only, np.inf)
        empty, _ = SceneRenderer(replace(scene, bodies=())).depth(index)
        stack = np.stack([empty, *alone.values()])
        np.testing.assert_array_equal(depth, stack.min(axis=0))
        np.testing.assert_array_equal(labels, np.array([0, *alone])[stack.argmin(axis=0)])


def test_objects_hide_each_other_and_stay_in_view() -> None:
    scene = make_scene("objects", size=(80, 60))
    whole = [SceneRenderer(replace(scene, bodies=(body,))) for body in scene.bodies]
    renderer = SceneRenderer(scene)
    visible = np.zeros((0, 3))
    for index in range(0, scene.frame_count, 10):
        labels = renderer.depth(index)[1]
        full = [(r.depth(index)[1] > 0).sum() for r in whole]
        border = np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]])
        assert not border.any()
        shares = [(labels == body.label).sum() / area for body, area in zip(scene.bodies, full, strict=True)]
        visible = np.vstack([visible, shares])
    assert visible.min() < 0.7
    assert visible.min() > 0
    assert (visible == 1).any(axis=0).all()


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_objects_never_touch(seed: int) -> None:
    scene = make_scene("objects", seed=seed)
    for index in range(0, scene.frame_count, 4):
        spheres = [
            [((body.T_world_body[index] @ part.T_body_part)[:3, 3], part.shape.radius) for part in body.parts]
            for body in scene.bodies
        ]
        for i, first in enumerate(spheres):
            for second in spheres[i + 1 :]:
                gaps = [np.linalg.norm(p - q) - r - s for p, r in first for q, s in second]
                assert min(gaps) > 0


def test_pausing_object_is_exactly_still_and_others_move() -> None:
    scene = make_scene("objects", size=(16, 12))
    poses = {body.label: body.T_world_body for body in scene.bodies}
    still = poses[1][OBJECTS_PAUSE.start]
    for index in OBJECTS_PAUSE:
        np.testing.assert_array_equal(poses[1][index], still)
        assert np.array_equal(scene.object_poses(index)[1], scene.object_poses(OBJECTS_PAUSE.start)[1])
    for label, pause in ((1, OBJECTS_PAUSE), (2, range(0)), (3, range(0))):
        moves = np.abs(np.diff(poses[label], axis=0)).max(axis=(1, 2)) > 0
        resting = [index for index in range(len(moves)) if index in pause and index + 1 in pause]
        np.testing.assert_array_equal(np.flatnonzero(~moves), resting)
    first, last = SyntheticSequence(scene)[OBJECTS_PAUSE.start], SyntheticSequence(scene)[OBJECTS_PAUSE.stop - 1]
    both = (first.mask == 1) & (last.mask == 1)
    assert both.any()
    np.testing.assert_array_equal(first.depth[both], last.depth[both])


def test_motion_is_smooth() -> None:
    for name in SCENES:
        scene = make_scene(name, size=(1, 1))
        for script in (scene.T_world_camera, *(body.T_world_body for body in scene.bodies)):
            steps = np.diff(script[:, :3], axis=0)
            assert np.abs(steps[:, :, 3]).max() < 0.035
            assert np.linalg.norm(steps[:, :, :3], axis=(1, 2)).max() < 2**0.5 * np.radians(5)
            assert np.abs(np.diff(steps, axis=0)).max() < 0.02


def test_depth_threshold_separates_the_papers_object_in_every_frame() -> None:
    scene = make_scene("paper", size=(50, 50))
    sequence = SyntheticSequence(scene)
    assert (len(sequence), sequence.info.gray) == (150, True)
    renderer = SceneRenderer(scene)
    for index in range(len(sequence)):
        depth, labels = renderer.depth(index)
        np.testing.assert_array_equal(depth < PAPER_THRESHOLD_M, labels == 1)
        assert 0.03 < (labels == 1).mean() < 0.25
        assert np.abs(depth - PAPER_THRESHOLD_M).min() > 0.01


@pytest.mark.parametrize("seed", range(1, 9))
def test_threshold_holds_for_other_seeds(seed: int) -> None:
    scene = make_scene("paper", seed=seed, size=(25, 25))
    assert SceneRenderer(scene).depth(0)[0][SceneRenderer(scene).depth(0)[1] == 0].min() > PAPER_THRESHOLD_M
    for index in range(scene.frame_count):
        T = scene.object_poses(index)[1]
        farthest = max((T @ part.T_body_part)[2, 3] + part.shape.radius for part in scene.bodies[0].parts)
        assert farthest < PAPER_THRESHOLD_M


def test_paper_frames_are_gray_and_eight_bit_100x100() -> None:
    frame = SyntheticSequence(make_scene("paper"))[0]
    assert frame.color.shape == (100, 100, 3)
    assert frame.color.dtype == np.uint8
    assert (frame.color == frame.color[..., :1]).all()
    assert np.unique(frame.color).size > 100


def test_room_path_comes_back_to_its_start() -> None:
    scene = make_scene("room", size=(20, 15))
    assert scene.frame_count == 150
    np.testing.assert_array_equal(scene.T_world_camera[ROOM_PERIOD:], scene.T_world_camera[: 150 - ROOM_PERIOD])
    first, again = SyntheticSequence(scene)[4], SyntheticSequence(scene)[4 + ROOM_PERIOD]
    np.testing.assert_array_equal(first.color, again.color)
    np.testing.assert_array_equal(first.depth, again.depth)
    assert np.ptp(scene.T_world_camera[:, :3, 3], axis=0).max() > 1.0


@pytest.mark.parametrize("name", SCENES)
def test_fewer_frames_are_the_start_of_the_sequence(name: str) -> None:
    short, long = make_scene(name, frames=7, size=(8, 6)), make_scene(name, frames=400, size=(8, 6))
    np.testing.assert_array_equal(short.T_world_camera, long.T_world_camera[:7])
    for few, many in zip(short.bodies, long.bodies, strict=True):
        np.testing.assert_array_equal(few.T_world_body, many.T_world_body[:7])


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("size", [(1, 1), (33, 17), (3, 41)])
def test_any_size_shows_the_closed_room(name: str, size: tuple[int, int]) -> None:
    frame = SyntheticSequence(make_scene(name, frames=1, size=size), noise="kinect")[0]
    ideal = SyntheticSequence(make_scene(name, frames=1, size=size))[0]
    assert frame.color.shape == (size[1], size[0], 3)
    assert frame.depth.shape == (size[1], size[0])
    assert (ideal.depth > 0.3).all()


@pytest.mark.parametrize("name", SCENES)
def test_seed_decides_everything_and_threads_nothing(name: str) -> None:
    def frame(seed: int, threads: int) -> Frame:
        return SyntheticSequence(make_scene(name, size=(40, 30), seed=seed), "kinect", seed, threads)[5]

    one, three, other = frame(0, 1), frame(0, 3), frame(1, 1)
    np.testing.assert_array_equal(one.color, three.color)
    np.testing.assert_array_equal(one.depth, three.depth)
    assert (one.color != other.color).mean() > 0.3
    assert (one.depth != other.depth).any()


def test_bad_scenes_are_refused() -> None:
    with pytest.raises(ConfigError, match="no scene 'kitchen'; choose one of paper, objects, room"):
        make_scene("kitchen")
    with pytest.raises(ConfigError, match="number of frames 0 must be at least 1"):
        make_scene("room", frames=0)
    with pytest.raises(ConfigError, match=r"seed -1 is not within 0\.\.2147483647"):
        make_scene("room", seed=-1)
    with pytest.raises(ConfigError, match="picture size 0x5"):
        make_scene("room", size=(0, 5))
    scene = plain_scene(CAMERA)
    with pytest.raises(ConfigError, match="labels"):
        replace(scene, bodies=(scene.bodies[0], scene.bodies[0]))
    with pytest.raises(ConfigError, match="2 frames"):
        replace(scene, bodies=(replace(scene.bodies[0], T_world_body=np.eye(4)[None]),))


def test_phases_pause_exactly_and_repeat() -> None:
    phase = phases_with_pause(250, 100, range(30, 50))
    assert (phase[30:50] == phase[30]).all()
    assert (np.diff(phase[:30]) > 0).all()
    assert (np.diff(phase[49:100]) > 0).all()
    np.testing.assert_array_equal(phase[100:200], phase[:100])
    assert phase[0] == 0
    np.testing.assert_array_equal(phases(5, 4), [0, 0.25, 0.5, 0.75, 0])


def test_harmonics_stay_within_their_amplitudes(rng: np.random.Generator) -> None:
    amplitudes = np.array([[0.5, 0.0, 0.1], [0.2, 0.0, 0.3]])
    values = harmonics(phases(400, 200), amplitudes, rng)
    assert (np.abs(values) <= amplitudes.sum(axis=0) + 1e-12).all()
    np.testing.assert_array_equal(values[:200], values[200:])
    assert not values[:, 1].any()


def test_look_at_puts_the_target_in_the_middle_and_up_on_top() -> None:
    T_world_camera = look_at(np.array([1.0, 2.0, 1.5]), np.array([0.0, 0.5, 1.0]))
    seen = inverse(T_world_camera) @ np.array([0.0, 0.5, 1.0, 1.0])
    np.testing.assert_allclose(seen[:2], 0, atol=1e-12)
    assert seen[2] > 0
    assert (inverse(T_world_camera) @ np.array([0.0, 0.5, 1.3, 1.0]))[1] < 0
    assert np.linalg.det(T_world_camera[:3, :3]) == pytest.approx(1)
