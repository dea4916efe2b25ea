# SPDX-License-Identifier: MIT
"""Units that are counted in more than one place, each said once."""

from __future__ import annotations

from typing import Final

__all__ = ["LUMA_WEIGHTS", "MILLIMETERS", "NANOSECONDS"]

NANOSECONDS: Final = 1_000_000_000
"""In a second."""
MILLIMETERS: Final = 1000.0
"""In a meter."""
LUMA_WEIGHTS: Final = (0.299, 0.587, 0.114)
"""Shares of red, green and blue in luma (ITU-R BT.601)."""
