# SPDX-License-Identifier: MIT
"""A synthetic scene as a sequence of frames, rendered when they are asked for."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from threedvc.errors import ConfigError
from threedvc.frames.frame import Frame, SequenceInfo
from threedvc.geometry.pose import Pose, make_pose, rotation_from_vector
from threedvc.synthesis.noise import KINECT_PROJECTOR_M, Noise, kinect_depth, quantized_depth
from threedvc.synthesis.renderer import Picture, SceneRenderer
from threedvc.synthesis.scene import Scene
from threedvc.units import MILLIMETERS, NANOSECONDS

__all__ = ["SyntheticSequence", "mounted_sequences"]

DEPTH_SCALE = MILLIMETERS
"""Units per meter: millimeters, as most depth pictures have them."""
SENSOR_TURN_RAD, SENSOR_SHIFT_M = 0.6, 0.12
"""How each sensor of several is mounted to the right of the one before: 34 degrees, so that their fields of view
overlap by nearly half."""


class SyntheticSequence:
    """Frames of a scene as a `threedvc.frames.sequence.FrameSequence`, without touching the disk.

    Parameters
    ----------
    scene
        What to show, see `threedvc.synthesis.make_scene`.
    noise
        ``ideal``: exact depth rounded to millimeters; ``kinect``: the model of `threedvc.synthesis.noise`.
    seed
        Seed of the sensor's noise; each frame has its own stream, so their order does not matter.
    threads
        Number of threads, or None for one per processor; frames do not depend on it.

    Raises
    ------
    ConfigError
        If the noise is not known or the seed is negative.
    """

    def __init__(
        self, scene: Scene, noise: Noise | str = Noise.IDEAL, seed: int = 0, threads: int | None = None
    ) -> None:
        if noise not in list(Noise):
            raise ConfigError(f"there is no noise {str(noise)!r}; choose one of {', '.join(Noise)}")
        if seed < 0:
            raise ConfigError(f"seed {seed} must not be negative")
        self.scene = scene
        self._noise = Noise(noise)
        self._seed = seed
        self._renderer = SceneRenderer(scene, threads)

    @property
    def info(self) -> SequenceInfo:
        """What holds for every frame."""
        return SequenceInfo(
            name=self.scene.name,
            rig=self.scene.rig,
            depth_scale=DEPTH_SCALE,
            fps=self.scene.fps,
            frame_count=self.scene.frame_count,
            gray=self.scene.gray,
            has_camera_poses=self.scene.camera_moves,
            has_object_poses=bool(self.scene.bodies),
            has_masks=bool(self.scene.bodies),
        )

    def __len__(self) -> int:
        """Return the number of frames."""
        return self.scene.frame_count

    def __getitem__(self, index: int) -> Frame:
        """Render frame `index`; negative ones count from the end.

        Raises
        ------
        IndexError
            If there is no such frame.
        """
        if not -len(self) <= index < len(self):
            raise IndexError(f"frame {index} is not within the {len(self)} frames of scene {self.scene.name}")
        index %= len(self)
        picture = self._renderer.picture(index)
        return Frame(
            index=index,
            timestamp_ns=round(Fraction(index * NANOSECONDS) / Fraction(self.scene.fps)),
            color=picture.color,
            depth=quantized_depth(self._measured(index, picture), DEPTH_SCALE),
            mask=picture.labels if self.scene.bodies else None,
            T_world_camera=self.scene.T_world_camera[index] if self.scene.camera_moves else None,
            T_camera_object=self.scene.object_poses(index),
        )

    def __iter__(self) -> Iterator[Frame]:
        """Render all frames in order."""
        return (self[index] for index in range(len(self)))

    def picture(self, index: int) -> Picture:
        """Return frame `index` as it is, with exact depth, for evaluation."""
        return self._renderer.picture(index)

    def _measured(self, index: int, picture: Picture) -> NDArray[np.float64]:
        if self._noise is Noise.IDEAL:
            return picture.depth
        hidden = self._renderer.hidden_from(index, picture.depth, np.array(KINECT_PROJECTOR_M))
        return kinect_depth(picture.depth, hidden, np.random.default_rng([self._seed, index]))


def mounted_sequences(
    scene: Scene, count: int, noise: Noise | str = Noise.IDEAL, seed: int = 0, threads: int | None = None
) -> list[tuple[SyntheticSequence, Pose]]:
    """Return what several sensors that are mounted together see of a scene, and the pose T_first_sensor of each.

    They stand side by side and look more and more to the right. The parameters are those of `SyntheticSequence`.

    Raises
    ------
    ConfigError
        If there is to be no sensor, or as `SyntheticSequence` does.
    """
    if count < 1:
        raise ConfigError(f"number of sensors {count} must be at least 1")
    result = []
    for number in range(count):
        turn = rotation_from_vector(np.array([0.0, SENSOR_TURN_RAD * number, 0.0]))
        T = make_pose(turn, np.array([SENSOR_SHIFT_M * number, 0.0, 0.0]))
        result.append((SyntheticSequence(scene.seen_from(T), noise, seed + number, threads), T))
    return result
