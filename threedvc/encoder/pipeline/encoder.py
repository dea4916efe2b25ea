# SPDX-License-Identifier: MIT
"""The encoder: frames in, packets out.

For a file every frame is fused first, cameras and poses are refined against the finished model and all
frames fused again; then each batch of frames gets the cells that it sees for the first time, as they turned
out in the end. A live encoder sends each batch as soon as it is fused.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sized
from math import inf
from time import perf_counter
from typing import cast

from threedvc.coding.video.av1 import can_encode_av1
from threedvc.coding.video.ffv1 import can_encode_ffv1
from threedvc.config import ColorVideo, DepthErrorKind, DepthVideo, EncoderConfig
from threedvc.encoder.packetizer.captured.live_color_video import LiveColorVideo
from threedvc.encoder.packetizer.packetizer import Packetizer
from threedvc.encoder.packetizer.scene_source import BatchFrames
from threedvc.encoder.pipeline.color_choice import file_stream
from threedvc.encoder.pipeline.fusion_pass import FrameReporter, FusionPass, Reconstruction, fuse_frames
from threedvc.encoder.pipeline.offline_passes import (
    check_regions_of_interest,
    check_surfaces,
    find_objects,
)
from threedvc.encoder.pipeline.rate_search import rated_choices
from threedvc.encoder.pipeline.stream_builder import StreamBuilder, StreamChoices, batch_length, batches, new_packetizer
from threedvc.encoder.reconstruction.scene import Scene
from threedvc.errors import ConfigError
from threedvc.frames.frame import Frame, SequenceInfo
from threedvc.frames.sequence import FrameSequence, frame_sets
from threedvc.stream.notes.frame_report import FrameReport, OnFrame
from threedvc.stream.packets import Packet

__all__ = ["Encoder"]


class Encoder:
    """Encodes one sequence.

    Parameters
    ----------
    info
        The sequence.
    config
        Choices.

    Attributes
    ----------
    state
        Choices, objects, evidence, poses and reports, as of the frames or passes so far.
    latency_s
        Longest time of a live stream so far from a frame coming in to its packet going out: until the last of its
        batch had come, by their time stamps, and what coding took then; None before the first batch.
    """

    def __init__(self, info: SequenceInfo, config: EncoderConfig | None = None) -> None:
        config = config or EncoderConfig()
        self._info = info
        self.state = Reconstruction(config=config, scene=Scene(info, config), reports=[])
        self.latency_s: float | None = None
        self._batch_frames = batch_length(info, config)

    @property
    def scene(self) -> Scene:
        """Objects, evidence and poses, as of the frames taken in so far."""
        return self.state.scene

    @property
    def config(self) -> EncoderConfig:
        """Choices, as they turned out so far."""
        return self.state.config

    @property
    def reports(self) -> list[FrameReport]:
        """One for every frame taken in."""
        return self.state.reports

    def packets(self, frames: Iterable[Frame], on_frame: OnFrame | None = None) -> Iterator[Packet]:
        """Take in all frames and yield the packets of the stream.

        Parameters
        ----------
        frames
            Frames in order, numbered from 0. Frames that can be read again (a `FrameSequence`) are used
            to refine cameras and poses unless the encoder is causal.
        on_frame
            Called after each frame of each pass.

        Raises
        ------
        SequenceError
            If there is no frame, or none of them has depth.
        """
        reporter = FrameReporter(on_frame)
        again = isinstance(frames, Sized) and hasattr(frames, "__getitem__")
        if self.config.depth_video is DepthVideo.ON and not (again and can_encode_av1()):
            raise ConfigError(
                "a depth video needs frames that can be read again, and a build of PyAV with AV1; install av 14 or "
                "newer with libsvtav1, or leave out --depth-video on"
            )
        if self.config.depth_error.kind is not DepthErrorKind.MODEL:
            if self.config.bitrate_bps is not None:
                raise ConfigError("the bytes of depth within a bound follow from it; give a quality in place of a rate")
            if not again:
                raise ConfigError("depth within a bound needs frames that can be read again; leave out --depth-error")
        can_encode = can_encode_ffv1 if self.config.video.lossless else can_encode_av1
        if self.config.color_video is ColorVideo.ON and not ((again or self.config.causal) and can_encode()):
            raise ConfigError(
                "a color video needs frames that can be read again, unless it is live, and a build of PyAV with AV1; "
                "install av 14 or newer with libsvtav1, or leave out --color-video on"
            )
        if self.config.causal:
            yield from self._live(frames, reporter)
        elif again:
            yield from self._in_passes(FusionPass(cast(FrameSequence, frames), reporter))
        else:
            yield from self._in_one_pass(frames, reporter)

    def _in_passes(self, fusion: FusionPass) -> list[Packet]:
        """Encode frames that can be read again."""
        self.state = find_objects(self._info, self.config, fusion)
        check_surfaces(self.state)
        check_regions_of_interest(self.state)
        if not self.state.has_depth:
            return self._without_fit()
        stream = file_stream(self.state, fusion)
        self.state = stream.state
        return stream.packets

    def _in_one_pass(self, frames: Iterable[Frame], reporter: FrameReporter) -> list[Packet]:
        """Encode frames that come once."""
        self.state = fuse_frames(frames, self.scene, reporter)
        check_surfaces(self.state)
        check_regions_of_interest(self.state)
        return self._without_fit()

    def _without_fit(self) -> list[Packet]:
        builder = StreamBuilder(self.state, None, self._batch_frames)
        return builder.build(rated_choices(builder))

    def _live(self, frames: Iterable[Frame], reporter: FrameReporter) -> Iterator[Packet]:
        """Send each batch when the first frame after it comes, so that the last batch is known to be it."""
        video = (
            None if self.config.color_video is ColorVideo.OFF or not can_encode_av1() else LiveColorVideo(self.scene)
        )
        packetizer: Packetizer | None = None
        sent = 0

        def due(now_ns: int, *, last: bool) -> Iterator[Packet]:
            nonlocal packetizer, video, sent
            began = perf_counter()
            if packetizer is None:
                video = self._live_video(video)
                packetizer = new_packetizer(self.state, StreamChoices(config=self.config), live_video=video)
                yield from packetizer.stream_headers()
            count = len(self.reports) - sent  # whole moments: sensors may take more frames than a batch has
            coded = list(batches(packetizer, self.state, sent, count, last=last))
            waited_s = (now_ns - self.scene.records[sent].timestamp_ns) / 1e9 if count else 0.0
            self.latency_s = max(self.latency_s or 0.0, waited_s + perf_counter() - began)
            yield from coded
            sent += count
            if last:
                yield packetizer.end()

        for frame_set in frame_sets(frames, self._info):
            if len(self.reports) - sent >= self._batch_frames:
                yield from due(frame_set[0].timestamp_ns, last=False)
            self.reports.extend(reporter.fuse(self.scene, frame_set))
            if video is not None:
                video.keep(frame_set)
        yield from due(self.scene.records[-1].timestamp_ns if self.reports else 0, last=True)

    def _live_video(self, video: LiveColorVideo | None) -> LiveColorVideo | None:
        """Return the color video of a stream that begins with the frames so far; None if models leave it too little."""
        if video is None or self.config.color_video is ColorVideo.ON or not self.reports:
            return video
        batch = BatchFrames.of(self.scene, 0, min(self._batch_frames, len(self.reports)))
        rate = self.config.bitrate_bps
        budget = inf if rate is None else rate / 8 * batch.count / self._info.fps
        return video if video.fits(batch, budget) else None
