# SPDX-License-Identifier: MIT
"""The report on a stream: sizes from real containers, quality from made-up pictures."""

from __future__ import annotations

import io
import json
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from helpers.streams import FRAMES, INFO, FakeStream, ListSequence, gradient_frame, packed_stream, roaming_stream
from threedvc.errors import BadMagic, CorruptStream, FormatError, SequenceError
from threedvc.formats.container import FILE_HEAD_BYTES, Record, StreamReader
from threedvc.formats.evaluation import statistics as module
from threedvc.formats.evaluation.byte_counts import ByteCounts
from threedvc.formats.evaluation.report import StreamStatistics
from threedvc.formats.evaluation.statistics import statistics
from threedvc.geometry.camera import Camera, CameraRig
from threedvc.stream.headers import BatchHeader, DepthHeader, ModelHeader, PoseHeader

KEYS = {
    "name", "complete", "file_bytes", "frames", "duration_s", "kbit_s", "raw_bytes", "ratio", "packets", "objects",
    "object_count", "bytes_per_frame", "entropy_bits", "trajectory", "paper", "sensors",
}  # fmt: skip
QUALITY = {
    "psnr_rgb", "psnr_y", "ssim_y", "depth_rmse_mm", "depth_median_mm", "depth_within_10mm", "depth_within_1pct",
    "depth_p99_mm", "depth_max_mm", "depth_lost", "depth_invented",
}  # fmt: skip


@pytest.fixture(autouse=True)
def fake_decoder(monkeypatch: pytest.MonkeyPatch) -> type[FakeStream]:
    class Stream(FakeStream):
        pass

    monkeypatch.setattr(module, "open_stream", Stream)
    return Stream


def report(reference: ListSequence | None = None) -> StreamStatistics:
    return statistics(io.BytesIO(packed_stream()), reference)


class TestTally:
    def counted(self, data: bytes) -> ByteCounts:
        byte_counts = ByteCounts()
        for _ in byte_counts.counted(StreamReader(io.BytesIO(data), "a.3dvc").records()):
            pass
        return byte_counts

    def test_every_byte_belongs_to_a_packet(self) -> None:
        data = packed_stream()
        byte_counts = self.counted(data)
        assert sum(total.bytes for total in byte_counts.packets.values()) == len(data) - FILE_HEAD_BYTES
        assert {name: total.count for name, total in byte_counts.packets.items()} == {
            "STREAM": 1, "BATCH": 2, "OBJECT": 2, "MODEL": 2, "POSE": 2, "META": 1, "INDEX": 1, "END": 1,
        }  # fmt: skip

    @pytest.mark.parametrize("frames", [1, 3, 4, 10])
    def test_every_byte_belongs_to_a_frame(self, frames: int) -> None:
        data = packed_stream()
        sizes = self.counted(data).frame_bytes(frames, len(data))
        assert len(sizes) == frames
        assert sum(sizes) == len(data)

    def test_no_frames_take_no_bytes(self) -> None:
        assert self.counted(packed_stream()).frame_bytes(0, 1000) == []

    def test_updates_count_where_they_are_drawn(self) -> None:
        byte_counts = ByteCounts()
        byte_counts.add(Record(BatchHeader(frame=4, count=2).packet(), 0, 30))
        byte_counts.add(Record(ModelHeader(frame=5).packet(), 0, 100))
        byte_counts.add(Record(PoseHeader(frame=4, count=2).packet(), 0, 7))
        assert byte_counts.frame_bytes(6, FILE_HEAD_BYTES + 137) == [FILE_HEAD_BYTES, 0, 0, 0, 15 + 3, 15 + 100 + 4]

    def test_a_depth_picture_counts_for_the_background(self) -> None:
        byte_counts = ByteCounts()
        byte_counts.add(Record(packet=DepthHeader(frame=1).packet(b"abc"), offset=0, size=9))
        assert byte_counts.object_bytes == {0: 9}
        assert byte_counts.frame_bytes(3, FILE_HEAD_BYTES + 9) == [FILE_HEAD_BYTES, 9, 0]

    def test_bytes_and_poses_by_object(self) -> None:
        byte_counts = self.counted(packed_stream())
        assert byte_counts.poses == {1: 4}
        of_objects = sum(byte_counts.packets[name].bytes for name in ("OBJECT", "MODEL", "POSE"))
        assert sum(byte_counts.object_bytes.values()) == of_objects


class TestReport:
    def test_json_has_every_key(self, tmp_path: Path) -> None:
        values = json.loads(report(ListSequence()).to_json())
        assert set(values) == KEYS | {"quality", "lossless", "reference_objects"}
        assert set(values["quality"]) == QUALITY
        assert set(values["paper"]) == {"M", "F_m", "S_3dvc", "S_raw", "ratio"}
        assert all(set(total) == {"count", "bytes"} for total in values["packets"].values())
        assert set(json.loads(report().to_json())) == KEYS

    def test_sizes(self) -> None:
        size = len(packed_stream())
        found = report()
        assert (found.frames, found.duration_s, found.file_bytes, found.complete) == (FRAMES, 0.2, size, True)
        assert found.kbit_s == pytest.approx(size * 8 / 0.2 / 1000)
        assert found.raw_bytes == FRAMES * 16 * 12 * 5
        assert found.ratio == pytest.approx(found.raw_bytes / size)

    def test_gray_pictures_have_one_channel(self) -> None:
        assert statistics(io.BytesIO(packed_stream(gray=True))).raw_bytes == FRAMES * 16 * 12 * 3

    def test_objects(self) -> None:
        first, second = report().objects
        assert (first.id, first.cells, first.voxel_size_m, first.poses) == (0, 300, 0.02, 0)
        assert (second.id, second.cells, second.voxel_size_m, second.poses) == (1, 125, 0.01, 4)

    def test_path_of_the_camera(self) -> None:
        found = report()
        assert found.travel is not None
        assert (found.travel.length_m, found.travel.turn_deg) == (0, 0)
        assert json.loads(found.to_json())["trajectory"]["poses"] == [[0, 0, 0, 0, 0, 0, 1]] * FRAMES

    def test_frames_of_note_are_named(self) -> None:
        assert report().status_spans == {"lost": ((3, 3),)}
        trajectory = json.loads(report().to_json())["trajectory"]
        assert (trajectory["spans"], trajectory["lost_frames"]) == ({"lost": [[3, 3]]}, 1)

    def test_stream_without_a_report(self) -> None:
        found = statistics(io.BytesIO(packed_stream(reported=False)))
        assert (found.status, found.status_spans) == ({}, {})
        assert all(frame.status is None and frame.entropy_bits is None for frame in found.per_frame)
        assert json.loads(found.to_json())["trajectory"]["lost_frames"] is None

    def test_paper_counts_what_moves(self) -> None:
        paper = report().paper
        assert (paper.cells, paper.pose_frames, paper.coded_bytes) == (125, 4, 4 * 125 + 24 * 4)
        assert paper.raw_bytes == FRAMES * 16 * 12

    def test_course(self) -> None:
        found = report()
        assert [frame.entropy_bits for frame in found.per_frame] == pytest.approx([400, 300, 250, 200], rel=0.02)
        assert [frame.timestamp_ns for frame in found.per_frame] == [0, 50_000_000, 100_000_000, 150_000_000]
        assert found.status == {"known": 1, "tracked": 2, "lost": 1}
        assert sum(frame.bytes for frame in found.per_frame) == found.file_bytes

    def test_file_and_stream_give_the_same(self, tmp_path: Path) -> None:
        path = tmp_path / "a.3dvc"
        path.write_bytes(packed_stream())
        assert statistics(path).to_json() == statistics(str(path)).to_json() == report().to_json()

    def test_missing_file(self, tmp_path: Path) -> None:
        path = tmp_path / "a.3dvc"
        with pytest.raises(FormatError) as caught:
            statistics(path)
        assert str(caught.value) == f"{path}: cannot be opened: No such file or directory; check the name"

    def test_not_a_stream(self, tmp_path: Path) -> None:
        path = tmp_path / "a.3dvc"
        path.write_bytes(b"GIF89a and more than twelve bytes")
        with pytest.raises(BadMagic, match=r"not a \.3dvc stream"):
            statistics(path)

    @pytest.mark.parametrize("size", [0, 5, 12, 30])
    def test_nothing_readable(self, size: int) -> None:
        with pytest.raises(FormatError):
            statistics(io.BytesIO(packed_stream()[:size]))

    def test_damage_is_an_error(self) -> None:
        data = bytearray(packed_stream())
        data[300] ^= 1
        with pytest.raises(CorruptStream, match="stream: packet 2 at byte"):
            statistics(io.BytesIO(bytes(data)))

    def test_drift_is_an_error(self) -> None:
        with pytest.raises(CorruptStream, match=r"^stream: the digest of the decoded models differs"):
            statistics(io.BytesIO(packed_stream(drifted=True)))

    @pytest.mark.parametrize("cut", [1, 10, 40])
    def test_cut_stream_counts_what_is_there(self, cut: int) -> None:
        data = packed_stream(ended=False)[:-cut]
        found = statistics(io.BytesIO(data))
        assert (found.complete, found.frames, found.file_bytes) == (False, 2, len(data))
        assert found.packets["BATCH"].count == 1
        assert sum(frame.bytes for frame in found.per_frame) == len(data)
        assert [item.cells for item in found.objects] == [300, 125]

    def test_cut_stream_is_compared_as_far_as_it_goes(self) -> None:
        found = statistics(io.BytesIO(packed_stream(ended=False)[:-10]), ListSequence())
        assert found.per_frame[0].entropy_bits is None
        assert found.quality is not None
        assert found.quality["psnr_rgb"] == 99
        assert json.loads(found.to_json())["entropy_bits"] == []


class TestLives:
    AWAY = 5.0

    def lives(self, places_m: Sequence[float]) -> StreamStatistics:
        return statistics(io.BytesIO(roaming_stream(places_m)))

    def test_an_object_that_leaves_and_comes_back(self) -> None:
        found = self.lives([self.AWAY, 0, 0.1, 0.2, self.AWAY, self.AWAY, 0, 0.1, self.AWAY])
        assert found.object_count == 1
        background, cube = found.objects
        assert (background.background, background.travel, background.birth, background.death) == (True, None, 0, None)
        assert (background.spans, background.visible_frames) == (((0, 8),), 9)
        assert (cube.background, cube.guessed, cube.birth, cube.death) == (False, False, 1, 7)
        assert (cube.spans, cube.visible_frames) == (((1, 3), (6, 7)), 5)
        assert [frame.visible_objects for frame in found.per_frame] == [0, 1, 1, 1, 0, 0, 1, 1, 0]

    def test_an_object_that_stays_is_not_dead(self) -> None:
        cube = self.lives([0.0] * 6).objects[1]
        assert (cube.birth, cube.death, cube.spans) == (0, None, ((0, 5),))

    def test_an_object_that_is_back_at_the_end_is_not_dead(self) -> None:
        cube = self.lives([0, self.AWAY, 0]).objects[1]
        assert (cube.birth, cube.death, cube.spans) == (0, None, ((0, 0), (2, 2)))

    def test_an_object_that_never_appears(self) -> None:
        cube = self.lives([self.AWAY] * 3).objects[1]
        assert (cube.birth, cube.death, cube.spans, cube.visible_frames, cube.travel) == (None, None, (), 0, None)

    def test_how_far_it_moved(self) -> None:
        travel = self.lives([0, 0.1, 0.3, 0.2]).objects[1].travel
        assert travel is not None
        assert (travel.length_m, travel.largest_distance_m, travel.turn_deg) == pytest.approx((0.4, 0.3, 0), abs=1e-6)

    def test_one_frame(self) -> None:
        found = self.lives([0.0])
        assert (found.frames, found.objects[1].birth, found.objects[1].death) == (1, 0, None)
        assert found.travel is not None
        json.loads(found.to_json())

    def test_cut_stream(self) -> None:
        whole = roaming_stream([0, self.AWAY], ended=False)
        found = statistics(io.BytesIO(whole[:-3]))
        assert (found.complete, found.frames, found.objects) == (False, 0, [])
        assert (found.travel, found.to_map()["trajectory"]["travel"]) == (None, None)
        assert (statistics(io.BytesIO(whole)).frames, statistics(io.BytesIO(whole)).objects[1].death) == (2, 0)

    def test_json(self) -> None:
        background, cube = json.loads(self.lives([0, 0.1, self.AWAY]).to_json())["objects"]
        assert (background["background"], background["birth"], background["death"]) == (True, 0, None)
        assert (cube["spans"], cube["visible_frames"], cube["birth"], cube["death"]) == ([[0, 1]], 2, 0, 1)
        assert cube["travel"]["largest_distance_m"] == pytest.approx(5)


class TestQuality:
    def test_perfect(self) -> None:
        quality = report(ListSequence()).quality
        assert quality is not None
        assert quality["psnr_rgb"] == quality["psnr_y"] == 99
        assert (quality["depth_rmse_mm"], quality["depth_within_1pct"]) == (0, 1)

    def test_known_errors(self, fake_decoder: type[FakeStream]) -> None:
        fake_decoder.changes = {"brighter": 5, "farther_mm": 12}
        found = report(ListSequence())
        assert found.quality is not None
        assert found.quality["psnr_rgb"] == pytest.approx(20 * math.log10(51))
        assert found.quality["depth_median_mm"] == found.quality["depth_max_mm"] == pytest.approx(12)
        assert found.quality["depth_within_10mm"] == 0
        assert found.quality["depth_within_1pct"] == pytest.approx(8 / 12)
        assert found.per_frame[2].quality["depth_max_mm"] == pytest.approx(12)

    def test_trajectories(self) -> None:
        found = report(ListSequence())
        assert found.camera is not None
        assert found.camera.ate_rmse_mm == pytest.approx(0, abs=1e-9)
        assert found.object_motion[1].frames == FRAMES
        trajectory = json.loads(found.to_json())["trajectory"]
        assert trajectory["status"] == {"known": 1, "tracked": 2, "lost": 1}
        assert trajectory["objects"]["1"]["rpe_rotation_deg"] == pytest.approx(0, abs=1e-5)

    def test_reference_without_poses(self) -> None:
        bare = [replace(frame, T_world_camera=None, T_camera_object={}) for frame in ListSequence().frames]
        found = report(ListSequence(bare))
        assert found.camera is None
        assert (found.reference_objects, found.spurious_objects) == (None, None)
        values = json.loads(found.to_json())
        assert set(values) == KEYS | {"quality", "lossless"}
        assert set(values["trajectory"]) == {"status", "spans", "lost_frames", "travel", "poses"}

    def test_masks_tell_which_objects_were_found(self) -> None:
        frames = ListSequence().frames
        mask = np.full(frames[0].depth.shape, 3, dtype=np.uint8)
        mask[:3] = 0
        poses = [{3: frame.T_camera_object[1]} for frame in frames]
        changed = zip(frames, [mask, None, mask, mask], poses, strict=True)
        found = report(ListSequence([replace(f, mask=m, T_camera_object=T) for f, m, T in changed]))
        assert found.reference_objects is not None
        (thing,) = found.reference_objects
        assert (thing.label, thing.number, thing.frames, thing.iou) == (3, 1, 3, 0.75)
        # The thing goes 5 cm a frame.
        assert (thing.moved_frames, thing.moved_iou) == (2, 0.75)
        assert thing.pose is not None
        assert thing.pose.frames == FRAMES
        assert thing.pose.translation_max_mm == pytest.approx(0, abs=1e-9)
        assert list(found.object_motion) == [1]
        values = json.loads(found.to_json())
        assert values["spurious_objects"] == []
        assert [item["label"] for item in values["reference_objects"]] == [3]

    def test_an_object_where_the_reference_has_none_is_spurious(self) -> None:
        bare = [
            replace(frame, mask=np.zeros(frame.depth.shape, dtype=np.uint8), T_camera_object={})
            for frame in ListSequence().frames
        ]
        values = json.loads(report(ListSequence(bare)).to_json())
        assert values["reference_objects"] == []
        assert values["spurious_objects"] == [{"number": 1, "frames": FRAMES, "spans": [[0, 3]]}]

    def test_nothing_to_measure_is_null(self) -> None:
        empty = [replace(frame, depth=np.zeros_like(frame.depth)) for frame in ListSequence().frames]
        quality = json.loads(report(ListSequence(empty)).to_json())["quality"]
        assert quality["depth_rmse_mm"] is None
        assert quality["depth_invented"] == 1

    def test_progress(self) -> None:
        seen: list[int] = []
        statistics(io.BytesIO(packed_stream()), ListSequence(), on_frame=seen.append)
        assert seen == [0, 1, 2, 3]

    def test_longer_reference_is_paired_by_time(self) -> None:
        longer = [gradient_frame(index) for index in range(FRAMES + 3)]
        shifted = [replace(frame, timestamp_ns=frame.timestamp_ns + 9_000_000) for frame in longer]
        found = report(ListSequence(shifted))
        assert found.quality is not None
        assert found.quality["psnr_rgb"] == 99

    def test_reference_without_the_frames(self) -> None:
        late = [replace(gradient_frame(index), timestamp_ns=10**12 + index) for index in range(FRAMES + 1)]
        with pytest.raises(SequenceError) as caught:
            report(ListSequence(late))
        assert str(caught.value) == (
            "gradient: has 5 frames and none at 0 ns, the time of frame 0 of 4 in the stream;"
            " give the frames that were encoded"
        )

    def test_reference_of_another_size(self) -> None:
        camera = Camera(width=8, height=6, fx=15.0, fy=15.0, cx=3.5, cy=2.5)
        other = ListSequence(info=replace(INFO, rig=CameraRig.registered_to(camera)))
        with pytest.raises(SequenceError) as caught:
            report(other)
        assert str(caught.value) == (
            "gradient: color pictures are 8x6 and those of the stream 16x12; give the frames that were encoded"
        )
