# SPDX-License-Identifier: MIT
"""Types of arrays that many stages name."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

__all__ = ["Doubles", "Floats", "Labels", "Mask"]

Doubles: TypeAlias = NDArray[np.float64]
"""What is solved or summed up."""
Floats: TypeAlias = NDArray[np.float32]
"""Pictures: depth in meters, luma in levels."""
Mask: TypeAlias = NDArray[np.bool_]
"""Which pixels count."""
Labels: TypeAlias = NDArray[np.uint16]
"""Numbers of objects or surfaces at pixels."""
