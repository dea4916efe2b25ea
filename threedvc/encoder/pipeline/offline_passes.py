# SPDX-License-Identifier: MIT
"""The passes over a sequence that can be read again: each takes a reconstruction and returns one.

`find_objects` tells which objects there are and where; `improve` chooses cells, calibrates cameras, and refines poses
against the finished models.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from threedvc.config import EncoderConfig, SegmentationConfig, SegmentationMode
from threedvc.encoder.appearance.appearance_fit import align_pictures, align_poses
from threedvc.encoder.appearance.rate_distortion import depth_misfit, rate_distortion_at
from threedvc.encoder.fusion.surface_extraction import extract_surface
from threedvc.encoder.pipeline.budget import surface_budget
from threedvc.encoder.pipeline.cell_size_trials import (
    surface_bytes,
    with_affordable_cells,
    with_affordable_geometry,
    with_best_cells,
    with_best_geometry,
    with_relief_chosen,
)
from threedvc.encoder.pipeline.fusion_pass import FusionPass, Reconstruction
from threedvc.encoder.rate.objective import ColorCost
from threedvc.encoder.reconstruction.color_calibration import calibrate_color_cameras
from threedvc.encoder.reconstruction.depth_consistency import background_depth_error, reclassify_sensors
from threedvc.encoder.reconstruction.extrinsic_calibration import calibrate_extrinsics
from threedvc.encoder.reconstruction.loop_closure import close_loops
from threedvc.encoder.reconstruction.pose_refinement import refine_poses
from threedvc.encoder.reconstruction.scene import Scene
from threedvc.encoder.registration.registration import RegistrationConfig
from threedvc.encoder.segmentation.sequence_labels import MAX_LOST_SHARE, SequenceLabels
from threedvc.encoder.tracking.pose_track import interpolate_blind_frames, merge_submaps
from threedvc.encoder.tracking.resting_camera import camera_rests
from threedvc.encoder.tracking.trajectory_smoothing import smooth_to_depth
from threedvc.errors import ConfigError, SequenceError
from threedvc.frames.frame import SequenceInfo
from threedvc.geometry.pose import Pose, compose, inverse
from threedvc.stream.pose_status import PoseStatus

__all__ = ["check_regions_of_interest", "check_surfaces", "find_objects", "improve", "improve_geometry"]

MAX_DEPTH_ROUNDS = 3
"""Rounds in which poses are registered with the depth: two are the rule."""
WORTHWHILE_ROUND = 0.98
"""Share of the depth's error that must be left for another round, or for loops that were closed, to count as a gain."""
POOR_MISFIT = 0.4
"""Misfit of drawn depth from which on pictures may tell poses better than it does. Measured: a fast, noisy camera has
.64, and .60 with such poses; the kitchen .20 either way."""
MORE_ROUNDS = 6
"""Rounds that shifts of pictures take beyond those of common poses: they converge slowly."""
TO_DEPTH = RegistrationConfig(luma_weight=0.1, weak_inliers=0.4, weak_overlap=0.15, rest_pixels=0.01, move_pixels=0.01)
"""Registration with the depth: luma counts little, but where the depth leaves a direction open. It refines poses that
are about right, so whatever is not lost may be trusted."""
SURE_LUMA = 2.0
"""Weight of luma where the background is tracked again with a calibration that proved right."""
BRIDGED_S = 0.5
"""Frames without depth, found by their pictures, are put on the way between those about them if they are no longer."""
WORTHWHILE_SHIFTS = 0.06
"""Share of the misfit of the depth that poses of its own surely are worth if they save it."""
SHIFT_BYTES = 3
"""What the shift of one picture takes in a stream, about."""
MIN_SURFACE_SHARE = 0.5
"""Surfaces keep this share of their bytes however many shifts of pictures take."""


def find_objects(info: SequenceInfo, config: EncoderConfig, fusion: FusionPass) -> Reconstruction:
    """Return which objects there are and where they are in every frame, with the evidence of their models."""
    if not info.has_camera_poses and not info.sensors and camera_rests(fusion.frames):
        info = replace(info, camera_rests=True)
    state = _first_pass(info, config, fusion)
    state = _with_measured_noise(state, info, config, fusion)
    if state.config.refine:
        state = _with_merged_submaps(state, fusion)
    return _with_camera_at_rest(state, fusion)


def improve(state: Reconstruction, fusion: FusionPass) -> tuple[Reconstruction, list[Pose] | None]:
    """Choose cells, calibrate cameras and refine poses; return the shifts of the color pictures, too, if there are
    any.

    A shift is T_shifted_camera of a frame: how the camera moved between its depth and its color picture.
    """
    state = with_affordable_cells(state, fusion)
    shifts = None
    if state.config.refine:
        state = _with_extrinsics(state, fusion)
        state = _with_color_calibration(state, fusion)
        state = _with_closed_loops(state, fusion)
        if state.config.appearance.rounds and any(item.may_move for item in state.scene.objects.values()):
            state, shifts = _with_photometric_poses(state, fusion)
        state = with_best_cells(state, fusion, shifts)
    return with_relief_chosen(state), shifts


def improve_geometry(state: Reconstruction, fusion: FusionPass, cost: ColorCost) -> Reconstruction:
    """Choose cells, calibrate cameras and refine poses where pictures do not count: a video shows them.

    `cost` is what bytes cost that the video does not get.
    """
    state = with_affordable_geometry(state, fusion)
    if state.config.refine:
        state = _with_extrinsics(state, fusion)
        state = _with_color_calibration(state, fusion)
        state = _with_closed_loops(state, fusion)
        if state.config.appearance.rounds and state.scene.objects[0].may_move:
            state = _with_poses_for_geometry(state, fusion)
        state = with_best_geometry(state, fusion, cost)
    return with_relief_chosen(state)


def check_surfaces(state: Reconstruction) -> None:
    """Raise SequenceError if depth was measured and makes no surface: a stream of it would draw nothing."""
    models = [item.evidence for item in state.scene.objects.values() if item.evidence.index.count]
    if models and not any(len(extract_surface(model, state.config.threads).cells) for model in models):
        raise SequenceError(
            f"{state.info.name}: the depth of its {len(state.reports)} frames makes no surface; it is too sparse, or "
            "too noisy for --sensor, or its poses are wrong (--motion track)"
        )


def check_regions_of_interest(state: Reconstruction) -> None:
    """Raise ConfigError if a region is an object that is not there; a live encoder cannot know."""
    for region in state.config.focus:
        if region.number is not None and region.number not in state.scene.objects:
            there = ", ".join(map(str, sorted(state.scene.objects)))
            raise ConfigError(
                f"focus on object {region.number}: {state.info.name} has object {there}; name one of them"
            )


def _first_pass(info: SequenceInfo, config: EncoderConfig, fusion: FusionPass) -> Reconstruction:
    """Find the objects and where they are; first by what moves, if nobody has said what there is."""
    if config.segmentation.mode is SegmentationMode.MOTION:
        labels = _labels_by_motion(info, config, fusion)
        return fusion.fuse(Scene(info, config, None, labels))
    if _may_divide(info, config):
        by_motion = replace(config, segmentation=SegmentationConfig(mode=SegmentationMode.MOTION))
        labels = _labels_by_motion(info, by_motion, fusion)
        if labels.is_sure:
            state = fusion.fuse(Scene(info, by_motion, None, labels))
            if not _loses_often(state):
                return state
    return fusion.fuse(Scene(info, config))


def _may_divide(info: SequenceInfo, config: EncoderConfig) -> bool:
    """Tell whether nobody has said which objects there are, and there is time to find out."""
    told = info.has_masks or info.has_object_poses or bool(info.sensors)
    return config.segmentation.mode is SegmentationMode.AUTO and config.refine and not told


def _labels_by_motion(info: SequenceInfo, config: EncoderConfig, fusion: FusionPass) -> SequenceLabels:
    """Divide all frames by motion."""
    labels = SequenceLabels(info, config)
    labels.segment_all(fusion.frames)
    return labels


def _loses_often(state: Reconstruction) -> bool:
    """Tell if something is lost in so many frames that it is no rigid object: surfaces that shine seem to move."""
    return sum(report.status is PoseStatus.LOST for report in state.reports) > MAX_LOST_SHARE * len(state.reports)


def _with_measured_noise(
    state: Reconstruction, info: SequenceInfo, asked: EncoderConfig, fusion: FusionPass
) -> Reconstruction:
    """Begin anew with the choices `asked` for where a sensor scatters more than its first frame made believe."""
    sensors = reclassify_sensors(state.scene, fusion.frames) if 0 in state.scene.objects else None
    if sensors is None:
        return state
    return _first_pass(info, replace(asked, sensor=sensors[0], other_sensors=tuple(sensors[1:])), fusion)


def _with_merged_submaps(state: Reconstruction, fusion: FusionPass) -> Reconstruction:
    """Bring the parts of models that recognized each other together."""
    items = state.scene.objects.items()
    links = {number: item.tracker.submap_links for number, item in items if item.tracker and item.tracker.submap_links}
    if not links:
        return state
    return fusion.fuse_at(state, {number: merge_submaps(item.found, links.get(number, {})) for number, item in items})


def _with_camera_at_rest(state: Reconstruction, fusion: FusionPass) -> Reconstruction:
    """Let a camera that was tracked and hardly moved stand still."""
    background = state.scene.objects.get(0)
    if background is None or background.stayed or not state.scene.hardly_moves(0):
        return state
    first = next(at.T_camera_object for at in background.found if at is not None and at.usable)
    at_rest = [at and replace(at, T_camera_object=first) for at in background.found]
    return fusion.fuse_at(state, state.poses | {0: at_rest})


def _with_extrinsics(state: Reconstruction, fusion: FusionPass) -> Reconstruction:
    """Correct how further sensors are mounted, if that makes their frames fit those of the first one better."""
    info = calibrate_extrinsics(state.scene, fusion.frames)
    if info is None:
        return state
    return fusion.fuse(Scene(info, state.config, state.poses, state.scene.sequence_labels))


def _with_color_calibration(state: Reconstruction, fusion: FusionPass) -> Reconstruction:
    """Calibrate the color cameras, and find all poses once more with what is then known.

    Where the input's own calibration turns out to be right, luma counts fully, and what was tracked is tracked
    anew. A new one is not quite exact: the depth leads on.
    """
    tracked = state.tracked
    info = calibrate_color_cameras(state.scene, fusion.frames)
    if info is not None:
        state = fusion.fuse(Scene(info, state.config, state.poses, state.scene.sequence_labels), state.config)
    elif tracked:
        state = _tracked_anew(state, fusion)
    poses = refine_poses(state.scene, fusion.frames, TO_DEPTH if tracked and info is not None else None)
    poses[0] = interpolate_blind_frames(
        poses[0], [record.blind for record in state.scene.records], round(BRIDGED_S * state.info.fps)
    )
    return fusion.fuse_at(state, poses)


def _tracked_anew(state: Reconstruction, fusion: FusionPass) -> Reconstruction:
    """Track everything again with luma at its full weight."""
    cells = min(state.config.cell_factor, 1.0)  # wider ones, for a low rate, would blunt the tracking
    narrow = replace(state.config, cell_factor=cells)
    scene = Scene(state.info, narrow, None, state.scene.sequence_labels, luma_weight=SURE_LUMA)
    state = fusion.fuse(scene, state.config)
    return _with_camera_at_rest(_with_merged_submaps(state, fusion), fusion)


def _with_closed_loops(state: Reconstruction, fusion: FusionPass) -> Reconstruction:
    """Take the drift out of a tracked camera's path, if that makes the model fit the frames better."""
    scene, frames = state.scene, fusion.frames
    if not scene.objects[0].may_move or all(
        at is None or at.status is PoseStatus.KNOWN for at in scene.objects[0].found
    ):
        return state
    closed_path = close_loops(scene, frames)
    if closed_path is None:
        return state
    closed = fusion.fuse_at(state, state.poses | {0: closed_path})
    closed = fusion.fuse_at(closed, refine_poses(closed.scene, frames))
    no_gain = background_depth_error(closed.scene, frames) > WORTHWHILE_ROUND * background_depth_error(scene, frames)
    return state if no_gain else closed


def _with_photometric_poses(state: Reconstruction, fusion: FusionPass) -> tuple[Reconstruction, list[Pose] | None]:
    """Move the camera to where pictures fit best; return the shifts of the color pictures if there are to be any.

    Poses that fit color and depth serve both, unless the depth alone wants clearly other ones, or the pictures are
    better for it.
    """
    rounds = state.config.appearance.rounds
    common = fusion.fuse_at(state, align_poses(state.scene, fusion.frames, rounds))
    if not common.scene.objects[0].may_move:
        return common, None
    apart, error, common_error = _with_poses_of_depth(common, fusion)
    shifts = _shifts_between(common.scene, apart.scene)
    sure = error <= (1 - WORTHWHILE_SHIFTS) * common_error
    if sure or (error < common_error and _is_better_apart(common, apart, shifts, fusion)):
        return apart, align_pictures(apart.scene, fusion.frames, shifts, rounds + MORE_ROUNDS)
    return common, None


def _with_poses_for_geometry(state: Reconstruction, fusion: FusionPass) -> Reconstruction:
    """Register with the depth; where that is poor try poses that fit the pictures, too, and keep what draws it best."""
    of_depth, _, _ = _with_poses_of_depth(state, fusion)
    tried = {depth_misfit(of_depth.scene, fusion.frames): of_depth}
    if min(tried) > POOR_MISFIT:
        common = fusion.fuse_at(state, align_poses(state.scene, fusion.frames, state.config.appearance.rounds))
        again, _, _ = _with_poses_of_depth(common, fusion)
        tried |= {depth_misfit(each.scene, fusion.frames): each for each in (common, again)}
    return tried[min(tried)]


def _with_poses_of_depth(common: Reconstruction, fusion: FusionPass) -> tuple[Reconstruction, float, float]:
    """Register with the depth until that gains nothing; return the depth's error then, and at the common poses."""
    frames, state = fusion.frames, common
    first = error = background_depth_error(common.scene, frames)
    for _ in range(MAX_DEPTH_ROUNDS):
        poses = refine_poses(state.scene, frames, TO_DEPTH)
        if not state.info.sensors:  # sensors share poses, or take turns at steps of uneven length
            poses[0] = smooth_to_depth(
                poses[0], common.scene.objects[0].found, [record.blind for record in common.scene.records]
            )
        state = fusion.fuse_at(state, poses)
        before, error = error, background_depth_error(state.scene, frames)
        if error > WORTHWHILE_ROUND * before:
            break
    return state, error, first


def _shifts_between(common: Scene, apart: Scene) -> list[Pose]:
    """Return T_shifted_camera of every frame, from poses that serve color and depth and poses of the depth."""
    there = [rig.at_sensor for rig in apart.info.rigs]
    poses = zip(common.objects[0].poses, apart.objects[0].poses, apart.records, strict=True)
    return [compose(there[frame.sensor](both), inverse(there[frame.sensor](depth))) for both, depth, frame in poses]


def _is_better_apart(common: Reconstruction, apart: Reconstruction, shifts: Sequence[Pose], fusion: FusionPass) -> bool:
    """Tell whether shifts, about right as yet, give better pictures than poses that serve color and depth."""
    budget = surface_budget(apart) or surface_bytes(common.scene, common.config.color.luma_step)
    with_shifts = max(budget - SHIFT_BYTES * len(shifts), MIN_SURFACE_SHARE * budget)
    error = rate_distortion_at(apart.scene, fusion.frames, shifts, with_shifts)
    return error < rate_distortion_at(common.scene, fusion.frames, None, budget)
