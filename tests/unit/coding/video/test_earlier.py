# SPDX-License-Identifier: MIT
"""Pictures of streams that were written before: they decode to the very samples that they did then."""

from __future__ import annotations

from contextlib import suppress

import numpy as np
import pytest

from helpers.earlier_pictures import RUNS, STILLS, EarlierRun, EarlierStill, digest_of
from threedvc.coding.video import av1, earlier
from threedvc.coding.video.av1 import can_decode_av1
from threedvc.coding.video.earlier import decode_earlier_run, decode_earlier_still
from threedvc.errors import CorruptStream, FormatError, UnsupportedVersion

pytestmark = pytest.mark.skipif(not can_decode_av1(), reason="this build of PyAV has no AV1")

RUN, ONE, STILL, WHOLE = RUNS["run"], RUNS["one"], STILLS["color"], STILLS["whole"]


def run_of(run: EarlierRun) -> list[np.ndarray]:
    return list(decode_earlier_run(run.payload, run.count, run.width, run.height))


def still_of(still: EarlierStill) -> np.ndarray:
    return decode_earlier_still(still.payload, still.width, still.height, still.gray)


@pytest.mark.parametrize("name", STILLS)
def test_stills_decode_as_before(name: str) -> None:
    picture = still_of(STILLS[name])
    assert picture.dtype == np.uint8
    assert picture.shape == (STILLS[name].height, STILLS[name].width, 3)
    assert digest_of(picture) == STILLS[name].digest


@pytest.mark.parametrize("name", RUNS)
def test_runs_decode_as_before(name: str) -> None:
    pictures = run_of(RUNS[name])
    assert all(picture.dtype == np.uint16 for picture in pictures)
    assert digest_of(np.stack(pictures).astype(np.uint8)) == RUNS[name].digest


def test_a_whole_file_and_its_parts_are_the_same_picture() -> None:
    np.testing.assert_array_equal(still_of(WHOLE), still_of(STILLS["gray"]))


@pytest.mark.parametrize("run", [RUN, ONE], ids=["run", "one"])
def test_truncated_runs_are_refused(run: EarlierRun) -> None:
    for size in range(0, len(run.payload), 3):
        with pytest.raises(CorruptStream, match="the stream is damaged"):
            run_of(run._replace(payload=run.payload[:size]))


@pytest.mark.parametrize("still", [STILL, WHOLE], ids=["parts", "whole"])
def test_truncated_stills_are_refused(still: EarlierStill) -> None:
    for size in range(len(still.payload)):
        with pytest.raises(CorruptStream):
            still_of(still._replace(payload=still.payload[:size]))


@pytest.mark.parametrize(
    ("count", "width", "height"), [(8, 37, 23), (10, 37, 23), (1, 37, 23), (9, 37, 24), (9, 36, 23), (1 << 20, 1, 1)]
)
def test_another_number_or_size_of_a_run_is_refused(
    count: int, width: int, height: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(earlier, "decode_pictures", lambda *_: pytest.fail("what cannot be right was decoded"))
    with pytest.raises(CorruptStream, match="the stream is damaged"):
        run_of(RUN._replace(count=count, width=width, height=height))


@pytest.mark.parametrize(("width", "height", "gray"), [(33, 32, False), (31, 31, False), (33, 31, True)])
def test_another_size_of_a_still_is_refused(
    width: int, height: int, gray: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(earlier, "decode_pictures", lambda *_: pytest.fail("what cannot be right was decoded"))
    with pytest.raises(CorruptStream, match="pictures of 34x47 samples of 8 bits should have"):
        still_of(STILL._replace(width=width, height=height, gray=gray))


@pytest.mark.parametrize(
    "payload",
    [b"", b"\x07abc", b"\x08abc", b"\x00", b"\x00no picture", b"\x01", b"\x01\x81\x00\x1c\x00rubbish", bytes(4000)],
)
def test_rubbish_is_refused(payload: bytes) -> None:
    with pytest.raises(CorruptStream):
        decode_earlier_still(payload, 32, 32, False)
    with pytest.raises(CorruptStream):
        list(decode_earlier_run(payload, 1, 32, 32))


def test_two_headers_in_a_still_are_refused() -> None:
    """The second could tell another size than the one that was checked."""
    head, data = STILL.payload[:5], STILL.payload[5:]
    with pytest.raises(CorruptStream, match="2 sequence headers"):
        still_of(STILL._replace(payload=head + data + data))


def test_no_damage_does_worse_than_spoil_pictures(rng: np.random.Generator) -> None:
    for _ in range(200):
        run, still = bytearray(RUN.payload), bytearray(STILL.payload)
        for damaged in (run, still):
            for at in rng.integers(0, len(damaged), rng.integers(1, 4)):
                damaged[at] = rng.integers(256)
        with suppress(FormatError):
            assert [picture.shape for picture in run_of(RUN._replace(payload=bytes(run)))] == [(23, 37)] * 9
        with suppress(FormatError):
            assert still_of(STILL._replace(payload=bytes(still))).shape == (31, 33, 3)


def test_builds_without_av1_say_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(av1, "_decoder_name", lambda: None)
    with pytest.raises(UnsupportedVersion, match="install av"):
        run_of(RUN)
    with pytest.raises(UnsupportedVersion, match="install av"):
        still_of(STILL)
