# SPDX-License-Identifier: MIT
"""Coders without loss or within a bound: they keep what they promise, and what does not is refused."""

from __future__ import annotations

import sys

import numpy as np
import pytest

import exact_coders
from av1 import MissingCodec
from exact_coders import Coder, NotExact, Numbers, checked_size, color_coders, depth_coders

HEIGHT, WIDTH, FRAMES = 34, 50, 3
LIMIT = 5


@pytest.fixture
def codecs() -> None:
    """Skip where a codec is missing."""
    try:
        exact_coders.library()
        exact_coders.pictures_library()
    except MissingCodec as error:
        pytest.skip(str(error))


def depths() -> list[np.ndarray]:
    rows, columns = np.mgrid[0:HEIGHT, 0:WIDTH]
    pictures = [(900 + 7 * columns + rows + 3 * k).astype(np.uint16) for k in range(FRAMES)]
    for picture in pictures:
        picture[10:14, 20:30] = 0
    return pictures


def colors() -> list[np.ndarray]:
    return [np.random.default_rng(k).integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8) for k in range(FRAMES)]


def coder(change: int, limit: int = 0) -> Coder:
    """Return one that adds something to every value."""
    return Coder(
        name="worse", version="1", limit=limit, round_trip=lambda given: (7, [picture + change for picture in given])
    )


@pytest.mark.usefixtures("codecs")
class TestCoders:
    def test_every_depth_comes_back_within_the_limit(self) -> None:
        found = {each.name: (each.limit, checked_size(each, depths())) for each in depth_coders(2000, LIMIT)}
        assert {name for name, (limit, _) in found.items() if not limit} == {
            f"{name}{words}"
            for name in ("x265, 12 bits", "FFV1, 16 bits", "JPEG-XL", "JPEG-LS", "PNG")
            for words in ("", ", levels")
        }
        assert all(0 < size < 2 * FRAMES * HEIGHT * WIDTH for _, (size, _) in found.values())
        assert all(worst <= limit for limit, (_, worst) in found.values())
        assert found["LERC"][1][1] == found["JPEG-LS, near lossless"][1][1] == LIMIT

    def test_depths_beyond_twelve_bits_go_through_x265_by_their_numbers_alone(self) -> None:
        names = [each.name for each in depth_coders(5000, LIMIT)]
        assert [name for name in names if "x265" in name] == ["x265, 12 bits, levels", "x265, 12 bits, steps"]

    @pytest.mark.parametrize("gray", [False, True])
    def test_every_color_comes_back(self, gray: bool) -> None:
        pictures = [picture[..., 0] if gray else picture for picture in colors()]
        found = {each.name: checked_size(each, pictures) for each in color_coders(gray)}
        assert list(found) == ["FFV1", "JPEG-XL", "PNG"]
        assert all(worst == 0 for _, worst in found.values())


class TestNumbers:
    def test_each_depth_has_a_number_and_comes_back(self) -> None:
        numbers = Numbers.covering(depths())
        assert len(numbers.depths) == len(np.unique(depths())) - 1
        for picture in depths():
            assert np.array_equal(numbers.decoded(numbers.number_of[picture]), picture)

    def test_numbers_within_a_limit_are_as_few_as_can_be(self) -> None:
        numbers = Numbers.covering([np.array([[0, 100, 104, 110, 111, 900]], dtype=np.uint16)], LIMIT)
        assert numbers.depths.tolist() == [105, 111, 900]
        assert numbers.number_of[[0, 100, 104, 110, 111, 900]].tolist() == [0, 1, 1, 1, 2, 3]
        assert numbers.decoded(np.array([[0, 2]], dtype=np.uint16)).tolist() == [[0, 111]]

    def test_nothing_but_holes(self) -> None:
        numbers = Numbers.covering([np.zeros((2, 2), dtype=np.uint16)])
        assert len(numbers.depths) == 0
        assert not numbers.decoded(np.zeros((2, 2), dtype=np.uint16)).any()


class TestCheck:
    def test_size_and_largest_error(self) -> None:
        assert checked_size(coder(0), depths()) == (7, 0)

    def test_error_above_the_limit_is_refused(self) -> None:
        with pytest.raises(NotExact, match="worse: picture 0 comes back with an error of 1, not 0"):
            checked_size(coder(1), depths())

    def test_holes_that_are_filled_are_refused(self) -> None:
        with pytest.raises(NotExact, match="error of 1, not 5"):
            checked_size(coder(1, LIMIT), depths())


def test_missing_package_is_named_with_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "imagecodecs", None)
    with pytest.raises(MissingCodec, match=r"need imagecodecs; install the extra \[bench\]"):
        exact_coders.pictures_library()
