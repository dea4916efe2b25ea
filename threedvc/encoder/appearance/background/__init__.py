# SPDX-License-Identifier: MIT
"""What stands for a background at rest: its image, and its depth map."""
