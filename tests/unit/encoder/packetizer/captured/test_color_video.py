# SPDX-License-Identifier: MIT
"""How fine a color video may be for a number of bytes."""

from __future__ import annotations

import pytest

from threedvc.config import EncoderConfig, VideoConfig, with_quality
from threedvc.config.stages import MAX_COARSENESS, MIN_CRF
from threedvc.encoder.packetizer.captured import color_video
from threedvc.encoder.packetizer.captured.color_video import (
    SCALES,
    ColorVideoWriter,
    VideoChoice,
    picture_coding,
    video_bytes,
)
from threedvc.errors import ConfigError
from threedvc.stream.captured_headers import ColorVideoHeader
from threedvc.stream.packets import Packet


class SizedVideo(ColorVideoWriter):
    """Packets of known sizes, without frames."""

    def __init__(self, finest_bytes: float, halving: float) -> None:
        self.trials: list[float] = []
        self.sizes: dict[VideoChoice, int] = {}
        self._finest, self._halving = finest_bytes, halving

    def packets(self, choice: VideoChoice) -> list[Packet]:
        coarseness = choice.coarseness
        self.trials.append(coarseness)
        size = self._finest * 2 ** (-(coarseness - MIN_CRF) / self._halving) * (1 + (coarseness % 3) / 50)
        return [ColorVideoHeader(frame=0, columns=8, rows=8).packet(bytes(int(size)))]


@pytest.mark.parametrize("halving", [4.0, 7.0, 12.0])
@pytest.mark.parametrize("budget", [2_000, 30_000, 400_000])
def test_budgets_are_nearly_used(budget: int, halving: float) -> None:
    writer = SizedVideo(1e6, halving)
    size = video_bytes(writer.packets(writer.choice_within(budget)))
    assert len(writer.trials) <= color_video.MAX_TRIALS + 1
    finest, coarsest = (video_bytes(writer.packets(VideoChoice(each))) for each in (MIN_CRF, MAX_COARSENESS))
    if coarsest <= budget <= finest:
        assert 0.88 * budget < size <= budget
    else:
        assert size == (coarsest if budget < coarsest else finest)


def test_a_share_of_the_bytes_may_take_more_trials() -> None:
    writer = SizedVideo(1e6, 4.0)
    few, more = (
        video_bytes(writer.packets(writer.choice_within(9_000, VideoChoice(70), 2, enough))) for enough in (None, 0.85)
    )
    assert few < 0.85 * 9_000 <= more <= 9_000


@pytest.mark.parametrize(("budget", "coarseness"), [(10, MAX_COARSENESS), (1 << 30, MIN_CRF)])
def test_the_ends_are_found(budget: int, coarseness: float) -> None:
    assert SizedVideo(1e6, 7.0).choice_within(budget, VideoChoice(60, full_chroma=True)) == VideoChoice(
        coarseness, full_chroma=True
    )


def test_coarser_pictures_become_smaller() -> None:
    codings = [picture_coding(MIN_CRF + k / 4) for k in range(int(4 * (MAX_COARSENESS - MIN_CRF)) + 1)]
    scales = [coding.scale for coding in codings]
    assert scales == sorted(scales, reverse=True)
    assert set(scales) == set(SCALES)
    assert all(1 <= coding.crf <= 70 and (4 * coding.crf).is_integer() for coding in codings)
    assert codings[-1].crf == 70


def test_quality_tells_the_coarseness() -> None:
    found = [with_quality(EncoderConfig(), quality).video.coarseness for quality in range(1, 101)]
    assert found == sorted(found, reverse=True)
    assert found[49] == VideoConfig().coarseness
    assert found[0] == MAX_COARSENESS
    assert found[99] < 10


@pytest.mark.parametrize("choice", [{"coarseness": 0.5}, {"coarseness": 83}, {"coarseness": 20.1}, {"preset": 14}])
def test_impossible_choices_are_refused(choice: dict[str, float]) -> None:
    with pytest.raises(ConfigError, match="of a video must be within"):
        VideoConfig(**choice)  # type: ignore[arg-type]
