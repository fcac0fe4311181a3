"""The verdict, read off the probabilities, for sessions and for records that are asked alone.

A session in which the search finds nothing has none to read (`diagnosis`), and faults of recordings go first (`faults.state`).

`none`: nothing beyond the noise. `named`: listed causes that are as good as certain. `ambiguous`: a few hypotheses, of which one is
true as likely as can be asked for, or causes that are certain beside something that is in no list. `unknown`: something that is in no
list is likelier than what is. No cause is named that something speaks against (`adequacy`).

Does not belong here: fits and tests (`search`, `single`).
"""

from __future__ import annotations

from pipeline.diagnose.results import AMBIGUOUS, NAMED, NONE, UNKNOWN
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.search.evidence import Evidence
from pipeline.diagnose.single.comparison import Comparison


def judge_session(evidence: Evidence) -> str:
    """Verdict on a session.

    Parameters
    ----------
    evidence : what the search for causes found

    Returns
    -------
    `none`, `named`, `ambiguous` or `unknown`
    """
    posterior, best = evidence.posterior, evidence.best
    if posterior is None:
        return NONE
    if evidence.is_unnamed or best is None:
        return UNKNOWN if evidence.sure is None else AMBIGUOUS
    return (
        NAMED
        if posterior.probability[best.name] >= RULES.verdict.credible
        and best.shortfall.is_adequate
        and evidence.predicts
        else AMBIGUOUS
    )


def judge_predictions(comparison: Comparison) -> str:
    """Verdict on a record that is asked alone, by what models with one mechanism each predict of a part left out.

    Parameters
    ----------
    comparison : the models, best prediction first

    Returns
    -------
    `none`, `named`, `ambiguous` or `unknown`
    """
    if comparison.p_value >= RULES.adequacy.level:
        return NONE
    possible = comparison.possible
    if not any(p.explained >= RULES.single.explained for p in possible):
        return UNKNOWN
    if len({p.model.mechanism for p in possible}) > 1:
        return AMBIGUOUS  # beside something in no list, where something speaks against all of them
    return NAMED if any(p.shortfall.is_adequate for p in possible) else UNKNOWN
