"""The house keeps its shape: no module imports itself by a detour, and rooms that were cleared stay clear."""

from __future__ import annotations

from collections.abc import Mapping
from graphlib import CycleError, TopologicalSorter

import grimp
import pytest

PACKAGES = ("schemas", "ingest", "pipeline", "reports")


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
