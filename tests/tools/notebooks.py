"""The example notebooks: executes them and keeps in them what they say, so that a reader sees it without running anything.

    python -m tests.tools.notebooks             all of reports/notebooks
    python -m tests.tools.notebooks film        one of them

A notebook runs in an empty folder that goes with it. What differs from run to run (how long a night took) is not kept.
"""

from __future__ import annotations

import os
import re
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import nbformat
from nbclient import NotebookClient

from tests.tools.first_file import without_times

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "reports" / "notebooks"
_LONGEST_S = 300
"""Of a cell, on a machine that does much else."""
_WIDTH = "110"
"""Columns of a terminal that commands are to write for."""
_WORD = re.compile(r"[+−-]?\d+(?:[.,]\d+)*|[^\s\d]+")
_KEPT = {"kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"}, "language_info": {"name": "python"}}  # fmt: skip


def list_notebooks() -> list[Path]:
    """The notebooks, by name."""
    return sorted(FOLDER.glob("*.ipynb"))


def execute(path: Path) -> Any:
    """The notebook as it is after a run of all its cells. Raises `nbclient.exceptions.CellExecutionError`."""
    notebook = nbformat.read(path, as_version=4)
    with tempfile.TemporaryDirectory() as folder:
        environment = os.environ | {
            "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
            "PYTHONPATH": str(ROOT),
            "COLUMNS": _WIDTH,
            "IPYTHONDIR": folder,
            "MPLCONFIGDIR": os.environ.get("MPLCONFIGDIR", folder),
        }
        client = NotebookClient(
            notebook,
            timeout=_LONGEST_S,
            coalesce_streams=True,
            record_timing=False,
            resources={"metadata": {"path": folder}},
            extra_arguments=["--IPKernelApp.log_level=40"],
        )
        client.execute(env=environment)
    notebook.metadata = nbformat.from_dict(_KEPT)
    for cell in notebook.cells:
        cell.metadata = nbformat.from_dict({})
        for output in cell.get("outputs", []):
            if "metadata" in output:
                output.metadata = nbformat.from_dict({})
            if output.output_type == "stream":
                output.text = without_times(output.text)
        if "outputs" in cell:
            cell.outputs = [one for one in cell.outputs if one.get("text") != ""]  # of progress alone nothing is left
    return notebook


def list_texts(notebook: Any) -> Iterator[tuple[int, str]]:
    """What the cells say in text, each with the number of its cell: streams, and results as plain text."""
    for number, cell in enumerate(notebook.cells):
        for output in cell.get("outputs", []):
            if output.output_type == "stream":
                yield number, f"{output.name}: {output.text}"
            elif "data" in output:
                yield number, f"{', '.join(sorted(output.data))}: {output.data.get('text/plain', '')}"


def find_difference(kept: Any, now: Any) -> str | None:
    """The first text that is another than the one that is kept; None: there is none.

    Another processor adds in another order, so that numbers may differ by two in their last place, whole ones by 1 %: those
    below 100 not at all. Pictures are not compared, but that there is one.
    """
    before, after = list(list_texts(kept)), list(list_texts(now))
    for (number, old), (_, new) in zip(before, after, strict=False):
        if not _are_alike(old, new):
            return f"cell {number} said\n{old}\nand says\n{new}"
    return None if len(before) == len(after) else f"{len(before)} outputs are kept, there are {len(after)}"


def _are_alike(old: str, new: str) -> bool:
    words, others = _WORD.findall(old), _WORD.findall(new)
    return len(words) == len(others) and all(map(_is_same_word, words, others))


def _is_same_word(old: str, new: str) -> bool:
    if old == new:
        return True
    try:
        a, b = (float(word.replace("−", "-").replace(",", "")) for word in (old, new))
    except ValueError:
        return False
    places = max(len(word.partition(".")[2]) for word in (old, new))
    return abs(a - b) <= (2.001 * 10**-places if places else 0.01 * abs(a))


def main() -> int:
    """Executes the notebooks that are named, or all, and writes them back."""
    for path in list_notebooks():
        if sys.argv[1:] and path.stem not in sys.argv[1:]:
            continue
        print(path.relative_to(ROOT), flush=True)
        nbformat.write(execute(path), path)
    return 0


if __name__ == "__main__":
    sys.exit(main())
