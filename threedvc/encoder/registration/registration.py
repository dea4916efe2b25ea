# SPDX-License-Identifier: MIT
"""Registration of a depth map with the model as seen from a pose (sec. 2.2).

`register` refines a pose coarse to fine. At every step each sample of the frame is moved into the
view, is associated with what the view shows at its pixel, and gives two residuals: its distance to the
view's surface in sigmas of the sensor (point to plane), and the difference of luma, whose gain and
offset are unknowns too, so that exposure does not matter. Both are weighted by Tukey's function on
measured scales. At the finest level luma is taken against its local mean: an object that turns under
a fixed light changes its shading, not its texture. Where the model is unknown there is no residual, so
the model may be incomplete.

Directions that the residuals do not determine, such as along a plain wall, keep the prediction. The
result says how far it can be trusted. `is_stationary` tells whether an object moved at all.
"""

from __future__ import annotations

import numpy as np

from threedvc.encoder.registration.frame_samples import MAX_JUMP, normal_reach
from threedvc.encoder.registration.icp import Alignment
from threedvc.encoder.registration.registration_types import (
    DepthSample,
    ModelView,
    Registration,
    RegistrationConfig,
    RegistrationProblem,
    Sigma,
    camera_rays,
)
from threedvc.geometry.pose import Pose
from threedvc.kernels.encoder.registration import estimate_normals
from threedvc.parallel import for_ranges
from threedvc.stream.pose_status import PoseStatus

__all__ = [
    "DepthSample",
    "ModelView",
    "Registration",
    "RegistrationConfig",
    "RegistrationProblem",
    "Sigma",
    "is_stationary",
    "register",
    "view_of_frame",
]


def register(problem: RegistrationProblem, T_guess: Pose) -> Registration:
    """Find the pose at which a frame fits the model's view, starting from a guess.

    Parameters
    ----------
    problem
        The frame, the view, and how they are to be registered.
    T_guess
        Predicted ``T_camera_object`` of the frame.
    """
    return Alignment(problem).solve_near(T_guess)


def is_stationary(problem: RegistrationProblem, T_previous: Pose, found: Registration, *, resting: bool) -> bool:
    """Tell whether an object still has its previous pose, so that no pose needs to be sent.

    Below a small displacement it does, above a large one it does not. Between them the previous pose
    is kept unless it fits significantly worse than the found one: the difference of the robust costs
    is taken over blocks of neighboring samples, whose scatter gives its standard error. An object at
    rest needs stronger evidence than a moving one. As poses are found against the model, slow motion
    adds up until it counts: the error stays below ``move_pixels``.

    Parameters
    ----------
    problem
        As in `register`.
    T_previous
        The pose of the frame before.
    found
        The registration of this frame.
    resting
        Whether the object rested in the frame before.
    """
    if found.status is PoseStatus.LOST:
        return False
    config, alignment = problem.config, Alignment(problem)
    displacement = alignment.displacement_pixels(T_previous, found.T_camera_object)
    if displacement <= config.rest_pixels or displacement > config.move_pixels:
        return displacement <= config.rest_pixels
    limit = config.rest_significance if resting else config.move_significance
    return alignment.excess_cost(T_previous, found.T_camera_object) < limit


def view_of_frame(
    sample: DepthSample, T_camera_object: Pose, *, reach: int | None = None, threads: int = 1
) -> ModelView:
    """Make a view from one frame alone: what is known of an object before it has a model.

    Parameters
    ----------
    sample
        What the frame shows of the object.
    T_camera_object
        The object's pose in the frame.
    reach
        Normals are taken across this many pixels to each side; None: as fits the picture's size.
    threads
        Number of threads.
    """
    camera, mask = sample.camera, sample.mask
    seen = sample.depth if mask is None else np.where(mask, sample.depth, np.float32(0))
    normals = np.empty((*seen.shape, 3), dtype=np.float32)
    rays, steps = camera_rays(camera), reach or normal_reach(camera)

    def work(start: int, stop: int) -> None:
        estimate_normals(seen, rays, steps, MAX_JUMP, normals, start, stop)

    for_ranges(work, len(seen), threads)
    known = np.where(np.any(normals != 0, axis=2), seen, np.float32(0))
    return ModelView(
        camera=camera,
        T_camera_object=T_camera_object,
        depth=known,
        normals=normals,
        intensity=sample.masked_luma,
    )
