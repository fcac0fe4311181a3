"""The example notebooks: they run as they stand, and say what they are kept with."""

from __future__ import annotations

import ast
import re
from pathlib import Path
from typing import Any

import nbformat
import pytest

from tests.tools.notebooks import FOLDER, ROOT, execute, find_difference, list_notebooks, list_texts

NOTEBOOKS = list_notebooks()
ASKED_FOR = {"dealab", "duckdb", "matplotlib", "numpy", "pandas", "scipy"}
OWN = {"json", "os", "pathlib", "tempfile"}
"""Modules of Python's own that they use."""
WORDS = 700
"""A notebook of more text is not read over a coffee."""


def read(path: Path) -> Any:
    return nbformat.read(path, as_version=4)


def without_magics(code: str) -> str:
    """The Python of a cell; commands of a shell stand in others, or on lines that begin with `!`."""
    return "" if code.startswith("%%") else re.sub(r"^!.*$", "", code, flags=re.MULTILINE)


def test_there_are_notebooks() -> None:
    """The rest of this module is parametrized by them."""
    assert {path.stem for path in NOTEBOOKS} >= {"film", "lives", "diagnosis", "design"}


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_read_over_a_coffee_and_knows_the_public_door_alone(path: Path) -> None:
    notebook = read(path)
    nbformat.validate(notebook)
    texts = [cell.source for cell in notebook.cells if cell.cell_type == "markdown"]
    assert texts[0].startswith("# ")
    assert sum(len(text.split()) for text in texts) <= WORDS
    for target in re.findall(r"\]\(([^)\s]+)\)", "\n".join(texts)):
        assert (FOLDER / target).exists(), target
    for cell in notebook.cells:
        if cell.cell_type != "code":
            continue
        for node in ast.walk(ast.parse(without_magics(cell.source))):
            names = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            names += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            assert {name.partition(".")[0] for name in names} <= ASKED_FOR | OWN


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_what_a_notebook_is_kept_with_is_for_a_reader(path: Path) -> None:
    """It has run from top to bottom without a warning, shows its pictures, and tells no folder and no duration of the machine."""
    notebook = read(path)
    counts = [cell.execution_count for cell in notebook.cells if cell.cell_type == "code"]
    assert counts == list(range(1, len(counts) + 1))
    texts = list(list_texts(notebook))
    assert not [text for _, text in texts if text.startswith("stderr")]
    assert not [text for _, text in texts if re.search(r"(?:^|[\s'\"(])(?:/[\w.-]+){2,}|[A-Z]:\\", text)]
    assert not [text for _, text in texts if re.search(r"\d s\.$", text, re.MULTILINE)]
    figures = [text for _, text in texts if "<Figure" in text]
    assert figures
    assert all(text.startswith("image/png") for text in figures)
    assert path.stat().st_size < 500_000


def test_readers_find_every_notebook() -> None:
    for document in ("schemas/README.md", "reports/README.md"):
        found = set(re.findall(r"notebooks/(\w+)\.ipynb\)", (ROOT / document).read_text(encoding="utf-8")))
        assert found == {path.stem for path in NOTEBOOKS}, document


@pytest.mark.slow
@pytest.mark.long_after(1)
@pytest.mark.parametrize("path", sorted(NOTEBOOKS, key=lambda path: path.stem != "film"), ids=lambda path: path.stem)
def test_a_notebook_says_what_it_is_kept_with(path: Path) -> None:
    difference = find_difference(read(path), execute(path))
    assert difference is None, f"{difference}\nrun python -m tests.tools.notebooks {path.stem}"


def outputs(*texts: str) -> Any:
    cell = nbformat.v4.new_code_cell(outputs=[nbformat.v4.new_output("stream", name="stdout", text=t) for t in texts])
    return nbformat.v4.new_notebook(cells=[cell])


@pytest.mark.parametrize(
    ("kept", "now", "alike"),
    [
        (["k0 1.959 MPa"], ["k0 1.958 MPa"], True),
        (["k0 1.959 MPa"], ["k0 1.949 MPa"], False),
        (["exponent −9.6"], ["exponent −9.5"], True),
        (["exponent −9.6"], ["exponent 9.6"], False),
        (["24 films"], ["23 films"], False),
        (["2200 times"], ["2210 times"], True),
        (["named"], ["none"], False),
        (["a", "b"], ["a"], False),
    ],
)
def test_a_number_may_differ_in_its_last_place_and_a_word_may_not(kept: list[str], now: list[str], alike: bool) -> None:
    assert (find_difference(outputs(*kept), outputs(*now)) is None) == alike
