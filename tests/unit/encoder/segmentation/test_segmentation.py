# SPDX-License-Identifier: MIT
"""Segmentation of frames into objects by masks and by depth."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from threedvc.config import SegmentationConfig, SegmentationMode
from threedvc.encoder.segmentation.masks import resolved_mode, segment
from threedvc.errors import SequenceError
from threedvc.frames.frame import Frame, SequenceInfo
from threedvc.geometry.camera import Camera, CameraRig

DEPTH = np.array([[0.0, 0.5, 1.0], [1.2, 2.0, 0.1]], dtype=np.float32)
LABELS = np.array([[0, 1, 1], [2, 2, 0]], dtype=np.uint8)


def frame(mask: NDArray[np.uint8] | None = None) -> Frame:
    return Frame(index=7, timestamp_ns=0, color=np.zeros((2, 3, 3), dtype=np.uint8), depth=DEPTH, mask=mask)


def info(has_masks: bool = False) -> SequenceInfo:
    rig = CameraRig.registered_to(Camera(width=3, height=2, fx=3.0, fy=3.0, cx=1.0, cy=0.5))
    return SequenceInfo(name="toys", rig=rig, depth_scale=1000.0, fps=30.0, frame_count=1, has_masks=has_masks)


def test_without_segmentation_everything_is_object_0() -> None:
    labels = segment(frame(LABELS), SegmentationConfig(mode=SegmentationMode.NONE), info(has_masks=True))
    assert labels.dtype == np.uint8
    assert not labels.any()


def test_depth_range_holds_its_near_bound_but_not_its_far_one() -> None:
    config = SegmentationConfig(mode=SegmentationMode.DEPTH, near_m=0.5, far_m=1.2)
    np.testing.assert_array_equal(segment(frame(), config, info()), [[0, 1, 1], [0, 0, 0]])


def test_pixels_without_depth_are_background_even_from_zero_on() -> None:
    config = SegmentationConfig(mode=SegmentationMode.DEPTH, near_m=0.0, far_m=0.2)
    np.testing.assert_array_equal(segment(frame(), config, info()), [[0, 0, 0], [0, 0, 1]])


def test_masks_are_labels() -> None:
    config = SegmentationConfig(mode=SegmentationMode.MASKS)
    np.testing.assert_array_equal(segment(frame(LABELS), config, info(has_masks=True)), LABELS)


@pytest.mark.parametrize(("has_masks", "mode"), [(True, SegmentationMode.MASKS), (False, SegmentationMode.NONE)])
def test_automatic_mode_uses_masks_where_there_are_any(has_masks: bool, mode: SegmentationMode) -> None:
    assert resolved_mode(SegmentationConfig(), info(has_masks)) is mode


def test_given_mode_stands() -> None:
    config = SegmentationConfig(mode=SegmentationMode.NONE)
    assert resolved_mode(config, info(has_masks=True)) is SegmentationMode.NONE


def test_missing_mask_is_an_error() -> None:
    with pytest.raises(SequenceError, match=r"^toys: frame 7 has no mask; add it, or use --segment none$"):
        segment(frame(), SegmentationConfig(mode=SegmentationMode.MASKS), info())


def test_mask_of_another_size_is_an_error() -> None:
    mask = np.zeros((4, 5), dtype=np.uint8)
    with pytest.raises(SequenceError, match=r"^toys: mask of frame 7 has 5x4 pixels, its depth 3x2; masks belong"):
        segment(frame(mask), SegmentationConfig(mode=SegmentationMode.MASKS), info())
