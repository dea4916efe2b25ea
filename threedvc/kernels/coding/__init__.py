# SPDX-License-Identifier: MIT
"""Kernels of entropy coding and of payloads."""
