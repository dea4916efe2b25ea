# SPDX-License-Identifier: MIT
"""Registration of the depth and luma of a frame with a view of a model."""
