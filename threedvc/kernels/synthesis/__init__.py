# SPDX-License-Identifier: MIT
"""Kernels that make exact frames of scenes of our own."""
