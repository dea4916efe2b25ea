# SPDX-License-Identifier: MIT
"""Coding of the filter of drawn pictures."""

from __future__ import annotations

import numpy as np

from threedvc.coding.entropy.range_coder import RangeCoder, RangeReader, RangeWriter, new_counters
from threedvc.errors import CorruptStream
from threedvc.kernels.coding.range_coder import NUMBER_COUNTERS
from threedvc.model.post_filter import PAIRS, PIXEL_CLASSES, PostFilter

__all__ = ["MAX_FACTOR", "decode_filter", "encode_filter"]

MAX_FACTOR = 127
"""Of 64: twice the difference to the pixels around, which no filter that mends a picture needs. Part of the format."""


def encode_filter(filters: PostFilter, gray: bool) -> bytes:
    """Return the payload of a filter; gray streams have that of luma alone.

    Raises
    ------
    ValueError
        If a factor is not within +-`MAX_FACTOR`.
    """
    if max(int(np.abs(filters.luma).max()), int(np.abs(filters.chroma).max())) > MAX_FACTOR:
        raise ValueError(f"factors of a filter must be within +-{MAX_FACTOR}")
    writer = RangeWriter()
    _code(writer, filters, gray)
    return writer.finish()


def decode_filter(payload: bytes, gray: bool) -> PostFilter:
    """Return the filter of a payload.

    Raises
    ------
    CorruptStream
        If the payload does not hold one.
    """
    reader = RangeReader(payload)
    filters = _code(reader, PostFilter.none(), gray)
    reader.finish()
    return filters


def _code(coder: RangeCoder, filters: PostFilter, gray: bool) -> PostFilter:
    """Code for every class of pixels if it has a filter, then its factors: of luma, and of chroma against those."""
    luma, chroma = (np.zeros((PIXEL_CLASSES, PAIRS), dtype=np.int32) for _ in range(2))
    counters = [new_counters(NUMBER_COUNTERS) for _ in range(2)]
    for pixel_class in range(PIXEL_CLASSES):
        if not coder.bit(bool(filters.luma[pixel_class].any() or filters.chroma[pixel_class].any())):
            continue
        for pair in range(PAIRS):
            given = int(filters.luma[pixel_class, pair]), int(filters.chroma[pixel_class, pair])
            of_luma = coder.signed(given[0], counters[0])
            of_chroma = of_luma + (0 if gray else coder.signed(given[1] - given[0], counters[1]))
            coder.check()
            if max(abs(of_luma), abs(of_chroma)) > MAX_FACTOR:
                raise CorruptStream("the factors of a filter are out of range; the stream is damaged")
            luma[pixel_class, pair], chroma[pixel_class, pair] = of_luma, of_chroma
    return PostFilter(luma=luma, chroma=chroma)
