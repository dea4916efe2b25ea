# SPDX-License-Identifier: MIT
"""docs/inputs.md says what really becomes of recordings as people have them."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

TABLE = re.compile(r"^\| `([^`]+)` \|", re.MULTILINE)


@pytest.fixture
def document(repository: Path, monkeypatch: pytest.MonkeyPatch):  # type: ignore[no-untyped-def]
    monkeypatch.setattr(sys, "path", [str(repository / "docs"), *sys.path])
    import make_inputs

    return make_inputs


def test_table_lists_every_case(repository: Path, document) -> None:  # type: ignore[no-untyped-def]
    text = (repository / "docs" / "inputs.md").read_text(encoding="utf-8")
    assert TABLE.findall(text) == [case.name for case in document.CASES]


@pytest.mark.long  # every case takes seconds, and the programs that record are not part of the checkout
def test_table_is_current(repository: Path, document) -> None:  # type: ignore[no-untyped-def]
    folder = document.field_folder()
    if not folder.is_dir():
        pytest.skip(f"no programs that make recordings at {folder}; set THREEDVC_FIELD to their folder")
    text = (repository / "docs" / "inputs.md").read_text(encoding="utf-8")
    assert document.inputs_document(folder) == text
