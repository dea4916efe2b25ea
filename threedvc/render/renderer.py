# SPDX-License-Identifier: MIT
"""Redraw a frame: first-opacity ray casting of all objects at their poses, composited by depth.

Both sides run this on decoded models. Only + - * /, sqrt and floor are used, rays are independent of
each other, and colors are summed in a fixed order: the pictures are the same on every machine and
for any number of threads.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from threedvc.config import RenderConfig
from threedvc.geometry.camera import CameraRig
from threedvc.geometry.pose import Pose, compose, identity
from threedvc.kernels.render.ray_sampling import interpolate_between, interpolate_centers, interpolate_diamonds
from threedvc.kernels.render.raycast import OPACITY, CastBlocks, cast_rays
from threedvc.kernels.render.tiles import Tiles
from threedvc.kernels.render.video_texture import SeenSurface
from threedvc.model.post_filter import PostFilter, classify_pixels
from threedvc.parallel import for_ranges
from threedvc.render.picture import BackgroundImage, Light, Picture
from threedvc.render.ray_grid import RayGrid, cells_from_camera
from threedvc.render.render_model import RenderModel
from threedvc.render.shading import Gain, Hits, first_rays, pixel_colors, shaded_rays
from threedvc.render.video_texture import MAX_DEPTH_RATIO

__all__ = ["Renderer"]

SMALL_PICTURE = 320 * 240
"""Pixels of a picture that is drawn with four rays each: what is small looks coarse without (a prototype gained 0.7
dB); in larger ones they are worth 0.05 dB (decision 0008). Every reader must use it."""
INTERPOLATIONS: dict[int, tuple[Callable[..., None], int, int]] = {
    1: (interpolate_diamonds, 4, 4),
    2: (interpolate_centers, 2, 4),
    3: (interpolate_diamonds, 2, 2),
    4: (interpolate_between, 1, 2),
}
"""How rays of each but the first of `RayGrid.levels` are interpolated, how far from others, and in every which row."""


class Renderer:
    """Draws models for one rig; keeps the rays of its cameras.

    Parameters
    ----------
    rig
        Cameras of the pictures to draw.
    config
        See `RenderConfig`.
    """

    def __init__(self, rig: CameraRig, config: RenderConfig | None = None) -> None:
        self.rig = rig
        self.config = config or RenderConfig()
        small = rig.color.width * rig.color.height <= SMALL_PICTURE
        self.supersample = self.config.supersample or (2 if small else 1)
        self._depth_rays = RayGrid(rig.depth, 1)
        one_cast = rig.registered and self.supersample == 1
        self._color_rays = self._depth_rays if one_cast else RayGrid(rig.color, self.supersample)

    def draw(
        self,
        models: Mapping[int, RenderModel],
        poses: Mapping[int, Pose],
        *,
        color: bool = True,
        gain: Gain | None = None,
        T_shifted_camera: Pose | None = None,
        backdrop: BackgroundImage | None = None,
        lights: Mapping[int, Light] | None = None,
        filters: PostFilter | None = None,
    ) -> Picture:
        """Draw one frame.

        Parameters
        ----------
        models
            Objects by number, refreshed.
        poses
            T_camera_object of every object to draw, for the depth camera.
        color
            False leaves the color picture black and saves its rays.
        gain
            Gain and offset (3,) float32 of each channel, applied to the drawn colors; None: none.
        T_shifted_camera
            Shift of the depth camera between depth and color picture; None: none.
        backdrop
            A picture that colors object 0 where it shows it; None: none.
        lights
            Light on objects, by number; the others look the same from all sides.
        filters
            Filter of the color picture, of which the parts that `RenderConfig` names are applied; None: none.

        Returns
        -------
        Picture
            Pixels that no ray of theirs finds an object for have depth 0; their color is interpolated
            from around.
        """
        rig, rays = self.rig, self._depth_rays
        depth, labels = self.cast(rays, models, poses)
        picture = np.zeros((rig.color.height, rig.color.width, 3), np.uint8)
        met: Hits | None = None
        pixel_classes = None
        still = T_shifted_camera is None or np.array_equal(T_shifted_camera, identity())
        if color and still and self._color_rays is rays:
            met = self.cast_guessed(rays, models, poses, depth, labels)
            picture = self._colored(rays, met, models, poses, backdrop, lights or {}, gain)
        elif color:
            T = rig.T_color_depth if T_shifted_camera is None else compose(rig.T_color_depth, T_shifted_camera)
            moved = {number: compose(T, poses[number]) for number in poses}
            met = self.cast_guessed(self._color_rays, models, moved, *self.cast(self._color_rays, models, moved))
            picture = self._colored(self._color_rays, met, models, moved, backdrop, lights or {}, gain)
        if filters is not None and met is not None:
            depths = first_rays(met[0], rig.color, self.supersample)
            numbers = first_rays(met[1], rig.color, self.supersample)
            pixel_classes = classify_pixels(depths, numbers, backdrop is not None)
            picture = filters.of(self.config.filter_parts).apply(picture, pixel_classes, self.config.threads)
        shape = (rig.depth.height, rig.depth.width)
        return Picture(
            color=picture, depth=depth.reshape(shape), labels=labels.reshape(shape), pixel_classes=pixel_classes
        )

    def gather_colors(
        self,
        models: Mapping[int, RenderModel],
        poses: Mapping[int, Pose],
        picture: NDArray[np.uint8],
        T_shifted_camera: Pose,
    ) -> None:
        """Color models by what a decoded picture shows of them.

        Parameters
        ----------
        models
            Objects by number, refreshed.
        poses
            T_camera_object of every object, for the depth camera when the picture was taken.
        picture
            (h, w, 3) uint8 RGB in the color camera.
        T_shifted_camera
            Shift of the depth camera between depth and color picture.
        """
        rays = self._pixel_rays()
        T_color_camera = compose(self.rig.T_color_depth, T_shifted_camera)
        moved = {number: compose(T_color_camera, pose) for number, pose in poses.items()}
        depth, labels = self.cast(rays, models, moved)
        shape = picture.shape[:2]
        for number, pose in moved.items():
            for texture in models[number].video_textures():
                T = cells_from_camera(pose, texture.texel_size_m)
                seen = SeenSurface(rays.slopes, depth.reshape(shape), labels.reshape(shape), number, T, MAX_DEPTH_RATIO)
                texture.add(seen, picture, self.config.threads)

    def _pixel_rays(self) -> RayGrid:
        """Return one ray for each pixel of the color picture."""
        if self._color_rays.width == self.rig.color.width:
            return self._color_rays
        return RayGrid(self.rig.color, 1)

    def _colored(
        self,
        rays: RayGrid,
        hits: Hits,
        models: Mapping[int, RenderModel],
        poses: Mapping[int, Pose],
        backdrop: BackgroundImage | None,
        lights: Mapping[int, Light],
        gain: Gain | None,
    ) -> NDArray[np.uint8]:
        """Return the color picture (h, w, 3) of rays that met surfaces."""
        threads = self.config.threads
        color, known = shaded_rays(rays, hits, models, poses, backdrop, lights, threads)
        return pixel_colors(color, known, self.rig.color, self.supersample, gain, threads)

    def cast(
        self, rays: RayGrid, models: Mapping[int, RenderModel], poses: Mapping[int, Pose]
    ) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
        """Find what every ray meets first.

        One ray of 32 is cast at first, then those between that cannot be interpolated, see `RayGrid.levels`.

        Returns
        -------
        depth
            (rays,) meters along z, 0 where nothing is met.
        labels
            (rays,) numbers of the objects.
        """
        count = len(rays.slopes)
        depth = np.zeros(count, dtype=np.float32)
        labels = np.zeros(count, dtype=np.uint8)
        casts = [
            self._caster(rays, models[number], number, poses[number], depth, labels)
            for number in sorted(poses)
            if models[number].index.count and not models[number].model.guessed
        ]
        wanted = np.ones(count, dtype=np.uint8)
        for level, order in enumerate(rays.levels):
            if level:
                self._interpolate(level, rays, depth, labels, wanted)
            for cast in casts:
                cast(order[wanted[order] != 0])
        return depth, labels

    def _interpolate(
        self,
        level: int,
        rays: RayGrid,
        depth: NDArray[np.float32],
        labels: NDArray[np.uint8],
        wanted: NDArray[np.uint8],
    ) -> None:
        """Interpolate rays of a level amid those of the levels before, and tell in `wanted` which have to be cast."""
        interpolate, reach, spacing = INTERPOLATIONS[level]

        def row_range(start: int, stop: int) -> None:
            interpolate(start, stop, rays.width, rays.height, reach, depth, labels, wanted)

        for_ranges(row_range, rays.height // spacing + 1, self.config.threads)

    def cast_guessed(
        self,
        rays: RayGrid,
        models: Mapping[int, RenderModel],
        poses: Mapping[int, Pose],
        depth: NDArray[np.float32],
        labels: NDArray[np.uint8],
    ) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
        """Return what `cast` has found, and guessed objects where it has found nothing."""
        guessed = [number for number in sorted(poses) if models[number].model.guessed and models[number].index.count]
        if not guessed:
            return depth, labels
        depth, labels = depth.copy(), labels.copy()
        rest = rays.order[depth[rays.order] == 0]
        for number in guessed:
            self._caster(rays, models[number], number, poses[number], depth, labels)(rest)
        return depth, labels

    def _caster(
        self,
        rays: RayGrid,
        model: RenderModel,
        number: int,
        pose: Pose,
        depth: NDArray[np.float32],
        labels: NDArray[np.uint8],
    ) -> Callable[[NDArray[np.int64]], None]:
        """Return a function that casts the rays of given numbers into one object."""
        T_cells_camera = cells_from_camera(pose, model.model.voxel_size_m)
        tiles = Tiles(rays.origin, rays.size, *rays.ranges(model.index, pose, model.model.voxel_size_m))
        blocks = CastBlocks(model.index.tables, model.skip, model.corners, model.plane)

        def cast(order: NDArray[np.int64]) -> None:
            def ray_range(start: int, stop: int) -> None:
                cast_rays(
                    rays.slopes, order, start, stop, T_cells_camera, tiles, blocks, number, OPACITY, depth, labels
                )

            for_ranges(ray_range, len(order), self.config.threads)

        return cast
