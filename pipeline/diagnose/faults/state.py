"""Faults of recordings as part of a diagnosis: what is said first, and what of the others beside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from pipeline.diagnose.faults.fault import Fault
from pipeline.diagnose.results import AMBIGUOUS, NAMED, UNKNOWN, Diagnosis
from schemas.mechanisms import plain_name


def state_faults(diagnosis: Diagnosis, faults: Sequence[Fault]) -> Diagnosis:
    """The diagnosis of the sound recordings with the faults of the others first; as it is where there are none.

    A fault is named. What is named beside it is what the sound recordings name; what they leave open stays open, in words.
    """
    if not faults:
        return diagnosis
    beside = diagnosis.mechanisms if diagnosis.verdict == NAMED else ()
    causes = tuple(dict.fromkeys((*(f.cause for f in faults), *beside)))
    return replace(
        diagnosis,
        verdict=NAMED,
        mechanisms=causes,
        also_possible=(),
        faults=tuple(faults),
        unexplained=(*_describe_rest(diagnosis), *diagnosis.unexplained),
    )


def describe_fault(fault: Fault) -> str:
    """What is wrong with which recordings, a sentence without its end."""
    names = fault.recordings
    who = f"in {names[0]}" if len(names) == 1 else f"in {len(names)} recordings from {names[0]} on"
    return f"{who}, {fault.finding}"


def _describe_rest(diagnosis: Diagnosis) -> tuple[str, ...]:
    """What the sound recordings leave open."""
    if diagnosis.verdict == UNKNOWN:
        return ("What the other recordings show is explained by no listed cause either.",)
    if diagnosis.verdict != AMBIGUOUS:
        return ()
    options = dict.fromkeys((*diagnosis.mechanisms, *diagnosis.also_possible))
    return (f"Beside the fault, the other recordings show {' or '.join(plain_name(m) for m in options)}.",)
