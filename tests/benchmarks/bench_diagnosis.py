"""Diagnosis of whole sessions, from the features of their recordings to the verdict with its proposal: processor time, one core."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.diagnose.diagnosis import diagnose
from pipeline.diagnose.features.reduce import reduce
from pipeline.diagnose.results import AMBIGUOUS, NONE, UNKNOWN
from tests.helpers.judging import Case, Judgement, hidden_in, made
from tests.helpers.kept_judgements import sessions_of
from tests.helpers.truth_rig import KINDS, Effect, random_effect

TITLE = "Diagnosis of a session, one core"
MULTIPLE = 3.0
SEED = 4_242
STUDY = Path(__file__).resolve().parents[1] / "studies" / "diagnosis.jsonl"
FULL = ("drive_lag", "cyclic_softening", "clamp_slip", "missing_relaxation", "field_dependent_permittivity")
"""Strong causes in full sessions; the last one is an offset of the drive as well, until the polarity is turned."""
AIMS = {"compact": 5.0, "full": 20.0}
"""Seconds, for orientation."""


@dataclass(frozen=True)
class _Timed:
    """Seconds of reading recordings into features and of the diagnosis, what was hidden, and the verdict."""

    reading: float
    diagnosis: float
    hidden: str
    verdict: str


def timed(case: Case, effects: tuple[Effect, ...]) -> _Timed:
    recordings = made(case, effects).recordings
    begin = time.process_time()
    features = [reduce(recording) for recording in recordings]
    read = time.process_time()
    found = diagnose(features)
    return _Timed(read - begin, time.process_time() - read, effects[0].id if effects else "", found.verdict)


def one_of_each(known: Sequence[Judgement]) -> Iterator[Judgement]:
    """The first session of every listed cause at `MULTIPLE` in a study that its diagnosis did not call clean."""
    seen = set()
    for j in known:
        if len(j.case.effects) != 1 or j.verdict == NONE:
            continue
        (id, multiple), *_ = j.case.effects
        if id not in seen and multiple == MULTIPLE and KINDS[id].listed:
            seen.add(id)
            yield j


def run() -> list[dict[str, Any]]:
    timed(Case(SEED), ())  # imports, compilation and caches
    clean = {size: [timed(Case(SEED + i, size), ()) for i in range(3)] for size in AIMS}
    base = float(np.median([t.diagnosis for t in clean["compact"]]))
    single = [timed(j.case, hidden_in(j)) for j in one_of_each(sessions_of(STUDY))]
    rng = np.random.default_rng(1)
    strong = [timed(Case(SEED, "full"), (random_effect(id, KINDS[id].typical, rng),)) for id in FULL]
    named, doubtful = _part(single)
    strong_named, strong_doubtful = _part(strong)
    return [
        _row("compact session of 10 recordings: nothing hidden", clean["compact"], "compact", base),
        _row(
            f"compact session: one cause at {MULTIPLE:g} times the smallest detectable, each once, named",
            named,
            "compact",
            base,
        ),
        _row("compact session: one such cause, the verdict leaves more open", doubtful, "compact", base),
        _row("full session of 30 recordings: nothing hidden", clean["full"], "full", base),
        _row("full session: one strong cause, named", strong_named, "full", base),
        _row("full session: one strong cause, the verdict leaves more open", strong_doubtful, "full", base),
    ]


def _part(found: Sequence[_Timed]) -> tuple[list[_Timed], list[_Timed]]:
    """Sessions whose cause is named, and those of which the verdict leaves more open."""
    doubtful = [t for t in found if t.verdict in (AMBIGUOUS, UNKNOWN)]
    return [t for t in found if t not in doubtful], doubtful


def _row(name: str, found: Sequence[_Timed], size: str, base: float) -> dict[str, Any]:
    if not found:
        return {"name": name, "note": "none"}
    seconds = np.array([t.diagnosis for t in found])
    within = int(np.sum(seconds <= AIMS[size]))
    worst = found[int(np.argmax(seconds))]
    longest = f", longest {worst.hidden} {seconds.max():.1f} s" if worst.hidden else ""
    note = (
        f"{len(found)} sessions, median {np.median(seconds):.1f} s (quartiles {np.quantile(seconds, 0.25):.1f} and"
        f" {np.quantile(seconds, 0.75):.1f}), {within} within {AIMS[size]:g} s{longest}; recordings into features before: {np.median([t.reading for t in found]):.1f} s"
    )
    return {
        "name": name,
        "seconds": float(np.median(seconds)),
        "ratio": float(np.median(seconds)) / base,
        "note": note,
    }
