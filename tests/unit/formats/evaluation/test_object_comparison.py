# SPDX-License-Identifier: MIT
"""Objects of a stream beside those of a reference: small pictures and poses with known answers."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest
from numpy.typing import NDArray

from threedvc.errors import SequenceError
from threedvc.formats.decoding import DecodedFrame
from threedvc.formats.evaluation.frame_ranges import FrameSpan
from threedvc.formats.evaluation.object_comparison import ObjectComparison, ObjectQuality, matched
from threedvc.frames.frame import Frame
from threedvc.geometry.pose import Pose, inverse, make_pose, rotation_from_vector

SHAPE = (20, 30)
Labels = NDArray[np.uint8]


def picture(**columns: tuple[int, int]) -> Labels:
    """Return labels in which object N of ``oN=(start, stop)`` covers these columns: 20 pixels each."""
    labels = np.zeros(SHAPE, dtype=np.uint8)
    for name, (start, stop) in columns.items():
        labels[:, start:stop] = int(name[1:])
    return labels


def at(x: float, turn_deg: float = 0.0) -> Pose:
    return make_pose(rotation_from_vector(np.array([0, np.radians(turn_deg), 0])), np.array([x, 0, 1]))


def compared(
    drawn: list[Labels],
    masks: list[Labels | None],
    found: list[Mapping[int, Pose]] | None = None,
    true: list[Mapping[int, Pose]] | None = None,
    cameras: list[Pose | None] | None = None,
) -> ObjectComparison:
    comparison = ObjectComparison()
    color, depth = np.zeros((*SHAPE, 3), dtype=np.uint8), np.ones(SHAPE, dtype=np.float32)
    for index, (labels, mask) in enumerate(zip(drawn, masks, strict=True)):
        decoded = DecodedFrame(
            index=index, sensor=0, number=index, timestamp_ns=index, color=color, depth=depth, labels=labels,
            T_world_camera=np.eye(4), T_camera_object=dict(found[index]) if found else {},
        )  # fmt: skip
        given = Frame(
            index=index, timestamp_ns=index, color=color, depth=depth, mask=mask,
            T_world_camera=cameras[index] if cameras else None, T_camera_object=true[index] if true else {},
        )  # fmt: skip
        comparison.add(decoded, given)
    return comparison


def quality(comparison: ObjectComparison) -> dict[int, ObjectQuality]:
    items = comparison.reference()
    assert items is not None
    return {item.label: item for item in items}


class TestMatching:
    def test_numbers_need_not_be_labels(self) -> None:
        mask = picture(o1=(0, 5), o2=(10, 18))
        comparison = compared([picture(o7=(0, 5), o1=(10, 18))], [mask])
        assert comparison.matches() == {1: 7, 2: 1}

    def test_most_pixels_first_and_one_to_one(self) -> None:
        # Object 4 covers both things, and more of the second; object 5 is left for the first.
        assert matched({(4, 1): 50, (4, 2): 90, (5, 1): 20}, {4: 140, 5: 25}) == {2: 4, 1: 5}
        assert matched({(4, 1): 50, (4, 2): 90}, {4: 140}) == {2: 4}

    def test_the_background_is_matched_to_nothing(self) -> None:
        assert matched({(0, 1): 500, (2, 0): 400, (0, 0): 1}, {2: 400}) == {}

    def test_an_object_that_lies_elsewhere_is_not_matched(self) -> None:
        assert matched({(2, 1): 9, (2, 0): 91}, {2: 100}) == {}
        assert matched({(2, 1): 10, (2, 0): 90}, {2: 100}) == {1: 2}

    def test_equal_pixels_give_the_same_match_every_time(self) -> None:
        assert matched({(2, 2): 5, (2, 1): 5, (1, 2): 5, (1, 1): 5}, {1: 10, 2: 10}) == {1: 1, 2: 2}

    def test_overlap_counts_over_all_frames(self) -> None:
        # Object 1 covers the thing in one frame, object 2 in three.
        mask = picture(o1=(0, 5))
        comparison = compared([picture(o1=(0, 5)), *[picture(o2=(0, 5))] * 3], [mask] * 4)
        assert comparison.matches() == {1: 2}

    def test_without_masks_equal_numbers_are_matched(self) -> None:
        poses = [{1: at(0), 2: at(1)}]
        comparison = compared([picture(o1=(0, 5))], [None], [{1: at(0), 3: at(0)}], poses)
        assert comparison.matches() == {1: 1}
        assert [item.number for item in quality(comparison).values()] == [1, None]


class TestOverlap:
    def test_mean_over_the_frames_that_show_it(self) -> None:
        # 10 of 10 columns, 5 of 10, 5 of 15, none of 10; the last frame does not show it.
        drawn = [picture(o1=(0, 10)), picture(o1=(0, 5)), picture(o1=(5, 15)), picture(), picture(o1=(0, 10))]
        found = quality(compared(drawn, [*[picture(o1=(0, 10))] * 4, picture()]))[1]
        assert (found.frames, found.moved_frames, found.moved_iou) == (4, 0, None)
        assert found.iou == pytest.approx((1 + 0.5 + 1 / 3 + 0) / 4)

    def test_a_few_pixels_do_not_count_as_shown(self) -> None:
        hint = picture()
        hint[0, :29] = 1
        found = quality(compared([picture(), picture(o1=(0, 9))], [hint, picture(o1=(0, 9))]))[1]
        assert (found.frames, found.iou) == (1, 1)

    def test_what_was_not_found_has_no_overlap(self) -> None:
        found = quality(compared([picture()], [picture(o3=(0, 10))]))[3]
        assert (found.number, found.frames, found.iou, found.pose) == (None, 1, 0, None)

    def test_what_is_never_shown_has_no_mean(self) -> None:
        found = quality(compared([picture()], [picture()], true=[{1: at(0)}]))[1]
        assert (found.number, found.frames, found.iou) == (None, 0, None)

    def test_frames_without_a_mask_do_not_count(self) -> None:
        masks = [picture(o1=(0, 10)), None, picture(o1=(0, 10))]
        found = quality(compared([picture(o1=(0, 10)), picture(), picture(o1=(0, 5))], masks))[1]
        assert (found.frames, found.iou) == (2, pytest.approx(0.75))

    def test_mask_of_another_size(self) -> None:
        with pytest.raises(SequenceError, match=r"mask of frame 0 has shape \(4, 4\) and the depth of the stream"):
            compared([picture()], [np.zeros((4, 4), dtype=np.uint8)])


class TestMoved:
    def moved_frames(self, true: list[Mapping[int, Pose]], cameras: list[Pose | None] | None = None) -> int:
        labels = picture(o1=(0, 10))
        return quality(compared([labels] * len(true), [labels] * len(true), true=true, cameras=cameras))[1].moved_frames

    def test_one_centimeter_or_two_degrees_from_the_first(self) -> None:
        still = [at(0), at(0.009), at(0, 1.9), at(-0.009, -1.9)]
        assert self.moved_frames([{1: pose} for pose in still]) == 0
        assert self.moved_frames([{1: pose} for pose in [*still, at(0.011), at(0, 2.1), at(0)]]) == 2

    def test_the_first_pose_is_that_of_the_first_frame_that_shows_it(self) -> None:
        labels = [picture(), picture(o1=(0, 10)), picture(o1=(0, 10))]
        poses = [{1: pose} for pose in (at(-5), at(0), at(0))]
        assert quality(compared(labels, list(labels), true=poses))[1].moved_frames == 0

    def test_a_moving_camera_moves_nothing(self) -> None:
        cameras = [at(0.1 * k, 3 * k) for k in range(4)]
        resting = [{1: inverse(camera) @ at(0, 10)} for camera in cameras]
        assert self.moved_frames(resting, [*cameras]) == 0
        assert self.moved_frames(resting) == 3

    def test_frames_without_the_camera_are_unknown(self) -> None:
        cameras: list[Pose | None] = [at(0), None, at(0)]
        assert self.moved_frames([{1: at(0)}, {1: at(1)}, {1: at(1)}], cameras) == 1

    def test_overlap_of_moved_frames(self) -> None:
        drawn = [picture(o1=(0, 10)), picture(o1=(0, 5)), picture(o1=(0, 10))]
        poses = [{1: at(0)}, {1: at(1)}, {1: at(0)}]
        found = quality(compared(drawn, [picture(o1=(0, 10))] * 3, true=poses))[1]
        assert (found.iou, found.moved_iou) == (pytest.approx(2.5 / 3), 0.5)


class TestPoses:
    def test_the_frame_that_the_stream_chose_is_no_error(self) -> None:
        T_number_label = make_pose(rotation_from_vector(np.array([0.3, -1, 2])), np.array([0.5, -0.2, 3]))
        true = [at(0.1 * k, 20 * k) for k in range(5)]
        found = [{7: pose @ inverse(T_number_label)} for pose in true]
        labels, mask = picture(o7=(0, 10)), picture(o2=(0, 10))
        pose = quality(compared([labels] * 5, [mask] * 5, found, [{2: each} for each in true]))[2].pose
        assert pose is not None
        assert pose.frames == 5
        assert (pose.rotation_max_deg, pose.translation_max_mm) == pytest.approx((0, 0), abs=1e-5)

    def test_only_frames_that_show_it_and_have_both_poses(self) -> None:
        labels = picture(o1=(0, 10))
        masks = [labels, labels, labels, labels, picture()]
        true = [{1: at(0)}, {}, {1: at(0)}, {1: at(0)}, {1: at(9)}]
        found = [{1: at(-0.002)}, {1: at(5)}, {1: at(0.002)}, {}, {1: at(0)}]
        pose = quality(compared([labels] * 5, list(masks), found, true))[1].pose
        assert pose is not None
        assert (pose.frames, pose.translation_max_mm) == (2, pytest.approx(2))

    def test_without_a_mask_the_drawn_frames_count(self) -> None:
        drawn = [picture(o1=(0, 10)), picture(), picture(o1=(0, 10))]
        found = [{1: at(0)}, {1: at(9)}, {1: at(0)}]
        pose = quality(compared(drawn, [None] * 3, found, [{1: at(0)}] * 3))[1].pose
        assert pose is not None
        assert (pose.frames, pose.translation_max_mm) == (2, 0)

    def test_none_without_poses(self) -> None:
        labels = picture(o1=(0, 10))
        assert quality(compared([labels], [labels], [{1: at(0)}]))[1].pose is None
        assert quality(compared([labels], [labels], None, [{1: at(0)}]))[1].pose is None

    def test_motion_is_named_by_the_streams_number(self) -> None:
        labels, mask = picture(o7=(0, 10)), picture(o2=(0, 10))
        motion = compared([labels] * 3, [mask] * 3, [{7: at(0.1 * k)} for k in range(3)], [{2: at(0)}] * 3).motion()
        assert list(motion) == [7]
        assert motion[7].rpe_translation_mm == pytest.approx(100)


class TestSpurious:
    def test_what_is_matched_to_nothing_and_how_long_it_lives(self) -> None:
        thing = picture(o1=(0, 5))
        ghost = picture(o1=(0, 5), o4=(20, 25))
        comparison = compared([thing, ghost, ghost, thing, ghost], [thing, thing, None, thing, thing])
        (found,) = comparison.spurious() or []
        assert (found.number, found.frames, found.spans) == (4, 3, (FrameSpan(1, 2), FrameSpan(4, 4)))

    def test_the_second_half_of_an_object_is_spurious(self) -> None:
        comparison = compared([picture(o1=(0, 8), o2=(8, 12))], [picture(o1=(0, 12))])
        assert [item.number for item in comparison.spurious() or []] == [2]
        assert quality(comparison)[1].iou == pytest.approx(8 / 12)

    def test_frames_without_masks_tell_nothing(self) -> None:
        assert compared([picture(o1=(0, 5))], [None]).spurious() is None
        comparison = compared([picture(), picture(o1=(0, 5))], [picture(), None])
        assert comparison.spurious() == []

    def test_an_object_of_few_pixels_is_not_drawn(self) -> None:
        speck = picture()
        speck[0, :29] = 3
        assert compared([speck], [picture()]).spurious() == []


def test_a_reference_without_masks_and_poses_tells_nothing() -> None:
    comparison = compared([picture(o1=(0, 5))], [None], [{1: at(0)}])
    assert (comparison.reference(), comparison.spurious(), comparison.motion()) == (None, None, {})


def test_masks_without_objects() -> None:
    comparison = compared([picture(o1=(0, 5))], [picture()])
    assert comparison.reference() == []
    assert [item.number for item in comparison.spurious() or []] == [1]
