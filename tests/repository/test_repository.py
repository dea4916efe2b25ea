# SPDX-License-Identifier: MIT
"""The repository as a whole: what is packaged, what imports what, what no file may hold."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest

import make_cli
import threedvc
from threedvc import errors

REPOSITORY = Path(__file__).resolve().parents[2]
PYPROJECT: dict[str, Any] = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))
LINKED = ("cli", "formats")
SOURCE_FOLDERS = ("threedvc", *LINKED)
OWN_FOLDERS = (*SOURCE_FOLDERS, "tests", "benchmarks", "docs")
TEXT_SUFFIXES = {".py", ".md", ".toml", ".txt", ".in", ".json", ".typed"}

# Written in two parts, so that this file passes its own test.
UNFINISHED = re.compile("|".join(["TO" + "DO", "FIX" + "ME", r"\bXX" + r"X\b", "NotImplemented" + "Error"]))
MACHINE_PATH = re.compile(r"(?<![\w.~/-])/(?:work|home|root|Users)/\w")


def python_files(*folders: str) -> list[Path]:
    """Return the Python files below some top folders, without following links."""
    return sorted(path for folder in folders for path in (REPOSITORY / folder).rglob("*.py") if not through_link(path))


def through_link(path: Path) -> bool:
    """Tell whether a path below the checkout leads through a link."""
    return path.resolve() != path


def own_texts() -> list[Path]:
    """Return every text file of the project."""
    below = [path for folder in OWN_FOLDERS for path in (REPOSITORY / folder).rglob("*")]
    top = [*REPOSITORY.glob("*"), *(REPOSITORY / ".ci").glob("*")]
    named = [path for path in [*below, *top] if path.suffix in TEXT_SUFFIXES or path.name in {"Makefile", "run"}]
    return sorted(path for path in named if path.is_file() and not through_link(path))


def module_name(path: Path) -> str:
    """Return the name under which a source file is imported."""
    parts = path.relative_to(REPOSITORY).with_suffix("").parts
    parts = parts if parts[0] == "threedvc" else ("threedvc", *parts)
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def run_python(code: str) -> str:
    """Run code in a new interpreter from the checkout and return what it prints."""
    result = subprocess.run(
        [sys.executable, "-c", code], cwd=REPOSITORY, capture_output=True, text=True, check=False, timeout=120
    )
    assert result.returncode == 0, result.stderr
    return result.stdout


class TestPackaging:
    def test_declared_packages_are_the_packages_of_the_tree(self) -> None:
        folders = {path.parent for path in python_files(*SOURCE_FOLDERS)}
        in_tree = sorted(module_name(folder / "__init__.py") for folder in folders)
        assert sorted(PYPROJECT["tool"]["setuptools"]["packages"]) == in_tree

    def test_every_package_has_an_init(self) -> None:
        folders = {path.parent for path in python_files(*SOURCE_FOLDERS)}
        assert [str(folder) for folder in folders if not (folder / "__init__.py").is_file()] == []

    @pytest.mark.parametrize("name", LINKED)
    def test_links_show_the_top_folders_inside_the_package(self, name: str) -> None:
        link = REPOSITORY / "threedvc" / name
        assert link.is_symlink()
        assert link.readlink() == Path("..", name)
        assert PYPROJECT["tool"]["setuptools"]["package-dir"][f"threedvc.{name}"] == name

    def test_console_script_names_a_function(self) -> None:
        home, function = PYPROJECT["project"]["scripts"]["3dvc"].split(":")
        tree = ast.parse((REPOSITORY / Path(*home.split(".")[1:]).with_suffix(".py")).read_text(encoding="utf-8"))
        assert function in {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}

    def test_type_marker_is_declared(self) -> None:
        assert (REPOSITORY / "threedvc" / "py.typed").is_file()
        assert "py.typed" in PYPROJECT["tool"]["setuptools"]["package-data"]["threedvc"]

    def test_changelog_has_the_version(self) -> None:
        changelog = (REPOSITORY / "CHANGELOG.md").read_text(encoding="utf-8")
        assert f"## {threedvc.__version__}" in changelog

    def test_makefile_names_files_that_exist(self) -> None:
        makefile = (REPOSITORY / "Makefile").read_text(encoding="utf-8")
        listed = re.search(r"tests/unit/%\.py, ((?:.*\\\n)*.*)\)", makefile)
        assert listed is not None
        named = re.findall(r"(?:benchmarks|docs|tests)/[\w/]+\.py", makefile)
        named += [f"tests/unit/{name}.py" for name in listed[1].replace("\\", " ").split()]
        assert [name for name in named if not (REPOSITORY / name).is_file()] == []

    def test_constraints_pin_every_dependency(self) -> None:
        project = PYPROJECT["project"]
        lists = [project["dependencies"], *project["optional-dependencies"].values()]
        wanted = {re.split(r"[<>=~!\[; ]", line)[0] for lines in lists for line in lines}
        pins = re.findall(r"^([\w.-]+)==", (REPOSITORY / "constraints.txt").read_text(encoding="utf-8"), re.MULTILINE)
        assert wanted - set(pins) == set()


class TestFacade:
    def test_every_public_name_is_there(self) -> None:
        assert [name for name in threedvc.__all__ if getattr(threedvc, name, None) is None] == []
        assert set(threedvc.__all__) <= set(dir(threedvc))

    def test_every_error_is_public(self) -> None:
        assert set(errors.__all__) <= set(threedvc.__all__)

    def test_unknown_name_is_an_attribute_error(self) -> None:
        with pytest.raises(AttributeError, match="module 'threedvc' has no attribute 'transcode'"):
            _ = threedvc.transcode

    def test_import_loads_no_heavy_library(self) -> None:
        loaded = run_python("import sys, threedvc; print(*sys.modules)").split()
        assert {"numpy", "numba", "cv2", "msgpack", "zstandard", "click"} & set(loaded) == set()


class TestImports:
    def test_decoder_side_loads_no_encoder_stage(self) -> None:
        loaded = run_python(
            "import sys, threedvc.decoder.decoder, threedvc.render.renderer; print(*sys.modules)"
        ).split()
        layers = PYPROJECT["tool"]["importlinter"]["contracts"][0]["layers"]
        above = [name.strip() for layer in layers[: layers.index("decoder")] for name in layer.split(":")]
        assert "encoder" in above
        assert {f"threedvc.{name}" for name in above} & set(loaded) == set()
        assert [name for name in loaded if name.startswith("threedvc.kernels.encoder")] == []

    def test_core_opens_no_file(self) -> None:
        # The decorator of the kernels reads their sources to key its cache of compiled code.
        allowed = {REPOSITORY / "threedvc" / "kernels" / "__init__.py"}
        offenders = [path for path in python_files("threedvc") if path not in allowed and opens_files(path)]
        assert [str(path.relative_to(REPOSITORY)) for path in offenders] == []


def opens_files(path: Path) -> bool:
    """Tell whether a module calls ``open`` or imports a module that reads and writes files; memory is none."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "open":
            return True
        imported = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        if isinstance(node, ast.ImportFrom) and [alias.name for alias in node.names] != ["BytesIO"]:
            imported.append(node.module or "")
        if {"io", "pathlib", "shutil", "tempfile"} & set(imported):
            return True
    return False


class TestTexts:
    @pytest.mark.parametrize("path", python_files(*OWN_FOLDERS), ids=lambda path: str(path.relative_to(REPOSITORY)))
    def test_python_file_starts_with_its_license(self, path: Path) -> None:
        assert path.read_text(encoding="utf-8").startswith("# SPDX-License-Identifier: MIT\n")

    def test_nothing_ignored_is_tracked(self) -> None:
        if not (REPOSITORY / ".git").exists():
            pytest.skip("not a git checkout")
        command = ["git", "ls-files", "--cached", "--ignored", "--exclude-standard"]
        listed = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, check=True)
        assert listed.stdout.splitlines() == []

    @pytest.mark.parametrize("pattern", [UNFINISHED, MACHINE_PATH], ids=["unfinished", "machine path"])
    def test_no_file_holds(self, pattern: re.Pattern[str]) -> None:
        found = [
            f"{path.relative_to(REPOSITORY)}:{number}: {line.strip()}"
            for path in own_texts()
            for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
            if pattern.search(line)
        ]
        assert found == []

    def test_commands_document_is_current(self) -> None:
        assert (REPOSITORY / "docs" / "cli.md").read_text(encoding="utf-8") == make_cli.reference(), "run make docs"

    def test_links_between_documents_lead_somewhere(self) -> None:
        broken = [
            f"{path.relative_to(REPOSITORY)}: {target}"
            for path in own_texts()
            if path.suffix == ".md"
            for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", path.read_text(encoding="utf-8"))
            if "://" not in target and not (path.parent / target).exists()
        ]
        assert broken == []
