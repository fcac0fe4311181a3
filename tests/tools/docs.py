"""The generated parts of the README: examples of SQL, what studies and benchmarks found, the table reference, and
the pictures.

python -m tests.tools.docs                  renews the text
python -m tests.tools.docs --check          exits 1 when it is out of date
python -m tests.tools.docs --pictures [LAB] renews text and pictures, from a lab's report or from the demonstration made anew
"""

from __future__ import annotations

import re
import sys
import tempfile
from pathlib import Path

from schemas.protocols import PROTOCOLS
from schemas.quantities import QUANTITIES
from schemas.tables import reference
from schemas.views import EXAMPLES, view_reference
from tests.studies.__main__ import HERE, RESULTS, about, parts
from tests.tools.measured import measured

README = Path(__file__).resolve().parents[2] / "README.md"


def examples() -> str:
    """The questions of `dealab sql --examples` as one SQL block."""
    return "```sql\n" + "\n\n".join(f"-- {question}\n{sql};" for question, sql in EXAMPLES) + "\n```"


def study(name: str, *left_out: str) -> str:
    """What a study found, from its results: its list without the lines that begin with one of `left_out`."""
    if not RESULTS.is_file():
        return "Not run yet."
    part = parts(RESULTS.read_text(encoding="utf-8")).get(about(HERE / f"study_{name}.py"), "Not run yet.")
    lines = [line for line in part.splitlines() if line.startswith("- ")]
    text = "\n".join(line for line in lines if not line.startswith(left_out)) or part
    missed = [line.removeprefix("Missed: ") for line in part.splitlines() if line.startswith("Missed: ")]
    return text + "".join(f"\n\n**Missed**: {names}" for names in missed if names != "nothing.")


def channels() -> str:
    """Which channels each protocol needs, and what the channels are."""
    rows = ["| `protocol` | `loading` | channels | may have | what it is |", "| --- | --- | --- | --- | --- |"]
    for p in PROTOCOLS.values():
        needed = " or ".join(", ".join(f"`{name}`" for name in names) for names in p.required)
        more = ", ".join(f"`{name}`" for name in p.optional) or "–"
        rows.append(f"| `{p.name}` | {p.loading} | {needed} | {more} | {p.meaning} |")
    rows += ["", "| channel | in SQL | what it is |", "| --- | --- | --- |"]
    return "\n".join(rows + [f"| `{q.name}` | {q.unit} | {q.meaning} |" for q in QUANTITIES.values()])


def generated() -> tuple[tuple[str, str], ...]:
    """The generated parts by name."""
    return (
        ("channels", channels()),
        ("examples", examples()),
        ("fit study", study("fit", "- order test, ", "- likelihood ratio", "- …")),
        ("diagnosis study", study("diagnosis")),
        ("measured", measured()),
        ("tables", f"{reference()}\n{view_reference()}".strip()),
    )


def renewed(text: str) -> str:
    """The README's text with its generated parts made again."""
    for name, made in generated():
        begin, end = f"<!-- {name}: written by make docs -->", f"<!-- end of {name} -->"
        pattern = re.compile(re.escape(begin) + ".*?" + re.escape(end), re.DOTALL)
        if not pattern.search(text):
            raise SystemExit(f"README.md has no part {begin}")
        text = pattern.sub(lambda _, b=begin, m=made, e=end: f"{b}\n\n{m}\n\n{e}", text)
    return text


PICTURES = README.parent / "reports" / "pictures"
SHOTS = {
    "finding": ("index.html", "ol.findings > li:first-child", 1010),
    "index": ("index.html", "main", 760),
    "specimen": ("specimens/PA-1.html", "section[aria-labelledby=response]", 560),
    "survival": ("campaigns/thesis.html", "section[aria-labelledby=survival]", 480),
    "control": ("control.html", "section[aria-labelledby=rigs]", 340),
}
"""Picture → page of the demonstration's report, what of it, and its height at most in px."""


def pictures(lab: Path) -> None:
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


def demonstration(folder: Path) -> Path:
    """The lab that `make demo` makes, in that folder."""
    from pipeline.cli import main as dealab

    dealab(["simulate", "thesis", "--out", str(folder / "raw")])
    dealab(["nightly", str(folder / "raw"), "--lab", str(folder / "lab")])
    return folder / "lab"


def main() -> int:
    text = README.read_text(encoding="utf-8")
    new = renewed(text)
    if "--check" in sys.argv[1:]:
        return int(text != new)
    README.write_text(new, encoding="utf-8")
    if "--pictures" in sys.argv[1:]:
        given = [Path(word) for word in sys.argv[1:] if not word.startswith("-")]
        with tempfile.TemporaryDirectory() as folder:
            pictures(given[0] if given else demonstration(Path(folder)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
