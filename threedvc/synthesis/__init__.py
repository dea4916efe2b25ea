# SPDX-License-Identifier: MIT
"""Exact synthetic RGB-D: scenes of analytic shapes, rendered by ray casting, with poses and masks.

::

    sequence = SyntheticSequence(make_scene("paper"))
    frame = sequence[0]
"""

from __future__ import annotations

from threedvc.synthesis.noise import Noise
from threedvc.synthesis.scene import Scene
from threedvc.synthesis.scenes import SCENES, make_scene
from threedvc.synthesis.sequence import SyntheticSequence, mounted_sequences

__all__ = ["SCENES", "Noise", "Scene", "SyntheticSequence", "make_scene", "mounted_sequences"]
