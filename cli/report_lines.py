# SPDX-License-Identifier: MIT
"""The text that `3dvc stats` prints."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING

from threedvc.units import MILLIMETERS

if TYPE_CHECKING:
    from threedvc.formats.evaluation.frame_ranges import FrameSpan
    from threedvc.formats.evaluation.object_comparison import ObjectQuality
    from threedvc.formats.evaluation.report import ObjectStatistics, StreamStatistics
    from threedvc.metrics.trajectory import ObjectPoseError, TrajectoryError, Travel

__all__ = ["report_lines"]

COLUMN = 18
"""Characters of a name; the names of measures fit."""
LABEL_COLUMN = 12
"""Characters of a label, of the wide tables of references."""
WIDTH = 100
"""Characters of a line, at which lists are wrapped."""


def report_lines(report: StreamStatistics) -> Iterator[str]:
    """Yield the lines of a report, at most 100 characters each where its names and numbers are of usual length."""
    state = "" if report.complete else "  TRUNCATED: the stream ends before its END packet"
    yield _row("stream", f"{report.name}, {report.frames} frames, {report.duration_s:.2f} s{state}")
    yield _row("size", f"{report.file_bytes:,} bytes, {report.kbit_s:.1f} kbit/s")
    yield _row("raw", f"{report.raw_bytes:,} bytes, 1:{report.ratio:.0f}")
    yield from _packets(report)
    yield from _objects(report)
    yield from _lives(report)
    yield from _course(report)
    yield _row("paper", _paper(report))
    yield from _motion(report)
    yield from _reference_objects(report)
    if report.quality is not None:
        yield ""
        yield from (_row(name, _measure(name, value)) for name, value in report.quality.items())
        if report.lossless:
            yield _row("exact", ", ".join(f"{kind} lossless" for kind in report.lossless))


def _row(name: str, text: str) -> str:
    return f"{name:<{COLUMN}}  {text}"


def _rows(start: str, text: str) -> list[str]:
    """Return a row, and more below it where its text is long."""
    indent = " " * len(start)
    return textwrap.wrap(text, WIDTH, initial_indent=start, subsequent_indent=indent, break_on_hyphens=False)


def _frames(spans: Sequence[FrameSpan]) -> str:
    return ", ".join(map(str, spans)) or "never"


def _packets(report: StreamStatistics) -> Iterator[str]:
    yield ""
    yield f"{'packets':<{COLUMN}}  {'count':>8} {'bytes':>12} {'share':>7}"
    for name, total in sorted(report.packets.items(), key=lambda item: -item[1].bytes):
        yield f"  {name:<{COLUMN - 2}}  {total.count:>8,} {total.bytes:>12,} {total.bytes / report.file_bytes:>7.1%}"


def _objects(report: StreamStatistics) -> Iterator[str]:
    yield ""
    yield f"{'objects':<{COLUMN}}  {'cells':>8} {'bytes':>12} {'poses':>7} {'cell':>8}"
    for item in report.objects:
        cell = f"{MILLIMETERS * item.voxel_size_m:g} mm"
        yield f"  {item.id:<{COLUMN - 2}}  {item.cells:>8,} {item.bytes:>12,} {item.poses:>7,} {cell:>8}"


def _lives(report: StreamStatistics) -> Iterator[str]:
    yield ""
    yield f"{'visible':<{COLUMN}}  {'frames':>8} {'moved':>10} {'turned':>8}  in frames"
    for item in report.objects:
        moved, turned = "-", "-"
        if item.travel is not None:
            moved, turned = f"{item.travel.largest_distance_m:.3f} m", f"{item.travel.largest_turn_deg:.0f} deg"
        start = f"  {_name(item):<{COLUMN - 2}}  {item.visible_frames:>8,} {moved:>10} {turned:>8}  "
        yield from _rows(start, _frames(item.spans))
    own = [item for item in report.objects if not item.background and not item.guessed]
    most = max((item.visible_objects for item in report.per_frame), default=0)
    yield _row("number of objects", f"{report.object_count}, at most {most} at once, the background apart")
    if own:
        yield from _rows(_row("births", ""), _events((item.birth, item.id) for item in own))
        yield from _rows(_row("deaths", ""), _events((item.death, item.id) for item in own))


def _name(item: ObjectStatistics) -> str:
    if item.background:
        return f"{item.id} background"
    kind = " guessed" if item.guessed else " passing" if item.passing else ""
    return f"{item.id}{kind}"


def _events(items: Iterable[tuple[int | None, int]]) -> str:
    """Name what happens to objects, given as frame and number, in order of time."""
    events: dict[int, list[int]] = {}
    for frame, number in sorted((frame, number) for frame, number in items if frame is not None):
        events.setdefault(frame, []).append(number)
    return "; ".join(f"frame {frame}: {_numbers(numbers)}" for frame, numbers in events.items()) or "none"


def _numbers(numbers: Sequence[int]) -> str:
    return f"object{'s' if len(numbers) > 1 else ''} {', '.join(map(str, numbers))}"


def _course(report: StreamStatistics) -> Iterator[str]:
    yield ""
    if report.frames:
        largest = max(report.per_frame, key=lambda item: item.bytes)
        mean = report.file_bytes / report.frames
        yield _row("bytes per frame", f"mean {mean:.0f}, largest {largest.bytes:,} (frame {largest.frame})")
    entropy = [item.entropy_bits for item in report.per_frame if item.entropy_bits is not None]
    if entropy:
        yield _row(
            "entropy", f"{entropy[0]:,.0f} bits at first, {max(entropy):,.0f} at most, {entropy[-1]:,.0f} at last"
        )
    if report.status:
        yield _row("poses", ", ".join(f"{count} {status}" for status, count in report.status.items()))
        for status, spans in report.status_spans.items():
            yield from _rows(_row(f"  {status}", ""), f"frames {_frames(spans)}")
    if report.travel is not None:
        yield _row("path", _travel(report.travel))


def _travel(travel: Travel) -> str:
    if not travel.length_m and not travel.turn_deg:
        return "the camera is at rest"
    return (
        f"{travel.length_m:.3f} m, turns by {travel.turn_deg:.1f} deg in all, {travel.largest_turn_deg:.1f} at most;"
        f" steps up to {MILLIMETERS * travel.largest_step_m:.1f} mm {travel.largest_step_deg:.2f} deg"
    )


def _paper(report: StreamStatistics) -> str:
    sizes = report.paper
    return (
        f"M {sizes.cells:,}, F_m {sizes.pose_frames:,}, S_3DVC {sizes.coded_bytes:,}, S_raw {sizes.raw_bytes:,}, "
        f"1:{sizes.ratio:.1f}"
    )


def _motion(report: StreamStatistics) -> Iterator[str]:
    if report.camera is not None:
        yield _row("camera", _trajectory(report.camera))
        lost = f"; lost in the stream: {report.status.get('lost', 0)}" if report.status else ""
        yield _row("", f"over all {report.camera.frames} frames with a known pose{lost}")
    for number, error in report.object_motion.items():
        yield _row(f"object {number}", _trajectory(error))


def _trajectory(error: TrajectoryError) -> str:
    return (
        f"ATE {error.ate_rmse_mm:.1f} mm (largest {error.ate_max_mm:.1f}), "
        f"RPE {error.rpe_translation_mm:.2f} mm {error.rpe_rotation_deg:.3f} deg "
        f"(median {error.rpe_translation_median_mm:.2f}, {error.rpe_rotation_median_deg:.3f})"
    )


def _reference_objects(report: StreamStatistics) -> Iterator[str]:
    if report.reference_objects:
        yield ""
        yield (
            f"{'reference':<{LABEL_COLUMN}}  {'object':>6} {'frames':>6} {'IoU':>6} {'moved':>6} {'IoU':>6}"
            f" {'deg median':>11} {'rmse':>6} {'max':>6} {'mm median':>10} {'rmse':>6} {'max':>6}"
        )
        yield from map(_reference_object, report.reference_objects)
    if report.spurious_objects is not None:
        spurious = [f"object {item.number} in {item.frames} frames" for item in report.spurious_objects]
        yield from _rows(_row("spurious", ""), ", ".join(spurious) or "none")


def _reference_object(item: ObjectQuality) -> str:
    number = "none" if item.number is None else str(item.number)
    return (
        f"  {item.label:<{LABEL_COLUMN - 2}}  {number:>6} {item.frames:>6,} {_overlap(item.iou):>6}"
        f" {item.moved_frames:>6,} {_overlap(item.moved_iou):>6} {_pose_error(item.pose)}"
    )


def _overlap(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


def _pose_error(error: ObjectPoseError | None) -> str:
    if error is None:
        return f"{'-':>11} {'-':>6} {'-':>6} {'-':>10} {'-':>6} {'-':>6}"
    return (
        f"{error.rotation_median_deg:>11.2f} {error.rotation_rmse_deg:>6.2f} {error.rotation_max_deg:>6.2f}"
        f" {error.translation_median_mm:>10.1f} {error.translation_rmse_mm:>6.1f} {error.translation_max_mm:>6.1f}"
    )


def _measure(name: str, value: float) -> str:
    if name.startswith("psnr"):
        return f"{value:.2f} dB"
    return f"{value:.1f} mm" if name.endswith("_mm") else f"{value:.4f}"
