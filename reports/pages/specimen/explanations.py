"""The part of a diagnosis that lists what may be behind a session with probabilities: listed causes, several, none, or one without a name."""

from __future__ import annotations

import json

from reports.blocks import Block, Head, Heading, Row, Table, bar
from reports.pages.draft import Draft
from reports.results import Query
from reports.results import Row as Record
from schemas.mechanisms import plain_name
from schemas.numbers import capital, probability

_TOLD = 0.99
"""Probability that the rows of the table hold together."""
_ROWS = 8
_PLAIN = "plain"
_WORDS = {
    _PLAIN: "nothing: the simulation is right within the noise",
    "anything": "something else in a few recordings, of any kind",
}
_SQL = "SELECT probabilities FROM diagnoses WHERE specimen_id = $specimen"


def blocks(draft: Draft, d: Record) -> list[Block]:
    """The most probable explanations, fewest first that hold 99 % together; nothing where probabilities were not computed.

    Parameters
    ----------
    draft : the specimen's page
    d : its row of `diagnoses`
    """
    known: dict[str, float] = json.loads(d["probabilities"] or "{}")
    if d["verdict"] == "none" or not known:
        return []
    rows: list[Row] = []
    total = 0.0
    for name, p in sorted(known.items(), key=lambda item: -item[1])[:_ROWS]:
        rows.append(Row((capital(describe(name)), bar(p, chosen=not rows, text=probability(p))), "" if rows else "sel"))
        total += p
        if total >= _TOLD:
            break
    heads = (Head("Explanation"), Head("Probability", "barcell"))
    below = (
        "All explanations are compared under one likelihood that allows each a form that is not quite right; the plain model"
        " counts among them."
    )
    query = Query(_SQL, {"specimen": draft.item})
    note = (
        f"{len(rows)} of {len(known)} that were compared {'holds' if len(rows) == 1 else 'hold'} {probability(total)}"
    )
    return [
        Heading("Why: the causes, ranked"),
        Table("What may be behind it", heads, tuple(rows), query.shown(), note, below),
    ]


def describe(hypothesis: str) -> str:
    """A hypothesis of the column `probabilities` in words."""
    return " + ".join(_describe_one(name) for name in hypothesis.split("+"))


def _describe_one(name: str) -> str:
    if name in _WORDS:
        return _WORDS[name]
    stage, slash, covariate = name.partition("/")
    if slash:
        return f"an effect without a name: {stage} over {covariate.replace('_', ' ')}"
    return plain_name(name)
