# SPDX-License-Identifier: MIT
"""Where to record next: the views from which models would lose most of their entropy.

The entropy of the models tells what is not known yet, and can guide the sensor (sec. 5 of the paper). Views from where
a camera can go are judged by the entropy of the cells that they would look at, and chosen one after the other, each for
what the ones before it leave.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from threedvc.config import ExplorationConfig, RenderConfig
from threedvc.decoder.frame_state import FrameState
from threedvc.decoder.replay import DrawableModels
from threedvc.errors import ConfigError, SequenceError
from threedvc.frames.sensor_model import SENSORS, SensorModel
from threedvc.geometry.camera import Camera, CameraRig
from threedvc.geometry.pose import Pose, compose, identity, inverse
from threedvc.model.decoded_model import DecodedModel
from threedvc.render.renderer import Renderer
from threedvc.view_planning.candidate_views import reachable_views, upward, views_around
from threedvc.view_planning.occupancy_field import OccupancyField

__all__ = ["DrawnFrame", "Target", "ViewSampling", "downsampled_frames", "draw_frames", "targets_of"]

MIN_FRAMES = 48
"""Frames that are drawn if there are so many, and fewer than twice as many: more take longer, fewer leave out views."""
PICTURE_SIDE = 160
"""Pixels of the longer side of what is drawn, at most: the cells are wider than those of the models anyway."""
RAYS = 4800
"""Of a view: 80 x 60. Cells are no smaller than these are apart at the usual depth, so more would need finer cells."""
CLEARANCE_M = 0.2
"""Between a camera and what is occupied: room for a camera and a hand. By hand: more would close narrow passages."""
OUTLIERS = 0.001
"""Share of the points at each end of each axis that a box leaves out: a few stray cells would make it much larger."""
FARTHEST = 0.99
"""Quantile of the drawn depths up to which views see: the rest may be strays."""
MARGIN_CELLS = 2
"""Around the box of an object: what lies before its surface belongs to the field, too."""


@dataclass(frozen=True, kw_only=True, eq=False)
class DrawnFrame:
    """A frame as all that the stream holds draws it, in a small picture.

    Attributes
    ----------
    state
        Poses.
    camera
        The camera of the picture.
    depth
        (h, w) float32 meters, 0 = nothing there.
    labels
        (h, w) uint8 object numbers.
    """

    state: FrameState
    camera: Camera
    depth: NDArray[np.float32]
    labels: NDArray[np.uint8]


@dataclass(frozen=True, kw_only=True, eq=False)
class ViewSampling:
    """The rays by which a view of the camera of a stream is judged, and how far and how surely it measures along them.

    Attributes
    ----------
    slopes
        (rays, 2) float64 slopes of some thousand rays.
    spacing
        Distance between two of them at depth 1.
    reach_m
        Depth up to which something is measured.
    sensor
        How readings scatter.
    """

    slopes: NDArray[np.float64]
    spacing: float
    reach_m: float
    sensor: SensorModel

    @classmethod
    def of(cls, camera: Camera, far_m: float, sensor: SensorModel) -> ViewSampling:
        """Return the sampling of the views of a camera that was used up to a depth `far_m`."""
        rays = _downsampled(camera, np.sqrt(RAYS / (camera.width * camera.height)))
        slopes = np.ascontiguousarray(rays.rays().reshape(-1, 2))
        return cls(slopes=slopes, spacing=1 / rays.fx, reach_m=min(far_m, sensor.reach_m), sensor=sensor)

    def distance_m(self, radius_m: float) -> float:
        """Return the distance at which a ball just fits into the picture."""
        slope = max(float(np.abs(self.slopes).max(axis=0).min()), self.spacing / 2)
        return float(radius_m * np.sqrt(1 + 1 / slope**2))


@dataclass(frozen=True, kw_only=True, eq=False)
class Target:
    """Something to explore: the world, or an object that moves in it.

    Attributes
    ----------
    number
        The object; 0 is the world, with all objects that rest in it.
    field
        What is known of it.
    recorded
        (n, 4, 4) poses T_field_camera that it was recorded from, in order of time.
    candidates
        (m, 4, 4) poses T_field_camera that it could be recorded from.
    T_world_field
        Where it stood at last.
    sampling
        How the camera samples a view.
    """

    number: int
    field: OccupancyField
    recorded: NDArray[np.float64]
    candidates: NDArray[np.float64]
    T_world_field: Pose
    sampling: ViewSampling


def downsampled_frames(states: Iterable[FrameState], count: int = MIN_FRAMES) -> list[FrameState]:
    """Return frames at equal steps, at least `count` and fewer than twice as many if there are enough, and the last."""
    kept: list[FrameState] = []
    step, last = 1, None
    for position, last in enumerate(states):
        if position % step == 0:
            kept.append(last)
        if len(kept) == 2 * count:
            kept, step = kept[::2], 2 * step
    return kept if last is None or kept[-1] is last else [*kept, last]


def targets_of(
    models: Mapping[int, DecodedModel],
    rigs: Sequence[CameraRig],
    states: Sequence[FrameState],
    config: ExplorationConfig,
) -> list[Target]:
    """Find what a recording leaves to be explored, and from where that could be done.

    The world is a target if the camera moves or nothing else does; an object is one if it moves in the world.

    Parameters
    ----------
    models
        Decoded models by object number.
    rigs
        Cameras of every sensor, of which those for depth count; the first one is to take the views to come.
    states
        Frames in order.
    config
        Choices.

    Raises
    ------
    SequenceError
        If no frame shows a surface.
    ConfigError
        If an object that is asked for is not there, or rests.
    """
    # The last frame is where the first sensor starts from.
    states = sorted(states, key=lambda state: state.sensor == 0)
    frames = draw_frames(models, rigs, states, config.threads)
    depths = np.concatenate([np.zeros(0, np.float32), *(frame.depth[frame.depth > 0] for frame in frames)])
    if not len(depths):
        raise SequenceError("no frame shows a surface, so there is nothing to explore; record something first")
    sampling = ViewSampling.of(rigs[0].depth, float(np.quantile(depths, FARTHEST)), SENSORS[config.sensor])
    movers = [number for number in _solid(models) if number and _moves(number, models[number], states)]
    resting = {number: models[number] for number in _solid(models) if number not in movers}
    targets = []
    for number in _chosen(config.objects, movers, bool(resting), _camera_moves(states)):
        if number == 0:
            targets.append(_world(resting, frames, sampling, float(np.median(depths)), config))
        else:
            targets.append(_object(number, models[number], frames, sampling, config))
    return targets


def draw_frames(
    models: Mapping[int, DecodedModel], rigs: Sequence[CameraRig], states: Sequence[FrameState], threads: int
) -> list[DrawnFrame]:
    """Draw small depth pictures of frames from the models as they are now."""
    cameras = [_downsampled(rig.depth, PICTURE_SIDE / max(rig.depth.width, rig.depth.height)) for rig in rigs]
    config = RenderConfig(supersample=1, threads=threads)
    renderers = [Renderer(CameraRig.registered_to(camera), config) for camera in cameras]
    drawable = DrawableModels(threads).refreshed(models, _solid(models))
    frames = []
    for state in states:
        poses = {number: state.T_camera_object[number] for number in drawable if number in state.T_camera_object}
        picture = renderers[state.sensor].draw(drawable, poses, color=False)
        camera = cameras[state.sensor]
        frames.append(DrawnFrame(state=state, camera=camera, depth=picture.depth, labels=picture.labels))
    return frames


def _chosen(wanted: tuple[int, ...] | None, movers: list[int], world: bool, camera_moves: bool) -> list[int]:
    there = [0, *movers] if world else movers
    if wanted is None:
        return there if camera_moves or not movers else movers
    for number in wanted:
        if number not in there:
            names = ", ".join(map(str, there))
            raise ConfigError(f"object {number} is not there to be explored, or rests as part of 0; choose of {names}")
    return [number for number in there if number in wanted]


def _solid(models: Mapping[int, DecodedModel]) -> list[int]:
    """Return the numbers of objects that have a depth."""
    return [number for number in sorted(models) if models[number].cell_count and not models[number].guessed]


def _downsampled(camera: Camera, scale: float) -> Camera:
    """Return the camera with smaller pictures; never with larger ones."""
    scale = min(scale, 1.0)
    return camera.resized(max(1, round(camera.width * scale)), max(1, round(camera.height * scale)))


def _camera_moves(states: Sequence[FrameState]) -> bool:
    first = {state.sensor: state.T_world_camera for state in reversed(states)}
    return any(not np.array_equal(state.T_world_camera, first[state.sensor]) for state in states)


def _moves(number: int, model: DecodedModel, states: Sequence[FrameState]) -> bool:
    """Tell whether an object moves in the world by more than poses jitter."""
    points = _points(model)
    corners = np.array([points.min(axis=0), points.max(axis=0)])
    places = [
        _placed(corners, compose(state.T_world_camera, state.T_camera_object[number]))
        for state in states
        if number in state.T_camera_object
    ]
    return any(np.abs(place - places[-1]).max() > 2 * model.voxel_size_m for place in places)


def _points(model: DecodedModel) -> NDArray[np.float64]:
    """Return the centers (n, 3) of a model's cells in meters."""
    return np.asarray((model.cells()[0] + 0.5) * model.voxel_size_m, dtype=np.float64)


def _placed(points: NDArray[np.float64], T: Pose) -> NDArray[np.float64]:
    return np.asarray(points @ T[:3, :3].T + T[:3, 3])


def _box(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return corners (3,) of a box about points (n, 3), without a few that lie far from all others."""
    corners = np.asarray(np.quantile(points, [OUTLIERS, 1 - OUTLIERS], axis=0), dtype=np.float64)
    return corners[0], corners[1]


def _world(
    resting: Mapping[int, DecodedModel],
    frames: Sequence[DrawnFrame],
    sampling: ViewSampling,
    scale_m: float,
    config: ExplorationConfig,
) -> Target:
    """Survey the world; `scale_m`, a usual depth in it, tells how large a room this is."""
    recorded = np.stack([frame.state.T_world_camera for frame in frames])
    last = frames[-1].state
    surface = np.concatenate(
        [
            _placed(_points(model), compose(last.T_world_camera, last.T_camera_object[number]))
            for number, model in resting.items()
        ]
    )
    places = recorded[:, :3, 3]
    low, high = _box(surface)
    field = OccupancyField(
        np.minimum(low, places.min(axis=0)) - scale_m / 2,
        np.maximum(high, places.max(axis=0)) + scale_m / 2,
        finest_m=max(sampling.spacing * scale_m, *(model.voxel_size_m for model in resting.values())),
        half_m=scale_m / 4,
        threads=config.threads,
    )
    _observe(field, list(resting), frames, recorded, sampling)
    field.hold_occupied(surface)
    clearance_m = min(CLEARANCE_M, scale_m / 4)
    for place in places:
        field.hold_free(place, clearance_m, sampling.sensor)
    return Target(
        number=0,
        field=field,
        recorded=recorded,
        candidates=reachable_views(field, recorded, clearance_m, config.candidates),
        T_world_field=identity(),
        sampling=sampling,
    )


def _object(
    number: int, model: DecodedModel, frames: Sequence[DrawnFrame], sampling: ViewSampling, config: ExplorationConfig
) -> Target:
    """Survey an object in its own frame, in which the camera moves about it."""
    showing = [frame for frame in frames if number in frame.state.T_camera_object]
    recorded = np.stack([inverse(frame.state.T_camera_object[number]) for frame in showing])
    surface = _points(model)
    low, high = _box(surface)
    center, radius_m = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
    usual_m = float(np.median(np.linalg.norm(recorded[:, :3, 3] - center, axis=1)))
    distance_m = max(usual_m, sampling.distance_m(radius_m))
    sampling = replace(sampling, reach_m=min(sampling.sensor.reach_m, max(sampling.reach_m, distance_m + radius_m)))
    finest_m = max(sampling.spacing * distance_m, model.voxel_size_m)
    margin_m = MARGIN_CELLS * finest_m
    field = OccupancyField(
        low - margin_m, high + margin_m, finest_m=finest_m, half_m=radius_m / 4 + finest_m, threads=config.threads
    )
    _observe(field, [number], showing, recorded, sampling)
    field.hold_occupied(surface)
    last = showing[-1].state
    return Target(
        number=number,
        field=field,
        recorded=recorded,
        candidates=views_around(center, distance_m, upward(recorded), config.candidates),
        T_world_field=compose(last.T_world_camera, last.T_camera_object[number]),
        sampling=sampling,
    )


def _observe(
    field: OccupancyField,
    members: Sequence[int],
    frames: Sequence[DrawnFrame],
    recorded: NDArray[np.float64],
    sampling: ViewSampling,
) -> None:
    """Integrate frames, of which the pixels of some objects show what the field is of."""
    for frame, view in zip(frames, recorded, strict=True):
        shown = np.isin(frame.labels, members)
        field.observe(frame.depth, shown, frame.camera, inverse(view), sampling.sensor)
