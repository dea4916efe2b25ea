# SPDX-License-Identifier: MIT
"""What frames packets in a file, in bytes: heads, checksums, the INDEX.

`threedvc.formats.container` writes it; tests hold these sizes against what it writes. Whoever has to meet a rate counts
with them before anything is written.
"""

from __future__ import annotations

from typing import Final

__all__ = [
    "COLOR_VIDEO_FRAMING_BYTES",
    "DEPTH_VIDEO_FRAMING_BYTES",
    "FILE_HEAD_BYTES",
    "INDEX_ENTRY_BYTES",
    "MAX_BATCH_FRAMING_BYTES",
    "MAX_END_BYTES",
    "MAX_INDEX_ENTRY_BYTES",
    "MAX_MEMBER_FRAMING_BYTES",
    "PACKET_FRAMING_BYTES",
]

FILE_HEAD_BYTES: Final = 12
"""Magic, 9 bytes, version, 2, and one that is zero."""
PACKET_FRAMING_BYTES: Final = 28
"""The head of a packet, 24, and the checksum of its body, 4."""

INDEX_ENTRY_BYTES: Final = 6
"""A usual entry of the INDEX: how far its frame and its place lie from those before, in variable-length integers."""
MAX_INDEX_ENTRY_BYTES: Final = 8
"""An entry of the INDEX at most: 4 bytes for up to 2^27 frames from one BATCH to the next, 4 for up to 256 MiB."""
MAX_BATCH_FRAMING_BYTES: Final = PACKET_FRAMING_BYTES + 12
"""A BATCH, with a map of its first frame, 5 bytes at most, and of up to 255 frames, 2; 5 more name the two."""
MAX_MEMBER_FRAMING_BYTES: Final = 20
"""A model update in a BATCH: type and flags, 2 bytes, a map of object and frame, 12 at most, two lengths, 1 and 5."""
MAX_END_BYTES: Final = 112
"""END with number of frames and digest (28 bytes), a pointer (8), and the INDEX (1): 93 with the frames of two packets,
and some to spare."""
DEPTH_VIDEO_FRAMING_BYTES: Final = 40
"""A usual DEPTH_VIDEO in a BATCH: a header of some 36 bytes tells its frames, its size and two depths; measured: 41."""
COLOR_VIDEO_FRAMING_BYTES: Final = 24
"""A usual COLOR_VIDEO in a BATCH: a header of some 18 bytes tells its frames and size; types and lengths take 6."""
