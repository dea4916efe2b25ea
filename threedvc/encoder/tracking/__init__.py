# SPDX-License-Identifier: MIT
"""Poses of the camera and of objects: registration of depth and luma against the models."""
