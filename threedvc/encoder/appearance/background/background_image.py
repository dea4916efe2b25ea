# SPDX-License-Identifier: MIT
"""The picture of a background at rest before a camera at rest (a backdrop), taken from all frames."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import cv2
import numpy as np
from numpy.typing import NDArray

from threedvc.arrays import Doubles, Floats, Mask
from threedvc.coding.video.planes import VideoFormat
from threedvc.coding.video.still import STILL_BITS, CodedStill, decode_still, encode_still
from threedvc.config import RenderConfig
from threedvc.encoder.appearance.background.robust_mean import Observations, robust_mean
from threedvc.encoder.appearance.color_field import ColorField
from threedvc.frames.frame import Frame
from threedvc.geometry.camera import CameraRig
from threedvc.geometry.pose import Pose, compose
from threedvc.render.hole_filling import fill_unknown
from threedvc.render.ray_grid import RayGrid
from threedvc.render.renderer import Renderer

__all__ = ["BackgroundImageCandidates", "averaged_background"]

MARGIN_PX = 2
"""About objects: outlines that are drawn are a pixel or two from those that are seen."""
OUTLIER_LEVELS = 24.0
"""Something that passes is further from the mean than this; the noise and the shades of a color are nearer."""
MIN_WEIGHT = 1e-9
"""Of a pixel that some frame shows; only saves from dividing by zero."""
MIN_CRF, MAX_CRF = 4, 68
"""Quantization of AV1 from 1 to 70; beyond these a picture takes bytes for what cannot be seen, or is no longer one."""


class BackgroundImageCandidates:
    """A picture and its codings at different qualities, each made when it is first asked for.

    Parameters
    ----------
    picture
        (h, w, 3) uint8 RGB.
    gray
        Whether to code the luma alone.
    """

    def __init__(self, picture: NDArray[np.uint8], gray: bool) -> None:
        self.picture, self._gray = picture, gray
        self._made: dict[tuple[int, bool], tuple[CodedStill, float]] = {}

    def error(self, shown: NDArray[np.uint8]) -> float:
        """Return the sum over all pixels of the squared error (mean of the channels) of a picture like this one."""
        return float(((shown.astype(np.float64) - self.picture) ** 2).mean(axis=2).sum())

    def best(self, price: float) -> tuple[CodedStill, float]:
        """Return the coded picture whose squared error plus `price` for every byte is about least, and that sum."""
        low, high = MIN_CRF, MAX_CRF
        while high - low > 2:
            third = (high - low) // 3
            if self._cost(low + third, price) <= self._cost(high - third, price):
                high -= third
            else:
                low += third
        crf = min(range(low, high + 1), key=lambda each: self._cost(each, price))
        still, error = self._coded(crf, thorough=True)
        return still, error + price * len(still.payload)

    def _cost(self, crf: int, price: float) -> float:
        still, error = self._coded(crf, thorough=False)
        return error + price * len(still.payload)

    def _coded(self, crf: int, *, thorough: bool) -> tuple[CodedStill, float]:
        key = crf, thorough
        if key not in self._made:
            still = encode_still(self.picture, crf, self._gray, thorough=thorough)
            height, width, _ = self.picture.shape
            video = VideoFormat(width=width, height=height, bits=STILL_BITS, magnified=still.magnified, gray=self._gray)
            self._made[key] = still, self.error(decode_still(still.payload, video))
        return self._made[key]


def averaged_background(
    rig: CameraRig,
    frames: Iterable[tuple[Frame, Mapping[int, Pose], Floats, Floats]],
    field: ColorField,
    threads: int,
) -> NDArray[np.uint8]:
    """Average what the color camera sees where no object is drawn before the background.

    Parameters
    ----------
    rig
        Cameras.
    frames
        Frames, with the poses T_camera_object of their objects, and gain and offset (3,) of the color camera.
    field
        The objects.
    threads
        Number of threads.

    Returns
    -------
    (h, w, 3) uint8 RGB; what no frame shows is interpolated from around.
    """
    rays, renderer = RayGrid(rig.color), Renderer(rig, RenderConfig(supersample=1, threads=threads))

    def clear(poses: Mapping[int, Pose]) -> Mask:
        """Return where no object is drawn (h, w), nor near."""
        in_color = {number: compose(rig.T_color_depth, pose) for number, pose in poses.items()}
        labels = renderer.cast(rays, field.models, in_color)[1].reshape(rig.color.height, rig.color.width)
        near = cv2.dilate((labels > 0).astype(np.uint8), np.ones((2 * MARGIN_PX + 1,) * 2, np.uint8))
        return np.asarray(near == 0)

    kept = [(frame.color, clear(poses), gain, offset) for frame, poses, gain, offset in frames]

    def observations() -> Observations:
        return (((color - offset) / gain, shows[..., None].astype(np.float64)) for color, shows, gain, offset in kept)

    mean, weight = robust_mean(observations, _residual, MIN_WEIGHT)
    value, known = mean.astype(np.float32), (weight[..., 0] > 0).astype(np.uint8)
    fill_unknown(value, known)
    return np.asarray(np.clip(np.rint(value), 0, 255), dtype=np.uint8)


def _residual(color: Floats | Doubles, mean: Doubles) -> Doubles:
    return np.asarray(np.abs(color - mean).mean(axis=2, keepdims=True) / OUTLIER_LEVELS)
