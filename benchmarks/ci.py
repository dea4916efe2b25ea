# SPDX-License-Identifier: MIT
"""Guard speed and size: the stages of the codec on a small fixed sequence, against a committed baseline.

Speed is the CPU time of a stage over that of a yardstick, a Numba stencil and a NumPy sort, measured in turns with it
in the same run: machines differ, and are disturbed, but both alike. Size is the bytes of two streams, and their
quality::

    python benchmarks/ci.py [--baseline FILE.json] [--output FILE.json] [--renew]

Exit code 1 if a stage is more than 25 % slower than the baseline says, a stream more than 2 % larger, or its pictures
worse. ``--renew`` writes the baseline; the commit that does says why.
"""

from __future__ import annotations

import argparse
import io
import json
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numba
import numpy as np
from numpy.typing import NDArray

from reporting import REPOSITORY, commit, markdown_table
from threedvc.coding.update import encode_update_with_result
from threedvc.config import ColorVideo, EncoderConfig, Motion, Preset, RenderConfig, with_preset
from threedvc.decoder.replay import replay
from threedvc.encoder.fusion.evidence_model import EvidenceModel
from threedvc.encoder.fusion.integration import fuse, observe
from threedvc.encoder.fusion.surface_extraction import extract_surface
from threedvc.encoder.pipeline.encoder import Encoder
from threedvc.encoder.rate.model_updates import first_visible_update
from threedvc.encoder.rate.trial_coding import color_settings
from threedvc.encoder.reconstruction.scene import Scene
from threedvc.encoder.registration.frame_resolutions import Downsampled
from threedvc.encoder.registration.model_view import raycast_model
from threedvc.formats.container import StreamWriter
from threedvc.formats.decoding import decode
from threedvc.frames.frame import Frame
from threedvc.metrics.depth_errors import DepthErrors, depth_units
from threedvc.metrics.picture_quality import psnr
from threedvc.model.decoded_model import DecodedModel
from threedvc.stream.packets import Packet
from threedvc.synthesis.scenes import make_scene
from threedvc.synthesis.sequence import SyntheticSequence
from threedvc.units import MILLIMETERS

__all__ = ["Measurement", "compare", "main", "measure"]

BASELINE = Path(__file__).with_name("ci_baseline.json")
SIZE, FRAMES = (160, 120), 8
"""Small enough to run with each change."""
VOXEL_SIZE_M = 0.03
"""Fixed, so that a change of how cells are chosen does not pass for a change of speed."""
ROUNDS = 6
"""Turns of stage and yardstick; the least of each is what it takes undisturbed."""
MAX_SLOWER, MAX_LARGER = 1.25, 1.02
"""Times the baseline: beyond what the yardstick leaves of the noise of a shared machine, and a change of size that
somebody should explain."""
MAX_PSNR_LOSS_DB, MAX_WITHIN_LOSS = 0.1, 0.002
"""Below the baseline, and of the share of depth within 1 %: too little to see, more than rounding explains."""
STENCIL_SIDE, SORTED = 1200, 300_000
"""Sizes of the yardstick: a few tens of milliseconds, half of it compiled loops, half NumPy."""

LIVE = replace(with_preset(EncoderConfig(), Preset.LIVE), threads=1, motion=Motion.TRACK, voxel_size_m=VOXEL_SIZE_M)
FILE = replace(
    with_preset(EncoderConfig(), Preset.FAST),
    color_video=ColorVideo.OFF,
    threads=1,
    motion=Motion.KNOWN,
    voxel_size_m=VOXEL_SIZE_M,
)
"""Both presets by which something is measured: one that tracks and sends as it goes, one that fuses first; a single
thread, so that the number of cores does not matter."""


@dataclass(frozen=True)
class Measurement:
    """One figure, and how it is judged.

    Attributes
    ----------
    name
        What was measured.
    value
        The figure.
    unit
        ``yardsticks``, ``bytes``, ``dB`` or ``share``.
    """

    name: str
    value: float
    unit: str

    def is_worse(self, baseline: float) -> bool:
        """Tell whether the figure has left what noise or rounding explain, to the wrong side."""
        if self.unit == "dB":
            return self.value < baseline - MAX_PSNR_LOSS_DB
        if self.unit == "share":
            return self.value < baseline - MAX_WITHIN_LOSS
        return self.value > baseline * (MAX_SLOWER if self.unit == "yardsticks" else MAX_LARGER)


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _stencil(values: NDArray[np.float32], result: NDArray[np.float32]) -> None:
    for r in range(1, values.shape[0] - 1):
        for c in range(1, values.shape[1] - 1):
            around = values[r - 1, c] + values[r + 1, c] + values[r, c - 1] + values[r, c + 1]
            result[r, c] = 0.5 * values[r, c] + 0.125 * around


def _yardstick() -> Callable[[], None]:
    """Return a fixed piece of work that none of our code takes part in."""
    rng = np.random.default_rng(0)
    picture = rng.random((STENCIL_SIDE, STENCIL_SIDE), dtype=np.float32)
    smooth, numbers = np.empty_like(picture), rng.random(SORTED)

    def work() -> None:
        for _ in range(10):
            _stencil(picture, smooth)
        np.sort(numbers)

    return work


def cpu_seconds(work: Callable[[], object]) -> float:
    """Return the CPU time of all threads of the process that some work takes."""
    began = time.process_time()
    work()
    return time.process_time() - began


def speeds(stages: Mapping[str, Callable[[], object]], yardstick: Callable[[], object]) -> list[Measurement]:
    """Measure stages and the yardstick in turns, once all are compiled: what disturbs a moment disturbs one turn."""
    for work in (*stages.values(), yardstick):
        work()
    taken: dict[str, list[float]] = {name: [] for name in stages}
    units = []
    for _ in range(ROUNDS):
        for name, work in stages.items():
            taken[name].append(cpu_seconds(work))
            units.append(cpu_seconds(yardstick))
    return [Measurement(name, min(times) / min(units), "yardsticks") for name, times in taken.items()]


def measure() -> list[Measurement]:
    """Measure everything."""
    sequence = SyntheticSequence(make_scene("room", frames=FRAMES, size=SIZE), noise="kinect", seed=1)
    frames, yardstick = list(sequence), _yardstick()
    live, file = _packets(sequence, frames, LIVE), _packets(sequence, sequence, FILE)
    stages = {**_encoder_stages(sequence, frames), **_stream_stages(sequence, frames, live)}
    return [
        *speeds(stages, yardstick),
        *_size("live", live, sequence, frames),
        *_size("file", file, sequence, frames),
    ]


def _packets(
    sequence: SyntheticSequence, frames: Sequence[Frame] | SyntheticSequence, config: EncoderConfig
) -> list[Packet]:
    return list(Encoder(sequence.info, config).packets(frames))


def _encoder_stages(sequence: SyntheticSequence, frames: Sequence[Frame]) -> dict[str, Callable[[], object]]:
    """Return what an encoder does for each frame, and the coding of a whole surface."""
    scene = Scene(sequence.info, FILE)
    for frame in frames:
        scene.add(frame)
    background, rig = scene.objects[0], sequence.info.rig
    rays, sensor = rig.depth.rays(), scene.sensor_of(0)
    observed = [(observe(frame, rig, rays), pose) for frame, pose in zip(frames, background.poses, strict=True)]
    everywhere, full = np.ones(frames[0].depth.shape, dtype=bool), Downsampled(rig, 1)
    surface, settings = extract_surface(background.evidence, 1), color_settings(FILE.color, sequence.info.gray)

    def fusion() -> None:
        evidence = EvidenceModel(VOXEL_SIZE_M)
        for seen, pose in observed:
            fuse(evidence, seen, everywhere, pose, sensor, FILE.fusion, 1)

    def tracking_view() -> None:
        for pose in background.poses:
            raycast_model(background.evidence, full, pose, 1, exact=True)

    def entropy_coding() -> None:
        model = DecodedModel(VOXEL_SIZE_M)
        encode_update_with_result(first_visible_update(surface, model, None), *model.cells(), settings)

    return {"fusion": fusion, "tracking view": tracking_view, "entropy coding": entropy_coding}


def _stream_stages(
    sequence: SyntheticSequence, frames: Sequence[Frame], packets: Sequence[Packet]
) -> dict[str, Callable[[], object]]:
    """Return drawing, a live encode and a decode."""
    *_, last = replay(packets, 1, lambda state: state.index == FRAMES - 1)
    stream = _stream(packets)

    def drawing() -> None:
        for _ in range(FRAMES):
            last.renderer.draw(last.models, last.state.T_camera_object)

    return {
        "drawing": drawing,
        "live encode": partial(_packets, sequence, frames, LIVE),
        "decode": lambda: _decoded(stream),
    }


def _stream(packets: Sequence[Packet]) -> bytes:
    sink = io.BytesIO()
    writer = StreamWriter(sink)
    for packet in packets:
        writer.write(packet)
    return sink.getvalue()


def _decoded(stream: bytes) -> list[Frame]:
    return list(decode(io.BytesIO(stream), render=RenderConfig(threads=1)))


def _size(
    name: str, packets: Sequence[Packet], sequence: SyntheticSequence, frames: Sequence[Frame]
) -> list[Measurement]:
    """Measure the bytes of a stream, and the quality that they buy."""
    stream = _stream(packets)
    decoded = _decoded(stream)
    scale = sequence.info.depth_scale
    depths = [[depth_units(frame.depth, scale) for frame in each] for each in (frames, decoded)]
    errors = [DepthErrors.measure(given, drawn, MILLIMETERS / scale) for given, drawn in zip(*depths, strict=True)]
    total = sum(errors[1:], errors[0])
    decibels = [psnr(given.color, drawn.color) for given, drawn in zip(frames, decoded, strict=True)]
    return [
        Measurement(f"{name} stream", len(stream), "bytes"),
        Measurement(f"{name} PSNR", float(np.mean(decibels)), "dB"),
        Measurement(f"{name} depth within 1 %", total.within_1pct / total.valid, "share"),
    ]


def compare(measured: Sequence[Measurement], baseline: Mapping[str, float]) -> tuple[str, list[str]]:
    """Return a table of now, baseline and ratio, and what is worse; what the baseline lacks is only shown."""
    rows, worse = [], []
    for each in measured:
        before = baseline.get(each.name)
        ratio = "" if before is None else f"{each.value / before:.3f}"
        bad = before is not None and each.is_worse(before)
        rows.append([each.name, each.unit, f"{each.value:.5g}", "" if before is None else f"{before:.5g}", ratio])
        rows[-1].append("worse" if bad else "")
        worse += [each.name] if bad else []
    return markdown_table(["measure", "unit", "now", "baseline", "ratio", ""], rows, text_columns=2), worse


def _quickest(first: Sequence[Measurement], second: Sequence[Measurement]) -> list[Measurement]:
    """Return of two runs the lesser time of each stage: what disturbed one of them hardly disturbed both."""
    return [
        min(one, other, key=lambda each: each.value) if one.unit == "yardsticks" else one
        for one, other in zip(first, second, strict=True)
    ]


def main(arguments: list[str] | None = None) -> None:
    """Parse the command line, measure, print the table, write the figures."""
    parser = argparse.ArgumentParser(description="Guard speed and size against a committed baseline.")
    parser.add_argument("--baseline", type=Path, default=BASELINE, help="figures to compare with")
    parser.add_argument("--output", type=Path, default=REPOSITORY / "build" / "bench-ci.json", help="file to write")
    parser.add_argument("--renew", action="store_true", help="write the baseline instead")
    options = parser.parse_args(arguments)
    baseline = {}
    if not options.renew:
        baseline = json.loads(options.baseline.read_text(encoding="utf-8"))["measures"]
    measured = measure()
    table, worse = compare(measured, baseline)
    if worse or options.renew:
        measured = _quickest(measured, measure())
        table, worse = compare(measured, baseline)
    output = options.baseline if options.renew else options.output
    output.parent.mkdir(parents=True, exist_ok=True)
    figures = {"commit": commit(), "measures": {each.name: round(each.value, 5) for each in measured}}
    output.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")
    print(table)
    if worse:
        sys.exit(f"worse than {options.baseline.name} allows: {', '.join(worse)}")


if __name__ == "__main__":
    main()
