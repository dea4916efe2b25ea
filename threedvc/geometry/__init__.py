# SPDX-License-Identifier: MIT
"""Rigid poses and cameras."""
