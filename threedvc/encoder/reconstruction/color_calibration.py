# SPDX-License-Identifier: MIT
"""Calibration of the color camera against the depth camera from the recording itself.

Data sets often come with one set of intrinsics for both cameras and pictures that are not registered. A
surface point that many frames see has one color, so the right color camera is the one in which the lumas
that the frames show at a point agree best. Focal length, the first radial coefficient and the extrinsic, whose
turn serves for the principal point too, are found by Gauss-Newton steps from coarse to fine; the luma of each
point and the exposure of each frame are eliminated by subtracting means.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from threedvc.arrays import Doubles
from threedvc.encoder.fusion.surface_extraction import extract_surface
from threedvc.encoder.reconstruction.scene import Scene
from threedvc.frames.frame import Frame, SequenceInfo
from threedvc.frames.sequence import FrameSequence
from threedvc.geometry.camera import Camera, CameraRig
from threedvc.geometry.pose import Pose, make_pose, rotation_from_vector

__all__ = ["Sighting", "calibrate", "calibrate_color_cameras", "sighting"]

BLURS_PX = (6.0, 3.0, 1.5)
"""Of the pictures, coarse to fine: an offset of some pixels lies within the first, the last keeps what is sharp."""
STEPS = 8
"""Gauss-Newton steps at each blur: what has not converged by then does not."""
CONVERGED = 2e-4
"""Change of each parameter below which no other step is taken: a tenth of a pixel of a focal length of 500."""
MIN_SIGHTS = 4
"""Frames that must see a point, and that are needed at all: the scatter of fewer lumas tells little."""
MIN_POINTS = 300
"""Seen so often: nearly forty for each of the eight unknowns."""
MIN_GAIN = 0.1
"""Share by which lumas must agree better (decision 0005): another camera has to be worth its bytes."""
MIN_DISPLACEMENT_PX = 1.0
"""By which another camera must move points (decision 0005): less is not seen."""
MIN_TRAVEL = 0.05
"""Slopes by which points wander over the picture, 26 pixels of a focal length of 525: a camera at rest agrees with any
calibration (decision 0005)."""
MAX_SPREADS = 4.0
"""Prior deviations beyond which a result is implausible: it explains something else."""
AGREEMENT = 0.015
"""Share of its depth by which a measurement may miss a point that it confirms: noise and poses of the first pass."""
OUTLIER_LEVELS = 40.0
"""Levels at which a luma has a quarter of its weight: glints and outlines, not noise."""
SPREAD = np.array([0.1, 0.1, 0.01, 0.01, 0.01, 0.02, 0.02, 0.02])
"""Prior deviation of the relative focal length, k1, the rotation (rad) and the translation (m): about what mountings
and lenses of such sensors differ by."""
STEP_SIZE = 1e-3
"""Of the differences that stand for slopes: a pixel or less, within what the pictures are blurred by."""
SAMPLES_PER_WITNESS = 50
"""Neighboring samples are not independent; so many of them count as one against the prior."""


CALIBRATION_FRAMES = 40
"""About so many of each sensor, spread over the recording; the time goes with their number."""
CALIBRATION_POINTS = 5000
"""Of the surface, at random: with so many the lumas outvote the prior, and all would take longer."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Sighting:
    """Surface points as one frame sees them.

    Attributes
    ----------
    points
        (n, 3) float64 in the depth camera; the same points in every sighting.
    seen
        (n,) whether the frame's depth confirms the point.
    luma
        (h, w) float32 luma of the color picture.
    """

    points: Doubles
    seen: NDArray[np.bool_]
    luma: NDArray[np.float32]


def sighting(points: Doubles, frame: Frame, T_camera_object: Pose, depth_camera: Camera) -> Sighting:
    """Place surface points (n, 3) of an object in a frame and tell which of them it sees."""
    there = points @ T_camera_object[:3, :3].T + T_camera_object[:3, 3]
    ahead = there[:, 2] > 0.05
    pixels = np.zeros((len(there), 2))
    pixels[ahead] = depth_camera.project(there[ahead])
    columns, rows = np.rint(pixels).astype(np.int64).T
    inside = ahead & (columns >= 0) & (rows >= 0) & (columns < depth_camera.width) & (rows < depth_camera.height)
    seen = inside.copy()
    reading = frame.depth[rows[inside], columns[inside]]
    seen[inside] = np.abs(reading - there[inside, 2]) < AGREEMENT * there[inside, 2]
    return Sighting(points=there, seen=seen, luma=cv2.cvtColor(frame.color, cv2.COLOR_RGB2GRAY).astype(np.float32))


def calibrate(rig: CameraRig, sightings: Sequence[Sighting]) -> CameraRig | None:
    """Find the rig in which the sightings agree best.

    Returns
    -------
    CameraRig or None
        None where there is too little to go by, as before a camera at rest; where the lumas agree less
        than 10 % better than with `rig`; where points move by less than a pixel; or where the change is
        implausible.
    """
    if (
        len(sightings) < MIN_SIGHTS
        or _travel(sightings) < MIN_TRAVEL
        or np.count_nonzero(sum(s.seen.astype(int) for s in sightings) >= MIN_SIGHTS) < MIN_POINTS
    ):
        return None
    found = np.zeros(len(SPREAD))
    for blur in BLURS_PX:
        pictures = [np.asarray(cv2.GaussianBlur(s.luma, (0, 0), blur), dtype=np.float32) for s in sightings]
        found = _refined(found, rig, sightings, pictures)
    before, after = _disagreement(np.zeros_like(found), found, rig, sightings, pictures)
    if np.any(np.abs(found) > MAX_SPREADS * SPREAD):
        return None
    better = _changed(rig, found)
    matters = max(_displacement(rig, better, s) for s in sightings) >= MIN_DISPLACEMENT_PX
    return better if matters and after < (1 - MIN_GAIN) * before else None


def _travel(sightings: Sequence[Sighting]) -> float:
    """Return how far points wander over the picture, as slopes; a camera at rest tells nothing."""
    slopes = np.array([np.where(s.seen[:, None], s.points[:, :2] / s.points[:, 2:], np.nan) for s in sightings])
    often = np.count_nonzero(np.isfinite(slopes[..., 0]), axis=0) >= MIN_SIGHTS
    if not often.any():
        return 0.0
    return float(np.median(np.nanstd(slopes[:, often], axis=0)))


def _displacement(rig: CameraRig, other: CameraRig, seen: Sighting) -> float:
    """Return the median displacement in pixels of the points of a sighting from one rig to another."""
    points = seen.points[seen.seen]
    if not len(points):
        return 0.0
    before, after = (_pixels(each, points) for each in (rig, other))
    return float(np.median(np.linalg.norm(after - before, axis=1)))


def _pixels(rig: CameraRig, points: Doubles) -> Doubles:
    moved = points @ rig.T_color_depth[:3, :3].T + rig.T_color_depth[:3, 3]
    return rig.color.project(np.where(moved[:, 2:] > 0.05, moved, np.array([0.0, 0.0, 1.0])))


def _changed(rig: CameraRig, change: Doubles) -> CameraRig:
    """Apply (log of the focal length, k1, rotation, translation) to a rig."""
    camera = rig.color
    k1, k2, p1, p2, k3 = camera.distortion
    color = replace(
        camera,
        fx=camera.fx * float(np.exp(change[0])),
        fy=camera.fy * float(np.exp(change[0])),
        distortion=(k1 + float(change[1]), k2, p1, p2, k3),
    )
    T = make_pose(rotation_from_vector(change[2:5]), change[5:8]) @ rig.T_color_depth
    return replace(rig, color=color, T_color_depth=T)


def _lumas(
    change: Doubles, rig: CameraRig, sightings: Sequence[Sighting], pictures: Sequence[NDArray[np.float32]]
) -> Doubles:
    """Return the luma (frames, points) at which each frame shows each point; NaN where it does not."""
    moved = _changed(rig, change)
    T = moved.T_color_depth
    rows = []
    for seen, picture in zip(sightings, pictures, strict=True):
        points = seen.points @ T[:3, :3].T + T[:3, 3]
        valid = seen.seen & (points[:, 2] > 0.05)
        points = np.where(valid[:, None], points, np.array([0.0, 0.0, 1.0]))
        pixels = moved.color.project(points).astype(np.float32)
        luma = cv2.remap(
            picture, pixels[None, :, 0], pixels[None, :, 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT,
            borderValue=float("nan"),
        )[0]  # fmt: skip
        rows.append(np.where(valid, luma, np.nan))
    return np.array(rows, dtype=np.float64)


def _centered(lumas: Doubles, used: NDArray[np.bool_]) -> Doubles:
    """Subtract the mean of every frame and of every point; 0 where not used."""
    values = np.where(used, lumas, 0.0)
    for _ in range(2):
        for axis in (1, 0):
            counts = np.maximum(used.sum(axis=axis, keepdims=True), 1)
            values = np.where(used, values - values.sum(axis=axis, keepdims=True) / counts, 0.0)
    return values


def _used(*lumas: Doubles) -> NDArray[np.bool_]:
    known = np.all([np.isfinite(luma) for luma in lumas], axis=0)
    often = np.count_nonzero(known, axis=0) >= MIN_SIGHTS
    return np.asarray(known & often, dtype=np.bool_)


def _refined(
    start: Doubles, rig: CameraRig, sightings: Sequence[Sighting], pictures: Sequence[NDArray[np.float32]]
) -> Doubles:
    change = start
    damping = 1e-3
    for _ in range(STEPS):
        base = _lumas(change, rig, sightings, pictures)
        ahead = [_lumas(change + step, rig, sightings, pictures) for step in STEP_SIZE * np.eye(len(change))]
        used = _used(base, *ahead)
        residual = _centered(base, used)
        weight = used / (1 + (residual / OUTLIER_LEVELS) ** 2) ** 2
        weight /= SAMPLES_PER_WITNESS * max(float(np.sum(weight * residual**2) / np.sum(weight)), 1.0)
        slopes = [_centered(luma - base, used) / STEP_SIZE for luma in ahead]
        matrix = np.array([[np.sum(weight * a * b) for b in slopes] for a in slopes]) + np.diag(1 / SPREAD**2)
        side = np.array([np.sum(weight * a * residual) for a in slopes]) + change / SPREAD**2
        step = -np.linalg.solve(matrix + damping * np.diag(np.diag(matrix)), side)
        before, after = _disagreement(change, change + step, rig, sightings, pictures)
        if after < before:
            change, damping = change + step, damping / 4
        else:
            damping *= 16
        if np.abs(step).max() < CONVERGED:
            break
    return change


def _disagreement(
    a: Doubles, b: Doubles, rig: CameraRig, sightings: Sequence[Sighting], pictures: Sequence[NDArray[np.float32]]
) -> tuple[float, float]:
    """Return how far the lumas of one point scatter against those of all, for two changes, where both see.

    The scatter alone would prefer whatever looks at the least texture.
    """
    lumas = [_lumas(change, rig, sightings, pictures) for change in (a, b)]
    used = _used(*lumas)
    ratios = []
    for luma in lumas:
        within = np.minimum(_centered(luma, used)[used] ** 2, OUTLIER_LEVELS**2)
        among = np.var(luma[used])
        ratios.append(float(np.sqrt(within.mean() / max(among, 1.0))))
    return ratios[0], ratios[1]


def calibrate_color_cameras(scene: Scene, frames: FrameSequence) -> SequenceInfo | None:
    """Calibrate the color cameras on the background; None where all present ones are as good.

    Objects that move before a camera at rest change their shade as they turn, which would be taken for
    a wrong camera.
    """
    item = scene.objects[0]
    surface = extract_surface(item.evidence, scene.config.threads)
    points = np.asarray((surface.cells + 0.5) * item.evidence.voxel_size_m, dtype=np.float64)
    chosen = np.random.default_rng(0).permutation(len(points))[:CALIBRATION_POINTS]
    found, rigs = [], scene.info.rigs
    for sensor, rig in enumerate(rigs):
        own = [frame for frame in range(len(frames)) if scene.records[frame].sensor == sensor]
        sightings = []
        for frame in own[:: max(1, len(own) // CALIBRATION_FRAMES)]:
            at = item.found[frame]
            if at is not None and at.usable:
                T_camera_object = rig.at_sensor(at.T_camera_object)
                sightings.append(
                    sighting(points[chosen], scene.with_depth_limit(frames[frame]), T_camera_object, rig.depth)
                )
        found.append(calibrate(rig, sightings))
    if not any(found):
        return None
    return scene.info.with_rigs([better or rig for better, rig in zip(found, rigs, strict=True)])
