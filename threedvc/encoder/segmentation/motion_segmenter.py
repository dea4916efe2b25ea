# SPDX-License-Identifier: MIT
"""Division of frames into rigid objects by their motion: no masks and no poses are given.

What some frame saw through and another one saw moved in between (`threedvc.encoder.segmentation.free_space`). Connected
surfaces of such pixels become bodies; each body has a model of its own and is registered in every frame. A pixel that
moves belongs to the body whose model shows its depth; else to one that it is connected with, unless it would have been
in the way of what frames saw, had it moved with that body; else to a new one. Bodies are kept as objects that moved as
one and far enough; the labels of others go back to the background, or to nothing where hardly any frame saw them at
rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from threedvc.arrays import Floats, Labels, Mask
from threedvc.config import EncoderConfig, FusionConfig, Motion
from threedvc.encoder.fusion.evidence_model import EvidenceModel
from threedvc.encoder.fusion.integration import Observation, fuse, observe
from threedvc.encoder.segmentation.downsampling import Reduction
from threedvc.encoder.segmentation.free_space import Memory
from threedvc.encoder.segmentation.moving_body import HUES, LOST_FRAMES, Body
from threedvc.encoder.tracking.frame_resolutions import Downsampled, FrameResolutions, ObjectView
from threedvc.encoder.tracking.model_view import raycast_model
from threedvc.encoder.tracking.tracker import Tracker
from threedvc.frames.frame import Frame, SequenceInfo
from threedvc.frames.sensor_model import SensorModel, chosen_sensor, within
from threedvc.geometry.camera import CameraRig
from threedvc.geometry.pose import Pose, inverse, make_pose, rotation_angle
from threedvc.kernels.encoder.free_space import connect_surfaces
from threedvc.stream.pose_status import PoseStatus

__all__ = [
    "PASSING",
    "TRANSIENT",
    "Divider",
]


NEAR_OFFSETS = (3, 6, 10, 15, 21, 28, 36, 45, 55, 66, 78, 91, 105)
LANDMARK, MAX_LANDMARKS = 4, 16
"""Frames apart of those that all frames ask while the camera rests, and how many there may be before they thin out."""
MAX_KEPT = 800
LEAST_STILL = 0.3
JOINED_FRAMES, NEARBY = 12, 3.0
TOGETHER, TOGETHER_RAD, WAY_APART = 0.01, 0.06, 4.0
"""By how much of their distance and by what angle two bodies may move against each other to be one, if they went so
many times as far."""
IN_THE_WAY = 0.3
"""Share of a body that other frames saw through where it would have been as a part of another: then it is none."""
RECOGNITION_FRAMES, RECOGNITION_STEP = 60, 5
VOTES, MOSTLY = 2, 0.6
JUMP = 0.03
LEAST_PIXELS = 60
LEAST_AREA_M2 = 0.0006
COARSE_GATE, FINE_GATE = 0.03, 0.01
GATE_SIGMAS = 4.0
VIEW_WINDOW = 5
OWN_OFFSETS = (2, 4, 7, 11, 16, 22, 30, 40)
YOUNG_FRAMES = 10
BORN, TRANSIENT = 0.25, 0.6
"""Shares of the frames that tell about a surface that must have seen through it, so that it may be a body, or that it
certainly moves."""
SEEN_TO_PASS, SEEN_TO_PASS_FAR = 0.5, 0.4
FAR_SIZES, FAR_WAY = 2.0, 0.1
"""What went farther than so many times its radius and such a part of its distance needs less evidence."""
LEAST_FRAMES, LEAST_FIT = 10, 0.6
LEAST_WAY_M, LEAST_WAY = 0.02, 0.03
GONE, AGREEMENT = 0.5, 0.7
PASSING = 65535
"""Label of what moves and belongs to no body."""
CELL_PIXELS, ROOM_CELLS = 2.0, 2.0
COARSE_PIXELS = 60_000
FUSION = FusionConfig()


@dataclass(eq=False)
class _Look:
    """A frame under division."""

    frame: Frame
    views: FrameResolutions
    seen: Observation
    moving: Mask
    transient: Floats
    groups: NDArray[np.int32]
    gate: Floats
    labels: Labels


class Divider:
    """Divides frames; `look` at each in order, then `divide` each in order, as soon or as late as wanted.

    Parameters
    ----------
    info
        The sequence.
    config
        Choices.
    """

    def __init__(self, info: SequenceInfo, config: EncoderConfig) -> None:
        self.info, self.config, self.threads = info, config, config.threads
        self.reduction = Reduction(info)
        self.rig = self.reduction.rig
        self._form, self._coarse = (Downsampled(self.rig, n, sparse=False, flat=True) for n in (1, 2))
        self._of_room = self._coarse if self.rig.depth.width * self.rig.depth.height > COARSE_PIXELS else self._form
        self._rays = self.rig.depth.rays()
        self.sensor: SensorModel | None = None
        self.poses: list[Pose | None] = []
        self.bodies: list[Body] = []
        self._known = info.has_camera_poses and config.motion is not Motion.TRACK
        self._room: EvidenceModel | None = None
        self._every = 1 + (info.frame_count or 0) // MAX_KEPT
        self._landmark = self._every * LANDMARK
        while (info.frame_count or 0) > MAX_LANDMARKS * self._landmark:
            self._landmark *= 2

    def limited(self, frame: Frame) -> Frame:
        """Return a frame reduced, without what is too far to be measured."""
        if self.sensor is None:
            self.sensor = chosen_sensor(self.config.sensor, frame.depth)
            self.memory = Memory(self.rig.depth, self.sensor, self.threads)
            self._camera = Tracker(self.sensor, self.threads, recovers=False)
        limit = self.config.max_depth_m or self.sensor.reach_m
        small = self.reduction(frame)
        return replace(small, depth=within(small.depth, limit))

    def look(self, frame: Frame) -> None:
        """Find the camera in the next frame, and remember the frame."""
        small = self.limited(frame)
        pose = self._camera_pose(small)
        self.poses.append(pose)
        if frame.index % self._every == 0:
            self.memory.keep(frame.index, small.depth)

    def _camera_pose(self, frame: Frame) -> Pose | None:
        assert self.sensor is not None
        if self._known:
            return None if frame.T_world_camera is None else inverse(frame.T_world_camera)
        everything = np.ones(frame.depth.shape, dtype=np.bool_)
        views = FrameResolutions(frame, self._of_room, self._of_room)
        if self._room is None:
            self._room, self._still = EvidenceModel(_room_cell(frame.depth, self.rig)), everything
            at = self._camera.start(ObjectView(views, everything), 0, self.rig)
        else:
            at = self._camera.locate([ObjectView(views, self._still)], self._room)
        if not at.usable:
            self._still = everything
            return None
        pose = at.T_camera_object
        before = [frame.index - k for k in NEAR_OFFSETS]
        through, _ = self.memory.sights(frame.depth, everything, pose, before, self.pose_of, sparse=True)
        moving = cv2.morphologyEx((through > 0).astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
        still = cv2.dilate(moving, np.ones((5, 5), np.uint8)) == 0
        fuse(self._room, observe(frame, self.rig, self._rays), still, pose, self.sensor, FUSION, self.threads)
        # What moves will be near there in the next frame; where most seems to, the pose is wrong rather.
        self._still = still if np.count_nonzero(still) > LEAST_STILL * still.size else everything
        return pose

    def pose_of(self, frame: int) -> Pose | None:
        """Return T_camera_world of a frame looked at, or None."""
        return self.poses[frame] if 0 <= frame < len(self.poses) else None

    def _others(self, frame: int) -> list[int]:
        """Return the frames to ask: some near in time, and while the camera rests some of all."""
        near = {frame + sign * k for k in NEAR_OFFSETS for sign in (-1, 1)}
        others = {k - k % self._every for k in near}
        pose = self.pose_of(frame)
        for k in range(0, len(self.poses), self._landmark):
            there = self.pose_of(k)
            if pose is not None and there is not None and np.array_equal(pose, there):
                others.add(k)
        return sorted(k for k in others if 0 <= k < len(self.poses) and k != frame)

    def forget(self, frame: int) -> None:
        """Drop what only frames near in time to `frame` would ask for, all frames up to it being divided."""
        old = frame - NEAR_OFFSETS[-1] - 1
        if old % self._landmark:
            self.memory.forget(old)
        while len(self.poses) > MAX_LANDMARKS * self._landmark:
            for k in range(self._landmark, old, 2 * self._landmark):
                self.memory.forget(k)
            self._landmark *= 2

    def divide(self, frame: Frame) -> Labels:
        """Divide a frame that was looked at; return the bodies' numbers (h, w) at the reduced pixels."""
        small = self.limited(frame)
        look = self._prepared(small)
        if look is None:
            return np.zeros(small.depth.shape, np.uint16)
        active = [body for body in self.bodies if body.active]
        self._follow(look, active)
        self._explain(look, active)
        self._give_birth(look)
        self._complete(look)
        self._recognise(look)
        self._join(look)
        self._fuse(look)
        self._miss(look)
        return np.where(look.labels, look.labels, np.where(self._passing(look), PASSING, 0)).astype(np.uint16)

    def _passing(self, look: _Look) -> Mask:
        """Tell which moving pixels belong to surfaces that hardly any frame saw at rest."""
        groups = look.groups
        sizes = np.maximum(np.bincount(groups.ravel()), 1)
        passing = np.bincount(groups.ravel(), look.transient.ravel()) / sizes > TRANSIENT
        passing[0] = False
        return passing[groups]

    def _miss(self, look: _Look) -> None:
        """Note which bodies are no longer where they were last."""
        index, depth, room = look.frame.index, look.frame.depth, self.pose_of(look.frame.index)
        for body in self.bodies:
            if index in body.found:
                body.gone = False
            elif self.is_object(body) and not body.gone and room is not None:
                at = body.found[body.last].T_camera_object
                there = self.pose_of(body.last)
                if there is None:
                    continue
                view = self._coarse_view(body, room @ inverse(there) @ at)
                known = (view > 0) & (depth > 0)
                empty = known & (depth > view + look.gate + np.float32(FINE_GATE) * depth)
                if np.count_nonzero(empty) > max(LEAST_PIXELS / 2, GONE * np.count_nonzero(known)):
                    body.gone = True

    def _prepared(self, frame: Frame) -> _Look | None:
        pose = self.pose_of(frame.index)
        if pose is None:
            return None
        assert self.sensor is not None
        depth = frame.depth
        others = self._others(frame.index)
        through, on = self.memory.sights(depth, depth > 0, pose, others, self.pose_of, sparse=True)
        square = np.ones((3, 3), np.uint8)
        seen_through = _grown(depth, through).astype(np.uint8)
        core = np.asarray(cv2.dilate(cv2.morphologyEx(seen_through, cv2.MORPH_OPEN, square), square), dtype=np.uint8)
        moving: Mask = (cv2.morphologyEx(seen_through & core, cv2.MORPH_CLOSE, square) > 0) & (depth > 0)
        sigma = self.sensor.sigma_m(depth.astype(np.float64)).astype(np.float32)
        return _Look(
            frame=frame,
            views=FrameResolutions(frame, self._form, self._form),
            seen=observe(frame, self.rig, self._rays),
            moving=moving,
            transient=through / np.maximum(through.astype(np.float32) + on, 1),
            groups=_surfaces(depth, moving),
            gate=np.float32(GATE_SIGMAS) * sigma,
            labels=np.zeros(depth.shape, np.uint16),
        )

    def _follow(self, look: _Look, bodies: Sequence[Body]) -> None:
        """Find bodies that are followed where the frame shows them."""
        index, depth = look.frame.index, look.frame.depth
        gate = look.gate + np.float32(COARSE_GATE) * depth
        views = [(body, self._coarse_view(body, body.predicted(index))) for body in bodies]
        owner = self._nearest(look, views, gate)
        for body in bodies:
            mask = owner == body.number
            for group in _shares(look.groups, owner, body.number):
                mask |= (look.groups == group) & (owner == 0)
            self._locate(body, look, mask)

    def _locate(self, body: Body, look: _Look, mask: Mask) -> None:
        index = look.frame.index
        at = None
        if np.count_nonzero(mask) >= LEAST_PIXELS:
            at = body.tracker.locate([ObjectView(look.views, mask)], body.model, near=not self.is_object(body))
        if at is None or not at.usable:
            body.lost += 1
            patience = LOST_FRAMES if index - body.born >= YOUNG_FRAMES else 1
            body.dead = body.lost > patience and not self.is_object(body)
            return
        body.lost = 0
        body.found[index] = at

    def _view(self, body: Body, pose: Pose) -> Floats:
        return raycast_model(body.model, self._form, pose, self.threads).depth

    def _coarse_view(self, body: Body, pose: Pose) -> Floats:
        """Return what a quarter of the rays show, each for four pixels."""
        depth, size = raycast_model(body.model, self._coarse, pose, self.threads).depth, self.rig.depth
        return depth.repeat(2, axis=0).repeat(2, axis=1)[: size.height, : size.width]

    def _nearest(self, look: _Look, views: Sequence[tuple[Body, Floats]], gate: Floats) -> Labels:
        """Return for each moving pixel the number of the body at whose surface it lies, within a gate (h, w)."""
        depth = look.frame.depth
        least = np.ones(depth.shape, np.float32)
        owner, known = np.zeros(depth.shape, np.uint16), depth > 0
        for body, view in views:
            off = _distance(depth, view) / np.maximum(gate, 1e-6)
            mine = look.moving
            if self.is_object(body):
                # What stands still for long is no longer seen to move.
                mine = mine | (known & (view > 0) & (np.abs(depth - view) < look.gate + FINE_GATE * depth))
            mine = mine & (off < least)
            owner[mine], least[mine] = body.number, off[mine]
        return owner

    def _explain(self, look: _Look, bodies: Sequence[Body]) -> None:
        """Label the pixels of bodies that were found."""
        index, depth = look.frame.index, look.frame.depth
        found = [body for body in bodies if index in body.found]
        gate = look.gate + np.float32(FINE_GATE) * depth
        views = [(body, self._view(body, body.found[index].T_camera_object)) for body in found]
        look.labels = self._nearest(look, views, gate)
        for body in found:
            self._extend(body, look)

    def _extend(self, body: Body, look: _Look) -> None:
        """Let a body have the pixels connected with it that nothing tells against."""
        index = look.frame.index
        free = np.zeros_like(look.moving)
        for group in _shares(look.groups, look.labels, body.number):
            free |= (look.groups == group) & (look.labels == 0)
        explained = int(np.count_nonzero(look.labels == body.number))
        body.fit[index] = explained / max(explained + int(np.count_nonzero(free)), 1)
        if not free.any():
            return
        others = [index - k for k in OWN_OFFSETS]
        pose = body.found[index].T_camera_object
        through, _ = self.memory.sights(look.frame.depth, free, pose, others, body.pose_of, whole=False)
        against = cv2.morphologyEx((through >= VOTES).astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)) > 0
        look.labels[free & ~against] = body.number

    def _give_birth(self, look: _Look) -> None:
        """Make bodies of connected surfaces that move and belong to none."""
        depth = look.frame.depth
        free = look.moving & (look.labels == 0)
        groups = _surfaces(depth, free)
        sizes = np.bincount(groups.ravel())
        area = np.bincount(groups.ravel(), (depth.ravel() / self.rig.depth.fx) ** 2)
        for group in (np.flatnonzero((sizes >= LEAST_PIXELS) & (area >= LEAST_AREA_M2))).tolist():
            if group == 0:
                continue
            mask = groups == group
            if float(look.transient[mask].mean()) < BORN:
                continue
            body = self._returned(look, mask) or self._new(look, mask)
            look.labels[mask] = body.number

    def _complete(self, look: _Look) -> None:
        """Give what is too small to be a body to the one that it is connected with."""
        for number in np.unique(look.labels[look.moving]).tolist():
            for group in _shares(look.groups, look.labels, number) if number else ():
                look.labels[(look.groups == group) & (look.labels == 0)] = number

    def _returned(self, look: _Look, mask: Mask) -> Body | None:
        index, depth = look.frame.index, look.frame.depth
        gate = look.gate + np.float32(FINE_GATE) * depth
        hues = self._hues(look, mask)
        for body in self.bodies:
            if index in body.found or body.same_as is not None or not self.is_object(body):
                continue
            if not body.looks_like(hues):
                continue
            last = body.found[body.last].T_camera_object
            # Where the body is seen as a whole: at its last pose it may be half out of the picture.
            body.tracker.resume(make_pose(last[:3, :3], self._middle(look, mask)))
            at = body.tracker.locate([ObjectView(look.views, mask)], body.model)
            if at.status is not PoseStatus.TRACKED:
                body.tracker.resume(last)
                continue
            view = self._view(body, at.T_camera_object)
            near, shown = _distance(depth, view) < gate, (view > 0) & (depth > view - gate)
            alike = np.count_nonzero(near & mask) > AGREEMENT * np.count_nonzero(mask)
            if alike and np.count_nonzero(shown & near) > AGREEMENT * np.count_nonzero(shown):
                body.lost = 0
                body.found[index] = at
                return body
            body.tracker.resume(last)
        return None

    def _hues(self, look: _Look, mask: Mask) -> NDArray[np.float64]:
        """Count the colours of pixels (h, w); none where the colour camera is another one."""
        color = look.frame.color
        if not self.rig.registered:
            return np.zeros(HUES**3)
        parts = color[mask].astype(np.intp) * HUES // 256
        return np.bincount(parts @ np.array([1, HUES, HUES**2]), minlength=HUES**3).astype(np.float64)

    def _middle(self, look: _Look, mask: Mask) -> NDArray[np.float64]:
        z = look.frame.depth[mask].astype(np.float64)
        return np.median(np.column_stack([self._rays[mask] * z[:, None], z]), axis=0)

    def _recognise(self, look: _Look) -> None:
        """See whether new objects, now that more of them is seen, are ones that were lost."""
        index = look.frame.index
        for body in self.bodies:
            if index not in body.found or index < body.compared_next or not self.is_object(body):
                continue
            if index > body.born + RECOGNITION_FRAMES:
                continue
            body.compared_next = index + RECOGNITION_STEP
            old = self._returned(look, look.labels == body.number)
            if old is not None:
                body.become(old, index)
                look.labels[look.labels == body.number] = old.number

    def _join(self, look: _Look) -> None:
        """Make one body of two that go the same way."""
        index = look.frame.index
        here = [body for body in self.bodies if index in body.found and index >= body.born + JOINED_FRAMES]
        for k, body in enumerate(here):
            for old in here[:k]:
                single = old.same_as is None and body.same_as is None
                if single and self._together(old, body, index) and not self._came_together(old, body, look):
                    body.become(old, index)
                    look.labels[look.labels == body.number] = old.number

    def _together(self, one: Body, other: Body, frame: int) -> bool:
        """Tell whether two bodies moved in the last frames, and not against each other."""
        places, way, room = [], 0.0, self.pose_of(frame)
        here, there = one.pose_of(frame), other.pose_of(frame)
        if here is None or there is None or room is None:
            return False
        for k in range(frame - JOINED_FRAMES, frame):
            first, second, before = one.pose_of(k), other.pose_of(k), self.pose_of(k)
            if first is None or second is None or before is None:
                return False
            places.append(inverse(first) @ second)
            moved = inverse(inverse(before) @ first) @ inverse(room) @ here
            way = max(way, float(np.linalg.norm(moved[:3, 3])))
        apart = inverse(here) @ there
        slack = TOGETHER * here[2, 3]
        near = np.linalg.norm(apart[:3, 3]) < NEARBY * (one.radius + other.radius)
        return (
            bool(near)
            and way > WAY_APART * slack
            and all(
                np.linalg.norm((place - apart)[:3, 3]) < slack and rotation_angle(inverse(place) @ apart) < TOGETHER_RAD
                for place in places
            )
        )

    def _came_together(self, one: Body, other: Body, look: _Look) -> bool:
        """Tell whether one of two bodies would have been in the way of what frames saw, had it moved with the other."""
        index = look.frame.index
        for body, with_other in ((one, other), (other, one)):
            mask = look.labels == body.number
            earlier = sorted(k for k in with_other.found if k < index - JOINED_FRAMES)
            earlier = earlier[:: max(1, len(earlier) // len(NEAR_OFFSETS))]
            pose = with_other.found[index].T_camera_object
            through, _ = self.memory.sights(look.frame.depth, mask, pose, earlier, with_other.pose_of, whole=False)
            if np.count_nonzero(through >= VOTES) > IN_THE_WAY * np.count_nonzero(mask):
                return True
        return False

    def is_object(self, body: Body) -> bool:
        """Tell whether a body moved as one, for long and far enough, through what other frames saw to be empty."""
        if body.proved is not None:
            return True
        frames = [k for k in body.found if body.pose_of(k) is not None]
        shares = sorted(body.passing.values(), reverse=True)
        if min(len(frames), len(shares)) < LEAST_FRAMES or shares[LEAST_FRAMES - 1] <= SEEN_TO_PASS_FAR:
            return False
        if np.mean([body.fit.get(k, 1.0) for k in frames]) < LEAST_FIT:
            return False
        way, distance = self.way(body), float(body.found[frames[0]].T_camera_object[2, 3])
        far = way > max(FAR_SIZES * body.radius, FAR_WAY * distance)
        enough = far or shares[LEAST_FRAMES - 1] > SEEN_TO_PASS
        if enough and way > max(LEAST_WAY_M, LEAST_WAY * distance):
            body.proved = max(frames)
        return body.proved is not None

    def way(self, body: Body) -> float:
        """Return how far in metres the points of a body went from where it was first, on an average."""
        places = []
        for k in sorted(body.found):
            at, room = body.pose_of(k), self.pose_of(k)
            if at is not None and room is not None:
                places.append(inverse(room) @ at)
        moves = [inverse(places[0]) @ place for place in places]
        return max(
            (float(np.hypot(np.linalg.norm(m[:3, 3]), body.radius * rotation_angle(m))) for m in moves), default=0
        )

    def _new(self, look: _Look, mask: Mask) -> Body:
        assert self.sensor is not None
        number, frame = len(self.bodies) + 1, look.frame
        body = Body(
            number, frame.index, _cell(frame.depth, mask, self.rig), Tracker(self.sensor, self.threads, recovers=False)
        )
        body.found[frame.index] = body.tracker.start(ObjectView(look.views, mask), number, self.rig)
        body.radius = float(np.sqrt(np.sum((frame.depth[mask] / self.rig.depth.fx) ** 2) / np.pi))
        self.bodies.append(body)
        return body

    def shown(self, body: Body, frame: Frame) -> Mask | None:
        """Return the pixels (h, w) of a frame that show a body where it was found, or before that where it was first.

        None if it was not there: most of what is not hidden by something must be seen. No pixel if all of it is hidden.
        """
        small, first = self.limited(frame), min(body.found)
        assert self.sensor is not None
        pose = body.pose_of(frame.index)
        if pose is None:
            room, there = self.pose_of(frame.index), self.pose_of(first)
            if room is None or there is None:
                return None
            pose = room @ inverse(there) @ body.found[first].T_camera_object
        view, depth = self._view(body, pose), small.depth
        gate = (GATE_SIGMAS * self.sensor.sigma_m(depth.astype(np.float64)) + FINE_GATE * depth).astype(np.float32)
        known = (view > 0) & (depth > 0)
        on, hidden = known & (np.abs(depth - view) < gate), known & (depth < view - gate)
        open_to_view = np.count_nonzero(known & ~hidden)
        if open_to_view < LEAST_PIXELS:
            return np.zeros(depth.shape, dtype=np.bool_)
        return np.asarray(on, dtype=np.bool_) if np.count_nonzero(on) >= AGREEMENT * open_to_view else None

    def caught(self, body: Body, frame: Frame, free: Mask) -> Mask | None:
        """Find a body with its finished model in a frame before it was first found, among free pixels (h, w)."""
        if np.count_nonzero(free) < LEAST_PIXELS:
            return None
        body.tracker.resume(body.found[min(body.found)].T_camera_object)
        views = FrameResolutions(self.limited(frame), self._form, self._form)
        at = body.tracker.locate([ObjectView(views, free)], body.model)
        if at.status is not PoseStatus.TRACKED:
            return None
        body.found[frame.index] = at
        mask = self.shown(body, frame)
        if mask is None or not np.any(mask):
            del body.found[frame.index]
            return None
        return mask

    def _fuse(self, look: _Look) -> None:
        assert self.sensor is not None
        index = look.frame.index
        for body in self.bodies:
            pose = body.pose_of(index)
            mask = look.labels == body.number
            if pose is not None and mask.any():
                body.passing[index] = float(look.transient[mask].mean())
                body.pixels[index] = int(np.count_nonzero(mask))
                body.hues += self._hues(look, mask)
                fuse(body.model, look.seen, mask, pose, self.sensor, FUSION, self.threads)


def _cell(depth: Floats, mask: Mask, rig: CameraRig, percentile: int = 75) -> float:
    """Return the edge of a cell that covers about two pixels of what is seen."""
    seen = depth[mask & (depth > 0)]
    distance = float(np.percentile(seen, percentile)) if len(seen) else 1.0
    return max(round(CELL_PIXELS * distance / rig.depth.fx, 3), 0.002)


def _room_cell(depth: Floats, rig: CameraRig) -> float:
    """Return a cell that is good enough to find the camera: wider ones, but not where most is much nearer than some."""
    return max(ROOM_CELLS * _cell(depth, depth > 0, rig, 50), _cell(depth, depth > 0, rig))


def _surfaces(depth: Floats, chosen: Mask) -> NDArray[np.int32]:
    groups, stack = np.zeros(depth.shape, np.int32), np.empty(depth.size, np.int32)
    connect_surfaces(depth, chosen, JUMP, groups, stack)
    return groups


def _grown(depth: Floats, through: NDArray[np.uint8]) -> Mask:
    """Return the pixels (h, w) that enough frames saw through, and those of surfaces that are mostly such."""
    certain, likely = through >= VOTES, through > 0
    groups = _surfaces(depth, likely)
    sizes = np.maximum(np.bincount(groups.ravel()), 1)
    mostly = np.bincount(groups.ravel(), certain.ravel()) > MOSTLY * sizes
    return np.asarray(certain | (likely & mostly[groups]), dtype=np.bool_)


def _shares(groups: NDArray[np.int32], owner: Labels, number: int) -> list[int]:
    """Return the surfaces of which a body has more pixels than any other body."""
    mine = np.bincount(groups[owner == number], minlength=groups.max() + 1)
    chosen = []
    for group in np.flatnonzero(mine).tolist():
        owners = np.bincount(owner[groups == group], minlength=number + 1)
        if group and owners[1:].max() == owners[number]:
            chosen.append(group)
    return chosen


def _distance(depth: Floats, view: Floats) -> Floats:
    """Return how far (h, w) depths are from those that a view shows about them; infinite where it shows none."""
    square = np.ones((VIEW_WINDOW, VIEW_WINDOW), np.uint8)
    low = cv2.erode(np.where(view > 0, view, np.float32(np.inf)), square)
    high = cv2.dilate(view, square)
    off = np.maximum(np.maximum(low - depth, depth - high), 0)
    return np.where(high > 0, off, np.float32(np.inf)).astype(np.float32)
