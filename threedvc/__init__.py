# SPDX-License-Identifier: MIT
"""3dvc: RGB-D video as object models and motion scripts.

The names of the Python interface stand here; what they need (NumPy, Numba, OpenCV) is imported when
a name is first used, so that ``import threedvc`` stays light.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from threedvc._version import __version__
from threedvc.errors import (
    BadMagic,
    ConfigError,
    CorruptStream,
    FormatError,
    LimitExceeded,
    OutputError,
    SequenceError,
    ThreedvcError,
    TruncatedStream,
    UnsupportedVersion,
)

if TYPE_CHECKING:
    from threedvc.config import EncoderConfig, ExplorationConfig, RenderConfig
    from threedvc.formats.decoding import decode, open_stream
    from threedvc.formats.encoding import encode
    from threedvc.formats.evaluation.statistics import statistics
    from threedvc.formats.sources import open_sensors, open_sequence
    from threedvc.formats.view_planning import explore

__all__ = [
    "BadMagic",
    "ConfigError",
    "CorruptStream",
    "EncoderConfig",
    "ExplorationConfig",
    "FormatError",
    "LimitExceeded",
    "OutputError",
    "RenderConfig",
    "SequenceError",
    "ThreedvcError",
    "TruncatedStream",
    "UnsupportedVersion",
    "__version__",
    "decode",
    "encode",
    "explore",
    "open_sensors",
    "open_sequence",
    "open_stream",
    "statistics",
]

_HOMES = {
    "EncoderConfig": "threedvc.config",
    "ExplorationConfig": "threedvc.config",
    "RenderConfig": "threedvc.config",
    "decode": "threedvc.formats.decoding",
    "encode": "threedvc.formats.encoding",
    "explore": "threedvc.formats.view_planning",
    "open_sensors": "threedvc.formats.sources",
    "open_sequence": "threedvc.formats.sources",
    "open_stream": "threedvc.formats.decoding",
    "statistics": "threedvc.formats.evaluation.statistics",
}


def __getattr__(name: str) -> Any:
    """Import a public name from its home on first use (PEP 562)."""
    home = _HOMES.get(name)
    if home is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(home), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
