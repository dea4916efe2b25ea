# SPDX-License-Identifier: MIT
"""Choices by which colors come back exactly, beside coarse models: for tests that look at the colors alone."""

from __future__ import annotations

from threedvc.config import ColorVideo, EncoderConfig, Motion, VideoConfig

__all__ = ["EXACT_COLORS"]

EXACT_COLORS = EncoderConfig(
    voxel_size_m=0.06,
    motion=Motion.KNOWN,
    color_video=ColorVideo.ON,
    video=VideoConfig(lossless=True),
    refine=False,
    threads=2,
)
