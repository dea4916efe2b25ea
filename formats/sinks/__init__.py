# SPDX-License-Identifier: MIT
"""Writers of decoded or synthetic frames."""

from __future__ import annotations

from threedvc.formats.sinks.plain import PARTS, PlainSink

__all__ = ["PARTS", "PlainSink"]
