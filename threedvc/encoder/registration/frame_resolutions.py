# SPDX-License-Identifier: MIT
"""A frame at the resolutions that registration needs: all its pixels for small objects, some for large ones."""

from __future__ import annotations

from typing import NamedTuple, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from threedvc.arrays import Floats, Mask
from threedvc.encoder.registration.registration_types import DepthSample
from threedvc.frames.frame import Frame
from threedvc.geometry.camera import Camera, CameraRig
from threedvc.render.ray_grid import RayGrid
from threedvc.units import LUMA_WEIGHTS

__all__ = ["TRACKING_PIXELS", "Downsampled", "FrameResolutions", "ObjectView"]

TRACKING_PIXELS = 120_000
"""Pixels of a whole picture that are enough to track as well as by all of them: many times the samples of a
registration."""
SMALL_OBJECT_PIXELS = 60_000
"""An object of no more pixels is taken with all of them."""
SPARSE_PIXELS = 40_000
"""From so many on, views are cast with fewer rays: below, casting all costs little, and outlines are exact."""
MIN_Z_M = 0.01
"""Points nearer to the color camera than this, or behind it, are not looked up in its picture."""
Scalar = TypeVar("Scalar", bound=np.generic)
LUMA = np.array(LUMA_WEIGHTS, dtype=np.float32)


class Downsampled:
    """A frame's depth, luma and masks at every n-th pixel.

    Parameters
    ----------
    rig
        Cameras of the frames.
    stride
        n; None: so that a whole picture keeps enough pixels to track as well as all of them.
    sparse
        Whether views are cast with fewer rays where surfaces are even; outlines are less exact. None: if there are
        many pixels.
    flat
        Whether views show surfaces at a flat angle too, whose place and normal are less sure: of use to tell where
        something is, not to register with.
    """

    def __init__(
        self, rig: CameraRig, stride: int | None = None, *, sparse: bool | None = None, flat: bool = False
    ) -> None:
        self.rig, self.flat = rig, flat
        full = rig.depth
        self.stride = stride or 1
        while stride is None and full.width * full.height > TRACKING_PIXELS * self.stride**2:
            self.stride += 1
        self.camera: Camera = full.every(self.stride)
        self.grid = RayGrid(self.camera, apart=True)
        places = np.arange(self.camera.width * self.camera.height)
        even = (places // self.camera.width | places % self.camera.width) % 2 == 0
        if not (len(places) >= SPARSE_PIXELS if sparse is None else sparse):
            even[:] = True
        self.even, self.between = self.grid.order[even[self.grid.order]], self.grid.order[~even[self.grid.order]]
        self._slopes = full.rays()

    def downsample(self, picture: NDArray[Scalar]) -> NDArray[Scalar]:
        """Return every n-th pixel of a picture of the depth camera."""
        return np.ascontiguousarray(picture[:: self.stride, :: self.stride])

    def luma(self, frame: Frame) -> Floats:
        """Return the luma (h, w) seen at the n-th depth pixels, NaN where it is not known."""
        luma: Floats = frame.color.astype(np.float32) @ LUMA
        if self.stride > 1:
            luma = np.asarray(cv2.blur(luma, (self.stride, self.stride)), dtype=np.float32)
        if self.rig.registered:
            return np.asarray(self.downsample(luma), dtype=np.float32)
        return self._warped(luma, frame.depth)

    def _warped(self, luma: Floats, depth: Floats) -> Floats:
        """Look the luma up where the depth camera's points appear in the color camera."""
        z = np.asarray(self.downsample(depth), dtype=np.float64)
        slopes = self._slopes[:: self.stride, :: self.stride]
        points = np.concatenate([slopes * z[..., None], z[..., None]], axis=-1)
        T = self.rig.T_color_depth
        moved = points @ T[:3, :3].T + T[:3, 3]
        valid = (z > 0) & (moved[..., 2] > MIN_Z_M)
        moved[~valid] = (0.0, 0.0, 1.0)
        pixels = self.rig.color.project(moved).astype(np.float32)
        seen = cv2.remap(
            luma,
            pixels[..., 0],
            pixels[..., 1],
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=float("nan"),
        )
        return np.where(valid, seen, np.float32(np.nan))


class FrameResolutions:
    """A frame at both resolutions, each made when it is first asked for.

    Parameters
    ----------
    frame
        The frame.
    full, downsampled
        All pixels, for small objects; every n-th, for large ones.
    """

    def __init__(self, frame: Frame, full: Downsampled, downsampled: Downsampled) -> None:
        self.frame = frame
        self._full, self._downsampled = full, downsampled
        self._lumas: dict[int, Floats] = {}

    @property
    def rig(self) -> CameraRig:
        """The cameras of the frame."""
        return self._full.rig

    def resolution(self, mask: Mask) -> Downsampled:
        """Return the resolution that suits an object seen at `mask` (h, w)."""
        return self._downsampled if np.count_nonzero(mask) > SMALL_OBJECT_PIXELS else self._full

    def luma(self, resolution: Downsampled) -> Floats:
        """Return the frame's luma at a resolution."""
        if resolution.stride not in self._lumas:
            self._lumas[resolution.stride] = resolution.luma(self.frame)
        return self._lumas[resolution.stride]


class ObjectView(NamedTuple):
    """What one sensor sees of an object: its frame, and the object's pixels (h, w) in the depth camera."""

    views: FrameResolutions
    mask: Mask

    @property
    def frame(self) -> Frame:
        """The frame."""
        return self.views.frame

    @property
    def rig(self) -> CameraRig:
        """The cameras of the sensor."""
        return self.views.rig

    @property
    def resolution(self) -> Downsampled:
        """The resolution that suits the object."""
        return self.views.resolution(self.mask)

    @property
    def sample(self) -> DepthSample:
        """What registration takes of the frame."""
        resolution = self.resolution
        return DepthSample(
            depth=resolution.downsample(self.frame.depth),
            luma=self.views.luma(resolution),
            mask=resolution.downsample(self.mask),
            camera=resolution.camera,
        )

    @property
    def object_depth(self) -> Floats:
        """The object's depth (h, w) in meters at the resolution that suits it; 0 = nothing measured, or not of it."""
        resolution = self.resolution
        mask, depth = resolution.downsample(self.mask), resolution.downsample(self.frame.depth)
        return np.where(mask, depth, np.float32(0))
