# SPDX-License-Identifier: MIT
"""The .3dvc container: packets to bytes, and bytes to checked packets. docs/format.md is its specification."""

from threedvc.formats.container.files import check_output, open_input, open_output
from threedvc.formats.container.index import IndexEntry, StreamIndex, read_index
from threedvc.formats.container.layout import FILE_HEAD_BYTES
from threedvc.formats.container.reader import Record, SkippedRange, StreamReader
from threedvc.formats.container.writer import StreamWriter

__all__ = [
    "FILE_HEAD_BYTES",
    "IndexEntry",
    "Record",
    "SkippedRange",
    "StreamIndex",
    "StreamReader",
    "StreamWriter",
    "check_output",
    "open_input",
    "open_output",
    "read_index",
]
