# SPDX-License-Identifier: MIT
"""Pictures as they were captured, beside the models: color and depth videos, measured depth."""
