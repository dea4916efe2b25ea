# SPDX-License-Identifier: MIT
"""Recordings, streams and stand-ins for tests of commands."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from helpers.commands import FakeEncoder
from helpers.streams import FakeStream, ListSequence, packed_stream
from threedvc.formats import decoding, encoding
from threedvc.formats.evaluation import statistics as statistics_module
from threedvc.formats.sinks import PlainSink


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Write a recording of four small frames."""
    folder = tmp_path / "recording"
    sequence = ListSequence()
    with PlainSink(folder, sequence.info, threads=1) as sink:
        for frame in sequence:
            sink.write_frame(frame)
    return folder


@pytest.fixture
def stream(tmp_path: Path) -> Path:
    """Write a complete stream."""
    path = tmp_path / "a.3dvc"
    path.write_bytes(packed_stream())
    return path


@pytest.fixture
def cut_stream(tmp_path: Path) -> Path:
    """Write a stream of two whole frames and some more bytes."""
    path = tmp_path / "cut.3dvc"
    path.write_bytes(packed_stream(ended=False)[:-5])
    return path


@pytest.fixture
def fake_decoder(monkeypatch: pytest.MonkeyPatch) -> list[FakeStream]:
    """Replace the decoder; return the streams that get opened."""
    opened: list[FakeStream] = []

    def open_stream(source: Any, **choices: Any) -> FakeStream:
        opened.append(FakeStream(source, **choices))
        return opened[-1]

    monkeypatch.setattr(decoding, "open_stream", open_stream)
    monkeypatch.setattr(statistics_module, "open_stream", open_stream)
    return opened


@pytest.fixture
def fake_encoder(monkeypatch: pytest.MonkeyPatch) -> FakeEncoder:
    encoder = FakeEncoder()
    monkeypatch.setattr(encoding, "encode", encoder)
    return encoder
