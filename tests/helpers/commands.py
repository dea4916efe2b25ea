# SPDX-License-Identifier: MIT
"""Commands run in this process, and an encoder that only remembers."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

from click.testing import CliRunner, Result

from helpers.streams import FRAMES
from threedvc.cli.main import main
from threedvc.formats.sources.notices import Notice


def run(*arguments: object, **options: Any) -> Result:
    return CliRunner().invoke(main, [str(argument) for argument in arguments], **options)


class FakeEncoder:
    """Remembers what it was asked for, calls back for two frames, and returns a report or raises."""

    def __init__(self, error: BaseException | None = None) -> None:
        self.error = error
        self.calls: list[SimpleNamespace] = []

    def __call__(
        self,
        source: Any,
        output: Any,
        config: Any,
        *,
        verify: bool,
        on_frame: Callable[[Any], None],
        on_notice: Callable[[Notice], None],
        force: bool,
        stop: Callable[[], bool] | None,
    ) -> Any:
        self.calls.append(SimpleNamespace(source=source, output=output, config=config, verify=verify))
        for index in range(2):
            on_frame(SimpleNamespace(index=index, bytes_so_far=1000 * index))
        if self.error is not None:
            raise self.error
        return SimpleNamespace(
            file_bytes=5000,
            frames=FRAMES,
            duration_s=0.2,
            seconds=2.0,
            latency_s=None,
            voxel_size_m=0.016,
            lost_frames=[3],
            digest=bytes.fromhex("00ff"),
            notices=(Notice("odd", warning=True),),
        )
