# SPDX-License-Identifier: MIT
"""Registration of two frames of one sensor with each other, without a model."""

from __future__ import annotations

import numpy as np

from threedvc.arrays import Doubles, Mask
from threedvc.config import Sensor
from threedvc.encoder.registration.frame_resolutions import Downsampled
from threedvc.encoder.registration.registration import (
    DepthSample,
    RegistrationConfig,
    RegistrationProblem,
    register,
    view_of_frame,
)
from threedvc.frames.frame import Frame
from threedvc.frames.sensor_model import chosen_sensor
from threedvc.geometry.camera import CameraRig
from threedvc.geometry.pose import Pose, identity
from threedvc.stream.pose_status import PoseStatus

__all__ = ["PairRegistration", "unlabeled_pixels"]

POINTS = 3000
"""Points of a frame: shares of them are told to a percent."""
LUMA_WEIGHT = 0.3
"""Color helps where depth is plain, but is perhaps not where the cameras say."""
SHORT = RegistrationConfig(samples=POINTS, luma_weight=LUMA_WEIGHT)


class PairRegistration:
    """Registers frames of one sensor with each other, from their depth and luma alone.

    Labeled pixels are left out, for what they show may move.

    Parameters
    ----------
    rig
        Cameras of the frames.
    threads
        Number of threads.
    """

    def __init__(self, rig: CameraRig, threads: int = 1) -> None:
        self.rig, self._threads = rig, threads
        self._resolution = Downsampled(rig)
        self._rays = rig.depth.rays()

    def points(self, frame: Frame) -> Doubles:
        """Return at most `POINTS` measured points (n, 3) in the depth camera, meters."""
        places = np.flatnonzero((frame.depth > 0) & unlabeled_pixels(frame))
        places = places[np.linspace(0, len(places) - 1, min(POINTS, len(places))).astype(int)]
        z = frame.depth.reshape(-1)[places].astype(np.float64)
        return np.column_stack([self._rays.reshape(-1, 2)[places] * z[:, None], z])

    def motion(self, first: Frame, second: Frame) -> Pose | None:
        """Return T_second_first, None where the frames do not tell."""
        if not (first.depth.any() and second.depth.any()):
            return None
        problem = RegistrationProblem(
            sample=self._sample(second),
            view=view_of_frame(self._sample(first), identity(), threads=self._threads),
            sigma_m=chosen_sensor(Sensor.AUTO, first.depth).sigma_m,
            config=SHORT,
            threads=self._threads,
        )
        found = register(problem, identity())
        return found.T_camera_object if found.status is PoseStatus.TRACKED else None

    def _sample(self, frame: Frame) -> DepthSample:
        """Return what every n-th pixel of a frame shows of the background."""
        only = self._resolution
        return DepthSample(
            depth=only.downsample(frame.depth),
            luma=only.luma(frame),
            mask=only.downsample(unlabeled_pixels(frame)),
            camera=only.camera,
        )


def unlabeled_pixels(frame: Frame) -> Mask:
    """Return which pixels (h, w) may be taken for the background: labeled things may move."""
    return np.ones(frame.depth.shape, dtype=bool) if frame.mask is None else frame.mask == 0
