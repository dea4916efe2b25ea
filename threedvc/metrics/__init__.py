# SPDX-License-Identifier: MIT
"""Quality of pictures, depth and trajectories, and entropy."""
