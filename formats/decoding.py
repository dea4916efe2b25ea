# SPDX-License-Identifier: MIT
"""Encode and decode whole sequences: frames from folders, streams in files and pipes."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from itertools import chain, islice
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from threedvc.coding.gains import apply_gain
from threedvc.config import RenderConfig
from threedvc.decoder.decoder import Decoder
from threedvc.decoder.frame_state import FrameState
from threedvc.decoder.measured_depth import MeasuredDepth
from threedvc.decoder.replay import DrawableModels
from threedvc.errors import ConfigError, FormatError, TruncatedStream
from threedvc.formats.container import open_input
from threedvc.frames.frame import SequenceInfo
from threedvc.geometry.camera import CameraRig
from threedvc.geometry.pose import Pose, compose, inverse
from threedvc.render.picture import Picture
from threedvc.render.renderer import Renderer
from threedvc.stream.headers import SensorHeader, StreamHeader
from threedvc.stream.packets import PacketType
from threedvc.stream.sensor_description import rig_of
from threedvc.units import NANOSECONDS

__all__ = ["DecodedFrame", "DecodedStream", "decode", "errors_named", "open_stream"]

EVERYTHING = frozenset({"color", "depth", "labels"})


@dataclass(frozen=True, kw_only=True, eq=False)
class DecodedFrame:
    """One frame out of a stream.

    Attributes
    ----------
    index, timestamp_ns
        Which frame.
    color_timestamp_ns
        Time of the color picture as filmed if that is another, else None.
    sensor, number
        The sensor that took it, from 0, and which of its own frames it is.
    color
        (h, w, 3) uint8 RGB in the color camera.
    depth
        (h, w) float32 meters in the depth camera, 0 = nothing there.
    labels
        (h, w) uint8 object numbers in the depth camera.
    saturated
        (h, w) bool, where the depth picture as filmed held the largest value of 16 bits in place of 0; None: nowhere.
    T_world_camera
        Pose of the depth camera that the frame was drawn from.
    T_camera_object
        Poses of the objects except the background, by number.
    """

    index: int
    timestamp_ns: int
    sensor: int
    number: int
    color: NDArray[np.uint8]
    depth: NDArray[np.float32]
    labels: NDArray[np.uint8]
    T_world_camera: Pose
    T_camera_object: dict[int, Pose]
    color_timestamp_ns: int | None = None
    saturated: NDArray[np.bool_] | None = None


class DecodedStream:
    """A stream being decoded: its description, and its frames by iteration (once).

    Made by `open_stream`, which documents the choices.

    Attributes
    ----------
    infos
        What each sensor's frames will be as a sequence; `frame_count` is None, for only END tells.
    decoder
        Models, report and completeness, as far as decoding has come.
    """

    def __init__(
        self,
        source: str | os.PathLike[str] | BinaryIO,
        *,
        frames: tuple[int, int | None] | None,
        what: frozenset[str],
        size: tuple[int, int] | None,
        objects: Sequence[int] | None,
        camera_path: Sequence[Pose] | None,
        sensor: int | None,
        render: RenderConfig | None,
    ) -> None:
        if camera_path is not None and not len(camera_path):
            raise ConfigError("the camera path has no poses; give one line for each frame")
        render = render or RenderConfig()
        self._frames, self._what, self._objects = frames or (0, None), what, objects
        self._camera_path = camera_path
        self._opened = ExitStack()
        reader = self._opened.enter_context(open_input(source))
        self._name, self._packets = reader.name, iter(reader)
        self._heads = list(islice(self._packets, 1))
        if not self._heads or self._heads[0].type != PacketType.STREAM:
            raise TruncatedStream(f"{self._name}: ends before its STREAM packet; nothing can be decoded")
        first = StreamHeader.from_map(self._heads[0].header)
        headers: list[StreamHeader | SensorHeader] = [first]
        for _ in range(first.sensors - 1):
            packet = next(self._packets, None)
            if packet is None or packet.type != PacketType.SENSOR:
                raise TruncatedStream(f"{self._name}: ends before all its SENSOR packets; nothing can be decoded")
            self._heads.append(packet)
            headers.append(SensorHeader.from_map(packet.header))
        if sensor is not None and not 0 <= sensor < len(headers):
            raise ConfigError(f"{self._name}: has no sensor {sensor}; choose from 0 to {len(headers) - 1}")
        rigs = [rig_of(header) for header in headers]
        shown = [rig if size is None else rig.resized(*size) for rig in rigs]
        self._sensor = 0 if sensor is None and camera_path is not None else sensor
        self._same_picture = camera_path is None and all(_same_size(*pair) for pair in zip(rigs, shown, strict=True))
        self._as_filmed = objects is None and camera_path is None
        self.decoder = Decoder(
            captured_depth=render.captured_depth and "depth" in what and self._as_filmed,
            captured_color=render.captured_color and "color" in what,
            threads=render.threads,
        )
        self._renderers = [Renderer(rig, render) for rig in shown]
        self._filming = [Renderer(rig, render) for rig in rigs]
        self._drawable = DrawableModels(render.threads)
        self.infos = tuple(_info(header, rig, what) for header, rig in zip(headers, shown, strict=True))

    def close(self) -> None:
        """Close the stream; iterating over all frames does so, too."""
        self._opened.close()

    @property
    def info(self) -> SequenceInfo:
        """What the frames of the first sensor, or of the one that is chosen, will be as a sequence."""
        return self.infos[self._sensor or 0]

    @property
    def unread_codecs(self) -> Mapping[str, int]:
        """Numbers of the codecs of videos that were wanted and cannot be decoded here, by what these show."""
        return self.decoder.unread_codecs

    def __iter__(self) -> Iterator[DecodedFrame]:
        first, stop = self._frames
        wanted = range(len(self.infos)) if self._sensor is None else [self._sensor]
        seen = dict.fromkeys(wanted, 0)
        with self._opened, errors_named(self._name):
            for state in self.decoder.frames(chain(self._heads, self._packets)):
                if stop is not None and min(seen.values()) >= stop:
                    return
                self._gather_colors(state)
                if state.sensor not in seen:
                    continue
                seen[state.sensor] = state.number + 1
                if state.number >= first and (stop is None or state.number < stop):
                    yield self._draw(state)
        if first >= max(seen.values()):
            raise ConfigError(f"frame {first} is beyond the stream, which has {max(seen.values())} frames")

    def _gather_colors(self, state: FrameState) -> None:
        """Color the models by what a picture of a color video shows, unless just such pictures are wanted."""
        if state.captured_color is None or (self._as_filmed and self._same_picture):
            return
        renderer = self._filming[state.sensor]
        camera = renderer.rig.color
        picture = state.captured_color.shown(camera.width, camera.height, renderer.config.threads)
        models = self._drawable.refreshed(self.decoder.models, state.T_camera_object)
        renderer.gather_colors(models, state.T_camera_object, picture, state.T_shifted_camera)

    def _draw(self, state: FrameState) -> DecodedFrame:
        T_world_camera, poses = state.T_world_camera, dict(state.T_camera_object)
        if self._camera_path is not None:
            seen_from = self._camera_path[min(state.number, len(self._camera_path) - 1)]
            T_view_camera = compose(inverse(seen_from), T_world_camera)
            poses = {number: compose(T_view_camera, pose) for number, pose in poses.items()}
            T_world_camera = seen_from
        picture, captured = self._picture(poses, state), state.captured_depth
        saturated = captured.saturated if isinstance(captured, MeasuredDepth) else None
        return DecodedFrame(
            index=state.index,
            timestamp_ns=state.timestamp_ns,
            color_timestamp_ns=state.color_timestamp_ns,
            sensor=state.sensor,
            number=state.number,
            color=picture.color,
            depth=picture.depth,
            labels=picture.labels,
            saturated=saturated if saturated is not None and saturated.shape == picture.depth.shape else None,
            T_world_camera=T_world_camera,
            T_camera_object={
                number: pose for number, pose in poses.items() if number and not self.decoder.models[number].guessed
            },
        )

    def _shows(self, number: int) -> bool:
        """Tell whether an object is to be drawn; guessed ones belong to the background."""
        return self._objects is None or (0 if self.decoder.models[number].guessed else number) in self._objects

    def _picture(self, poses: dict[int, Pose], state: FrameState) -> Picture:
        """Draw the objects; gain and shift are those of the camera that filmed, not of one on another path."""
        renderer = self._renderers[state.sensor]
        shown = {number: pose for number, pose in poses.items() if self._shows(number)}
        as_captured = self._camera_path is None
        as_filmed = state.captured_color if self._as_filmed and self._same_picture else None
        picture = renderer.draw(
            self._drawable.refreshed(self.decoder.models, shown),
            shown,
            color="color" in self._what and as_filmed is None,
            gain=apply_gain(state.gain) if as_captured else None,
            T_shifted_camera=state.T_shifted_camera if as_captured else None,
            backdrop=state.backdrop if self._objects is None or 0 in self._objects else None,
            lights={number: light for number, light in state.lights.items() if number in shown},
            filters=state.filters if self._same_picture else None,
        )
        threads = renderer.config.threads
        if as_filmed is not None:
            camera = renderer.rig.color
            picture = replace(picture, color=as_filmed.shown(camera.width, camera.height, threads))
        if state.captured_depth is not None:
            picture = replace(picture, depth=state.captured_depth.shown(picture.depth, threads))
        return picture


@contextmanager
def errors_named(name: str) -> Iterator[None]:
    """Put the name of the stream before the message of an error that lacks it: a decoder knows no files."""
    try:
        yield
    except FormatError as error:
        if str(error).startswith(f"{name}: "):
            raise
        raise type(error)(f"{name}: {error}") from None


def _same_size(one: CameraRig, other: CameraRig) -> bool:
    return (one.color.width, one.color.height) == (other.color.width, other.color.height)


def _info(header: StreamHeader | SensorHeader, rig: CameraRig, what: frozenset[str]) -> SequenceInfo:
    return SequenceInfo(
        name=header.name,
        rig=rig,
        depth_scale=header.depth_scale,
        fps=NANOSECONDS * header.period_den / header.period_num,
        frame_count=None,
        gray=header.gray,
        has_camera_poses=True,
        has_object_poses=True,
        has_masks="labels" in what,
    )


def open_stream(
    source: str | os.PathLike[str] | BinaryIO,
    *,
    frames: tuple[int, int | None] | None = None,
    what: frozenset[str] = EVERYTHING,
    size: tuple[int, int] | None = None,
    objects: Sequence[int] | None = None,
    camera_path: Sequence[Pose] | None = None,
    sensor: int | None = None,
    render: RenderConfig | None = None,
) -> DecodedStream:
    """Open a stream for decoding.

    Parameters
    ----------
    source
        A file name, ``-`` for standard input, or a binary stream.
    frames
        First frame and the one after the last, counted for each sensor by itself; None: all.
    what
        Which of ``color``, ``depth``, ``labels`` are wanted; without color its rays are saved.
    size
        (width, height) of the pictures; None: as encoded.
    objects
        Numbers of the objects to draw; None: all.
    camera_path
        T_world_camera for each frame of the first sensor, or of the one that is chosen, whose cameras are moved there;
        its last one for all that follow; None: as filmed.
    sensor
        Number of the sensor whose frames are drawn; None: all.
    render
        Choices of the renderer.

    Returns
    -------
    DecodedStream
        Iterate over it for the frames; TruncatedStream is raised after the last one that is complete.
    """
    return DecodedStream(
        source,
        frames=frames,
        what=what,
        size=size,
        objects=objects,
        camera_path=camera_path,
        sensor=sensor,
        render=render,
    )


def decode(
    source: str | os.PathLike[str] | BinaryIO,
    *,
    frames: tuple[int, int | None] | None = None,
    what: frozenset[str] = EVERYTHING,
    size: tuple[int, int] | None = None,
    objects: Sequence[int] | None = None,
    camera_path: Sequence[Pose] | None = None,
    sensor: int | None = None,
    render: RenderConfig | None = None,
) -> Iterator[DecodedFrame]:
    """Iterate over the frames of a stream; the parameters are those of `open_stream`."""
    yield from open_stream(
        source,
        frames=frames,
        what=what,
        size=size,
        objects=objects,
        camera_path=camera_path,
        sensor=sensor,
        render=render,
    )
