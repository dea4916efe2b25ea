# SPDX-License-Identifier: MIT
"""The paper's experiment: its accounting, its report, and the pictures of its models."""

from __future__ import annotations

import re
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest

import paper_experiment
import paper_report
from paper_report import CASES, EARLY, PAPER_CELLS
from spheres import Spheres, View, draw, spheres_of_cells
from threedvc.synthesis import make_scene

FRAMES = 3
SIDE_PX = 61
WIDTH_PX = 200


def experiment(place: Path, size: tuple[int, int]) -> Path:
    """Make an experiment with a few frames; return its folder."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(paper_experiment, "SPHERES_WIDTH_PX", WIDTH_PX)
        patch.setattr(paper_experiment, "make_scene", partial(make_scene, size=size))
        paper_experiment.main([str(place), "--frames", str(FRAMES)])
    return place


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of an experiment with pictures of the paper's size."""
    return experiment(tmp_path_factory.mktemp("paper"), (100, 100))


@pytest.fixture(scope="module")
def small_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of an experiment with small pictures."""
    return experiment(tmp_path_factory.mktemp("small"), (40, 40))


def one_sphere(x: float, y: float, z: float, level: float = 200.0) -> Spheres:
    return Spheres(centers=np.array([[x, y, z]]), radii=np.array([0.1]), colors=np.full((1, 3), level))


def both(first: Spheres, second: Spheres) -> Spheres:
    return Spheres(
        centers=np.vstack([first.centers, second.centers]),
        radii=np.append(first.radii, second.radii),
        colors=np.vstack([first.colors, second.colors]),
    )


class TestAccounting:
    @pytest.mark.parametrize("case", [case for case in CASES if case.pose_rule != "3F/10"], ids=str)
    def test_figures_of_the_paper_follow_from_its_equations(self, case: paper_report.Case) -> None:
        assert case.ratio(PAPER_CELLS[case.sight]) == pytest.approx(case.paper, abs=1)

    def test_poses_of_each_rule_are_that_part_of_the_frames(self) -> None:
        parts = {"F": 1.0, "3F/10": 0.3, "F/3": 1 / 3}
        assert all(case.pose_frames == pytest.approx(parts[case.pose_rule] * case.frames) for case in CASES)

    def test_report_says_which_rule_gives_the_printed_figures(self) -> None:
        assert list(paper_report.remarks()) == [
            "F_m = F reproduces the paper's 77 and 304.",
            "F_m = 3F/10 does not reproduce the paper's 277 and 967.",
            "F_m = F/3 reproduces the paper's 277 and 967.",
        ]

    def test_document_has_the_ratios_of_the_equations(self, repository: Path) -> None:
        text = (repository / "docs" / "paper.md").read_text(encoding="utf-8")
        wanted = {f"1:{case.ratio(PAPER_CELLS[case.sight]):.1f}" for case in CASES}
        assert {ratio for ratio in wanted if ratio not in text} == set()


@pytest.mark.long
class TestReport:
    def test_holds_the_cells_after_two_and_after_all_frames(self, folder: Path) -> None:
        text = (folder / "report.md").read_text(encoding="utf-8")
        rows = re.findall(r"^\| (\d+) frames +\|(.*)\|.*\|$", text, re.MULTILINE)
        counts = {int(frames): [int(cell) for cell in cells.split("|")] for frames, cells in rows}
        assert set(counts) == {EARLY, FRAMES}
        assert all(300 < count < 3000 for count in counts[EARLY])

    def test_gives_every_case_for_both_models(self, folder: Path) -> None:
        text = (folder / "report.md").read_text(encoding="utf-8")
        for case in CASES:
            assert f" {case.ratio(PAPER_CELLS[case.sight]):.1f} " in text

    def test_weighs_the_files_that_it_wrote(self, folder: Path) -> None:
        line = next(line for line in (folder / "report.md").read_text().splitlines() if line.startswith("| file "))
        told = [int(cell.split()[0].replace(",", "")) for cell in line.split("|")[2:4]]
        assert told == [(folder / name).stat().st_size for name in ("pixel.3dvc", "default.3dvc")]

    def test_columns_are_aligned(self, folder: Path) -> None:
        lines = (folder / "report.md").read_text(encoding="utf-8").split("\n\n")
        tables = [part.splitlines() for part in lines if part.startswith("|")]
        assert len(tables) == 3
        assert all(len({len(line) for line in table}) == 1 for table in tables)


class TestPictures:
    def test_every_range_frame_stands_beside_its_input(self, small_folder: Path) -> None:
        pictures = [cv2.imread(str(path), cv2.IMREAD_UNCHANGED) for path in sorted((small_folder / "range").iterdir())]
        assert len(pictures) == FRAMES
        for picture in pictures:
            assert picture is not None
            given, drawn = np.hsplit(picture.astype(int), 2)
            assert np.median(np.abs(given - drawn)) <= 3

    def test_near_is_bright_and_nothing_is_black(self) -> None:
        gray = paper_experiment.range_picture(np.array([[0.0, 1.0, 2.0]], dtype=np.float32), 1.0, 2.0)
        assert gray[0, :: paper_experiment.RANGE_ENLARGEMENT].tolist() == [0, 255, paper_experiment.DARKEST_GRAY]

    def test_models_are_drawn_for_both_moments(self, small_folder: Path) -> None:
        pictures = [cv2.imread(str(small_folder / f"spheres_{count:03}.png")) for count in (EARLY, FRAMES)]
        assert all(picture is not None and picture.shape[1] == WIDTH_PX for picture in pictures)


class TestSpheres:
    def test_radius_grows_with_probability_from_nothing(self) -> None:
        cells = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]], dtype=np.int32)
        made = spheres_of_cells(cells, np.array([0.4, 0.6, 0.9, 1.0]), np.zeros((4, 3)), 0.01)
        np.testing.assert_allclose(made.centers[:, 0], [0.015, 0.025, 0.035])
        assert np.all(np.diff(made.radii) > 0)
        assert made.radii[-1] == pytest.approx(0.0062)

    def test_disc_has_the_size_of_the_sphere(self) -> None:
        sphere = one_sphere(0.3, -0.2, 0.7, 0.0)
        view = View.around(sphere, np.array([0.0, 1.0, 0.0]), SIDE_PX)
        assert (view.width, view.height) == (SIDE_PX, SIDE_PX)
        covered = np.abs(draw(sphere, view).astype(int) - draw(one_sphere(9, 9, 9), view)).max(axis=2) > 8
        expected = np.pi * (0.1 * view.scale) ** 2
        assert np.count_nonzero(covered) == pytest.approx(expected, rel=0.05)

    def test_nearer_sphere_hides_the_farther(self) -> None:
        near, far = one_sphere(0, 0, 0, 250.0), one_sphere(0, 0.5, 0, 20.0)
        view = View.around(near, np.array([0.0, 1.0, 0.0]), SIDE_PX)
        back = View.around(near, np.array([0.0, -1.0, 0.0]), SIDE_PX)
        middle = SIDE_PX // 2
        for pair in (both(near, far), both(far, near)):
            assert draw(pair, view)[middle, middle].min() > 100
            assert draw(pair, back)[middle, middle].max() < 60

    def test_up_is_up(self) -> None:
        pair = both(one_sphere(0, 0, 1, 250.0), one_sphere(0, 0, 0, 20.0))
        view = View.around(pair, np.array([1.0, 0.0, -0.3]), SIDE_PX)
        picture = draw(pair, view)
        column = picture[:, view.width // 2].mean(axis=1)
        assert np.argmin(column) > view.height / 2

    def test_sphere_towards_the_light_casts_a_shadow(self) -> None:
        receiver = one_sphere(0, 0, 0)
        view = View.around(receiver, np.array([0.0, 1.0, 0.0]), SIDE_PX)
        towards_light = np.array([-0.48, -0.65, -0.60]) @ view.axes
        blocker = one_sphere(*(0.5 * towards_light / np.linalg.norm(towards_light)))
        lit, shaded = draw(receiver, view), draw(both(receiver, blocker), view)
        middle = SIDE_PX // 2
        assert shaded[middle, middle, 0] < 0.75 * lit[middle, middle, 0]


def test_too_few_frames_are_refused(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match="2"):
        paper_experiment.main([str(tmp_path), "--frames", "1"])
    assert "--frames 1: the experiment needs at least 2" in capsys.readouterr().err
