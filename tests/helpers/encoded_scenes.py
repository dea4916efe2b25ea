# SPDX-License-Identifier: MIT
"""Small synthetic scenes, rendered once, and their streams, encoded once for all tests of a process that read them.

Modules of tests that take streams from here all use the fixture quick_av1, so that they share the same ones.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import cache

from helpers.streams import ListSequence
from threedvc.config import ColorVideo, EncoderConfig, Motion, PoseConfig, SegmentationConfig, SegmentationMode, Sensor
from threedvc.decoder.decoder import Decoder
from threedvc.decoder.frame_state import FrameState
from threedvc.encoder.pipeline.encoder import Encoder
from threedvc.stream.batch import unpack_batch
from threedvc.stream.headers import BatchHeader, PoseHeader
from threedvc.stream.packets import Packet, PacketType
from threedvc.synthesis import SyntheticSequence, make_scene

__all__ = [
    "FRAMES",
    "MASKS",
    "SIZES",
    "THRESHOLD",
    "WHOLE",
    "batches",
    "config",
    "decoded",
    "encoded",
    "pose_headers",
    "scene",
    "stream",
]

THRESHOLD = SegmentationConfig(mode=SegmentationMode.DEPTH, near_m=0.0, far_m=1.2)
MASKS = SegmentationConfig(mode=SegmentationMode.MASKS)
WHOLE = SegmentationConfig(mode=SegmentationMode.NONE)
FRAMES = 7
STEPS = PoseConfig(translation_step_m=0.0005, rotation_step_rad=0.00025)
SIZES = {"paper": (56, 56), "objects": (80, 60), "room": (80, 60)}
USUAL = {"paper": THRESHOLD, "objects": MASKS, "room": WHOLE}


@cache
def scene(name: str, frames: int = FRAMES, first: int = 0) -> ListSequence:
    """Return frames of a synthetic scene, rendered once."""
    source = SyntheticSequence(make_scene(name, frames=first + frames, size=SIZES[name]), threads=1)
    kept = [replace(source[first + index], index=index) for index in range(frames)]
    return ListSequence(kept, replace(source.info, frame_count=frames))


def config(**changes: object) -> EncoderConfig:
    """Return a configuration for tests: small groups, the exact sensor, no second pass."""
    values = {
        "batch_frames": 3,
        "threads": 1,
        "color_video": ColorVideo.OFF,
        "sensor": Sensor.IDEAL,
        "refine": False,
        "motion": Motion.KNOWN,
        "pose": STEPS,
    }
    return EncoderConfig(**{**values, **changes})  # type: ignore[arg-type]


def encoded(sequence: ListSequence, settings: EncoderConfig) -> tuple[Encoder, list[Packet]]:
    """Encode frames; return what the encoder knows at the end, and the stream."""
    encoder = Encoder(sequence.info, settings)
    return encoder, list(encoder.packets(sequence))


def stream(name: str, **changes: object) -> tuple[Encoder, list[Packet]]:
    """Encode a scene, divided as is usual for it unless told; nothing is encoded twice, so leave the result alone."""
    return _encoded_once(name, config(**{"segmentation": USUAL[name], **changes}))


@cache
def _encoded_once(name: str, settings: EncoderConfig) -> tuple[Encoder, list[Packet]]:
    return encoded(scene(name), settings)


def decoded(packets: Iterable[Packet]) -> tuple[Decoder, list[FrameState]]:
    """Decode a stream; return what the decoder knows at the end, and the state at every frame."""
    decoder = Decoder()
    return decoder, list(decoder.frames(packets))


def batches(packets: Sequence[Packet]) -> dict[int, list[Packet]]:
    """Return the members of every batch by its first frame."""
    return {
        BatchHeader.from_map(packet.header).frame: unpack_batch(packet)
        for packet in packets
        if packet.type == PacketType.BATCH
    }


def pose_headers(packets: Sequence[Packet]) -> list[PoseHeader]:
    """Return the headers of all POSE packets."""
    every = (member for group in batches(packets).values() for member in group)
    return [PoseHeader.from_map(member.header) for member in every if member.type == PacketType.POSE]
