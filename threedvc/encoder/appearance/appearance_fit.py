# SPDX-License-Identifier: MIT
"""Fit a finished scene to the pictures that the decoder will draw of it: colours, gains, light, poses.

`align` moves the camera to where the drawn pictures fit colour and depth best, `align_pictures` the colour pictures
alone; when the frames are fused anew at these poses, `finish` fits what else the stream carries.
`threedvc.encoder.appearance.color_field` has the mathematics.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import inf

import numpy as np
from numpy.typing import NDArray

from threedvc.arrays import Floats
from threedvc.coding.gains import NEUTRAL, apply_gain
from threedvc.config import ColorConfig, RenderConfig, with_step
from threedvc.encoder.appearance.background_depth import DepthChoice, best_depths, measured_depths
from threedvc.encoder.appearance.background_image import PictureChoice, background_picture
from threedvc.encoder.appearance.color_field import LUMA, ColorField
from threedvc.encoder.appearance.color_solver import fit_colors, fit_gain, fit_light
from threedvc.encoder.appearance.lighting import epoch_frames
from threedvc.encoder.appearance.photometric_alignment import aligned_pose, aligned_shift
from threedvc.encoder.appearance.samples import FrameSamples, Sampler, joined, shown_shares
from threedvc.encoder.appearance.surface_completion import Guess, guess_surfaces
from threedvc.encoder.fusion.surface_extraction import REGION_SHIFT, Surface, read_surface
from threedvc.encoder.rate.rate_control import DEPTH_SHARE, error_at
from threedvc.encoder.rate.trial_coding import color_settings, one_shot
from threedvc.encoder.reconstruction.depth_consistency import misfit_frames
from threedvc.encoder.reconstruction.scene import Scene
from threedvc.encoder.reconstruction.scene_object import SceneObject
from threedvc.encoder.tracking.model_view import Thinned
from threedvc.encoder.tracking.pose_track import Script
from threedvc.encoder.tracking.registration import Status
from threedvc.errors import FormatError
from threedvc.frames.frame import Frame
from threedvc.frames.sequence import FrameSequence, moments, spread_step
from threedvc.geometry.pose import Pose, identity, interpolated, inverse
from threedvc.metrics.depth_errors import mean_misfit
from threedvc.render.render_model import RenderModel
from threedvc.render.renderer import Renderer

__all__ = ["Finish", "align", "align_pictures", "finish", "trial_error"]

SAMPLES = 2_000_000
TRIAL_SAMPLES = 500_000
TRIAL_STEPS = (40.0, 24.0, 14.0, 8.0)
LEAST_SIGHT = 0.2
"""Share of the sight of the cells around that a cell needs; each of the others costs twice an average one."""
LEAST_SHARE = np.float32(0.02)
MIN_FRAME_SAMPLES, MAX_FRAME_SAMPLES = 5_000, 20_000
COLOR_FITS = 3
LIGHT_FITS = 8
FINAL_FITS = 12
TURNS_RAD = 0.2
WORTHWHILE_GAIN = 0.01
WORTHWHILE_ALIGNMENT = 0.02
"""Share of the squared error that other poses must save: exact ones are not to be moved by the noise of the fit."""
BACKDROP_FRAMES = 80
GUESS_FRAMES = 60
MIN_GUESSED_CELLS = 32
GEOMETRY_SHARE = 0.1
"""What the cells of a background at rest take of a usual stream, once a picture colours them."""
MISFIT_TOLERANCE = 1.005
WRONG, WRONG_TOLERANCE = 0.01, 0.0003
NOWHERE = np.float32(1e6)
MAX_LABEL = 255


@dataclass(frozen=True, kw_only=True, eq=False)
class Finish:
    """What the fit to the drawn pictures found.

    Attributes
    ----------
    surfaces
        Surface of every object with the fitted colours, by number, and that of the guess. The error of a colour counts
        as the frames show the cell.
    colors
        Colours of the texels, and the light on objects.
    gains
        (frames, 3, 2) units of the colour camera's gains, see `threedvc.coding.gains`.
    shifts
        T_shifted_camera of every frame: how the camera moved between depth and colour picture.
    backdrop
        The picture of a background at rest before a camera at rest, or None.
    depths
        The depth picture of such a background, if it takes less than its cells do and is no worse; or None.
    guess
        Number of the object of guessed cells, and their edge in metres; None where little depth is missing.
    pixels_per_cell
        How many pixels of a frame show a coloured cell, on an average over all frames; without those of a
        background that has a backdrop, unless there is nothing else.
    """

    surfaces: dict[int, Surface]
    colors: ColorField
    gains: NDArray[np.int64]
    shifts: list[Pose]
    backdrop: PictureChoice | None
    depths: DepthChoice | None
    guess: tuple[int, float] | None
    pixels_per_cell: float


def align(scene: Scene, frames: FrameSequence, rounds: int) -> Script:
    """Return where every object is in every frame, as fits colour and depth.

    Poses are aligned `rounds` times, each time against colours fitted at the poses before. They stay as they are
    unless the pictures fit better otherwise.
    """
    fit = _Fit(scene, frames, [identity()] * len(frames))
    fit.take_samples()
    fit.fit_colors()
    script, error = {number: list(found) for number, found in fit.script.items()}, fit.log_error()
    for _ in range(rounds):
        fit.take_samples(aligned=True)
        fit.fit_colors()
    return fit.script if fit.log_error() < error + np.log(1 - WORTHWHILE_ALIGNMENT) else script


def align_pictures(scene: Scene, frames: FrameSequence, shifts: Sequence[Pose], rounds: int) -> list[Pose]:
    """Return the shifts of the colour pictures, found in `rounds` from given ones; other poses stay."""
    fit = _Fit(scene, frames, list(shifts))
    fit.only_shifts = True
    fit.take_samples()
    fit.fit_colors()
    for _ in range(rounds):
        fit.take_samples(aligned=True)
        fit.fit_colors()
    return fit.shifts


def finish(scene: Scene, frames: FrameSequence, shifts: Sequence[Pose] | None = None) -> Finish:
    """Fit colours, light and gains at the scene's poses and at shifts that `align_pictures` has found."""
    fit = _Fit(scene, frames, list(shifts) if shifts is not None else [identity()] * len(frames))
    fit.drop_hidden_cells()
    fit.guess_holes()
    fit.take_samples()
    fit.fit_colors(FINAL_FITS)
    gains = fit.steady_gains()
    backdrop = fit.backdrop(gains)
    return Finish(
        surfaces=fit.surfaces(background_apart=backdrop is not None),
        colors=fit.colors,
        gains=gains,
        shifts=fit.shifts,
        backdrop=backdrop,
        depths=fit.depth_picture(),
        guess=(fit.guess[0], fit.guess[1].voxel_size_m) if fit.guess is not None else None,
        pixels_per_cell=fit.pixels_per_cell(backdrop is not None),
    )


def trial_error(scene: Scene, frames: FrameSequence, shifts: Sequence[Pose] | None, room_bytes: float) -> float:
    """Return about how large the error of pictures would be if surfaces took a number of bytes.

    Returns
    -------
    float
        Logarithm of the squared error of colours, plus `DEPTH_SHARE` of that of the depth's `mean_misfit`.
    """
    fit = _Fit(scene, frames, list(shifts) if shifts is not None else [identity()] * len(frames), TRIAL_SAMPLES)
    fit.take_samples()
    fit.fit_colors()
    sizes, errors = zip(*map(fit.coded, TRIAL_STEPS), strict=True)
    return error_at(room_bytes, sizes, errors) + DEPTH_SHARE * float(np.log(fit.depth_misfit() + 1e-4))


class _Fit:
    """The state of a fit: colours, poses and gains, and samples of the frames at these poses."""

    def __init__(self, scene: Scene, frames: FrameSequence, shifts: list[Pose], most_samples: int = SAMPLES) -> None:
        self._scene, self._frames = scene, frames
        self._threads, self._grey = scene.config.threads, scene.info.grey
        self._surfaces = {
            number: read_surface(item.evidence, self._threads, smooth=True) for number, item in scene.objects.items()
        }
        self.guess: tuple[int, Guess] | None = None
        self.colors = self._field()
        self.script: Script = {number: list(item.found) for number, item in scene.objects.items()}
        self.shifts = shifts
        self.only_shifts = False
        pixels = int(np.clip(most_samples // len(frames), MIN_FRAME_SAMPLES, MAX_FRAME_SAMPLES))
        self._every = spread_step(len(frames) * pixels, most_samples, scene.info)
        self._samplers = [Sampler(rig, pixels, self._threads) for rig in scene.info.rigs]
        self._views: dict[int, tuple[Thinned, Renderer]] = {}
        self._gains = np.repeat(NEUTRAL[None], len(frames), axis=0)
        self._lit = [number for number, item in scene.objects.items() if _turns(scene, item)]
        self._kept: list[tuple[int, FrameSamples]] = []

    def _field(self) -> ColorField:
        scene = self._scene
        sizes = {number: item.evidence.voxel_size_m for number, item in scene.objects.items()}
        scales = dict.fromkeys(scene.objects, scene.config.appearance.texture_scale)
        surfaces, guessed = dict(self._surfaces), frozenset[int]()
        if self.guess is not None:
            number, guess = self.guess
            surfaces[number], sizes[number], scales[number] = guess.surface, guess.voxel_size_m, 1
            guessed = frozenset([number])
        return ColorField(surfaces, sizes, scales, self._threads, guessed, scene.config.appearance.relief_bits or 0)

    def drop_hidden_cells(self) -> None:
        """Drop cells that frames show much less of than of others around: behind a surface, or beside it.

        Only frames that show a cell at all speak about it: one that is seen but for a moment is as good as others.
        """
        sizes = {number: item.evidence.voxel_size_m for number, item in self._scene.objects.items()}
        field = ColorField(self._surfaces, sizes, dict.fromkeys(sizes, 1), self._threads)
        regions = np.zeros(len(field.values), dtype=np.int64)
        for number, surface in self._surfaces.items():
            _, member = np.unique(surface.cells >> REGION_SHIFT, axis=0, return_inverse=True)
            regions[field.numbers_of(number, surface.cells)] = regions.max(initial=-1) + 1 + member
        shown, around = np.zeros(len(regions)), np.zeros(len(regions))
        for index in np.flatnonzero(~np.array(self._scene.repeated)).tolist():
            poses, sight = self._poses(index), np.zeros(len(regions))
            thinned, renderer = self._thinned_views(index)
            depth, labels = renderer.cast(thinned.grid, field.models, poses)
            points = np.column_stack([thinned.grid.slopes, np.ones(len(depth))]) * depth[:, None].astype(np.float64)
            for number, pose in poses.items():
                here, T = (labels == number) & (depth > 0), inverse(pose)
                numbers, weights = field.corners(number, points[here] @ T[:3, :3].T + T[:3, 3])
                sight += np.bincount(numbers.ravel(), weights.ravel(), len(sight))
            seen = sight > 0
            means = np.bincount(regions, sight) / np.maximum(np.bincount(regions, seen), 1)
            shown[seen] += sight[seen]
            around[seen] += means[regions[seen]]
        for number, surface in self._surfaces.items():
            mine = field.numbers_of(number, surface.cells)
            self._surfaces[number] = surface.part(shown[mine] > LEAST_SIGHT * around[mine])
        self.colors = self._field()

    def guess_holes(self) -> None:
        """Guess surfaces where the colour pictures of a moving camera show something and the model has nothing."""
        scene = self._scene
        free = [number for number in range(1, MAX_LABEL + 1) if number not in scene.objects]
        if scene.at_rest(0) or not free or not self._surfaces[0].cells.size:
            return
        chosen = range(0, len(self._frames), spread_step(len(self._frames), GUESS_FRAMES, scene.info))
        views = (
            (index, scene.sensors[index], poses, self.shifts[index])
            for index in chosen
            if 0 in (poses := self._poses(index))
        )
        guess = guess_surfaces(scene.info.rigs, views, self.colors.models, scene.distance_m, self._threads)
        if len(guess.surface.cells) >= MIN_GUESSED_CELLS:
            self.guess = free[-1], guess
            self.colors = self._field()

    def take_samples(self, *, aligned: bool = False) -> None:
        """Sample all frames, if wanted after aligning what may move in them with the colours so far."""
        self._kept = []
        for moment in moments(self._seen_frames(), self._scene.info):
            fresh = []
            for frame in moment:
                if self._scene.repeated[frame.index]:
                    self._hold(frame.index)
                elif not self._lost(frame.index):
                    fresh.append(frame)
            samples = self._aligned(fresh) if aligned else list(map(self._sample, fresh))
            for sample in samples:
                self._gains[sample.frame] = fit_gain(sample, sample.shown(self.colors), self._grey)
                if sample.frame % self._every == 0:
                    self._kept.append((sample.frame, replace(sample, points=sample.points[:0])))

    def fit_colors(self, fits: int | None = None) -> None:
        """Fit colours, light and gains to the samples, in turn, `fits` times or as often as does for a start."""
        if fits is None:
            fits = LIGHT_FITS if self._lit else COLOR_FITS
        for fit in range(fits if self._kept else 0):
            fit_colors(self.colors, joined(self.colors, self._samples()), self._threads)
            for number in self._lit:
                # Until colours are about right, a light that changes would make up for them.
                epoch = len(self._frames) if 2 * fit < fits else epoch_frames(len(self._frames))
                fit_light(self.colors, number, self._samples(), epoch)
            if fit < fits - 1:
                for index, sample in self._kept:
                    self._gains[index] = fit_gain(sample, sample.shown(self.colors), self._grey)

    def log_error(self) -> float:
        """Return the logarithm of the squared error of the samples, on an average over the frames."""
        errors = [_error(sample, sample.shown(self.colors), gain) for sample, gain in self._samples()]
        return float(np.mean(np.log(np.array(errors) + 1))) if errors else 0.0

    def coded(self, luma_step: float) -> tuple[int, float]:
        """Return how many bytes the surfaces take with colours of a luma step, and `log_error` with these."""
        settings = color_settings(with_step(luma_step), self._grey)
        fitted, total = self.colors.values.copy(), 0
        for number, surface in self.surfaces().items():
            model = self.colors.models[number].model
            size, decoded = one_shot(surface, model.voxel_size_m, model.relief_bits, settings)
            self.colors.recolor(number, *decoded.cells())
            total += size
        error = self.log_error()
        self.colors.values = fitted
        return total, error

    def depth_misfit(self) -> float:
        """Return the `mean_misfit` of what is drawn."""

        def pictures(index: int) -> tuple[Floats, Floats]:
            thinned, renderer = self._thinned_views(index)
            depth, _ = renderer.cast(thinned.grid, self.colors.models, self._poses(index))
            return depth, thinned.thin(self._scene.limited(self._frames[index]).depth).reshape(-1)

        return mean_misfit(map(pictures, misfit_frames(self._frames)))

    def _thinned_views(self, frame: int) -> tuple[Thinned, Renderer]:
        """Return rays of the depth camera that took a frame, and what casts them."""
        sensor = self._scene.sensors[frame]
        if sensor not in self._views:
            rig = self._scene.info.rigs[sensor]
            self._views[sensor] = Thinned(rig), Renderer(rig, RenderConfig(threads=self._threads))
        return self._views[sensor]

    def surfaces(self, *, background_apart: bool = False) -> dict[int, Surface]:
        """Return the surfaces with the colours so far, and how much these count, on an average 1.

        The background can have an average of its own, as is right where its colours may not be sent.
        """
        surfaces, colors = dict(self._surfaces), self.colors
        if self.guess is not None:
            surfaces[self.guess[0]] = self.guess[1].surface
        seen = shown_shares(colors, (sample for _, sample in self._kept))
        numbers = {
            number: None if colors.textured(number) else colors.numbers_of(number, surface.cells)
            for number, surface in surfaces.items()
        }
        groups = [[0], [number for number in numbers if number]] if background_apart else [list(numbers)]
        importance: dict[int, Floats] = {}
        for group in groups:
            cells = {number: mine for number in group if (mine := numbers.get(number)) is not None and len(mine)}
            mean = float(seen[np.concatenate(list(cells.values()))].mean()) if cells else 0.0
            if mean:
                importance |= {number: np.maximum(seen[mine] / mean, LEAST_SHARE) for number, mine in cells.items()}
        return {
            number: replace(surface, colors=colors.cell_colors(number)[1], importance=importance.get(number))
            for number, surface in surfaces.items()
        }

    def steady_gains(self) -> NDArray[np.int64]:
        """Return the gains of all frames; one that is hardly better than the one before is not worth its bits."""
        gains = np.repeat(NEUTRAL[None], len(self._frames), axis=0)
        kept, last_of = dict(self._kept), dict[int, NDArray[np.int64]]()
        for index in range(len(self._frames)):
            sensor = self._scene.sensors[index]
            last = gains[index] = last_of.get(sensor, NEUTRAL)
            if not self._poses(index) or self._scene.repeated[index] or self._lost(index):
                continue
            sample = kept.get(index) or self._sample(self._scene.limited(self._frames[index]))
            shown = sample.shown(self.colors)
            found = fit_gain(sample, shown, self._grey)
            errors = [_error(sample, shown, units) for units in (last, found)]
            if errors[1] < (1 - WORTHWHILE_GAIN) * errors[0]:
                gains[index] = last_of[sensor] = found
        return gains

    def backdrop(self, gains: NDArray[np.int64]) -> PictureChoice | None:
        """Return the picture of the background if it and the camera, the only one, are at rest."""
        scene = self._scene
        if scene.info.sensors or not scene.at_rest(0):
            return None
        chosen = range(0, len(self._frames), -(-len(self._frames) // BACKDROP_FRAMES))
        seen = ((scene.limited(self._frames[index]), self._poses(index), *apply_gain(gains[index])) for index in chosen)
        return PictureChoice(background_picture(scene.info.rig, seen, self.colors, self._threads), self._grey)

    def depth_picture(self) -> DepthChoice | None:
        """Return the depth picture of the background if it and the only camera are at rest, and if it is worth it.

        It must take fewer bytes than the background's cells and meet the measurements no worse. Bytes are weighed
        as the share that they have of a usual stream.
        """
        scene = self._scene
        if scene.info.sensors or not scene.at_rest(0) or not len(self._surfaces[0].cells):
            return None
        chosen = range(0, len(self._frames), -(-len(self._frames) // BACKDROP_FRAMES))
        limited = (scene.limited(self._frames[index]) for index in chosen)
        seen = ((frame.depth, scene.labels(frame) > 0) for frame in limited)
        size, views = self._background_bytes(), self._background_views()
        misfit, beyond = views.misfit(self.colors.models[0])

        def cost(choice: DepthChoice) -> float:
            if len(choice.payload) >= size:
                return inf
            try:
                model = RenderModel(choice.model(scene.info.rig.depth, scene.objects[0].poses[0]))
            except FormatError:
                return inf
            model.refresh(self._threads)
            found, wrong = views.misfit(model)
            if found > MISFIT_TOLERANCE * misfit or wrong > beyond + WRONG_TOLERANCE:
                return inf
            return GEOMETRY_SHARE * len(choice.payload) / size + DEPTH_SHARE * float(np.log(found + 1e-4))

        return best_depths(measured_depths(seen), scene.info.rig.depth, cost, scene.config.voxel_size_m)

    def _background_bytes(self) -> int:
        """Return how many bytes the cells of the background take without colours."""
        surface, model = self._surfaces[0], self.colors.models[0].model
        flat = replace(surface, colors=np.zeros_like(surface.colors))
        return one_shot(flat, model.voxel_size_m, model.relief_bits, color_settings(ColorConfig(), self._grey))[0]

    def _background_views(self) -> _BackgroundViews:
        """Return what frames measure where no object is drawn."""
        thinned, renderer = self._thinned_views(0)
        measured = []
        for index in misfit_frames(self._frames):
            _, labels = renderer.cast(thinned.grid, self.colors.models, self._poses(index))
            depth = thinned.thin(self._scene.limited(self._frames[index]).depth).reshape(-1)
            measured.append(np.where(labels == 0, depth, np.float32(0)))
        return _BackgroundViews(thinned, renderer, self._scene.objects[0].poses[0], measured)

    def pixels_per_cell(self, without_background: bool) -> float:
        """Return how many pixels of a frame show a cell, on an average over all frames."""
        chosen = [number for number in self._surfaces if number or not without_background] or [0]
        cells = sum(len(self._surfaces[number].cells) for number in chosen)
        shown = sum(
            np.count_nonzero(np.isin(sample.labels, chosen)) * self._sampler(index).pixels_per_sample
            for index, sample in self._kept
        )
        return shown / max(len(self._kept) * cells, 1)

    def _samples(self) -> Iterator[tuple[FrameSamples, NDArray[np.int64]]]:
        return ((sample, self._gains[index]) for index, sample in self._kept)

    def _seen_frames(self) -> Iterator[Frame]:
        """Yield the frames in which anything is drawn."""
        return (frame for frame in map(self._scene.limited, self._frames) if self._poses(frame.index))

    def _sample(self, frame: Frame) -> FrameSamples:
        poses, shift = self._poses(frame.index), self.shifts[frame.index]
        return self._sampler(frame.index).sample(frame, self.colors, poses, shift)

    def _sampler(self, frame: int) -> Sampler:
        return self._samplers[self._scene.sensors[frame]]

    def _aligned(self, moment: Sequence[Frame]) -> list[FrameSamples]:
        """Align the objects that may move in the frames of a moment, or their shifts alone, then sample them."""
        samples = [self._sample(frame) for frame in moment]
        moved = [self._align(frame, sample) for frame, sample in zip(moment, samples, strict=True)]
        if not any(moved):
            return samples
        if len(moment) > 1:
            self._unite([frame.index for frame in moment])
        return [self._sample(frame) for frame in moment]

    def _unite(self, frames: Sequence[int]) -> None:
        """Give the frames of a moment the same poses, those in the middle of their own."""
        for script in self.script.values():
            at = script[frames[0]]
            if at is None:
                continue
            pose = at.T_camera_object
            for count, frame in enumerate(frames[1:], 2):
                other = script[frame]
                pose = pose if other is None else interpolated(pose, other.T_camera_object, 1 / count)
            for frame in frames:
                script[frame] = replace(at, T_camera_object=pose)

    def _align(self, frame: Frame, sample: FrameSamples) -> bool:
        """Align the objects that may move in a frame, or its shift alone; tell whether there are any."""
        scene, index, rig = self._scene, frame.index, self._scene.info.rigs[frame.sensor]
        luma = (sample.shown(self.colors) @ LUMA).astype(np.float64)
        moved = False
        for number, item in scene.objects.items():
            at = self.script[number][index]
            if at is None or not at.usable or item.is_given(at):
                continue
            moved, here = True, sample.labels == number
            view = frame, rig, rig.at_sensor(at.T_camera_object), sample.points[here], luma[here]
            if not self.only_shifts:
                pose = rig.at_base(aligned_pose(*view, sensor=scene.sensor_of(frame.sensor)))
                self.script[number][index] = replace(at, T_camera_object=pose)
            elif number == 0:
                self.shifts[index] = aligned_shift(*view, self.shifts[index])
        return moved

    def _hold(self, index: int) -> None:
        """Let a frame that repeats the sensor's one before be as that one, but for poses that are given."""
        last = self._scene.frame_before(index)
        if last is None:
            return
        self._gains[index], self.shifts[index] = self._gains[last], self.shifts[last]
        for number, item in self._scene.objects.items():
            at, before = self.script[number][index], self.script[number][last]
            if at is not None and before is not None and not item.is_given(at):
                self.script[number][index] = replace(at, T_camera_object=before.T_camera_object)

    def _lost(self, frame: int) -> bool:
        """Tell whether an object is drawn where it was not seen: then the picture says nothing about colours."""
        return any(at.status == Status.LOST for script in self.script.values() if (at := script[frame]) is not None)

    def _poses(self, frame: int) -> dict[int, Pose]:
        """Return where the decoder will draw every object that has appeared, before the sensor that took a frame."""
        poses, rig = {}, self._scene.info.rigs[self._scene.sensors[frame]]
        for number, item in self._scene.objects.items():
            at = self.script[number][frame]
            if item.born is not None and item.born <= frame:
                poses[number] = rig.at_sensor(item.poses[frame] if at is None else at.T_camera_object)
        if self.guess is not None and 0 in poses:
            poses[self.guess[0]] = poses[0]
        return poses


class _BackgroundViews:
    """What frames measure of a background at rest, to be held against what is drawn of it."""

    def __init__(self, thinned: Thinned, renderer: Renderer, pose: Pose, measured: list[Floats]) -> None:
        self._thinned, self._renderer, self._pose, self._measured = thinned, renderer, pose, measured

    def misfit(self, model: RenderModel) -> tuple[float, float]:
        """Return the `mean_misfit`, and the share of measurements that are more than `WRONG` off.

        What is measured and not drawn counts as quite wrong.
        """
        depth, _ = self._renderer.cast(self._thinned.grid, {0: model}, {0: self._pose})
        drawn = np.where(depth > 0, depth, NOWHERE)
        wrong = sum(np.count_nonzero((np.abs(drawn - each) > WRONG * each) & (each > 0)) for each in self._measured)
        count = sum(map(np.count_nonzero, self._measured))
        return mean_misfit((drawn, each) for each in self._measured), wrong / max(count, 1)


def _turns(scene: Scene, item: SceneObject) -> bool:
    """Tell whether an object turns in the world, so that the light on its surface changes."""
    if not item.number:
        return False
    world = scene.objects[0].poses
    turns = [inverse(world[k])[:3, :3] @ item.poses[k][:3, :3] for k, at in enumerate(item.found) if at is not None]
    return any(np.trace(turns[0].T @ turn) < 1 + 2 * np.cos(TURNS_RAD) for turn in turns)


def _error(sample: FrameSamples, shown: NDArray[np.float32], units: NDArray[np.int64]) -> float:
    gain, offset = apply_gain(units)
    return float(np.mean((np.clip(shown * gain + offset, 0, 255) - sample.observed) ** 2))
