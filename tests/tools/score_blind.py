"""Scores answers to a blind campaign: `python -m tests.tools.score_blind ANSWERS.csv TRUTH.json`.

The sessions come from `dealab simulate CAMPAIGN --out RAW --truth TRUTH.json --blind`. Answers have a row per specimen: `specimen_id`, `verdict`
(`none`, `named`, `ambiguous`, `unknown`), `mechanisms` and `also_possible` (names with commas between them). Ours are
`dealab sql "SELECT specimen_id, verdict, mechanisms, also_possible FROM diagnoses" --format csv`.
"""

from __future__ import annotations

import csv
import json
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from reports.pages.campaign.places import clopper_pearson

_NAME = re.compile(r"[a-z_]+")


@dataclass(frozen=True)
class Answer:
    """What is said of a specimen: the causes named, first first, and those that are possible beside them."""

    verdict: str
    named: tuple[str, ...]
    possible: tuple[str, ...]


def read_answers(path: Path) -> dict[str, Answer]:
    """Answers by specimen."""
    with path.open(newline="", encoding="utf-8") as file:
        return {
            row["specimen_id"]: Answer(
                row["verdict"], _split(row["mechanisms"]), _split(row.get("also_possible") or "")
            )
            for row in csv.DictReader(file)
        }


def read_truth(path: Path) -> dict[str, tuple[str, ...]]:
    """What is hidden in each specimen that has recordings."""
    recordings = json.loads(path.read_text(encoding="utf-8"))["recordings"]
    return {r["specimen_id"]: tuple(r["effects"]) for r in recordings if "specimen_id" in r}


def score(answers: Mapping[str, Answer], truth: Mapping[str, Sequence[str]]) -> dict[str, tuple[int, int]]:
    """Counts of what was right, and out of how many.

    A specimen without an answer was not asked: it counts where something was to be found. `wrong name` counts specimens of which a cause is
    named without doubt that is not hidden in them.
    """
    nothing = Answer("none", (), ())
    told = {name: answers.get(name, nothing) for name in truth}
    hidden, clean = [n for n, t in truth.items() if t], [n for n, t in truth.items() if not t]
    return {
        "found that something is wrong": (sum(told[n].verdict != "none" for n in hidden), len(hidden)),
        "a right cause first": (sum(bool(told[n].named) and told[n].named[0] in truth[n] for n in hidden), len(hidden)),
        "all causes named or possible": (
            sum(set(truth[n]) <= {*told[n].named, *told[n].possible} for n in hidden), len(hidden),
        ),
        "a wrong name without doubt": (
            sum(told[n].verdict == "named" and not set(told[n].named) <= set(truth[n]) for n in truth), len(truth),
        ),
        "false alarms": (sum(told[n].verdict != "none" for n in clean), len(clean)),
    }  # fmt: skip


def print_score(counts: Mapping[str, tuple[int, int]]) -> str:
    """A line each, with 95 % limits (Clopper and Pearson)."""
    lines = []
    for what, (right, of) in counts.items():
        if of == 0:
            lines.append(f"{what}: nothing to score")
            continue
        low, high = clopper_pearson(right, of)
        lines.append(f"{what}: {right} of {of} = {right / of:.0%} ({low:.0%} to {high:.0%})")
    return "\n".join(lines)


def _split(names: str) -> tuple[str, ...]:
    return tuple(_NAME.findall(names))


if __name__ == "__main__":
    print(print_score(score(read_answers(Path(sys.argv[1])), read_truth(Path(sys.argv[2])))))
