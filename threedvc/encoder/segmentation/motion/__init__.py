# SPDX-License-Identifier: MIT
"""Objects found by their motion: hypotheses, their evidence, what becomes of them."""
