"""Files of strangers through the night, held against what must come out: one line each.

python -m tests.strangers.check FOLDER…         folders of cases, or single cases
python -m tests.strangers.check --reading …     samples and tables alone, not the results that rest on them

A case is a folder with data files, their mappings and `expected.json`: `outcome` (`ok`, `damaged`, `quarantined`,
`unmapped`, or `either`: accepted as `if_accepted` says, or refused), `rows`, `values`, `time`, `sql`, `must_mention`.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import tomllib
from collections.abc import Iterator, Mapping
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from schemas.errors import RefusedError
from schemas.quantities import QUANTITIES
from schemas.units import conversion
from schemas.visible import shown
from tests.strangers.nights import REFUSED, UNMAPPED, NightOfOne, Taken, drafted, run_night

OK, AS_ALLOWED, WRONG = "ok", "refused as allowed", "WRONG"
_INSTANT_S = 0.0011
_RATIO = 1e-12


def judge(case: Path, *, results: bool = True) -> tuple[str, str]:
    """The verdict on one case and what it rests on. `results`: whether the queries count as well."""
    expected = json.loads((case / "expected.json").read_text(encoding="utf-8"))
    with tempfile.TemporaryDirectory() as place:
        night = run_night(case, Path(place))
        if night.crash:
            return WRONG, f"the night crashed: {night.crash}"
        if expected["outcome"] == UNMAPPED:
            return _judge_draft(case, expected, night)
        wrong: list[str] = []
        kinds = set()
        for name, facts in _facts_by_file(expected, night).items():
            taken = night.files.get(name)
            if taken is None:
                wrong.append(f"{name} is not in the database")
                continue
            verdict, what = _judge_file(taken, expected, facts, night, results)
            kinds.add(verdict)
            if verdict == WRONG:
                wrong.append(what if len(night.files) == 1 else f"{name}: {what}")
        if wrong:
            return WRONG, "; ".join(wrong)
        said = "; ".join(t.said for t in night.files.values() if t.said)
        return (AS_ALLOWED if AS_ALLOWED in kinds else OK), said


def _facts_by_file(expected: Mapping[str, Any], night: NightOfOne) -> dict[str, Mapping[str, Any]]:
    if "files" in expected:
        return dict(expected["files"])
    facts = expected.get("if_accepted", expected)
    return dict.fromkeys(night.files, facts) or {"(no file)": facts}


def _judge_file(
    taken: Taken, expected: Mapping[str, Any], facts: Mapping[str, Any], night: NightOfOne, results: bool
) -> tuple[str, str]:
    allowed = {facts.get("outcome", expected["outcome"]), *expected.get("also_accepted", ())}
    if "either" in allowed:
        allowed |= {"ok", "damaged", REFUSED}
    if taken.status not in allowed:
        return WRONG, f"status {taken.status} ({taken.said[:200]}), expected {' or '.join(sorted(allowed))}"
    unsaid = [w for w in expected.get("must_mention", ()) if w.lower() not in taken.said.lower()]
    if taken.status == REFUSED:
        if "unexpectedly" in taken.said:
            return WRONG, f"crashed: {taken.said[:200]}"
        if unsaid:
            return WRONG, f"refused without a word about {', '.join(unsaid)}: {taken.said[:200]}"
        return (OK if allowed == {REFUSED} else AS_ALLOWED), taken.said
    if taken.status == "duplicate":
        return OK, taken.said
    wrong = [*_wrong_samples(taken, facts, night), *(_wrong_results(facts, night) if results else ())]
    if unsaid and not facts.get("values") and not facts.get("sql"):
        wrong.append(f"accepted ({taken.status}) without a word about {', '.join(unsaid)}")
    return (WRONG, "; ".join(wrong)) if wrong else (OK, taken.said)


def _wrong_samples(taken: Taken, facts: Mapping[str, Any], night: NightOfOne) -> Iterator[str]:
    rows = taken.time_ns.size or _table_rows(taken, night)
    allowed = facts.get("rows_any_of", [facts["rows"]] if "rows" in facts else [])
    if allowed and rows not in allowed:
        yield f"{rows} rows, not {' or '.join(map(str, allowed))}"
    for fact in facts.get("values", ()):
        found = _value(taken, fact)
        if found is None or not _close(found, fact["value"], fact["tolerance"]):
            yield f"{fact['quantity']} at row {fact['at_row']} is {found}, not {fact['value']}"
    time = facts.get("time", {})
    if taken.time_ns.size and "duration_s" in time and abs(taken.duration_s - time["duration_s"]) > _INSTANT_S:
        yield f"{taken.duration_s:.6g} s, not {time['duration_s']}"
    if taken.time_ns.size and "first_utc" in time:
        first = datetime.fromisoformat(time["first_utc"]).timestamp()
        if abs(int(taken.time_ns[0]) * 1e-9 - first) > _INSTANT_S:
            yield f"begins {int(taken.time_ns[0]) * 1e-9 - first:+.6g} s from {time['first_utc']}"


def _table_rows(taken: Taken, night: NightOfOne) -> int:
    name = str(taken.row.get("recording_id") or "").replace("'", "''")
    lives = night.value(f"SELECT count(*) FROM lifetimes WHERE recording_id = '{name}'")
    lines = f"SELECT count(*) FROM frequency_responses WHERE recording_id = '{name}' AND stage = 'measured'"
    return int(lives or night.value(lines) or 0)


def _wrong_results(facts: Mapping[str, Any], night: NightOfOne) -> Iterator[str]:
    for fact in facts.get("sql", ()):
        found = night.value(fact["query"])
        if found is None or not _close(float(found), fact["value"], fact["tolerance"]):
            yield f"result: {fact['query']} gives {found}, not {fact['value']:.6g}"


def _value(taken: Taken, fact: Mapping[str, Any]) -> float | None:
    values = taken.columns.get(fact["quantity"])
    if values is None or not values.size:
        return None
    canonical = QUANTITIES[fact["quantity"]].unit
    place = fact["at_row"]
    if isinstance(place, int):
        found = values[place] if place < values.size else np.nan
    elif place in ("first", "last"):
        found = values[0 if place == "first" else -1]
    else:
        found = {"max": np.nanmax, "min": np.nanmin, "mean": np.nanmean}[place](values)
    try:
        return float(conversion(canonical, fact.get("unit", canonical)).apply(np.array([found]))[0])
    except RefusedError:
        return float(found)


def _close(found: float, value: float | None, tolerance: float) -> bool:
    if value is None or value != value:
        return found != found
    return abs(found - value) <= max(tolerance * abs(value), _RATIO)


def _judge_draft(case: Path, expected: Mapping[str, Any], night: NightOfOne) -> tuple[str, str]:
    """Without a mapping: the file is named as unmapped, and the draft says what a person would see in it."""
    other = [f"{t.name} is {t.status}" for t in night.files.values() if t.status != UNMAPPED]
    if other:
        return WRONG, "; ".join(other)
    text = drafted(case)
    try:
        draft = tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        draft = {}
    kind = expected.get("draft_kind")
    if kind != draft.get("kind"):
        return WRONG, f"drafted as {draft.get('kind')}, not {kind}: {text[:120]}"
    wrong = [
        f"{key} is drafted as {draft.get('recording', {}).get(key)}, not {expected[f'draft_{key}']}"
        for key in ("protocol", "loading")
        if f"draft_{key}" in expected and draft.get("recording", {}).get(key) != expected[f"draft_{key}"]
    ]
    for name, column in expected.get("draft_columns", {}).items():
        found = draft.get("columns", {}).get(name, {}).get("column")
        if found != column:
            wrong.append(f"{name} is drafted from {found!r}, not {column!r}")
    return (WRONG, "; ".join(wrong)) if wrong else (OK, f"drafted as {kind}")


def cases_in(folder: Path) -> list[Path]:
    """The cases of a folder, or the folder itself where it is one."""
    if (folder / "expected.json").is_file():
        return [folder]
    return sorted(p.parent for p in folder.glob("*/expected.json"))


def main(arguments: list[str]) -> int:
    """One line for each case; 1 where one is wrong."""
    parser = argparse.ArgumentParser(prog="python -m tests.strangers.check", description=__doc__)
    parser.add_argument("folders", nargs="+", type=Path, metavar="FOLDER")
    parser.add_argument("--reading", action="store_true", help="samples and tables alone, not the results")
    parser.add_argument("--only", default="", metavar="LETTERS", help="cases that begin with one of these letters")
    given = parser.parse_args(arguments)
    counts: dict[str, int] = {}
    for case in [case for folder in given.folders for case in cases_in(folder)]:
        if given.only and case.name[0] not in given.only:
            continue
        verdict, what = judge(case, results=not given.reading)
        counts[verdict] = counts.get(verdict, 0) + 1
        print(f"{case.name:<34} {verdict}{': ' if what else ''}{shown(what)[:400]}", flush=True)
    print(", ".join(f"{number} {verdict}" for verdict, number in sorted(counts.items())))
    return 1 if counts.get(WRONG) or not counts else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
