# SPDX-License-Identifier: MIT
"""Small .3dvc streams for the tests of the container."""

from __future__ import annotations

import io

from threedvc.formats.container import Record, StreamReader, StreamWriter
from threedvc.formats.container.checksum import crc32c
from threedvc.formats.container.layout import CRC, PACKET_HEAD, SYNC
from threedvc.stream.batch import pack_batch
from threedvc.stream.headers import BatchHeader, EndHeader, ModelHeader, ObjectHeader, PoseHeader, StreamHeader
from threedvc.stream.packets import Packet

CAMERA = (4.0, 3.0, 5.0, 5.0, 1.5, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
DIGEST = bytes(range(16))


def stream_header(**changes: object) -> StreamHeader:
    values = {
        "color_camera": CAMERA,
        "depth_scale": 1000.0,
        "period_num": 1_000_000_000,
        "period_den": 30,
        "translation_step_m": 0.0005,
        "rotation_step_rad": 0.00025,
    }
    return StreamHeader(**{**values, **changes})  # type: ignore[arg-type]


def batch(frame: int, count: int = 10, payload: bytes = b"model of the object", **flags: bool) -> Packet:
    members = [
        ObjectHeader(object_id=0, voxel_size_m=0.016).packet(),
        ModelHeader(frame=frame).packet(payload),
        PoseHeader(frame=frame, count=count).packet(bytes(range(40))),
    ]
    joined = pack_batch(BatchHeader(frame=frame, count=count), members)
    return Packet(type=joined.type, header=joined.header, payload=joined.payload, **flags)


def packets(batches: int = 3) -> list[Packet]:
    """Return STREAM and batches of ten frames each, without END."""
    return [stream_header().packet(), *(batch(10 * number) for number in range(batches))]


def end(frames: int = 30) -> Packet:
    return EndHeader(frames=frames, digest=DIGEST).packet()


def stream_of(content: list[Packet]) -> bytes:
    sink = io.BytesIO()
    writer = StreamWriter(sink)
    for packet in content:
        writer.write(packet)
    writer.close()
    return sink.getvalue()


def small_stream() -> bytes:
    """Return a complete stream of three batches."""
    return stream_of([*packets(), end()])


def records(data: bytes) -> list[Record]:
    return list(StreamReader(io.BytesIO(data), "k.3dvc").records())


def raw_packet(
    number: int,
    *,
    flags: int = 1,
    header: bytes = b"\x80",
    payload: bytes = b"",
    seq: int = 0,
    header_size: int | None = None,
    payload_size: int | None = None,
    raw_size: int | None = None,
) -> bytes:
    """Frame a packet with correct checksums and whatever lengths are asked for."""
    stored = len(payload) if payload_size is None else payload_size
    head = PACKET_HEAD.pack(
        SYNC,
        number,
        flags,
        len(header) if header_size is None else header_size,
        stored,
        stored if raw_size is None else raw_size,
        seq,
        0,
    )[: -CRC.size]
    return head + CRC.pack(crc32c(head)) + header + payload + CRC.pack(crc32c(header + payload))
