# SPDX-License-Identifier: MIT
"""Label pictures that wait, packed: those of all frames of a sequence are kept."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

__all__ = ["PackedPicture", "packed"]

LEVEL = 1
"""Of zlib: labels are a few hundred bytes a frame at the quickest one (decision 0016)."""
Whole = TypeVar("Whole", np.uint8, np.uint16)


@dataclass(frozen=True)
class PackedPicture(Generic[Whole]):
    """A picture (h, w) as compressed bytes."""

    data: bytes
    shape: tuple[int, ...]
    dtype: np.dtype[Whole]

    def unpacked(self) -> NDArray[Whole]:
        """Return the picture, read-only."""
        return np.frombuffer(zlib.decompress(self.data), self.dtype).reshape(self.shape)


def packed(picture: NDArray[Whole]) -> PackedPicture[Whole]:
    """Pack a picture (h, w)."""
    return PackedPicture(zlib.compress(picture.tobytes(), LEVEL), picture.shape, picture.dtype)
