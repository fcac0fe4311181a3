"""The map of the house: the modules that a recording passes on its way to a page, and a specimen on its way to a verdict."""

from __future__ import annotations

import ast
from pathlib import Path

RECORDING = (
    "pipeline/nightly/night.py",
    "pipeline/nightly/look.py",
    "ingest/discover.py",
    "pipeline/nightly/read.py",
    "ingest/intake.py",
    "ingest/read.py",
    "ingest/assemble.py",
    "ingest/canonical.py",
    "ingest/samples.py",
    "pipeline/analyse/recording.py",
    "pipeline/transform/chirp.py",
    "pipeline/nightly/ownership.py",
    "pipeline/nightly/derive.py",
    "pipeline/analyse/specimen.py",
    "pipeline/fit/relaxation/identify.py",
    "pipeline/analyse/groups.py",
    "pipeline/nightly/publish.py",
    "pipeline/lab/snapshot.py",
    "reports/build.py",
)
"""In the order of a night; `transform/chirp` stands for the modules of all protocols."""
SPECIMEN = (
    "pipeline/diagnose/features/reduce.py",
    "pipeline/diagnose/diagnosis.py",
    "pipeline/diagnose/faults/find.py",
    "pipeline/diagnose/simulation/session.py",
    "pipeline/diagnose/simulation/simulation.py",
    "pipeline/diagnose/search/plain_fit.py",
    "pipeline/diagnose/search/screen.py",
    "pipeline/diagnose/search/fit_mechanisms.py",
    "pipeline/diagnose/search/several_causes.py",
    "pipeline/diagnose/search/likelihood.py",
    "pipeline/diagnose/search/posterior.py",
    "pipeline/diagnose/search/regions.py",
    "pipeline/diagnose/search/held_out.py",
    "pipeline/diagnose/judge.py",
    "pipeline/diagnose/proposals/next_recording.py",
    "pipeline/diagnose/report.py",
)
"""In the order in which a diagnosis asks them; the README of the package names them all."""


def house_map(root: Path) -> str:
    """Both ways as tables: each module with the first sentence of its docstring."""
    ways = (("A recording, from its file to a page:", RECORDING), ("A specimen, through the diagnosis:", SPECIMEN))
    return "\n\n".join(f"{title}\n\n{_table(root, modules)}" for title, modules in ways)


def _table(root: Path, modules: tuple[str, ...]) -> str:
    rows = [f"| [{name}]({name}) | {first_paragraph(root / name).replace('|', '&#124;')} |" for name in modules]
    return "\n".join(["| module | what it does |", "|---|---|", *rows])


def first_paragraph(path: Path) -> str:
    """How the docstring of a module begins, in one line. Raises `SystemExit` where the module is not."""
    if not path.is_file():
        raise SystemExit(
            f"a document names {path}, which is not there: the map of the README stands in tests/tools/house.py"
        )
    text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    return " ".join(text.split("\n\n")[0].split())
