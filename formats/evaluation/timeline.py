# SPDX-License-Identifier: MIT
"""What happens in a stream: where the camera and the objects are, and which of these can be seen when."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field

from threedvc.decoder.frame_state import FrameState
from threedvc.formats.evaluation.frame_ranges import FrameSpan, ranges_of
from threedvc.formats.evaluation.report import BACKGROUND
from threedvc.geometry.pose import Pose
from threedvc.metrics.trajectory import Travel, travel
from threedvc.model.decoded_model import DecodedModel

__all__ = ["StreamTimeline"]


@dataclass(kw_only=True)
class StreamTimeline:
    """The frames of a stream so far.

    Attributes
    ----------
    times_ns
        Their times.
    sensors
        The sensors that took them.
    T_world_camera
        Their poses of the depth camera.
    visible
        The numbers of the objects that they show.
    """

    times_ns: list[int] = field(default_factory=list)
    sensors: list[int] = field(default_factory=list)
    T_world_camera: list[Pose] = field(default_factory=list)
    visible: list[frozenset[int]] = field(default_factory=list)
    _scripts: defaultdict[int, dict[int, Pose]] = field(default_factory=lambda: defaultdict(dict))

    def add(self, state: FrameState, visible: frozenset[int]) -> None:
        """Note one frame."""
        frame = len(self.times_ns)
        self.times_ns.append(state.timestamp_ns)
        self.sensors.append(state.sensor)
        self.T_world_camera.append(state.T_world_camera)
        self.visible.append(visible)
        for number, pose in state.T_camera_object.items():
            if number != BACKGROUND:
                self._scripts[number][frame] = state.T_world_camera @ pose

    def camera_travel(self) -> Travel | None:
        """Return how far the camera of the first sensor went; None without frames of it."""
        own = [pose for pose, sensor in zip(self.T_world_camera, self.sensors, strict=True) if not sensor]
        return travel(own) if own else None

    def spans(self, number: int) -> tuple[FrameSpan, ...]:
        """Return the frames in which an object is visible."""
        return ranges_of(frame for frame, visible in enumerate(self.visible) if number in visible)

    def object_travel(self, number: int, model: DecodedModel) -> Travel | None:
        """Return how far the middle of an object's cells went in the world, from the first frame that shows it on.

        None for the background, and for an object that no frame shows.
        """
        script, spans, cells = self._scripts.get(number, {}), self.spans(number), model.cells()[0]
        poses = [pose for frame, pose in script.items() if spans and frame >= spans[0].first]
        if not poses or not len(cells):
            return None
        return travel(poses, (cells.mean(axis=0) + 0.5) * model.voxel_size_m)

    def counts(self, models: Mapping[int, DecodedModel]) -> list[int]:
        """Return for each frame how many objects it shows, the background, guessed and passing ones left out."""
        own = {
            number
            for number, model in models.items()
            if number != BACKGROUND and not model.guessed and not model.passing
        }
        return [len(visible & own) for visible in self.visible]
