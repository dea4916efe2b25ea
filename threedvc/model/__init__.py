# SPDX-License-Identifier: MIT
"""What both sides hold: blocks of cells, their colors, and updates of them."""
