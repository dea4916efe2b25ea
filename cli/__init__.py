# SPDX-License-Identifier: MIT
"""The command `3dvc`: one file per subcommand, each parses, calls the library and prints."""

__all__: list[str] = []
