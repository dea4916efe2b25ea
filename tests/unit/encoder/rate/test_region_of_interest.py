# SPDX-License-Identifier: MIT
"""Focus of attention: bits go where the user looks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from helpers.streams import ListSequence, drawn
from threedvc.coding.color import ColorSettings
from threedvc.config import (
    ColorVideo,
    EncoderConfig,
    Motion,
    Preset,
    RegionOfInterest,
    SegmentationConfig,
    SegmentationMode,
    Sensor,
    with_preset,
)
from threedvc.encoder.pipeline.encoder import Encoder
from threedvc.encoder.rate.rate_control import stream_bytes
from threedvc.encoder.rate.region_of_interest import roi_weights, with_roi_weights, with_steps_scaled
from threedvc.errors import ConfigError
from threedvc.model.model_update import ModelUpdate
from threedvc.stream.packets import Packet
from threedvc.synthesis import SyntheticSequence, make_scene

CELLS = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 5, 0]], dtype=np.int32)
BOX = (0.1, 0.3, 0.0, 0.1, 0.0, 0.1)
MASKS = SegmentationConfig(mode=SegmentationMode.MASKS)


def filmed(name: str, frames: int = 6) -> ListSequence:
    """Return frames of a camera that moves: a background at rest would be coded as a picture."""
    scene = make_scene(name, frames=60, size=(96, 72))
    if not scene.camera_moves:
        path = scene.T_world_camera.copy()
        path[:, 0, 3] += 0.01 * np.arange(len(path))
        scene = replace(scene, T_world_camera=path, camera_moves=True)
    source = SyntheticSequence(scene)
    kept = [replace(source[index], index=index) for index in range(frames)]
    return ListSequence(kept, replace(source.info, frame_count=frames))


def errors(sequence: ListSequence, packets: list[Packet]) -> tuple[float, float]:
    """Return the mean squared error of the colors of the background and of objects, as labeled by the input."""
    sums, counts = np.zeros(2), np.zeros(2)
    for frame, color in zip(sequence.frames, drawn(packets), strict=True):
        square = np.square(color.astype(float) - frame.color).mean(axis=2)
        mask = np.zeros(square.shape, np.uint8) if frame.mask is None else frame.mask
        for k, here in enumerate((mask == 0, mask > 0)):
            sums[k] += square[here].sum()
            counts[k] += np.count_nonzero(here)
    return float(sums[0] / counts[0]), float(sums[1] / max(counts[1], 1))


def test_weights_of_object_and_box() -> None:
    focuses = [
        RegionOfInterest(weight=4, number=1),
        RegionOfInterest(weight=3, box_m=BOX),
        RegionOfInterest(weight=2, number=0),
    ]
    np.testing.assert_allclose(roi_weights(focuses, 1, CELLS, 0.1), 4)
    np.testing.assert_allclose(roi_weights(focuses, 0, CELLS, 0.1), [2, 6, 6, 2])
    np.testing.assert_allclose(roi_weights([], 0, CELLS, 0.1), 1)


def test_steps_follow_the_heaviest_cell() -> None:
    settings = ColorSettings(luma_step=16, chroma_step=32)
    update = ModelUpdate.adding(CELLS, np.zeros((4, 3), np.int16))
    same, steps = with_roi_weights(update, settings, (), 0, 0.1)
    assert same is update
    assert steps is settings
    weighted, steps = with_roi_weights(update, settings, (RegionOfInterest(weight=4, box_m=BOX),), 0, 0.1)
    assert weighted.importance is not None
    np.testing.assert_allclose(weighted.importance, [0.25, 1, 1, 0.25])
    assert (steps.luma_step, steps.chroma_step) == (8, 16)
    seen = replace(update, importance=np.array([2, 1, 1, 1], np.float32))
    weighted, _ = with_roi_weights(seen, settings, (RegionOfInterest(weight=4, box_m=BOX),), 0, 0.1)
    assert weighted.importance is not None
    np.testing.assert_allclose(weighted.importance, [0.5, 1, 1, 0.25])


@pytest.mark.parametrize("weight", [100.0, 0.01])
def test_steps_keep_within_their_bounds(weight: float) -> None:
    steps = with_steps_scaled(ColorSettings(luma_step=0.1, chroma_step=200), weight)
    assert ColorSettings(luma_step=steps.luma_step, chroma_step=steps.chroma_step) == steps


def test_an_object_in_focus_gets_better_at_the_cost_of_the_rest() -> None:
    sequence = filmed("objects")
    config = EncoderConfig(
        color_video=ColorVideo.OFF,
        threads=1,
        sensor=Sensor.IDEAL,
        motion=Motion.KNOWN,
        segmentation=MASKS,
        voxel_size_m=0.03,
    )
    plain = replace(with_preset(config, Preset.FAST), bitrate_bps=100e3)
    numbers = {int(number) for frame in sequence.frames for number in np.unique(frame.mask)} - {0}
    focus = tuple(RegionOfInterest(weight=10, number=number) for number in sorted(numbers))
    made = [list(Encoder(sequence.info, each).packets(sequence)) for each in (plain, replace(plain, focus=focus))]
    (background, objects), (background_beside, objects_in_focus) = (errors(sequence, packets) for packets in made)
    assert objects_in_focus < 0.95 * objects
    assert objects_in_focus / background_beside < 0.95 * objects / background
    assert stream_bytes(made[1]) < 1.05 * stream_bytes(made[0])


@pytest.mark.parametrize("causal", [False, True])
def test_a_box_in_focus_gets_better(causal: bool) -> None:
    sequence = filmed("room")
    config = EncoderConfig(
        color_video=ColorVideo.OFF,
        threads=1,
        sensor=Sensor.IDEAL,
        motion=Motion.KNOWN,
        voxel_size_m=0.06,
        causal=causal,
        refine=False,
    )
    whole = (-50.0, 50.0, -50.0, 50.0, -50.0, 50.0)
    sizes, squares = [], []
    for focus in ((), (RegionOfInterest(weight=16, box_m=whole),)):
        packets = list(Encoder(sequence.info, replace(config, focus=focus)).packets(sequence))
        sizes.append(stream_bytes(packets))
        squares.append(errors(sequence, packets)[0])
    assert squares[1] < squares[0]
    assert sizes[1] > 1.2 * sizes[0]


def test_a_focus_on_an_object_that_is_not_there_is_refused() -> None:
    sequence = filmed("room", 3)
    config = EncoderConfig(
        color_video=ColorVideo.OFF,
        threads=1,
        sensor=Sensor.IDEAL,
        focus=(RegionOfInterest(weight=4, number=7),),
        refine=False,
    )
    with pytest.raises(ConfigError, match="focus on object 7: room has object 0; name one of them"):
        list(Encoder(sequence.info, config).packets(sequence))
