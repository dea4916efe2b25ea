# SPDX-License-Identifier: MIT
"""One folder with both kinds of pictures, told apart by words in their names: ``0000-color.png``, ``0000-depth.png``.

The words are color, color, rgb, image or img, and depth. The intrinsics are given, or stand in ``intrinsics.json``
there; depth is in millimeters unless the scale is given. Names that are times give the clock, else it is regular.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from threedvc.errors import SequenceError
from threedvc.formats.sources.assembly import assemble
from threedvc.formats.sources.association import PICTURE_SUFFIXES, list_pictures, pair_named
from threedvc.formats.sources.files.intrinsics import REMEDY, find_cameras
from threedvc.formats.sources.files.timestamps import clock_of
from threedvc.formats.sources.names import named_pictures
from threedvc.formats.sources.notices import Notice
from threedvc.formats.sources.recording import FrameFiles, Layout, Recording, SourceOptions
from threedvc.units import MILLIMETERS

__all__ = ["LAYOUT"]

DEPTH = re.compile(r"depth", re.IGNORECASE)
COLOR = re.compile(r"colou?r|rgb|image|img", re.IGNORECASE)
INTRINSICS_NAMES = ("intrinsics.json", "camera_intrinsic.json", "intrinsic.json")


def recognizes(folder: Path) -> bool:
    """Tell whether the folder itself holds pictures of both kinds."""
    names = [path.stem for path in folder.iterdir() if path.suffix.lower() in PICTURE_SUFFIXES]
    return any(map(DEPTH.search, names)) and any(COLOR.search(name) and not DEPTH.search(name) for name in names)


def read(folder: Path, options: SourceOptions) -> Recording:
    """List a recording in one folder; raises SequenceError or ConfigError."""
    pictures = list_pictures(folder)
    depths = [path for path in pictures if DEPTH.search(path.stem)]
    colors = [path for path in pictures if COLOR.search(path.stem) and not DEPTH.search(path.stem)]
    _require_both(folder, colors, depths)
    others = [path for path in pictures if not COLOR.search(path.stem) and not DEPTH.search(path.stem)]
    unread = (
        [Notice(f"{folder}: {len(others)} pictures of neither kind are not read ({others[0].name})")] if others else []
    )
    pairing = pair_named(named_pictures(folder, colors), named_pictures(folder, depths))
    own = next((folder / name for name in INTRINSICS_NAMES if (folder / name).is_file()), None)
    cameras = find_cameras(folder, options, pairing.pairs[0], own)
    if cameras is None:
        raise SequenceError(f"{folder}: no camera intrinsics; {REMEDY}")
    clock = clock_of(pairing.stamps, len(pairing.pairs), options.fps or cameras.fps, str(folder))
    frames = [
        FrameFiles(color=color, depth=depth, timestamp_ns=stamp, color_timestamp_ns=color_stamp)
        for (color, depth), (stamp, color_stamp) in zip(pairing.pairs, clock.stamps, strict=True)
    ]
    return assemble(
        folder, frames, cameras, options, depth_scale=MILLIMETERS, fps=clock.fps,
        notices=(*unread, *pairing.notices, *clock.notices),
    )  # fmt: skip


def _require_both(folder: Path, colors: Sequence[Path], depths: Sequence[Path]) -> None:
    if not colors or not depths:
        raise SequenceError(
            f"{folder}: {len(colors)} pictures named color, rgb or image and {len(depths)} named depth; name both "
            "kinds so"
        )


LAYOUT = Layout(name="flat", recognizes=recognizes, read=read, trial=90)
