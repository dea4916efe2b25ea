# SPDX-License-Identifier: MIT
"""Payload of a depth picture: the inverse depths of a background at rest before a camera at rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from threedvc.coding.entropy.range_coder import RangeCoder, RangeReader, RangeWriter, new_counters
from threedvc.errors import CorruptStream, LimitExceeded
from threedvc.kernels.coding.depth_picture import DEPTH_COUNTERS, MAX_SAMPLE, DepthSamples, code_depths
from threedvc.kernels.coding.range_coder import NUMBER_COUNTERS
from threedvc.limits import MAX_DEPTH_SAMPLES

__all__ = [
    "MAX_SAMPLE",
    "MAX_SCALE_BITS",
    "MAX_SPACING",
    "DepthPicture",
    "DepthSteps",
    "decode_depths",
    "encode_depths",
    "grid_shape",
]

BYTES_PER_SAMPLE = 16
"""Room for one: four times what noise of 20 bits takes."""
MAX_SPACING = 64
"""Pixels between samples, at most: ten samples along a row of 640 pixels. As the next three, it is part of the
format."""
MAX_SCALE_BITS = 40
"""With it the largest sample stands for a distance of a thousand kilometers."""
MAX_LEVELS = 10
"""Halvings of a grid, at most: one of 1024 samples is one sample then."""
MAX_HALVINGS = 8
"""Halvings of the step, at most."""


@dataclass(frozen=True, kw_only=True, eq=False)
class DepthPicture:
    """Inverse depths on a grid of pixels of the depth camera.

    Attributes
    ----------
    samples
        (rows, columns) int64, in units of 2^-scale_bits per meter, within 0..`MAX_SAMPLE`; 0 = nothing there. Sample
        (i, j) stands at the pixel of row ``spacing * i`` and column ``spacing * j``.
    spacing
        Pixels between samples.
    scale_bits
        See `samples`.
    """

    samples: NDArray[np.int64]
    spacing: int
    scale_bits: int


@dataclass(frozen=True, kw_only=True)
class DepthSteps:
    """How finely samples are coded.

    Attributes
    ----------
    step
        Quantization step of the finest level, in units of the samples.
    levels
        Number of halvings of the grid above the coarsest one.
    halvings
        For how many levels from the finest on the step is halved.
    dead_zone
        Differences below this many 256ths of a step are coded as none; the writer's alone.
    """

    step: int
    levels: int
    halvings: int
    dead_zone: int = 192

    def all(self) -> NDArray[np.int64]:
        """Return the steps of all levels (levels + 1,), the finest first."""
        return np.array(
            [max(1, self.step >> min(level, self.halvings)) for level in range(self.levels + 1)], dtype=np.int64
        )


def grid_shape(width: int, height: int, spacing: int) -> tuple[int, int]:
    """Return rows and columns of the grid whose samples cover a picture."""
    return -(-(height - 1) // spacing) + 1, -(-(width - 1) // spacing) + 1


def encode_depths(picture: DepthPicture, steps: DepthSteps) -> tuple[bytes, DepthPicture]:
    """Return the payload of a picture, and the picture as decoded."""
    writer = RangeWriter()
    decoded = _code(writer, picture, steps, bool((picture.samples > 0).all()), picture.samples.shape)
    return writer.finish(), decoded


def decode_depths(payload: bytes, width: int, height: int) -> DepthPicture:
    """Return the picture of a payload, for a camera of a size in pixels.

    Raises
    ------
    CorruptStream
        If the payload is damaged.
    LimitExceeded
        If there are more than `MAX_DEPTH_SAMPLES`.
    """
    reader = RangeReader(payload)
    decoded = _code(reader, None, None, False, (height, width))
    reader.finish()
    return decoded


def _code(
    coder: RangeCoder,
    picture: DepthPicture | None,
    steps: DepthSteps | None,
    complete: bool,
    size: tuple[int, int],
) -> DepthPicture:
    """Code head and samples; a reader knows the camera's `size` alone."""
    counters = new_counters(NUMBER_COUNTERS)
    wanted = [picture.spacing, picture.scale_bits] if picture is not None else [0, 0]
    wanted += [steps.levels, steps.step, steps.halvings] if steps is not None else [0, 0, 0]
    spacing, scale_bits, levels, step, halvings = (coder.number(value, counters) for value in wanted)
    complete = coder.bit(complete)
    coder.check()
    if not (
        1 <= spacing <= MAX_SPACING
        and scale_bits <= MAX_SCALE_BITS
        and levels <= MAX_LEVELS
        and 1 <= step <= MAX_SAMPLE
        and halvings <= MAX_HALVINGS
    ):
        raise CorruptStream(
            f"a depth picture of spacing {spacing}, scale {scale_bits}, {levels} levels and step {step} is impossible;"
            " the stream is damaged"
        )
    shape = grid_shape(size[1], size[0], spacing) if picture is None else size
    if shape[0] * shape[1] > MAX_DEPTH_SAMPLES:
        raise LimitExceeded(
            f"a depth picture of {shape[1]}x{shape[0]} samples is larger than the {MAX_DEPTH_SAMPLES} accepted"
        )
    kept = DepthSteps(step=step, levels=levels, halvings=halvings)
    job = DepthSamples(
        values=np.zeros(shape, dtype=np.int64),
        residuals=np.zeros(shape, dtype=np.int64),
        modes=np.zeros(shape, dtype=np.int64),
        wishes=np.zeros(shape, dtype=np.int64) if picture is None else np.ascontiguousarray(picture.samples),
        steps=kept.all(),
        dead_zone=kept.dead_zone if steps is None else steps.dead_zone,
        complete=int(complete),
        counters=new_counters(DEPTH_COUNTERS),
    )
    coder.reserve(BYTES_PER_SAMPLE * job.values.size)
    if not code_depths(coder.coder, job):
        raise CorruptStream("a depth picture ends too early; the stream is damaged")
    return DepthPicture(samples=job.values, spacing=spacing, scale_bits=scale_bits)
