# SPDX-License-Identifier: MIT
"""How well a decoded stream draws a reference sequence, one frame in memory at a time."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, field

import numpy as np
from numpy.typing import NDArray

from threedvc.errors import SequenceError
from threedvc.formats.decoding import DecodedFrame
from threedvc.formats.evaluation.object_comparison import ObjectComparison
from threedvc.frames.frame import Frame, SequenceInfo
from threedvc.frames.sequence import FrameSequence
from threedvc.geometry.pose import Pose
from threedvc.metrics.depth_errors import DepthErrors, depth_units
from threedvc.metrics.picture_quality import ColorQuality, mean_color_quality
from threedvc.metrics.trajectory import TrajectoryError, trajectory_error
from threedvc.units import MILLIMETERS, NANOSECONDS

__all__ = ["Comparison", "check_comparable", "paired"]


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


class _Partner:
    """The frames of one sensor's reference, to be paired with `frames` decoded ones."""

    def __init__(self, reference: FrameSequence, frames: int) -> None:
        self._reference, self._frames = reference, frames
        self._in_order = len(reference) == frames
        self._tolerance_ns = NANOSECONDS / reference.info.fps / 2
        self._candidates = iter(reference)
        self._candidate = None if self._in_order else next(self._candidates, None)

    def of(self, drawn: DecodedFrame) -> Frame:
        """Return the partner of the next decoded frame."""
        if self._in_order:
            return next(self._candidates)
        candidate = self._candidate
        while candidate is not None and candidate.timestamp_ns < drawn.timestamp_ns - self._tolerance_ns:
            candidate = next(self._candidates, None)
        self._candidate = candidate
        if candidate is None or candidate.timestamp_ns > drawn.timestamp_ns + self._tolerance_ns:
            raise SequenceError(
                f"{self._reference.info.name}: has {len(self._reference)} frames and none at {drawn.timestamp_ns} ns, "
                f"the time of frame {drawn.number} of {self._frames} in the stream; give the frames that were encoded"
            )
        return candidate


def paired(
    decoded: Iterable[DecodedFrame], references: Sequence[FrameSequence], frames: Sequence[int]
) -> Iterator[tuple[DecodedFrame, Frame]]:
    """Pair decoded frames with those of the reference.

    Parameters
    ----------
    decoded
        In order of time.
    references
        For each sensor the frames that were encoded, or a sequence that contains them.
    frames
        Number of decoded frames of each sensor. Where its reference has as many, they are paired in order, else
        by time, within half a frame period.

    Raises
    ------
    SequenceError
        If a reference has no frame at the time of a decoded one.
    """
    partners = [_Partner(reference, count) for reference, count in zip(references, frames, strict=True)]
    for drawn in decoded:
        yield drawn, partners[drawn.sensor].of(drawn)


@dataclass(kw_only=True)
class Comparison:
    """Measures of decoded frames against their reference, as they accumulate.

    Attributes
    ----------
    depth_scale
        Units per meter of depth pictures, in which depth is compared.
    per_frame
        Measures of each frame alone, under their names in the JSON report.
    objects
        Objects beside those of the reference.
    """

    depth_scale: float
    per_frame: list[dict[str, float]] = field(default_factory=list)
    objects: ObjectComparison = field(default_factory=ObjectComparison)
    _color: list[ColorQuality] = field(default_factory=list)
    _depth: DepthErrors | None = None
    _equal_colors: bool = True
    _equal_gaps: bool = True
    _camera: dict[int, tuple[Pose, Pose]] = field(default_factory=dict)

    def add(self, drawn: DecodedFrame, given: Frame) -> None:
        """Compare one frame."""
        color, scale = ColorQuality.measure(given.color, drawn.color), self.depth_scale
        depth = DepthErrors.measure(
            depth_units(given.depth, scale), depth_units(drawn.depth, scale), MILLIMETERS / scale
        )
        self.per_frame.append(asdict(color) | depth.quality())
        self._color.append(color)
        self._equal_colors &= np.array_equal(given.color, drawn.color)
        self._equal_gaps &= _same(given.saturated, drawn.saturated)
        self._depth = depth if self._depth is None else self._depth + depth
        self.objects.add(drawn, given)
        if given.T_world_camera is not None and not drawn.sensor:
            self._camera[drawn.number] = (given.T_world_camera, drawn.T_world_camera)

    def quality(self) -> dict[str, float]:
        """Return the measures over all frames under their names in the JSON report."""
        if self._depth is None:
            return {}
        return asdict(mean_color_quality(self._color)) | self._depth.quality()

    def lossless(self) -> tuple[str, ...]:
        """Return which of ``color`` and ``depth`` are equal to the reference in every frame and pixel."""
        if self._depth is None:
            return ()
        equal = {"color": self._equal_colors, "depth": self._depth.lossless and self._equal_gaps}
        return tuple(kind for kind, same in equal.items() if same)

    def camera(self) -> TrajectoryError | None:
        """Return the error of the first sensor's trajectory; None where the reference has no poses."""
        if not self._camera:
            return None
        true, found = zip(*self._camera.values(), strict=True)
        return trajectory_error(true, found, list(self._camera))


def _same(one: NDArray[np.bool_] | None, other: NDArray[np.bool_] | None) -> bool:
    """Tell whether the same pixels (h, w) are marked; None marks none."""
    return one is other or (one is not None and other is not None and np.array_equal(one, other))
