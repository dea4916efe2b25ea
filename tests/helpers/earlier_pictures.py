# SPDX-License-Identifier: MIT
"""Payloads of BACKDROP and VIDEO as earlier writers made them, and what they decoded to then."""

from __future__ import annotations

import hashlib
from base64 import b64decode
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["RUNS", "STILLS", "EarlierRun", "EarlierStill", "digest_of"]


class EarlierStill(NamedTuple):
    """A picture, and the digest of its pixels (height, width, 3) uint8."""

    width: int
    height: int
    gray: bool
    payload: bytes
    digest: str


class EarlierRun(NamedTuple):
    """Pictures, and the digest of their samples (count, height, width) uint8."""

    count: int
    width: int
    height: int
    payload: bytes
    digest: str


def digest_of(values: NDArray[np.uint8]) -> str:
    """Return the first half of the SHA-256 of pixels."""
    return hashlib.sha256(np.ascontiguousarray(values).tobytes()).hexdigest()[:32]


STILLS = {
    "color": EarlierStill(
        width=33,
        height=31,
        gray=False,
        payload=b64decode(
            "BYEAHAASAAoJGBVhu7YCGg1AMkUZgFEBQsTYlYLQOctTOnFjLscOFzobZ9s6BpSXSBn9L5RwDVwVAiUYdXAGCb+i3PUon/+WHYejK/v7qHD4"
            "fOqb4FrSicA="
        ),
        digest="3f8ee4338fef141bfe763085cc4ca670",
    ),
    "gray": EarlierStill(
        width=20,
        height=16,
        gray=True,
        payload=b64decode("AYEAHAASAAoIGBDn/bAQ0GoyDxmAAAFABA00fUmY2LsHEA=="),
        digest="1b4e2e1dd943ea9d23061f0690acc4a0",
    ),
    "whole": EarlierStill(
        width=20,
        height=16,
        gray=True,
        payload=b64decode(
            "AAAAABxmdHlwYXZpZgAAAABhdmlmbWlmMW1pYWYAAADpbWV0YQAAAAAAAAAhaGRscgAAAAAAAAAAcGljdAAAAAAAAAAAAAAAAAAAAAAOcGl0"
            "bQAAAAAAAQAAAB5pbG9jAAAAAEQAAAEAAQAAAAEAAAENAAAAHQAAAChpaW5mAAAAAAABAAAAGmluZmUCAAAAAAEAAGF2MDFDb2xvcgAAAABo"
            "aXBycAAAAElpcGNvAAAAFGlzcGUAAAAAAAAAFAAAABAAAAAOcGl4aQAAAAABCAAAAAxhdjFDgQAcAAAAABNjb2xybmNseAACAAIAAoAAAAAX"
            "aXBtYQAAAAAAAAABAAEEAQKDBAAAACVtZGF0EgAKCBgQ5/2wENBqMg8ZgAABQAQNNH1JmNi7BxA="
        ),
        digest="1b4e2e1dd943ea9d23061f0690acc4a0",
    ),
    "pixel": EarlierStill(
        width=1,
        height=1,
        gray=False,
        payload=b64decode("B4EAHAASAAoHGAA+2AhoNTISE0AAAQJEjQf/06EBNA7+FHYY"),
        digest="dcdef2816afa88ec6cc0cf2179d460b7",
    ),
    "magnified": EarlierStill(
        width=16,
        height=12,
        gray=False,
        payload=b64decode("B4EAHAASAAoIGA0+PbAQ0GoyGRZAAAEgpPrbhQSpq6VUpim+oQMMQL/9N9w="),
        digest="89b1ab5c0816f8b94d7c7157a4aab70f",
    ),
}

RUNS = {
    "run": EarlierRun(
        count=9,
        width=37,
        height=23,
        payload=b64decode(
            "gQAcAAwAAAACpJY+vmwENBqAIxQAKYAAAkBAPJpuOZKgHuim1l6W1SfS/tiieKdNx8h4Q4+VrBwpA3AgAAARqSAgAkACALqWU5anuNgXKKKR"
            "ED2QoBIpAfBAABARq+BAAkACAOPGxRODEjIB4QAAQINbQIAEgQoAuPXm+iAPMgICBgBAo17AgASADgDfJACoEDIEJAUYAKNagIAEgA4A3D1A"
            "DzIFCAqgYKNgAIAFAA4A3oAAmBAyB9ANUYwjYACABQAEAN2C8BEyCAEDr1ADYACABQAEAN6pkFU="
        ),
        digest="6e7ac887bc2b39cede52f8e5f029d620",
    ),
    "one": EarlierRun(
        count=1,
        width=37,
        height=23,
        payload=b64decode(
            "gQAcAAwAAAACpJY+vmwENBqAHRQALUAAAkBAu3/kkldlaK2nQeQtm8/G/9iXGPEe1xAzAeBAAAAGwAAACgAIAN0QhA=="
        ),
        digest="544e7434fe6c924210e3f165bbc430f3",
    ),
    "pixel": EarlierRun(
        count=2,
        width=1,
        height=1,
        payload=b64decode("gQAcAAoAAAAAAH182AhoNQsUACyAAAJAAAFZY4AQMgHgQAAAI1kAAASABAAeiCQ="),
        digest="ed5b3f51065772430ee187dc5cc32fb7",
    ),
    "long": EarlierRun(
        count=20,
        width=16,
        height=16,
        payload=b64decode(
            "gQAcAAsAAAABn/n182AhoNQPFAAxoAACjQAEtAMWRpJKSBIpAnAgAAABsgAAAoECABZ3MvuQECkBcEAAEAGy4AACgwUAYU+ADzIB4QAAQKNs"
            "AAAFAA4AeWAAqA4yAyIEwACjbAAABQAOAHwAmBQpBTIETIARsIAAAoACABzf3O1LtEAQKQOUBEyBQbQgAAKABQB5pTAOMgUQCJnCo2sAAAUA"
            "DgB4DjIGAQ8RwqNsAAAFAA4AeADoDjIIIIz5gqNmQAAFAA4AeA4yCQIFmeKjbAAABQAOAHAA2BQpBzAUWrIRr0AAAkECAB+B/LQwFYAPKQYo"
            "BFqyAbLAAAKABwCBwA4yCwEIteQjbAAABQAOAHAA+A4yDSgO5UQjbAAABQAOAHAAiBQpCbAm7FheygAACgQIAADSbj6UPZMQKQgQRuxYQbJg"
            "AAKABQBsVUAOMg8CDdhUo2wAAAUADgBwAKgQMhEhBTD0o2eAAAUACgCaoEAOMhIQBqDUo2wAAAUADgBgAJg="
        ),
        digest="fc7869ec55a9c3bd9df504bff87c2c57",
    ),
}
