# SPDX-License-Identifier: MIT
"""What depth pictures hold: which values are no measurements, and whether the rest makes sense."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from threedvc.errors import ConfigError, SequenceError
from threedvc.formats.sources.notices import Notice

__all__ = ["NO_MEASUREMENT", "check_depth"]

NO_MEASUREMENT = 65535
"""The largest value of 16 bits says "nothing there" or "too far" in every data set that uses it; so does 0."""
PROBES = 8
"""Pictures that are looked at, spread over the recording, until three have depth: recordings may begin with none."""
PROBES_WITH_DATA = 3
"""So many tell what the others are like; each has to be decoded."""
PLAUSIBLE_M = (0.05, 100.0)
"""Medians of depth that need no explanation: from a hand before a close-range camera to a street."""
TOLD_PLAUSIBLE_M = (0.005, 500.0)
"""Those of a scale that was told: endoscopes look at centimeters, lasers along streets."""
FAR_SHARE, FAR_FACTOR = 0.02, 1.5
"""A value on more than this share of the pixels, beyond all others by this factor, stands for "no measurement"."""
NEARLY_ALL = 0.999
"""Quantile of the other values that stands for the largest: a few may be strays."""
MIN_NEIGHBORS, MIN_DENSE_SHARE = 3, 0.3
"""Surfaces are made of measurements with neighbors: cameras have 3 of 8 at nearly all pixels, and the accumulated
scans of a rotating laser at 80 %; single scans and sparse points hardly anywhere."""
MIN_MEASURED = 100
"""Pixels with depth: fewer tell nothing of how dense they lie."""


@dataclass(frozen=True, eq=False)
class _Probe:
    """A depth picture that has measurements: raw units (h, w), 0 = none, and its file."""

    path: Path
    raw: NDArray[np.uint16]


def check_depth(
    paths: Sequence[Path],
    read: Callable[[Path], NDArray[np.uint16]],
    depth_scale: float,
    *,
    told: bool,
    max_depth_m: float | None,
) -> list[Notice]:
    """Look at the depth of a few frames: whether there is any, whether its scale makes sense, and what is odd.

    Parameters
    ----------
    paths
        The depth pictures of a recording.
    read
        Returns raw units (h, w), 0 = no measurement; raises SequenceError.
    depth_scale
        Units per meter.
    told
        Whether the user or the recording says so, rather than a custom of its layout.
    max_depth_m
        Depth beyond this is not used; None: all is.

    Raises
    ------
    SequenceError
        If no picture has depth, it is implausible, or too sparse to make surfaces of.
    ConfigError
        If `max_depth_m` leaves none.
    """
    probes = _probes(paths, read)
    _check_scale(probes, depth_scale, told=told, max_depth_m=max_depth_m)
    _check_density(probes)
    doubts = (_far_value(probe, depth_scale, max_depth_m) for probe in probes)
    return [doubt for doubt in doubts if doubt is not None][:1]


def _probes(paths: Sequence[Path], read: Callable[[Path], NDArray[np.uint16]]) -> list[_Probe]:
    """Return the first few pictures with depth, of some that are spread over the recording."""
    places = np.unique(np.linspace(0, len(paths) - 1, PROBES).astype(int))
    found: list[_Probe] = []
    for place in places:
        # A damaged picture is reported when its frame is read, so that the frames before it can be used.
        with suppress(SequenceError):
            raw = read(paths[place])
            if raw.any():
                found.append(_Probe(paths[place], raw))
        if len(found) == PROBES_WITH_DATA:
            break
    if not found:
        raise SequenceError(
            f"{paths[0]}: depth is zero everywhere, and in {len(places) - 1} more pictures looked at; "
            "give the folder of the real depth pictures"
        )
    return found


def _check_scale(probes: Sequence[_Probe], depth_scale: float, *, told: bool, max_depth_m: float | None) -> None:
    path = probes[0].path
    depth = np.concatenate([probe.raw[probe.raw > 0] for probe in probes]) / np.float32(depth_scale)
    nearest, farthest, median = float(depth.min()), float(depth.max()), float(np.median(depth))
    extent = f"{nearest:.4g}..{farthest:.4g} m"
    least, most = TOLD_PLAUSIBLE_M if told else PLAUSIBLE_M
    if not least <= median <= most:
        raise SequenceError(
            f"{path}: depth of {extent} (median {median:.4g} m) is implausible at {depth_scale:g} units per meter; "
            "give --depth-scale (1000 for millimeters)"
        )
    if max_depth_m is not None and nearest > max_depth_m:
        raise ConfigError(f"--max-depth {max_depth_m:g} m leaves no depth: {path} has {extent}; give a larger value")


def _check_density(probes: Sequence[_Probe]) -> None:
    """Refuse depth that is scattered over single pixels."""
    densest = max(probes, key=lambda probe: int(np.count_nonzero(probe.raw)))
    measured = densest.raw > 0
    count = int(np.count_nonzero(measured))
    about = cv2.boxFilter(measured.astype(np.float32), -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT) - 1
    dense = np.count_nonzero(measured & (about >= MIN_NEIGHBORS - 0.5))
    if count >= MIN_MEASURED and dense < MIN_DENSE_SHARE * count:
        raise SequenceError(
            f"{densest.path}: depth is on {count / measured.size:.1%} of the pixels, and only {dense / count:.0%} of "
            f"these have {MIN_NEIGHBORS} neighbors with depth: too sparse to make surfaces of; fill it in (depth "
            "completion), or give a depth camera's pictures"
        )


def _far_value(probe: _Probe, depth_scale: float, max_depth_m: float | None) -> Notice | None:
    """Return a doubt about one value that is far beyond all others and all over the picture."""
    largest = int(probe.raw.max())
    share = float(np.mean(probe.raw == largest))
    others = probe.raw[(probe.raw > 0) & (probe.raw < largest)]
    if share <= FAR_SHARE or not len(others):
        return None
    end = float(np.quantile(others, NEARLY_ALL))
    beyond_use = max_depth_m is not None and largest / depth_scale > max_depth_m
    if largest < FAR_FACTOR * end or beyond_use:
        return None
    return Notice(
        f"{probe.path}: depth {largest} ({largest / depth_scale:.4g} m) is on {share:.0%} of the pixels and all else "
        f"within {end / depth_scale:.4g} m; if it stands for no measurement, give --max-depth "
        f"{_rounded_up(end / depth_scale)}",
        warning=True,
    )


def _rounded_up(depth_m: float) -> str:
    return f"{1.2 * depth_m:.2g}m"
