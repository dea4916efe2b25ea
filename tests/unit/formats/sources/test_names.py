# SPDX-License-Identifier: MIT
"""What the numbers in file names mean: frames' numbers, times, or nothing; and which pictures pair."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

import pytest

from threedvc.errors import SequenceError
from threedvc.formats.sources.association import Pairing, pair_named
from threedvc.formats.sources.names import NamedPictures, named_pictures, times_in

FOLDER = Path("folder")
THIRTIETHS = range(12)
MS = 1_000_000


def named(stems: Sequence[str], folder: Path = FOLDER) -> NamedPictures:
    return named_pictures(folder, [folder / f"{stem}.png" for stem in stems])


def times_ms(stems: Sequence[str]) -> list[float]:
    return [stamp / MS for stamp in named(stems).times_ns]


def numbers(stems: Sequence[str]) -> list[int]:
    found = named(stems)
    assert found.unit_ns is None
    return [number for (number,) in found.pictures]


@pytest.mark.parametrize(
    ("stems", "expected"),
    [
        (["7", "10", "9"], [7, 9, 10]),
        (["000100", "000110", "000120", "000140"], [100, 110, 120, 140]),
        (["take1_rgb_0001", "take1_rgb_0002"], [1, 2]),
        (["000003_v2", "000004_v2"], [3, 4]),
        (["Maya.0001", "Maya.0002"], [1, 2]),
        (["shot2.0001", "shot2.0002", "shot2.0003"], [1, 2, 3]),
        (["s1.01", "s1.02", "s1.03", "s1.05"], [1, 2, 3, 5]),
        (["0000000000", "0000000001"], [0, 1]),
        (["3", "17", "20", "44", "81"], [3, 17, 20, 44, 81]),
        (["0", "116", "422"], [0, 116, 422]),
        (["rgb_4_v_4", "rgb_5_v_5"], [4, 5]),
        (["20230501_123005_0001", "20230501_123005_0002"], [1, 2]),
        (["20230501_123005_01", "20230501_123005_02", "20230501_123005_03"], [1, 2, 3]),
        (["20231114_000001", "20231114_000002"], [1, 2]),
        (["20231399_120001", "20231399_120002"], [120001, 120002]),
    ],
)
def test_numbers_of_frames(stems: list[str], expected: list[int]) -> None:
    assert numbers(stems) == expected


@pytest.mark.parametrize(
    ("stems", "unit", "second_ms"),
    [
        ([str(round(5 + k / 30, 3)) for k in THIRTIETHS], "seconds", 5033),
        ([f"take_Color_{1700000000.1 + k / 30:.11f}" for k in THIRTIETHS], "seconds", None),
        ([f"{1700000000 + k // 30}_{k % 30 * 33333333:09d}" for k in range(40)], "seconds", 1700000000033.333333),
        ([f"{1700000000 + k // 30}-{k % 30 * 33333:06d}" for k in range(40)], "seconds", 1700000000033.333),
        ([str(1700000000 + k) for k in THIRTIETHS], "seconds", 1700000001000),
        ([f"2023-11-14_22-13-{20 + k // 10:02d}.{k % 10 * 100:03d}" for k in range(25)], "seconds", 1700000000100),
        ([f"cam1_20231114T2213{20 + k // 10:02d}_{k % 10 * 100:03d}" for k in range(25)], "seconds", 1700000000100),
        (["20231114221358", "20231114221359", "20231114221400"], "seconds", 1700000039000),
        ([f"{1694000000123.25 + 33.25 * k:.4f}" for k in THIRTIETHS], "milliseconds", 1694000000156.5),
        ([str(round(k * 1000 / 30)) for k in THIRTIETHS], "milliseconds", 33),
        (["0", "33", "66", "133", "167", "200"], "milliseconds", 33),
        (["000000", "000017", "000033", "000050"], "milliseconds", 17),
        (["0", "31", "66", "98", "134", "166"], "milliseconds", 31),
        ([str(1700000000000 + 40 * k) for k in THIRTIETHS], "milliseconds", 1700000000040),
        ([f"{33333 * k:09d}" for k in THIRTIETHS], "microseconds", 33.333),
        ([f"{k:07d}-{33369 * k:012d}" for k in THIRTIETHS], "microseconds", 33.369),
        ([str(1700000000000000000 + 33333333 * k) for k in THIRTIETHS], "nanoseconds", 1700000000033.333333),
    ],
)
def test_names_that_are_times(stems: list[str], unit: str, second_ms: float | None) -> None:
    shuffled = [*stems[1::2], *stems[::2]]
    found = named(shuffled)
    assert found.unit == unit
    assert [path.stem for path in found.pictures.values()] == stems
    if second_ms is not None:
        assert times_ms(shuffled)[1] == pytest.approx(second_ms, abs=1e-3)


def test_order_of_decimal_seconds_without_trailing_zeros() -> None:
    assert times_ms(["5.0", "5.1", "5.033", "5.067", "5.133"]) == [5000, 5033, 5067, 5100, 5133]
    assert times_ms(["9.9", "10.0", "10.1", "9.8"]) == [9800, 9900, 10000, 10100]


@pytest.mark.parametrize(
    ("stems", "said"),
    [
        (["000003", "3", "4"], "3.png: no number in its name tells it from 000003.png; keep one of the two"),
        (["3", "000003"], "3.png: no number in its name tells it from 000003.png; keep one of the two"),
        (["left_1", "right_1", "left_2"], "right_1.png: no number in its name tells it from left_1.png"),
        (["5.0", "5.033", "5.067", "5.1", "5.100"], "5.100.png: no number in its name tells it from 5.1.png"),
        (["s1_1", "s1_2", "s2_1", "s2_2"], "s2_2.png: 2 numbers change from name to name (s1_1.png, s2_2.png)"),
        (["12-30-59_900", "12-31-00_100", "12-31-00_900"], "numbers change from name to name"),
        (["1", "2", "3 (1)"], "3 (1).png: has 2 numbers in its name, but 1.png has one number"),
        (["thumbnail", "1", "2"], "thumbnail.png: has no numbers in its name, but 1.png has one number"),
    ],
)
def test_names_that_cannot_be_told(stems: list[str], said: str) -> None:
    with pytest.raises(SequenceError) as caught:
        named(stems)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_two_suffixes_of_one_frame() -> None:
    with pytest.raises(SequenceError, match=r"3\.png: no number in its name tells it from 3\.jpg; keep one of the two"):
        named_pictures(FOLDER, [FOLDER / "3.png", FOLDER / "3.jpg", FOLDER / "4.png"])


def test_many_names_are_fast() -> None:
    start = time.process_time()
    found = named([f"{k:06d}" for k in range(20_000)])
    assert len(found.pictures) == 20_000
    assert time.process_time() - start < 2


def test_times_in_a_name() -> None:
    assert times_in("mask_5.033", "seconds") == [5033 * MS]
    assert times_in("m1_0033", "milliseconds") == [MS, 33 * MS]


def paired(colors: Sequence[str], depths: Sequence[str]) -> Pairing:
    return pair_named(named(colors, Path("color")), named(depths, Path("depth")))


def names_of(pairing: Pairing) -> list[tuple[str, str]]:
    return [(color.stem, depth.stem) for color, depth in pairing.pairs]


def test_pairs_by_time_where_both_sides_lost_frames() -> None:
    clock = [round(k * 1000 / 30) for k in range(20)]
    colors = [str(stamp) for k, stamp in enumerate(clock) if k not in (3, 8, 9)]
    depths = [str(stamp + 5) for k, stamp in enumerate(clock) if k not in (5, 8, 12)]
    pairing = paired(colors, depths)
    assert all(int(depth) - int(color) == 5 for color, depth in names_of(pairing))
    assert len(pairing.pairs) == 15
    assert pairing.stamps[0] == (5 * MS, 0)
    assert [str(notice) for notice in pairing.notices] == [
        "Note: depth: the names are taken for times in milliseconds; 33 ms between frames",
        "Note: .: 17 color, 17 depth pictures, 15 pairs within 20 ms; 2 left out",
    ]


def test_equal_times_of_both_pictures_are_told_once() -> None:
    stamps = [str(1700000000000000000 + 33333333 * k) for k in range(4)]
    assert [color for _, color in paired(stamps, stamps).stamps] == [None] * 4


def test_few_times_take_the_unit_of_the_other_folder() -> None:
    pairing = paired(["0", "40", "80", "120"], ["1", "40", "81", "120", "161"])
    assert names_of(pairing) == [("0", "1"), ("40", "40"), ("80", "81"), ("120", "120")]
    assert pairing.unit == "milliseconds"


@pytest.mark.parametrize(
    ("colors", "depths", "said"),
    [
        (
            [str(k) for k in range(10) if k != 3],
            [str(k) for k in range(10) if k != 7],
            "color/7.png: has no depth picture in depth, and 3.png there no color picture (9 color and 9 depth "
            "pictures, 8 of their names agree)",
        ),
        (["1", "2", "3"], ["0", "1", "2"], "color/3.png: has no depth picture in depth, and 0.png there"),
        (["0", "1", "2"], ["0", "1"], "color/2.png: has no depth picture in depth (3 color and 2 depth pictures)"),
        (["0", "1"], ["0", "1", "2"], "depth/2.png: has no color picture in color (2 color and 3 depth pictures)"),
        (["a", "b", "c"], ["a", "b"], "color: names tell nothing that pairs these pictures with those in depth (3"),
        (["a", "b"], ["1", "2"], "color: names tell nothing that pairs these pictures with those in depth (2"),
        (["5.0", "5.033", "5.067"], ["9.0", "9.033", "9.067"], "color: names are times, and none is within 20 ms"),
        (["5.0", "5.033", "5.067"], ["0", "1", "2"], "color/5.0.png: has no depth picture in depth, and 0.png there"),
    ],
)
def test_names_that_do_not_pair(colors: list[str], depths: list[str], said: str) -> None:
    with pytest.raises(SequenceError) as caught:
        paired(colors, depths)
    assert said in str(caught.value)


def test_names_without_numbers_pair_in_order_and_it_is_told() -> None:
    pairing = paired(["ca", "cb"], ["da", "db"])
    assert names_of(pairing) == [("ca", "da"), ("cb", "db")]
    assert [str(notice) for notice in pairing.notices] == [
        "Note: color: names have no numbers; paired with depth in order of names (ca.png and da.png first)"
    ]


def test_regular_steps_of_milliseconds_are_doubted() -> None:
    stems = [str(100 * k) for k in range(6)]
    assert [str(notice) for notice in paired(stems, stems).notices] == [
        "Warning: depth: the names step by 100 (0.png, 100.png) and are taken for frame numbers; if they are "
        "milliseconds (10 frames a second), rename the files to seconds (0.000.png, 0.100.png)"
    ]
    for step in (1, 10, 30, 37):
        stems = [str(step * k) for k in range(6)]
        assert not paired(stems, stems).notices
