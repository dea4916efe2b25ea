# SPDX-License-Identifier: MIT
"""Kernels of ray casting and pictures."""
