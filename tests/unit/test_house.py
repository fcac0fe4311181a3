"""The house keeps its shape: no module imports itself by a detour, and rooms that were cleared stay clear."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import grimp
import pytest

from tests.conftest import ROOT

MODULE = re.compile(r"^\s*(?:from|import) (tests\.\w+\.\w+)", re.MULTILINE)
PACKAGES = ("schemas", "ingest", "pipeline", "reports")
ROOMS_WITHIN_THE_LENGTH = ("pipeline/commands", "pipeline/lab", "pipeline/nightly")


def find_cycles(imports: Mapping[str, set[str]]) -> list[str]:
    """Cycles among modules, by what each imports; every one that is found is cut where it was met, until none is left."""
    left = {name: set(found) for name, found in imports.items()}
    cycles = []
    while True:
        try:
            TopologicalSorter(left).prepare()
        except CycleError as error:
            imported, importer, *_ = cycle = error.args[1]
            cycles.append(" imports ".join(reversed(cycle)))
            left[importer].remove(imported)
        else:
            return cycles


@pytest.mark.parametrize(
    ("imports", "number"),
    [
        ({"a": {"b"}, "b": {"c"}, "c": set()}, 0),
        ({"a": {"b"}, "b": {"c"}, "c": {"a"}}, 1),
        ({"a": {"b"}, "b": {"a", "c"}, "c": {"d"}, "d": {"c"}}, 2),
    ],
)
def test_cycles_are_found(imports: dict[str, set[str]], number: int) -> None:
    assert len(find_cycles(imports)) == number


def test_no_module_imports_itself_by_a_detour() -> None:
    """Also not for the sake of types alone: a detour of names is one for the reader as well."""
    graph = grimp.build_graph(*PACKAGES, cache_dir=None)
    assert find_cycles({name: graph.find_modules_directly_imported_by(name) for name in graph.modules}) == []


def test_helpers_of_two_folders_are_in_the_folder_of_helpers() -> None:
    """A studies' own command may be called by the test of it; everything else that two folders share is in `tests/helpers`."""
    tests = Path(__file__).resolve().parents[1]
    shared = {}
    for path in tests.rglob("*.py"):
        folder = path.relative_to(tests).parts[0]
        for name in MODULE.findall(path.read_text(encoding="utf-8")):
            home, _, module = name.removeprefix("tests.").partition(".")
            if home not in (folder, "helpers", "tools") and not module.startswith(("study_", "__main__")):
                shared[name] = path.relative_to(tests).as_posix()
    assert shared == {}


def test_the_night_has_few_modules() -> None:
    """Its steps and what all of them use; see the picture in the package's docstring."""
    modules = {path.stem for path in (ROOT / "pipeline" / "nightly").rglob("*.py")} - {"__init__"}
    assert len(modules) <= 10
    picture = (ROOT / "pipeline" / "nightly" / "__init__.py").read_text(encoding="utf-8")
    assert {name for name in modules if f"{name}.py" not in picture} == set()


def test_lines_end_before_the_declared_length() -> None:
    """The formatter breaks code, not text; a page that scrolls sideways is not read."""
    with (ROOT / "pyproject.toml").open("rb") as file:
        limit = tomllib.load(file)["tool"]["ruff"]["line-length"]
    long = [
        f"{path.relative_to(ROOT)}:{number}"
        for room in ROOMS_WITHIN_THE_LENGTH
        for path in sorted((ROOT / room).rglob("*.py"))
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1)
        if len(line) > limit
    ]
    assert long == []
