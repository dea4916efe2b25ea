# SPDX-License-Identifier: MIT
"""Fit a finished scene to the pictures that the decoder will draw of it: colors, gains, light, poses.

`align_poses` moves the camera to where the drawn pictures fit color and depth best, `align_pictures` the color
pictures alone; when the frames are fused anew at these poses, `fit_appearance` fits what else the stream carries.
`threedvc.encoder.appearance.color_field` has the mathematics.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from threedvc.encoder.appearance.background.background_depth import CodedDepthMap
from threedvc.encoder.appearance.background.background_image import BackgroundImageCandidates
from threedvc.encoder.appearance.background_fit import background_depth_map, background_image
from threedvc.encoder.appearance.color_field import ColorField
from threedvc.encoder.appearance.color_fit import FINAL_FITS, fit_colors, log_color_error, steady_gains
from threedvc.encoder.appearance.fit_state import FitState
from threedvc.encoder.appearance.fitted_surfaces import fitted_surfaces, pixels_per_cell
from threedvc.encoder.appearance.hidden_cells import drop_hidden_cells
from threedvc.encoder.appearance.pose_alignment import Alignment
from threedvc.encoder.appearance.surface_completion import complete_surfaces
from threedvc.encoder.fusion.surface_extraction import Surface
from threedvc.encoder.reconstruction.scene import Scene
from threedvc.encoder.tracking.pose_track import PoseTracks
from threedvc.frames.sequence import FrameSequence
from threedvc.geometry.pose import Pose

__all__ = ["FittedAppearance", "align_pictures", "align_poses", "fit_appearance", "fit_geometry"]

MIN_ALIGNMENT_SAVING = 0.02
"""Share of the squared error that other poses must save: exact ones are not to be moved by the noise of the fit."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FittedAppearance:
    """What the fit to the drawn pictures found.

    Attributes
    ----------
    surfaces
        Surface of every object with the fitted colors, by number, and the inferred one. The error of a color counts
        as the frames show the cell.
    colors
        Colors of the texels, and the light on objects.
    gains
        (frames, 3, 2) units of the color camera's gains, see `threedvc.coding.gains`.
    shifts
        T_shifted_camera of every frame: how the camera moved between depth and color picture.
    backdrop
        The picture of a background at rest before a camera at rest, or None.
    depths
        The depth picture of such a background, if it takes less than its cells do and is no worse; or None.
    inferred
        Number of the object of inferred cells, and their edge in meters; None where little depth is missing.
    pixels_per_cell
        How many pixels of a frame show a colored cell, on an average over all frames; without those of a
        background that has a backdrop, unless there is nothing else.
    colorless
        Whether cells have no colors of their own: a video shows them.
    """

    surfaces: dict[int, Surface]
    colors: ColorField
    gains: NDArray[np.int64]
    shifts: list[Pose]
    backdrop: BackgroundImageCandidates | None
    depths: CodedDepthMap | None
    inferred: tuple[int, float] | None
    pixels_per_cell: float
    colorless: bool = False


def align_poses(scene: Scene, frames: FrameSequence, rounds: int) -> PoseTracks:
    """Return where every object is in every frame, as fits color and depth.

    Poses are aligned `rounds` times, each time against colors fitted at the poses before. They stay as they are
    unless the pictures fit better otherwise.
    """
    state = FitState(scene, frames)
    fit_colors(state)
    tracks, error = {number: list(track) for number, track in state.tracks.items()}, log_color_error(state)
    for _ in range(rounds):
        fit_colors(state, alignment=Alignment.POSES)
    return state.tracks if log_color_error(state) < error + np.log(1 - MIN_ALIGNMENT_SAVING) else tracks


def align_pictures(scene: Scene, frames: FrameSequence, shifts: Sequence[Pose], rounds: int) -> list[Pose]:
    """Return the shifts of the color pictures, found in `rounds` from given ones; other poses stay."""
    state = FitState(scene, frames, shifts)
    fit_colors(state)
    for _ in range(rounds):
        fit_colors(state, alignment=Alignment.SHIFTS)
    return state.shifts


def fit_appearance(scene: Scene, frames: FrameSequence, shifts: Sequence[Pose] | None = None) -> FittedAppearance:
    """Fit colors, light and gains at the scene's poses and at shifts that `align_pictures` has found."""
    state = FitState(scene, frames, shifts)
    drop_hidden_cells(state)
    complete_surfaces(state)
    fit_colors(state, fits=FINAL_FITS)
    gains = steady_gains(state)
    backdrop = background_image(state, gains)
    depths = background_depth_map(state)
    completion = state.completion
    return FittedAppearance(
        surfaces=fitted_surfaces(state, background_apart=backdrop is not None),
        colors=state.colors,
        gains=gains,
        shifts=state.shifts,
        backdrop=backdrop,
        depths=depths,
        inferred=None if completion is None else (completion.number, completion.voxel_size_m),
        pixels_per_cell=pixels_per_cell(state, without_background=backdrop is not None),
    )


def fit_geometry(scene: Scene, frames: FrameSequence) -> FittedAppearance:
    """Return the surfaces that frames show, without colors, gains and shifts: a video stands for these."""
    state = FitState(scene, frames)
    drop_hidden_cells(state)
    return FittedAppearance(
        surfaces={number: surface.without_colors() for number, surface in state.surfaces.items()},
        colors=state.colors,
        gains=state.gains,
        shifts=[],
        backdrop=None,
        depths=background_depth_map(state),
        inferred=None,
        pixels_per_cell=0.0,
        colorless=True,
    )
