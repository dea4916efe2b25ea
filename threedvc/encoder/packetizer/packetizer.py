# SPDX-License-Identifier: MIT
"""Packets of a scene: what the decoder lacks, group by group.

The emitter holds a decoder's state: models as decoded, poses as quantised. A model update is the
difference between what is to be seen and that state; a group without difference has no packet.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import inf
from typing import Any, NamedTuple

import numpy as np

from threedvc.coding.filters import encode_filter
from threedvc.coding.gains import GainCoder
from threedvc.coding.light import pack_light
from threedvc.coding.picture import can_encode_pictures
from threedvc.coding.poses import PoseCoder
from threedvc.coding.relief import encode_relief
from threedvc.coding.texture import encode_texture
from threedvc.coding.update import encode_update_with_result
from threedvc.config import EncoderConfig, PoseConfig, RenderConfig
from threedvc.encoder.appearance.appearance_fit import FittedAppearance
from threedvc.encoder.appearance.background_depth import RELIEF_BITS, CodedDepthMap
from threedvc.encoder.appearance.lighting import light_at
from threedvc.encoder.fusion.surface_extraction import Surface, in_regions, read_surface
from threedvc.encoder.rate.model_updates import changes, first_sights
from threedvc.encoder.rate.rate_control import LeakyBucket, stream_bytes
from threedvc.encoder.rate.region_of_interest import finer, focused
from threedvc.encoder.rate.trial_coding import color_settings, one_shot
from threedvc.encoder.rate.update_priority import best_part
from threedvc.encoder.reconstruction.scene import Scene
from threedvc.encoder.reconstruction.scene_object import SceneObject
from threedvc.geometry.pose import Pose, compose, identity, inverse
from threedvc.limits import MAX_COUNT
from threedvc.model.decoded_model import DecodedModel, models_digest
from threedvc.model.model_update import ModelUpdate
from threedvc.model.post_filter import PictureFilter
from threedvc.render.render_model import RenderModel
from threedvc.render.renderer import Renderer
from threedvc.stream.batch import pack_batch
from threedvc.stream.color_times import color_times_packet
from threedvc.stream.frame_report import FrameReport, report_packet
from threedvc.stream.headers import (
    BackdropHeader,
    BatchHeader,
    ClockHeader,
    DepthHeader,
    EndHeader,
    FilterHeader,
    GainHeader,
    LightHeader,
    ModelHeader,
    ObjectHeader,
    OrderHeader,
    PoseHeader,
    ReliefHeader,
    SensorHeader,
    ShiftHeader,
    StreamHeader,
    TextureHeader,
)
from threedvc.stream.input_options import input_options_packet
from threedvc.stream.packets import Packet
from threedvc.stream.sensor_description import camera_record, clock_record, nearest_multiple, transform_record
from threedvc.stream.sensor_order import Turn, Turns, pack_cycle, shortest_cycle
from threedvc.stream.wire import pack_signed_varint

__all__ = ["Emitter"]

MAX_STILL_GAP = 2
MIN_LIVE_CELLS = 4
"""A live encoder lets fewer changed cells than these wait for more: their framing would outweigh them."""
FILL = 0.97
"""How much of the room a part of an update aims at: what parts take is estimated."""
MAX_REST = MAX_COUNT // 2
MAX_LIVE_REST_S = 60
"""A live stream lets nothing be heard for so long where nothing changes."""
STEP_PIXELS = 0.35
LEAST_STEP_M, GREATEST_STEP_M = 5e-5, 5e-3
BATCH_BYTES = 40
MEMBER_BYTES = 20
END_BYTES = 112
INDEX_ENTRY_BYTES = 8
"""At most what frames a BATCH, a model update in it, and the end of a stream."""


class PoseSteps(NamedTuple):
    """Quantisation steps of poses: metres and radians."""

    translation_m: float
    rotation_rad: float


def pose_steps(scene: Scene, config: PoseConfig) -> PoseSteps:
    """Return the steps asked for, or about a third of a pixel: rounding moves what is seen by half of that."""
    turn = STEP_PIXELS / max(max(rig.color.fx, rig.depth.fx) for rig in scene.info.rigs)
    return PoseSteps(
        config.translation_step_m or min(max(turn * scene.distance_m, LEAST_STEP_M), GREATEST_STEP_M),
        config.rotation_step_rad or turn,
    )


class _Sent:
    """What the decoder has of one object, and what it would have if colours were not quantised."""

    def __init__(self, item: SceneObject, model: DecodedModel, steps: PoseSteps) -> None:
        self.item = item
        self.model = model
        self.wanted = DecodedModel(item.evidence.voxel_size_m)
        self.coder = PoseCoder(*steps)
        self.given: Pose | None = None
        self.next_coded: int | None = None
        self.final: Surface | None = None


class _Entry(NamedTuple):
    """What a group holds of an object besides its model update."""

    sent: _Sent
    introduction: list[Packet]
    poses: list[Packet]


class Emitter:
    """Turns a scene into packets.

    Parameters
    ----------
    scene
        The scene; a live encoder adds frames to it between groups.
    config
        Choices.
    finished
        Colours and gains fitted to the pictures; None: the mean colours of the evidence, and no gains.
    picture_step
        Luma step that the quality of a backdrop follows; None: that of the cells.
    filters
        Filter of the pictures, or None.
    videos
        VIDEO packets in the order of their frames.
    """

    def __init__(
        self,
        scene: Scene,
        config: EncoderConfig,
        finished: FittedAppearance | None = None,
        picture_step: float | None = None,
        filters: PictureFilter | None = None,
        videos: Sequence[Packet] = (),
    ) -> None:
        self._scene, self._config, self._info = scene, config, scene.info
        self._finished, self._filters, self._videos = finished, filters, videos
        sensors = scene.info.each_sensor
        self._gains = [GainCoder(sensor.grey) for sensor in sensors]
        self._guessed: dict[int, SceneObject] = {}
        if finished is not None and finished.inferred is not None:
            number, voxel_size_m = finished.inferred
            self._guessed[number] = SceneObject(number, voxel_size_m, None)
            self._guessed[number].born = int(finished.surfaces[number].first_seen.min())
        self._steps = pose_steps(scene, config.pose)
        self._shifts = [PoseCoder(*self._steps) for _ in sensors]
        self._turns = Turns()
        self._sent: dict[int, _Sent] = {}
        self._color = color_settings(config.color, scene.info.grey)
        self._clocks = [clock_record(sensor.fps) for sensor in sensors]
        self._batched = 0
        self._untold: list[FrameReport] = []
        self._rest = min(round(MAX_LIVE_REST_S * scene.info.fps), MAX_REST) if config.causal else MAX_REST
        self._groups = 0
        self._bucket = None
        if config.causal and config.bitrate_bps is not None:
            self._bucket = LeakyBucket(config.bitrate_bps / 8, config.live_buffer_s)
            self._bucket.take(stream_bytes(self.head()))
        self._backdrop = self._worthwhile_backdrop(picture_step or config.color.luma_step)
        self._depths: CodedDepthMap | None = None
        if self._backdrop is not None and finished is not None:
            self._depths = finished.depths

    @property
    def digest(self) -> bytes:
        """Digest of the decoded models so far."""
        return models_digest({number: sent.model for number, sent in self._sent.items()})

    def head(self) -> list[Packet]:
        """Return the STREAM packet, SENSOR packets for further sensors, and how the recordings were read if told."""
        count = len(self._info.each_sensor)
        stream = StreamHeader(
            **self._described(0),
            translation_step_m=self._steps.translation_m,
            rotation_step_rad=self._steps.rotation_rad,
            given_world=self._info.has_camera_poses,
            sensors=count,
        )
        sensors = [self._sensor_header(number).packet() for number in range(1, count)]
        told = [
            input_options_packet(number, sensor.read_as)
            for number, sensor in enumerate(self._info.each_sensor)
            if sensor.read_as
        ]
        return [stream.packet(), *sensors, *told]

    def _sensor_header(self, number: int) -> SensorHeader:
        mount = transform_record(self._info.rigs[number].T_depth_base)
        return SensorHeader(**self._described(number), T_depth_base=mount)

    def _described(self, number: int) -> dict[str, Any]:
        """Return what STREAM and SENSOR say of a sensor."""
        sensor = self._info.each_sensor[number]
        rig, (period_num, period_den) = sensor.rig, self._clocks[number]
        return {
            "color_camera": camera_record(rig.color),
            "depth_camera": () if rig.depth == rig.color else camera_record(rig.depth),
            "T_color_depth": transform_record(rig.T_color_depth),
            "depth_scale": sensor.depth_scale,
            "start_ns": self._start(number),
            "period_num": period_num,
            "period_den": period_den,
            "grey": sensor.grey,
            "name": sensor.name,
        }

    def _start(self, number: int) -> int:
        """Return the time of a sensor's first frame; that of the first frame of all where it has none so far."""
        scene = self._scene
        times = (time for time, sensor in zip(scene.timestamps, scene.sensors, strict=True) if sensor == number)
        return next(times, scene.timestamps[0])

    def group(self, first: int, stop: int, reports: Sequence[FrameReport], *, last: bool) -> Packet | None:
        """Return the BATCH of frames ``first..stop``, or None if nothing changes in them and none is due.

        Parameters
        ----------
        first, stop
            Frames of the group; the scene has taken in all of them.
        reports
            What to tell about them; empty: nothing. It waits for a group in which something changes.
        last
            Whether no frame follows: the batch then holds every cell that is still due.
        """
        entries = [entry for number in self._numbers() if (entry := self._enter(number, first, stop)) is not None]
        around = [
            *self._order_packets(first, stop),
            *self._clock_packets(first, stop),
            *self._shift_packets(first, stop),
            *self._gain_packets(first, stop),
        ]
        if not first and self._backdrop is not None:
            around.append(BackdropHeader(frame=first).packet(self._backdrop))
        if not first and self._filters is not None:
            payload = encode_filter(self._filters, self._info.grey)
            around.append(FilterHeader(frame=first).packet(payload, critical=False))
        around += [video for video in self._videos if first <= video.header["f"] < stop]
        offsets = self._scene.color_offsets[first:stop]
        if any(offsets):
            around.append(color_times_packet(first, offsets))
        self._untold += reports
        told = [report_packet(self._untold[at : at + MAX_COUNT]) for at in range(0, len(self._untold), MAX_COUNT)]
        needed = [packet for entry in entries for packet in (*entry.introduction, *entry.poses)]
        room = self._room(first, stop, [*around, *told, *needed], last)
        members = []
        for entry in entries:
            update = list(self._model(entry.sent, first, None if last else stop, room, last))
            room -= _packed_bytes(update)
            # What a picture shows depends on where the camera stands, so poses come first.
            members += [*entry.introduction, *entry.poses, *update]
        members += around
        if not members and not (last and told) and stop - self._batched <= self._rest:
            return None
        members += told
        self._batched, self._untold = stop, []
        batch = pack_batch(BatchHeader(frame=first, count=stop - first), members)
        if self._bucket is not None:
            self._bucket.take(len(batch.payload) + BATCH_BYTES)
        return batch

    def end(self) -> Packet:
        """Return the END packet."""
        return EndHeader(frames=len(self._scene.timestamps), digest=self.digest).packet()

    def _room(self, first: int, stop: int, needed: Sequence[Packet], last: bool) -> float:
        """Return how many bytes model updates may take in a group whose other packets are known."""
        if self._bucket is None:
            return inf
        seconds = (stop - first) / self._info.fps
        self._bucket.wait(seconds)
        self._groups += 1
        needs = _packed_bytes(needed) + BATCH_BYTES
        # The next group may be the last, and will need about as much as this one.
        reserve = float(END_BYTES + INDEX_ENTRY_BYTES * (self._groups + 1))
        if not last:
            reserve = max(reserve + needs - self._bucket.refill(seconds), 0.0)
        return self._bucket.room - needs - reserve

    def _numbers(self) -> list[int]:
        return sorted({*self._scene.objects, *self._guessed})

    def _enter(self, number: int, first: int, stop: int) -> _Entry | None:
        """Return what a group holds of an object besides its model update; None before it appears."""
        guessed = number in self._guessed
        item = self._guessed[number] if guessed else self._scene.objects[number]
        introduction, new = [], number not in self._sent
        if new:
            if item.born is None or item.born >= stop:
                return None
            model = self._new_model(item, guessed)
            self._sent[number] = _Sent(item, model, self._steps)
            introduction.append(
                ObjectHeader(
                    object_id=number,
                    voxel_size_m=model.voxel_size_m,
                    texture_bits=0 if model.texture is None else model.texture.scale.bit_length() - 1,
                    guessed=guessed,
                    relief_bits=model.relief_bits,
                    passing=item.passing,
                ).packet()
            )
        sent = self._sent[number]
        introduction += self._light_packets(number, first, stop, new=new)
        return _Entry(sent, introduction, list(self._poses(sent, first, stop)))

    def _light_packets(self, number: int, first: int, stop: int, *, new: bool) -> Iterator[Packet]:
        """Yield the lights on an object that begin in a group, and the present one if the object is new."""
        script = () if self._finished is None else self._finished.colors.lights.get(number, ())
        if script and new:
            yield LightHeader(object_id=number, frame=first).packet(pack_light(light_at(script, first)))
        for frame, factors in script[1:]:
            if first + new <= frame < stop:
                yield LightHeader(object_id=number, frame=frame).packet(pack_light(factors))

    def _new_model(self, item: SceneObject, guessed: bool) -> DecodedModel:
        """Return the model of an object of which nothing has been sent."""
        if item.number == 0 and self._depths is not None:
            return DecodedModel(self._depths.voxel_size_m, relief_bits=RELIEF_BITS)
        plain, appearance = self._finished is None or guessed, self._config.appearance
        scale, relief_bits = (1, 0) if plain else (appearance.texture_scale, appearance.relief_bits or 0)
        size = item.evidence.voxel_size_m
        return DecodedModel(size, scale, guessed=guessed, relief_bits=relief_bits, passing=item.passing)

    def _model(self, sent: _Sent, frame: int, until_frame: int | None, room: float, last: bool) -> Iterator[Packet]:
        """Yield the model update of an object and the texture of its new cells, or the picture that makes cells."""
        if sent.item.number == 0 and self._depths is not None:
            if not sent.model.cell_count:
                poses = sent.coder.decoded
                sent.model = self._depths.model(self._info.rig.depth, poses[0] if len(poses) else identity())
                yield DepthHeader(frame=frame).packet(self._depths.payload)
            return
        update = self._update(sent, until_frame)
        if update.size < (MIN_LIVE_CELLS if self._config.causal and not last else 1):
            return
        update, payload, decoded = self._affordable(update, sent, room - MEMBER_BYTES)
        if update.empty:
            return
        sent.model.apply(decoded)
        sent.wanted.apply(update)
        yield ModelHeader(object_id=sent.item.number, frame=frame).packet(payload)
        yield from self._relief(sent, frame)
        yield from self._texture(sent, frame)

    def _affordable(self, update: ModelUpdate, sent: _Sent, room: float) -> tuple[ModelUpdate, bytes, ModelUpdate]:
        """Encode as much of an update as there is room for, what lifts most ignorance per bit first; the rest waits."""
        cells, size = sent.model.cells(), sent.model.voxel_size_m

        def encoded() -> tuple[bytes, ModelUpdate]:
            number = 0 if sent.model.guessed else sent.item.number
            weighted, settings = focused(update, self._color, self._config.focus, number, size)
            return encode_update_with_result(weighted, *cells, settings)

        payload, decoded = encoded()
        while len(payload) > room and not update.empty:
            share = FILL * room / len(payload)
            update = best_part(update, sent.item.evidence, sent.wanted, share, sent.item.in_sight)
            payload, decoded = encoded()
        return update, payload, decoded

    def _update(self, sent: _Sent, until_frame: int | None) -> ModelUpdate:
        if self._config.causal:
            return changes(sent.item.evidence, sent.wanted, self._config.threads)
        if sent.final is None:
            surface = self._surface(sent.item)
            sent.final = surface if sent.model.guessed else in_regions(surface)
        return first_sights(sent.final, sent.model, until_frame)

    def _surface(self, item: SceneObject) -> Surface:
        if self._finished is None:
            return read_surface(item.evidence, self._config.threads, smooth=True)
        surface = self._finished.surfaces[item.number]
        if item.number == 0 and self._backdrop is not None:
            return replace(surface, colors=np.zeros_like(surface.colors))
        return surface

    def _worthwhile_backdrop(self, luma_step: float) -> bytes | None:
        """Return the coded picture of the background if there is one, and it is worth its bytes.

        Among qualities, and coloured cells instead, that of the least squared error plus price of the bits is
        taken. A bit that quantises a cell's colour finer saves ``q^2 ln 2 / 6`` at every pixel of the cell: that
        is the price.
        """
        finished = self._finished
        if finished is None or finished.backdrop is None or not can_encode_pictures():
            return None
        price = 8 * luma_step**2 * np.log(2) / 6 * finished.pixels_per_cell / self._weight(0)
        payload, cost = finished.backdrop.best(price)
        return payload if cost < self._cost_of_cells(price) else None

    def _cost_of_cells(self, price: float) -> float:
        """Return what colouring the cells of the background costs, in bytes and in squared error."""
        assert self._finished is not None
        assert self._finished.backdrop is not None
        threads, item = self._config.threads, self._scene.objects[0]
        surface = self._finished.surfaces[0]
        size, decoded = self._size_of(surface)
        if self._finished.depths is not None:
            flat_size = len(self._finished.depths.payload)
        else:
            flat_size, _ = self._size_of(replace(surface, colors=np.zeros_like(surface.colors)))
        model = RenderModel(decoded)
        model.refresh(threads)
        renderer = Renderer(self._info.rig, RenderConfig(supersample=1, threads=threads))
        drawn = renderer.draw({0: model}, {0: item.poses[0]}).color
        return self._finished.backdrop.error(drawn) + price * (size - flat_size)

    def _size_of(self, surface: Surface) -> tuple[int, DecodedModel]:
        """Return the bytes of a surface sent at once, and the model with it."""
        voxel_size_m = self._scene.objects[0].evidence.voxel_size_m
        settings = finer(self._color, self._weight(0))
        return one_shot(surface, voxel_size_m, self._config.appearance.relief_bits or 0, settings)

    def _weight(self, number: int) -> float:
        """Return how much errors count of an object as a whole."""
        return float(np.prod([focus.weight for focus in self._config.focus if focus.number == number]))

    def _relief(self, sent: _Sent, frame: int) -> Iterator[Packet]:
        """Yield where in the cells that were just sent the surface passes."""
        if not sent.model.relief_bits:
            return
        assert sent.final is not None
        crossings = sent.final.crossings_of(sent.model.untold_cells()[0])
        if len(crossings):
            payload = encode_relief(sent.model, crossings)
            yield ReliefHeader(object_id=sent.item.number, frame=frame).packet(payload)

    def _texture(self, sent: _Sent, frame: int) -> Iterator[Packet]:
        """Yield the colours of the texels of cells that were just sent."""
        if self._finished is None or sent.model.texture is None:
            return
        texels = sent.model.bare_texels()
        if not len(texels):
            return
        owners = sent.model.index.locate(texels // sent.model.texture.scale)
        colors = self._finished.colors.texel_colors(sent.item.number, texels, sent.model.color.reshape(-1, 3)[owners])
        payload, decoded = encode_texture(
            sent.model, texels, colors, finer(self._color, self._weight(sent.item.number))
        )
        sent.model.texture.paint(texels, decoded)
        yield TextureHeader(object_id=sent.item.number, frame=frame).packet(payload)

    def _shift_packets(self, first: int, stop: int) -> Iterator[Packet]:
        """Yield the shifts of a group, unless there are none at all."""
        if self._finished is None or all(np.array_equal(shift, identity()) for shift in self._finished.shifts):
            return
        for sensor, frames in self._own_frames(first, stop):
            payload = self._shifts[sensor].encode([self._finished.shifts[frame] for frame in frames])
            yield ShiftHeader(frame=frames[0], count=len(frames), sensor=sensor).packet(payload)

    def _gain_packets(self, first: int, stop: int) -> Iterator[Packet]:
        """Yield the gains from the first frame of a group in which they change to the last."""
        all_gains = np.stack(self._scene.gains) if self._finished is None else self._finished.gains
        for sensor, frames in self._own_frames(first, stop):
            gains, coder = all_gains[frames], self._gains[sensor]
            before = np.concatenate([coder.last[None], gains[:-1]])
            changes = np.flatnonzero((gains != before).any(axis=(1, 2)))
            if len(changes):
                start, end = int(changes[0]), int(changes[-1]) + 1
                payload = coder.encode(gains[start:end])
                yield GainHeader(frame=frames[start], count=end - start, sensor=sensor).packet(payload)

    def _own_frames(self, first: int, stop: int) -> Iterator[tuple[int, list[int]]]:
        """Yield the sensors that took frames of a group, and these frames."""
        for sensor in range(len(self._info.rigs)):
            frames = [frame for frame in range(first, stop) if self._scene.sensors[frame] == sensor]
            if frames:
                yield sensor, frames

    def _moments(self, first: int, stop: int) -> list[int]:
        """Return the frames of a group that begin a moment."""
        return [frame for frame in range(first, stop) if not self._scene.together[frame]]

    def _order_packets(self, first: int, stop: int) -> Iterator[Packet]:
        """Yield the turns of sensors in a group, unless they go on as before."""
        scene = self._scene
        turns = [Turn(scene.sensors[frame], scene.together[frame]) for frame in range(first, stop)]
        if any(self._turns.at(frame) != turn for frame, turn in enumerate(turns, first)):
            cycle = shortest_cycle(turns)
            self._turns.begin(first, cycle)
            yield OrderHeader(frame=first).packet(pack_cycle(cycle))

    def _poses(self, sent: _Sent, first: int, stop: int) -> Iterator[Packet]:
        """Yield a packet for every run of frames in which the object moves."""
        frames, before = self._moments(first, stop), first - sum(self._scene.together[:first])
        script = self._script(sent.item, frames)
        for start, end in _runs(self._moving(sent, script)):
            if sent.next_coded != before + start:
                sent.coder.hold()
            payload = sent.coder.encode(script[start:end])
            sent.given, sent.next_coded = script[end - 1], before + end
            yield PoseHeader(object_id=sent.item.number, frame=frames[start], count=end - start).packet(payload)

    def _script(self, item: SceneObject, frames: Sequence[int]) -> list[Pose]:
        """Return the poses that the stream carries: the background's before the base, others' in the background."""
        if item.number in self._guessed:
            return [identity()] * len(frames)
        poses = [item.poses[frame] for frame in frames]
        if not item.number:
            return poses
        world = [self._scene.objects[0].poses[frame] for frame in frames]
        return [compose(inverse(T_camera_world), pose) for T_camera_world, pose in zip(world, poses, strict=True)]

    def _moving(self, sent: _Sent, script: Sequence[Pose]) -> list[bool]:
        """Tell in which frames an object's pose differs from the one last sent by a quantisation step."""
        steps = self._steps
        moving: list[bool] = []
        last = sent.given
        for pose in script:
            if last is None:
                still = sent.coder.repeats(pose)
            else:
                shift, turn = pose[:3, 3] - last[:3, 3], pose[:3, :3] - last[:3, :3]
                still = 2 * np.abs(shift).max() < steps.translation_m and np.abs(turn).max() < steps.rotation_rad
            moving.append(not still)
            last = last if still else pose
        return moving

    def _clock_packets(self, first: int, stop: int) -> Iterator[Packet]:
        for sensor, frames in self._own_frames(first, stop):
            start, clock = self._start(sensor), self._clocks[sensor]
            taken = self._scene.sensors[:first].count(sensor)
            nominal = [start + nearest_multiple(number, *clock) for number in range(taken, taken + len(frames))]
            off = [self._scene.timestamps[frame] - due for frame, due in zip(frames, nominal, strict=True)]
            if any(off):
                payload = b"".join(map(pack_signed_varint, off))
                yield ClockHeader(frame=frames[0], count=len(frames), sensor=sensor).packet(payload)


def _packed_bytes(packets: Sequence[Packet]) -> int:
    """Return how many bytes packets take in a BATCH."""
    return len(pack_batch(BatchHeader(frame=0, count=1), packets).payload)


def _runs(moving: Sequence[bool]) -> list[tuple[int, int]]:
    """Return the ranges of moving frames; rests of up to two frames do not divide them."""
    runs: list[tuple[int, int]] = []
    for frame, moves in enumerate(moving):
        if not moves:
            continue
        if runs and frame - runs[-1][1] <= MAX_STILL_GAP:
            runs[-1] = (runs[-1][0], frame + 1)
        else:
            runs.append((frame, frame + 1))
    return runs
