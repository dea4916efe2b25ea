# SPDX-License-Identifier: MIT
"""The encoder: live frame by frame, or a file in passes."""
