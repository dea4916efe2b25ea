# SPDX-License-Identifier: MIT
"""Camera poses in a folder beside the pictures: one text file with a 4x4 camera-to-world matrix for each frame."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from threedvc.errors import SequenceError
from threedvc.formats.sources.association import name_numbers
from threedvc.formats.sources.files.poses import read_known_matrix
from threedvc.geometry.pose import Pose

__all__ = ["find_pose_folder", "read_pose_folder"]

NAMES = ("pose", "poses")


def find_pose_folder(folder: Path) -> Path | None:
    """Return the folder of poses that a recording has, if it has one."""
    return next((folder / name for name in NAMES if any((folder / name).glob("*.txt"))), None)


def read_pose_folder(folder: Path, numbers: Sequence[int]) -> dict[int, Pose | None]:
    """Read the poses of frames with these numbers.

    Parameters
    ----------
    folder
        Holds ``N.txt``, where N is the number of a frame, perhaps padded or after a word. A matrix with infinite
        numbers, as ScanNet has for frames that were lost, is an unknown pose.
    numbers
        Of the frames.

    Returns
    -------
    dict of int to Pose or None
        T_world_camera by number of frame, for those frames that have a file.

    Raises
    ------
    SequenceError
        If a file is no rigid transform, two files are of one frame, or no file is of any frame.
    """
    files: dict[int, Path] = {}
    for path in sorted(folder.glob("*.txt")):
        named = name_numbers(path)
        if not named:
            continue
        other = files.setdefault(named[-1], path)
        if other is not path:
            raise SequenceError(f"{path}: is of frame {named[-1]}, as {other.name} is; keep one of the two")
    poses = {number: read_known_matrix(files[number]) for number in numbers if number in files}
    if not poses:
        raise SequenceError(
            f"{folder}: holds no pose of frame {numbers[0]} or any other; name the files by the frames' numbers, or "
            "remove the folder to track the camera"
        )
    return poses
