# SPDX-License-Identifier: MIT
"""Cells that frames hardly show: behind a surface, or beside it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from threedvc.arrays import Doubles
from threedvc.encoder.appearance.color_field import ColorField, FieldObject
from threedvc.encoder.appearance.fit_state import FitState
from threedvc.encoder.fusion.surface_extraction import REGION_SHIFT, Surface
from threedvc.geometry.pose import inverse

__all__ = ["drop_hidden_cells"]

MIN_SIGHT = 0.2
"""Share of the sight of the cells around that a cell needs; measured on the kitchen: each of the others, 2.8 % of the
cells, costs nearly twice an average one."""


def drop_hidden_cells(state: FitState) -> None:
    """Drop cells that frames show much less of than of others around.

    Only frames that show a cell at all speak about it: one that is seen but for a moment is as good as others.
    """
    field = ColorField(
        {
            number: FieldObject(surface=state.surfaces[number], voxel_size_m=item.evidence.voxel_size_m)
            for number, item in state.scene.objects.items()
        },
        state.threads,
    )
    regions = _regions(field, state.surfaces)
    shown, around = np.zeros(len(regions)), np.zeros(len(regions))
    for frame in range(len(state.frames)):
        if state.is_repeated(frame):
            continue
        sight = _sight(state, field, frame)
        seen = sight > 0
        means = np.bincount(regions, sight) / np.maximum(np.bincount(regions, seen), 1)
        shown[seen] += sight[seen]
        around[seen] += means[regions[seen]]
    visible = {}
    for number, surface in state.surfaces.items():
        mine = field.numbers_of(number, surface.cells)
        visible[number] = surface.part(shown[mine] > MIN_SIGHT * around[mine])
    state.replace_surfaces(visible)


def _regions(field: ColorField, surfaces: Mapping[int, Surface]) -> NDArray[np.int64]:
    """Return the number of the region (n,) that each numbered cell lies in, together with those around."""
    regions = np.zeros(len(field.values), dtype=np.int64)
    for number, surface in surfaces.items():
        _, member = np.unique(surface.cells >> REGION_SHIFT, axis=0, return_inverse=True)
        regions[field.numbers_of(number, surface.cells)] = regions.max(initial=-1) + 1 + member
    return regions


def _sight(state: FitState, field: ColorField, frame: int) -> Doubles:
    """Return how much a frame shows of each numbered cell (n,): the weights of the rays that it colors."""
    poses, caster, sight = state.poses_in(frame), state.depth_caster(frame), np.zeros(len(field.values))
    depth, labels = caster.cast(field.models, poses)
    points = caster.points(depth)
    for number, pose in poses.items():
        here, T = (labels == number) & (depth > 0), inverse(pose)
        numbers, weights = field.corners(number, points[here] @ T[:3, :3].T + T[:3, 3])
        sight += np.bincount(numbers.ravel(), weights.ravel(), len(sight))
    return sight
