"""The generated parts of the READMEs, each made from the one place that knows: tables, keys, protocols, the results of studies
and benchmarks, the docstrings of the map, and what the first five minutes show; and the pictures.

python -m tests.tools.docs                  renews the text
python -m tests.tools.docs --check          exits 1 when it is out of date, and names the files
python -m tests.tools.docs --pictures [LAB] renews text and pictures, from a lab's report or from the demonstration made anew
"""

from __future__ import annotations

import functools
import re
import sys
import tempfile
from collections.abc import Callable, Collection, Mapping
from pathlib import Path

from pipeline.diagnose.rules import write_table
from schemas.views import EXAMPLES, view_reference
from tests.studies.__main__ import HERE, RESULTS, about, parts
from tests.thesis.__main__ import table as table_of_the_thesis
from tests.tools import measured
from tests.tools.first_file import shown
from tests.tools.house import house_map
from tests.tools.keys import channels, formats, mapping_keys, metadata_keys, rig_keys
from tests.tools.licences import DOCUMENT as LICENCES
from tests.tools.licences import write_licences

ROOT = Path(__file__).resolve().parents[2]
README = ROOT / "README.md"


def examples() -> str:
    """The questions of `dealab sql --examples` as one SQL block."""
    return "```sql\n" + "\n\n".join(f"-- {question}\n{sql};" for question, sql in EXAMPLES) + "\n```"


def tables() -> str:
    """The tables and views with the meaning of each column."""
    from schemas.tables import reference

    return f"{reference()}\n{view_reference()}".strip()


def study(name: str, *left_out: str) -> str:
    """What a study found, from its results: its list without the lines that begin with one of `left_out`."""
    if not RESULTS.is_file():
        return "Not run yet."
    part = parts(RESULTS.read_text(encoding="utf-8")).get(about(HERE / f"study_{name}.py"), "Not run yet.")
    lines = [line for line in part.splitlines() if line.startswith("- ")]
    text = "\n".join(line for line in lines if not line.startswith(left_out)) or part
    missed = [line.removeprefix("Missed: ") for line in part.splitlines() if line.startswith("Missed: ")]
    return text + "".join(f"\n\n**Missed**: {names}" for names in missed if names != "nothing.")


def study_rates(name: str) -> str:
    """The first table of a study's results."""
    part = (
        parts(RESULTS.read_text(encoding="utf-8")).get(about(HERE / f"study_{name}.py"), "")
        if RESULTS.is_file()
        else ""
    )
    found = re.search(r"(^\|.*\n)+", part, re.MULTILINE)
    return found.group().strip() if found else "Not run yet."


PARTS: Mapping[str, Mapping[str, Callable[[], str]]] = {
    "README.md": {
        "first file": functools.partial(shown, README),
        "map": functools.partial(house_map, ROOT),
    },
    "ingest/README.md": {
        "formats": formats,
        "channels": channels,
        "mapping keys": mapping_keys,
        "metadata": metadata_keys,
        "rig keys": rig_keys,
    },
    "schemas/README.md": {"examples": examples, "tables": tables},
    "pipeline/README.md": {"fit study": functools.partial(study, "fit", "- order test, ", "- likelihood ratio", "- …")},
    "pipeline/nightly/README.md": {"costs": measured.costs},
    "pipeline/diagnose/README.md": {
        "foreign study": functools.partial(study_rates, "foreign"),
        "diagnosis study": functools.partial(study, "diagnosis"),
        "rules": write_table,
    },
    LICENCES: {"licences": write_licences},
    "reports/README.md": {"thesis": table_of_the_thesis},
    "tests/README.md": {
        "benchmarks": measured.ratios,
        "faults": measured.faults,
        "bad files": measured.bad_files,
    },
}
"""File → its generated parts by name, and what makes them."""


def renew(name: str, text: str, *, left: Collection[str] = ()) -> str:
    """The text of a file with its generated parts made again, but for those that are `left` as they are.

    Raises `SystemExit` where a part has no place in the text.
    """
    for part, make in PARTS[name].items():
        if part in left:
            continue
        begin, end = f"<!-- {part}: written by make docs -->", f"<!-- end of {part} -->"
        pattern = re.compile(re.escape(begin) + ".*?" + re.escape(end), re.DOTALL)
        if not pattern.search(text):
            raise SystemExit(f"{name} has no part {begin}")
        made = f"{begin}\n\n{make()}\n\n{end}"
        text = pattern.sub(lambda _, made=made: made, text)
    return text


PICTURES = ROOT / "reports" / "pictures"
SHOTS = {
    "finding": ("index.html", "ol.findings > li:first-child", 1010),
    "index": ("index.html", "main", 760),
    "specimen": ("specimens/PA-1.html", "section[aria-labelledby=response]", 560),
    "survival": ("campaigns/demo.html", "section[aria-labelledby=survival]", 480),
}
"""Picture → page of the demonstration's report, what of it, and its height at most in px."""


def take_pictures(lab: Path) -> None:
    """Takes all pictures of a report with Chromium, in few colours so that they stay small."""
    from io import BytesIO

    from PIL import Image

    from tests.helpers import chromium

    binary, reason = chromium.find()
    if binary is None:
        raise SystemExit(reason)
    PICTURES.mkdir(exist_ok=True)
    with chromium.running(binary) as browser:
        for name, (page, selector, most) in SHOTS.items():
            browser.open(lab / "reports" / page)
            image = Image.open(BytesIO(browser.picture(selector, most)))
            image.convert("RGB").quantize(160, dither=Image.Dither.NONE).save(PICTURES / f"{name}.png", optimize=True)


def make_demonstration(folder: Path) -> Path:
    """The lab that `make demo` makes, in that folder."""
    from pipeline.cli import main as dealab

    for night in ("1", "2"):
        dealab(["simulate", "demo", "--night", night, "--out", str(folder / "raw")])
        dealab(["nightly", str(folder / "raw"), "--lab", str(folder / "lab")])
    return folder / "lab"


def main() -> int:
    texts = {name: (ROOT / name).read_text(encoding="utf-8") for name in PARTS}
    made = {name: renew(name, text) for name, text in texts.items()}
    old = [name for name, text in texts.items() if made[name] != text]
    if "--check" in sys.argv[1:]:
        for name in old:
            print(f"{name} is out of date: make docs", file=sys.stderr)
        return int(bool(old))
    for name in old:
        (ROOT / name).write_text(made[name], encoding="utf-8")
    if "--pictures" in sys.argv[1:]:
        given = [Path(word) for word in sys.argv[1:] if not word.startswith("-")]
        with tempfile.TemporaryDirectory() as folder:
            take_pictures(given[0] if given else make_demonstration(Path(folder)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
