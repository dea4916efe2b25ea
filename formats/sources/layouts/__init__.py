# SPDX-License-Identifier: MIT
"""One module for each layout of a recording."""
