# SPDX-License-Identifier: MIT
"""The decoder: packets in, models and poses out, frame by frame.

Drawing is apart (`threedvc.render.renderer`): a decoder that only follows the models, or checks them, draws
nothing.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

from threedvc.decoder.decoder_state import DecoderState, WantedVideos
from threedvc.decoder.frame_state import FrameState
from threedvc.decoder.packet_handlers import changes_by_frame
from threedvc.decoder.stream_notes import StreamNotes
from threedvc.errors import CorruptStream, LimitExceeded, TruncatedStream
from threedvc.geometry.camera import CameraRig
from threedvc.limits import MAX_COUNT
from threedvc.model.decoded_model import DecodedModel, models_digest
from threedvc.stream.batch import read_batch
from threedvc.stream.header_reader import BATCH_TYPES
from threedvc.stream.headers import BatchHeader, EndHeader, SensorHeader, StreamHeader, check_supported
from threedvc.stream.notes.frame_report import FrameReports, StreamReport
from threedvc.stream.notes.input_options import InputNotes, InputOptions
from threedvc.stream.packets import Packet, PacketType, type_name

__all__ = ["Decoder"]


class Decoder:
    """Applies packets; the same class checks the encoder's own output.

    Parameters
    ----------
    captured_depth, captured_color
        Whether depth and color as captured are wanted; they need AV1, or FFV1.
    threads
        On how many measured depth is decoded.

    Attributes
    ----------
    complete
        Whether END came and its digest was right.
    """

    def __init__(self, *, captured_depth: bool = True, captured_color: bool = True, threads: int = 1) -> None:
        self.complete = False
        self._wanted = WantedVideos(captured_depth, captured_color, threads)
        self._notes = StreamNotes()
        self._state: DecoderState | None = None

    @property
    def header(self) -> StreamHeader | None:
        """The STREAM header, once it came."""
        return None if self._state is None else self._state.header

    @property
    def sensors(self) -> list[SensorHeader]:
        """The SENSOR headers of further sensors."""
        headers = [] if self._state is None else [sensor.header for sensor in self._state.sensors]
        return [header for header in headers if isinstance(header, SensorHeader)]

    @property
    def rigs(self) -> list[CameraRig]:
        """The cameras of every sensor, the first of which STREAM describes; empty before it came."""
        return [] if self._state is None else [sensor.rig for sensor in self._state.sensors]

    @property
    def models(self) -> dict[int, DecodedModel]:
        """Decoded models by object number, as of the frame last yielded."""
        return {} if self._state is None else self._state.models

    @property
    def frame_count(self) -> int:
        """Frames that the stream has conveyed so far."""
        return 0 if self._state is None else self._state.frame_count

    @property
    def unread_codecs(self) -> Mapping[str, int]:
        """Numbers of the codecs of videos that were wanted and cannot be decoded here, by what these show."""
        return {} if self._state is None else self._state.unread_codecs

    @property
    def report(self) -> StreamReport:
        """What the encoder told about its work, of at most `MAX_COUNT` frames; empty if the stream does not say."""
        return self._notes.of(FrameReports).all()

    @property
    def input_options(self) -> Mapping[int, InputOptions]:
        """Options that the recordings were read with, by sensor."""
        return self._notes.of(InputNotes).by_sensor

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
            if packet.type in BATCH_TYPES:
                raise CorruptStream(f"{type_name(packet.type)} stands outside a BATCH")
            if packet.type == PacketType.STREAM:
                self._begin(StreamHeader.from_map(packet.header))
            elif packet.type == PacketType.SENSOR:
                header = SensorHeader.from_map(packet.header)
                self._begun("a SENSOR").add_sensor(header)
            elif packet.type == PacketType.META:
                self._notes.add(packet)
            elif packet.type == PacketType.BATCH:
                yield from self._batch(BatchHeader.from_map(packet.header), packet)
            elif packet.type == PacketType.END:
                yield from self._end(EndHeader.from_map(packet.header))
                return
        raise TruncatedStream(f"the stream ends after {self.frame_count} frames, before its END packet")

    def _begin(self, header: StreamHeader) -> None:
        if self._state is not None:
            raise CorruptStream("the stream has two STREAM packets")
        check_supported(header)
        self._state = DecoderState(header, self._notes, self._wanted)

    def _begun(self, what: str) -> DecoderState:
        """Return the state that STREAM has begun, which something else needs."""
        if self._state is None:
            raise CorruptStream(f"{what} comes before STREAM")
        return self._state

    def _batch(self, header: BatchHeader, packet: Packet) -> Iterator[FrameState]:
        state = self._begun(f"the BATCH of frame {header.frame}")
        state.check_sensors()
        if header.frame < state.frame_count:
            raise CorruptStream(f"the BATCH of frame {header.frame} comes after {state.frame_count} frames")
        yield from _idle_frames(state, header.frame)
        changes = changes_by_frame(header, read_batch(packet), state)
        for frame in range(header.frame, header.stop):
            for change in changes.pop(frame, ()):
                change()
            yield state.next_frame()

    def _end(self, header: EndHeader) -> Iterator[FrameState]:
        state = self._begun("END")
        state.check_sensors()
        if header.frames < state.frame_count:
            raise CorruptStream(f"END tells of {header.frames} frames, the stream conveyed {state.frame_count}")
        yield from _idle_frames(state, header.frames)
        if models_digest(state.models) != header.digest:
            raise CorruptStream("the digest of the decoded models differs from the one in END; the decoder has drifted")
        self.complete = True


def _idle_frames(state: DecoderState, stop: int) -> Iterator[FrameState]:
    """Yield the frames up to one with packets, in which everything stays as it is."""
    if stop - state.frame_count > MAX_COUNT:
        raise LimitExceeded(
            f"the next packet is that of frame {stop} after {state.frame_count} frames, at most {MAX_COUNT} may pass"
            " without one"
        )
    for _ in range(state.frame_count, stop):
        yield state.next_frame()
