# SPDX-License-Identifier: MIT
"""Runs of pictures: their samples, and what codes them: AV1, FFV1, or the JPEG files that they came in."""
