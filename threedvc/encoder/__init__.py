# SPDX-License-Identifier: MIT
"""From frames to packets; one package for each stage."""
