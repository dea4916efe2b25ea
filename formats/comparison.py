# SPDX-License-Identifier: MIT
"""How well a decoded stream draws a reference sequence, one frame in memory at a time."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field

from threedvc.errors import SequenceError
from threedvc.formats.api import DecodedFrame
from threedvc.frame import NANOSECONDS, Frame, FrameSequence, SequenceInfo
from threedvc.metrics import (
    ColorQuality,
    DepthErrors,
    TrajectoryError,
    depth_units,
    mean_color_quality,
    trajectory_error,
)
from threedvc.pose import Pose, inverse

__all__ = ["Comparison", "check_comparable", "paired"]

MILLIMETRES = 1000.0
CAMERA = -1


def check_comparable(decoded: SequenceInfo, reference: SequenceInfo) -> None:
    """Refuse a reference whose pictures are not those of the stream.

    Raises
    ------
    SequenceError
        If a size differs.
    """
    for kind in ("color", "depth"):
        ours, theirs = getattr(decoded.rig, kind), getattr(reference.rig, kind)
        if (ours.width, ours.height) != (theirs.width, theirs.height):
            raise SequenceError(
                f"{reference.name}: {kind} pictures are {theirs.width}x{theirs.height} and those of the stream"
                f" {ours.width}x{ours.height}; give the frames that were encoded"
            )


def paired(
    decoded: Iterable[DecodedFrame], reference: FrameSequence, frames: int
) -> Iterator[tuple[DecodedFrame, Frame]]:
    """Pair decoded frames with those of the reference.

    Parameters
    ----------
    decoded
        In order of time.
    reference
        The frames that were encoded, or a sequence that contains them.
    frames
        Number of decoded frames. Where the reference has as many, they are paired in order, else
        by time, within half a frame period.

    Raises
    ------
    SequenceError
        If the reference has no frame at the time of a decoded one.
    """
    if len(reference) == frames:
        yield from zip(decoded, reference, strict=False)
        return
    tolerance_ns = NANOSECONDS / reference.info.fps / 2
    candidates = iter(reference)
    candidate = next(candidates, None)
    for drawn in decoded:
        while candidate is not None and candidate.timestamp_ns < drawn.timestamp_ns - tolerance_ns:
            candidate = next(candidates, None)
        if candidate is None or candidate.timestamp_ns > drawn.timestamp_ns + tolerance_ns:
            raise SequenceError(
                f"{reference.info.name}: has {len(reference)} frames and none at {drawn.timestamp_ns} ns, the time of"
                f" frame {drawn.index} of {frames} in the stream; give the frames that were encoded"
            )
        yield drawn, candidate


@dataclass(kw_only=True)
class Comparison:
    """Measures of decoded frames against their reference, as they accumulate.

    Attributes
    ----------
    depth_scale
        Units per metre of the depth pictures, in which depth is compared.
    per_frame
        Measures of each frame alone, under their names in the JSON report.
    """

    depth_scale: float
    per_frame: list[dict[str, float]] = field(default_factory=list)
    _color: list[ColorQuality] = field(default_factory=list)
    _depth: DepthErrors | None = None
    _poses: defaultdict[int, list[tuple[Pose, Pose]]] = field(default_factory=lambda: defaultdict(list))

    def add(self, drawn: DecodedFrame, given: Frame) -> None:
        """Compare one frame."""
        color = ColorQuality.measure(given.color, drawn.color)
        depth = DepthErrors.measure(
            depth_units(given.depth, self.depth_scale),
            depth_units(drawn.depth, self.depth_scale),
            MILLIMETRES / self.depth_scale,
        )
        self.per_frame.append(asdict(color) | depth.quality())
        self._color.append(color)
        self._depth = depth if self._depth is None else self._depth + depth
        self._add_poses(drawn, given)

    def quality(self) -> dict[str, float]:
        """Return the measures over all frames under their names in the JSON report."""
        if self._depth is None:
            return {}
        return asdict(mean_color_quality(self._color)) | self._depth.quality()

    def camera(self) -> TrajectoryError | None:
        """Return the error of the camera's trajectory; None where the reference has no poses."""
        return self._trajectory(CAMERA)

    def object_motion(self) -> Mapping[int, TrajectoryError]:
        """Return, by object, the error of the camera's trajectory as seen from the object."""
        errors = {number: self._trajectory(number) for number in sorted(self._poses) if number != CAMERA}
        return {number: error for number, error in errors.items() if error is not None}

    def _add_poses(self, drawn: DecodedFrame, given: Frame) -> None:
        if given.T_world_camera is not None:
            self._poses[CAMERA].append((given.T_world_camera, drawn.T_world_camera))
        for number, pose in given.T_camera_object.items():
            found = drawn.T_camera_object.get(number)
            # Seen from the object, a stream's own choice of object frame is a choice of world, which
            # the alignment of trajectories removes.
            if found is not None:
                self._poses[number].append((inverse(pose), inverse(found)))

    def _trajectory(self, number: int) -> TrajectoryError | None:
        pairs = self._poses.get(number)
        return trajectory_error([true for true, _ in pairs], [found for _, found in pairs]) if pairs else None
