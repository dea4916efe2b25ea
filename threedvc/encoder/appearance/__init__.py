# SPDX-License-Identifier: MIT
"""Colours, light and background fitted to the pictures as the decoder will draw them."""
