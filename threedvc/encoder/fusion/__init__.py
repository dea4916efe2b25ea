# SPDX-License-Identifier: MIT
"""Evidence of occupancy and colour, fused from every frame, and surfaces out of it."""
