# SPDX-License-Identifier: MIT
"""The evidence as seen from a pose, and a frame in the same form: the two sides of registration."""

from __future__ import annotations

from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from threedvc.encoder.fusion.evidence_model import EvidenceModel
from threedvc.encoder.tracking.registration import ModelView
from threedvc.frames.frame import Frame
from threedvc.geometry.camera import Camera, CameraRig
from threedvc.geometry.pose import Pose
from threedvc.kernels.encoder.raycast_evidence import cast_evidence, fill_between
from threedvc.parallel import for_ranges
from threedvc.render.ray_grid import RayGrid, cells_from_camera
from threedvc.units import LUMA_WEIGHTS

__all__ = ["FrameViews", "Thinned", "cast_view", "shown_and_measured"]

TRACKING_PIXELS = 120_000
SMALL_OBJECT_PIXELS = 60_000
SPARSE_PIXELS = 40_000
Scalar = TypeVar("Scalar", bound=np.generic)
LUMA = np.array(LUMA_WEIGHTS, dtype=np.float32)


class Thinned:
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

    def thin(self, picture: NDArray[Scalar]) -> NDArray[Scalar]:
        """Return every n-th pixel of a picture of the depth camera."""
        return np.ascontiguousarray(picture[:: self.stride, :: self.stride])

    def luma(self, frame: Frame) -> NDArray[np.float32]:
        """Return the luma (h, w) seen at the thinned depth pixels, NaN where it is not known."""
        luma: NDArray[np.float32] = frame.color.astype(np.float32) @ LUMA
        if self.stride > 1:
            luma = np.asarray(cv2.blur(luma, (self.stride, self.stride)), dtype=np.float32)
        if self.rig.registered:
            return np.asarray(self.thin(luma), dtype=np.float32)
        return self._warped(luma, frame.depth)

    def _warped(self, luma: NDArray[np.float32], depth: NDArray[np.float32]) -> NDArray[np.float32]:
        """Look the luma up where the depth camera's points appear in the colour camera."""
        z = np.asarray(self.thin(depth), dtype=np.float64)
        slopes = self._slopes[:: self.stride, :: self.stride]
        points = np.concatenate([slopes * z[..., None], z[..., None]], axis=-1)
        T = self.rig.T_color_depth
        moved = points @ T[:3, :3].T + T[:3, 3]
        valid = (z > 0) & (moved[..., 2] > 0.01)
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


class FrameViews:
    """The forms of one frame that registration needs, each made when it is first asked for.

    Parameters
    ----------
    frame
        The frame.
    full, thinned
        All pixels, for small objects; every n-th, for large ones.
    """

    def __init__(self, frame: Frame, full: Thinned, thinned: Thinned) -> None:
        self.frame = frame
        self._full, self._thinned = full, thinned
        self._lumas: dict[int, NDArray[np.float32]] = {}

    @property
    def rig(self) -> CameraRig:
        """The cameras of the frame."""
        return self._full.rig

    def form(self, mask: NDArray[np.bool_]) -> Thinned:
        """Return the form that suits an object seen at `mask` (h, w)."""
        return self._thinned if np.count_nonzero(mask) > SMALL_OBJECT_PIXELS else self._full

    def luma(self, form: Thinned) -> NDArray[np.float32]:
        """Return the frame's luma in a form."""
        if form.stride not in self._lumas:
            self._lumas[form.stride] = form.luma(self.frame)
        return self._lumas[form.stride]


def cast_view(
    model: EvidenceModel, thinned: Thinned, T_camera_object: Pose, threads: int, *, exact: bool = False
) -> ModelView:
    """Cast the evidence at a pose into the thinned depth camera.

    If the form is sparse and the view need not be exact, every other ray of every other row is cast first; between
    four that meet one even surface the rest are interpolated.
    """
    camera, grid = thinned.camera, thinned.grid
    count = camera.width * camera.height
    depth, intensity = np.zeros(count, np.float32), np.zeros(count, np.float32)
    normals, done = np.zeros((count, 3), np.float32), np.zeros(count, np.uint8)
    T = cells_from_camera(T_camera_object, model.voxel_size_m)
    near, far = grid.ranges(model.index, T_camera_object, model.voxel_size_m)

    def cast(numbers: NDArray[np.int64]) -> None:
        def rays(start: int, stop: int) -> None:
            cast_evidence(
                grid.slopes, numbers, start, stop, T, grid.origin, grid.size, near, far, model.voxel_size_m,
                model.index.tables, model.distance.reshape(-1), model.distance_weight.reshape(-1),
                model.color.reshape(-1, 3), model.color_weight.reshape(-1), thinned.flat, depth, normals, intensity,
            )  # fmt: skip

        for_ranges(rays, len(numbers), threads)

    def squares(start: int, stop: int) -> None:
        fill_between(start, stop, camera.width, depth, normals, intensity, done)

    cast(grid.order if exact else thinned.even)
    if len(thinned.between) and not exact:
        for_ranges(squares, (camera.height - 1) // 2, threads)
        cast(thinned.between[done[thinned.between] == 0])
    shape = (camera.height, camera.width)
    return ModelView(
        camera=camera,
        T_camera_object=T_camera_object,
        depth=depth.reshape(shape),
        normals=normals.reshape(*shape, 3),
        intensity=intensity.reshape(shape),
    )


def shown_and_measured(
    model: EvidenceModel,
    views: FrameViews,
    mask: NDArray[np.bool_],
    T_camera_object: Pose,
    threads: int,
    *,
    exact: bool = False,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the depths in metres that the evidence shows at a pose, and what a frame measured within `mask` (h, w).

    Both are of the form that suits the mask; 0 = nothing.
    """
    form = views.form(mask)
    shown = cast_view(model, form, T_camera_object, threads, exact=exact).depth
    return shown, np.where(form.thin(mask), form.thin(views.frame.depth), np.float32(0))
