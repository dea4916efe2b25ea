# SPDX-License-Identifier: MIT
"""Write frames as a folder in the plain layout, which `threedvc.formats.sources` reads back exactly.

Pictures are compressed by several threads; each picture's bytes depend on its content alone. The folder is valid
input after every closed sink, also one that closes early because a stream ended: poses and times stand in it for
exactly the frames that were written. ``intrinsics.json`` says which command wrote it (``"written_by"``), by which a
later sink of the same command knows a folder that it may fill anew, and ``"complete": false`` until the sink was closed
without an error. Nothing is made or removed before the first frame comes.
"""

from __future__ import annotations

import os
import re
from collections import deque
from collections.abc import Collection, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import Self

import cv2
import numpy as np
from numpy.typing import NDArray

from threedvc.errors import ConfigError, OutputError, SequenceError, ThreedvcError
from threedvc.formats.outputs import locked_folder
from threedvc.formats.sinks.sidecars import INTRINSICS, SIDECARS, WrittenFrame, intrinsics_text, sidecar_texts
from threedvc.formats.sources.association import PICTURE_SUFFIXES
from threedvc.formats.sources.files.text import read_json
from threedvc.frames.frame import Frame, SequenceInfo
from threedvc.geometry.pose import Pose
from threedvc.parallel import default_threads

__all__ = ["DECODE", "PARTS", "SYNTH", "PlainSink", "sensor_folder"]

PARTS = frozenset({"color", "depth", "labels"})
FOLDERS = {"color": "color", "depth": "depth", "labels": "masks"}
OWN_PICTURE = re.compile(r"\d{6,}\.png(\.part)?")
DECODE, SYNTH = "3dvc decode", "3dvc synth"
"""Commands that write recordings; 0.1.0 called both 3dvc, so that it is not known which of them wrote such a folder."""
DEPTH_LIMIT, SATURATED = 65534, 65535
"""The latter reads as no measurement."""
PENDING_PER_THREAD = 4
"""Pictures that wait to be written: enough that no thread is idle, few enough to fit into memory."""


def sensor_folder(folder: Path, sensor: int) -> Path:
    """Return where the frames of one of several sensors are written."""
    return folder / f"sensor{sensor}"


class PlainSink:
    """A folder in the plain layout, to be filled frame by frame inside a ``with`` block.

    Parameters
    ----------
    folder
        Made if absent. An empty folder or an earlier output is filled anew when the first frame comes; files of other
        names stay untouched.
    info
        Cameras, depth scale, frame rate, and whether color has one channel, of what is written. Where the sensor is
        mounted among others stands there only if `mounted`.
    what
        Which of `PARTS` to write; others are ignored when handed over.
    mounted
        Whether the sensor is one of several, so that ``intrinsics.json`` tells its pose on their mount.
    writer
        The command that writes, which may replace its own earlier outputs.
    force
        Whether any recording may be replaced.
    threads
        Threads that compress pictures; by default one per processor.

    Raises
    ------
    ConfigError
        If `what` is empty or names an unknown part.
    OutputError
        If the folder is a file, or holds a recording that the command did not write; when the first frame comes, if it
        cannot be written or another run writes it.
    """

    def __init__(
        self,
        folder: str | os.PathLike[str],
        info: SequenceInfo,
        *,
        what: Collection[str] = PARTS,
        mounted: bool = False,
        writer: str = DECODE,
        force: bool = False,
        threads: int | None = None,
    ) -> None:
        unknown = sorted(set(what) - PARTS)
        if unknown or not what:
            raise ConfigError(f"--what {','.join(unknown)}: choose from {','.join(sorted(PARTS))}")
        self._folder = Path(folder)
        self._info = info
        self._what, self._mounted = frozenset(what), mounted
        self._threads = threads or default_threads()
        self._written: list[WrittenFrame] = []
        self._pending: deque[Future[None]] = deque()
        self._writer, self._force = writer, force
        self._check_folder()
        self._held = ExitStack()
        self._begun = False
        self._encoders = ThreadPoolExecutor(max_workers=self._threads, thread_name_prefix="threedvc-png")
        self._closed = False

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if error is None:
            self.close()
            return
        # The first error is the one to report.
        with suppress(ThreedvcError):
            self.close(complete=False)

    def write(
        self,
        index: int,
        timestamp_ns: int,
        *,
        color: NDArray[np.uint8] | None = None,
        depth: NDArray[np.float32] | None = None,
        labels: NDArray[np.uint8] | None = None,
        saturated: NDArray[np.bool_] | None = None,
        T_world_camera: Pose | None = None,
        T_camera_object: Mapping[int, Pose] | None = None,
        color_timestamp_ns: int | None = None,
    ) -> None:
        """Write one frame; the arrays may be reused as soon as this returns.

        Parameters
        ----------
        index
            Number of the frame, which names its files; greater than that of the frame before.
        timestamp_ns, color_timestamp_ns
            Times of the depth picture, and of the color picture where that differs.
        color
            (height, width, 3) uint8 RGB.
        depth
            (height, width) meters. 0, NaN and what 16 bits cannot hold at the depth scale become 0, no measurement.
        labels
            (height, width) uint8 object labels in the depth camera.
        saturated
            (height, width) bool, where 65535 is written in place of 0 for no measurement; None: nowhere.
        T_world_camera, T_camera_object
            Poses where known.

        Raises
        ------
        OutputError
            If an earlier picture could not be written.
        """
        if not self._begun:
            self._begin()
        if self._written and index <= self._written[-1].index:
            raise ConfigError(f"frame {index} follows frame {self._written[-1].index}; write frames in order")
        for part, picture in self._pictures(color, depth, labels, saturated):
            path = self._folder / FOLDERS[part] / f"{index:06d}.png"
            self._pending.append(self._encoders.submit(_write_png, path, picture))
        self._written.append(
            WrittenFrame(index, timestamp_ns, color_timestamp_ns, T_world_camera, dict(T_camera_object or {}))
        )
        self._wait(self._threads * PENDING_PER_THREAD)

    def write_frame(self, frame: Frame) -> None:
        """Write a `Frame` with all that it carries; raises as `write` does."""
        self.write(
            frame.index,
            frame.timestamp_ns,
            color=frame.color,
            depth=frame.depth,
            labels=frame.mask,
            saturated=frame.saturated,
            T_world_camera=frame.T_world_camera,
            T_camera_object=frame.T_camera_object,
            color_timestamp_ns=frame.color_timestamp_ns,
        )

    def close(self, *, complete: bool = True) -> None:
        """Wait for all pictures and write poses and times; closing twice does nothing.

        Parameters
        ----------
        complete
            Whether all frames that were to be written have been.

        Raises
        ------
        OutputError
            If something could not be written.
        """
        if self._closed:
            return
        self._closed = True
        with self._held:
            try:
                self._wait(0)
            finally:
                self._encoders.shutdown(cancel_futures=True)
            if self._begun:
                for name, text in sidecar_texts(self._written, self._info.fps).items():
                    _write_bytes(self._folder / name, text.encode())
                self._write_intrinsics(complete=complete)

    def _check_folder(self) -> None:
        """Check that a recording may be written here."""
        if self._folder.exists() and not self._folder.is_dir():
            raise OutputError(f"{self._folder}: is a file; choose another folder")
        if self._holds_recording() and not (self._force or self._made_by() == self._writer):
            maker = self._made_by()
            maker = f"{maker} wrote" if isinstance(maker, str) else f"{self._writer} did not write"
            raise OutputError(f"{self._folder}: holds a recording that {maker}; choose another folder, or give --force")

    def _begin(self) -> None:
        """Claim the folder: make it, mark it as ours, and remove what an earlier sink wrote."""
        with _output_errors(self._folder):
            self._folder.mkdir(parents=True, exist_ok=True)
            self._held.enter_context(locked_folder(self._folder))
        self._check_folder()
        self._begun = True
        self._write_intrinsics(complete=False)
        with _output_errors(self._folder):
            for name in FOLDERS.values():
                _clear_pictures(self._folder / name, every=self._force)
            for name in SIDECARS:
                (self._folder / name).unlink(missing_ok=True)

    def _holds_recording(self) -> bool:
        names = (INTRINSICS, *SIDECARS, *FOLDERS.values())
        return any((self._folder / name).exists() for name in names)

    def _made_by(self) -> object:
        """Return what the recording that is there says of its writer."""
        try:
            return read_json(self._folder / INTRINSICS).get("written_by")
        except SequenceError:
            return None

    def _pictures(
        self,
        color: NDArray[np.uint8] | None,
        depth: NDArray[np.float32] | None,
        labels: NDArray[np.uint8] | None,
        saturated: NDArray[np.bool_] | None,
    ) -> Iterator[tuple[str, cv2.typing.MatLike]]:
        """Yield the parts to write as OpenCV wants them, in memory of their own."""
        if color is not None and "color" in self._what:
            yield "color", color[..., 0].copy() if self._info.gray else cv2.cvtColor(color, cv2.COLOR_RGB2BGR)
        if depth is not None and "depth" in self._what:
            units = _depth_units(depth, self._info.depth_scale)
            if saturated is not None:
                units[saturated & (units == 0)] = SATURATED
            yield "depth", units
        if labels is not None and "labels" in self._what:
            yield "labels", labels.copy()

    def _wait(self, allowed: int) -> None:
        """Wait until at most `allowed` pictures are still to be compressed; raises the error of a failed one."""
        while len(self._pending) > allowed:
            self._pending.popleft().result()

    def _write_intrinsics(self, *, complete: bool) -> None:
        text = intrinsics_text(self._info, mounted=self._mounted, writer=self._writer, complete=complete)
        _write_bytes(self._folder / INTRINSICS, text.encode())


def _depth_units(depth: NDArray[np.float32], depth_scale: float) -> NDArray[np.uint16]:
    units = np.rint(depth * np.float32(depth_scale))
    held = (units >= 0) & (units <= DEPTH_LIMIT)
    return np.where(held, units, 0).astype(np.uint16)


def _clear_pictures(folder: Path, *, every: bool) -> None:
    """Remove the pictures that a sink wrote, or `every` one: any other would be read with those to come."""
    for path in folder.iterdir() if folder.is_dir() else ():
        if OWN_PICTURE.fullmatch(path.name) or (every and path.suffix.lower() in PICTURE_SUFFIXES):
            path.unlink()
    # An empty masks/ would announce masks that are not there.
    with suppress(OSError):
        folder.rmdir()


def _write_png(path: Path, picture: cv2.typing.MatLike) -> None:
    # OpenCV's own settings are its fastest that still compress; naming a level turns on slower filters.
    _, data = cv2.imencode(".png", picture)
    _write_bytes(path, data.tobytes())


def _write_bytes(path: Path, data: bytes) -> None:
    """Write a file so that its name never shows a half-written one."""
    part = path.with_name(f"{path.name}.part")
    with _output_errors(path):
        path.parent.mkdir(exist_ok=True)
        part.write_bytes(data)
        part.replace(path)


@contextmanager
def _output_errors(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise OutputError(
            f"{path}: cannot be written ({error.strerror}); free space or choose another folder"
        ) from None
