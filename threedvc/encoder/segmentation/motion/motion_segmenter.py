# SPDX-License-Identifier: MIT
"""Segmentation of frames into rigid bodies by their motion: no masks and no poses are given.

What some frame saw through and another one saw moved in between (`threedvc.encoder.segmentation.motion.free_space`).
Connected surfaces of such pixels become bodies; each body has a model of its own and is registered in every frame. A
pixel that moves belongs to the body whose model shows its depth; else to one that it is connected with, unless it would
have been in the way of what frames saw, had it moved with that body; else to a new one. Bodies are kept as objects that
moved as one and far enough; the labels of others go back to the background, or are void where hardly any frame saw them
at rest.
"""

from __future__ import annotations

import numpy as np

from threedvc.arrays import Labels, Mask
from threedvc.config import EncoderConfig, Motion
from threedvc.encoder.fusion.integration import fuse
from threedvc.encoder.segmentation.motion.association import label_followed, label_remnants, locate_followed
from threedvc.encoder.segmentation.motion.body_identity import (
    color_histogram,
    label_new_bodies,
    merge_moving_together,
    recognize_lost,
)
from threedvc.encoder.segmentation.motion.camera_pass import CameraPass
from threedvc.encoder.segmentation.motion.downsampling import Downsampling
from threedvc.encoder.segmentation.motion.object_evidence import is_object
from threedvc.encoder.segmentation.motion.prepared_frame import FINE_GATE, MIN_PIXELS, PreparedFrame, prepared_frame
from threedvc.encoder.segmentation.motion.segmenter_state import FUSION, SegmenterState
from threedvc.frames.frame import Frame, SequenceInfo
from threedvc.frames.sensor_model import SensorModel
from threedvc.geometry.pose import inverse

__all__ = ["MIN_CERTAIN_TRANSIENCE", "TRANSIENT_LABEL", "MotionSegmenter"]

MIN_CERTAIN_TRANSIENCE = 0.6
"""Share of the frames that tell about a surface that must have seen through it, so that it certainly moves: more than
an object needs (0.5), for nothing else speaks for it."""
TRANSIENT_LABEL = int(np.iinfo(np.uint16).max)
"""Label of what moves and belongs to no body."""
MAX_EMPTY_SHARE = 0.5
"""Part of a body's view that may be seen to be empty where it was last, before it counts as gone; never less than half
of the pixels that a body must have."""


class MotionSegmenter:
    """Segments frames; `observe` each in order, then `segment` each in order, as soon or as late as wanted.

    Parameters
    ----------
    info
        The sequence.
    config
        Choices.
    sensor
        Noise of the depth.
    downsampling
        Brings frames to the working resolution.

    Attributes
    ----------
    state
        What is known of the sequence so far.
    """

    def __init__(
        self, info: SequenceInfo, config: EncoderConfig, sensor: SensorModel, downsampling: Downsampling
    ) -> None:
        self.state = SegmenterState(info, config, sensor, downsampling)
        known = info.has_camera_poses and config.motion is not Motion.TRACK
        self._camera = CameraPass(self.state, known=known, rests=info.camera_rests)

    def observe(self, frame: Frame) -> None:
        """Find the camera in the next frame, and remember the frame."""
        small = self.state.downsampled(frame)
        self.state.poses.append(self._camera.locate(small))
        if self.state.reference_frames.holds(frame.index):
            self.state.history.keep(frame.index, small.depth)

    def segment(self, frame: Frame) -> Labels:
        """Label a frame that was observed; return the bodies' numbers (h, w) at the downsampled pixels."""
        state, small, pose = self.state, self.state.downsampled(frame), self.state.pose_of(frame.index)
        if pose is None:
            return np.zeros(small.depth.shape, np.uint16)
        prepared = prepared_frame(state, small, pose)
        followed = [body for body in state.bodies if body.active]
        locate_followed(state, prepared, followed)
        label_followed(state, prepared, followed)
        label_new_bodies(state, prepared)
        label_remnants(prepared)
        recognize_lost(state, prepared)
        merge_moving_together(state, prepared)
        _fuse_bodies(state, prepared)
        _note_departures(state, prepared)
        unlabeled = np.where(_transient_pixels(prepared), TRANSIENT_LABEL, 0)
        return np.where(prepared.labels, prepared.labels, unlabeled).astype(np.uint16)


def _fuse_bodies(state: SegmenterState, prepared: PreparedFrame) -> None:
    """Take what a frame shows of each body into its model, and into what is known of its motion and its colors."""
    for body in state.bodies:
        pose, mask = body.pose_of(prepared.index), prepared.pixels_of(body)
        if pose is not None and mask.any():
            body.transience[prepared.index] = float(prepared.transience[mask].mean())
            body.pixels[prepared.index] = int(np.count_nonzero(mask))
            body.color_histogram += color_histogram(state, prepared, mask)
            fuse(body.model, prepared.observation, mask, pose, state.sensor, FUSION, state.threads)


def _note_departures(state: SegmenterState, prepared: PreparedFrame) -> None:
    """Note which objects are no longer where they were last."""
    depth = prepared.depth
    for body in state.bodies:
        if prepared.index in body.found:
            body.gone = False
        elif is_object(state, body) and not body.gone:
            camera_then = state.pose_of(body.last)
            if camera_then is None:
                continue
            pose = prepared.T_camera_world @ inverse(camera_then) @ body.last_pose
            shown = state.coarse_predicted_depth(body, pose)
            known = (shown > 0) & (depth > 0)
            empty = known & (depth > shown + prepared.noise_m + np.float32(FINE_GATE) * depth)
            body.gone = bool(np.count_nonzero(empty) > max(MIN_PIXELS / 2, MAX_EMPTY_SHARE * np.count_nonzero(known)))


def _transient_pixels(prepared: PreparedFrame) -> Mask:
    """Tell which moving pixels (h, w) belong to surfaces that hardly any frame saw at rest."""
    surfaces = prepared.surfaces
    sizes = np.maximum(np.bincount(surfaces.ravel()), 1)
    transient = np.bincount(surfaces.ravel(), prepared.transience.ravel()) / sizes > MIN_CERTAIN_TRANSIENCE
    transient[0] = False
    return np.asarray(transient[surfaces], dtype=np.bool_)
