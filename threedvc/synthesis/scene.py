# SPDX-License-Identifier: MIT
"""What a synthetic sequence shows: bodies with motion scripts, lights, and cameras with their path."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from threedvc.errors import ConfigError
from threedvc.geometry.camera import CameraRig
from threedvc.geometry.pose import Pose, inverse
from threedvc.synthesis.shapes import Part

__all__ = ["Body", "Light", "Scene"]

MAX_LABEL = 255
"""8-bit masks have no larger ones."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Body:
    """Parts that move as one.

    Attributes
    ----------
    label
        Label in the masks, 1..255; 0 belongs to the background.
    parts
        Textured shapes in the frame of the body.
    T_world_body
        (frames, 4, 4) motion script.
    """

    label: int
    parts: tuple[Part, ...]
    T_world_body: NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Light:
    """A point light fixed in the room, without fall-off: place in meters and strength."""

    position: tuple[float, float, float]
    strength: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """Everything that a synthetic sequence shows.

    Attributes
    ----------
    name
        Name for messages and reports.
    rig
        Cameras.
    background
        Parts that stand still, in world coordinates (meters, z up).
    bodies
        Things that move; `Body.label` differs.
    T_world_camera
        (frames, 4, 4) path of the depth camera.
    camera_moves
        Whether the frames tell the pose of the camera; a fixed camera has none.
    lights
        Lights; the first one casts the shadows of the background.
    ambient
        Strength of the light from everywhere.
    fps
        Frame rate.
    gray
        Whether the pictures have one channel.

    Raises
    ------
    ConfigError
        If a script's length or a label does not fit.
    """

    name: str
    rig: CameraRig
    background: tuple[Part, ...]
    bodies: tuple[Body, ...]
    T_world_camera: NDArray[np.float64]
    camera_moves: bool
    lights: tuple[Light, ...]
    ambient: float = 0.40
    fps: float = 30.0
    gray: bool = False

    def __post_init__(self) -> None:
        labels = [body.label for body in self.bodies]
        if len(set(labels)) != len(labels) or any(not 1 <= label <= MAX_LABEL for label in labels):
            raise ConfigError(f"labels {labels} of a scene must differ and lie within 1..{MAX_LABEL}")
        if any(len(body.T_world_body) != self.frame_count for body in self.bodies):
            raise ConfigError(f"every motion script must have {self.frame_count} frames, like the camera's path")

    @property
    def frame_count(self) -> int:
        """Number of frames."""
        return len(self.T_world_camera)

    def seen_from(self, T_camera_sensor: Pose) -> Scene:
        """Return what another sensor sees that is mounted on the camera at a pose of its depth camera."""
        return replace(self, T_world_camera=self.T_world_camera @ T_camera_sensor)

    def object_poses(self, index: int) -> dict[int, Pose]:
        """Return T_camera_object of every body by its label, in the depth camera."""
        T_camera_world = inverse(self.T_world_camera[index])
        return {body.label: T_camera_world @ body.T_world_body[index] for body in self.bodies}
