# SPDX-License-Identifier: MIT
"""What a command line asks for, typed: how recordings are read, and how they are encoded."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import click

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from threedvc.config import DepthErrorConfig, EncoderConfig, RegionOfInterest, SegmentationConfig
    from threedvc.formats.sources import FrameRange
    from threedvc.frames.sequence import FrameSequence

__all__ = ["EncodeRequest", "ReaderRequest"]


@dataclass(frozen=True, kw_only=True)
class ReaderRequest:
    """How recordings are read, see `threedvc.formats.sources.open_sequence`.

    Each is given once for all recordings, or once for each, or not at all.
    """

    layout: tuple[str, ...] = ()
    color: tuple[str, ...] = ()
    depth: tuple[str, ...] = ()
    intrinsics: tuple[str, ...] = ()
    depth_scale: tuple[float, ...] = ()
    fps: tuple[float, ...] = ()
    poses: tuple[str, ...] = ()

    @classmethod
    def of(cls, given: Mapping[str, Any]) -> Self:
        """Return the request of what click parsed."""
        return cls(**{each.name: given[each.name] for each in fields(cls)})

    def by_name(self) -> dict[str, tuple[Any, ...]]:
        """Return what is given, by the names of `open_sensors`."""
        return {each.name: getattr(self, each.name) for each in fields(ReaderRequest)}

    def for_recording(self, number: int) -> dict[str, Any]:
        """Return what is given for one recording, by the names of `open_sequence`."""
        return {
            name: given[number if len(given) > 1 else 0] for name, given in self.by_name().items() if len(given) > 0
        }

    def for_references(self, count: int) -> list[dict[str, Any]]:
        """Return what is said of each reference; raises click.UsageError where counts do not fit."""
        for name, given in self.by_name().items():
            if len(given) not in (0, 1, count):
                raise click.UsageError(
                    f"{_option(name)} is given {len(given)} times for {count} references; give it once, or once for "
                    "each"
                )
        return [self.for_recording(number) for number in range(count)]


@dataclass(frozen=True, kw_only=True)
class EncodeRequest(ReaderRequest):
    """What `3dvc encode` is asked for, but its input and output."""

    extrinsics: tuple[str, ...]
    delay: tuple[float, ...]
    max_depth: float | None
    frames: FrameRange | None
    voxel_size: float | None
    motion: str
    segment: SegmentationConfig
    sensor: tuple[str, ...]
    preset: str
    latency: float | None
    bitrate: float | None
    quality: int | None
    favor: str | None
    relief: int | None
    depth_video: str
    color_video: str
    depth_error: DepthErrorConfig
    lossless: bool
    focus: tuple[RegionOfInterest, ...]
    causal: bool
    threads: int | None

    def open(self, folders: Sequence[Path]) -> FrameSequence:
        """Open the recordings in some folders, one for each sensor.

        Raises
        ------
        click.UsageError
            If something is given for more sensors than there are.
        SequenceError, ConfigError
            If a recording cannot be read so.
        """
        from threedvc.formats.sources import open_sensors, open_sequence

        if len(folders) > 1:
            return open_sensors(
                folders,
                extrinsics=self.extrinsics,
                delays_s=self.delay,
                max_depth_m=self.max_depth,
                frames=self.frames,
                **self.by_name(),
            )
        for name, given in (self.by_name() | {"extrinsics": self.extrinsics, "delay": self.delay}).items():
            if len(given) > (name not in ("extrinsics", "delay")):
                raise click.UsageError(
                    f"{_option(name)} is given for more sensors than there are; add --input DIR for the others"
                )
        return open_sequence(folders[0], max_depth_m=self.max_depth, frames=self.frames, **self.for_recording(0))

    def configuration(self, sensors: int) -> EncoderConfig:
        """Return the encoder's choices for so many sensors; raises click.UsageError where options contradict."""
        from threedvc.config import (
            DEPTH_WEIGHTS,
            ColorVideo,
            DepthVideo,
            EncoderConfig,
            Favor,
            Motion,
            Preset,
            Sensor,
            with_lossless,
            with_preset,
            with_quality,
        )
        from threedvc.parallel import default_threads

        self._check(sensors)
        noise, *others = map(Sensor, self.sensor or ["auto"])
        config = EncoderConfig(
            voxel_size_m=self.voxel_size,
            max_depth_m=self.max_depth,
            motion=Motion(self.motion),
            sensor=noise,
            other_sensors=tuple(others),
            segmentation=self.segment,
            focus=self.focus,
            depth_video=DepthVideo(self.depth_video),
            depth_weight=DEPTH_WEIGHTS[Favor(self.favor or "neither")],
            color_video=ColorVideo(self.color_video),
            depth_error=self.depth_error,
            threads=self.threads or default_threads(),
        )
        if self.quality is not None:
            config = with_quality(config, self.quality)
        config = with_preset(config, Preset.LIVE if self.causal else Preset(self.preset))
        if self.latency is not None:
            config = replace(config, latency_s=self.latency)
        if self.lossless:
            config = with_lossless(config)
        appearance = replace(config.appearance, relief_bits=self.relief)
        return replace(config, bitrate_bps=self.bitrate, appearance=appearance)

    def _check(self, sensors: int) -> None:
        if self.bitrate is not None and self.quality is not None:
            raise click.UsageError("--bitrate and --quality contradict each other; give one of them")
        if self.causal and self.preset not in ("live", "medium"):
            raise click.UsageError(f"--causal and --preset {self.preset} contradict each other; give one of them")
        live = self.causal or self.preset == "live"
        if self.depth_video == "on" and live:
            raise click.UsageError("--depth-video on and --preset live contradict each other; give one of them")
        if self.latency is not None and not live:
            raise click.UsageError("--latency is for live streams; add --preset live, or leave it out")
        if self.lossless:
            for option, given in (
                ("--bitrate", self.bitrate is not None),
                ("--preset live", live),
                ("--color-video off", self.color_video == "off"),
                ("--depth-error", self.depth_error.kind not in ("model", "lossless")),
            ):
                if given:
                    raise click.UsageError(f"--lossless and {option} contradict each other; give one of them")
        if self.depth_error.kind != "model":
            for option, given in (("--bitrate", self.bitrate is not None), ("--preset live", live)):
                if given:
                    raise click.UsageError(f"--depth-error and {option} contradict each other; give one of them")
        if len(self.sensor) not in (0, 1, sensors):
            raise click.UsageError(f"--sensor is given {len(self.sensor)} times; give it once, or once for each INPUT")


def _option(name: str) -> str:
    return f"--{name.replace('_', '-')}"
