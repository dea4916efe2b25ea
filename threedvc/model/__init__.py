# SPDX-License-Identifier: MIT
"""What both sides hold: blocks of cells, their colours, and updates of them."""
