"""Faults of recordings as part of a diagnosis: what is said first, and what of the others beside it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace

from scipy.stats import norm

from pipeline.diagnose.faults.fault import Fault
from pipeline.diagnose.results import AMBIGUOUS, NAMED, UNKNOWN, Diagnosis
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.search.posterior import PLAIN
from schemas.explanations import cause
from schemas.mechanisms import RECORD


def state_faults(diagnosis: Diagnosis, faults: Sequence[Fault]) -> Diagnosis:
    """The diagnosis of the sound recordings with the faults of the others first; as it is where there are none.

    A fault is named, or ambiguous where several would put the recordings right alike. What is named beside it is what the sound
    recordings name; what they leave open stays open, in words. Faults that are less probable than not only may be, beside causes that
    are told.
    """
    if not faults:
        return diagnosis
    if diagnosis.mechanisms and all(f.probability < 1 / 2 for f in faults):
        told = {*diagnosis.mechanisms, *diagnosis.also_possible}
        return replace(
            diagnosis,
            verdict=AMBIGUOUS,
            also_possible=(*diagnosis.also_possible, *dict.fromkeys(f.cause for f in faults if f.cause not in told)),
            probabilities=_combine(diagnosis, faults),
            faults=tuple(faults),
        )
    beside = diagnosis.mechanisms if diagnosis.verdict == NAMED else ()
    causes = tuple(dict.fromkeys((*(f.cause for f in faults), *beside)))
    options = (id for f in faults for id in (*(c.cause for c in f.corrections), *f.alike))
    others = dict.fromkeys(id for id in options if id not in causes)
    is_clear = all(f.probability >= RULES.fault.named for f in faults)
    return replace(
        diagnosis,
        verdict=NAMED if is_clear else AMBIGUOUS,
        mechanisms=causes,
        also_possible=() if is_clear else tuple(others),
        # Whatever is called a fault is so many standard deviations away, or more.
        p_value=min(diagnosis.p_value, float(2 * norm.sf(RULES.fault.off))),
        probabilities=_combine(diagnosis, faults),
        stage=RECORD,
        depends_on=(),
        faults=tuple(faults),
        unexplained=(*_describe_rest(diagnosis, faults), *diagnosis.unexplained),
    )


def _combine(diagnosis: Diagnosis, faults: Sequence[Fault]) -> dict[str, float]:
    """Probabilities of the faults with what is behind the sound recordings, and without."""
    found: dict[tuple[str, ...], float] = {
        () if name == PLAIN else tuple(name.split("+")): p
        for name, p in (diagnosis.probabilities or {PLAIN: 1.0}).items()
    }
    for fault in reversed(faults):
        other = next((id for id in (*(c.cause for c in fault.corrections), *fault.alike) if id != fault.cause), "")
        with_fault: dict[tuple[str, ...], float] = {}
        for names, p in found.items():
            for one, share in ((fault.cause, fault.probability), (other, 1 - fault.probability)):
                both = names if not one or one in names else (one, *names)
                with_fault[both] = with_fault.get(both, 0.0) + p * share
        found = with_fault
    return {"+".join(names) or PLAIN: p for names, p in found.items()}


def describe_fault(fault: Fault) -> str:
    """What is wrong with which recordings, a sentence without its end."""
    names = fault.recordings
    who = f"in {names[0]}" if len(names) == 1 else f"in {len(names)} recordings from {names[0]} on"
    return f"{who}, {fault.finding}"


def _describe_rest(diagnosis: Diagnosis, faults: Sequence[Fault]) -> tuple[str, ...]:
    """What the sound recordings leave open."""
    if any(f.bars for f in faults):
        return ("No other cause can be asked of these recordings before that is put right.",)
    if diagnosis.verdict == UNKNOWN:
        return ("What the other recordings show is explained by no listed cause either.",)
    if diagnosis.verdict != AMBIGUOUS:
        return ()
    told = cause(
        {
            "verdict": diagnosis.verdict,
            "mechanism": next(iter(diagnosis.mechanisms), None),
            "mechanisms": diagnosis.mechanisms,
            "also_possible": diagnosis.also_possible,
            "probabilities": json.dumps(diagnosis.probabilities),
            "severity": None,
        }
    )
    return (f"What the other recordings show beside the fault: {told}.",)
