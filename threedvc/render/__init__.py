# SPDX-License-Identifier: MIT
"""Pictures out of decoded models: first-opacity ray casting, shading, filling of holes."""
