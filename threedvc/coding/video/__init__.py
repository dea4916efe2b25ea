# SPDX-License-Identifier: MIT
"""Runs of pictures predicted from each other: their samples, and AV1 as their coder."""
