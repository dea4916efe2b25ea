# SPDX-License-Identifier: MIT
"""Whatever is written comes back, in any sequence of packets."""

from __future__ import annotations

import io
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from helpers.container_streams import end, records, stream_header, stream_of
from threedvc.formats.container import IndexEntry, StreamReader
from threedvc.formats.container.index import pack_index, unpack_index
from threedvc.limits import MAX_COUNT, MAX_FRAME, MAX_OBJECT_ID
from threedvc.stream.batch import pack_batch, unpack_batch
from threedvc.stream.headers import BatchHeader, ModelHeader, ObjectHeader, PoseHeader
from threedvc.stream.packets import Packet, PacketType
from threedvc.stream.wire import ByteReader, pack_map, pack_varint, unpack_map

numbers = st.integers(-(1 << 63), (1 << 64) - 1)
scalars = st.one_of(
    st.none(),
    st.booleans(),
    numbers,
    st.floats(allow_nan=False, allow_infinity=False),
    st.text(max_size=9),
    st.binary(max_size=9),
)
values = st.recursive(
    scalars,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=3),
    max_leaves=4,
).filter(lambda value: depth(value) <= 3)
maps = st.dictionaries(st.text(max_size=4), values, max_size=4)
frames = st.integers(0, MAX_FRAME)
members = st.one_of(
    st.builds(
        lambda number, size: ObjectHeader(object_id=number, voxel_size_m=size).packet(),
        st.integers(0, MAX_OBJECT_ID),
        st.floats(1e-6, 1e3),
    ),
    st.builds(lambda frame, data: ModelHeader(frame=frame).packet(data), frames, st.binary(max_size=300)),
    st.builds(
        lambda frame, count, data: PoseHeader(frame=frame, count=count).packet(data),
        frames,
        st.integers(1, MAX_COUNT),
        st.binary(max_size=300),
    ),
    st.builds(
        lambda header, data, access: Packet(
            type=PacketType.META, header=header, payload=data, critical=False, random_access=access
        ),
        maps,
        st.binary(max_size=300),
        st.booleans(),
    ),
)


def depth(value: Any) -> int:
    inner = value.values() if isinstance(value, dict) else value if isinstance(value, list) else None
    return 0 if inner is None else 1 + max(map(depth, inner), default=0)


@given(maps)
def test_maps(content: dict[str, Any]) -> None:
    data = pack_map(content)
    assert unpack_map(data) == content
    assert pack_map(unpack_map(data)) == data


@given(st.integers(0, (1 << 64) - 1), st.binary(max_size=3))
def test_varints(number: int, rest: bytes) -> None:
    reader = ByteReader(pack_varint(number) + rest)
    assert (reader.varint(), reader.take(reader.remaining)) == (number, rest)


@given(st.lists(members, max_size=6))
def test_batches(content: list[Packet]) -> None:
    assert unpack_batch(pack_batch(BatchHeader(frame=0, count=1), content)) == content


@given(st.lists(st.one_of(members, st.lists(members, max_size=4)), max_size=6))
def test_streams(content: list[Packet | list[Packet]]) -> None:
    packets = [stream_header().packet()]
    for number, item in enumerate(content):
        joined = pack_batch(BatchHeader(frame=number, count=1), item) if isinstance(item, list) else item
        packets.append(joined)
    data = stream_of([*packets, end()])
    assert list(StreamReader(io.BytesIO(data), "k.3dvc"))[:-1] == packets
    assert 12 + sum(part.size for record in records(data) for part in record.parts()) == len(data)
    assert stream_of([*packets, end()]) == data


@given(st.lists(st.tuples(st.integers(0, 1000), st.integers(1, 1 << 40), st.booleans()), max_size=20))
def test_indices(rises: list[tuple[int, int, bool]]) -> None:
    entries: list[IndexEntry] = []
    frame = offset = 0
    for rise, distance, access in rises:
        frame, offset = frame + rise, offset + distance
        entries.append(IndexEntry(frame, offset, access))
    assert unpack_index(pack_index(entries)) == tuple(entries)
