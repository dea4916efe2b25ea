# SPDX-License-Identifier: MIT
"""Programs that do tasks: the poses they take and give are ours; one that is missing is named."""

from __future__ import annotations

import numpy as np
import pytest

import task_tools
from task_inputs import scene_of
from task_scores import f_score, trajectory_scores
from threedvc.frames.frame import Frame
from threedvc.synthesis.sequence import SyntheticSequence

FRAMES = 3
SURFACE_M = 0.01


@pytest.fixture(scope="module")
def scene() -> SyntheticSequence:
    return scene_of("room", FRAMES, "ideal")


@pytest.fixture(scope="module")
def frames(scene: SyntheticSequence) -> list[Frame]:
    return list(scene)


@pytest.fixture
def loaded() -> None:
    """Skip without Open3D."""
    try:
        task_tools.open3d()
    except task_tools.MissingTool as error:
        pytest.skip(str(error))


class TestOdometry:
    def test_steps_of_opencv_lead_from_each_camera_to_the_next(
        self, scene: SyntheticSequence, frames: list[Frame]
    ) -> None:
        steps = task_tools.opencv_steps(frames, scene.info.rig.depth)
        scores = trajectory_scores([frame.T_world_camera for frame in frames], steps)
        assert len(steps) == FRAMES - 1
        assert scores["rpe_mm"] < 3
        assert scores["rpe_deg"] < 0.2

    def test_what_opencv_cannot_tell_is_no_step(self, scene: SyntheticSequence, frames: list[Frame]) -> None:
        empty = [
            Frame(index=k, timestamp_ns=k, color=np.zeros_like(frames[0].color), depth=np.zeros_like(frames[0].depth))
            for k in range(2)
        ]
        (told,) = task_tools.opencv_steps(empty, scene.info.rig.depth)
        assert np.array_equal(told, np.eye(4))

    @pytest.mark.usefixtures("loaded")
    def test_steps_of_open3d_lead_from_each_camera_to_the_next(
        self, scene: SyntheticSequence, frames: list[Frame]
    ) -> None:
        steps = task_tools.open3d_steps(frames, scene.info.rig.depth)
        scores = trajectory_scores([frame.T_world_camera for frame in frames], steps)
        assert scores["rpe_mm"] < 3
        assert scores["rpe_deg"] < 0.2


@pytest.mark.usefixtures("loaded")
def test_fused_surfaces_of_the_same_depth_are_the_same(scene: SyntheticSequence, frames: list[Frame]) -> None:
    poses, camera = [frame.T_world_camera for frame in frames], scene.info.rig.depth
    right, off = (
        task_tools.fused([frame.depth + np.float32(error) for frame in frames], poses, camera) for error in (0, 0.05)
    )
    scores = [
        f_score(task_tools.distances(found, right), task_tools.distances(right, found), SURFACE_M)
        for found in (right, off)
    ]
    assert scores[0] == 1
    assert scores[1] < 0.5


def test_missing_package_is_named_with_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> None:
        raise ModuleNotFoundError(name)

    monkeypatch.setattr(task_tools.importlib, "import_module", missing)
    with pytest.raises(task_tools.MissingTool, match=r"need Open3D; install the extra \[bench\]"):
        task_tools.open3d()


def test_package_that_lacks_a_library_names_it(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(name: str) -> None:
        raise ImportError("libx.so: cannot open shared object file")

    monkeypatch.setattr(task_tools.importlib, "import_module", broken)
    with pytest.raises(task_tools.MissingTool, match=r"cannot be loaded \(libx.so: .*\); install that library"):
        task_tools.open3d()
