"""What may be behind a specimen's recordings, from a row of `diagnoses`: as sets of causes, and as one sentence.

The causes themselves in words are `schemas.mechanisms`. Does not belong here: how probable an explanation is, which is the analysis'.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from schemas.mechanisms import RECORD, UNLISTED, finding, list_actions, nested
from schemas.numbers import joined, word

CREDIBLE = 0.95
"""Probability that explanations hold together which are said to be possible, and that one alone has which is named."""
_TOLD = 4
"""Explanations that a sentence tells where there are two or more others; more would not be read."""
REMOVABLE = "of the squared error beyond the noise"
"""What a gain is a share of: χ² of the plain model on what was left out, less the number of its values."""
_TELLS_NOTHING = 1.0
"""Width of the interval of a gain from which it tells nothing: whatever may be removed lies in it."""
_BY_RECORDINGS = 4.0
"""Fall of χ² from which on recordings show a cause by themselves; below it what is known of film and rig does."""
STAGES = {"contact": "clamping of the film", "drift": "force while a recording lasts"}
"""Stages whose name is no word for people."""
_PLAIN = "plain"
"""The explanation, in `probabilities`, that nothing is beside the simulation but noise."""

Explanation = tuple[str, ...]
"""Causes that are there together; none of them: nothing is wrong beyond the noise."""


def list_explanations(diagnosis: Mapping[str, Any]) -> list[Explanation]:
    """The explanations among which a diagnosis cannot tell, or the one that it names, the likeliest first.

    Parameters
    ----------
    diagnosis : a row of `diagnoses`

    Returns
    -------
    Sets of causes; `unlisted` stands for one that is in no list. Where probabilities were not computed, each cause that is possible is
    one of its own.
    """
    named = tuple(m for m in (diagnosis["mechanisms"] or [diagnosis["mechanism"]]) if m)
    if diagnosis["verdict"] != "ambiguous":
        return [named] if named else []
    possible = [m for m in diagnosis["also_possible"] or () if m not in named]
    found = list(_take_likeliest(diagnosis, {*named, *possible, UNLISTED}))
    if not any({*one} == {*named} for one in found):
        found.insert(0, named)
    if len(found) == 1 and not possible and len(named) > 1:
        found.append(named[:1])
    found += [(m,) for m in possible if not any(m in one for one in found)]
    return [tuple(sorted(one, key=lambda m: _place(m, named))) for one in found]


def _place(mechanism: str, named: Sequence[str]) -> tuple[bool, int]:
    """The order within an explanation: as they are named, what is in no list last."""
    return mechanism == UNLISTED, named.index(mechanism) if mechanism in named else len(named)


def _take_likeliest(diagnosis: Mapping[str, Any], allowed: set[str]) -> Iterator[Explanation]:
    """The fewest explanations that hold `CREDIBLE` together, of these causes.

    Of faults of recordings all is told that is `allowed`, whatever is behind the sound ones: they are told of elsewhere.
    """
    shares: dict[str, float] = json.loads(diagnosis.get("probabilities") or "{}")
    total, known = 0.0, set()
    for name, share in sorted(shares.items(), key=lambda item: -item[1]):
        if total >= CREDIBLE:
            return
        total += share
        causes = {UNLISTED if "/" in m or m not in allowed | {_PLAIN} else m for m in name.split("+")} - {_PLAIN}
        if diagnosis.get("stage") == RECORD:
            causes &= allowed - {UNLISTED}
        if frozenset(causes) not in known:
            known.add(frozenset(causes))
            yield tuple(causes)


def has_unnamed_beside(diagnosis: Mapping[str, Any]) -> bool:
    """Whether the causes of a row of `diagnoses` are certain, with something beside them that is in no list: the likeliest hypothesis is
    `rig_constants+film/frequency`, say.
    """
    if diagnosis["verdict"] != "ambiguous":
        return False
    shares: dict[str, float] = json.loads(diagnosis.get("probabilities") or "{}")
    *beside, last = max(shares, key=lambda name: shares[name], default="").split("+")
    return "/" in last and {*beside} == {*(diagnosis["mechanisms"] or ())}


def cause(diagnosis: Mapping[str, Any]) -> str:
    """What is wrong, from a row of `diagnoses`: `the load cell is stiffer than its file says, by 6.3 ± 0.3 %`.

    A cause that is in every explanation is said with its size, and what may be beside it with "perhaps". Explanations that have no cause
    in common stand between "either" and "or", without sizes.
    """
    found = nested(diagnosis["severity"])
    named = [m for m in (diagnosis["mechanisms"] or [diagnosis["mechanism"]]) if m]
    if has_unnamed_beside(diagnosis):
        return _join([finding(m, found.get(m, {})) for m in named] + [finding(UNLISTED, {}, beside=True)])
    explanations = list_explanations(diagnosis)
    if len(explanations) < 2:
        return _join([finding(m, found.get(m, {})) for one in explanations for m in one])
    common = [m for m in explanations[0] if m != UNLISTED and all(m in one for one in explanations)]
    if not common:
        return _choose([_state(one, explanations, found) for one in explanations])
    sure = _join([finding(m, found.get(m, {})) for m in common])
    beside = [tuple(m for m in one if m not in common) for one in explanations]
    perhaps = _choose([_state(one, beside, found, beside=True) for one in beside if one])
    return f"{sure}, and {'perhaps' if () in beside else 'in addition'} {perhaps}"


def tell_no_gain(diagnosis: Mapping[str, Any]) -> str:
    """What it means that recordings which the fit has not seen are not surely predicted better with the cause, from a row of `diagnoses`; empty
    where they are.

    A cause may yet be sure: where the plain model follows the recordings as well, it does so with constants of film or rig that
    contradict what is known of them.
    """
    lower = diagnosis["gain_lower"]
    if diagnosis["gain"] is None or lower is None or lower > 0:
        return ""
    upper = diagnosis.get("gain_upper")
    if upper is not None and upper - lower > _TELLS_NOTHING:
        return "Whether what the fit has not seen is predicted better with it these few recordings do not tell."
    no_better = "What the fit has not seen is predicted no better with it"
    before, after = diagnosis["chi2"], diagnosis["chi2_extended"]
    if before is None or after is None or before - after > _BY_RECORDINGS:
        return f"{no_better}."
    return f"{no_better}: the plain model follows these recordings too, but with constants that contradict what is known of film and rig."


def tell_doubt(diagnosis: Mapping[str, Any]) -> str:
    """What recordings cannot do whose verdict is `ambiguous`: `cannot tell which`, of causes to choose from, or `cannot tell`, of one that
    may be beside another; empty where nothing is in doubt.
    """
    if diagnosis["verdict"] != "ambiguous" or has_unnamed_beside(diagnosis):
        return ""
    first, *others = (set(one) - {UNLISTED} for one in list_explanations(diagnosis))
    return "cannot tell" if first.intersection(*others) and others else "cannot tell which"


def tell_where_to_begin(diagnosis: Mapping[str, Any]) -> list[str]:
    """What to do where no cause is named and no recording is known that would tell, from a row of `diagnoses`, in sentences; empty where the
    verdict is another.
    """
    if diagnosis["verdict"] == "ambiguous":
        actions = list_actions(diagnosis["mechanisms"] or ())
        return ["No recording is known that would tell. Begin with the likeliest:", *actions] if actions else []
    if diagnosis["verdict"] != "unknown":
        return []
    if not diagnosis["stage"]:
        return ["Look at the recordings that the simulation misses most, and repeat them."]
    on = joined([str(name).replace("_", " ") for name in diagnosis["depends_on"] or ()])
    what = f", at what depends on the {on}: a repeated test that differs in nothing else shows it" if on else ""
    return [
        f"Look at the {STAGES.get(diagnosis['stage'], diagnosis['stage'])}{what}.",
        "Until it has a name, use the extended model within what was tested.",
    ]


def call_cause(diagnosis: Mapping[str, Any]) -> str:
    """What the cause that an extended model has in it is called, from a row of `diagnoses`: the likeliest one, where others may be it."""
    return "the likeliest cause" if tell_doubt(diagnosis) == "cannot tell which" else "the cause"


def _state(
    one: Explanation, of: Sequence[Explanation], severities: Mapping[str, Mapping[str, Any]], *, beside: bool = False
) -> str:
    """An explanation without sizes; of one that another holds too, with more, that it is only this."""
    if not one:
        return "nothing is wrong beyond the noise"
    together = [finding(m, severities.get(m, {}), beside=beside or len(one) > 1, sized=False) for m in one]
    text = f"{', '.join(together[:-1])} and {together[-1]}" if len(together) > 1 else together[0]
    return f"only {text}" if one != (UNLISTED,) and any({*one} < {*other} for other in of) else text


def _join(clauses: Sequence[str]) -> str:
    """Clauses that all hold; they may have commas in them."""
    if len(clauses) < 3:
        return ", and ".join(clauses)
    return f"{'; '.join(clauses[:-1])}; and {clauses[-1]}"


def _choose(clauses: Sequence[str]) -> str:
    """Clauses of which one holds."""
    if len(clauses) == 1:
        return clauses[0]
    if len(clauses) == 2 and not any(re.search(", | and | or ", clause) for clause in clauses):
        return f"either {clauses[0]} or {clauses[1]}"
    told = clauses if len(clauses) <= _TOLD + 1 else [*clauses[:_TOLD], f"one of {word(len(clauses) - _TOLD)} others"]
    return "either " + ", or ".join(told)
