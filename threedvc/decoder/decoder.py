# SPDX-License-Identifier: MIT
"""The decoder: packets in, models and poses out, frame by frame.

Drawing is apart (`threedvc.render.renderer`): a decoder that only follows the models, or checks them, draws
nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from threedvc.coding.depth_cells import spread
from threedvc.coding.depth_picture import decode_depths
from threedvc.coding.filters import decode_filter
from threedvc.coding.light import unpack_light
from threedvc.coding.picture import decode_picture
from threedvc.coding.picture_sequence import decode_sequence
from threedvc.coding.poses import PoseCoder
from threedvc.coding.relief import decode_relief
from threedvc.coding.texture import decode_texture
from threedvc.coding.update import decode_update
from threedvc.decoder.batch_timeline import FrameRun
from threedvc.decoder.frame_state import FrameState, camera_poses
from threedvc.decoder.sensor_state import SensorState
from threedvc.errors import CorruptStream, LimitExceeded, TruncatedStream
from threedvc.geometry.camera import CameraRig
from threedvc.geometry.pose import Pose, compose, identity, inverse
from threedvc.limits import MAX_COUNT, MAX_SEQUENCE_SAMPLES
from threedvc.model.decoded_model import DecodedModel, models_digest
from threedvc.model.post_filter import PostFilter
from threedvc.render.captured_depth import CapturedDepth, depth_levels
from threedvc.render.picture import Backdrop, Light
from threedvc.stream.batch import unpack_batch
from threedvc.stream.color_times import unpack_color_times
from threedvc.stream.frame_report import StreamReport, unpack_report
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
    RunHeader,
    SensorHeader,
    SensorRunHeader,
    ShiftHeader,
    StreamHeader,
    TextureHeader,
    VideoHeader,
    check_supported,
)
from threedvc.stream.input_options import InputOptions, unpack_input_options
from threedvc.stream.packets import Packet, PacketType, type_name
from threedvc.stream.pose_status import PoseStatus
from threedvc.stream.sensor_order import Turns, unpack_cycle
from threedvc.stream.wire import ByteReader

__all__ = ["Decoder"]

IN_BATCHES = frozenset(
    {
        PacketType.OBJECT,
        PacketType.MODEL,
        PacketType.RELIEF,
        PacketType.TEXTURE,
        PacketType.POSE,
        PacketType.SHIFT,
        PacketType.GAIN,
        PacketType.BACKDROP,
        PacketType.DEPTH,
        PacketType.FILTER,
        PacketType.LIGHT,
        PacketType.CLOCK,
        PacketType.ORDER,
        PacketType.VIDEO,
    }
)


def _check_pictures(members: Iterable[Packet]) -> None:
    videos = (VideoHeader.from_map(member.header) for member in members if member.type == PacketType.VIDEO)
    samples = sum(video.count * video.columns * video.rows for video in videos)
    if samples > MAX_SEQUENCE_SAMPLES:
        raise LimitExceeded(f"a BATCH holds videos of {samples} samples, at most {MAX_SEQUENCE_SAMPLES} are accepted")


def _check_pose_count(members: Iterable[Packet]) -> None:
    headers: dict[int, type[RunHeader]] = {
        PacketType.POSE: PoseHeader,
        PacketType.SHIFT: ShiftHeader,
        PacketType.GAIN: GainHeader,
    }
    poses = sum(headers[member.type].from_map(member.header).count for member in members if member.type in headers)
    if poses > MAX_COUNT:
        raise LimitExceeded(f"a BATCH holds {poses} poses, shifts and gains, at most {MAX_COUNT} are accepted")


class Decoder:
    """Applies packets; the same class checks the encoder's own output.

    Parameters
    ----------
    filmed
        Whether depth as filmed is wanted; it needs AVIF.

    Attributes
    ----------
    header
        The STREAM header, once it came.
    sensors
        The SENSOR headers of further sensors.
    models
        Decoded models by object number, as of the frame last yielded.
    frame_count
        Frames that the stream has conveyed so far.
    complete
        Whether END came and its digest was right.
    """

    def __init__(self, *, filmed: bool = True) -> None:
        self._filmed = filmed
        self.header: StreamHeader | None = None
        self.sensors: list[SensorHeader] = []
        self.models: dict[int, DecodedModel] = {}
        self.frame_count = 0
        self.complete = False
        self._entropy_bits: list[float] = []
        self._color_offsets: dict[int, int] = {}
        self.input_options: dict[int, InputOptions] = {}
        self._status: list[PoseStatus] = []
        self._coders: dict[int, PoseCoder] = {}
        self._due: dict[str, int] = {}
        self._scripts: dict[int, Pose] = {}
        self._devices: list[SensorState] = []
        self._turns = Turns()
        self._moments = 0
        self._own_runs: list[FrameRun] = []
        self._moment_run = FrameRun(0, [])
        self._span = 0, 0
        self._lights: dict[int, NDArray[np.float64]] = {}
        self._backdrop: Backdrop | None = None
        self._filters: PostFilter | None = None
        self._hung = False

    @property
    def rigs(self) -> list[CameraRig]:
        """The cameras of every sensor, the first of which STREAM describes; empty before it came."""
        return [device.rig for device in self._devices]

    @property
    def report(self) -> StreamReport:
        """What the encoder told about its work, of at most `MAX_COUNT` frames; empty if the stream does not say."""
        return StreamReport(entropy_bits=tuple(self._entropy_bits), status=tuple(self._status))

    def frames(self, packets: Iterable[Packet]) -> Iterator[FrameState]:
        """Yield the state of every frame, in order; `models` is up to date whenever one is yielded.

        Raises
        ------
        CorruptStream
            If packets contradict each other or the digest in END is not that of the decoded models.
        LimitExceeded
            If more frames pass without a packet, or have poses in one, than a reader accepts.
        TruncatedStream
            If the packets stop before END, after all complete frames were yielded.
        """
        for packet in packets:
            if packet.type == PacketType.STREAM:
                self._begin(StreamHeader.from_map(packet.header))
            elif packet.type == PacketType.SENSOR:
                self._join(SensorHeader.from_map(packet.header))
            elif packet.type == PacketType.BATCH:
                yield from self._batch(packet)
            elif packet.type == PacketType.END:
                yield from self._end(EndHeader.from_map(packet.header))
                return
            elif packet.type == PacketType.META:
                self._tell(packet)
            elif packet.type in IN_BATCHES:
                raise CorruptStream(f"{type_name(packet.type)} stands outside a BATCH")
        raise TruncatedStream(f"the stream ends after {self.frame_count} frames, before its END packet")

    def _begin(self, header: StreamHeader) -> None:
        if self.header is not None:
            raise CorruptStream("the stream has two STREAM packets")
        check_supported(header)
        self.header = header
        self._devices = [SensorState(header, self._steps)]

    @property
    def _steps(self) -> tuple[float, float]:
        assert self.header is not None
        return self.header.translation_step_m, self.header.rotation_step_rad

    def _join(self, header: SensorHeader) -> None:
        if self.header is None:
            raise CorruptStream("a SENSOR comes before STREAM")
        if len(self._devices) == self.header.sensors:
            raise CorruptStream(f"a SENSOR comes after those of all {self.header.sensors} sensors")
        self.sensors.append(header)
        self._devices.append(SensorState(header, self._steps))

    def _check_sensors(self) -> None:
        assert self.header is not None
        if len(self._devices) < self.header.sensors:
            raise CorruptStream(
                f"the stream describes {len(self._devices)} of its {self.header.sensors} sensors before its first frame"
            )

    def _batch(self, packet: Packet) -> Iterator[FrameState]:
        header = BatchHeader.from_map(packet.header)
        if self.header is None:
            raise CorruptStream(f"the BATCH of frame {header.frame} comes before STREAM")
        self._check_sensors()
        if header.frame < self.frame_count:
            raise CorruptStream(f"the BATCH of frame {header.frame} comes after {self.frame_count} frames")
        yield from self._still_frames(header.frame)
        stop = header.frame + header.count
        members = unpack_batch(packet)
        _check_pose_count(members)
        _check_pictures(members)
        self._span = header.frame, stop
        self._take_turns(members)
        todo: dict[int, list[Callable[[], None]]] = {}
        for member in members:
            for frame, action in self._actions(member):
                if not header.frame <= frame < stop:
                    raise self._elsewhere(frame)
                todo.setdefault(frame, []).append(action)
        for frame in range(header.frame, stop):
            for action in todo.get(frame, ()):
                action()
            yield self._state(frame)

    def _elsewhere(self, frame: int) -> CorruptStream:
        first, stop = self._span
        return CorruptStream(f"a packet of frame {frame} stands in the BATCH of frames {first}..{stop - 1}")

    def _take_turns(self, members: Iterable[Packet]) -> None:
        """Find out which sensor takes each frame of a BATCH."""
        first, stop = self._span
        orders = {}
        for member in members:
            if member.type == PacketType.ORDER:
                frame = OrderHeader.from_map(member.header).frame
                if not first <= frame < stop:
                    raise self._elsewhere(frame)
                orders[frame] = unpack_cycle(member.payload, len(self._devices))
        if len(self._devices) == 1 and not orders:
            self._own_runs = [FrameRun(first, range(first, stop))]
            self._moment_run = self._own_runs[0]
            return
        own: list[list[int]] = [[] for _ in self._devices]
        moments = []
        turns = self._turns.copy()
        for frame in range(first, stop):
            if frame in orders:
                turns.begin(frame, orders[frame])
            turn = turns.at(frame)
            own[turn.sensor].append(frame)
            if not turn.together or not frame:
                moments.append(frame)
        self._own_runs = [FrameRun(device.frames, frames) for device, frames in zip(self._devices, own, strict=True)]
        self._moment_run = FrameRun(self._moments, moments)

    def _actions(self, packet: Packet) -> Iterator[tuple[int, Callable[[], None]]]:
        """Yield what a packet does, and before which frame; pose payloads are decoded at once."""
        if packet.type == PacketType.OBJECT:
            self._appear(ObjectHeader.from_map(packet.header))
        elif packet.type == PacketType.MODEL:
            model = ModelHeader.from_map(packet.header)
            yield model.frame, lambda: self._update(model.object_id, packet.payload)
        elif packet.type == PacketType.POSE:
            header = PoseHeader.from_map(packet.header)
            for frame, pose in self._poses(header, packet.payload):
                yield frame, lambda pose=pose: self._move(header.object_id, pose)  # type: ignore[misc]
        elif packet.type == PacketType.RELIEF:
            relief = ReliefHeader.from_map(packet.header)
            yield relief.frame, lambda: self._mould(relief.object_id, packet.payload)
        elif packet.type == PacketType.TEXTURE:
            texture = TextureHeader.from_map(packet.header)
            yield texture.frame, lambda: self._paint(texture.object_id, packet.payload)
        elif packet.type == PacketType.SHIFT:
            shift = ShiftHeader.from_map(packet.header)
            device = self._device("SHIFT", shift)
            for frame, pose in self._decoded_poses(device.shifts, "SHIFT", shift, packet.payload, shift.sensor):
                yield frame, lambda pose=pose: setattr(device, "shift", pose)  # type: ignore[misc]
        elif packet.type == PacketType.GAIN:
            yield from self._expose(GainHeader.from_map(packet.header), packet.payload)
        elif packet.type == PacketType.BACKDROP:
            frame = BackdropHeader.from_map(packet.header).frame
            yield frame, lambda: self._hang(packet.payload)
        elif packet.type == PacketType.DEPTH:
            self._known(0)
            yield DepthHeader.from_map(packet.header).frame, lambda: self._spread(packet.payload)
        elif packet.type == PacketType.FILTER:
            assert self.header is not None
            filters = decode_filter(packet.payload, self.header.grey)
            yield FilterHeader.from_map(packet.header).frame, lambda: self._set_filters(filters)
        elif packet.type == PacketType.VIDEO:
            yield from self._film(VideoHeader.from_map(packet.header), packet.payload)
        elif packet.type == PacketType.LIGHT:
            light = LightHeader.from_map(packet.header)
            self._known(light.object_id)
            factors = unpack_light(packet.payload)
            yield light.frame, lambda: self._shine(light.object_id, factors)
        elif packet.type == PacketType.CLOCK:
            yield from self._clock(ClockHeader.from_map(packet.header), packet.payload)
        elif packet.type == PacketType.ORDER:
            frame, cycle = OrderHeader.from_map(packet.header).frame, unpack_cycle(packet.payload, len(self._devices))
            yield frame, lambda: self._turns.begin(frame, cycle)
        elif packet.type == PacketType.META:
            self._tell(packet)

    def _tell(self, packet: Packet) -> None:
        self._color_offsets.update(unpack_color_times(packet) or {})
        if (given := unpack_input_options(packet)) is not None:
            self.input_options[given[0]] = given[1]
        told = unpack_report(packet)
        if told is not None:
            room = MAX_COUNT - len(self._status)
            self._entropy_bits += told.entropy_bits[:room]
            self._status += told.status[:room]

    def _appear(self, header: ObjectHeader) -> None:
        if header.object_id in self.models:
            raise CorruptStream(f"object {header.object_id} is introduced twice")
        self.models[header.object_id] = DecodedModel(
            header.voxel_size_m,
            1 << header.texture_bits,
            guessed=header.guessed,
            relief_bits=header.relief_bits,
            passing=header.passing,
        )
        self._coders[header.object_id] = PoseCoder(*self._steps)
        self._scripts[header.object_id] = identity()

    def _update(self, number: int, payload: bytes) -> None:
        model = self._known(number)
        model.apply(decode_update(payload, *model.cells()))

    def _mould(self, number: int, payload: bytes) -> None:
        model = self._known(number)
        if not model.relief_bits:
            raise CorruptStream(f"a RELIEF names object {number}, which has none")
        if not len(model.untold_cells()[0]):
            raise CorruptStream(f"a RELIEF of object {number} comes when all its cells have one")
        decode_relief(payload, model)

    def _spread(self, payload: bytes) -> None:
        """Make cells of a depth picture, as seen from where the packets before it have placed the camera."""
        camera = self.rigs[0].depth
        spread(decode_depths(payload, camera.width, camera.height), self._known(0), camera, self._scripts[0])

    def _paint(self, number: int, payload: bytes) -> None:
        model = self._known(number)
        if model.texture is None:
            raise CorruptStream(f"a TEXTURE names object {number}, which has none")
        texels = model.bare_texels()
        if not len(texels):
            raise CorruptStream(f"a TEXTURE of object {number} comes when all its cells have one")
        model.texture.paint(texels, decode_texture(payload, model, texels))

    def _device(self, name: str, header: SensorRunHeader) -> SensorState:
        if header.sensor >= len(self._devices):
            raise CorruptStream(f"a {name} names sensor {header.sensor}, but the stream has {len(self._devices)}")
        return self._devices[header.sensor]

    def _run(self, name: str, header: RunHeader, sensor: int | None = None) -> tuple[bool, Sequence[int]]:
        """Note that frames of a sensor, or moments, were conveyed.

        Returns
        -------
        bool, Sequence
            Whether they follow the last ones of their kind directly, and their frames.
        """
        run = (self._moment_run if sensor is None else self._own_runs[sensor]).of(header)
        key = name if not sensor else f"{name} of sensor {sensor}"
        due = self._due.get(key, 0)
        number = header.frame if run is None else run[0]
        if number < due:
            raise CorruptStream(f"a {name} from frame {header.frame} on follows one up to frame {due - 1}")
        if run is None:
            first, stop = self._span
            raise self._elsewhere(stop if first <= header.frame < stop else header.frame)
        self._due[key] = number + header.count
        return number == due, run[1]

    def _expose(self, header: GainHeader, payload: bytes) -> Iterator[tuple[int, Callable[[], None]]]:
        device = self._device("GAIN", header)
        _, frames = self._run("GAIN", header, header.sensor)
        for frame, gain in zip(frames, device.gains.decode(payload, header.count), strict=True):
            yield frame, lambda gain=gain: setattr(device, "gain", gain)  # type: ignore[misc]

    def _film(self, header: VideoHeader, payload: bytes) -> Iterator[tuple[int, Callable[[], None]]]:
        device = self._device("VIDEO", header)
        _, frames = self._run("VIDEO", header, header.sensor)
        if not self._filmed:
            return
        pictures = decode_sequence(payload, header.count, header.columns, header.rows)
        levels = depth_levels(header.nearest_m, header.ratio)
        for frame, samples in zip(frames, pictures, strict=True):
            filmed = CapturedDepth(samples=samples, levels=levels, complete=header.complete)
            yield frame, lambda filmed=filmed: setattr(device, "filmed", filmed)  # type: ignore[misc]

    def _poses(self, header: PoseHeader, payload: bytes) -> Iterable[tuple[int, Pose]]:
        self._known(header.object_id)
        name = f"POSE of object {header.object_id}"
        return self._decoded_poses(self._coders[header.object_id], name, header, payload)

    def _decoded_poses(
        self, coder: PoseCoder, name: str, header: RunHeader, payload: bytes, sensor: int | None = None
    ) -> Iterable[tuple[int, Pose]]:
        """Decode the poses of a run, with their frames; between runs what they place stands still."""
        follows, frames = self._run(name, header, sensor)
        if not follows:
            coder.hold()
        return zip(frames, coder.decode(payload, header.count), strict=True)

    def _set_filters(self, filters: PostFilter) -> None:
        self._filters = filters

    def _move(self, number: int, pose: Pose) -> None:
        self._scripts[number] = pose

    def _known(self, number: int) -> DecodedModel:
        if number not in self.models:
            raise CorruptStream(f"a packet names object {number}, which was not introduced")
        return self.models[number]

    def _clock(self, header: ClockHeader, payload: bytes) -> Iterator[tuple[int, Callable[[], None]]]:
        device = self._device("CLOCK", header)
        _, frames = self._run("CLOCK", header, header.sensor)
        reader = ByteReader(payload)
        for frame in frames:
            correction = reader.signed_varint()
            yield frame, lambda correction=correction: setattr(device, "correction_ns", correction)  # type: ignore[misc]
        if reader.remaining:
            raise CorruptStream(f"{reader.remaining} bytes follow the corrections of CLOCK")

    def _still_frames(self, stop: int) -> Iterator[FrameState]:
        if stop - self.frame_count > MAX_COUNT:
            raise LimitExceeded(
                f"the next packet is that of frame {stop} after {self.frame_count} frames, at most {MAX_COUNT} may pass"
                " without one"
            )
        for frame in range(self.frame_count, stop):
            yield self._state(frame)

    def _shine(self, number: int, factors: NDArray[np.float64]) -> None:
        self._lights[number] = factors

    def _hang(self, payload: bytes) -> None:
        """Decode a backdrop; it is drawn from where the camera stands once all packets of the frame are applied."""
        assert self.header is not None
        camera = self.rigs[0].color
        picture = decode_picture(payload, camera.width, camera.height, self.header.grey)
        self._backdrop = Backdrop(picture=picture, camera=camera, T_camera_world=identity())
        self._hung = False

    def _state(self, frame: int) -> FrameState:
        turn = self._turns.at(frame)
        device, T_base_world = self._devices[turn.sensor], self._scripts.get(0, identity())
        timestamp, number, together = device.next_time(), device.frames, turn.together and frame > 0
        device.frames += 1
        self._moments += not together
        self.frame_count = frame + 1
        if self._backdrop is not None and not self._hung:
            first = self._devices[0]
            T_color_camera = compose(first.rig.T_color_depth, first.shift)
            self._backdrop = replace(self._backdrop, T_camera_world=compose(T_color_camera, T_base_world))
            self._hung = True
        offset = self._color_offsets.pop(frame, 0)
        return FrameState(
            index=frame,
            timestamp_ns=timestamp,
            color_timestamp_ns=timestamp + offset if offset else None,
            sensor=turn.sensor,
            number=number,
            together=together,
            T_world_camera=inverse(device.rig.at_sensor(T_base_world)),
            T_camera_object={
                number: device.rig.at_sensor(pose) for number, pose in camera_poses(self._scripts).items()
            },
            T_shifted_camera=device.shift,
            gain=device.gain,
            backdrop=self._backdrop,
            lights={number: self._light(number) for number in self._lights},
            filters=self._filters,
            filmed=device.next_filmed(),
        )

    def _light(self, number: int) -> Light:
        """The script of an object holds its pose in the world; that of the background is the world."""
        R = self._scripts[number][:3, :3] if number else np.eye(3)
        return Light(factors=self._lights[number], R_world_object=R)

    def _end(self, header: EndHeader) -> Iterator[FrameState]:
        if self.header is None:
            raise CorruptStream("END comes before STREAM")
        self._check_sensors()
        if header.frames < self.frame_count:
            raise CorruptStream(f"END tells of {header.frames} frames, the stream conveyed {self.frame_count}")
        yield from self._still_frames(header.frames)
        if models_digest(self.models) != header.digest:
            raise CorruptStream("the digest of the decoded models differs from the one in END; the decoder has drifted")
        self.complete = True
