# SPDX-License-Identifier: MIT
"""Every error that 3dvc raises on purpose.

::

    ThreedvcError
    ├── FormatError              a .3dvc stream cannot be read
    │   ├── BadMagic             not a .3dvc file
    │   ├── UnsupportedVersion   written for a newer reader
    │   ├── TruncatedStream      the stream ends too early
    │   ├── CorruptStream        checksum, digest or content is wrong
    │   └── LimitExceeded        a length or count is beyond what a reader accepts
    ├── SequenceError            input frames are missing, unreadable or implausible
    ├── ConfigError              an option has an impossible value
    └── OutputError              an output cannot be written

Messages are one line: the file, the offending value, and what to do.
"""

from __future__ import annotations

__all__ = [
    "BadMagic",
    "ConfigError",
    "CorruptStream",
    "FormatError",
    "LimitExceeded",
    "OutputError",
    "SequenceError",
    "ThreedvcError",
    "TruncatedStream",
    "UnsupportedVersion",
]


class ThreedvcError(Exception):
    """Base of all errors raised on purpose; its text is fit to be shown to a user."""


class FormatError(ThreedvcError):
    """A stream cannot be read."""


class BadMagic(FormatError):
    """The bytes are not a .3dvc stream."""


class UnsupportedVersion(FormatError):
    """The stream asks for a newer reader or for features that this one lacks."""


class TruncatedStream(FormatError):
    """The stream ends before its END packet."""


class CorruptStream(FormatError):
    """A checksum, a digest or the content of a packet is wrong."""


class LimitExceeded(FormatError):
    """A length or count is larger than a reader accepts."""


class SequenceError(ThreedvcError):
    """Input frames are missing, unreadable or implausible."""


class ConfigError(ThreedvcError):
    """An option has an impossible value."""


class OutputError(ThreedvcError):
    """An output file or stream cannot be written."""
