# SPDX-License-Identifier: MIT
"""Pictures of an object that a lost pose is found again by.

A keyframe keeps features of a color picture and the points of the object that they show. Features of another
picture that match them give its pose by perspective from n points, with outliers left out: without any guess, and
without depth. It is good to some pixels, so registration has to confirm it wherever there is depth.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from threedvc.arrays import Doubles, Mask
from threedvc.encoder.registration.feature_matching import Descriptors, detect_features, match_features
from threedvc.frames.frame import Frame
from threedvc.geometry.camera import CameraRig
from threedvc.geometry.pose import Pose, compose, inverse, make_pose, rotation_angle, rotation_from_vector

__all__ = ["Keyframes", "PoseHypothesis"]

MAX_FEATURES = 600
"""Of a whole picture: enough that tens are seen again from elsewhere; each is held against those of every keyframe."""
BORDER = 16
"""Pixels at the border without features: half of what is usual, for small pictures would have none left."""
PICTURE_SIDE = 640
"""Wider pictures are shrunk to about this: features at the pixels of large ones are mostly noise."""
RASTER = 4
"""Side of the cells of color pixels by which depth is looked up: points of half as fine a picture fill them."""
LIFTED_SIDE = 320
"""Of wider depth pictures, about so many columns serve to lift features, at least two to a cell of the raster."""
MIN_TURN_RAD, MIN_SHIFT = 0.25, 0.15
"""Keyframes differ by this turn, or by this shift in parts of the distance of what they show: what lies between two of
them is matched with both."""
MAX_KEYFRAMES = 400
"""Bounds memory: 13 MB, of 600 features with 56 bytes each."""
MIN_MATCHES = 12
"""Fewer matches that agree on a pose may do so by chance: three points with four solutions always agree."""
MAX_REPROJECTION = 0.006
"""Largest distance of a feature from where its point appears, in parts of the picture's width: 4 pixels of 640."""
DRAWS = 300
"""Of five points each: with 0.4 of the matches right, one of them is with a chance of 0.95."""
MAX_HYPOTHESES = 3
"""Poses that registration has to confirm, each at the price of a view and a registration."""
THUMBNAIL = (20, 15)
"""Width and height of the small pictures by which keyframes are compared."""
MAX_TRIED = 48
"""Of more keyframes only those are matched whose small pictures are most like the frame's."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Keyframe:
    """Pose before its sensor, points (n, 3) of the object, descriptors (n, 32), distance, small picture."""

    T_camera_object: Pose
    points: Doubles
    descriptors: Descriptors
    distance_m: float
    thumbnail: Doubles


class PoseHypothesis(NamedTuple):
    """A pose ``T_camera_object`` before the rig that features speak for, and how many do."""

    T_camera_object: Pose
    features: int


class Keyframes:
    """The keyframes of one object.

    Parameters
    ----------
    rigs
        Cameras of every sensor.
    """

    def __init__(self, *rigs: CameraRig) -> None:
        self._rigs = rigs
        self._kept: list[_Keyframe] = []
        self._strides = [_stride_of(rig) for rig in rigs]
        self._rays = [rig.depth.rays()[stride] for rig, stride in zip(rigs, self._strides, strict=True)]

    def __len__(self) -> int:
        return len(self._kept)

    def add(self, frame: Frame, mask: Mask, T_camera_object: Pose) -> None:
        """Keep a frame whose pose is trusted, unless the object was kept from about there before.

        Parameters
        ----------
        frame
            The frame.
        mask
            (h, w) bool pixels of the object in the depth camera.
        T_camera_object
            Its pose before the rig.
        """
        T_camera_object = self._rigs[frame.sensor].at_sensor(T_camera_object)
        if len(self._kept) >= MAX_KEYFRAMES or any(_near(kept, T_camera_object) for kept in self._kept):
            return
        pixels, descriptors = self._features(frame)
        if not len(pixels):
            return
        points, lifted = self._lift(frame, mask, pixels)
        if np.count_nonzero(lifted) < MIN_MATCHES:
            return
        T = inverse(T_camera_object)
        self._kept.append(
            _Keyframe(
                T_camera_object=T_camera_object,
                points=points[lifted] @ T[:3, :3].T + T[:3, 3],
                descriptors=descriptors[lifted],
                distance_m=float(np.median(points[lifted][:, 2])),
                thumbnail=_thumbnail(frame),
            )
        )

    def query(self, frame: Frame, mask: Mask | None = None) -> list[PoseHypothesis]:
        """Return poses at which features of a frame match keyframes, the one with most of them first.

        Parameters
        ----------
        frame
            The frame; its depth is not needed.
        mask
            (h, w) bool pixels of the depth camera to which features are limited; None: all of the picture.
        """
        pixels, descriptors = self._features(frame)
        if mask is not None and len(pixels):
            _, lifted = self._lift(frame, mask, pixels)
            pixels, descriptors = pixels[lifted], descriptors[lifted]
        if len(pixels) < MIN_MATCHES:
            return []
        found = [
            hypothesis
            for kept in self._most_alike(frame)
            if (hypothesis := self._hypothesis(kept, pixels, descriptors, self._rigs[frame.sensor])) is not None
        ]
        return sorted(found, key=lambda hypothesis: -hypothesis.features)[:MAX_HYPOTHESES]

    def _most_alike(self, frame: Frame) -> list[_Keyframe]:
        if len(self._kept) <= MAX_TRIED:
            return self._kept
        seen = _thumbnail(frame)
        return sorted(self._kept, key=lambda kept: -float(seen @ kept.thumbnail))[:MAX_TRIED]

    def _features(self, frame: Frame) -> tuple[Doubles, Descriptors]:
        """Return pixels (n, 2) in the color camera and descriptors (n, 32)."""
        gray = np.asarray(cv2.cvtColor(frame.color, cv2.COLOR_RGB2GRAY), dtype=np.uint8)
        height, width = gray.shape
        scale = max(1, round(max(width, height) / PICTURE_SIDE))
        if scale > 1:
            small = width // scale, height // scale
            gray = np.asarray(cv2.resize(gray, small, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        border = min(BORDER, min(gray.shape) // 8)
        pixels, descriptors = detect_features(gray, MAX_FEATURES, border)
        return (pixels + 0.5) * scale - 0.5, descriptors

    def _lift(self, frame: Frame, mask: Mask, pixels: Doubles) -> tuple[Doubles, Mask]:
        """Return the points (n, 3) in the depth camera that color pixels show, and which of them are the object's."""
        rig, stride = self._rigs[frame.sensor], self._strides[frame.sensor]
        known = frame.depth[stride] > 0
        z = frame.depth[stride][known].astype(np.float64)
        points = np.column_stack([self._rays[frame.sensor][known] * z[:, None], z])
        T = rig.T_color_depth
        moved = points @ T[:3, :3].T + T[:3, 3]
        ahead = moved[:, 2] > 0
        places = np.full((len(points), 2), -1.0)
        places[ahead] = rig.color.project(moved[ahead])
        cells = np.floor((places + 0.5) / RASTER).astype(np.int64)
        shape = (-(-rig.color.height // RASTER), -(-rig.color.width // RASTER))
        inside = (cells >= 0).all(axis=1) & (cells[:, 0] < shape[1]) & (cells[:, 1] < shape[0]) & ahead
        raster = np.full(shape, -1, dtype=np.int64)
        order = np.flatnonzero(inside)[np.argsort(-moved[inside, 2], kind="stable")]
        raster[cells[order, 1], cells[order, 0]] = order
        own = np.floor((pixels + 0.5) / RASTER).astype(np.int64)
        number = raster[np.clip(own[:, 1], 0, shape[0] - 1), np.clip(own[:, 0], 0, shape[1] - 1)]
        found = (number >= 0) & mask[stride][known][number] if len(points) else np.zeros(len(pixels), np.bool_)
        return (points[number] if len(points) else np.zeros((len(pixels), 3))), found

    @staticmethod
    def _hypothesis(
        kept: _Keyframe, pixels: Doubles, descriptors: Descriptors, rig: CameraRig
    ) -> PoseHypothesis | None:
        """Return the pose that matches with a keyframe speak for (EPnP in RANSAC); None where too few agree."""
        query, train = match_features(descriptors, kept.descriptors)
        if len(query) < MIN_MATCHES:
            return None
        points, places, camera = kept.points[train], pixels[query], rig.color
        parameters = camera.parameters()
        matrix = np.array([[parameters[0], 0, parameters[2]], [0, parameters[1], parameters[3]], [0, 0, 1]])
        try:
            fits, turn, shift, followers = cv2.solvePnPRansac(
                points, places, matrix, parameters[4:9], iterationsCount=DRAWS,
                reprojectionError=MAX_REPROJECTION * camera.width, flags=cv2.SOLVEPNP_EPNP,
            )  # fmt: skip
        except cv2.error:  # points that leave the pose open, such as all in one place
            return None
        if not fits or len(followers) < MIN_MATCHES:
            return None
        follow = followers.ravel()
        turn, shift = cv2.solvePnPRefineLM(points[follow], places[follow], matrix, parameters[4:9], turn, shift)
        R = rotation_from_vector(np.asarray(turn, dtype=np.float64).ravel())
        T_color_object = make_pose(R, np.asarray(shift, dtype=np.float64).ravel())
        return PoseHypothesis(rig.at_rig(compose(inverse(rig.T_color_depth), T_color_object)), len(follow))


def _stride_of(rig: CameraRig) -> tuple[slice, slice]:
    """Return which rows and columns of a depth picture lift features."""
    columns = slice(
        None, None, max(1, round(min(rig.depth.width / LIFTED_SIDE, RASTER / 2 * rig.depth.fx / rig.color.fx)))
    )
    return columns, columns


def _near(kept: _Keyframe, T_camera_object: Pose) -> bool:
    """Tell whether an object was kept from about the same direction and place."""
    change = T_camera_object @ inverse(kept.T_camera_object)
    center = np.array([0.0, 0.0, kept.distance_m])
    displacement = float(np.linalg.norm(change[:3, :3] @ center + change[:3, 3] - center))
    return rotation_angle(change) < MIN_TURN_RAD and displacement < MIN_SHIFT * kept.distance_m


def _thumbnail(frame: Frame) -> Doubles:
    """Return a small gray picture as a vector of mean 0 and length 1, so that exposure does not matter."""
    small = cv2.resize(cv2.cvtColor(frame.color, cv2.COLOR_RGB2GRAY), THUMBNAIL, interpolation=cv2.INTER_AREA)
    values = small.astype(np.float64).ravel()
    values -= values.mean()
    return np.asarray(values / max(float(np.linalg.norm(values)), 1e-9))
