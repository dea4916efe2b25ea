# SPDX-License-Identifier: MIT
"""Write the golden streams of this version, and what every golden stream decodes to.

Run by ``make golden`` alone. Streams of earlier versions are never written again, nor those of 0.1.0-avif and
0.1.0-ratio, written before this version was finished: by the former pictures are AVIF, by the latter each level of a
depth video is the one before times a ratio. What they decode to is, because the
renderer may change on purpose; their models may not, and the digest inside each stream holds that.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import threedvc
from threedvc.config import (
    AppearanceConfig,
    ColorVideo,
    DepthErrorConfig,
    DepthErrorKind,
    DepthVideo,
    EncoderConfig,
    Motion,
    SegmentationConfig,
    SegmentationMode,
    VideoConfig,
    with_lossless,
)
from threedvc.formats.decoding import DecodedFrame
from threedvc.synthesis import SyntheticSequence, make_scene

__all__ = ["FOLDER", "expectation", "main", "streams"]

FOLDER = Path(__file__).parent
FRAMES = 8

MASKS = SegmentationConfig(mode=SegmentationMode.MASKS)
THRESHOLD = SegmentationConfig(mode=SegmentationMode.DEPTH, near_m=0.0, far_m=1.2)
CAPTURED = EncoderConfig(
    color_video=ColorVideo.OFF, voxel_size_m=0.1, motion=Motion.KNOWN, refine=False, batch_frames=4, threads=1
)
"""Coarse models beside pictures as captured."""


class Case(NamedTuple):
    """A stream: the scene, the choices, the noise of its depth, and how many frames."""

    scene: str
    config: EncoderConfig
    noise: str = "ideal"
    frames: int = FRAMES


CASES = {
    "paper": Case("paper", EncoderConfig(color_video=ColorVideo.OFF, voxel_size_m=0.02, batch_frames=4)),
    "objects": Case("objects", EncoderConfig(color_video=ColorVideo.OFF, voxel_size_m=0.02, segmentation=MASKS)),
    "room": Case("room", EncoderConfig(color_video=ColorVideo.OFF, voxel_size_m=0.04)),
    "room_relief": Case(
        "room",
        EncoderConfig(color_video=ColorVideo.OFF, voxel_size_m=0.05, appearance=AppearanceConfig(relief_bits=2)),
    ),
    "paper_picture": Case(
        "paper",
        EncoderConfig(color_video=ColorVideo.OFF, motion=Motion.KNOWN, segmentation=THRESHOLD, batch_frames=4),
    ),
    "depth_video": Case(
        "room",
        EncoderConfig(
            color_video=ColorVideo.OFF,
            depth_video=DepthVideo.ON,
            voxel_size_m=0.05,
            motion=Motion.KNOWN,
            refine=False,
            batch_frames=4,
        ),
    ),
    "room_live": Case(
        "room", EncoderConfig(color_video=ColorVideo.OFF, voxel_size_m=0.04, causal=True, batch_frames=3)
    ),
    "room_color_video": Case(
        "room", replace(CAPTURED, color_video=ColorVideo.ON, video=VideoConfig(coarseness=64)), frames=6
    ),
    "room_full_chroma": Case(
        "room", replace(CAPTURED, color_video=ColorVideo.ON, video=VideoConfig(coarseness=40)), frames=6
    ),
    "room_live_video": Case(
        "room",
        EncoderConfig(voxel_size_m=0.04, video=VideoConfig(coarseness=64), causal=True, batch_frames=3),
        frames=6,
    ),
    "room_depth_error": Case(
        "room",
        replace(CAPTURED, depth_error=DepthErrorConfig(kind=DepthErrorKind.RELATIVE, size=0.01)),
        noise="kinect",
        frames=6,
    ),
    "paper_lossless": Case("paper", with_lossless(CAPTURED), noise="kinect", frames=3),
}


def streams() -> list[Path]:
    """Return the golden streams of all versions."""
    return sorted(FOLDER.glob("*/*.3dvc"))


def expectation(stream: Path) -> dict[str, Any]:
    """Decode a stream and return what stays of it: its frames, and a hash of each kind of output."""
    decoded = threedvc.open_stream(stream)
    hashes = {kind: hashlib.sha256() for kind in ("color", "depth", "labels", "motion")}
    for frame in decoded:
        hashes["color"].update(frame.color.tobytes())
        hashes["depth"].update(frame.depth.astype("<f4").tobytes())
        hashes["labels"].update(frame.labels.tobytes())
        hashes["motion"].update(b"".join(motion(frame)))
    return {
        "frames": decoded.decoder.frame_count,
        "complete": decoded.decoder.complete,
        **{kind: digest.hexdigest() for kind, digest in hashes.items()},
    }


def motion(frame: DecodedFrame) -> Iterator[bytes]:
    """Yield the time and the poses of a frame."""
    yield frame.timestamp_ns.to_bytes(8, "little")
    for pose in (frame.T_world_camera, *(frame.T_camera_object[number] for number in sorted(frame.T_camera_object))):
        yield pose.astype("<f8").tobytes()


def main() -> None:
    """Write everything."""
    folder = FOLDER / threedvc.__version__
    folder.mkdir(exist_ok=True)
    for name, case in CASES.items():
        sequence = SyntheticSequence(make_scene(case.scene, frames=case.frames, size=(64, 48)), case.noise)
        threedvc.encode(sequence, folder / f"{name}.3dvc", case.config, verify=True)
    for stream in streams():
        text = json.dumps(expectation(stream), indent=2)
        stream.with_suffix(".json").write_text(text + "\n", encoding="utf-8")
        print(f"{stream.relative_to(FOLDER)}: {stream.stat().st_size} bytes")


if __name__ == "__main__":
    main()
