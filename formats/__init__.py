# SPDX-License-Identifier: MIT
"""Files: the .3dvc container, and where frames come from and go to."""

__all__: list[str] = []
