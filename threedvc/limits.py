# SPDX-License-Identifier: MIT
"""How large the parts of a stream may be.

Readers check these before they allocate, so that a damaged or hostile file costs no more memory
than the bytes it really holds; writers check them so that no file is made that a reader refuses.
docs/format.md lists the same numbers.
"""

from __future__ import annotations

from typing import Final

__all__ = [
    "MAX_BATCH_PACKETS",
    "MAX_COLOR_VIDEO_SAMPLES",
    "MAX_COUNT",
    "MAX_DEPTH_SAMPLES",
    "MAX_EXPANSION",
    "MAX_FRAME",
    "MAX_HEADER_BYTES",
    "MAX_HEADER_DEPTH",
    "MAX_HEADER_ITEMS",
    "MAX_INDEX_ENTRIES",
    "MAX_MAGNIFICATION",
    "MAX_OBJECT_ID",
    "MAX_PAYLOAD_BYTES",
    "MAX_RELIEF_BITS",
    "MAX_SENSORS",
    "MAX_SEQUENCE_SAMPLES",
    "MAX_TEXTURE_BITS",
    "MAX_TILE_BYTES",
    "MAX_VIDEO_SIDE",
]

MAX_HEADER_BYTES: Final = 4096
"""Bytes of a packet's header."""

MAX_HEADER_DEPTH: Final = 4
"""Levels of maps and lists in a header, the header itself included."""

MAX_HEADER_ITEMS: Final = 256
"""Items of one list or map in a header."""

MAX_PAYLOAD_BYTES: Final = 1 << 26
"""Bytes of a packet's payload, as stored and after decompression."""

MAX_EXPANSION: Final = 256
"""Bytes of a payload after decompression per byte stored."""

MAX_BATCH_PACKETS: Final = 1 << 16
"""Packets in one BATCH."""

MAX_INDEX_ENTRIES: Final = 1 << 20
"""Entries of the INDEX."""

MAX_OBJECT_ID: Final = 65535
"""Largest number of an object."""

MAX_FRAME: Final = (1 << 31) - 1
"""Largest number of a frame."""

MAX_COUNT: Final = 1 << 20
"""Frames that one packet speaks of, or that pass without a BATCH; poses in a BATCH."""

MAX_RELIEF_BITS: Final = 3
"""Binary logarithm of the places in a cell where a surface may pass."""

MAX_SENSORS: Final = 256
"""Sensors of a stream."""

MAX_TEXTURE_BITS: Final = 2
"""Binary logarithm of the number of texels along an edge of a cell."""

MAX_TILE_BYTES: Final = 2048
"""Bytes that tell the tiles of a depth video, one bit each."""

MAX_VIDEO_SIDE: Final = 4096
"""Columns or rows of a video."""

MAX_DEPTH_SAMPLES: Final = 1 << 20
"""Samples of a depth picture."""

MAX_COLOR_VIDEO_SAMPLES: Final = 1 << 31
"""Samples of luma in all color videos of a BATCH; they are decoded one picture at a time."""

MAX_MAGNIFICATION: Final = 12
"""By how many quarters chroma of a color video may be magnified."""

MAX_SEQUENCE_SAMPLES: Final = 1 << 26
"""Samples of all pictures of a run that are predicted from each other."""
