# SPDX-License-Identifier: MIT
"""Evidence of occupancy and color, fused from every frame, and surfaces out of it."""
