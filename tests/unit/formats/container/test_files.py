# SPDX-License-Identifier: MIT
"""Output files: what stands under which name, after success and after failure."""

from __future__ import annotations

import io
import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from helpers.container_streams import end, packets, small_stream
from threedvc.errors import ConfigError, FormatError, OutputError
from threedvc.formats.container import StreamWriter, open_input, open_output
from threedvc.formats.outputs import locked_folder
from threedvc.stream.packets import Packet

OLDER = small_stream()[:-1]


class FakeStandardStream(io.TextIOWrapper):
    """Standard input or output over memory."""

    def __init__(self, data: bytes = b"", *, terminal: bool = False) -> None:
        super().__init__(io.BytesIO(data))
        self.terminal = terminal

    def isatty(self) -> bool:
        return self.terminal


def write_all(writer: StreamWriter) -> None:
    for packet in [*packets(), end()]:
        writer.write(packet)


def fail_after(path: Path, content: list[Packet], error: BaseException) -> None:
    with open_output(path) as writer:
        for packet in content:
            writer.write(packet)
        raise error


def test_success_leaves_the_file_alone(tmp_path: Path) -> None:
    with open_output(tmp_path / "k.3dvc") as writer:
        write_all(writer)
        assert os.listdir(tmp_path) == ["k.3dvc.part"]
    assert os.listdir(tmp_path) == ["k.3dvc"]
    assert (tmp_path / "k.3dvc").read_bytes() == small_stream()
    with open_input(tmp_path / "k.3dvc") as reader:
        assert list(reader)[:-1] == packets()


def test_batches_are_on_disk_while_writing(tmp_path: Path) -> None:
    with open_output(tmp_path / "k.3dvc") as writer:
        for packet in packets():
            writer.write(packet)
        assert (tmp_path / "k.3dvc.part").stat().st_size == writer.offset
        writer.write(end())


def test_an_older_file_is_replaced_at_the_end_only(tmp_path: Path) -> None:
    path = tmp_path / "k.3dvc"
    path.write_bytes(OLDER)
    with open_output(path) as writer:
        write_all(writer)
        assert path.read_bytes() == OLDER
    assert path.read_bytes() == small_stream()


def test_failure_without_frames_leaves_nothing(tmp_path: Path) -> None:
    path = tmp_path / "k.3dvc"
    path.write_bytes(OLDER)
    with pytest.raises(ConfigError, match="nothing fits") as caught:
        fail_after(path, packets(0), ConfigError("nothing fits"))
    assert not hasattr(caught.value, "__notes__")
    assert os.listdir(tmp_path) == ["k.3dvc"]
    assert path.read_bytes() == OLDER


@pytest.mark.parametrize("error", [ConfigError("stopped"), KeyboardInterrupt()], ids=["error", "interrupt"])
def test_failure_keeps_the_frames(tmp_path: Path, error: BaseException) -> None:
    with pytest.raises(type(error)) as caught:
        fail_after(tmp_path / "k.3dvc", packets(2), error)
    part = tmp_path.resolve() / "k.3dvc.part"
    assert caught.value.__notes__ == [f"kept {part}: 20 frames can be decoded"]
    assert os.listdir(tmp_path) == ["k.3dvc.part"]
    received: list[Packet] = []
    with open_input(part) as reader, pytest.raises(FormatError, match="3 packets with 20 frames could be read"):
        received.extend(reader)
    assert received == packets(2)


def test_a_stream_without_end_does_not_get_the_name(tmp_path: Path) -> None:
    path = tmp_path / "k.3dvc"
    with pytest.raises(OutputError, match="the stream was not brought to its END"), open_output(path) as writer:
        writer.write(packets()[0])
    assert os.listdir(tmp_path) == []


def test_unwritable_places_are_named(tmp_path: Path) -> None:
    missing = tmp_path / "no" / "k.3dvc"
    with pytest.raises(OutputError) as caught, open_output(missing):
        pass
    assert str(caught.value) == f"{missing}: cannot be written (No such file or directory); choose another place"
    with pytest.raises(OutputError) as caught, open_output(tmp_path):
        pass
    assert str(caught.value) == f"{tmp_path}: is a folder; give the name of a file"


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may write everywhere")
def test_unwritable_folder(tmp_path: Path) -> None:
    tmp_path.chmod(0o555)
    with pytest.raises(OutputError, match="Permission denied"), open_output(tmp_path / "k.3dvc"):
        pass


def test_a_target_that_becomes_a_folder(tmp_path: Path) -> None:
    path = tmp_path / "k.3dvc"

    def write_and_disturb() -> None:
        with open_output(path) as writer:
            path.mkdir()
            write_all(writer)

    with pytest.raises(OutputError, match="Is a directory") as caught:
        write_and_disturb()
    assert caught.value.__notes__ == [f"kept {tmp_path.resolve()}/k.3dvc.part: 30 frames can be decoded"]


def test_a_link_keeps_pointing_to_its_target(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    (tmp_path / "link.3dvc").symlink_to(tmp_path / "real" / "k.3dvc")
    with open_output(tmp_path / "link.3dvc") as writer:
        write_all(writer)
    assert (tmp_path / "link.3dvc").is_symlink()
    assert (tmp_path / "real" / "k.3dvc").read_bytes() == small_stream()


def test_a_named_pipe_is_written_directly(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    received: list[bytes] = []
    reading = threading.Thread(target=lambda: received.append(pipe.read_bytes()))
    reading.start()
    with open_output(pipe) as writer:
        write_all(writer)
    reading.join(timeout=10)
    assert received == [small_stream()]
    assert os.listdir(tmp_path) == ["pipe"]


def test_standard_output(monkeypatch: pytest.MonkeyPatch) -> None:
    stdout = FakeStandardStream()
    monkeypatch.setattr(sys, "stdout", stdout)
    with open_output("-") as writer:
        write_all(writer)
    assert stdout.buffer.getvalue() == small_stream()  # type: ignore[attr-defined]


def test_standard_input(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", FakeStandardStream(small_stream()))
    with open_input("-") as reader:
        assert list(reader)[:-1] == packets()
        assert reader.name == "standard input"


def test_terminals_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdout", FakeStandardStream(terminal=True))
    monkeypatch.setattr(sys, "stdin", FakeStandardStream(terminal=True))
    with pytest.raises(ConfigError, match="standard output is a terminal; redirect it"), open_output("-"):
        pass
    with pytest.raises(ConfigError, match="standard input is a terminal; pipe a stream in"), open_input("-"):
        pass


def test_open_streams_are_used_and_left_open(tmp_path: Path) -> None:
    memory = io.BytesIO()
    with open_output(memory) as writer:
        write_all(writer)
        assert writer.name == "stream"
    assert memory.getvalue() == small_stream()
    with open(tmp_path / "k.3dvc", "wb+") as file:
        file.write(memory.getvalue())
        file.seek(0)
        with open_input(file) as reader:
            assert reader.name == str(tmp_path / "k.3dvc")
            assert len(list(reader)) == 5
        assert not file.closed


def test_unreadable_input_is_named(tmp_path: Path) -> None:
    for path, reason in ((tmp_path / "none.3dvc", "No such file or directory"), (tmp_path, "Is a directory")):
        with pytest.raises(FormatError) as caught, open_input(path):
            pass
        assert str(caught.value) == f"{path}: cannot be opened: {reason}"


def test_import_needs_no_compiler(repository: Path) -> None:
    program = "import sys, threedvc.formats.container; print('numba' in sys.modules)"
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, cwd=repository)
    assert result.stdout == "False\n"


def test_what_is_no_stream_is_not_replaced(tmp_path: Path) -> None:
    poses = tmp_path / "poses.txt"
    poses.write_text("0 0 0 0 0 0 0 1\n")
    with pytest.raises(OutputError) as caught, open_output(poses):
        pass
    assert str(caught.value) == (
        f"{poses}: is a file, but no stream that 3dvc wrote; choose another name, or give --force"
    )
    assert poses.read_text() == "0 0 0 0 0 0 0 1\n"
    with open_output(poses, force=True) as writer:
        write_all(writer)
    assert poses.read_bytes() == small_stream()


def test_an_empty_file_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / "k.3dvc"
    path.touch()
    with open_output(path) as writer:
        write_all(writer)
    assert path.read_bytes() == small_stream()


def test_a_kept_part_is_not_written_over(tmp_path: Path) -> None:
    path = tmp_path / "k.3dvc"
    for name in ("k.3dvc.part", "k.3dvc.2.part"):
        with pytest.raises(ConfigError) as caught:
            fail_after(path, packets(), ConfigError("stop"))
        assert f"kept {tmp_path / name}: " in caught.value.__notes__[0]
    with open_output(path) as writer:
        write_all(writer)
        assert (tmp_path / "k.3dvc.3.part").exists()
    assert sorted(os.listdir(tmp_path)) == ["k.3dvc", "k.3dvc.2.part", "k.3dvc.part"]


def test_two_runs_for_one_name(tmp_path: Path) -> None:
    path = tmp_path / "k.3dvc"
    link = tmp_path / "link.3dvc"
    link.symlink_to(path)
    with open_output(path) as writer:
        for other in (path, tmp_path / "." / "k.3dvc", link):
            text = r"is being written by another 3dvc, in .*k\.3dvc\.part; wait for it"
            with pytest.raises(OutputError, match=text), open_output(other):
                pass
        write_all(writer)
    assert path.read_bytes() == small_stream()
    assert link.is_symlink()
    assert sorted(os.listdir(tmp_path)) == ["k.3dvc", "link.3dvc"]


def test_a_folder_that_is_held_does_not_stop_a_file_in_it(tmp_path: Path) -> None:
    with locked_folder(tmp_path), open_output(tmp_path / "k.3dvc") as writer:
        write_all(writer)
    assert (tmp_path / "k.3dvc").read_bytes() == small_stream()
