"""Causes that a search in some recordings of a session found, tried in a search of others.

What two searches say is only compared where neither lacks what the other found: a search that ended early would be taken for what speaks
against its recordings.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from pipeline.diagnose.rules import RULES
from pipeline.diagnose.search.consensus import stand_at
from pipeline.diagnose.search.evidence import Evidence
from pipeline.diagnose.search.extended_model import ExtendedFit
from pipeline.diagnose.search.fit_mechanisms import finish_fit
from pipeline.diagnose.search.form_functions import allow_form_errors, differentiate_regions
from pipeline.diagnose.search.posterior import ANYTHING, Hypothesis, Posterior, settle_hypotheses, weigh_fit

_MOST = 2
"""Hypotheses that are tried."""
_STEPS = 15
"""Steps of their fit."""


def try_found_elsewhere(elsewhere: Evidence, here: Evidence) -> Posterior | None:
    """The posterior of a search with the most probable causes of another search of the same specimen among its hypotheses.

    Parameters
    ----------
    elsewhere, here : what the searches found, each in its own recordings

    Returns
    -------
    None where that adds nothing
    """
    posterior = here.posterior
    if posterior is None or elsewhere.posterior is None:
        return None
    tried = settle_hypotheses([weigh_fit(_fit_here(h, here)) for h in _list_likely(elsewhere.posterior)])
    about = next((h for h in posterior.hypotheses if h.name == ANYTHING), None)
    if not tried or about is None:
        return None
    return Posterior.of([*posterior.hypotheses, *allow_form_errors(tried, differentiate_regions(about.model))])


def _list_likely(posterior: Posterior) -> Sequence[Hypothesis]:
    """Those of listed causes that come near the best of these."""
    listed = posterior.listed
    return [h for h in listed[:_MOST] if h.log_joint > listed[0].log_joint - RULES.fit.close_call]


def _fit_here(hypothesis: Hypothesis, here: Evidence) -> ExtendedFit:
    """The causes of a hypothesis fitted to the recordings of another search, from where they stood, film and rig too if these have the
    same entries."""
    fit, plain = hypothesis.model, here.plain
    of = replace(plain.of, chosen=fit.of.chosen)
    theta = fit.theta if fit.of.model.names == plain.of.model.names else plain.theta
    begun = stand_at(replace(fit, of=of), of.make_entries(theta, fit.values))
    return finish_fit(begun.of.fit(begun.x, most=_STEPS))
