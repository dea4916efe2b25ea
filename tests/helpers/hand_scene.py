# SPDX-License-Identifier: MIT
"""A hand that pushes a box and flicks a ball on a table, before a camera at rest or in another hand."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from helpers.streams import ListSequence
from threedvc.frames.frame import Frame
from threedvc.geometry.camera import Camera, CameraRig
from threedvc.geometry.pose import make_pose, rotation_from_vector
from threedvc.synthesis import SyntheticSequence, textures, toys
from threedvc.synthesis.motion import harmonics, look_at
from threedvc.synthesis.scene import Body, Light, Scene
from threedvc.synthesis.shapes import Part, at, ball, box, capsule_between, rectangle, turned

__all__ = ["BALL", "BOX", "HAND", "pushing"]

BOX, BALL, HAND = 1, 2, 10
"""Labels in the masks; all parts of the hand have one."""
TABLE_M, BALL_RADIUS_M = 0.7, 0.06
BOX_M = (0.13, 0.20, 0.12)
SPEEDS = {"enter": (0, 8), "push": (8, 26), "lift": (26, 34), "flick": (34, 42), "leave": (42, 54)}
"""Frames from and to which the hand does what."""


def pushing(
    frames: int = 60, size: tuple[int, int] = (160, 120), *, held: bool = False, limp: bool = False, seed: int = 0
) -> ListSequence:
    """Render the sequence with a Kinect's noise; the hand appears in frame 2 or so and is gone after frame 54."""
    rng = np.random.default_rng([7, seed])
    box_x = 0.05 + 0.24 * np.array([_eased(k, "push") for k in range(frames)])
    rolled = 0.5 * np.array([_rolled(k) for k in range(frames)])
    scene = Scene(
        name="pushing",
        rig=_rig(*size),
        background=_surroundings(seed, rng),
        bodies=(
            Body(label=BOX, parts=_parcel(rng), T_world_body=_slid(box_x, frames)),
            Body(label=BALL, parts=_ball(), T_world_body=_rolling(rolled)),
            *_hand(frames, limp),
        ),
        T_world_camera=_path(frames, held, rng),
        camera_moves=held,
        lights=(Light(position=(1.4, 0.9, 2.4), strength=0.6), Light(position=(-0.6, 1.8, 1.8), strength=0.14)),
    )
    rendered = SyntheticSequence(scene, "kinect", seed)
    info = replace(rendered.info, has_camera_poses=False, has_object_poses=True)
    return ListSequence([_labeled(frame) for frame in rendered], info)


def _labeled(frame: Frame) -> Frame:
    assert frame.mask is not None
    poses = {label: pose for label, pose in frame.T_camera_object.items() if label < HAND}
    return replace(frame, mask=np.minimum(frame.mask, HAND).astype(np.uint8), T_camera_object=poses)


def _eased(frame: int, act: str) -> float:
    start, stop = SPEEDS[act]
    t = float(np.clip((frame - start) / (stop - start), 0, 1))
    return t * t * (3 - 2 * t)


def _rolled(frame: int) -> float:
    """Return how far the ball went of its way: it is pushed, then rolls slower and slower."""
    t = float(np.clip((frame - SPEEDS["flick"][0]) / 30, 0, 1))
    return 1 - (1 - t) ** 2


def _rig(width: int, height: int) -> CameraRig:
    f = 0.95 * width
    return CameraRig.registered_to(
        Camera(width=width, height=height, fx=f, fy=f, cx=(width - 1) / 2, cy=(height - 1) / 2)
    )


def _path(frames: int, held: bool, rng: np.random.Generator) -> NDArray[np.float64]:
    eye, target = np.array([0.25, 1.55, 1.45]), np.array([0.3, 0.25, 0.72])
    if not held:
        return np.repeat(look_at(eye, target)[None], frames, axis=0)
    phase = np.arange(frames) / 120
    sway = harmonics(phase, np.repeat([[0.10], [0.03], [0.01], [0.004]], 6, axis=1), rng)
    return np.stack([look_at(eye + way[:3], target + 0.7 * way[3:]) for way in sway])


def _surroundings(seed: int, rng: np.random.Generator) -> tuple[Part, ...]:
    wall = textures.wallpaper((156, 174, 146), (206, 92, 70), rng)
    cloth = textures.patches((186, 196, 206), (110, 130, 160), 0.05, seed)
    return (
        Part(shape=rectangle(4.0, 3.0), texture=wall, T_body_part=at(0.3, -0.75, 1.2, turned(x=90))),
        Part(shape=rectangle(5.0, 5.0), texture=textures.planks((172, 122, 74), rng), T_body_part=at(0.3, 1.0, 0.0)),
        Part(shape=box(1.6, 1.0, 0.04), texture=cloth, T_body_part=at(0.3, 0.2, TABLE_M - 0.02)),
        *toys.placed(toys.vase(seed), at(-0.2, -0.15, TABLE_M)),
        *toys.placed(toys.globe(seed), at(0.75, -0.15, TABLE_M)),
        *toys.placed(toys.books(5, rng), at(0.2, -0.2, TABLE_M)),
    )


def _parcel(rng: np.random.Generator) -> tuple[Part, ...]:
    return (Part(shape=box(*BOX_M), texture=textures.parcel(BOX_M[0], BOX_M[1], rng)),)


def _ball() -> tuple[Part, ...]:
    texture = textures.stripes((226, 188, 60), (52, 104, 172), BALL_RADIUS_M * np.pi / 4, upright=True)
    return (Part(shape=ball(BALL_RADIUS_M), texture=texture),)


def _slid(x: NDArray[np.float64], frames: int) -> NDArray[np.float64]:
    turns = [rotation_from_vector(np.array([0.0, 0.0, 0.3 + 0.9 * (place - x[0])])) for place in x]
    return np.stack([make_pose(turns[k], np.array([x[k], 0.38, TABLE_M + BOX_M[2] / 2])) for k in range(frames)])


def _rolling(way: NDArray[np.float64]) -> NDArray[np.float64]:
    start = np.array([-0.12, 0.55, TABLE_M + BALL_RADIUS_M])
    along = np.array([1.0, 0.1, 0.0])
    return np.stack(
        [
            make_pose(rotation_from_vector(np.array([-0.1, 1.0, 0.0]) * s / BALL_RADIUS_M), start + s * along)
            for s in way
        ]
    )


def _hand(frames: int, limp: bool) -> Iterator[Body]:
    """Yield forearm, palm and two joints of each finger; they bend as the hand moves, and flap if it is limp."""
    skin = textures.noise((214, 160, 132), (196, 140, 112), 0.02)
    sleeve = textures.noise((70, 84, 120), (56, 66, 100), 0.03)
    wrists = np.stack([_wrist(k) for k in range(frames)])
    bends = np.array([0.25 + 0.5 * np.sin(0.22 * k) ** 2 for k in range(frames)])
    label, flap = HAND, 5.0 if limp else 1.0
    elbow = (-0.12, 0.03, 0.05) if limp else (-0.6, 0.13, 0.25)
    forearm = (capsule_between((0, 0, 0), elbow, 0.045, sleeve),)
    palm = (Part(shape=box(0.10, 0.09, 0.035), texture=skin, T_body_part=at(0.05, 0, 0)),)
    for parts, wave in ((forearm, 0.1 * limp), (palm, 0.15)):
        turns = [
            rotation_from_vector(np.array([0.0, flap * wave * np.sin(0.3 * k), 0.1 * np.sin(0.11 * k)]))
            for k in range(frames)
        ]
        yield Body(
            label=label,
            parts=parts,
            T_world_body=np.stack([make_pose(t, w) for t, w in zip(turns, wrists, strict=True)]),
        )
        label += 1
    for finger in range(5):
        root = np.array([0.10, -0.036 + 0.024 * finger, 0.0]) if finger < 4 else np.array([0.03, 0.055, -0.01])
        spread = 0.06 * (finger - 1.5) if finger < 4 else 0.9
        first = (capsule_between((0, 0, 0), (0.045, 0, 0), 0.0115, skin),)
        second = (capsule_between((0, 0, 0), (0.04, 0, 0), 0.0105, skin),)
        scripts: tuple[list[NDArray[np.float64]], list[NDArray[np.float64]]] = ([], [])
        for k in range(frames):
            bend = bends[k] * (1 + 0.25 * flap * np.sin(0.4 * k + finger))
            knuckle = make_pose(np.eye(3), wrists[k]) @ make_pose(
                rotation_from_vector(np.array([0.0, 0.0, spread])) @ rotation_from_vector(np.array([0.0, bend, 0.0])),
                root,
            )
            joint = knuckle @ make_pose(rotation_from_vector(np.array([0.0, 1.2 * bend, 0.0])), np.array([0.045, 0, 0]))
            scripts[0].append(knuckle)
            scripts[1].append(joint)
        for parts, script in zip((first, second), scripts, strict=True):
            yield Body(label=label, parts=parts, T_world_body=np.stack(script))
            label += 1


def _wrist(frame: int) -> NDArray[np.float64]:
    """Return where the wrist is: it enters from the left, pushes the box along x, then the ball, and leaves."""
    reach = 0.05 - BOX_M[0] / 2 - 0.20
    away, at_box = np.array([-0.85, 0.6, 0.95]), np.array([reach, 0.38, TABLE_M + 0.07])
    after = at_box + np.array([0.24, 0.0, 0.0])
    at_ball = np.array([-0.12 - BALL_RADIUS_M - 0.2, 0.55, TABLE_M + 0.07])
    flicked = at_ball + np.array([0.10, 0.01, 0.02])
    place = away + _eased(frame, "enter") * (at_box - away) + _eased(frame, "push") * (after - at_box)
    place = place + _eased(frame, "lift") * (at_ball - after) + _eased(frame, "flick") * (flicked - at_ball)
    place = place + _eased(frame, "leave") * (away - flicked)
    return np.asarray(place + np.array([0, 0, 0.12 * np.sin(np.pi * _eased(frame, "lift"))]))
