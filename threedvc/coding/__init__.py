# SPDX-License-Identifier: MIT
"""Payloads: entropy coding of model updates and poses, the same on both sides of a stream."""

from __future__ import annotations

from threedvc.coding.color import ColorSettings
from threedvc.coding.morton import morton_codes, morton_order
from threedvc.coding.poses import PoseCoder
from threedvc.coding.update import decode_update, encode_update, encode_update_with_result

__all__ = [
    "ColorSettings",
    "PoseCoder",
    "decode_update",
    "encode_update",
    "encode_update_with_result",
    "morton_codes",
    "morton_order",
]
