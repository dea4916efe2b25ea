# SPDX-License-Identifier: MIT
"""From packets to frames."""
