# SPDX-License-Identifier: MIT
"""What a scene is made of: one record for each primitive, with its placement and its texture."""

from __future__ import annotations

import numpy as np

__all__ = [
    "BOX",
    "CAPSULE",
    "CHECKER",
    "ELLIPSOID",
    "FRUSTUM",
    "MARBLE",
    "NOISE",
    "PART",
    "PATCHES",
    "PICTURE",
    "PLAIN",
    "RECTANGLE",
    "TORUS",
    "WOOD",
    "Vector",
]

RECTANGLE, BOX, ELLIPSOID, FRUSTUM, CAPSULE, TORUS = range(6)
PLAIN, CHECKER, NOISE, MARBLE, WOOD, PATCHES, PICTURE = range(7)
PART = np.dtype(
    [
        ("kind", np.int32),
        ("pattern", np.int32),
        ("label", np.int32),
        ("seed", np.int64),
        ("size", np.float64, (3,)),
        ("T_part_camera", np.float64, (3, 4)),
        ("T_body_camera", np.float64, (3, 4)),
        ("colors", np.float64, (2, 3)),
        ("scale", np.float64, (2,)),
        ("grain", np.float64),
        ("picture", np.int64, (3,)),
    ],
    align=True,
)
"""One primitive of one picture.

``size`` in meters as in `threedvc.synthesis.shapes`; ``colors`` in 0..255; ``scale`` is the period of the
pattern along u and v in meters; ``picture`` is the first texel, height and width of a picture.
"""
Vector = tuple[float, float, float]
