# SPDX-License-Identifier: MIT
"""Which objects a frame shows, found with a few thousand rays instead of a whole picture."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from threedvc.config import RenderConfig
from threedvc.decoder.replay import DrawableModels
from threedvc.geometry.camera import CameraRig
from threedvc.geometry.pose import Pose
from threedvc.model.decoded_model import DecodedModel
from threedvc.render.ray_grid import RayGrid
from threedvc.render.renderer import Renderer

__all__ = ["VisibilityDetector"]

RAYS = 6000
"""Enough for `APPEARING_SHARE` to be three of them; a whole picture has fifty times as many."""
APPEARING_SHARE = 1 / 2000
"""An object appears when so many of the rays meet it: of a picture of 640x480 these are 154 pixels."""
STAYING_SHARE = 1 / 8000
"""It disappears when not even so many do: the number of rays that meet a small or hidden object is uncertain."""


class VisibilityDetector:
    """Tells what the depth camera of a stream sees, one frame after the other.

    Parameters
    ----------
    rig
        The cameras; every n-th pixel of the depth camera along both axes is looked at, about `RAYS` of them.
    config
        Choices of the renderer.
    """

    def __init__(self, rig: CameraRig, config: RenderConfig | None = None) -> None:
        camera = rig.depth
        n = min(max(1, round(math.sqrt(camera.width * camera.height / RAYS))), camera.width, camera.height)
        thinned = camera.every(n, n // 2, n // 2)
        self._renderer = Renderer(CameraRig.registered_to(thinned), config)
        self._rays = RayGrid(thinned, apart=True)
        count = len(self._rays.slopes)
        self._appearing, self._staying = math.ceil(APPEARING_SHARE * count), math.ceil(STAYING_SHARE * count)
        self._drawable = DrawableModels(self._renderer.config.threads)
        self._state: object = None
        self._visible: frozenset[int] = frozenset()

    def visible(self, models: Mapping[int, DecodedModel], poses: Mapping[int, Pose]) -> frozenset[int]:
        """Return the numbers of the objects that the next frame shows, guessed ones among them.

        Parameters
        ----------
        models
            Decoded models by number, as of this frame.
        poses
            T_camera_object by number.
        """
        state = {number: (models[number].version, poses[number].tobytes()) for number in poses}
        if state != self._state:
            counts = self._look(models, poses)
            seen = {number: self._staying if number in self._visible else self._appearing for number in poses}
            self._state = state
            self._visible = frozenset(number for number, least in seen.items() if counts.get(number, 0) >= least)
        return self._visible

    def _look(self, models: Mapping[int, DecodedModel], poses: Mapping[int, Pose]) -> dict[int, int]:
        """Return by number how many rays meet an object."""
        drawable = self._drawable.refreshed(models, poses)
        met = self._renderer.cast(self._rays, drawable, poses)
        depth, labels = self._renderer.cast_guessed(self._rays, drawable, poses, *met)
        return dict(enumerate(np.bincount(labels[depth > 0]).tolist()))
