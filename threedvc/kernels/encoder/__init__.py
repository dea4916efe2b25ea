# SPDX-License-Identifier: MIT
"""Kernels that only the encoder needs."""
