"""Diagnosis of sessions with hidden effects: false alarms, detection, right causes, gains, unknown effects.

    python -m tests.studies.study_diagnosis [--seed N] [--jobs N] [--clean N] [--per-mechanism N] [--pairs N] [--unlisted N]
                                            [--severities N] [--size compact|full] [--minutes N] [--log FILE]

The truth rig integrates in time and gives every effect a form that the extensions do not have. Severities
are multiples of the smallest detectable one of the same specimen's clean session, which is one of the clean ones. Rates stand with
95 % intervals (Clopper and Pearson). `--minutes` ends the study early: what was not begun is left out and counted. Targets that are
missed are named. A share that is wanted within ten points needs more than the forty effects whose severity is defined: further ones
count for that share alone. Every judgement is kept in `diagnosis.jsonl`, or `--log`: a study that was ended goes on where it
stopped, as long as the code is the same. The seed is a fresh one for every study that begins, where none is given.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from reports.pages.campaign.places import clopper_pearson
from schemas.errors import NotIdentifiableError
from tests.helpers.judging import INSEPARABLE, Case, Judgement, judged
from tests.helpers.kept_judgements import Kept, digest
from tests.helpers.truth_rig import KINDS, MECHANISMS, UNLISTED
from tests.studies.confusion import confusion_svg

HERE = Path(__file__).resolve().parent
MULTIPLES = (1.5, 2.0, 3.0, 4.0)
SEEDS = 100_000
_FOR_SEVERITY = 8000
"""Place of the seeds of sessions that count for the severity alone."""
REMOVED = 0.8


def cases(
    seed: int, size: str, clean: int, per_mechanism: int, pairs: int, unlisted: int, severities: int = 0
) -> list[Case]:
    """All sessions of a study, mixed so that an early end leaves a fair share of each sort.

    Each with an effect brings the clean session of its specimen with it: no two have the same seed.
    """
    rng = np.random.default_rng(seed)
    sorts: list[list[Case]] = [[Case(seed * 10_000 + 7000 + i, size) for i in range(clean)]]
    single = []
    for i in range(per_mechanism):
        for number, id in enumerate(MECHANISMS):
            multiple = MULTIPLES[(i + number) % len(MULTIPLES)]
            single.append(Case(seed * 10_000 + len(single), size, ((id, multiple),)))
    sorts.append(single)
    both = []
    while len(both) < pairs:
        first, second = rng.choice(len(MECHANISMS), 2, replace=False)
        ids = frozenset({MECHANISMS[first], MECHANISMS[second]})
        if "gain_error" in ids or any(ids <= group for group in INSEPARABLE):
            continue
        both.append(Case(seed * 10_000 + 3000 + len(both), size, ((MECHANISMS[first], 4.0), (MECHANISMS[second], 4.0))))
    sorts.append(both)
    sorts.append([Case(seed * 10_000 + 5000 + i, size, ((UNLISTED[i % len(UNLISTED)], 4.0),)) for i in range(unlisted)])
    exact = [id for id in MECHANISMS if KINDS[id].exact]
    further = []
    for i in range(severities):
        multiple = MULTIPLES[(i + i // len(exact)) % len(MULTIPLES)]
        further.append(Case(seed * 10_000 + _FOR_SEVERITY + i, size, ((exact[i % len(exact)], multiple),)))
    sorts.append(further)
    placed = [((k + 0.5) / len(sort), case) for sort in sorts for k, case in enumerate(sort)]
    return [case for _, case in sorted(placed, key=lambda pair: pair[0])]


def rate(hits: Sequence[bool]) -> str:
    """Share with its 95 % interval, in per cent."""
    n, k = len(hits), sum(hits)
    if n == 0:
        return "–"
    low, high = clopper_pearson(k, n)
    return f"{100 * k / n:.1f} % ({k}/{n}; {100 * low:.1f} to {100 * high:.1f} %)"


def separable(j: Judgement) -> bool:
    """Whether the truth and what was named are no declared hard pair, and the effect no gain that the material absorbs."""
    return j.hidden[0] != "gain_error" and not any({j.hidden[0], j.first} <= group for group in INSEPARABLE)


def for_severity(j: Judgement) -> bool:
    """Whether a judgement of a hidden effect counts for the severity alone."""
    return bool(j.hidden) and j.case.seed % 10_000 >= _FOR_SEVERITY


@dataclass(frozen=True)
class Rate:
    """A row of the study: what was asked, and how often it was so; a target where the share has bounds."""

    name: str
    hits: Sequence[bool]
    wanted: str = ""
    least: float = 0.0
    most: float = 1.0

    @property
    def missed(self) -> bool:
        """Whether the rate is not where it is wanted; of a target that nothing was seen of it is not known to be."""
        if not self.wanted:
            return False
        return not self.hits or not self.least <= sum(self.hits) / len(self.hits) <= self.most


@dataclass(frozen=True)
class Sorts:
    """Judgements by what was hidden; effects that a specimen's recordings cannot show are left out."""

    clean: Sequence[Judgement]
    single: Sequence[Judgement]
    pairs: Sequence[Judgement]
    unlisted: Sequence[Judgement]
    severities: Sequence[Judgement]

    @classmethod
    def of(cls, found: Sequence[Judgement]) -> Sorts:
        shown = [j for j in found if j.verdict != "not detectable"]
        more = [j for j in shown if for_severity(j)]
        shown = [j for j in shown if not for_severity(j)]
        return cls(
            clean=[j for j in shown if not j.hidden],
            single=[j for j in shown if len(j.hidden) == 1 and j.hidden[0] in MECHANISMS],
            pairs=[j for j in shown if len(j.hidden) == 2],
            unlisted=[j for j in shown if j.hidden and j.hidden[0] in UNLISTED],
            severities=more,
        )

    @property
    def seen(self) -> Sequence[Judgement]:
        return [j for j in self.single if j.found]


def rates(sorts: Sorts) -> list[Rate]:
    """All rates but that of the error removed, which is pooled."""
    seen, unlisted = sorts.seen, sorts.unlisted
    fair = [j for j in seen if separable(j)]
    biased = [j for j in seen if j.first == j.hidden[0] and j.bias > 2]
    ambiguous = [j for j in seen if j.split is not None]
    return [
        Rate("false alarms in clean sessions", [j.found for j in sorts.clean], "≤ 1 %", most=0.01),
        Rate("effects at ≥ 1.5 × the smallest detectable: detected", [j.found for j in sorts.single], "≥ 95 %", 0.95),
        Rate("… the right cause first, outside the declared hard pairs", [j.first == j.hidden[0] for j in fair], "≥ 90 %", 0.9),
        Rate("… the right cause first, all", [j.first == j.hidden[0] for j in seen]),
        Rate("… the right cause named or among the possible ones", [j.hidden[0] in (*j.named, *j.possible) for j in seen], "≥ 98 %", 0.98),
        Rate("… called unknown", [j.verdict == "unknown" for j in seen]),
        Rate("causes ambiguous: a recording that could tell them apart exists and is proposed", [j.proposed for j in ambiguous]),
        Rate("… the recording proposed, once made, leaves the right cause alone", [bool(j.split) for j in ambiguous if j.proposed], "≥ 90 %", 0.9),
        Rate("severity within its 90 % interval (forms that define it)", [bool(j.covered) for j in (*seen, *sorts.severities) if j.covered is not None], "85–95 %", 0.85, 0.95),
        Rate("material nearer to the truth where it was biased by more than 2 σ", [j.nearer for j in biased], "≥ 95 %", 0.95),
        Rate("two effects at 4 ×: both named", [set(j.hidden) <= {*j.named} for j in sorts.pairs], "≥ 80 %", 0.8),
        Rate("two effects at 4 ×: both named or possible", [set(j.hidden) <= {*j.named, *j.possible} for j in sorts.pairs]),
        Rate("effects in no list at 4 ×: unknown, ambiguous or nothing found", [j.verdict != "named" for j in unlisted], "≥ 70 %", 0.7),
        Rate("effects in no list at 4 ×: a wrong name without doubt", [j.verdict == "named" for j in unlisted], "≤ 10 %", most=0.1),
    ]  # fmt: skip


def removed(sorts: Sorts) -> tuple[float, int]:
    """Share of the removable held-out error that extensions by the right cause at ≥ 3 × remove, pooled, and their number."""
    strong = [j for j in sorts.seen if j.case.effects[0][1] >= 3 and j.first == j.hidden[0] and j.size]
    removable = sum(j.size * j.before for j in strong)
    return (sum(j.size * (j.before - j.after) for j in strong) / removable if removable else float("nan")), len(strong)


def report(found: Sequence[Judgement]) -> Iterable[str]:
    """The tables of the study in Markdown."""
    sorts = Sorts.of(found)
    for r in rates(sorts):
        yield f"- {r.name}: {rate(r.hits)}" + (f", wanted {r.wanted}" if r.wanted else "")
    share, number = removed(sorts)
    yield f"- removable held-out error removed at ≥ 3 ×, pooled: {100 * share:.1f} % ({number} sessions), wanted ≥ {100 * REMOVED:.0f} %"
    yield ""
    yield "| hidden | sessions | detected | right cause first | named otherwise |\n| --- | --- | --- | --- | --- |"
    for id in [*MECHANISMS, *UNLISTED]:
        own = [j for j in (*sorts.single, *sorts.unlisted) if j.hidden[0] == id]
        if not own:
            continue
        other = Counter(j.first for j in own if j.found and j.first != id)
        words = ", ".join(f"{name} {n}" for name, n in other.most_common(3))
        right = "–" if id in UNLISTED else f"{sum(j.first == id for j in own)}"
        yield f"| {id} | {len(own)} | {sum(j.found for j in own)} | {right} | {words} |"


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--seed", type=int)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--size", choices=("compact", "full"), default="compact")
    parser.add_argument("--clean", type=int, default=200)
    parser.add_argument("--per-mechanism", type=int, default=8)
    parser.add_argument("--pairs", type=int, default=40)
    parser.add_argument("--unlisted", type=int, default=42)
    parser.add_argument("--severities", type=int, default=120)
    parser.add_argument("--minutes", type=float, default=float("inf"))
    parser.add_argument("--log", type=Path, default=HERE / "diagnosis.jsonl")
    given = parser.parse_args(arguments)
    kept = Kept(given.log, digest())
    seed = next(s for s in (given.seed, kept.seed(), int(np.random.default_rng().integers(SEEDS))) if s is not None)
    kept.begin()
    chosen = cases(seed, given.size, given.clean, given.per_mechanism, given.pairs, given.unlisted, given.severities)
    begin = time.monotonic()
    found = list(run(chosen, given.jobs, lambda: time.monotonic() - begin < 60 * given.minutes, kept, seed))
    of = sum(1 + bool(c.effects) for c in chosen)
    print(f"{len(found)} of {of} sessions ({given.size}), seed {seed}, {given.jobs} at a time.\n")
    for why in kept.refused(seed):
        print(f"Left out, for its features cannot be read: {why}.\n")
    print("\n".join(report(found)))
    print(f"\nMissed: {'; '.join(missed(found)) or 'nothing'}.")
    drawn = [j for j in found if not for_severity(j)]
    (HERE / "diagnosis.svg").write_text(confusion_svg(drawn), encoding="utf-8")
    return int(bool(missed(found)))


def missed(found: Sequence[Judgement]) -> list[str]:
    """Targets that are not met."""
    sorts = Sorts.of(found)
    names = [r.name.removeprefix("… ") for r in rates(sorts) if r.missed]
    return names if removed(sorts)[0] >= REMOVED else [*names, "held-out error removed"]


def run(chosen: Sequence[Case], jobs: int, going: Callable[[], bool], kept: Kept, seed: int) -> Iterable[Judgement]:
    """Judgements: those that are kept, then others in the order in which they were asked for."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ[name] = "1"
    known = kept.judgements(seed)
    for case in chosen:
        yield from known.get(case, ())
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        waiting = [case for case in chosen if case not in known][::-1]
        running: list[tuple[Case, Future[tuple[Judgement, ...]]]] = []
        while waiting or running:
            while waiting and len(running) < 2 * jobs:
                if not going():
                    waiting.clear()
                    break
                case = waiting.pop()
                running.append((case, pool.submit(judged, case)))
            if not running:
                break
            case, future = running.pop(0)
            try:
                found = future.result()
            except NotIdentifiableError as error:
                kept.refuse(seed, case, str(error))
                continue
            kept.add(seed, case, found)
            yield from found


if __name__ == "__main__":
    sys.exit(main())
