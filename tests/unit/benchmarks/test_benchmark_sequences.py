# SPDX-License-Identifier: MIT
"""The table of recorded sequences: which runs it has, and what stands in its cells."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

import pytest

import reporting
import sequences
from sequences import RUNS, Outcome, Run
from speed import Cost
from threedvc.cli.main import main as command

QUALITY = {"psnr_rgb": 20.0, "psnr_y": 21.0, "ssim_y": 0.5, "depth_within_1pct": 0.75, "depth_lost": 0.02}
STATISTICS: dict[str, Any] = {
    "file_bytes": 12345,
    "frames": 60,
    "kbit_s": 49.38,
    "ratio": 1000.4,
    "quality": {**QUALITY, "depth_median_mm": None},
    "trajectory": {
        "status": {"tracked": 58, "lost": 2},
        "objects": {"1": {"ate_rmse_mm": 3.0}, "2": {"ate_rmse_mm": 7.26}},
    },
}


def outcome(run: Run) -> Outcome:
    encode, decode = Cost(seconds=30.0, peak_mib=400.4), Cost(seconds=4.0, peak_mib=150.0)
    return Outcome(run=run, statistics=STATISTICS, encode=encode, decode=decode)


class TestRuns:
    @pytest.mark.parametrize("run", RUNS, ids=lambda run: f"{run.sequence} {run.options}")
    def test_options_are_understood(self, run: Run) -> None:
        arguments = [run.sequence, "out.3dvc", *shlex.split(run.options)]
        command.commands["encode"].make_context("encode", arguments)

    def test_no_run_stands_there_twice(self) -> None:
        assert len(set(RUNS)) == len(RUNS)

    def test_named_folder_has_its_runs_and_another_one_without_options(self, tmp_path: Path) -> None:
        known, other = tmp_path / RUNS[0].sequence, tmp_path / "mine"
        named = [run for run in RUNS if run.sequence == known.name]
        assert sequences.runs_of([known, other]) == [*((known, run) for run in named), (other, Run(sequence="mine"))]


class TestTable:
    def test_cells_of_a_row(self) -> None:
        row = dict(zip(sequences.HEADER, outcome(Run(sequence="mine", options="--motion track")).row(), strict=True))
        assert row["bytes"] == "12,345"
        assert (row["PSNR RGB"], row["within 1 %"], row["median mm"]) == ("20.00", "0.7500", "-")
        assert (row["ATE mm"], row["lost poses"]) == ("7.3", "2")
        assert (row["encode fps"], row["decode fps"], row["encode MiB"]) == ("2.0", "15.0", "400")

    @pytest.mark.parametrize(
        ("trajectory", "expected"),
        [
            ({"status": {}}, None),
            ({"ate_rmse_mm": 5.0, "objects": {"1": {"ate_rmse_mm": 9.0}}}, 5.0),
            ({"objects": {"1": {"ate_rmse_mm": 9.0}, "2": {"ate_rmse_mm": 4.0}}}, 9.0),
        ],
        ids=["no poses", "camera", "objects"],
    )
    def test_error_of_the_trajectory(self, trajectory: dict[str, Any], expected: float | None) -> None:
        assert sequences.trajectory_error(trajectory) == expected

    def test_failed_run_is_named_and_the_others_stand(
        self, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        def measure(folder: Path, run: Run, frames: str | None) -> Outcome:
            if folder.name == "broken":
                raise SystemExit("3dvc encode broken: no depth")
            return outcome(run)

        monkeypatch.setattr(sequences, "outcome", measure)
        monkeypatch.setattr(sequences, "warm_up", lambda: None)
        monkeypatch.setattr(sequences, "WORK", tmp_path / "work")
        table = tmp_path / "table.md"
        with pytest.raises(SystemExit, match="1 of the runs failed"):
            sequences.main([str(tmp_path / "broken"), str(tmp_path / "mine"), "--output", str(table)])
        text = table.read_text(encoding="utf-8")
        assert "Failed: `broken`." in text
        assert "| mine " in text
        assert "3dvc encode broken: no depth" in capsys.readouterr().err

    def test_without_recordings_it_says_so_and_writes_nothing(
        self, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        monkeypatch.setattr(sequences, "DATA", tmp_path)
        sequences.main(["--output", str(tmp_path / "table.md")])
        assert "no recorded sequences in" in capsys.readouterr().err
        assert not (tmp_path / "table.md").exists()


def test_columns_of_text_are_flush_left_and_others_flush_right() -> None:
    table = reporting.markdown_table(["name", "n"], [["a", "1"], ["longer", "1234"]])
    assert table.splitlines() == ["| name   |    n |", "| ------ | ---: |", "| a      |    1 |", "| longer | 1234 |"]
