# SPDX-License-Identifier: MIT
"""A layer of cells out of a depth picture, the same on both sides."""

from __future__ import annotations

import numpy as np

from threedvc.coding.depth_picture import DepthPicture
from threedvc.errors import CorruptStream, LimitExceeded
from threedvc.geometry.camera import Camera
from threedvc.geometry.pose import Pose
from threedvc.kernels.coding.depth_cells import DepthView, count_places, spread_depths
from threedvc.model.block_index import CELL_LIMIT, morton_keys
from threedvc.model.decoded_model import DecodedModel
from threedvc.model.model_update import ModelUpdate

__all__ = ["spread"]

MAX_PLACES = 1 << 26
"""How many cells may be looked at: some seconds' worth."""
USUAL_CELLS = 1 << 17
"""For how many there is room at first."""


def spread(picture: DepthPicture, model: DecodedModel, camera: Camera, T_camera_object: Pose) -> None:
    """Give an object without cells those that a depth picture shows, without colors.

    Parameters
    ----------
    picture
        What a camera sees of the object.
    model
        The object, which must have relief; changed.
    camera
        The camera; its lens's distortion does not count.
    T_camera_object
        Where the object is.

    Raises
    ------
    CorruptStream
        If the object has cells already, or no relief.
    LimitExceeded
        If the cells are too small for the picture.
    """
    if model.cell_count or not model.relief_bits:
        raise CorruptStream("a depth picture is of an object that has cells already, or no relief")
    view = DepthView(
        samples=picture.samples,
        unit=1.0 / (1 << picture.scale_bits),
        lens=np.array([camera.fx, camera.fy, camera.cx, camera.cy]) / picture.spacing,
        T_camera_object=np.ascontiguousarray(T_camera_object[:3]),
        cell_size_m=model.voxel_size_m,
        levels=1 << model.relief_bits,
    )
    if not count_places(view) <= MAX_PLACES:
        raise LimitExceeded("a depth picture makes too many cells; use larger ones")
    room, count = 0, USUAL_CELLS
    while count > room:
        room = count
        cells, relief = np.empty((room, 3), dtype=np.int32), np.empty(room, dtype=np.uint8)
        count = spread_depths(view, cells, relief)
    cells, relief = cells[:count], relief[:count]
    if count and np.abs(cells.astype(np.int64)).max() >= CELL_LIMIT:
        raise LimitExceeded("a depth picture shows something too far away for its cells; use larger ones")
    _, first = np.unique(morton_keys(cells), return_index=True)
    cells, relief = cells[first], relief[first]
    none = np.empty((0, 3), dtype=np.int32)
    model.apply(
        ModelUpdate(
            added=cells,
            added_colors=np.zeros((len(cells), 3), dtype=np.int16),
            removed=none,
            recolored=none,
            recolored_colors=none.astype(np.int16),
        )
    )
    model.shape(model.index.locate(cells), relief)
