# SPDX-License-Identifier: MIT
"""What a fit to the pictures holds: colors, gains, poses and shifts, and samples of the frames at these poses."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from threedvc.arrays import Doubles, Floats
from threedvc.coding.gains import NEUTRAL
from threedvc.config import RenderConfig
from threedvc.encoder.appearance.color_field import ColorField, FieldObject
from threedvc.encoder.appearance.samples import FrameSamples, Sampler, rays_at
from threedvc.encoder.fusion.surface_extraction import Surface, extract_surface
from threedvc.encoder.reconstruction.scene import Scene
from threedvc.encoder.reconstruction.scene_object import SceneObject
from threedvc.encoder.registration.frame_resolutions import Downsampled
from threedvc.encoder.tracking.pose_track import PoseTracks
from threedvc.frames.frame import Frame
from threedvc.frames.sequence import FrameSequence, sampling_stride
from threedvc.geometry.camera import CameraRig
from threedvc.geometry.pose import Pose, identity, inverse
from threedvc.render.render_model import RenderModel
from threedvc.render.renderer import Renderer
from threedvc.stream.pose_status import PoseStatus

__all__ = ["MAX_SAMPLES", "CompletedSurface", "DepthCaster", "FitState"]

MAX_SAMPLES = 2_000_000
"""Of all frames: bounds the memory and the time of the least squares, whatever the length of a sequence."""
MIN_FRAME_SAMPLES, MAX_FRAME_SAMPLES = 5_000, 20_000
"""Of a frame: fewer do not tell its pose and gain, more say little that their neighbors do not."""
MIN_TURN_RAD = 0.2
"""Some eleven degrees: by less, the light on the surface of an object hardly changes."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CompletedSurface:
    """Inferred cells of the background where no depth was measured.

    Attributes
    ----------
    number
        Of the object that they form.
    surface
        The cells; their colors are gray.
    voxel_size_m
        Edge of a cell.
    """

    number: int
    surface: Surface
    voxel_size_m: float


class DepthCaster(NamedTuple):
    """Rays of a sensor's depth camera, fewer than its pixels, and what casts them."""

    thinned: Downsampled
    renderer: Renderer

    def cast(self, models: Mapping[int, RenderModel], poses: Mapping[int, Pose]) -> tuple[Floats, NDArray[np.uint8]]:
        """Return depth (n,) and object numbers (n,) that the rays meet."""
        return self.renderer.cast(self.thinned.grid, models, poses)

    def points(self, depth: Floats) -> Doubles:
        """Return the points (n, 3) of depths (n,) in the depth camera's frame."""
        return rays_at(self.thinned.grid.slopes, depth)

    def measured(self, frame: Frame) -> Floats:
        """Return the depth (n,) that a frame has at the rays."""
        return self.thinned.downsample(frame.depth).reshape(-1)


class FitState:
    """Colors, gains, poses and shifts of a scene so far, and samples of the frames at these.

    Its colors are always those of its surfaces, numbered through: set surfaces by `replace_surfaces` and `complete`.

    Parameters
    ----------
    scene
        All frames fused.
    frames
        These frames.
    shifts
        T_shifted_camera of every frame to begin with; None: none.
    max_samples
        About how many samples to keep.

    Attributes
    ----------
    threads, gray
        Number of threads; whether the pictures have luma alone.
    surfaces
        Surface of every object that was measured, by number.
    completion
        The inferred surface behind them, if there is one.
    colors
        Colors of all cells, and the light on objects.
    tracks
        Where every object is in every frame.
    shifts
        T_shifted_camera of every frame: how the camera moved between depth and color picture.
    gains
        (frames, 3, 2) units of the color camera's gains, see `threedvc.coding.gains`.
    samples
        Of the frames that are kept, without their points.
    turning
        Numbers of the objects that turn in the world, so that the light on them changes.
    """

    def __init__(
        self,
        scene: Scene,
        frames: FrameSequence,
        shifts: Sequence[Pose] | None = None,
        max_samples: int = MAX_SAMPLES,
    ) -> None:
        self.scene, self.frames = scene, frames
        self.threads, self.gray = scene.config.threads, scene.info.gray
        self.surfaces: Mapping[int, Surface] = {
            number: extract_surface(item.evidence, self.threads, smooth=True) for number, item in scene.objects.items()
        }
        self.completion: CompletedSurface | None = None
        self.colors = self._color_field()
        self.tracks: PoseTracks = {number: list(item.found) for number, item in scene.objects.items()}
        self.shifts = [identity()] * len(frames) if shifts is None else list(shifts)
        self.gains = np.repeat(NEUTRAL[None], len(frames), axis=0)
        self.samples: list[FrameSamples] = []
        self.turning = [number for number, item in scene.objects.items() if _turns(scene, item)]
        pixels = int(np.clip(max_samples // len(frames), MIN_FRAME_SAMPLES, MAX_FRAME_SAMPLES))
        self._kept_step = sampling_stride(len(frames) * pixels, max_samples, scene.info)
        self._samplers = [Sampler(rig, pixels, self.threads) for rig in scene.info.rigs]
        self._casters: dict[int, DepthCaster] = {}

    @property
    def all_surfaces(self) -> dict[int, Surface]:
        """The surfaces by number, the inferred one among them."""
        surfaces = dict(self.surfaces)
        if self.completion is not None:
            surfaces[self.completion.number] = self.completion.surface
        return surfaces

    def replace_surfaces(self, surfaces: Mapping[int, Surface]) -> None:
        """Take other surfaces of the measured objects; colors are those of the surfaces again."""
        self.surfaces = surfaces
        self.colors = self._color_field()

    def complete(self, completion: CompletedSurface) -> None:
        """Add an inferred surface; colors are those of the surfaces again."""
        self.completion = completion
        self.colors = self._color_field()

    def _color_field(self) -> ColorField:
        appearance = self.scene.config.appearance
        objects = {
            number: FieldObject(
                surface=self.surfaces[number],
                voxel_size_m=item.evidence.voxel_size_m,
                texture_scale=appearance.texture_scale,
                relief_bits=appearance.relief_bits or 0,
            )
            for number, item in self.scene.objects.items()
        }
        if self.completion is not None:
            completion = self.completion
            objects[completion.number] = FieldObject(
                surface=completion.surface, voxel_size_m=completion.voxel_size_m, inferred=True
            )
        return ColorField(objects, self.threads)

    def sensor_of(self, frame: int) -> int:
        """Return the number of the sensor that took a frame."""
        return self.scene.records[frame].sensor

    def rig_of(self, frame: int) -> CameraRig:
        """Return the cameras that took a frame."""
        return self.scene.info.rigs[self.sensor_of(frame)]

    def is_repeated(self, frame: int) -> bool:
        """Tell whether a frame is a copy of the sensor's one before."""
        return self.scene.records[frame].repeated

    def measured(self, frame: int) -> Frame:
        """Return a frame without the depth that is not to be used."""
        return self.scene.with_depth_limit(self.frames[frame])

    def drawn_frames(self) -> Iterator[Frame]:
        """Yield the frames in which anything is drawn."""
        return (frame for frame in map(self.scene.with_depth_limit, self.frames) if self.poses_in(frame.index))

    def poses_in(self, frame: int) -> dict[int, Pose]:
        """Return where the decoder will draw every object that has appeared, before the sensor that took a frame."""
        poses, rig = {}, self.rig_of(frame)
        for number, item in self.scene.objects.items():
            at = self.tracks[number][frame]
            if item.born is not None and item.born <= frame:
                poses[number] = rig.at_sensor(item.poses[frame] if at is None else at.T_camera_object)
        if self.completion is not None and 0 in poses:
            poses[self.completion.number] = poses[0]
        return poses

    def draws_lost_object(self, frame: int) -> bool:
        """Tell whether an object is drawn where it was not seen: then the picture says nothing about colors."""
        return any(at.status is PoseStatus.LOST for track in self.tracks.values() if (at := track[frame]) is not None)

    def depth_caster(self, frame: int) -> DepthCaster:
        """Return the rays of the depth camera that took a frame."""
        sensor = self.sensor_of(frame)
        if sensor not in self._casters:
            rig = self.scene.info.rigs[sensor]
            self._casters[sensor] = DepthCaster(Downsampled(rig), Renderer(rig, RenderConfig(threads=self.threads)))
        return self._casters[sensor]

    def sample(self, frame: Frame) -> FrameSamples:
        """Return samples of a frame at its pose and shift so far."""
        sampler = self._samplers[self.sensor_of(frame.index)]
        return sampler.sample(frame, self.colors, self.poses_in(frame.index), self.shifts[frame.index])

    def keep(self, sample: FrameSamples) -> None:
        """Keep the samples of a frame for the fit, unless it is one of those left out of long sequences."""
        if sample.frame % self._kept_step == 0:
            self.samples.append(replace(sample, points=sample.points[:0]))

    def samples_and_gains(self) -> Iterator[tuple[FrameSamples, NDArray[np.int64]]]:
        """Yield the samples of every frame that is kept, and its gain so far (3, 2)."""
        return ((sample, self.gains[sample.frame]) for sample in self.samples)

    def pixels_per_sample(self, frame: int) -> int:
        """Return how many pixels of a frame a sample stands for."""
        return self._samplers[self.sensor_of(frame)].pixels_per_sample


def _turns(scene: Scene, item: SceneObject) -> bool:
    """Tell whether an object turns in the world, so that the light on its surface changes."""
    if not item.number:
        return False
    world = scene.objects[0].poses
    rotations = [inverse(world[k])[:3, :3] @ item.poses[k][:3, :3] for k, at in enumerate(item.found) if at is not None]
    return any(np.trace(rotations[0].T @ rotation) < 1 + 2 * np.cos(MIN_TURN_RAD) for rotation in rotations)
