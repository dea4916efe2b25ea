# SPDX-License-Identifier: MIT
"""The encoder: frames in, packets out.

For a file every frame is fused first, cameras and poses are refined against the finished model and all
frames fused again; then each group of frames gets the cells that it sees for the first time, as they turned
out in the end. A live encoder sends each group as soon as it is fused.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence, Sized
from dataclasses import replace
from math import inf
from typing import cast

import numpy as np

from threedvc.coding.picture_sequence import can_encode_sequences
from threedvc.config import DepthVideo, EncoderConfig, SegmentationConfig, SegmentationMode, with_step
from threedvc.decoder.decoder import Decoder
from threedvc.encoder.appearance.appearance_fit import Finish, align, align_pictures, finish, trial_error
from threedvc.encoder.fusion.surface_extraction import read_surface
from threedvc.encoder.packetizer.depth_video import worthwhile_videos
from threedvc.encoder.packetizer.packetizer import Emitter
from threedvc.encoder.packetizer.post_filter_fit import FILTER_BYTES, fitted_filter
from threedvc.encoder.pipeline.cell_choice import cheap_relief, surface_bytes
from threedvc.encoder.rate.rate_control import (
    CLOSE,
    FINER,
    LEAST_STEP,
    MIDDLE_STEP,
    best_cells,
    cell_factor,
    closest_below,
    stream_bytes,
    surface_room,
)
from threedvc.encoder.reconstruction.color_calibration import calibrated_info
from threedvc.encoder.reconstruction.depth_consistency import depth_misfit, noisier_sensors
from threedvc.encoder.reconstruction.extrinsic_calibration import mounted_info
from threedvc.encoder.reconstruction.loop_closure import closed_loops
from threedvc.encoder.reconstruction.pose_refinement import refined_script
from threedvc.encoder.reconstruction.scene import Scene
from threedvc.encoder.segmentation.sequence_labels import MOST_LOST, Division
from threedvc.encoder.tracking.pose_track import Located, along_with_the_room, bridged, joined_parts
from threedvc.encoder.tracking.registration import RegistrationConfig, Status
from threedvc.encoder.tracking.trajectory_smoothing import settled
from threedvc.errors import ConfigError, CorruptStream, SequenceError
from threedvc.frames.frame import Frame, SequenceInfo
from threedvc.frames.sequence import FrameSequence, ThinnedSequence, moments, spread_step
from threedvc.geometry.pose import Pose, compose, inverse
from threedvc.model.post_filter import PictureFilter
from threedvc.stream.frame_report import FrameReport, OnFrame
from threedvc.stream.packets import Packet, PacketType

__all__ = ["Encoder", "verified"]

FILE_GROUP_S = 2
TRIAL_FRAMES = 100
DEPTH_ROUNDS = 3
WORTHWHILE_ROUND = 0.98
MORE_ROUNDS = 6
"""Rounds that shifts of pictures take beyond those of common poses: they converge slowly."""
TO_DEPTH = RegistrationConfig(luma_weight=0.1, weak_inliers=0.4, weak_overlap=0.15, rest_pixels=0.01, move_pixels=0.01)
"""Registration with the depth: luma counts little, but where the depth leaves a direction open. It refines poses that
are about right, so whatever is not lost may be trusted."""
DOUBTED_LUMA = 0.1
"""Weight of luma in the first pass, when it is not known yet whether depth and colour are registered as the input says:
a colour camera with another focal length would show other motions."""
SURE_LUMA = 2.0
"""Weight of luma where the background is tracked again with a calibration that proved right."""
BRIDGED_S = 0.5
"""Frames without depth, found by their pictures, are put on the way between those about them if they are no longer."""
WORTHWHILE_SHIFTS = 0.06
"""Share of the misfit of the depth that poses of its own surely are worth if they save it."""
SHIFT_BYTES = 3
LEAST_CELL_FACTOR, LEAST_SHIFTED_FACTOR = 0.45, 0.65
"""Cells narrower than about two pixels are not tried, or three where colour and depth have rays of their own: a decoder
would draw them slowly."""


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
    scene
        Objects, evidence and poses, as of the frames taken in so far.
    reports
        One for every frame taken in.
    """

    def __init__(self, info: SequenceInfo, config: EncoderConfig | None = None) -> None:
        self.info = info
        self.config = config or EncoderConfig()
        self.scene = Scene(info, self.config)
        self.reports: list[FrameReport] = []
        self._group = self.config.group_frames or max(1, round((1 if self.config.causal else FILE_GROUP_S) * info.fps))
        self._began = time.perf_counter()

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
        self._began = time.perf_counter()
        again = isinstance(frames, Sized) and hasattr(frames, "__getitem__")
        if self.config.depth_video is DepthVideo.ON and not (again and can_encode_sequences()):
            raise ConfigError(
                "a depth video needs frames that can be read again, and builds of Pillow and OpenCV with AVIF; install "
                "pillow 11.3 and opencv-python-headless 5 or newer, or leave out --depth-video on"
            )
        if self.config.causal:
            yield from self._live(frames, on_frame)
            return
        asked = self.config
        self._first_pass(frames, on_frame, again=again)
        if again:
            self._know_noise(cast(FrameSequence, frames), on_frame, asked)
        if again and self.config.refine:
            self._join_parts(cast(FrameSequence, frames), on_frame)
        if again:
            self._settle(cast(FrameSequence, frames), on_frame)
        self._check_surfaces()
        self._check_focus()
        finished = None
        if again:
            finished = self._finish(cast(FrameSequence, frames), on_frame)
        if finished is None:
            yield from self._everything(None, *self._rated(None, 0))
        else:
            yield from self._filtered(finished, cast(FrameSequence, frames))

    def _first_pass(self, frames: Iterable[Frame], on_frame: OnFrame | None, *, again: bool) -> None:
        """Find the objects and where they are; frames that can be read `again` are looked at beforehand."""
        undivided = self.config
        if again and self._may_divide:
            self._divide(cast(FrameSequence, frames))
        elif again and self.scene.division is not None:
            self.scene.division.take(cast(FrameSequence, frames))
        if again and self.config.refine:
            self.scene.luma_weight = DOUBTED_LUMA
        self._fuse_all(frames, on_frame)
        if self.config is not undivided and self._loses_often:
            self.config, self.scene = undivided, Scene(self.info, undivided)
            self.scene.luma_weight = DOUBTED_LUMA
            self._fuse_all(frames, on_frame)

    def _know_noise(self, frames: FrameSequence, on_frame: OnFrame | None, asked: EncoderConfig) -> None:
        """Begin anew with the choices `asked` for where a sensor scatters more than its first frame made believe."""
        sensors = noisier_sensors(self.scene, frames) if 0 in self.scene.objects else None
        if sensors is not None:
            self.config = replace(asked, sensor=sensors[0], other_sensors=tuple(sensors[1:]))
            self.scene = Scene(self.info, self.config)
            self._first_pass(frames, on_frame, again=True)

    @property
    def _may_divide(self) -> bool:
        """Whether nobody has said which objects there are, and there is time to find out."""
        info, asked = self.info, self.config.segmentation.mode
        told = info.has_masks or info.has_object_poses or bool(info.sensors)
        return asked is SegmentationMode.AUTO and self.config.refine and not told

    @property
    def _loses_often(self) -> bool:
        """Whether something is lost in so many frames that it is no rigid object: surfaces that shine seem to move."""
        return sum(report.status == Status.LOST for report in self.reports) > MOST_LOST * len(self.reports)

    def _divide(self, frames: FrameSequence) -> None:
        """Divide frames by motion if that finds anything."""
        config = replace(self.config, segmentation=SegmentationConfig(mode=SegmentationMode.MOTION))
        division = Division(self.info, config)
        division.take(frames)
        if division.is_sure:
            self.config = config
            self.scene = Scene(self.info, config, None, division)

    def _check_surfaces(self) -> None:
        """Raise SequenceError if depth was measured and makes no surface: a stream of it would draw nothing."""
        models = [item.evidence for item in self.scene.objects.values() if item.evidence.index.count]
        if models and not any(len(read_surface(model, self.config.threads).cells) for model in models):
            raise SequenceError(
                f"{self.info.name}: the depth of its {len(self.reports)} frames makes no surface; it is too sparse, or "
                "too noisy for --sensor, or its poses are wrong (--motion track)"
            )

    def _check_focus(self) -> None:
        """Raise ConfigError if a focus is on an object that is not there; a live encoder cannot know."""
        for focus in self.config.focus:
            if focus.number is not None and focus.number not in self.scene.objects:
                there = ", ".join(map(str, sorted(self.scene.objects)))
                raise ConfigError(
                    f"focus on object {focus.number}: {self.info.name} has object {there}; name one of them"
                )

    def _filtered(self, finished: Finish, frames: FrameSequence) -> list[Packet]:
        """Return all packets, with a filter fitted to what they draw."""
        choices = self._rated(finished, FILTER_BYTES)
        packets = self._everything(finished, *choices)
        videos = self._videos(packets, frames)
        target = self._target_bytes
        if videos:
            with_videos = self._rated(finished, FILTER_BYTES, videos)
            filmed = self._everything(finished, *with_videos, None, videos)
            if target is None or stream_bytes(filmed) <= target:
                choices, packets = with_videos, filmed
            else:
                videos = []
        plain_bytes = stream_bytes(packets)
        filters = fitted_filter(packets, frames, self.config.threads)
        if filters is not None:
            packets = self._everything(finished, *choices, filters, videos)
        took = stream_bytes(packets) - plain_bytes
        if target is None or plain_bytes > target - FILTER_BYTES:
            return packets
        if took > FILTER_BYTES or FILTER_BYTES - took > (1 - CLOSE) * target:
            choices = self._rated(finished, took, videos)
            packets = self._everything(finished, *choices, filters, videos)
        return packets

    def _videos(self, packets: Sequence[Packet], frames: FrameSequence) -> list[Packet]:
        """Return VIDEO packets of depth that the models do not tell, if it is worth it."""
        mode = self.config.depth_video
        if mode is DepthVideo.OFF or (mode is DepthVideo.AUTO and not self.config.refine):
            return []
        wanted = mode is DepthVideo.ON
        return worthwhile_videos(self.scene, frames, packets, self._target_bytes, self._group, sure=wanted)

    def _rated(
        self, finished: Finish | None, filter_bytes: int, videos: Sequence[Packet] = ()
    ) -> tuple[EncoderConfig, float | None]:
        """Return the choices, and the step of a backdrop, that with a filter give the bytes wanted if there are any."""
        if self._target_bytes is None:
            return self.config, None
        target = self._target_bytes - filter_bytes

        def config(step: float) -> EncoderConfig:
            return replace(self.config, color=with_step(step))

        def made(step: float, picture_step: float | None = None) -> int:
            return stream_bytes(self._everything(finished, config(step), picture_step, None, videos))

        step, size = closest_below(made, target)
        finest = max(step / FINER, LEAST_STEP)
        if size < CLOSE * target and finished is not None and finished.backdrop is not None and finest < step:
            # Pictures come in leaps; cells fill what a leap leaves.
            for_cells, larger = closest_below(lambda each: made(each, step), target, (finest, step))
            if size < larger <= target:
                return config(for_cells), step
        return config(step), None

    def _everything(
        self,
        finished: Finish | None,
        config: EncoderConfig,
        picture_step: float | None = None,
        filters: PictureFilter | None = None,
        videos: Sequence[Packet] = (),
    ) -> list[Packet]:
        emitter = self._emitter(finished, config, picture_step, filters, videos)
        return [*emitter.head(), *self._batches(emitter, 0, last=True), emitter.end()]

    @property
    def _target_bytes(self) -> float | None:
        rate = self.config.bitrate_bps
        return None if rate is None else rate * len(self.reports) / self.info.fps / 8

    def _live(self, frames: Iterable[Frame], on_frame: OnFrame | None) -> Iterator[Packet]:
        """Send each group when the first frame after it comes, so that the last group is known to be it."""
        emitter: Emitter | None = None
        sent = 0
        for moment in moments(frames, self.info):
            if len(self.reports) - sent >= self._group:
                if emitter is None:
                    emitter = self._emitter()
                    yield from emitter.head()
                yield from self._batches(emitter, sent, last=False)
                sent = len(self.reports)
            self._take(moment, on_frame)
        if emitter is None:
            emitter = self._emitter()
            yield from emitter.head()
        yield from self._batches(emitter, sent, last=True)
        yield emitter.end()

    def _fuse_all(self, frames: Iterable[Frame], on_frame: OnFrame | None) -> None:
        self.reports = []
        for moment in moments(frames, self.info):
            self._take(moment, on_frame)

    def _finish(self, frames: FrameSequence, on_frame: OnFrame | None) -> Finish | None:
        """Choose cells, calibrate, register again, fuse anew, and fit to the pictures that the decoder draws."""
        if not any(item.evidence.index.count for item in self.scene.objects.values()):
            return None
        self._fit_cells(frames, on_frame)
        shifts = None
        if self.config.refine:
            self._mount(frames, on_frame)
            self._calibrate(frames, on_frame)
            self._close_loops(frames, on_frame)
            if self.config.appearance.rounds and any(map(self.scene.may_move, self.scene.objects)):
                shifts = self._align(frames, on_frame)
            self._try_cells(frames, on_frame, shifts)
        self._choose_relief()
        return finish(self.scene, frames, shifts)

    def _join_parts(self, frames: FrameSequence, on_frame: OnFrame | None) -> None:
        """Bring the parts of models that recognised each other together."""
        items = self.scene.objects.items()
        bridges = {number: item.tracker.bridges for number, item in items if item.tracker and item.tracker.bridges}
        if bridges:
            script = {number: joined_parts(item.found, bridges.get(number, {})) for number, item in items}
            self._fuse_again(frames, on_frame, script)

    def _mount(self, frames: FrameSequence, on_frame: OnFrame | None) -> None:
        """Correct how further sensors are mounted, if that makes their frames fit those of the first one better."""
        info = mounted_info(self.scene, frames)
        if info is not None:
            self.info = info
            script = {number: item.found for number, item in self.scene.objects.items()}
            self.scene = Scene(info, self.config, script, self.scene.division)
            self._fuse_all(frames, on_frame)

    def _settle(self, frames: FrameSequence, on_frame: OnFrame | None) -> None:
        """Let a camera that was tracked and hardly moved stand still."""
        background = self.scene.objects.get(0)
        if background is None or background.stayed or not self.scene.hardly_moves(0):
            return
        first = next(at.T_camera_object for at in background.found if at is not None and at.usable)
        script = {number: item.found for number, item in self.scene.objects.items()}
        self._fuse_again(
            frames, on_frame, script | {0: [at and replace(at, T_camera_object=first) for at in background.found]}
        )

    def _calibrate(self, frames: FrameSequence, on_frame: OnFrame | None) -> None:
        """Calibrate the colour cameras, and find all poses once more with what is then known.

        Where the input's own calibration turns out to be right, luma counts fully, and what was tracked is tracked
        anew. A new one is not quite exact: the depth leads on.
        """
        tracked = any(item.tracker is not None for item in self.scene.objects.values())
        info = calibrated_info(self.scene, frames)
        if info is not None:
            known = {number: item.found for number, item in self.scene.objects.items()}
            self.scene = Scene(info, self.config, known, self.scene.division)
            self._fuse_all(frames, on_frame)
        elif tracked:
            cells = min(self.config.cell_factor, 1.0)  # wider ones, for a low rate, would blunt the tracking
            self.scene = Scene(self.info, replace(self.config, cell_factor=cells), None, self.scene.division)
            self.scene.luma_weight = SURE_LUMA
            self._fuse_all(frames, on_frame)
            self._join_parts(frames, on_frame)
            self._settle(frames, on_frame)
        script = refined_script(self.scene, frames, TO_DEPTH if tracked and info is not None else None)
        script[0] = bridged(script[0], self.scene.blind, round(BRIDGED_S * self.info.fps))
        self._fuse_again(frames, on_frame, script)

    def _close_loops(self, frames: FrameSequence, on_frame: OnFrame | None) -> None:
        """Take the drift out of a tracked camera's path, if that makes the model fit the frames better."""
        if not self.scene.may_move(0) or all(at is None or at.status == "known" for at in self.scene.objects[0].found):
            return
        closed = closed_loops(self.scene, frames)
        if closed is None:
            return
        before, reports = self.scene, self.reports
        script = {number: item.found for number, item in before.objects.items()}
        self._fuse_again(frames, on_frame, script | {0: closed})
        self._fuse_again(frames, on_frame, refined_script(self.scene, frames))
        if depth_misfit(self.scene, frames) > WORTHWHILE_ROUND * depth_misfit(before, frames):
            self.scene, self.reports = before, reports

    def _align(self, frames: FrameSequence, on_frame: OnFrame | None) -> list[Pose] | None:
        """Move the camera to where pictures fit best; return the shifts of the colour pictures if there are to be any.

        Poses that fit colour and depth serve both, unless the depth alone wants clearly other ones, or the pictures are
        better for it.
        """
        rounds = self.config.appearance.rounds
        self._fuse_again(frames, on_frame, align(self.scene, frames, rounds))
        if not self.scene.may_move(0):
            return None
        together, reports = self.scene, self.reports
        first = misfit = depth_misfit(together, frames)
        for _ in range(DEPTH_ROUNDS):
            script = refined_script(self.scene, frames, TO_DEPTH)
            if not self.info.sensors:  # sensors share poses, or take turns at steps of uneven length
                script[0] = settled(script[0], together.objects[0].found, together.blind)
            self._fuse_again(frames, on_frame, script)
            before, misfit = misfit, depth_misfit(self.scene, frames)
            if misfit > WORTHWHILE_ROUND * before:
                break
        poses = zip(together.objects[0].poses, self.scene.objects[0].poses, self.scene.sensors, strict=True)
        there = [rig.at_sensor for rig in self.info.rigs]
        shifts = [compose(there[sensor](both), inverse(there[sensor](depth))) for both, depth, sensor in poses]
        sure = misfit <= (1 - WORTHWHILE_SHIFTS) * first
        if sure or (misfit < first and self._is_better_apart(together, shifts, frames)):
            return align_pictures(self.scene, frames, shifts, rounds + MORE_ROUNDS)
        self.scene, self.reports = together, reports
        return None

    def _is_better_apart(self, together: Scene, shifts: Sequence[Pose], frames: FrameSequence) -> bool:
        """Tell whether shifts, about right as yet, give better pictures than poses that serve colour and depth."""
        room = self._cell_room or surface_bytes(together, self.config.color.luma_step)
        apart = trial_error(self.scene, frames, shifts, max(room - SHIFT_BYTES * len(shifts), 0.5 * room))
        return apart < trial_error(together, frames, None, room)

    @property
    def _cell_room(self) -> float | None:
        """Bytes that surfaces may take if their cells are free to follow from it: not before a backdrop."""
        target = self._target_bytes
        if target is None or self.config.voxel_size_m is not None or self.scene.at_rest(0):
            return None
        return surface_room(len(self.reports), target)

    def _fit_cells(self, frames: FrameSequence, on_frame: OnFrame | None) -> None:
        """Take wider or narrower cells if the bit rate asks for them."""
        room = self._cell_room
        if room is not None:
            factor = cell_factor(surface_bytes(self.scene, MIDDLE_STEP), room)
            if factor != 1:
                self._take_cells(frames, on_frame, factor)

    def _try_cells(self, frames: FrameSequence, on_frame: OnFrame | None, shifts: Sequence[Pose] | None) -> None:
        """Take those cells that draw the best pictures at the bit rate, of some tried or between them."""
        room = self._cell_room
        if room is None:
            return

        least = LEAST_CELL_FACTOR if shifts is None else LEAST_SHIFTED_FACTOR
        step = spread_step(len(frames), TRIAL_FRAMES, self.info)
        some = ThinnedSequence(frames, step)
        script = {number: item.found[::step] for number, item in self.scene.objects.items()}

        def tried(factor: float) -> float:
            config = self._with_cells(factor)
            if factor < 1 and config.cell_factor < least:
                return inf
            scene = Scene(self.scene.info, config, script, self.scene.division)
            for frame in some:
                scene.add(frame)
            return trial_error(scene, some, shifts and shifts[::step], room)

        factor = best_cells(tried)
        if factor != 1:
            self._take_cells(frames, on_frame, factor)

    def _choose_relief(self) -> None:
        """Settle whether the stream tells where in their cells surfaces pass."""
        appearance = self.config.appearance
        if appearance.relief_bits is None:
            step = self.config.color.luma_step if self._target_bytes is None else MIDDLE_STEP
            appearance = replace(appearance, relief_bits=cheap_relief(self.scene, step))
            self.config = self.scene.config = replace(self.config, appearance=appearance)

    def _with_cells(self, factor: float) -> EncoderConfig:
        """Return the choices with cells wider by a factor."""
        return replace(self.config, cell_factor=float(np.clip(self.config.cell_factor * factor, 1 / 16, 16)))

    def _take_cells(self, frames: FrameSequence, on_frame: OnFrame | None, factor: float) -> None:
        """Fuse all frames again into cells wider by a factor."""
        self.config = self._with_cells(factor)
        self._fuse_again(frames, on_frame, {number: item.found for number, item in self.scene.objects.items()})

    def _fuse_again(
        self, frames: FrameSequence, on_frame: OnFrame | None, script: Mapping[int, Sequence[Located | None]]
    ) -> None:
        before = {number: item.found for number, item in self.scene.objects.items()}
        script = along_with_the_room(script, before)
        self.scene = Scene(self.scene.info, self.config, script, self.scene.division)
        self._fuse_all(frames, on_frame)

    def _take(self, moment: Sequence[Frame], on_frame: OnFrame | None) -> None:
        status = self.scene.add(*moment)
        for frame in moment:
            report = FrameReport(
                index=frame.index,
                timestamp_ns=frame.timestamp_ns,
                status=status,
                entropy_bits=self.scene.entropy_bits,
                seconds=time.perf_counter() - self._began,
            )
            self.reports.append(report)
            if on_frame is not None:
                on_frame(report)

    def _emitter(
        self,
        finished: Finish | None = None,
        config: EncoderConfig | None = None,
        picture_step: float | None = None,
        filters: PictureFilter | None = None,
        videos: Sequence[Packet] = (),
    ) -> Emitter:
        if not self.reports:
            raise SequenceError(f"{self.info.name} has no frames")
        if not self.config.causal and not any(item.evidence.index.count for item in self.scene.objects.values()):
            raise SequenceError(
                f"{self.info.name}: no frame has a depth measurement that could be used; all may lie beyond the reach "
                "of its sensor: give --sensor lidar, or --max-depth"
            )
        return Emitter(self.scene, config or self.config, finished, picture_step, filters, videos)

    def _batches(self, emitter: Emitter, first: int, *, last: bool) -> Iterator[Packet]:
        """Yield the batches of the frames from `first` on that were taken in."""
        stop = len(self.reports)
        for start in range(first, stop, self._group):
            end = min(start + self._group, stop)
            final = last and end == stop
            told = self.reports[start:end] if self.config.causal else self.reports if final else []
            batch = emitter.group(start, end, told, last=final)
            if batch is not None:
                yield batch


def verified(packets: Iterable[Packet]) -> Iterator[Packet]:
    """Pass packets on while a decoder follows them.

    Raises
    ------
    CorruptStream
        If the decoder cannot follow, or arrives at another model than the encoder's.
    """
    decoder = Decoder()
    kept: list[Packet] = []

    def passing() -> Iterator[Packet]:
        for packet in packets:
            kept.append(packet)
            yield packet

    for _ in decoder.frames(passing()):
        while kept:
            yield kept.pop(0)
    while kept:
        packet = kept.pop(0)
        yield packet
        if packet.type == PacketType.END and not decoder.complete:
            raise CorruptStream("verification failed: the decoder did not reach the encoder's model")
