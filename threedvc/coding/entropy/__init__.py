# SPDX-License-Identifier: MIT
"""The binary range coder and the mixing of predictions."""
