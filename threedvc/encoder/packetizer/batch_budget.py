# SPDX-License-Identifier: MIT
"""How many bytes the model updates of a live stream's batch may take."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf

from threedvc.config import EncoderConfig
from threedvc.encoder.rate.rate_control import LeakyBucket, stream_bytes
from threedvc.stream.batch import pack_batch
from threedvc.stream.framing_sizes import MAX_BATCH_FRAMING_BYTES, MAX_END_BYTES, MAX_INDEX_ENTRY_BYTES
from threedvc.stream.headers import BatchHeader
from threedvc.stream.packets import Packet

__all__ = ["BatchBudget", "packed_bytes"]


def packed_bytes(packets: Sequence[Packet]) -> int:
    """Return how many bytes packets take in a BATCH."""
    return len(pack_batch(BatchHeader(frame=0, count=1), packets).payload)


class BatchBudget:
    """What batches may take: without a rate, or for a file, whatever they need.

    Parameters
    ----------
    config
        Choices.
    fps
        Frames per second of all sensors.
    head
        The head of the stream, which takes its part.
    """

    def __init__(self, config: EncoderConfig, fps: float, head: Sequence[Packet]) -> None:
        self._fps = fps
        self._bucket: LeakyBucket | None = None
        if config.causal and config.bitrate_bps is not None:
            self._bucket = LeakyBucket(config.bitrate_bps / 8, config.live_buffer_s)
            self._bucket.take(stream_bytes(head))

    def open_batch(self, frames: int, needed: Sequence[Packet], *, last: bool) -> float:
        """Return how many bytes model updates may take in the batch of the next frames, whose other packets are needed.

        What the end of the stream will take is kept back.
        """
        if self._bucket is None:
            return inf
        seconds = frames / self._fps
        self._bucket.wait(seconds)
        needed_bytes = packed_bytes(needed) + MAX_BATCH_FRAMING_BYTES
        # The next batch may be the last, and will need about as much as this one.
        reserve = float(MAX_END_BYTES + MAX_INDEX_ENTRY_BYTES)
        if not last:
            reserve = max(reserve + needed_bytes - self._bucket.refill(seconds), 0.0)
        return self._bucket.available - needed_bytes - reserve

    def close_batch(self, batch: Packet) -> None:
        """Note that a BATCH was sent, which takes an entry of the INDEX at the end."""
        if self._bucket is not None:
            self._bucket.take(len(batch.payload) + MAX_BATCH_FRAMING_BYTES + MAX_INDEX_ENTRY_BYTES)
