# SPDX-License-Identifier: MIT
"""Packets in their order, and what the decoder has been sent."""
