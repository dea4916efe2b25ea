# SPDX-License-Identifier: MIT
"""Readers of single files: text, pictures, poses, cameras, masks, times."""
