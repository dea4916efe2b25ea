# SPDX-License-Identifier: MIT
"""Texts of options and the values they become."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import pytest

from threedvc.cli.options import (
    decoded_outputs,
    duration,
    focus,
    frame_range,
    frame_span,
    length,
    object_numbers,
    picture_size,
    positive_number,
    segmentation,
)
from threedvc.cli.progress import Progress
from threedvc.config import RegionOfInterest, SegmentationConfig, SegmentationMode
from threedvc.errors import ConfigError, OutputError
from threedvc.formats.outputs import write_output

FOCUS_FORM = "{!r} is not OBJECT=WEIGHT or X0..X1,Y0..Y1,Z0..Z1=WEIGHT, such as 1=4 or -20cm..20cm,0..1,0.5..2=4"


@pytest.mark.parametrize(
    ("parse", "text", "value"),
    [
        (length, "8mm", 0.008),
        (length, "7 mm", 0.007),
        (length, "1cm", 0.01),
        (length, "0.02m", 0.02),
        (length, ".5", 0.5),
        (length, "2", 2.0),
        (length, "0mm", 0.0),
        (duration, "100ms", 0.1),
        (duration, "2s", 2.0),
        (duration, ".5 s", 0.5),
        (duration, "1", 1.0),
        (positive_number, "5e3", 5000.0),
        (frame_range, "0:100", (0, 100, None)),
        (frame_range, ":", (None, None, None)),
        (frame_range, "5:", (5, None, None)),
        (frame_range, ":9:3", (None, 9, 3)),
        (frame_range, "2::2", (2, None, 2)),
        (frame_span, "3:7", (3, 7)),
        (frame_span, ":7", (0, 7)),
        (frame_span, "3:", (3, None)),
        (picture_size, "640x480", (640, 480)),
        (decoded_outputs, "depth,color", frozenset({"color", "depth"})),
        (object_numbers, "3,1,3", (1, 3)),
        (focus, "1=4", RegionOfInterest(weight=4, number=1)),
        (focus, "-20cm..0.2,0..1m,5mm..2=0.5", RegionOfInterest(weight=0.5, box_m=(-0.2, 0.2, 0, 1, 0.005, 2))),
        (segmentation, "none", SegmentationConfig(mode=SegmentationMode.NONE)),
        (segmentation, "masks", SegmentationConfig(mode=SegmentationMode.MASKS)),
        (segmentation, "auto", SegmentationConfig()),
        (segmentation, "motion", SegmentationConfig(mode=SegmentationMode.MOTION)),
        (segmentation, "depth:10cm..1.2m", SegmentationConfig(mode=SegmentationMode.DEPTH, near_m=0.1, far_m=1.2)),
        (segmentation, "depth:0..1", SegmentationConfig(mode=SegmentationMode.DEPTH, near_m=0, far_m=1)),
    ],
)
def test_value(parse: Callable[[str], Any], text: str, value: Any) -> None:
    assert parse(text) == value


@pytest.mark.parametrize(
    ("parse", "text", "message"),
    [
        (length, "8 miles", "'8 miles' is not a length; write 8mm, 1cm, 0.02m or a number of meters"),
        (length, "-1mm", "'-1mm' is not a length; write 8mm, 1cm, 0.02m or a number of meters"),
        (length, "nan", "'nan' is not a length; write 8mm, 1cm, 0.02m or a number of meters"),
        (length, "", "'' is not a length; write 8mm, 1cm, 0.02m or a number of meters"),
        (positive_number, "inf", "'inf' is not a positive number"),
        (positive_number, "0", "'0' is not a positive number"),
        (positive_number, "fast", "'fast' is not a positive number"),
        (frame_range, "7", "'7' is not a range of frames; write A:B or A:B:STEP, such as 0:100 or 50:"),
        (frame_range, "-3:", "'-3:' is not a range of frames; write A:B or A:B:STEP, such as 0:100 or 50:"),
        (frame_span, "0:9:2", "'0:9:2' has a step; decoding takes A:B"),
        (picture_size, "640", "'640' is not a picture size; write WIDTHxHEIGHT, such as 640x480"),
        (decoded_outputs, "color,normals", "'color,normals' names something else than color, depth, labels"),
        (decoded_outputs, "", "'' names something else than color, depth, labels"),
        (object_numbers, "1,256", "'1,256' is not a list of object numbers from 0 to 255; write 1,3"),
        (object_numbers, "1,,2", "'1,,2' is not a list of object numbers from 0 to 255; write 1,3"),
        (focus, "abc", FOCUS_FORM.format("abc")),
        (focus, "=4", FOCUS_FORM.format("=4")),
        (focus, "0..1,0..1=4", FOCUS_FORM.format("0..1,0..1=4")),
        (focus, "1=", "'' is not a positive number"),
        (focus, "1=-2", "'-2' is not a positive number"),
        (
            segmentation,
            "depth",
            "'depth' is not none, masks, motion, auto or depth:NEAR..FAR, such as depth:10cm..1.2m",
        ),
        (
            segmentation,
            "0.1..1",
            "'0.1..1' is not none, masks, motion, auto or depth:NEAR..FAR, such as depth:10cm..1.2m",
        ),
        (segmentation, "depth:1..x", "'x' is not a length; write 8mm, 1cm, 0.02m or a number of meters"),
    ],
)
def test_wrong_form_is_a_usage_error(parse: Callable[[str], Any], text: str, message: str) -> None:
    with pytest.raises(click.BadParameter) as caught:
        parse(text)
    assert caught.value.message == message


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1=1000", r"focus weight 1000 must be within 0\.01\.\.100"),
        ("300=2", "focus on object 300: objects are numbered from 0 to 255"),
        ("1..0,0..1,0..1=2", r"focus on the empty box 1\.\.0,0\.\.1,0\.\.1; give it as X0\.\.X1"),
    ],
)
def test_senseless_focus_is_a_config_error(text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        focus(text)


@pytest.mark.parametrize("text", ["5:5", "9:3", ":0"])
def test_empty_span_is_a_config_error(text: str) -> None:
    with pytest.raises(ConfigError, match=f"--frames {text} is empty; the end must be above the start"):
        frame_span(text)


def test_empty_depth_range_is_a_config_error() -> None:
    with pytest.raises(ConfigError, match=r"depth range 1\.2 m \.\. 0\.1 m is empty"):
        segmentation("depth:1.2m..10cm")


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


class TestProgress:
    def test_is_silent_when_not_on_a_terminal(self) -> None:
        stream = io.StringIO()
        with Progress("encode", 10, 30.0, stream) as progress:
            progress.advance(1, 1000)
            progress.summary("done")
        assert stream.getvalue() == "done\n"

    def test_rewrites_one_line_on_a_terminal_and_clears_it(self) -> None:
        stream = Terminal()
        with Progress("encode", 10, 30.0, stream) as progress:
            progress.advance(5, 1000)
        first, *_, last = stream.getvalue().split("\r")[1:]
        assert first.startswith("encode: frame 5/10, ")
        assert first.endswith(" frames/s, 48.0 kbit/s")
        assert last == ""
        assert "\n" not in stream.getvalue()

    def test_unknown_length_and_rate(self) -> None:
        stream = Terminal()
        with Progress("compare", None, stream=stream) as progress:
            progress.advance(5)
        assert stream.getvalue().startswith("\rcompare: frame 5, ")
        assert "kbit/s" not in stream.getvalue()

    def test_counts_passes_over_the_frames(self) -> None:
        stream = Terminal()
        with Progress("encode", 2, stream=stream) as progress:
            for frame in (1, 2, 1):
                progress.advance(frame)
        assert "\rencode, pass 2: frame 1/2, " in stream.getvalue()

    def test_does_not_write_for_every_frame(self) -> None:
        stream = Terminal()
        with Progress("encode", 10000, None, stream) as progress:
            for frame in range(1000):
                progress.advance(frame)
        assert stream.getvalue().count("encode") < 100
        assert progress.frames == 999


class TestWriteOutput:
    def test_replaces_what_was_there(self, tmp_path: Path) -> None:
        target = tmp_path / "a.csv"
        target.write_text("old")
        write_output(target, b"new", lambda head: head == b"old", "table")
        assert target.read_bytes() == b"new"
        assert list(tmp_path.iterdir()) == [target]

    def test_keeps_what_is_another_file(self, tmp_path: Path) -> None:
        target = tmp_path / "a.csv"
        target.write_text("notes")
        with pytest.raises(OutputError) as caught:
            write_output(target, b"new", lambda head: head == b"old", "table")
        assert str(caught.value) == (
            f"{target}: is a file, but no table that 3dvc wrote; choose another name, or give --force"
        )
        assert target.read_text() == "notes"
        write_output(target, b"new", lambda head: head == b"old", "table", force=True)
        assert target.read_bytes() == b"new"

    def test_keeps_links_and_devices(self, tmp_path: Path) -> None:
        link, target = tmp_path / "link.csv", tmp_path / "a.csv"
        link.symlink_to(target)
        write_output(link, b"new", lambda head: False, "table")
        assert link.is_symlink()
        assert target.read_bytes() == b"new"
        write_output(Path("/dev/null"), b"new", lambda head: False, "table")
        assert Path("/dev/null").is_char_device()

    def test_names_the_file_that_cannot_be_written(self, tmp_path: Path) -> None:
        target = tmp_path / "missing" / "a.csv"
        with pytest.raises(OutputError) as caught:
            write_output(target, b"", lambda head: True, "table")
        assert str(caught.value) == (f"{target}: cannot be written (No such file or directory); choose another place")
