# SPDX-License-Identifier: MIT
"""Depth as it was captured, where rigid models cannot tell it: what a frame of a depth video shows.

Sensors that guess between few measurements give a surface another shape in every frame. The stream may carry a video
of such depth beside the models: small pictures of levels, which stand for drawn depth in frames as captured.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from threedvc.errors import CorruptStream
from threedvc.kernels.render.depth_video import magnify
from threedvc.parallel import for_ranges

__all__ = [
    "EDGE",
    "TILE",
    "CapturedDepth",
    "DepthLaw",
    "depth_levels",
    "pack_tiles",
    "tile_grid",
    "tiles_of_pixels",
    "unpack_tiles",
]

EDGE = 1.1
"""Samples that differ by more than this factor lie on different surfaces. Every reader must use it
(docs/drawing.md)."""

TILE = 8
"""Samples along a side of a tile, a block of AV1: smaller ones cost it more than they leave out. Every reader must use
it."""


def tile_grid(rows: int, columns: int) -> tuple[int, int]:
    """Return how many tiles pictures of a size have, down and across; the last ones may be cut."""
    return -(-rows // TILE), -(-columns // TILE)


def pack_tiles(tiles: NDArray[np.bool_]) -> bytes:
    """Return tiles (down, across) as bits, row by row, the first one the highest of its byte; empty if all are set."""
    return b"" if tiles.all() else np.packbits(tiles.reshape(-1)).tobytes()


def unpack_tiles(packed: bytes, rows: int, columns: int) -> NDArray[np.bool_] | None:
    """Return the tiles (down, across) of `pack_tiles`, None for all.

    Raises
    ------
    CorruptStream
        If there are more or fewer bits than tiles, or bits set beyond them.
    """
    if not packed:
        return None
    down, across = tile_grid(rows, columns)
    bits = np.unpackbits(np.frombuffer(packed, np.uint8)).astype(np.bool_)
    if len(packed) != -(-down * across // 8) or bits[down * across :].any():
        raise CorruptStream(
            f"a depth video of {columns}x{rows} samples has {down * across} tiles, not what {len(packed)} bytes tell; "
            "the stream is damaged"
        )
    return bits[: down * across].reshape(down, across)


def tiles_of_pixels(sizes: tuple[int, int], shape: tuple[int, int]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the tile (h,) of each row and (w,) of each column of a depth map of `shape`, of a video of `sizes`."""
    down, across = (
        (2 * np.arange(pixels) + 1) * samples // (2 * pixels) // TILE
        for samples, pixels in zip(sizes, shape, strict=True)
    )
    return down, across


class DepthLaw(IntEnum):
    """How depths go with sample values from the first to the last: by one ratio, or by steps of their inverse root."""

    RATIO = 0
    INVERSE_ROOT = 1


def depth_levels(nearest_m: float, ratio: float, bits: int, law: int = DepthLaw.RATIO) -> NDArray[np.float64]:
    """Return the depths (2^bits,) in meters of sample values, by a `DepthLaw`.

    They ascend from `nearest_m` to as much as values make of it of which each is `ratio` times the one before.
    """
    geometric = np.multiply.accumulate(np.concatenate([[nearest_m], np.full((1 << bits) - 1, ratio)]))
    if law == DepthLaw.RATIO:
        return geometric
    first, last = 1 / np.sqrt(geometric[[0, -1]])
    roots = first - (first - last) * (np.arange(1 << bits) / ((1 << bits) - 1))
    return np.asarray(1 / (roots * roots))


@dataclass(frozen=True, kw_only=True, eq=False)
class CapturedDepth:
    """The depth of one frame.

    Attributes
    ----------
    samples
        (rows, columns) uint16, which cover the picture of the depth camera.
    levels
        (n,) float64 meters: what their values mean.
    complete
        Whether something is everywhere, also where nothing is drawn.
    tiles
        (down, across) bool: where it is shown; None: everywhere.
    """

    samples: NDArray[np.uint16]
    levels: NDArray[np.float64]
    complete: bool
    tiles: NDArray[np.bool_] | None = None

    def shown(self, drawn: NDArray[np.float32], threads: int) -> NDArray[np.float32]:
        """Return the depth (h, w) in meters of a frame for which the models' (h, w) is drawn; 0 = nothing there."""
        result = np.empty_like(drawn)

        def row_range(start: int, stop: int) -> None:
            magnify(start, stop, self.samples, self.levels, EDGE, self.complete, drawn, result)

        for_ranges(row_range, len(drawn), threads)
        if self.tiles is None:
            return result
        down, across = tiles_of_pixels(self.samples.shape, drawn.shape)
        return np.where(self.tiles[down][:, across], result, drawn)
