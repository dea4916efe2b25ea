# SPDX-License-Identifier: MIT
"""The scene, and passes over all of its frames: refinement, loop closure, calibration."""
