"""How often is the diagnosis right on rigs that were written apart from it and from each other?

    python -m tests.studies.study_foreign [--seed N] [--rigs NAME …] [--folder DIR] [--kinds KIND …] [--sessions N] [--minutes N]
                                          [--jobs N] [--log FILE] [--again [--of SEED …]]

Every rig of `tests/foreign` makes sessions with nothing hidden, one cause, an effect that is in no list, two causes, or an everyday
fault. They are written as raw files, read, and diagnosed. The seed is a fresh one where none is given: what is reported comes from sessions
that nobody has seen. `--sessions` of each kind and rig; `--minutes` ends the study early, with a fair share of each kind.
Every answer is kept in `foreign.jsonl`, or `--log`; `--again` reports what is kept there. Intervals are those of Clopper and Pearson, 95 %.
The amplifiers of the rigs lag their command: a `drive_lag` that is said beside what is hidden counts neither for nor against an answer.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.diagnose.faults.fault import CHANNELS_SWAPPED, DEAD_CHANNEL
from pipeline.diagnose.mechanisms import MECHANISMS
from reports.pages.campaign.places import clopper_pearson
from tests.helpers.foreign_rigs import (
    CLEAN,
    FAULT,
    FOLDER,
    KINDS,
    PAIR,
    SINGLE,
    UNLISTED,
    Answer,
    Asked,
    answer_session,
    find_rigs,
)
from tests.helpers.judging import INSEPARABLE

HERE = Path(__file__).resolve().parent
SEEDS = 1_000_000_000
_ALIKE = 0.03
"""Relative difference within which a proposed value is the right one."""
_ALIKE_DRIFT = 0.1
"""Relative difference within which a proposed drift of a clock is the right one."""
_BEYOND_REPAIR = frozenset({"dead_channel", "sensor_saturation"})
"""Faults that nothing that is written puts right."""
_NOT_COMPARABLE = ("sample_rate_hz", "in samples")
"""In the key of a rig: an absolute rate or a number of samples, where a proposal is a factor or a time."""
_WORDS = {"scale": ("scale", "sample_interval_s"), "time_scale": ("sample_interval_s", "ppm"), "delay_s": ("delay_s",)}
"""Last part of a proposal's key → what rigs call it."""
_CLOCKS = ("clock", "time")
"""Words of a rig for what runs apart: whichever channel is called the slow one, the correction is the same but for its sign."""
_BINS = (0.0, 0.5, 0.8, 0.95, 1.0)
"""Limits of the bins of a reliability diagram."""
_NEAR = 0.3
"""Share of an effect by which its form may differ from the catalogue's to be near."""
_POSSIBLE = 0.05
"""Probability from which a cause may be there."""


def draw_sessions(seed: int, rigs: Sequence[str], kinds: Sequence[str], sessions: int) -> list[Asked]:
    """All sessions of a study, mixed so that an early end leaves a fair share of each kind."""
    rng = np.random.default_rng(seed)
    return [Asked(rig, int(rng.integers(SEEDS)), kind) for _ in range(sessions) for kind in kinds for rig in rigs]


def answer_all(
    asked: Sequence[Asked], folder: Path, jobs: int, minutes: float, log: Path, study: int
) -> Iterator[Answer]:
    """Answers in the order in which they come; each is a line of `log`, with the seed `study`."""
    os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"
    end, left = time.monotonic() + 60 * minutes, list(asked)[::-1]
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        running = set()
        while left or running:
            while left and len(running) < jobs and time.monotonic() < end:
                running.add(pool.submit(partial(answer_session, folder=folder), left.pop()))
            if not running:
                return
            done, running = wait(running, return_when=FIRST_COMPLETED)
            for future in done:
                try:
                    answer = replace(future.result(), study=study)
                except ArithmeticError as error:
                    print(f"a rig could not make its session: {error}", file=sys.stderr)
                    continue
                with log.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(answer.as_line()) + "\n")
                yield answer


def leave_out_lag(a: Answer) -> Answer:
    """The answer without `drive_lag` where it is not hidden on purpose: amplifiers of these rigs lag their command, and to say so is no
    error."""
    if "drive_lag" in a.truth["listed"] or "drive_lag" not in {*a.named, *a.possible}:
        return a
    named, possible = (tuple(c for c in causes if c != "drive_lag") for causes in (a.named, a.possible))
    shares: Counter[str] = Counter()
    for name, p in (a.probabilities or {}).items():
        shares["+".join(c for c in name.split("+") if c != "drive_lag") or "plain"] += p
    return replace(
        a, verdict=a.verdict if named or possible else "none", named=named, possible=possible, probabilities=shares
    )


def read_answers(log: Path) -> list[Answer]:
    """The answers that were kept."""
    return [Answer(**json.loads(line)) for line in log.read_text(encoding="utf-8").splitlines()]


def is_hard_pair(a: Answer) -> bool:
    """Whether what was named first and what is hidden are a declared hard pair, or the effect a gain that the material absorbs."""
    hidden = a.truth["listed"]
    return "gain_error" in hidden or any({*hidden, *a.named[:1]} <= group for group in INSEPARABLE)


def is_near(a: Answer) -> bool:
    """Whether the form of what is hidden is near to the catalogue's, of two causes that of either."""
    return float(a.truth.get("form_distance") or 0.0) <= _NEAR


def is_right_first(a: Answer) -> bool:
    """Whether the first cause named is hidden."""
    return a.verdict in ("named", "ambiguous") and bool(a.named) and a.named[0] in a.truth["listed"]


def is_in_set(a: Answer) -> bool:
    """Whether all that is hidden is named or possible."""
    return a.verdict in ("named", "ambiguous") and set(a.truth["listed"]) <= {*a.named, *a.possible}


def is_wrong_name(a: Answer) -> bool:
    """Whether something is named without doubt that is not there."""
    right = {*a.truth["listed"], (a.truth.get("fault") or {}).get("id", "")}
    return a.verdict == "named" and not set(a.named) <= right


def is_place_right(a: Answer) -> bool:
    """Whether stage and dependence are those of what is hidden: its stage, of several one, and one covariate at least where there is one."""
    stage, depends = a.truth["stage"], set(a.truth["depends_on"] or ())
    stages = [stage] if isinstance(stage, str) else stage or []
    return a.stage in stages and (not depends or bool(depends & set(a.depends_on)))


def is_fault_named(a: Answer) -> bool:
    """Whether the fault is named, with the recordings that it is in."""
    told = a.truth["fault"]
    own = [f for f in a.faults if f["id"] == told["id"]]
    # A recording may be refused for what is wrong with it before the others are asked.
    channel = str(told["key"]).partition(" ")[0]
    refusal = {DEAD_CHANNEL: f"{channel} is", CHANNELS_SWAPPED: "Force and displacement are in each other's place"}
    words = refusal.get(told["id"])
    if told["recordings"] == "all":
        return bool(own) or told["id"] in a.named
    refused = {name for name in told["recordings"] if words is not None and _is_refused(a, name, words)}
    return refused | {name for f in own for name in f["recordings"]} == set(told["recordings"])


def _is_refused(a: Answer, recording: str, words: str) -> bool:
    """Whether a recording was refused before the diagnosis, with words that name the fault."""
    return any(recording in text and words in text for text in a.refused)


def is_correction_right(a: Answer) -> bool | None:
    """Whether what would put the fault right is proposed; None where nothing would, or where the rig states it in terms that a proposal
    cannot be held against."""
    told = a.truth["fault"]
    if not told.get("key") or told.get("right_value") in (None, "") or told["id"] in _BEYOND_REPAIR:
        return None
    if any(word in told["key"] for word in _NOT_COMPARABLE) or told["right_value"] == 0:
        return None  # 0: the rig states what is right, not how far it is off
    return any(
        _is_same_key(key, told["key"]) and _same(proposed, right)
        for f in a.faults
        for key, _, proposed, _ in f["corrections"]
        if (right := _state_right(told, f["recordings"][0])) is not None
    )


def _state_right(told: Mapping[str, Any], recording: str) -> object:
    """The right value for a recording, a drift in words with its unit; None where the rig states values by recording and none for this one."""
    right = told["right_value"]
    if isinstance(right, Mapping):
        right = right.get(recording)
    is_drift = "ppm" in str(told["key"]) and isinstance(right, int | float)
    return f"{right} ppm" if is_drift else right


def _is_same_key(proposed: str, told: str) -> bool:
    """Whether a key of a proposal is what a rig calls by words of its own: `columns.force.scale` and `force scale` are one."""
    if proposed == told:
        return True
    what = proposed.removeprefix("columns.").removeprefix("rig.")
    if what == told:
        return True
    if what.endswith(".column"):
        return "<->" in told or told == "columns"
    channel, _, how = what.rpartition(".")
    words = _WORDS.get(how, (how,))
    of_two_clocks = how == "time_scale" and any(word in told for word in _CLOCKS)
    return any(word in told for word in words) and (channel in ("", "time") or channel in told or of_two_clocks)


def _same(proposed: object, right: object) -> bool:
    if str(right).endswith(" ppm"):
        # Fast and slow are each other's opposite, as are the two channels: what a rig means by the sign is its own matter.
        drift = abs(float(str(right).removesuffix(" ppm")) * 1e-6)
        return abs(abs(float(str(proposed)) - 1) - drift) < _ALIKE_DRIFT * drift
    try:
        return abs(float(str(proposed)) / float(str(right)) - 1) < _ALIKE
    except (ValueError, ZeroDivisionError):
        # What a rig tells in a sentence is all in its key; a name is the name.
        return " " in str(right) or "<->" in str(right) or str(proposed) == str(right)


def state_rate(hits: Sequence[bool]) -> str:
    """Share with its 95 % interval, in per cent."""
    if not hits:
        return "–"
    low, high = clopper_pearson(sum(hits), len(hits))
    return f"{100 * sum(hits) / len(hits):.0f} % ({sum(hits)}/{len(hits)}; {100 * low:.0f} to {100 * high:.0f})"


@dataclass(frozen=True)
class Row:
    """A line of the report: what is asked of which answers, and what is wanted."""

    name: str
    hits: Sequence[bool]
    wanted: str = ""


def make_rows(found: Sequence[Answer]) -> list[Row]:
    """The rates of some answers."""
    asked = [a for a in found if not a.failed]
    clean, single, unlisted, pairs, faults = ([a for a in asked if a.kind == kind] for kind in KINDS)
    right_file = [a for a in single if a.truth.get("within_file")]
    single = [a for a in single if a not in right_file]
    seen = [a for a in single if a.verdict != "none"]
    mended = [hit for a in faults if is_fault_named(a) and (hit := is_correction_right(a)) is not None]
    return [
        Row("could not be diagnosed", [bool(a.failed) for a in found], "0 %"),
        Row("tables that contradict each other", [bool(a.contradictions) for a in asked if a.contradictions is not None], "0 %"),
        Row("nothing hidden: false alarms", [a.verdict != "none" for a in clean], "≤ 1 %"),
        Row("one cause: detected", [a.verdict != "none" for a in single], "≥ 95 %"),
        Row("… right cause first, outside the declared hard pairs", [is_right_first(a) for a in seen if not is_hard_pair(a)], "≥ 90 %"),
        Row("… … of forms up to 30 % away", [is_right_first(a) for a in seen if is_near(a) and not is_hard_pair(a)], "≥ 85 %"),
        Row("… right cause first, all", [is_right_first(a) for a in seen]),
        Row("… right cause named or possible", [is_in_set(a) for a in seen], "93–97 %"),
        Row("… named or possible, or its stage and dependence", [is_in_set(a) or is_place_right(a) for a in seen]),
        Row("… called unknown", [a.verdict == "unknown" for a in seen]),
        Row("… a wrong name without doubt", [is_wrong_name(a) for a in single]),
        Row("rig constants off by less than two standard deviations of their file: named", [a.verdict != "none" for a in right_file]),
        Row("in no list: a wrong name without doubt", [is_wrong_name(a) for a in unlisted], "≤ 5 %"),
        Row("… detected", [a.verdict != "none" for a in unlisted]),
        Row("… stage and dependence right, of those called unknown", [is_place_right(a) for a in unlisted if a.verdict == "unknown"], "≥ 70 %"),
        Row("two causes: both named", [set(a.truth["listed"]) <= {*a.named} for a in pairs], "≥ 85 %"),
        Row("… … of forms up to 30 % away", [set(a.truth["listed"]) <= {*a.named} for a in pairs if is_near(a)]),
        Row("… both named or possible", [set(a.truth["listed"]) <= {*a.named, *a.possible} for a in pairs], "≥ 93 %"),
        Row("everyday faults: fault and recordings named", [is_fault_named(a) for a in faults], "≥ 90 %"),
        Row("… what is proposed puts them right", mended, "≥ 90 %"),
        Row("… a wrong name without doubt", [is_wrong_name(a) for a in faults]),
    ]  # fmt: skip


@dataclass(frozen=True)
class Bin:
    """Probabilities of a reliability diagram that are near to each other: their mean, and how many of how many came true."""

    probability: float
    hits: int
    size: int

    @property
    def share(self) -> float:
        """Share that came true."""
        return self.hits / self.size


def sort_into_bins(pairs: Sequence[tuple[float, bool]]) -> list[Bin]:
    """The bins that hold anything, of probabilities and whether what they are of is so."""
    found = []
    for low, high in pairwise(_BINS):
        own = [(p, hit) for p, hit in pairs if low < p <= high]
        if own:
            found.append(Bin(float(np.mean([p for p, _ in own])), sum(hit for _, hit in own), len(own)))
    return found


def measure_calibration(found: Iterable[Answer]) -> list[Bin]:
    """How often the most probable hypothesis is all that is hidden, where one or two causes are."""
    pairs = []
    for a in found:
        if a.kind in (SINGLE, PAIR) and not a.failed and a.probabilities and a.verdict != "none":
            name, p = max(a.probabilities.items(), key=lambda item: item[1])
            pairs.append((min(p, 1.0), set(name.split("+")) == set(a.truth["listed"])))
    return sort_into_bins(pairs)


def measure_calibration_of_causes(found: Iterable[Answer]) -> list[Bin]:
    """How often a listed cause is hidden that is there with some probability, alone or beside anything else, where one or two causes are
    hidden, or an effect that is in no list."""
    pairs = []
    for a in found:
        if a.kind in (SINGLE, PAIR, UNLISTED) and not a.failed and a.verdict != "none":
            shares: Counter[str] = Counter()
            for name, p in (a.probabilities or {}).items():
                shares.update({id: p for id in name.split("+") if id in MECHANISMS})
            pairs += [(min(p, 1.0), id in a.truth["listed"]) for id, p in shares.items() if p >= _POSSIBLE]
    return sort_into_bins(pairs)


def _draw_reliability(what: str, bins: Sequence[Bin]) -> Iterator[str]:
    """Expected calibration error, and the bins as a table."""
    if not bins:
        return
    error = sum(b.size * abs(b.probability - b.share) for b in bins) / sum(b.size for b in bins)
    yield ""
    yield f"{what}: expected calibration error {error:.2f} (wanted ≤ 0.05)."
    yield ""
    yield "| mean probability | right | of |"
    yield "| --- | --- | --- |"
    for b in bins:
        yield f"| {b.probability:.2f} | {b.share:.2f} | {b.size} |"


def report(found: Sequence[Answer]) -> Iterator[str]:
    """The tables in Markdown: all rigs, each rig, the reliability, and what was said for what."""
    rigs = sorted({a.rig for a in found})
    columns = [make_rows(found), *(make_rows([a for a in found if a.rig == rig]) for rig in rigs)]
    yield "| | all | " + " | ".join(rigs) + " | wanted |"
    yield "| --- |" + " --- |" * (len(columns) + 1)
    for rows in zip(*columns, strict=True):
        yield f"| {rows[0].name} | " + " | ".join(state_rate(r.hits) for r in rows) + f" | {rows[0].wanted} |"
    yield from _draw_reliability("Most probable hypothesis, one or two causes hidden", measure_calibration(found))
    each = measure_calibration_of_causes(found)
    yield from _draw_reliability(
        "Each listed cause that may be there, alone or beside others, or an effect in no list hidden", each
    )
    seconds = sorted(a.seconds for a in found if not a.failed)
    if seconds:
        yield ""
        yield f"Time of a diagnosis: median {np.median(seconds):.0f} s, longest {seconds[-1]:.0f} s of processor."
    yield ""
    yield "| hidden | sessions | first or named | otherwise |"
    yield "| --- | --- | --- | --- |"
    by_truth: dict[str, list[Answer]] = {}
    for a in found:
        by_truth.setdefault(name_truth(a), []).append(a)
    for name, own in sorted(by_truth.items()):
        right = [a for a in own if is_answered(a)]
        wrong = Counter(say(a) for a in own if a not in right)
        words = ", ".join(f"{what} {n}" for what, n in wrong.most_common(3))
        yield f"| {name} | {len(own)} | {len(right)} | {words} |"


def name_truth(a: Answer) -> str:
    """Words for what is hidden; effects without a name and pairs are one line each."""
    if a.kind == SINGLE:
        return str(a.truth["listed"][0])
    return f"fault: {a.truth['fault']['id']}" if a.kind == FAULT else a.kind


def is_answered(a: Answer) -> bool:
    """Whether an answer is right, of any kind."""
    if a.kind == CLEAN:
        return a.verdict == "none"
    if a.kind == UNLISTED:
        return a.verdict not in ("none", "named")
    if a.kind == FAULT:
        return is_fault_named(a)
    return set(a.truth["listed"]) <= {*a.named} if a.kind == PAIR else is_right_first(a)


def say(a: Answer) -> str:
    """An answer in short."""
    if a.failed:
        return "failed"
    return f"{a.verdict} {a.named[0]}" if a.named and a.verdict in ("named", "ambiguous") else a.verdict


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--seed", type=int)
    parser.add_argument("--rigs", nargs="*")
    parser.add_argument("--folder", type=Path, default=FOLDER)
    parser.add_argument("--kinds", nargs="*", choices=KINDS, default=list(KINDS))
    parser.add_argument("--sessions", type=int, default=20)
    parser.add_argument("--minutes", type=float, default=float("inf"))
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--log", type=Path, default=HERE / "foreign.jsonl")
    parser.add_argument("--resume", action="store_true", help="go on with a study of that seed which was stopped")
    parser.add_argument("--again", action="store_true", help="report what is kept, ask nothing")
    parser.add_argument("--of", type=int, nargs="*", help="with --again: of the studies with these seeds only")
    given = parser.parse_args(arguments)
    if given.again:
        kept = [a for a in read_answers(given.log) if not given.of or a.study in given.of]
        found = [leave_out_lag(a) for a in kept]
        print(f"{len(found)} sessions, each with its seed in {given.log.name}.\n")
        print("\n".join(report(found)))
        return 0
    seed = int(np.random.default_rng().integers(SEEDS)) if given.seed is None else given.seed
    asked = draw_sessions(seed, given.rigs or find_rigs(given.folder), given.kinds, given.sessions)
    known = [a for a in read_answers(given.log) if a.study == seed] if given.resume else []
    done = {(a.rig, a.seed) for a in known}
    left = [a for a in asked if (a.rig, a.seed) not in done]
    answers = [*known, *answer_all(left, given.folder, given.jobs, given.minutes, given.log, seed)]
    found = [leave_out_lag(a) for a in answers]
    print(f"{len(found)} of {len(asked)} sessions, seed {seed}.\n")
    print("\n".join(report(found)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
