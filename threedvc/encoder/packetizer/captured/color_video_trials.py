# SPDX-License-Identifier: MIT
"""How fine a color video is, and what bytes are worth to it, by trials of about the size that it will have."""

from __future__ import annotations

from collections.abc import Iterator
from math import inf
from typing import Any, NamedTuple

import numpy as np

from threedvc.coding.video.color_runs import decode_color, halving_error, video_format
from threedvc.coding.video.planes import picture_of
from threedvc.config.stages import MAX_COARSENESS, MIN_CRF
from threedvc.encoder.packetizer.captured.color_video import (
    EXACT,
    MAX_SCALED_CRF,
    QUARTERS,
    SCALES,
    ColorVideoWriter,
    VideoChoice,
)
from threedvc.encoder.rate.objective import MIN_SLOPE, ColorCost
from threedvc.encoder.reconstruction.scene import Scene
from threedvc.frames.sequence import FrameSequence, sampling_stride
from threedvc.metrics.picture_quality import psnr
from threedvc.stream.captured_headers import ColorVideoHeader
from threedvc.stream.packets import Packet

__all__ = ["DB_PER_COARSENESS", "MAX_CHROMA_SHARE", "ColorVideoTrials"]

SAMPLED_FRAMES = 40
"""Frames whose error is measured, spread over the sequence: as many as of a finished stream."""
CHROMA_FRAMES = 8
"""Frames of which it is measured what chroma of half the rows and columns loses: it hardly differs between them."""
LIKELY_SHARE = 0.75
"""Share of a budget that a video may have when the rest is shared out; the trials about it tell what more or less is
worth. Geometry and poses of hand-held recordings take a tenth to a half."""
MAX_CHROMA_SHARE = 0.35
"""Share of the squared error that halving chroma may have; beyond, full chroma is better for the bytes. Measured where
the two are equal: .25 (fr1_rpy), .3 (two_toys), .4 (cow_turn), see decision 0034."""
LIKELY_TRIALS = 3
"""Videos that are coded to find the price of bytes: none has to fit."""
DB_PER_COARSENESS, MIN_DB_PER_COARSENESS = 0.36, 0.05
"""By how much one of coarseness lowers PSNR, about, and at least."""
CLOSE_DB = 0.15
"""Beyond a PSNR that was asked for this is close enough: a quarter of coarseness is about a tenth."""
SCALE_CRF = 3.0
"""By how much coarser the next larger scale is quantized in about as many bytes (decision 0036): a first guess."""
SPARE_DB = 1.5
"""Beyond the least PSNR of a quality pictures with full chroma have no more: as coarse as halved ones they would
have up to 9 dB more, in three times the bytes."""
MAX_STEPS = 8
"""Trials on the way to a PSNR; three are the rule."""
PEAK = 255.0
"""Largest level of a channel."""
HOPELESS = 0.15
"""By how much the logarithm of a larger scale's error may exceed the least one, .65 dB, and the next scale still be
tried: before a camera at rest three quarters of the sides may be worse than both half of them and all (hands_table)."""
ALIKE = 1.3
"""A scale found for one budget serves budgets up to so many times larger or smaller."""
ENOUGH = 0.95
"""Share of a budget that a video takes at least; otherwise a smaller scale is tried, or one without loss may fit."""


class _ColorErrors(NamedTuple):
    """What is measured of a video.

    Attributes
    ----------
    square, logarithm, psnr_db
        Means over frames of the squared error, of the logarithm of it plus one, and of PSNR.
    """

    square: float
    logarithm: float
    psnr_db: float


class ColorVideoTrials:
    """Videos of the pictures of all frames, and what is measured of them.

    Parameters
    ----------
    scene
        The finished scene, of which sensors and choices count.
    frames
        Its frames.
    batch_frames
        Frames of a BATCH.
    """

    def __init__(self, scene: Scene, frames: FrameSequence, batch_frames: int) -> None:
        count = len(scene.records)
        batches = (range(first, min(first + batch_frames, count)) for first in range(0, count, batch_frames))
        self.writer = ColorVideoWriter(scene, frames, batches)
        self._scene, self._frames = scene, frames
        self._measured: dict[VideoChoice, _ColorErrors] = {}
        self._halved: float | None = None
        self._scales: list[tuple[float, VideoChoice]] = []

    def within(self, budget_bytes: float) -> VideoChoice:
        """Return the best choice of at most so many bytes that a few trials find, or the coarsest there is."""
        choice = self._scaled(budget_bytes)
        if self._wants_full_chroma(choice):
            full = self.writer.choice_within(budget_bytes, choice._replace(full_chroma=True, scale=0.0))
            fits = self.writer.size(full) <= budget_bytes
            choice = full if fits and self._errors(full).logarithm < self._errors(choice).logarithm else choice
        if choice.coarseness == MIN_CRF and self.writer.size(choice) < ENOUGH * budget_bytes:
            return EXACT if self.writer.size(EXACT) <= budget_bytes else choice
        return choice

    def _scaled(self, budget_bytes: float) -> VideoChoice:
        """Return the choice of the best scale; of one found before, if that was for about as many bytes."""
        for before, found in self._scales:
            if 1 / ALIKE < budget_bytes / before < ALIKE:
                choice = self.writer.choice_within(budget_bytes, found)
                if ENOUGH * budget_bytes <= self.writer.size(choice) <= budget_bytes:
                    return choice
        choice = self._best_scale(self.writer.choice_within(budget_bytes), budget_bytes)
        self._scales.append((budget_bytes, choice))
        return choice

    def _best_scale(self, choice: VideoChoice, budget_bytes: float) -> VideoChoice:
        """Return a choice of larger pictures of as many bytes if these have a smaller error: still ones may.

        Smaller ones are tried, too, where sizes leap over a part of the bytes.
        """
        if choice.coarseness == MIN_CRF:
            return choice
        first = choice.coding
        larger = [scale for scale in SCALES if scale > first.scale]
        smaller = [scale for scale in SCALES if scale < first.scale][-1:]
        for scale in [*(smaller if self.writer.size(choice) < ENOUGH * budget_bytes else []), *larger]:
            steps = SCALES.index(scale) - SCALES.index(first.scale)
            coarseness = min(max(first.crf + SCALE_CRF * steps, MIN_CRF), MAX_SCALED_CRF)
            other = self.writer.choice_within(budget_bytes, VideoChoice(coarseness, scale=scale))
            fits = self.writer.size(other) <= budget_bytes
            worse = self._errors(other).logarithm - self._errors(choice).logarithm if fits else inf
            if worse < 0:
                choice = other
            elif scale in larger and worse > HOPELESS:
                break
        return choice

    def of_quality(self) -> VideoChoice:
        """Return the choice of the coarseness asked for, or the coarsest finer one that has the PSNR asked for."""
        video = self._scene.config.video
        if video.lossless:
            return EXACT
        choice, least_db = VideoChoice(video.coarseness), video.min_psnr_db
        psnr_db = self._errors(choice).psnr_db
        may_be_full = psnr_db < least_db or choice.coding.scale == 1
        if not (may_be_full and self._halving_costs(_square(max(psnr_db, least_db)))):
            return choice if psnr_db >= least_db else self._coarsest(choice, least_db)
        choice = choice._replace(full_chroma=True)
        spare_db = self._errors(choice).psnr_db - least_db
        if 0 <= spare_db <= SPARE_DB or not least_db:
            return choice
        return self._coarsest(choice, least_db + (SPARE_DB if spare_db > 0 else 0.0))

    def _coarsest(self, choice: VideoChoice, asked_db: float) -> VideoChoice:
        """Return the coarsest choice of a few, of which the first is given, that has a PSNR; else the finest."""
        fine, too_coarse = MIN_CRF, MAX_COARSENESS
        coarseness, slope = choice.coarseness, DB_PER_COARSENESS
        before: tuple[float, float] | None = None
        for _ in range(MAX_STEPS):
            spare = self._errors(choice._replace(coarseness=coarseness)).psnr_db - asked_db
            fine, too_coarse = (coarseness, too_coarse) if spare >= 0 else (fine, coarseness)
            if 0 <= spare < CLOSE_DB or too_coarse - fine <= 1 / QUARTERS:
                break
            if before is not None and before[0] != coarseness:
                slope = max((before[1] - spare) / (coarseness - before[0]), MIN_DB_PER_COARSENESS)
            before = coarseness, spare
            aim = coarseness + (spare - CLOSE_DB / 2) / slope
            coarseness = float(np.clip(round(QUARTERS * aim) / QUARTERS, fine, too_coarse))
            if coarseness in (fine, too_coarse) and coarseness != MIN_CRF:
                coarseness = round(QUARTERS * (fine + too_coarse) / 2) / QUARTERS
        return choice._replace(coarseness=fine)

    def cost(self, budget_bytes: float | None) -> ColorCost:
        """Return what bytes cost that a color video does not get.

        `budget_bytes` is what the stream may take, or None: the video has the quality asked for.
        """
        if self._scene.config.video.lossless:
            return ColorCost.of_slope(float(self.writer.size(EXACT)), MIN_SLOPE, fixed=False)
        asked = self.of_quality() if budget_bytes is None else self._likely(LIKELY_SHARE * budget_bytes)
        tried = (asked, asked.coarser)
        sizes = [float(self.writer.size(each)) for each in tried]
        errors = [self._errors(each).logarithm for each in tried]
        if budget_bytes is None:
            return ColorCost(sizes, errors)
        order = sorted(range(len(tried)), key=sizes.__getitem__)
        coarsest = VideoChoice(MAX_COARSENESS)
        least = self.writer.sizes.get(coarsest, 0)
        return ColorCost([sizes[k] for k in order], [errors[k] for k in order], budget_bytes, least)

    def _likely(self, budget_bytes: float) -> VideoChoice:
        """Return the choice of some coded that comes nearest to so many bytes, with full chroma if that is better."""
        found = self.writer.choice_within(budget_bytes, max_trials=LIKELY_TRIALS)
        if full := self._wants_full_chroma(found):
            self.writer.choice_within(budget_bytes, found._replace(full_chroma=True), LIKELY_TRIALS)
        alike = [each for each in self.writer.sizes if each.full_chroma == full and not each.exact]
        return min(alike, key=lambda each: abs(np.log(self.writer.size(each) / budget_bytes)))

    def _wants_full_chroma(self, choice: VideoChoice) -> bool:
        """Tell whether halving chroma takes so much of the error of a choice that full chroma is better."""
        plain = not (choice.full_chroma or choice.exact) and choice.coding.scale == 1
        return plain and self._halving_costs(self._errors(choice).square)

    def _halving_costs(self, square: float) -> bool:
        """Tell whether halving chroma takes so much of a squared error that full chroma is better."""
        return not self._scene.info.gray and self._error_of_halving() > MAX_CHROMA_SHARE * square

    def _error_of_halving(self) -> float:
        """Return the mean squared error of pictures of which nothing but chroma's rows and columns is lost."""
        if self._halved is None:
            every = sampling_stride(len(self._frames), CHROMA_FRAMES, self._frames.info)
            sampled = range(0, len(self._frames), every)
            errors = [halving_error(self._frames[number].color, self._scene.config.threads) for number in sampled]
            self._halved = float(np.mean(errors))
        return self._halved

    def _errors(self, choice: VideoChoice) -> _ColorErrors:
        if choice not in self._measured:
            every = sampling_stride(len(self._frames), SAMPLED_FRAMES, self._frames.info)
            packets = self.writer.packets(choice)
            decibels = np.array([each for packet in packets for each in self._decibels(packet, every)])
            squares = _square(decibels)
            self._measured[choice] = _ColorErrors(
                float(squares.mean()), float(np.log(squares + 1).mean()), float(decibels.mean())
            )
        return self._measured[choice]

    def _decibels(self, packet: Packet, every: int) -> Iterator[float]:
        """Yield the PSNR of those frames that a packet shows whose number is a multiple of `every`."""
        header, scene = ColorVideoHeader.from_map(packet.header), self._scene
        camera = scene.info.rigs[header.sensor].color
        own = [number for number in range(len(self._frames)) if scene.records[number].sensor == header.sensor]
        first = own.index(header.frame)
        video = video_format(header, gray=scene.info.each_sensor[header.sensor].gray)
        pictures = decode_color(packet.payload, header.count, video)
        for number, planes in zip(own[first : first + header.count], pictures, strict=True):
            if number % every == 0:
                shown = picture_of(planes, video, camera.width, camera.height, scene.config.threads)
                yield psnr(self._frames[number].color, shown)


def _square(psnr_db: Any) -> Any:
    """Return the mean squared error that a PSNR tells."""
    return PEAK**2 * 10 ** (-psnr_db / 10)
