# SPDX-License-Identifier: MIT
"""Payloads of META packets: compressed by Zstandard, with a size that is checked before memory is taken."""

from __future__ import annotations

import zstandard

from threedvc.errors import CorruptStream

__all__ = ["compress", "decompress"]

ZSTD_LEVEL = 19
"""Payloads are small and packed once: the highest level of Zstandard but for those it calls ultra."""


def compress(content: bytes) -> bytes:
    """Return the payload of some content; it states the size of the content."""
    return zstandard.ZstdCompressor(level=ZSTD_LEVEL).compress(content)


def decompress(payload: bytes, max_bytes: int, name: str) -> bytes:
    """Return the content of a payload.

    Parameters
    ----------
    payload
        As `compress` makes it.
    max_bytes
        What the content may take.
    name
        What it is, for messages.

    Raises
    ------
    CorruptStream
        If it is damaged, does not state its size or states more than `max_bytes`.
    """
    try:
        # The size that the Zstandard frame states rules its allocation, whatever limit is passed.
        size = zstandard.frame_content_size(payload)
        if not 0 <= size <= max_bytes:
            told = f"states {size} bytes" if size > 0 else "does not state its size"
            raise CorruptStream(f"{name} {told}, at most {max_bytes} are accepted")
        return zstandard.ZstdDecompressor().decompress(payload, allow_extra_data=False)
    except zstandard.ZstdError as error:
        raise CorruptStream(f"{name} cannot be read: {error}") from None
