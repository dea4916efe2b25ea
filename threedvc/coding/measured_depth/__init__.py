# SPDX-License-Identifier: MIT
"""Depth as it was measured, within a bound or without loss (RESIDUAL packets)."""
