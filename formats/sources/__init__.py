# SPDX-License-Identifier: MIT
"""Readers of RGB-D recordings: one file per layout, all turned into `threedvc.frames.frame.Frame`."""

from __future__ import annotations

from threedvc.formats.layout_names import layout_names
from threedvc.formats.sources.opening import FrameRange, open_sequence
from threedvc.formats.sources.sequence import FolderSequence
from threedvc.formats.sources.several import open_sensors

__all__ = ["FolderSequence", "FrameRange", "layout_names", "open_sensors", "open_sequence"]
