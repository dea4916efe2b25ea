# SPDX-License-Identifier: MIT
"""Colors, light and background fitted to the pictures as the decoder will draw them."""
