"""The verdict: the one place where it is made, for sessions and for records that are asked alone.

`none`: nothing beyond the noise. `named`: causes that explain it, that no other mechanism replaces and that predict
what they were not fitted to. `ambiguous`: the same, but another mechanism, or a cause that is in no list, might do as
well. `unknown`: a discrepancy that no listed mechanism explains.

Does not belong here: fits and tests (`search`, `single`).
"""

from __future__ import annotations

import math

from pipeline.diagnose.results import AMBIGUOUS, NAMED, NONE, UNKNOWN, HeldOut
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.search.evidence import Evidence
from pipeline.diagnose.search.extended_model import ExtendedFit
from pipeline.diagnose.search.tempering import measure_excess
from pipeline.diagnose.single.comparison import Comparison


def judge_session(evidence: Evidence, held_out: HeldOut | None) -> str:
    """Verdict on a session.

    Parameters
    ----------
    evidence : what the search for causes found
    held_out : errors on parts that the causes were not fitted to; None where nothing can be left out

    Returns
    -------
    `none`, `named`, `ambiguous` or `unknown`
    """
    if not evidence.is_discrepant:
        return NONE
    final = evidence.final
    if final is None or _leave_too_much(evidence, final) or not _hold_elsewhere(evidence, final, held_out):
        return UNKNOWN
    return AMBIGUOUS if evidence.alternatives or evidence.beside or evidence.instead else NAMED


def _leave_too_much(evidence: Evidence, final: ExtendedFit) -> bool:
    """Whether something surely differs beside the causes, or they leave a pattern and explain too little for their
    names to be said."""
    if evidence.surely_beside:
        return True
    too_little = evidence.explained < RULES.verdict.explained
    more_than_noise = measure_excess(evidence.plain, final) > RULES.verdict.more_than_noise
    return evidence.leaves_pattern and too_little and more_than_noise


def _hold_elsewhere(evidence: Evidence, final: ExtendedFit, held_out: HeldOut | None) -> bool:
    """Whether nothing speaks against the causes on parts that they were not fitted to.

    A rig that fits with other constants than its file's predicts as well with those of the file: no gain is asked of
    causes that explain little in the features. Of strong causes some gain is asked; weaker evidence is too noisy for
    that.
    """
    if held_out is None:
        return True
    rules, leaves = RULES.verdict, evidence.leaves_pattern
    if math.isnan(held_out.gain):
        return held_out.after < held_out.before or not leaves
    plain = evidence.plain
    fall = plain.chi2 - final.chi2
    in_features = float(plain.misfit @ plain.misfit - final.misfit @ final.misfit)
    if in_features < rules.in_features * fall:
        return True
    better = sum(after < before for before, after in held_out.parts.values())
    is_strong = fall > rules.strong * evidence.threshold
    if is_strong and held_out.gain < rules.strong_gain and 2 * better <= len(held_out.parts):
        return False
    return held_out.upper > (rules.gain_with_pattern if leaves else 0.0)


def judge_predictions(comparison: Comparison) -> str:
    """Verdict on a record that is asked alone, by what models with one mechanism each predict of a part left out.

    Parameters
    ----------
    comparison : the models, best prediction first

    Returns
    -------
    `none`, `named`, `ambiguous` or `unknown`
    """
    if not comparison.misfit > 0:
        return NONE
    possible = comparison.possible
    if not possible or max(p.explained for p in possible) < RULES.verdict.explained:
        return UNKNOWN
    return NAMED if len({p.model.mechanism for p in possible}) == 1 else AMBIGUOUS
