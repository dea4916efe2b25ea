# SPDX-License-Identifier: MIT
"""The layouts that 3dvc reads, and which of them a folder has."""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

from threedvc.errors import ConfigError, SequenceError
from threedvc.formats.layout_names import AUTO, layout_modules, layout_names
from threedvc.formats.sources.layouts import bare
from threedvc.formats.sources.recording import Layout, SourceOptions

__all__ = ["LAYOUTS", "find_layout"]


def _layouts() -> Iterator[Layout]:
    """Yield the layout of every module in `threedvc.formats.sources.layouts`, which calls it ``LAYOUT``."""
    for name, module in layout_modules().items():
        layout: Layout = import_module(f"threedvc.formats.sources.layouts.{module}").LAYOUT
        assert layout.name == name, f"{module}.LAYOUT is called {layout.name}, expected {name}"
        yield layout


LAYOUTS: tuple[Layout, ...] = tuple(sorted(_layouts(), key=lambda layout: layout.trial))
"""In the order in which they are tried."""

EXPORTS = (
    (("rgb.mp4", "odometry.csv"), "a recording of Stray Scanner, whose color is a video; take its frames out as "
     "color/NNNNNN.jpg, numbered as depth/ is, and give --intrinsics"),
    (("rgbd", "metadata*"), "an export of Record3D, whose depth is compressed; let it export PNG sequences, or convert "
     "rgbd/*.depth to 16-bit PNG"),
    (("*.bag",), "a rosbag; take its pictures out as color/NNNNNN.png and depth/NNNNNN.png first"),
    (("*.mcap",), "an MCAP recording; take its pictures out as color/NNNNNN.png and depth/NNNNNN.png first"),
    (("*.mkv",), "a video; take its pictures out as color/NNNNNN.png and depth/NNNNNN.png first"),
    (("*.mp4",), "a video; give 16-bit depth pictures beside its frames, as color/NNNNNN.png and depth/NNNNNN.png"),
    (("*.r3d",), "an export of Record3D; let it export PNG sequences"),
    (("*.sens",), "a .sens file of ScanNet; export it with its SensReader"),
)  # fmt: skip
"""What other programs leave, by the files that tell it, and what to do."""
RTABMAP = ("rgb", "depth", "calib", "poses.txt")
"""What RTAB-Map exports: poses.txt has times, where that of the plain layout has the frames' numbers."""


def find_layout(folder: Path, name: str, options: SourceOptions) -> Layout:
    """Return the layout of a name, or for ``auto`` the first that recognizes the folder.

    Raises
    ------
    ConfigError
        If there is no layout of that name, or it does not take the folders given.
    SequenceError
        If no layout recognizes the folder.
    """
    gives_folders = options.color is not None or options.depth is not None
    if name == AUTO:
        return _recognized(folder, gives_folders)
    layout = next((layout for layout in LAYOUTS if layout.name == name), None)
    if layout is None:
        raise ConfigError(f"--layout {name}: no such layout; choose one of {', '.join(layout_names())}")
    if gives_folders and not layout.takes_folders:
        raise ConfigError(f"--layout {name}: finds its pictures itself; leave out --color and --depth")
    return layout


def _recognized(folder: Path, gives_folders: bool) -> Layout:
    if not gives_folders and all((folder / name).exists() for name in RTABMAP):
        raise SequenceError(
            f"{folder}: holds an export of RTAB-Map; give --layout bare and --intrinsics FILE or fx,fy,cx,cy, as "
            "calib/ has them (its poses.txt is not read)"
        )
    candidates = [layout for layout in LAYOUTS if layout.takes_folders or not gives_folders]
    found = next((layout for layout in candidates if layout.recognizes(folder)), None)
    if found is not None:
        return found
    if gives_folders:
        return bare.LAYOUT
    raise SequenceError(f"{folder}: {_guess(folder)}")


def _guess(folder: Path) -> str:
    inside = [child for child in sorted(folder.iterdir()) if child.is_dir()]
    export = next((told for marks, told in EXPORTS if all(any(folder.glob(mark)) for mark in marks)), None)
    if export is not None:
        return f"holds {export}"
    deeper = next((child for child in inside if any(layout.recognizes(child) for layout in LAYOUTS)), None)
    if deeper is not None:
        return f"is not a recording, but {deeper} looks like one; give that folder"
    return "is in no layout that 3dvc knows; name it with --layout, or give --color DIR and --depth DIR"
