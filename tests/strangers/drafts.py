"""How good the drafts of mappings are: each data file of a corpus drafted without its mapping, held against it.

python -m tests.strangers.drafts FOLDER…        folders of cases (default: our own files)

Held against the mapping of the case, or against what its `expected.json` says a person would recognise (`draft_…`):

- protocol: kind of file, protocol and loading of a recording;
- units: a unit that is drafted without a question and means another one is wrong;
- columns: each is mapped to its quantity, or named as not recognised; one that is neither is lost.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import tempfile
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ingest.cell_units import same_unit
from ingest.columns import ColumnFile
from ingest.draft import make_draft
from ingest.draft_text import UNANSWERED, toml_string
from ingest.mapping import FileMapping, format_of
from ingest.mapping_keys import RECORDING
from ingest.parts import content_of_part, name_parts
from ingest.read import open_columns
from schemas.errors import DealabError
from schemas.protocols import PROTOCOLS
from schemas.quantities import QUANTITIES
from schemas.units import ANY

HERE = Path(__file__).resolve().parent
OWN = (HERE / "files", HERE / "drafted")
"""Cases that go through the night as well, and those that are only drafted."""
_NO_DATA = ("expected.json", "README", "README.md")
_CONTRADICTED = (
    "header_unit_against_mapping",
    "unit_row_mpa_against_kpa",
    "bode_degrees_called_rad",
    "header_time_ms_mapping_s",
    "unit_row_time_conflict",
    "h5_unit_attribute_conflict",
)
"""Cases whose mapping is wrong about a unit on purpose: what the file says is right there."""
_TABLE_UNITS = {"frequency": "Hz", "storage": "MPa", "loss": "MPa", "lifetime": "s", "voltage": "kV", "time": "s"}
_TABLE_UNITS |= {"phase": "rad", "magnitude": "N/mm", "relaxation": "MPa", "test_duration": "s"}


@dataclass
class Judgement:
    """What is wrong with the draft of one file; `protocol` None where nothing says which it is."""

    name: str
    protocol: bool | None = None
    drafted_as: str = ""
    columns: int = 0
    recognised: int = 0
    asked_units: int = 0
    wrong: list[str] = field(default_factory=list)
    wrong_units: list[str] = field(default_factory=list)
    lost: list[str] = field(default_factory=list)


def judge(case: Path) -> Iterator[Judgement]:
    """A judgement for each data file of a case."""
    folder = case / "raw" if (case / "raw").is_dir() else case
    said = case / "expected.json"
    expected = json.loads(said.read_text(encoding="utf-8")) if said.is_file() else {}
    for path in sorted(p for p in folder.iterdir() if p.is_file() and p.suffix != ".toml" and p.name not in _NO_DATA):
        truth = _truth(path)
        if (truth or any(key.startswith("draft_") for key in expected)) and format_of(path) != "mcap":
            yield _judge_file(case.name, path, truth, expected)


def _truth(path: Path) -> dict[str, Any]:
    own, shared = path.with_name(path.name + ".toml"), path.with_name("recordings.toml")
    try:
        if own.is_file():
            return tomllib.loads(own.read_text(encoding="utf-8"))
        if shared.is_file():
            entries = tomllib.loads(shared.read_text(encoding="utf-8"))["files"]
            return next((dict(e) for e in entries if path.match(e["match"])), {})
    except (ValueError, RecursionError):
        pass
    return {}


def _judge_file(name: str, path: Path, truth: Mapping[str, Any], expected: Mapping[str, Any]) -> Judgement:
    found = Judgement(f"{name}/{path.name}")
    with tempfile.TemporaryDirectory() as place:
        alone = Path(shutil.copy(path, place))
        try:
            made = make_draft(alone)
            text, asked = made.as_toml(), {q.key for q in made.questions}
        except DealabError as error:
            text, asked = "", set()
            found.drafted_as = str(error)[:100]
        draft = tomllib.loads(text)
        _judge_protocol(found, draft, truth, expected)
        if draft:
            _judge_columns(found, draft, truth, asked, name)
            _judge_lost(found, alone, draft, text)
            found.asked_units = sum(key.endswith(".unit") for key in asked)
    return found


def _judge_protocol(
    found: Judgement, draft: Mapping[str, Any], truth: Mapping[str, Any], expected: Mapping[str, Any]
) -> None:
    said = truth.get("recording", {})
    if "draft_kind" in expected:
        kind, protocol, loading = (expected.get(f"draft_{key}") for key in ("kind", "protocol", "loading"))
        if kind == RECORDING and protocol is None:
            return
    else:
        kind, protocol, loading = truth.get("kind", RECORDING), said.get("protocol"), said.get("loading")
    if kind == RECORDING and (protocol, loading) not in PROTOCOLS:
        return
    wanted = f"{protocol}, {loading}" if kind == RECORDING else str(kind)
    got = draft.get("kind")
    names = name_parts(draft)
    abouts = [content_of_part(draft, n)["recording"] for n in names] if names else [draft.get("recording", {})]
    tests = [f"{a.get('protocol')}, {a.get('loading')}" if got == RECORDING else str(got) for a in abouts]
    if draft:
        found.drafted_as = " and ".join(tests)
    found.protocol = (
        (wanted in tests) if draft else kind is None
    )  # a file may hold more tests than the one it is kept for
    if not found.protocol:
        found.wrong.append(f"{found.drafted_as or 'no draft'} instead of {wanted}")


def _judge_columns(
    found: Judgement, draft: Mapping[str, Any], truth: Mapping[str, Any], asked: set[str], name: str
) -> None:
    mapped = {"time": truth["time"]} if "column" in truth.get("time", {}) else {}
    mapped |= truth.get("columns", {})
    drafted = {"time": draft["time"]} if "column" in draft.get("time", {}) else {}
    drafted |= draft.get("columns", {})
    for quantity, column in mapped.items():
        if "column" not in column:
            continue
        found.columns += 1
        got = drafted.get(quantity, {})
        found.recognised += bool(got)
        raw_volts = column.get("scale", 1.0) != 1.0
        unit, right = got.get("unit"), column.get("unit")
        if not unit or not right or raw_volts or name in _CONTRADICTED or got.get("scale", 1.0) != 1.0:
            continue
        if (f"{quantity}.unit" if quantity == "time" else f"columns.{quantity}.unit") in asked:
            continue
        canonical = "s" if quantity == "time" else _TABLE_UNITS.get(quantity) or _unit_in_sql(quantity)
        if canonical != ANY and same_unit(unit, right, canonical) is False:
            found.wrong_units.append(f"{quantity} in {unit} instead of {right}")


def _unit_in_sql(quantity: str) -> str:
    return QUANTITIES[quantity].unit if quantity in QUANTITIES else ANY


def _judge_lost(found: Judgement, path: Path, draft: Mapping[str, Any], text: str) -> None:
    answered = tomllib.loads(text.replace(f'= "{UNANSWERED}"', "= 1.0"))
    try:
        mapping = FileMapping.parse(answered, stem=path.stem, suffix=path.suffix)
        file: ColumnFile = open_columns(path, str(format_of(path, mapping)), mapping)
    except DealabError as error:
        found.wrong.append(f"the draft does not open the file: {error}")
        return
    names = file.names()
    text = text.replace("\\n", " ")  # a name of two lines is read as one
    for place, name in enumerate(names):
        label = name if name and names.count(name) == 1 else str(place)
        if name and toml_string(label)[1:-1] not in text and f"= {place}" not in text:
            found.lost.append(label)


def main(arguments: list[str]) -> int:
    """A line for each file with something wrong, and the score; 1 where it is below what is asked."""
    parser = argparse.ArgumentParser(prog="python -m tests.strangers.drafts", description=__doc__)
    parser.add_argument("folders", nargs="*", type=Path, metavar="FOLDER", default=list(OWN))
    parser.add_argument("--all", action="store_true", help="a line for each file, right or wrong")
    given = parser.parse_args(arguments)
    found = [f for folder in given.folders for case in sorted(folder.iterdir()) if case.is_dir() for f in judge(case)]
    for one in found:
        said = [*one.wrong, *(f"WRONG UNIT {u}" for u in one.wrong_units), *(f"LOST COLUMN {c}" for c in one.lost)]
        if said or given.all:
            print(f"{one.name:<55} {'; '.join(said) or one.drafted_as}")
    judged = [one for one in found if one.protocol is not None]
    right = sum(bool(one.protocol) for one in judged)
    units, lost = sum(len(one.wrong_units) for one in found), sum(len(one.lost) for one in found)
    recognised, columns = sum(one.recognised for one in found), sum(one.columns for one in found)
    print(f"{len(found)} files; protocol right in {right} of {len(judged)} ({right / max(1, len(judged)):.1%})")
    print(f"{units} wrong units, {sum(one.asked_units for one in found)} asked for; {lost} lost columns")
    print(f"{recognised} of {columns} mapped columns recognised")
    return 0 if judged and right >= 0.9 * len(judged) and not units and not lost else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
