# SPDX-License-Identifier: MIT
"""Pictures of an object that a lost pose is found again by.

A keyframe keeps features of a colour picture and the points of the object that they show. Features of another
picture that match them give its pose by perspective from n points, with outliers left out: without any guess, and
without depth. It is good to some pixels, so registration has to confirm it wherever there is depth.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from threedvc.arrays import Doubles
from threedvc.frames.frame import Frame
from threedvc.geometry.camera import CameraRig
from threedvc.geometry.pose import Pose, compose, inverse, make_pose, rotation_angle, rotation_from_vector

__all__ = ["Keyframes", "Sight"]

MAX_FEATURES = 600
FAST_THRESHOLD = 7
BORDER = 16
PICTURE_SIDE = 640
RASTER = 4
LIFTED_SIDE = 320
"""Of wider depth pictures, about so many columns serve to lift features, at least two to a cell of the raster."""
APART_RAD, APART = 0.25, 0.15
"""Keyframes differ by this turn, or by this way in parts of the distance of what they show."""
MAX_KEYFRAMES = 400
MAX_RATIO = 0.8
MIN_MATCHES = 12
REPROJECTION = 0.006
"""Largest distance of a feature from where its point appears, in parts of the picture's width."""
DRAWS = 300
CANDIDATES = 3
THUMBNAIL = (20, 15)
MAX_TRIED = 48
"""Of more keyframes only those are matched whose small pictures are most like the frame's."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Keyframe:
    """Pose before its sensor, points (n, 3) of the object, descriptors (n, 32), distance, small picture."""

    T_camera_object: Pose
    points: Doubles
    descriptors: NDArray[np.uint8]
    distance_m: float
    thumbnail: Doubles


class Sight(NamedTuple):
    """A pose ``T_camera_object`` before the base that features speak for, and how many do."""

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
        self._thin = [_thinning(rig) for rig in rigs]
        self._rays = [rig.depth.rays()[thin] for rig, thin in zip(rigs, self._thin, strict=True)]

    def __len__(self) -> int:
        return len(self._kept)

    def note(self, frame: Frame, mask: NDArray[np.bool_], T_camera_object: Pose) -> None:
        """Keep a frame whose pose is trusted, unless the object was kept from about there before.

        Parameters
        ----------
        frame
            The frame.
        mask
            (h, w) bool pixels of the object in the depth camera.
        T_camera_object
            Its pose before the base.
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

    def find(self, frame: Frame, mask: NDArray[np.bool_] | None = None) -> list[Sight]:
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
            sight
            for kept in self._most_alike(frame)
            if (sight := self._sight(kept, pixels, descriptors, self._rigs[frame.sensor])) is not None
        ]
        return sorted(found, key=lambda sight: -sight.features)[:CANDIDATES]

    def _most_alike(self, frame: Frame) -> list[_Keyframe]:
        if len(self._kept) <= MAX_TRIED:
            return self._kept
        seen = _thumbnail(frame)
        return sorted(self._kept, key=lambda kept: -float(seen @ kept.thumbnail))[:MAX_TRIED]

    def _features(self, frame: Frame) -> tuple[Doubles, NDArray[np.uint8]]:
        """Return pixels (n, 2) in the colour camera and descriptors (n, 32)."""
        grey = cv2.cvtColor(frame.color, cv2.COLOR_RGB2GRAY)
        height, width = grey.shape
        scale = max(1, round(max(width, height) / PICTURE_SIDE))
        if scale > 1:
            grey = cv2.resize(grey, (width // scale, height // scale), interpolation=cv2.INTER_AREA)
        border = min(BORDER, min(grey.shape) // 8)
        detector = cv2.ORB.create(MAX_FEATURES, edgeThreshold=border, fastThreshold=FAST_THRESHOLD)
        points, descriptors = detector.detectAndCompute(grey, None)
        if not len(points):
            return np.zeros((0, 2)), np.zeros((0, 32), np.uint8)
        pixels = np.array([point.pt for point in points])
        return (pixels + 0.5) * scale - 0.5, np.asarray(descriptors, dtype=np.uint8)

    def _lift(self, frame: Frame, mask: NDArray[np.bool_], pixels: Doubles) -> tuple[Doubles, NDArray[np.bool_]]:
        """Return the points (n, 3) in the depth camera that colour pixels show, and which of them are the object's."""
        rig, thin = self._rigs[frame.sensor], self._thin[frame.sensor]
        known = frame.depth[thin] > 0
        z = frame.depth[thin][known].astype(np.float64)
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
        found = (number >= 0) & mask[thin][known][number] if len(points) else np.zeros(len(pixels), np.bool_)
        return (points[number] if len(points) else np.zeros((len(pixels), 3))), found

    @staticmethod
    def _sight(kept: _Keyframe, pixels: Doubles, descriptors: NDArray[np.uint8], rig: CameraRig) -> Sight | None:
        matcher = cv2.BFMatcher(cv2.NORM_HAMMING)
        pairs = [pair for pair in matcher.knnMatch(descriptors, kept.descriptors, k=2) if len(pair) == 2]
        clear = [best for best, second in pairs if best.distance < MAX_RATIO * second.distance]
        if len(clear) < MIN_MATCHES:
            return None
        points = kept.points[[match.trainIdx for match in clear]]
        places = pixels[[match.queryIdx for match in clear]]
        camera = rig.color
        parameters = camera.parameters()
        matrix = np.array([[parameters[0], 0, parameters[2]], [0, parameters[1], parameters[3]], [0, 0, 1]])
        try:
            fits, turn, shift, followers = cv2.solvePnPRansac(
                points, places, matrix, parameters[4:9], iterationsCount=DRAWS,
                reprojectionError=REPROJECTION * camera.width, flags=cv2.SOLVEPNP_EPNP,
            )  # fmt: skip
        except cv2.error:  # points that leave the pose open, such as all in one place
            return None
        if not fits or len(followers) < MIN_MATCHES:
            return None
        follow = followers.ravel()
        turn, shift = cv2.solvePnPRefineLM(points[follow], places[follow], matrix, parameters[4:9], turn, shift)
        R = rotation_from_vector(np.asarray(turn, dtype=np.float64).ravel())
        T_color_object = make_pose(R, np.asarray(shift, dtype=np.float64).ravel())
        return Sight(rig.at_base(compose(inverse(rig.T_color_depth), T_color_object)), len(follow))


def _thinning(rig: CameraRig) -> tuple[slice, slice]:
    """Return which rows and columns of a depth picture lift features."""
    columns = slice(
        None, None, max(1, round(min(rig.depth.width / LIFTED_SIDE, RASTER / 2 * rig.depth.fx / rig.color.fx)))
    )
    return columns, columns


def _near(kept: _Keyframe, T_camera_object: Pose) -> bool:
    """Tell whether an object was kept from about the same direction and place."""
    change = T_camera_object @ inverse(kept.T_camera_object)
    centre = np.array([0.0, 0.0, kept.distance_m])
    way = float(np.linalg.norm(change[:3, :3] @ centre + change[:3, 3] - centre))
    return rotation_angle(change) < APART_RAD and way < APART * kept.distance_m


def _thumbnail(frame: Frame) -> Doubles:
    """Return a small grey picture as a vector of mean 0 and length 1, so that exposure does not matter."""
    small = cv2.resize(cv2.cvtColor(frame.color, cv2.COLOR_RGB2GRAY), THUMBNAIL, interpolation=cv2.INTER_AREA)
    values = small.astype(np.float64).ravel()
    values -= values.mean()
    return np.asarray(values / max(float(np.linalg.norm(values)), 1e-9))
