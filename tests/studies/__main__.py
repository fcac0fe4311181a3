"""`make study`: every study of this folder, and what each found, into `results.md`.

    python -m tests.studies [NAME …] [--seed N] [--jobs N] [--minutes N]

A study is a file `study_<name>.py` with a command of its own: it takes `--seed`, prints what it found as Markdown, and
ends with another status than 0 when something that it is there to show is not so. Its docstring says what is studied. The
seed that each study has of its own is used where none is given; `--jobs` studies run at a time. A run over some renews
their parts of the file and leaves the others.
"""

from __future__ import annotations

import argparse
import ast
import os
import re
import subprocess
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from tests.helpers.machine import machine, today

HERE = Path(__file__).resolve().parent
RESULTS = HERE / "results.md"
HEAD = "# Studies\n\nMade by `make study`; not edited by hand.\n"


def about(path: Path) -> str:
    """The first sentence of a study's docstring."""
    text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or path.stem
    return " ".join(text.split("\n\n")[0].split())


def parts(text: str) -> dict[str, str]:
    """The parts of a results file by heading, each with its heading; headings that a study prints itself belong to it."""
    known = {about(path) for path in HERE.glob("study_*.py")}
    found: dict[str, str] = {}
    heading = ""
    for piece in re.split(r"^(?=## )", text, flags=re.MULTILINE)[1:]:
        first = piece.splitlines()[0].removeprefix("## ")
        heading = first if first in known else heading
        found[heading] = found.get(heading, "") + piece
    return {heading: part.rstrip() + "\n" for heading, part in found.items()}


def run(path: Path, options: Sequence[str]) -> tuple[str, bool]:
    """Runs a study: its part of the results, and whether all was as it should be."""
    begin = time.monotonic()
    done = subprocess.run(
        [sys.executable, "-m", f"tests.studies.{path.stem}", *options],
        cwd=HERE.parent.parent,
        capture_output=True,
        text=True,
        check=False,
    )
    good = done.returncode == 0
    print(done.stderr, end="", file=sys.stderr, flush=True)
    # Warnings and tracebacks name folders of this machine: the results get the error alone.
    error = done.stderr.strip().splitlines()[-1] if "Traceback" in done.stderr else ""
    found = done.stdout.strip() if good else f"{done.stdout}\n**Failed** (status {done.returncode}).\n{error}"
    how = f"{today()} · {machine()} · {' '.join(options) or 'its own seed'} · {time.monotonic() - begin:.0f} s"
    return f"## {about(path)}\n\n{found.strip()}\n\n{how}\n", good


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("names", nargs="*", help="studies to run, without study_; all when none is named")
    parser.add_argument("--seed", type=int, help="the seed of all studies in place of their own")
    parser.add_argument("--minutes", help="time after which a study that can end early begins nothing more")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    arguments = parser.parse_args()
    found = {path.stem.removeprefix("study_"): path for path in sorted(HERE.glob("study_*.py"))}
    unknown = set(arguments.names) - set(found)
    if unknown:
        print(f"no study {', '.join(sorted(unknown))}; there are {', '.join(found)}", file=sys.stderr)
        return 2
    options = [] if arguments.seed is None else ["--seed", str(arguments.seed)]
    options += [] if arguments.minutes is None else ["--minutes", arguments.minutes]
    made: dict[str, str] = {}
    all_good = True
    with ThreadPoolExecutor(arguments.jobs) as pool:
        for text, good in pool.map(lambda name: run(found[name], options), arguments.names or found):
            print(text, flush=True)
            made |= parts(text)
            all_good = all_good and good
    kept = parts(RESULTS.read_text(encoding="utf-8")) if RESULTS.is_file() else {}
    order = [about(path) for path in found.values()]
    shown = [(kept | made)[heading] for heading in order if heading in kept | made]
    RESULTS.write_text("\n".join([HEAD, *shown]), encoding="utf-8")
    return 0 if all_good else 1


if __name__ == "__main__":
    sys.exit(main())
