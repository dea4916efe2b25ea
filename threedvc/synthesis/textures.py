# SPDX-License-Identifier: MIT
"""Procedural textures: solid patterns computed where a ray hits, and small seeded pictures.

Solid patterns are functions of the body point, so that they run on without seams over all parts of a
body; checkers, stripes and pictures follow the texture coordinates of each surface.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from threedvc.errors import ConfigError
from threedvc.kernels.synthesis.parts import CHECKER, MARBLE, NOISE, PATCHES, PICTURE, PLAIN, WOOD

__all__ = [
    "RGB",
    "Texture",
    "bricks",
    "checker",
    "cloth",
    "marble",
    "noise",
    "parcel",
    "patches",
    "picture",
    "plain",
    "planks",
    "poster",
    "rug",
    "stripes",
    "wallpaper",
    "wood",
]

RGB = tuple[int, int, int]
Image = NDArray[np.uint8]

TEXEL_M = 0.005
"""Of pictures: less than a pixel of 320x240 covers at 2 m."""
BLACK: RGB = (0, 0, 0)
"""Of outlines and print."""
INKS: tuple[RGB, ...] = (
    (196, 62, 48),
    (222, 146, 52),
    (232, 202, 108),
    (88, 134, 78),
    (46, 108, 122),
    (58, 88, 148),
    (122, 74, 112),
    (176, 116, 86),
    (208, 216, 206),
)
"""Colors of posters and prints, of which pictures draw some; by taste, far apart in hue."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Texture:
    """The color of a surface before lighting.

    Attributes
    ----------
    pattern
        One of the patterns of `threedvc.kernels.synthesis.parts`.
    colors
        The two colors that the pattern mixes.
    scale_m
        Period along u and v; of a picture, its width and height. Infinity: no change along that axis.
    grain
        Strength of a fine noise in brightness on top, 0..1.
    seed
        Seed of the noise in the pattern.
    image
        (height, width, 3) uint8 RGB of a picture, else None.

    Raises
    ------
    ConfigError
        If a period or the grain is out of range, or the image has another shape.
    """

    pattern: int
    colors: tuple[RGB, RGB] = (BLACK, BLACK)
    scale_m: tuple[float, float] = (1.0, 1.0)
    grain: float = 0.0
    seed: int = 0
    image: Image | None = None

    def __post_init__(self) -> None:
        if not min(self.scale_m) > 0 or not 0 <= self.grain <= 1:
            raise ConfigError(f"texture periods {self.scale_m} m must be positive and grain {self.grain} within 0..1")
        if self.image is not None and (self.image.ndim != 3 or self.image.shape[2] != 3 or self.image.size == 0):
            raise ConfigError(f"a picture must have the shape (height, width, 3), not {self.image.shape}")


def plain(color: RGB, grain: float = 0.15) -> Texture:
    """Return one color with a little grain."""
    return Texture(pattern=PLAIN, colors=(color, color), grain=grain)


def checker(first: RGB, second: RGB, width_m: float, height_m: float) -> Texture:
    """Return a checkerboard."""
    return Texture(pattern=CHECKER, colors=(first, second), scale_m=(width_m, height_m), grain=0.12)


def stripes(first: RGB, second: RGB, width_m: float, *, upright: bool = False) -> Texture:
    """Return stripes, level or upright."""
    scale = (width_m, float("inf")) if upright else (float("inf"), width_m)
    return Texture(pattern=CHECKER, colors=(first, second), scale_m=scale, grain=0.12)


def noise(first: RGB, second: RGB, scale_m: float, seed: int = 0) -> Texture:
    """Return soft clouds."""
    return Texture(pattern=NOISE, colors=(first, second), scale_m=(scale_m, scale_m), seed=seed)


def marble(first: RGB, second: RGB, scale_m: float, seed: int = 0) -> Texture:
    """Return marble veins."""
    return Texture(pattern=MARBLE, colors=(first, second), scale_m=(scale_m, scale_m), seed=seed)


def wood(first: RGB, second: RGB, ring_m: float, seed: int = 0) -> Texture:
    """Return growth rings about a distant axis along the body's x."""
    return Texture(pattern=WOOD, colors=(first, second), scale_m=(ring_m, ring_m), grain=0.2, seed=seed)


def patches(first: RGB, second: RGB, scale_m: float, seed: int = 0) -> Texture:
    """Return sharp blots of the second color on the first, as on a cow's hide."""
    return Texture(pattern=PATCHES, colors=(first, second), scale_m=(scale_m, scale_m), grain=0.1, seed=seed)


def picture(image: Image, width_m: float, height_m: float, grain: float = 0.0) -> Texture:
    """Return a picture of a given size, repeated beyond it."""
    return Texture(pattern=PICTURE, scale_m=(width_m, height_m), grain=grain, image=image)


def wallpaper(ground: RGB, petals: RGB, rng: np.random.Generator) -> Texture:
    """Return a flower wallpaper, 0.6 m x 0.6 m, with flowers that differ in place and size."""
    image = _ground(ground, 0.6, 0.6, rng)
    rows, columns = np.indices(image.shape[:2])
    for row in range(3):
        for column in range(3):
            x, y = (np.array([column + 0.25 + 0.5 * (row % 2), row + 0.5]) + rng.uniform(-0.12, 0.12, 2)) * 40
            # The picture repeats, so a flower that leaves on one side enters on the other.
            dx, dy = (columns - x + 60) % 120 - 60, (rows - y + 60) % 120 - 60
            distance = np.hypot(dx, dy) / rng.uniform(0.85, 1.15)
            outline = 8 + 4.5 * np.cos(5 * np.arctan2(dy, dx) + rng.uniform(0, 6))
            _paint(image, distance < outline, petals)
            _paint(image, distance < 3.2, (232, 190, 70))
    return picture(image, 0.6, 0.6)


def bricks(brick: RGB, mortar: RGB, rng: np.random.Generator) -> Texture:
    """Return a brick wall, 0.96 m x 0.64 m."""
    image = _ground(mortar, 0.96, 0.64, rng)
    rows, columns = np.indices(image.shape[:2])
    for course in range(8):
        for place in range(4):
            left = (place * 48 + 24 * (course % 2)) % 192
            inside = ((columns - left) % 192 < 46) & (rows // 16 == course) & (rows % 16 < 14)
            _paint(image, inside, _varied(brick, rng, 0.2))
    return picture(_speckled(image, rng, 0.12), 0.96, 0.64)


def planks(color: RGB, rng: np.random.Generator) -> Texture:
    """Return floor boards along x, 1.6 m x 0.8 m."""
    image = _ground(color, 1.6, 0.8, rng)
    rows, columns = np.indices(image.shape[:2])
    grain = _smooth_noise(image.shape[0], image.shape[1], 80, 10, rng)
    for board in range(8):
        joint = int(rng.integers(image.shape[1]))
        for half in range(2):
            inside = (rows // 20 == board) & ((columns - joint) % 320 // 160 == half)
            tone = (0.85 + 0.3 * rng.random()) * (0.85 + 0.3 * grain[inside])
            image[inside] = np.clip(np.array(color) * tone[:, None], 0, 255).astype(np.uint8)
        _paint(image, (rows // 20 == board) & ((columns - joint) % 160 == 0), _varied(color, rng, 0.0, 0.45))
    _paint(image, rows % 20 == 0, _varied(color, rng, 0.0, 0.45))
    return picture(image, 1.6, 0.8)


def cloth(thread: RGB, rng: np.random.Generator) -> Texture:
    """Return a gingham table cloth, 0.2 m x 0.2 m."""
    image = _ground((238, 234, 224), 0.2, 0.2, rng)
    rows, columns = np.indices(image.shape[:2])
    dyed = 1 + (rows // 10 % 2) + (columns // 10 % 2)
    for depth, strength in ((2, 0.5), (3, 1.0)):
        mixed = tuple(int(238 + strength * (c - 238)) for c in thread)
        _paint(image, dyed == depth, (mixed[0], mixed[1], mixed[2]))
    return picture(_speckled(image, rng, 0.08), 0.2, 0.2)


def poster(width_m: float, height_m: float, rng: np.random.Generator) -> Texture:
    """Return a printed sheet: a colored field of discs and boxes over lines like those of a text."""
    image = _ground((240, 236, 224), width_m, height_m, rng)
    height, width = image.shape[:2]
    rows, columns = np.indices((height, width))
    field = (rows > height * 0.07) & (rows < height * 0.66) & (np.abs(columns - width / 2) < width * 0.43)
    _paint(image, field, _printed(rng))
    for shape in range(7):
        x, y = rng.uniform(0.15, 0.85) * width, rng.uniform(0.1, 0.62) * height
        size = rng.uniform(0.06, 0.17) * width
        dx, dy = np.abs(columns - x), np.abs(rows - y)
        inside = np.hypot(dx, dy) < size if shape % 2 else np.maximum(dx, 0.6 * dy) < 0.8 * size
        _paint(image, field & inside, _printed(rng))
    word = _smooth_noise(height, width, max(height // 3, 1), max(width // 3, 1), rng) > 0.36
    text = (rows > height * 0.71) & (rows < height * 0.95) & (np.abs(columns - width / 2) < width * 0.4)
    _paint(image, text & (rows % 4 < 2) & word, (52, 48, 56))
    _paint(image, (columns == 0) | (rows == 0) | (columns == width - 1) | (rows == height - 1), (60, 46, 36))
    return picture(image, width_m, height_m)


def parcel(width_m: float, height_m: float, rng: np.random.Generator) -> Texture:
    """Return a printed package: a band across a ground color, a bright label and a frame."""
    image = _ground(_printed(rng), width_m, height_m, rng)
    height, width = image.shape[:2]
    rows, columns = np.indices((height, width))
    _paint(image, (rows + columns * height / max(width, 1)) % height < 0.3 * height, _printed(rng))
    label = (np.abs(rows - height * 0.55) < height * 0.22) & (np.abs(columns - width / 2) < width * 0.36)
    _paint(image, label, (236, 230, 214))
    word = _smooth_noise(height, width, max(height // 3, 1), max(width // 3, 1), rng) > 0.4
    _paint(image, label & (rows % 5 < 2) & word, (40, 40, 60))
    edge = np.minimum(np.minimum(rows, height - 1 - rows), np.minimum(columns, width - 1 - columns))
    _paint(image, edge < 1, (70, 56, 44))
    return picture(image, width_m, height_m, 0.08)


def rug(width_m: float, height_m: float, rng: np.random.Generator) -> Texture:
    """Return a woven rug: nested borders about a field of lozenges."""
    image = _ground((122, 30, 38), width_m, height_m, rng)
    height, width = image.shape[:2]
    rows, columns = np.indices((height, width))
    edge = np.minimum(np.minimum(rows, height - 1 - rows), np.minimum(columns, width - 1 - columns))
    lozenge = np.abs(rows % 36 - 18) + np.abs(columns % 36 - 18)
    _paint(image, (lozenge < 13) & (edge > 24), (206, 164, 92))
    _paint(image, (lozenge < 7) & (edge > 24), (34, 58, 92))
    for first, last, color in ((0, 3, (214, 196, 160)), (10, 20, (34, 58, 92)), (21, 23, (214, 196, 160))):
        _paint(image, (edge >= first) & (edge <= last), color)
    _paint(image, (edge >= 13) & (edge <= 17) & ((rows + columns) % 12 < 6), (206, 164, 92))
    return picture(_speckled(image, rng, 0.15), width_m, height_m)


def _ground(color: RGB, width_m: float, height_m: float, rng: np.random.Generator) -> Image:
    height, width = max(2, round(height_m / TEXEL_M)), max(2, round(width_m / TEXEL_M))
    tone = 0.9 + 0.2 * _smooth_noise(height, width, max(height // 16, 1), max(width // 16, 1), rng)
    return np.asarray(np.clip(tone[..., None] * np.array(color), 0, 255), dtype=np.uint8)


def _paint(image: Image, where: NDArray[np.bool_], color: RGB) -> None:
    image[where] = color


def _varied(color: RGB, rng: np.random.Generator, spread: float, tone: float = 1.0) -> RGB:
    tone *= 1 + rng.uniform(-spread, spread)
    red, green, blue = (int(min(255, c * tone)) for c in color)
    return red, green, blue


def _printed(rng: np.random.Generator) -> RGB:
    """Draw one of the inks of posters and packages."""
    return _varied(INKS[int(rng.integers(len(INKS)))], rng, 0.12)


def _speckled(image: Image, rng: np.random.Generator, strength: float) -> Image:
    height, width = image.shape[:2]
    tone = 1 + strength * (_smooth_noise(height, width, max(height // 2, 1), max(width // 2, 1), rng) - 0.5) * 2
    return np.clip(image * tone[..., None], 0, 255).astype(np.uint8)


def _smooth_noise(height: int, width: int, rows: int, columns: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Interpolate random numbers on a (rows, columns) grid that repeats to (height, width), 0..1."""
    grid = rng.random((rows, columns))
    y, x = np.arange(height) * rows / height, np.arange(width) * columns / width
    top, left = y.astype(np.intp), x.astype(np.intp)
    fy, fx = (y - top)[:, None], (x - left)[None, :]
    below, right = (top + 1) % rows, (left + 1) % columns
    upper = grid[top][:, left] * (1 - fx) + grid[top][:, right] * fx
    lower = grid[below][:, left] * (1 - fx) + grid[below][:, right] * fx
    return np.asarray(upper * (1 - fy) + lower * fy, dtype=np.float64)
