# SPDX-License-Identifier: MIT
"""The encoder's view of a sequence: which objects there are, where they were found, what is fused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from threedvc.config import EncoderConfig, Motion, SegmentationConfig, SegmentationMode, Sensor
from threedvc.encoder.reconstruction.cell_size import default_voxel_size
from threedvc.encoder.reconstruction.scene import Scene
from threedvc.encoder.reconstruction.scene_object import SceneObject
from threedvc.encoder.tracking.pose_track import TrackedPose
from threedvc.errors import SequenceError
from threedvc.frames.frame import Frame, SequenceInfo
from threedvc.geometry.camera import Camera, CameraRig
from threedvc.geometry.pose import Pose, identity, make_pose
from threedvc.stream.pose_status import PoseStatus

CAMERA = Camera(width=48, height=36, fx=50.0, fy=50.0, cx=23.5, cy=17.5)
INFO = SequenceInfo(
    name="wall", rig=CameraRig.registered_to(CAMERA), depth_scale=1000.0, fps=30.0, frame_count=None,
    has_camera_poses=True, has_object_poses=True, has_masks=True,
)  # fmt: skip
MASKS = SegmentationConfig(mode=SegmentationMode.MASKS)
BOX = (slice(10, 22), slice(8, 24))


def config(**changes: object) -> EncoderConfig:
    values = {"segmentation": MASKS, "motion": Motion.KNOWN, "sensor": Sensor.IDEAL, "threads": 1, "refine": False}
    return EncoderConfig(**{**values, **changes})  # type: ignore[arg-type]


def shifted(x: float, z: float = 0.0) -> Pose:
    return make_pose(np.eye(3), np.array([x, 0.0, z]))


def frame(index: int, *, boxed: bool = True, pose: Pose | None = None, wall: float = 1.5) -> Frame:
    """Return a wall with a box before it, which has label 3."""
    depth = np.full((36, 48), wall, dtype=np.float32)
    mask = np.zeros((36, 48), dtype=np.uint8)
    if boxed:
        depth[BOX], mask[BOX] = 0.9, 3
    color = np.full((36, 48, 3), 90, dtype=np.uint8)
    color[0, 0] = index
    poses = {3: shifted(0, 0.9) if pose is None else pose} if boxed else {}
    return Frame(
        index=index,
        timestamp_ns=index,
        color=color,
        depth=depth,
        mask=mask,
        T_world_camera=identity(),
        T_camera_object=poses,
    )


def test_objects_are_those_of_the_labels() -> None:
    scene = Scene(INFO, config())
    assert scene.entropy_bits == 0
    assert scene.add(frame(0, boxed=False)) is PoseStatus.KNOWN
    assert sorted(scene.objects) == [0]
    scene.add(frame(1))
    assert sorted(scene.objects) == [0, 3]
    assert (scene.objects[0].born, scene.objects[3].born) == (0, 1)
    assert [record.timestamp_ns for record in scene.records] == [0, 1]
    assert scene.entropy_bits == sum(item.entropy.bits for item in scene.objects.values()) > 0


def test_a_few_pixels_make_no_object() -> None:
    scene = Scene(INFO, config())
    speck = frame(0, boxed=False)
    assert speck.mask is not None
    speck.mask[3:5, 3:9] = 7
    scene.add(speck)
    assert sorted(scene.objects) == [0]


def test_an_object_has_its_own_model() -> None:
    scene = Scene(INFO, config())
    for index in range(3):
        scene.add(frame(index))
    box, wall = scene.objects[3].evidence, scene.objects[0].evidence
    occupied = [
        model.index.coords[np.flatnonzero((model.log_odds[: model.index.count] > 1).any(axis=1))]
        * 8
        * model.voxel_size_m
        for model in (box, wall)
    ]
    # The box's frame has its origin in the box, the wall's in the camera.
    assert np.abs(occupied[0][:, 2]).max() < 0.3
    assert np.abs(occupied[1][:, 2] - 1.5).max() < 0.4


def test_an_unseen_object_keeps_its_last_pose_and_at_first_its_first() -> None:
    scene = Scene(INFO, config())
    places = [None, None, shifted(0.1, 0.9), shifted(0.2, 0.9), None, shifted(0.4, 0.9)]
    for index, place in enumerate(places):
        scene.add(frame(index, boxed=place is not None, pose=place))
    x = [pose[0, 3] for pose in scene.objects[3].poses]
    assert x == [0.1, 0.1, 0.1, 0.2, 0.2, 0.4]
    assert scene.objects[3].born == 2
    assert [at is None for at in scene.objects[3].found] == [True, True, False, False, True, False]


def test_what_was_never_found_stands_at_the_origin() -> None:
    item = SceneObject(1, 0.01, None)
    for index in range(3):
        item.record(index, None)
    assert item.born is None
    np.testing.assert_array_equal(item.poses, [identity()] * 3)


def test_the_worst_status_of_a_frame_is_told() -> None:
    script = {
        0: [
            TrackedPose(T_camera_object=identity(), status=PoseStatus(status))
            for status in ("known", "tracked", "tracked", "weak")
        ],
        3: [
            TrackedPose(T_camera_object=shifted(0, 0.9), status=PoseStatus(status))
            for status in ("known", "known", "lost", "tracked")
        ],
    }
    scene = Scene(INFO, config(), script)
    assert [scene.add(frame(index)) for index in range(4)] == ["known", "tracked", "lost", "weak"]


def test_a_lost_object_is_not_fused() -> None:
    lost = TrackedPose(T_camera_object=shifted(0.3, 0.9), status=PoseStatus.LOST)
    found = TrackedPose(T_camera_object=shifted(0, 0.9), status=PoseStatus.TRACKED)
    here = TrackedPose(T_camera_object=identity(), status=PoseStatus.KNOWN)
    once = Scene(INFO, config(), {0: [here] * 3, 3: [found] * 3})
    twice = Scene(INFO, config(), {0: [here] * 3, 3: [found, lost, lost]})
    once.add(frame(0))
    for index in range(3):
        twice.add(frame(index))
    np.testing.assert_array_equal(once.objects[3].evidence.log_odds, twice.objects[3].evidence.log_odds)


def test_a_frame_that_repeats_the_one_before_is_not_fused() -> None:
    once, twice = Scene(INFO, config()), Scene(INFO, config())
    once.add(frame(0))
    for index in range(3):
        twice.add(replace(frame(0), index=index, timestamp_ns=index))
    assert [record.repeated for record in twice.records] == [False, True, True]
    for number in (0, 3):
        evidence = [scene.objects[number].evidence for scene in (once, twice)]
        np.testing.assert_array_equal(evidence[0].log_odds, evidence[1].log_odds)
        assert len(twice.objects[number].poses) == 3
    twice.add(frame(3))
    assert np.any(twice.objects[0].evidence.log_odds != once.objects[0].evidence.log_odds)


@pytest.mark.parametrize("broken", [np.nan, np.inf, -np.inf, -1.0])
def test_what_is_no_depth_counts_as_no_measurement(broken: float) -> None:
    scenes = [Scene(INFO, config()), Scene(INFO, config())]
    for index in range(2):
        holes = frame(index)
        holes.depth[5:9, 30:40] = 0
        bad = replace(holes, depth=np.where(holes.depth == 0, np.float32(broken), holes.depth))
        scenes[0].add(holes)
        scenes[1].add(bad)
    one, two = (scene.objects[0].evidence for scene in scenes)
    np.testing.assert_array_equal(one.log_odds, two.log_odds)
    np.testing.assert_array_equal(one.color, two.color)


def test_a_depth_limit_cuts_what_is_beyond() -> None:
    scene = Scene(INFO, config(max_depth_m=1.2))
    scene.add(frame(0))
    assert scene.objects[0].evidence.index.count == 0
    assert scene.objects[3].evidence.index.count > 0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"depth": np.zeros((36, 47), dtype=np.float32)},
            r"wall: frame 2 has depth of shape \(36, 47\), its camera asks for \(36, 48\)",
        ),
        (
            {"color": np.zeros((35, 48, 3), dtype=np.uint8)},
            r"color of shape \(35, 48, 3\), its camera asks for \(36, 48, 3\)",
        ),
        ({"color": np.zeros((36, 48), dtype=np.uint8)}, r"wall: frame 2 has color of shape \(36, 48\), its"),
        ({"mask": np.zeros((18, 24), dtype=np.uint8)}, r"wall: mask of frame 2 has 24x18 pixels, its depth 48x36"),
        ({"T_world_camera": np.full((4, 4), np.nan)}, r"wall: frame 2 has a camera pose that is not a rigid transform"),
        (
            {"T_camera_object": {3: np.zeros((4, 4))}},
            r"wall: frame 2 has a pose of object 3 that is not a rigid transform",
        ),
    ],
)
def test_frames_that_do_not_fit_are_refused(changes: dict[str, object], message: str) -> None:
    scene = Scene(INFO, config())
    with pytest.raises(SequenceError, match=message):
        scene.add(replace(frame(2), **changes))


def whole(depth: NDArray[np.float32]) -> NDArray[np.bool_]:
    return np.ones(depth.shape, dtype=bool)


def test_the_default_cell_follows_distance_and_picture() -> None:
    large = replace(INFO, rig=CameraRig.registered_to(CAMERA.resized(640, 480)))
    near, far = (np.full((480, 640), z, dtype=np.float32) for z in (1.0, 3.0))
    one, three = (default_voxel_size(depth, whole(depth), large.rig) for depth in (near, far))
    # Four pixels of a 640x480 picture; a pixel spans z / fx.
    assert one == pytest.approx(4.0 * 1.0 / large.rig.depth.fx, abs=0.0006)
    assert three == pytest.approx(3 * one, abs=0.0016)
    assert one == round(one, 3)


def test_the_default_cell_is_that_of_the_object() -> None:
    picture = frame(0)
    box = picture.mask == 3
    assert default_voxel_size(picture.depth, box, INFO.rig) < default_voxel_size(picture.depth, ~box, INFO.rig)
    nothing = np.zeros_like(picture.depth)
    assert default_voxel_size(nothing, whole(nothing), INFO.rig) > 0
    close = np.full_like(picture.depth, 0.001)
    assert default_voxel_size(close, whole(close), INFO.rig) == 0.001


@pytest.mark.parametrize(
    "early",
    [
        pytest.param([0.0], id="one frame without depth"),
        pytest.param([0.0, 0.0, 0.0], id="three frames without depth"),
        pytest.param([0.3], id="a few near points first"),
        pytest.param([9.0, 0.0, 0.2], id="a few far, none, a few near"),
    ],
)
def test_frames_with_hardly_any_depth_choose_nothing(early: list[float]) -> None:
    late, whole_from_the_start = Scene(INFO, config()), Scene(INFO, config())
    whole_from_the_start.add(frame(0, boxed=False))
    for k, distance in enumerate(early):
        depth = np.zeros((36, 48), dtype=np.float32)
        depth[4, 5:9] = distance
        late.add(replace(frame(k, boxed=False), depth=depth))
    late.add(frame(len(early), boxed=False))
    assert late.distance_m == whole_from_the_start.distance_m == pytest.approx(1.5)
    assert late.objects[0].evidence.voxel_size_m == whole_from_the_start.objects[0].evidence.voxel_size_m


def test_sensor_is_guessed_once_or_given() -> None:
    rng = np.random.default_rng(4)
    smooth, noisy = Scene(INFO, config(sensor=Sensor.AUTO)), Scene(INFO, config(sensor=Sensor.AUTO))
    smooth.add(frame(0))
    rough = frame(0, boxed=False)
    noisy.add(replace(rough, depth=(rough.depth + rng.normal(0, 0.01, rough.depth.shape)).astype(np.float32)))
    assert smooth.sensor_of(0).sigma_m(2.0) < noisy.sensor_of(0).sigma_m(2.0)
    before = smooth.sensor_of(0)
    smooth.add(replace(frame(1), depth=(frame(1).depth + rng.normal(0, 0.01, rough.depth.shape)).astype(np.float32)))
    assert smooth.sensor_of(0) is before
    assert Scene(INFO, config()).sensor_of(0).sigma_m(2.0) > 0


def test_what_was_not_in_the_field_of_view_lately_is_out_of_sight() -> None:
    scene = Scene(INFO, config())
    for index in range(8):
        # The camera turns round after the third frame.
        turn = make_pose(np.diag([-1.0, 1.0, -1.0]), np.zeros(3)) if index > 2 else identity()
        scene.add(replace(frame(index, boxed=False), T_world_camera=turn))
    background = scene.objects[0]
    ahead = background.evidence.index.coords[: background.evidence.index.count, 2] > 0
    assert 0 < np.count_nonzero(ahead) < len(ahead)
    np.testing.assert_array_equal(background.in_sight, ~ahead)


@pytest.mark.parametrize(
    ("changes", "wider"), [({}, True), ({"causal": False}, False), ({"voxel_size_m": 0.05}, False)]
)
def test_live_cells_are_as_wide_as_the_rate_asks(changes: dict[str, object], wider: bool) -> None:
    sizes = []
    for rate in (8e3, 8.8e3):
        scene = Scene(INFO, config(**{"causal": True, "bitrate_bps": rate, **changes}))
        scene.add(frame(0))
        sizes.append([item.evidence.voxel_size_m for _, item in sorted(scene.objects.items())])
    np.testing.assert_allclose(np.divide(*sizes), 1.1**0.5 if wider else 1, rtol=0.01)


def test_a_frame_without_a_mask_is_labeled_by_the_models() -> None:
    scene = Scene(INFO, config())
    for index in range(4):
        scene.add(frame(index))
    bare = replace(frame(4), mask=None)
    expected = frame(4).mask
    assert expected is not None
    labels = scene.labels(bare)
    agree = np.count_nonzero((labels == 3) & (expected == 3))
    assert agree > 0.7 * np.count_nonzero(expected == 3)
    assert np.count_nonzero((labels == 3) & (expected != 3)) == 0
    scene.add(bare)
    assert scene.objects[3].found[4] is not None


def test_the_first_frame_needs_its_mask() -> None:
    with pytest.raises(SequenceError, match="frame 0 has no mask"):
        Scene(INFO, config()).add(replace(frame(0), mask=None))
