# SPDX-License-Identifier: MIT
"""Put input and decoded pictures side by side: color, decoded color, depth, decoded depth.

Both folders have the plain layout (``color/``, ``depth/``, ``intrinsics.json``). One row per frame::

    python benchmarks/montage.py INPUT DECODED OUT.png --frames 0,75,149
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from threedvc.units import MILLIMETERS

__all__ = ["colored_depth", "main", "montage"]

Picture = NDArray[np.uint8]

LABEL_HEIGHT = 22
"""Pixels of the bar above a picture: a line of text."""
ROWS = 4
"""Frames unless told: start, end and two between fill a page."""


def pictures(folder: Path, kind: str) -> list[Path]:
    """Return the pictures of one kind in their order.

    Raises
    ------
    SystemExit
        If there are none.
    """
    found = sorted(path for path in (folder / kind).glob("*") if path.suffix in {".png", ".jpg"})
    if not found:
        sys.exit(f"{folder / kind}: no pictures; give a folder of the plain layout")
    return found


def depth_scale(folder: Path) -> float:
    """Return the units per meter of a folder's depth pictures, 1000 where it does not say."""
    description = json.loads((folder / "intrinsics.json").read_text(encoding="utf-8"))
    return float(description.get("depth_scale", MILLIMETERS))


def read(path: Path, flags: int) -> NDArray[np.generic]:
    """Read one picture.

    Raises
    ------
    SystemExit
        If it cannot be read.
    """
    picture = cv2.imread(str(path), flags)
    if picture is None:
        sys.exit(f"{path}: not a readable picture")
    return picture


def colored_depth(depth_m: NDArray[np.float64], near_m: float, far_m: float) -> Picture:
    """Color a depth picture (height, width) in meters by nearness, BGR; no measurement is black."""
    nearness = np.clip((far_m - depth_m) / max(far_m - near_m, 1e-9), 0, 1)
    colored = cv2.applyColorMap((255 * nearness).astype(np.uint8), cv2.COLORMAP_TURBO)
    colored[depth_m == 0] = 0
    return np.asarray(colored, dtype=np.uint8)


def labeled(picture: NDArray[np.generic], height: int, text: str) -> Picture:
    """Bring a picture to one height and write a line of text above it."""
    width = round(picture.shape[1] * height / picture.shape[0])
    scaled = cv2.resize(picture.astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST)
    bar = np.full((LABEL_HEIGHT, width, 3), 255, dtype=np.uint8)
    cv2.putText(bar, text, (4, 16), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (0, 0, 0), 1, cv2.LINE_AA)
    return np.vstack([bar, scaled])


def row(source: Path, decoded: Path, index: int, height: int) -> Picture:
    """Return one row: the four pictures of one frame, all depth on the input's own scale of colors."""
    depths = [
        read(pictures(folder, "depth")[index], cv2.IMREAD_UNCHANGED).astype(np.float64) / depth_scale(folder)
        for folder in (source, decoded)
    ]
    measured = depths[0][depths[0] > 0]
    near_m, far_m = np.percentile(measured, [1, 99]) if measured.size else (0.0, 1.0)
    colors = [read(pictures(folder, "color")[index], cv2.IMREAD_COLOR) for folder in (source, decoded)]
    cells = [
        (colors[0], f"input {index}"),
        (colors[1], "decoded"),
        (colored_depth(depths[0], near_m, far_m), f"depth {near_m:.2f}-{far_m:.2f} m"),
        (colored_depth(depths[1], near_m, far_m), "decoded depth"),
    ]
    return np.hstack([labeled(picture, height, text) for picture, text in cells])


def montage(source: Path, decoded: Path, indices: list[int], height: int) -> Picture:
    """Stack the rows of the given frames."""
    return np.vstack([row(source, decoded, index, height) for index in indices])


def chosen_frames(text: str | None, count: int) -> list[int]:
    """Return the frames asked for, or a few spread over the sequence."""
    if text is None:
        return sorted({round(i * (count - 1) / (ROWS - 1)) for i in range(ROWS)})
    indices = [int(part) for part in text.split(",")]
    outside = [index for index in indices if not 0 <= index < count]
    if outside:
        sys.exit(f"--frames {text}: frame {outside[0]} is not within 0..{count - 1}")
    return indices


def main(arguments: list[str] | None = None) -> None:
    """Parse the command line and write the montage."""
    parser = argparse.ArgumentParser(description="Put input and decoded pictures side by side.")
    parser.add_argument("input", type=Path, help="folder that was encoded")
    parser.add_argument("decoded", type=Path, help="folder that 3dvc decode wrote")
    parser.add_argument("output", type=Path, help="picture to write")
    parser.add_argument("--frames", help="frames to show, such as 0,75,149 (default: four, evenly spaced)")
    parser.add_argument("--height", type=int, default=240, help="height of each picture in pixels (default: 240)")
    options = parser.parse_args(arguments)
    count = min(len(pictures(folder, "depth")) for folder in (options.input, options.decoded))
    picture = montage(options.input, options.decoded, chosen_frames(options.frames, count), options.height)
    if not cv2.imwrite(str(options.output), picture):
        sys.exit(f"{options.output}: cannot be written")


if __name__ == "__main__":
    main()
