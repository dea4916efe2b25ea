# SPDX-License-Identifier: MIT
"""Payload of a texture: colors of the texels of cells whose own colors are known."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from threedvc.coding.color import ColorSettings, code_cell_colors
from threedvc.coding.entropy.range_coder import RangeCoder, RangeReader, RangeWriter
from threedvc.coding.morton import Cube, morton_codes
from threedvc.coding.octree import Octree
from threedvc.errors import LimitExceeded
from threedvc.kernels.coding.octree import COORDINATE_BITS
from threedvc.model.decoded_model import DecodedModel

__all__ = ["decode_texture", "encode_texture"]


def encode_texture(
    model: DecodedModel, texels: NDArray[np.int32], colors: NDArray[np.int16], settings: ColorSettings
) -> tuple[bytes, NDArray[np.int16]]:
    """Encode the colors of texels.

    Parameters
    ----------
    model
        The object as the decoder has it.
    texels
        (n, 3) int32 its bare texels, see `DecodedModel.uncolored_texels`; at least one.
    colors
        (n, 3) int16 RGB.
    settings
        How finely colors are coded.

    Returns
    -------
    payload
        Bytes for `decode_texture`.
    decoded
        (n, 3) int16 colors as the decoder will see them.
    """
    writer = RangeWriter()
    decoded = _code(writer, model, texels, colors, settings)
    return writer.finish(), decoded


def decode_texture(payload: bytes, model: DecodedModel, texels: NDArray[np.int32]) -> NDArray[np.int16]:
    """Return the colors (n, 3) of texels (n, 3); see `encode_texture`.

    Raises
    ------
    CorruptStream
        If the payload is damaged.
    LimitExceeded
        If the cells lie too far apart.
    """
    reader = RangeReader(payload)
    decoded = _code(reader, model, texels, np.zeros((len(texels), 3), dtype=np.int16), ColorSettings())
    reader.finish()
    return decoded


def _code(
    coder: RangeCoder,
    model: DecodedModel,
    texels: NDArray[np.int32],
    colors: NDArray[np.int16],
    settings: ColorSettings,
) -> NDArray[np.int16]:
    assert model.texture is not None
    scale = model.texture.scale
    cube = Cube.around(model.cells()[0])
    levels = scale.bit_length() - 1
    depth = cube.depth + levels
    if depth > COORDINATE_BITS:
        raise LimitExceeded("the cells of a textured object lie too far apart; use larger cells or no texture")
    origin = (scale * cube.origin[0], scale * cube.origin[1], scale * cube.origin[2])
    settings = settings.code(coder)
    codes = morton_codes(texels, origin)
    order = np.argsort(codes, kind="stable")
    painted, painted_colors = model.texture.texels()
    state_codes = morton_codes(painted, origin)
    state_order = np.argsort(state_codes, kind="stable")
    tree = Octree(codes[order], depth)
    cells = np.unique(texels // scale, axis=0)
    cells = cells[np.argsort(morton_codes(cells, cube.origin), kind="stable")]
    own = model.color.reshape(-1, 3)[model.index.locate(cells)]
    decoded = np.empty_like(colors)
    decoded[order] = code_cell_colors(
        coder,
        tree,
        colors[order],
        Octree(state_codes[state_order], depth),
        painted_colors[state_order],
        settings,
        own,
        levels,
    )
    return decoded
