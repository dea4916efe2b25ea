# SPDX-License-Identifier: MIT
"""Payload of a relief: where in their cells the surface of an object passes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from threedvc.coding.entropy.range_coder import RangeCoder, RangeReader, RangeWriter, new_counters
from threedvc.errors import CorruptStream
from threedvc.kernels.coding.relief import RELIEF_COUNTERS, ReliefCells, code_relief
from threedvc.model.decoded_model import DecodedModel

__all__ = ["decode_relief", "encode_relief"]

BYTES_PER_CELL = 8
"""Room for one: three bits of at most 11 bits each take 5."""
PRICE = 0.003
"""What a bit may save, in squared cells; a level of 2 bits is wrong by 0.005 on an average."""


def encode_relief(model: DecodedModel, subvoxel_offsets: NDArray[np.float32]) -> bytes:
    """Encode the relief of the cells of an object that have none, and give it to them.

    Parameters
    ----------
    model
        The object as the decoder has it; changed.
    crossings
        (n, 3) where the surface passes along each axis from the centers of its untold cells, in cells, see
        `DecodedModel.cells_without_offset`; at least one.

    Returns
    -------
    bytes
        For `decode_relief`.
    """
    writer = RangeWriter()
    model.shape(*_code(writer, model, subvoxel_offsets))
    return writer.finish()


def decode_relief(payload: bytes, model: DecodedModel) -> None:
    """Give the cells of an object that have none their relief; see `encode_relief`.

    Raises
    ------
    CorruptStream
        If the payload is damaged.
    """
    reader = RangeReader(payload)
    positions, relief = _code(reader, model, None)
    reader.finish()
    model.shape(positions, relief)


def _code(
    coder: RangeCoder, model: DecodedModel, subvoxel_offsets: NDArray[np.float32] | None
) -> tuple[NDArray[np.int64], NDArray[np.uint8]]:
    """Return where the untold cells are in the model, and their relief."""
    model.fit_planes()
    cells, positions = model.cells_without_offset()
    wishes = np.zeros((len(cells), 3), dtype=np.float32) if subvoxel_offsets is None else subvoxel_offsets
    coder.reserve(BYTES_PER_CELL * len(cells))
    relief = model.relief.copy()
    job = ReliefCells(
        cells=cells,
        positions=positions,
        tables=model.index.tables,
        occupied=model.occupied.reshape(-1),
        planes=model.planes.reshape(-1, 4),
        relief=relief.reshape(-1),
    )
    if not code_relief(coder.coder, job, model.relief_bits, wishes, PRICE, new_counters(RELIEF_COUNTERS)):
        raise CorruptStream("the relief of an object ends too early; the stream is damaged")
    return positions, relief.reshape(-1)[positions]
