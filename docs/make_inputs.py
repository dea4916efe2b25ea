# SPDX-License-Identifier: MIT
"""Write docs/inputs.md: what is made of recordings as people have them, from programs that make such recordings.

Usage: python docs/make_inputs.py [FOLDER]

The folder of these programs is that of the argument, ``$THREEDVC_FIELD`` or ``../shared/field``. Each writes a
recording into the folder of its first argument; variants are its second one. Without the folder nothing is written.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import runpy
import sys
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest import mock
from warnings import catch_warnings, simplefilter

from threedvc.config import EncoderConfig
from threedvc.errors import ThreedvcError
from threedvc.formats.pose_check import settle_poses
from threedvc.formats.sources import open_sequence
from threedvc.formats.sources.notices import notices_of

__all__ = ["CASES", "Case", "field_folder", "inputs_document", "main"]

REPOSITORY = Path(__file__).resolve().parent.parent
DOCUMENT = REPOSITORY / "docs" / "inputs.md"
RECORDING = "RECORDING"
INTRODUCTION = """\
# Recordings as people have them

Each line is a recording as some program, data set or user leaves it, and what `3dvc encode` makes of it. "read" means:
the right frames, poses and times, without a word. A note tells a decision, a warning a doubt; both go to standard error
and into `--json`. What is refused is refused before anything is encoded, with exit code 1. Written by
`docs/make_inputs.py`.

## What names and stamps mean

- Numbers that are the same in all file names say nothing. The one that changes is the frame's number: 100 110 120 are
  frames with gaps. Times are decimal seconds (5.033), dates with a time of day, whole nano-, micro- or milliseconds;
  0 33 67 are milliseconds, 0 100 200 are taken for frame numbers, with a warning.
- Pictures named by time pair within 20 ms. Numbers that do not agree are an error that shows both sides.
- The frame rate is that of the time stamps. One that is told counts if the stamps agree with it within 5 %.
- Depth of 0 and 65535 is no measurement. A scale that is told is believed; one of a layout is held against reason.

## What is done with doubtful poses

A few pairs of frames are held against each other under the given poses. If much more of their depth disagrees than
under another reading of the poses, or than after a registration, `--motion known` is an error and `auto` warns and
tracks the camera. `--poses READING` says what poses are: `as-given`, `inverted` (world-to-camera), `opengl` (y up, z
back), `w-first` (quaternions w x y z), `millimeters`, `centimeters`, `body` (x forward, y left, z up), `left-handed`,
or several joined by `+`. Frames without a pose get one between their neighbors', or by registration with them.

## Recordings

| recording | what is odd about it | result |
|---|---|---|
"""
CAMERA = {"intrinsics": "131.2,131.2,79.5,59.5"}


@dataclass(frozen=True)
class Case:
    """A program that makes a recording, its variant, what is odd about it, and the options to read it with."""

    program: str
    variant: str
    oddity: str
    options: Mapping[str, Any]
    inside: str = ""

    @property
    def name(self) -> str:
        """What the line of the document is called."""
        return " ".join(filter(None, [self.program, self.variant]))


def _cases() -> Iterator[Case]:
    for program, oddities in ODDITIES.items():
        options = CAMERA if program in WITHOUT_CAMERA else {}
        for variant, oddity in ({"": oddities} if isinstance(oddities, str) else oddities).items():
            own = OPTIONS.get((program, variant), options)
            yield Case(program, variant, oddity, own, "seq" if program == "seven_own_K" else "")


WITHOUT_CAMERA = ("bom_text", "float_names", "icl_first", "layouts", "scannet_dir", "tum_base", "tum_var")
OPTIONS: dict[tuple[str, str], Mapping[str, Any]] = {
    ("stats_options", ""): {"depth_scale": 5000.0},
    ("stats_options", "bare"): {"depth_scale": 5000.0, **CAMERA},
    **{("layouts", kind): {} for kind in ("tiff", "npy", "webp", "bmp", "pgm")},
}
ODDITIES: dict[str, str | dict[str, str]] = {
    "control": "nothing",
    "control3": "nothing",
    "tum_base": "nothing",
    "poses_w2c": "poses are world-to-camera",
    "poses_opengl": "camera axes of OpenGL",
    "poses_mm": "poses in millimeters",
    "poses_offset": "poses of the next frame each",
    "bop_masks": "a mask for each object, FFFFFF_OOOOOO.png",
    "mask_suffix": "masks with a version in their names",
    "mask_strays": "masks of frames that are not there",
    "mask_misnamed": "masks numbered from 1, frames from 0",
    "mask_jpg": "masks are JPEG",
    "mask_16": "masks of 16 bits",
    "mask_1bit": "masks of 1 bit",
    "mask_255": "one object, labeled 255",
    "mask_rgb": "masks of 3 channels",
    "float_names": "names are seconds without trailing zeros",
    "rowmajor": "intrinsic_matrix written by rows",
    "nested_matrix": "intrinsic_matrix as nested rows",
    "extr_mm": {"": "T_color_depth in millimeters", "m": "T_color_depth in meters"},
    "depth_65535": "65535 where nothing was measured",
    "depth_late": {"": "no depth in the first frames", "5": "5 specks of depth in them", "40": "40 specks of it"},
    "fps_missing": {"": "10 frames a second by the stamps alone", "with": "and by intrinsics.json"},
    "stamps_ms": "stamps in milliseconds",
    "stamps_dup": "two frames at one time",
    "stats_options": {"": "the depth scale is not told", "bare": "nor are the cameras"},
    "icl_first": {"": "no pose for the first frame", "all": "poses of all frames"},
    "scannet_dir": "poses in pose/, some infinite",
    "seven_own_K": "7-Scenes' names, another camera beside",
    "endo": "a scene of 25 to 50 mm",
    "kitti_sparse": "depth on single pixels",
    "jpg_fill": {"": "fill bytes before JPEG markers", "end": "fill bytes before the last marker"},
    "bom_text": {"": "lists with a byte order mark", "nobom": "lists from Windows without one"},
    "bom_plain": {"": "poses.txt and intrinsics.json with a byte order mark", "poses.txt": "poses.txt with one"},
    "name_bytes": "made as usual, then copied to a name that is no UTF-8",
    "layouts": {
        "bop": "a scene of BOP",
        "stray": "Stray Scanner",
        "record3d": "Record3D",
        "nerfstudio": "nerfstudio",
        "rtabmap": "RTAB-Map",
        "onefolder": "NNNNN-color.png and NNNNN-depth.png",
        "realsense_viewer": "take_Color_SECONDS.png of the RealSense viewer",
        "tiff": "depth as TIFF",
        "npy": "depth as NumPy arrays",
        "webp": "color as WebP",
        "bmp": "color as bitmaps",
        "pgm": "depth as portable gray maps",
    },
    "sizes": {"8 160 120": "nothing", "4 320 240 128 96": "depth smaller than color", "1 160 120": "a single frame"},
    "scenes": {
        "person": "somebody walks through",
        "lightsoff": "the light goes off",
        "unregistered": "the color camera stands 50 mm beside",
        "euclid": "depth along the ray",
        "teleport": "poses jump by 0.3 m",
        "rest": "nothing moves",
        "restnoise": "nothing moves, with noise",
        "far": "40 to 90 m away",
        "edge": "a white wall",
        "quant": "depth in steps of 8 mm",
        "oneside": "no depth in the left half",
    },
    "pics": {
        "rgba": "color with alpha", "palette": "color with a palette", "grayalpha16depth": "depth with alpha",
        "grey": "gray color", "greymix": "some color pictures gray", "color16": "color of 16 bits",
        "interlaced": "interlaced depth", "jpgdepth": "depth as JPEG", "depth8": "depth of 8 bits",
        "depthrgb16": "depth in three channels", "depthrgb8": "depth in channels of 8 bits",
        "mixed": "PNG and JPEG mixed", "progressive": "progressive JPEG", "restart": "JPEG with restart markers",
        "greyjpg": "gray JPEG", "exif": "EXIF orientation 6", "fill": "JPEG fill bytes", "noeoi": "JPEG without end",
        "trailing": "bytes after the JPEG's end", "misnamed": "JPEG named .png", "upper": ".PNG", "jpegext": ".JPEG",
        "hidden": "files of file managers", "dirpng": "a folder named .png", "unpadded": "names 5 to 12",
        "gaps": "names 100, 110, 120", "symlink": "links to pictures", "brokenlink": "a broken link",
        "zerobyte": "an empty picture", "truncated": "half a picture", "dark": "black color",
        "covered": "the lens covered for a while", "nodepthfirst": "no depth at first",
        "nodepthlast": "no depth at last", "identical": "all frames the same", "exposure": "exposure that jumps",
        "onepixel": "depth on one pixel", "odd": "odd sizes and masks",
    },
    "tum_var": {
        "base": "nothing", "ms": "stamps in milliseconds", "ns": "stamps in nanoseconds", "index": "frame numbers",
        "offset15": "depth 15 ms later", "offset25": "depth 25 ms later", "jitter": "depth 3 or 25 ms later",
        "comma": "decimal commas", "exp": "stamps of ten digits", "space": "names with spaces",
        "backslash": "backslashes in paths", "quote": "paths in quotes", "abs": "paths of another computer",
        "tab": "tabs", "csv": "commas between columns", "csvhead": "heading without #", "semicolon": "comments with ;",
        "dup": "a line twice", "shuffled": "lists in another order", "gtshort": "no poses at first",
        "gtgap": "no poses in the middle", "gt7": "poses of 7 columns", "missingfile": "a picture is missing",
        "cr": "line ends of old Macs", "crlf": "line ends of Windows", "bom": "byte order marks",
        "bom1": "and no heading", "nonl": "no last line end", "utf16": "UTF-16", "latin": "a comment in Latin-1",
    },
}  # fmt: skip
CASES = tuple(_cases())


def field_folder() -> Path:
    """Return where the programs are looked for."""
    return Path(os.environ.get("THREEDVC_FIELD") or REPOSITORY.parent / "shared" / "field")


def make_recording(folder: Path, case: Case, output: Path) -> Path:
    """Let a program write its recording; return where it is."""
    arguments = [str(folder / f"{case.program}.py"), str(output), *case.variant.split()]
    path = [str(folder), *sys.path]
    silent = contextlib.redirect_stdout(io.StringIO())
    with silent, mock.patch.object(sys, "argv", arguments), mock.patch.object(sys, "path", path), catch_warnings():
        simplefilter("ignore", ResourceWarning)  # these programs leave the closing of files to their end
        runpy.run_path(arguments[0], run_name="__main__")
    if case.program == "name_bytes":
        return Path(os.fsdecode(os.fsencode(output.parent) + b"/bad\xff"))
    return output / case.inside


def result_of(recording: Path, options: Mapping[str, Any]) -> str:
    """Return what encoding would say of a recording: read every frame, and settle its poses."""
    try:
        sequence = open_sequence(recording, **options)
        settled = settle_poses(sequence, EncoderConfig())
        for _ in sequence:
            pass
    except ThreedvcError as error:
        return f"refused: {error}"
    told = [f"read. {notice}" for notice in (*notices_of(sequence), *settled.notices)]
    return "<br>".join(told) or "read"


def inputs_document(folder: Path) -> str:
    """Return the text of docs/inputs.md."""
    rows = []
    with tempfile.TemporaryDirectory() as scratch:
        for number, case in enumerate(CASES):
            recording = make_recording(folder, case, Path(scratch, str(number), case.program))
            text = result_of(recording, case.options)
            for place in (recording, recording.resolve(), Path(scratch), Path(scratch).resolve()):
                text = text.replace(str(place), RECORDING)
            text = re.sub(r"/home/\w+/\w+", "ELSEWHERE", text)
            cells = (f"`{case.name}`", case.oddity, re.sub(r"[\udc80-\udcff]", "?", text))
            rows.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |\n")
    return INTRODUCTION + "".join(rows)


def main() -> None:
    """Write the document."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else field_folder()
    if not folder.is_dir():
        print(f"no programs that make recordings at {folder}; set THREEDVC_FIELD to their folder", file=sys.stderr)
        return
    DOCUMENT.write_text(inputs_document(folder), encoding="utf-8")


if __name__ == "__main__":
    main()
