# SPDX-License-Identifier: MIT
"""What a frame shows, and what a course of frames comes to: a ball that hides, leaves and comes back."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest
from numpy.typing import NDArray

from reference.rendering import model_of_cells, surface_cells
from threedvc.config import RenderConfig
from threedvc.decoder.frame_state import FrameState
from threedvc.formats.evaluation.frame_ranges import FrameSpan
from threedvc.formats.evaluation.timeline import StreamTimeline
from threedvc.formats.evaluation.visibility import VisibilityDetector
from threedvc.geometry.camera import Camera, CameraRig
from threedvc.geometry.pose import Pose, inverse, make_pose, rotation_from_vector
from threedvc.model.decoded_model import DecodedModel
from threedvc.model.model_update import ModelUpdate
from threedvc.render.ray_grid import RayGrid

CELL = 0.03
RIG = CameraRig.registered_to(Camera(width=320, height=240, fx=300.0, fy=300.0, cx=159.5, cy=119.5))
ONE_THREAD = RenderConfig(threads=1)


def ball(points: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.linalg.norm(points, axis=-1) - 0.2


def wall(points: NDArray[np.float64]) -> NDArray[np.float64]:
    return points[..., 2] - 0.004


def gray(cells: NDArray[np.int32]) -> DecodedModel:
    return model_of_cells(cells, CELL, np.full((len(cells), 3), 90, dtype=np.int16))


@pytest.fixture(scope="module")
def models() -> dict[int, DecodedModel]:
    return {0: gray(surface_cells(wall, CELL, 1.6)), 1: gray(surface_cells(ball, CELL, 0.3))}


def at(x: float, z: float, turn_deg: float = 0.0) -> Pose:
    return make_pose(rotation_from_vector(np.array([0, np.radians(turn_deg), 0])), np.array([x, 0, z]))


class TestLookout:
    @pytest.mark.parametrize(
        ("x", "z", "seen"), [(0, 1.5, True), (0, 2.5, False), (2, 1.5, False), (0, -1.5, False)],
        ids=["before the wall", "behind it", "beside the picture", "behind the camera"],
    )  # fmt: skip
    def test_what_stands_where(self, models: dict[int, DecodedModel], x: float, z: float, seen: bool) -> None:
        visible = VisibilityDetector(RIG, ONE_THREAD).visible(models, {0: at(0, 2), 1: at(x, z)})
        assert visible == ({0, 1} if seen else {0})

    def test_too_small_to_be_seen_but_large_enough_to_stay(self, models: dict[int, DecodedModel]) -> None:
        # At 30 m the ball covers 1/6000 of the picture, and a single ray, of the column 1.5 pixels left of the middle.
        detector = VisibilityDetector(RIG, ONE_THREAD)
        seen = [1 in detector.visible(models, {1: at(-0.005 * z, z)}) for z in (30, 10, 30, 200, 30)]
        assert seen == [False, True, True, False, False]

    def test_the_same_frame_again_casts_nothing(
        self, models: dict[int, DecodedModel], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        detector, poses = VisibilityDetector(RIG, ONE_THREAD), {0: at(0, 2), 1: at(0, 1.5)}
        first = detector.visible(models, poses)
        monkeypatch.setattr(detector, "_look", None)
        assert detector.visible(models, {number: pose.copy() for number, pose in poses.items()}) == first

    def test_a_model_that_grows_is_seen(self, models: dict[int, DecodedModel]) -> None:
        growing = DecodedModel(CELL)
        detector = VisibilityDetector(RIG, ONE_THREAD)
        assert detector.visible({1: growing}, {1: at(0, 1.5)}) == set()
        cells, colors = models[1].cells()
        growing.apply(ModelUpdate.adding(cells, colors))
        assert detector.visible({1: growing}, {1: at(0, 1.5)}) == {1}

    def test_guessed_objects_show_where_there_is_nothing_else(self, models: dict[int, DecodedModel]) -> None:
        guessed = DecodedModel(CELL, guessed=True)
        guessed.apply(ModelUpdate.adding(*models[1].cells()))
        assert VisibilityDetector(RIG, ONE_THREAD).visible({2: guessed}, {2: at(0, 1.5)}) == {2}
        assert VisibilityDetector(RIG, ONE_THREAD).visible({**models, 2: guessed}, {0: at(0, 2), 2: at(0, 1.5)}) == {0}

    @pytest.mark.parametrize(("width", "height"), [(1, 1), (3, 500), (100, 100), (1280, 960)])
    def test_any_size_gets_thousands_of_rays_at_most(self, width: int, height: int) -> None:
        camera = Camera(width=width, height=height, fx=300.0, fy=300.0, cx=width / 2, cy=height / 2)
        rays: RayGrid = VisibilityDetector(CameraRig.registered_to(camera), ONE_THREAD)._rays
        assert 1 <= len(rays.slopes) <= 12_000


def state(index: int, T_world_camera: Pose, T_world_object: Mapping[int, Pose]) -> FrameState:
    T_camera_world = inverse(T_world_camera)
    return FrameState(
        index=index,
        timestamp_ns=index,
        sensor=0,
        number=index,
        synchronized=False,
        T_world_camera=T_world_camera,
        T_camera_object={0: T_camera_world} | {n: T_camera_world @ pose for n, pose in T_world_object.items()},
        T_shifted_camera=np.eye(4),
        gain=np.zeros((3, 2), dtype=np.int64),
        backdrop=None,
        lights={},
        filters=None,
        captured_depth=None,
    )


class TestCourse:
    def course(self, visible: list[set[int]], poses: list[Pose], cameras: list[Pose] | None = None) -> StreamTimeline:
        course = StreamTimeline()
        for index, (numbers, pose) in enumerate(zip(visible, poses, strict=True)):
            camera = np.eye(4) if cameras is None else cameras[index]
            course.add(state(index, camera, {1: pose}), frozenset(numbers))
        return course

    def test_leaving_and_coming_back(self, models: dict[int, DecodedModel]) -> None:
        course = self.course([{0}, {0, 1}, {0, 1}, {0}, {0, 1}], [at(0, 1)] * 5)
        assert course.spans(1) == (FrameSpan(1, 2), FrameSpan(4, 4))
        assert course.spans(0) == (FrameSpan(0, 4),)
        assert course.spans(7) == ()
        assert course.counts(models) == [0, 1, 1, 0, 1]

    def test_what_is_guessed_does_not_count(self, models: dict[int, DecodedModel]) -> None:
        course = self.course([{0, 1, 2}], [at(0, 1)])
        assert course.counts({**models, 2: DecodedModel(CELL, guessed=True)}) == [1]

    def test_an_object_goes_as_far_as_its_middle_does(self, models: dict[int, DecodedModel]) -> None:
        # The ball's cells lie 2 m off the origin of their frame, which turns about the ball.
        cells, colors = models[1].cells()
        apart = DecodedModel(CELL)
        apart.apply(ModelUpdate.adding(cells + np.array([0, 0, round(2 / CELL)], dtype=np.int32), colors))
        middle = (apart.cells()[0].mean(axis=0) + 0.5) * CELL
        turning = [turned @ make_pose(np.eye(3), -middle) for turned in (at(0, 1), at(0, 1, 20), at(0, 1, 40))]
        travel = self.course([{1}] * 3, turning).object_travel(1, apart)
        assert travel is not None
        assert (travel.length_m, travel.turn_deg) == pytest.approx((0, 40), abs=1e-9)

    def test_the_way_of_the_camera_is_not_that_of_the_object(self, models: dict[int, DecodedModel]) -> None:
        cameras = [at(0.1 * k, 0, 5 * k) for k in range(4)]
        course = self.course([{1}] * 4, [at(0, 1)] * 4, cameras)
        travel, way = course.object_travel(1, models[1]), course.camera_travel()
        assert travel is not None
        assert way is not None
        assert (travel.length_m, travel.turn_deg) == pytest.approx((0, 0), abs=1e-6)
        assert (way.length_m, way.turn_deg) == pytest.approx((0.3, 15))

    def test_poses_before_birth_do_not_count(self, models: dict[int, DecodedModel]) -> None:
        course = self.course([set(), {1}, {1}], [np.eye(4), at(0, 5), at(0.1, 5)])
        travel = course.object_travel(1, models[1])
        assert travel is not None
        assert travel.length_m == pytest.approx(0.1)

    def test_no_travel(self, models: dict[int, DecodedModel]) -> None:
        course = self.course([set()], [at(0, 1)])
        assert course.object_travel(1, models[1]) is None
        assert self.course([{0, 1}], [at(0, 1)]).object_travel(1, DecodedModel(CELL)) is None
        assert self.course([{0}], [at(0, 1)]).object_travel(0, models[0]) is None
        assert StreamTimeline().camera_travel() is None
