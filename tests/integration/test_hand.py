# SPDX-License-Identifier: MIT
"""Things that a hand moves, found by their motion."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from helpers.hand_scene import BALL, BOX, pushing
from helpers.streams import ListSequence
from threedvc.config import ColorVideo, EncoderConfig, Motion, Preset, SegmentationConfig, SegmentationMode, with_preset
from threedvc.decoder.decoder import Decoder
from threedvc.encoder.pipeline.encoder import Encoder
from threedvc.encoder.segmentation.motion.transient_numbers import MAX_SEGMENT_FRAMES, TRANSIENT_NUMBERS
from threedvc.encoder.segmentation.sequence_labels import VOID_LABEL, SequenceLabels

CONFIG = EncoderConfig(
    color_video=ColorVideo.OFF,
    threads=1,
    motion=Motion.TRACK,
    segmentation=SegmentationConfig(mode=SegmentationMode.MOTION),
    refine=False,
)
FRAMES, SIZE = 54, (160, 120)


@cache
def filmed(held: bool) -> ListSequence:
    return pushing(FRAMES, SIZE, held=held)


@cache
def labels_of(held: bool, live: bool) -> np.ndarray:
    frames, sequence_labels = filmed(held), SequenceLabels(filmed(held).info, CONFIG)
    if not live:
        sequence_labels.segment_all(frames)
    return np.stack([sequence_labels.labels(frame) for frame in frames])


def main_label(labels: np.ndarray, masks: np.ndarray, thing: int) -> int:
    inside = labels[(masks == thing) & (labels > 0) & (labels < TRANSIENT_NUMBERS.start)]
    return int(np.bincount(inside).argmax()) if len(inside) else 0


@pytest.mark.parametrize(
    ("held", "live"), [(False, False), (False, True), (True, True), pytest.param(True, False, marks=pytest.mark.long)]
)
def test_what_a_hand_pushes_is_an_object_of_its_own(held: bool, live: bool) -> None:
    frames = filmed(held)
    masks, labels = np.stack([frame.mask for frame in frames]), labels_of(held, live)
    last = slice(FRAMES - 5, FRAMES)
    known = np.stack([frame.depth > 0 for frame in frames])[last]
    found = {thing: main_label(labels[last], masks[last], thing) for thing in (BOX, BALL)}
    assert 0 not in found.values()
    assert found[BOX] != found[BALL]
    for thing, label in found.items():
        there, true = (labels[last] == label) & known, (masks[last] == thing) & known
        assert np.count_nonzero(there & true) > 0.6 * np.count_nonzero(there | true)
    others = set(np.unique(labels)) - {0, VOID_LABEL, *TRANSIENT_NUMBERS, *found.values()}
    assert len(others) <= 1  # the hand


def test_in_a_file_things_are_labeled_before_the_hand_comes() -> None:
    first = filmed(False)[0]
    labels = labels_of(False, False)[0]
    for thing in (BOX, BALL):
        inside = labels[(first.mask == thing) & (first.depth > 0)]
        assert np.mean((inside > 0) & (inside != VOID_LABEL)) > 0.8


@cache
def limp() -> ListSequence:
    return pushing(30, SIZE, limp=True)


@cache
def limp_stream(bitrate_bps: float | None) -> tuple[list, Decoder]:
    frames = limp()
    config = replace(with_preset(CONFIG, Preset.LIVE), bitrate_bps=bitrate_bps)
    decoder = Decoder()
    states = list(decoder.frames(iter(list(Encoder(frames.info, config).packets(frames)))))
    return states, decoder


def test_what_passes_is_an_object_for_a_moment() -> None:
    states, decoder = limp_stream(None)
    assert decoder.complete
    passing = [number for number, model in decoder.models.items() if model.passing]
    assert passing
    assert set(passing) <= set(TRANSIENT_NUMBERS)
    assert all(decoder.models[number].cell_count for number in passing)
    for number in passing:
        away = [
            np.linalg.norm(state.T_camera_object[number][:3, 3]) > 100
            for state in states
            if number in state.T_camera_object
        ]
        assert away[-1]
        assert not all(away)
        assert sum(not each for each in away) <= MAX_SEGMENT_FRAMES


def test_at_low_rates_what_passes_is_left_out() -> None:
    _, decoder = limp_stream(16_000)
    assert not any(model.passing for model in decoder.models.values())
