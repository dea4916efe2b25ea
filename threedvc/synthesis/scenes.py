# SPDX-License-Identifier: MIT
"""The scenes of ``3dvc synth``.

``paper``
    The set-up of Martins & Moura, sec. 3: one rigid object in 6-DOF motion before a static background, gray;
    the object is nearer than `PAPER_THRESHOLD_M`, the background beyond, in every frame and for every seed.
``objects``
    A fixed camera before the corner of a room; three toys move at three distances and hide each other; the
    one with label 1 stands exactly still in the frames of `OBJECTS_PAUSE`.
``room``
    A hand-held camera in a furnished room; its path repeats after `ROOM_PERIOD` frames.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from threedvc.errors import ConfigError
from threedvc.geometry.camera import Camera, CameraRig
from threedvc.geometry.pose import Pose, make_pose, rotation_from_vector
from threedvc.synthesis import textures, toys
from threedvc.synthesis.motion import harmonics, look_at, phases, phases_with_pause
from threedvc.synthesis.scene import Body, Light, Scene
from threedvc.synthesis.shapes import Part, at, ball, box, rectangle, turned
from threedvc.synthesis.textures import RGB, Texture

__all__ = ["OBJECTS_PAUSE", "PAPER_THRESHOLD_M", "ROOM_PERIOD", "SCENES", "make_scene"]

PAPER_THRESHOLD_M = 1.2
"""Between the toy, some 0.9 m before the camera, and all that stands behind it."""
PAPER_PERIOD = 150
"""Frames of the paper's sequence, 5 s, in which the toy turns once."""
OBJECTS_PERIOD = 240
"""Frames in which the toys go to and fro and turn once: twice the default length."""
OBJECTS_PAUSE = range(45, 75)
"""Frames in which one toy rests, for a second: poses that stay have to cost nothing."""
ROOM_PERIOD = 140
"""Frames of the camera's round, ten fewer than by default: the last ones see the first place again."""
MAX_SEED = 2**31 - 1
"""31 bits, so that a seed plus a few is a positive number of 32 bits."""

FLOOR_RGB: RGB = (172, 122, 74)
"""Of wood; by taste."""


def make_scene(name: str, *, frames: int | None = None, size: tuple[int, int] | None = None, seed: int = 0) -> Scene:
    """Build one of the scenes.

    Parameters
    ----------
    name
        ``paper``, ``objects`` or ``room``.
    frames
        Number of frames, or None for 150, 120, 150. The motion is a function of time, so fewer frames
        are the start of the same sequence, and more repeat it.
    size
        Width and height in pixels, or None for 100x100, 320x240, 320x240.
    seed
        Varies textures, colors and the small motions.

    Raises
    ------
    ConfigError
        If there is no scene of that name, or a number is out of range.
    """
    if name not in SCENES:
        raise ConfigError(f"there is no scene {name!r}; choose one of {', '.join(SCENES)}")
    builder, default_frames, default_size = SCENES[name]
    frames = default_frames if frames is None else frames
    if frames < 1:
        raise ConfigError(f"number of frames {frames} must be at least 1")
    if not 0 <= seed <= MAX_SEED:
        raise ConfigError(f"seed {seed} is not within 0..{MAX_SEED}")
    width, height = size or default_size
    return builder(frames, width, height, seed)


def _paper(frames: int, width: int, height: int, seed: int) -> Scene:
    rng = np.random.default_rng([1995, seed])
    T_world_camera = look_at(np.array([1.86, 1.60, 1.20]), np.array([0.0, 0.05, 1.14]))
    phase = phases(frames, PAPER_PERIOD)
    place = np.array([0.0, 0.01, 0.91]) + harmonics(phase, np.array([[0.10, 0.07, 0.03], [0.03, 0.02, 0.02]]), rng)
    tilt = harmonics(phase, np.array([[0.45, 0.45, 0.15], [0.2, 0.2, 0.1]]), rng)
    script = _before_camera(T_world_camera, place, 2 * np.pi * phase - 0.9, tilt)
    ornament = (
        *_hung(textures.poster(0.42, 0.56, rng), (0.0, 0.62, 1.20), (1, 0, 0)),
        *_hung(textures.checker((188, 60, 56), (236, 230, 220), 0.06, 0.06), (0.66, 0.0, 1.16), (0, 1, 0), (0.5, 0.42)),
        *_hung(textures.poster(0.5, 0.4, rng), (1.15, 0.0, 1.62), (0, 1, 0)),
        Part(
            shape=ball(0.17),
            texture=textures.marble((90, 90, 96), (222, 220, 210), 0.1, seed),
            T_body_part=at(0.3, 0.3, 0.70),
        ),
        _carton((0.5, 0.5, 0.53), at(0.28, 0.28, 0.265), rng),
    )
    walls = (
        textures.wallpaper((146, 158, 134), (196, 98, 74), rng),
        textures.noise((186, 178, 160), (152, 144, 130), 0.25, seed),
    )
    return Scene(
        name="paper",
        rig=_rig(width, height, 1.2 * max(width, height)),
        background=_shell((0.0, 4.0), (0.0, 4.0), 2.6, walls, textures.planks(FLOOR_RGB, rng)) + ornament,
        bodies=(Body(label=1, parts=toys.cow(seed), T_world_body=script),),
        T_world_camera=np.repeat(T_world_camera[None], frames, axis=0),
        camera_moves=False,
        lights=(Light(position=(2.6, 0.9, 2.3), strength=0.62), Light(position=(0.9, 3.0, 1.6), strength=0.14)),
        gray=True,
    )


def _objects(frames: int, width: int, height: int, seed: int) -> Scene:
    rng = np.random.default_rng([2002, seed])
    T_world_camera = look_at(np.array([2.35, 2.15, 1.25]), np.array([0.0, 0.0, 0.98]))
    steady, paused = phases(frames, OBJECTS_PERIOD), phases_with_pause(frames, OBJECTS_PERIOD, OBJECTS_PAUSE)
    bodies = (
        _toy(1, toys.cow(seed), T_world_camera, (-0.02, 0.04, 1.20), 0.28, 0.1, paused, 1, rng),
        _toy(
            2, toys.mug((42, 92, 168), (236, 226, 196)), T_world_camera, (0.0, 0.03, 0.74), 0.20, 3.4, steady, -1, rng
        ),
        _toy(3, toys.truck((198, 52, 44), seed), T_world_camera, (0.0, -0.09, 1.68), 0.36, 1.7, steady, 1, rng),
    )
    furniture = (
        *_hung(textures.poster(0.50, 0.66, rng), (0.0, 1.05, 1.35), (1, 0, 0)),
        *_hung(textures.poster(0.72, 0.5, rng), (0.95, 0.0, 1.50), (0, 1, 0)),
        *_hung(textures.poster(0.44, 0.6, rng), (1.95, 0.0, 1.30), (0, 1, 0)),
        *toys.placed(toys.table(0.8, 0.6, 0.55, textures.cloth((196, 44, 44), rng)), at(0.52, 1.35, 0, turned(z=90))),
        *toys.placed(toys.vase(seed), at(0.45, 1.2, 0.55)),
        *toys.placed(toys.globe(seed), at(0.42, 1.58, 0.55)),
        _carton((0.5, 0.4, 0.6), at(1.3, 0.45, 0.3, turned(z=12)), rng),
        _carton((0.3, 0.3, 0.25), at(1.3, 0.45, 0.725, turned(z=-20)), rng),
        *toys.placed(toys.cone(), at(0.4, 0.4, 0)),
    )
    walls = (
        textures.wallpaper((156, 174, 146), (206, 92, 70), rng),
        textures.bricks((164, 82, 62), (198, 188, 172), rng),
    )
    return Scene(
        name="objects",
        rig=_rig(width, height, _handheld_focal_length(width, height)),
        background=_shell((0.0, 5.0), (0.0, 5.0), 2.7, walls, textures.planks(FLOOR_RGB, rng)) + furniture,
        bodies=bodies,
        T_world_camera=np.repeat(T_world_camera[None], frames, axis=0),
        camera_moves=False,
        lights=(Light(position=(2.9, 1.2, 2.5), strength=0.62), Light(position=(1.0, 3.2, 1.6), strength=0.14)),
    )


def _room(frames: int, width: int, height: int, seed: int) -> Scene:
    rng = np.random.default_rng([2009, seed])
    phase = phases(frames, ROOM_PERIOD)
    turn = 2 * np.pi * phase
    # The high multiples are the tremor of a hand, the low ones its path.
    tremor = harmonics(phase, np.repeat([[0.0], [0.012], [0.006], [0.0], [0.003], [0.002]], 6, axis=1), rng)
    eye = np.stack([0.62 * np.sin(turn), -1.42 + 0.22 * np.cos(turn), 1.42 + 0.09 * np.sin(2 * turn)], axis=1)
    target = np.stack([0.55 * np.sin(turn + 0.7), 0.5 + 0 * turn, 0.86 + 0.10 * np.cos(turn)], axis=1)
    roll = 0.03 * np.sin(turn) + tremor[:, 0]
    path = [look_at(*view) for view in zip(eye + tremor[:, :3], target + tremor[:, 3:], roll, strict=True)]
    walls = (
        textures.wallpaper((160, 172, 150), (198, 92, 74), rng),
        textures.noise((212, 198, 168), (184, 170, 142), 0.3, seed),
        textures.wallpaper((176, 184, 196), (86, 108, 166), rng),
        textures.bricks((166, 86, 64), (200, 190, 176), rng),
    )
    shell = _shell((-2.2, 2.2), (-2.1, 1.9), 2.5, walls, textures.planks(FLOOR_RGB, rng))
    return Scene(
        name="room",
        rig=_rig(width, height, _handheld_focal_length(width, height)),
        background=shell + _furniture(seed, rng) + _table_things(seed, rng),
        bodies=(),
        T_world_camera=np.stack(path),
        camera_moves=True,
        lights=(Light(position=(-0.7, -0.9, 2.35), strength=0.62), Light(position=(1.6, -1.6, 1.7), strength=0.14)),
    )


def _furniture(seed: int, rng: np.random.Generator) -> tuple[Part, ...]:
    """Return what stands on the floor and hangs on the walls of the room."""
    shelf = textures.wood((168, 120, 74), (116, 76, 44), 0.025, seed)
    return (
        *_hung(textures.rug(2.4, 1.8, rng), (0.0, 0.15, 0.0), (0, 0, 1)),
        *_hung(textures.poster(0.6, 0.8, rng), (-0.55, 1.9, 1.62), (0, -1, 0)),
        *_hung(textures.poster(0.8, 0.55, rng), (-2.2, 0.55, 1.55), (1, 0, 0)),
        *_hung(textures.poster(0.7, 0.9, rng), (2.2, 0.7, 1.5), (-1, 0, 0)),
        Part(shape=box(1.1, 0.22, 0.03), texture=shelf, T_body_part=at(0.75, 1.79, 1.30)),
        *toys.placed(toys.books(9, rng), at(0.3, 1.78, 1.315)),
        *toys.placed(toys.vase(seed + 1), at(1.12, 1.77, 1.315)),
        *toys.placed(
            toys.sofa((84, 112, 120), textures.patches((222, 190, 96), (196, 84, 52), 0.05, seed)), at(-0.35, 1.48, 0)
        ),
        *toys.placed(toys.floor_lamp(), at(1.85, 1.55, 0)),
        *toys.placed(toys.stool((176, 52, 60)), at(-1.25, 0.25, 0)),
        *toys.placed(toys.cone(), at(1.35, 1.25, 0, turned(z=25))),
        *toys.placed(toys.ring(0.24, 0.075, (230, 224, 214), (206, 60, 56)), at(-1.66, 0.95, 0)),
        Part(
            shape=ball(0.16),
            texture=textures.stripes((226, 188, 60), (52, 104, 172), 0.16 * np.pi / 4, upright=True),
            T_body_part=at(1.2, 0.1, 0.16, turned(x=35, y=20)),
        ),
        _carton((0.5, 0.42, 0.48), at(1.85, 0.75, 0.24, turned(z=-15)), rng),
    )


def _table_things(seed: int, rng: np.random.Generator) -> tuple[Part, ...]:
    """Return the table in the middle of the room and the things on it."""
    top = 0.72
    return (
        *toys.placed(toys.table(1.4, 0.8, top, textures.cloth((190, 46, 48), rng)), at(0, 0.2, 0)),
        *toys.placed(toys.cow(seed), at(-0.35, 0.22, top - toys.COW_HOOF_Z, turned(z=-50))),
        *toys.placed(
            toys.mug((36, 120, 120), (240, 230, 204)), at(-0.02, -0.02, top - toys.MUG_BOTTOM_Z, turned(z=-40))
        ),
        *toys.placed(toys.truck((204, 70, 40), seed), at(0.28, 0.02, top - toys.TRUCK_WHEEL_Z, turned(z=-155))),
        *toys.placed(toys.globe(seed), at(0.50, 0.36, top)),
        *toys.placed(toys.vase(seed), at(0.10, 0.40, top)),
        _book((0.22, 0.16, 0.035), at(-0.52, -0.06, top + 0.0175, turned(z=25)), rng),
        _book((0.19, 0.14, 0.03), at(-0.53, -0.05, top + 0.05, turned(z=5)), rng),
    )


def _carton(size: tuple[float, float, float], pose: Pose, rng: np.random.Generator) -> Part:
    """Return a printed box whose front is as wide and high as its picture."""
    return Part(shape=box(*size), texture=textures.parcel(size[0], size[2], rng), T_body_part=pose)


def _book(size: tuple[float, float, float], pose: Pose, rng: np.random.Generator) -> Part:
    """Return a lying book with a printed cover."""
    return Part(shape=box(*size), texture=textures.parcel(size[0], size[1], rng), T_body_part=pose)


def _rig(width: int, height: int, focal_length: float) -> CameraRig:
    camera = Camera(
        width=width, height=height, fx=focal_length, fy=focal_length, cx=(width - 1) / 2, cy=(height - 1) / 2
    )
    return CameraRig.registered_to(camera)


def _handheld_focal_length(width: int, height: int) -> float:
    """Return the focal length, in pixels, of a Kinect-like field of view: 525 at 640x480."""
    return 525 / 640 * max(width, height * 4 / 3)


def _facing(normal: tuple[float, float, float]) -> NDArray[np.float64]:
    """Return the rotation of a rectangle that faces along `normal`, its y axis upright (north for level ones)."""
    z = np.array(normal, dtype=np.float64)
    upright = np.array([0.0, 1.0, 0.0]) if abs(z[2]) > 0.5 else np.array([0.0, 0.0, 1.0])
    x = np.cross(upright, z)
    return np.stack([x, np.cross(z, x), z], axis=1)


def _hung(
    texture: Texture,
    center: tuple[float, float, float],
    normal: tuple[float, float, float],
    size_m: tuple[float, float] | None = None,
) -> tuple[Part]:
    """Return a thin sheet in front of a wall; without a size it has that of its picture."""
    width, height = size_m or texture.scale_m
    thickness = 0.012
    middle = np.array(center) + 0.5 * thickness * np.array(normal)
    return (Part(shape=box(width, height, thickness), texture=texture, T_body_part=make_pose(_facing(normal), middle)),)


def _shell(
    x: tuple[float, float], y: tuple[float, float], height: float, walls: tuple[Texture, ...], floor: Texture
) -> tuple[Part, ...]:
    """Return floor, ceiling and four walls; `walls` are for +x, +y, -x, -y normals, repeated if fewer.

    Neighbors overlap, so that no ray slips out between them.
    """
    overlap = 0.2
    mx, my, mz = sum(x) / 2, sum(y) / 2, height / 2
    dx, dy, dz = x[1] - x[0] + overlap, y[1] - y[0] + overlap, height + overlap
    faces: tuple[tuple[tuple[float, float, float], tuple[float, float, float], float, float, Texture], ...] = (
        ((x[0], my, mz), (1, 0, 0), dy, dz, walls[0]),
        ((mx, y[0], mz), (0, 1, 0), dx, dz, walls[1 % len(walls)]),
        ((x[1], my, mz), (-1, 0, 0), dy, dz, walls[2 % len(walls)]),
        ((mx, y[1], mz), (0, -1, 0), dx, dz, walls[3 % len(walls)]),
        ((mx, my, 0.0), (0, 0, 1), dx, dy, floor),
        ((mx, my, height), (0, 0, -1), dx, dy, textures.plain((226, 224, 216), 0.1)),
    )
    return tuple(
        Part(shape=rectangle(width, tall), texture=texture, T_body_part=at(*center, _facing(normal)))
        for center, normal, width, tall, texture in faces
    )


def _toy(
    label: int,
    parts: tuple[Part, ...],
    T_world_camera: Pose,
    center: tuple[float, float, float],
    sweep_m: float,
    start: float,
    phase: NDArray[np.float64],
    spin: int,
    rng: np.random.Generator,
) -> Body:
    """Return a body that sweeps from side to side at its own distance and turns `spin` times per period."""
    place = np.array(center) + harmonics(phase, np.array([[0.02, 0.05, 0.04], [0.01, 0.03, 0.01]]), rng)
    place[:, 0] += sweep_m * np.sin(2 * np.pi * phase + start)
    tilt = harmonics(phase, np.array([[0.30, 0.30, 0.10], [0.10, 0.10, 0.10]]), rng)
    yaw = 2 * np.pi * spin * phase + start
    return Body(label=label, parts=parts, T_world_body=_before_camera(T_world_camera, place, yaw, tilt))


def _before_camera(
    T_world_camera: Pose, place: NDArray[np.float64], yaw: NDArray[np.float64], tilt: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the (frames, 4, 4) script of a body: places in the camera's frame, yaw and tilt in the world's."""
    places = place @ T_world_camera[:3, :3].T + T_world_camera[:3, 3]
    rotations = [
        rotation_from_vector(lean) @ rotation_from_vector(np.array([0.0, 0.0, angle]))
        for lean, angle in zip(tilt, yaw, strict=True)
    ]
    return np.stack([make_pose(rotation, spot) for rotation, spot in zip(rotations, places, strict=True)])


SCENES: dict[str, tuple[Callable[[int, int, int, int], Scene], int, tuple[int, int]]] = {
    "paper": (_paper, 150, (100, 100)),
    "objects": (_objects, 120, (320, 240)),
    "room": (_room, 150, (320, 240)),
}
"""Every scene's builder, default number of frames and default size."""
