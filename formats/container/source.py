# SPDX-License-Identifier: MIT
"""Bytes from a file or pipe, with the one place where a stream can be found too short."""

from __future__ import annotations

from typing import BinaryIO, Final

from threedvc.errors import TruncatedStream

__all__ = ["CHUNK_BYTES", "ByteSource"]

CHUNK_BYTES: Final = 1 << 16
"""What is read at once, as pipes hold: a false length of gigabytes takes no more memory than there are bytes."""


class ByteSource:
    """Reads forward, counts bytes and can take bytes back; OSErrors of the stream pass through.

    Parameters
    ----------
    stream
        A binary stream, not necessarily seekable.
    offset
        Position of the stream's next byte in the file.
    """

    def __init__(self, stream: BinaryIO, offset: int = 0) -> None:
        self.offset = offset
        self._stream = stream
        self._returned = b""

    @property
    def end(self) -> int:
        """Position behind the last byte that the stream has delivered."""
        return self.offset + len(self._returned)

    def exactly(self, size: int) -> bytes:
        """Return the next `size` bytes.

        Raises
        ------
        TruncatedStream
            If fewer are left.
        """
        data = self.take(size)
        if len(data) < size:
            raise TruncatedStream(f"ends at byte {self.offset}, {size - len(data)} bytes too early")
        return data

    def take(self, size: int) -> bytes:
        """Return the next `size` bytes, or as many as are left.

        The stream is asked for small pieces, so that memory grows with what arrives, not with what
        a damaged length promises.
        """
        pieces = [self._returned[:size]]
        self._returned = self._returned[size:]
        missing = size - len(pieces[0])
        while missing:
            piece = self._stream.read(min(missing, CHUNK_BYTES))
            if not piece:
                break
            pieces.append(piece)
            missing -= len(piece)
        self.offset += size - missing
        return b"".join(pieces)

    def give_back(self, data: bytes) -> None:
        """Put bytes that were taken back in front of what follows."""
        self._returned = data + self._returned
        self.offset -= len(data)

    def skip_to(self, pattern: bytes) -> bool:
        """Move to the next occurrence of a pattern; at the end of the stream return False."""
        while len(data := self.take(CHUNK_BYTES)) >= len(pattern):
            place = data.find(pattern)
            self.give_back(data[place:] if place >= 0 else data[1 - len(pattern) :])
            if place >= 0:
                return True
        return False
