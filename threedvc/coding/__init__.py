# SPDX-License-Identifier: MIT
"""Payloads: entropy coding of model updates, poses and pictures, the same on both sides of a stream."""
