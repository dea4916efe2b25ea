# SPDX-License-Identifier: MIT
"""Points without loss or within a bound: what 3dvc promises, what tables say."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import rd_exact
from exact_coders import Coder, NotExact
from rd_exact import BOUNDED, EXACT, LEVEL, LOSSLESS, ExactResult, exact_tables, keeps_promise
from rd_points import Point, Recording, Store, config_of
from rd_report import report
from threedvc.cli.main import main as command
from threedvc.config import ColorVideo, DepthErrorKind

EXACTLY = {"depth_max_mm": 0.0, "depth_lost": 0.0, "depth_invented": 0.0, "psnr_rgb": 99.0, "color_bytes": 600.0}


def ours(option: str, size: int = 1000, **changed: float) -> Point:
    return Point(setting=option, size=size, quality=EXACTLY | changed)


def theirs(name: str, size: int, limit: float = 0.0) -> Point:
    return Point(setting=name, size=size, quality={"limit_mm": limit, "depth_max_mm": limit})


def result(sequence: str = "room") -> ExactResult:
    return ExactResult(
        sequence=sequence,
        frames=10,
        seconds=1.0,
        ours={BOUNDED: ours(BOUNDED, 800), LEVEL: ours(LEVEL, 900), EXACT: ours(EXACT), LOSSLESS: ours(LOSSLESS, 4600)},
        depth=[theirs("FFV1", 800), theirs("LERC", 400, limit=5.0)],
        color=[theirs("PNG", 1200)],
    )


@pytest.fixture
def recording(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Recording:
    place = tmp_path / "tiny"
    command.main(["synth", str(place), "--scene", "objects", "--frames", "2", "--size", "40x30"], standalone_mode=False)
    capsys.readouterr()
    return Recording.of(place)


class TestPromises:
    def test_options_are_understood(self) -> None:
        assert config_of(BOUNDED).depth_error.size == pytest.approx(0.005)
        assert config_of(LEVEL).depth_error.kind is DepthErrorKind.LEVEL
        assert config_of(EXACT).color_video is ColorVideo.ON
        assert config_of(LOSSLESS).video.lossless

    @pytest.mark.parametrize(
        ("option", "changed", "kept"),
        [
            (BOUNDED, {"depth_max_mm": 5.0}, True),
            (BOUNDED, {"depth_max_mm": 6.0}, False),
            (BOUNDED, {"depth_lost": 0.1}, False),
            (LEVEL, {"depth_max_mm": 40.0}, True),
            (LEVEL, {"depth_invented": 0.1}, False),
            (EXACT, {"psnr_rgb": 33.0}, True),
            (EXACT, {"depth_max_mm": 1.0}, False),
            (LOSSLESS, {"psnr_rgb": 98.0}, False),
        ],
    )
    def test_what_is_promised_is_checked(self, option: str, changed: dict[str, float], kept: bool) -> None:
        assert keeps_promise(ours(option, **changed)) is kept

    def test_broken_promise_is_an_error(
        self, recording: Recording, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
    ) -> None:
        monkeypatch.setattr(Recording, "encode", lambda *_: 1000)
        monkeypatch.setattr(rd_exact, "_color_bytes", lambda _: 600.0)
        monkeypatch.setattr(rd_exact, "scored", lambda *_: EXACTLY | {"depth_lost": 0.5})
        with pytest.raises(NotExact, match="3dvc --color-video on --depth-error 5mm comes to"):
            list(rd_exact.our_exact_points(recording, Store(tmp_path)))


class TestPoints:
    def test_pictures_as_they_were_read_go_to_every_coder(
        self, recording: Recording, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
    ) -> None:
        def coders(largest: int, limit: int) -> list[Coder]:
            assert limit == 5
            return [Coder(name="all", version=str(largest), round_trip=lambda given: (len(given), given))]

        monkeypatch.setattr(rd_exact, "depth_coders", coders)
        (point,) = rd_exact.depth_points(recording, Store(tmp_path))
        assert point == Point(setting="all", size=2, quality={"limit_mm": 0.0, "depth_max_mm": 0.0})

    def test_gray_pictures_have_one_channel(
        self, recording: Recording, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
    ) -> None:
        shapes = []

        def round_trip(given: list[np.ndarray]) -> tuple[int, list[np.ndarray]]:
            shapes.extend(picture.shape for picture in given)
            return 1, given

        monkeypatch.setattr(
            rd_exact, "color_coders", lambda gray: [Coder(name=str(gray), version="1", round_trip=round_trip)]
        )
        (point,) = rd_exact.color_points(recording, Store(tmp_path))
        assert point.setting == "False"
        assert shapes == [(30, 40, 3)] * 2


class TestTables:
    def test_cells(self) -> None:
        other = replace(result("desk"), depth=[theirs("FFV1", 200)])
        text = report([], "Heading.", exact=[result(), other])
        lines = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines()]
        assert [f"3dvc `{EXACT}`", "1.00", "0.04", "0.04"] in lines
        assert ["FFV1", "1.00", "0.08", "0.02"] in lines
        assert [f"3dvc `{LEVEL}`", "1.50", "0.03", "0.03"] in lines
        assert ["LERC", "2.00", "0.04", "-"] in lines
        assert [f"3dvc `{LOSSLESS}`", "1.00", "0.06", "0.06"] in lines
        assert ["PNG", "2.00", "0.12", "0.12"] in lines
        assert ["room", f"`{LOSSLESS}`", "4,600", "36.8", "0.06", "0.40", "99.00", "0.0"] in lines

    def test_nothing_measured_says_nothing(self) -> None:
        assert exact_tables([]) == []
