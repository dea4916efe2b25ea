# SPDX-License-Identifier: MIT
"""Choices of what draws decoded models, and of what plans views."""

from __future__ import annotations

from dataclasses import dataclass, field

from threedvc.config.choices import FilterParts, Sensor
from threedvc.errors import ConfigError
from threedvc.parallel import default_threads

__all__ = ["ExplorationConfig", "RenderConfig"]

MAX_CANDIDATES = 100_000
"""More is a slip: each view is judged by thousands of rays."""


@dataclass(frozen=True, kw_only=True)
class RenderConfig:
    """Choices of the decoder's renderer.

    Attributes
    ----------
    supersample
        Rays per pixel side for color, or None for 2 on small pictures and 1 on large ones.
    filter_parts
        Where the stream's filter of pictures is applied.
    captured_depth, captured_color
        Whether depth and color as they were captured stand for those of the models, where the stream has a video.
    threads
        Number of threads; pictures do not depend on it.
    """

    supersample: int | None = None
    filter_parts: FilterParts = FilterParts.ALL
    captured_depth: bool = True
    captured_color: bool = True
    threads: int = field(default_factory=default_threads)

    def __post_init__(self) -> None:
        if self.supersample is not None and not 1 <= self.supersample <= 4:
            raise ConfigError(f"supersampling {self.supersample} must be within 1..4")
        if self.threads < 1:
            raise ConfigError(f"number of threads {self.threads} must be at least 1")


@dataclass(frozen=True, kw_only=True)
class ExplorationConfig:
    """Choices of the search for views to record next.

    Attributes
    ----------
    candidates
        Views of each explored object to choose from (decision 0015 ranks as many); the time goes with their number.
    best
        How many to propose: enough to choose another one where the first cannot be reached.
    sensor
        The sensor that will take them; a Kinect, as most recordings are of its kind.
    objects
        Numbers of the objects to explore, 0 for all that rests; None: what moves against the camera.
    threads
        Number of threads; proposals do not depend on it.
    """

    candidates: int = 200
    best: int = 5
    sensor: Sensor = Sensor.KINECT1
    objects: tuple[int, ...] | None = None
    threads: int = field(default_factory=default_threads)

    def __post_init__(self) -> None:
        if not 1 <= self.candidates <= MAX_CANDIDATES:
            raise ConfigError(f"number of candidates {self.candidates} must be within 1..{MAX_CANDIDATES}")
        if self.best < 1:
            raise ConfigError(f"number of proposals {self.best} must be at least 1")
        if self.sensor is Sensor.AUTO:
            raise ConfigError("a stream does not tell the sensor of views to come; name one")
        if self.threads < 1:
            raise ConfigError(f"number of threads {self.threads} must be at least 1")
