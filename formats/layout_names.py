# SPDX-License-Identifier: MIT
"""Names of the layouts that 3dvc reads, found without loading the readers: ``3dvc --help`` must not wait for them."""

from __future__ import annotations

import pkgutil
from pathlib import Path

__all__ = ["AUTO", "layout_modules", "layout_names"]

AUTO = "auto"
FOLDER = Path(__file__).parent / "sources" / "layouts"
OTHER_NAMES = {"seven-scenes": "7scenes"}
"""Names that no module can have."""


def layout_modules() -> dict[str, str]:
    """Return the module of each layout in `threedvc.formats.sources.layouts`, by the layout's name."""
    modules = sorted(module.name for module in pkgutil.iter_modules([str(FOLDER)]))
    names = (module.replace("_", "-") for module in modules)
    return {OTHER_NAMES.get(name, name): module for name, module in zip(names, modules, strict=True)}


def layout_names() -> tuple[str, ...]:
    """Return what a user may ask for: ``auto`` and the name of each layout."""
    return AUTO, *sorted(layout_modules())
