# SPDX-License-Identifier: MIT
"""Which pixel shows which object: masks, depth ranges, motion."""
