"""Mechanisms that do as well as the strongest cause: what the recordings cannot tell from it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from pipeline.diagnose.rules import RULES
from pipeline.diagnose.search.extended_model import ExtendedFit
from pipeline.diagnose.search.fit_mechanisms import rank_by_evidence
from pipeline.diagnose.search.tempering import measure_excess

_ROUGH_STEPS, _STEPS = 6, 20
"""Steps of a rough fit, and of one to its end."""


def find_alternatives(
    plain: ExtendedFit, final: ExtendedFit, singles: Sequence[ExtendedFit]
) -> tuple[ExtendedFit, ...]:
    """Fits with the strongest cause replaced by another mechanism, as far as they do as well; best evidence first.

    Parameters
    ----------
    plain, final : the plain model and the one with the causes
    singles : mechanisms fitted alone, from which the replacements are taken
    """
    others = final.of.chosen[1:]
    held = {c.id for c in final.of.chosen}
    found = []
    for single in singles:
        if single.of.chosen[0].id in held:
            continue
        fit = _replace_strongest(plain, final, single) if others else single
        if fit is not None and _is_as_good(plain, final, fit):
            found.append(fit)
    return rank_by_evidence(found)


def _replace_strongest(plain: ExtendedFit, final: ExtendedFit, single: ExtendedFit) -> ExtendedFit | None:
    """The causes with another strongest one; None where a rough fit explains far less."""
    of = replace(final.of, chosen=(single.of.chosen[0], *final.of.chosen[1:]))
    start = of.make_entries(single.theta, (single.values[0], *final.values[1:]))
    fit = of.fit(start, most=_ROUGH_STEPS, near=final, thorough=False)
    if fit.chi2 > final.chi2 + RULES.fit.alternative_chi2 * (plain.chi2 - final.chi2):
        return None
    return of.fit(fit.x, most=_STEPS)


def _is_as_good(plain: ExtendedFit, best: ExtendedFit, other: ExtendedFit) -> bool:
    """Whether the evidence does not part two fits or, where even the best leaves much beyond the noise, the ratio of
    what they leave."""
    if best.log_evidence - other.log_evidence < RULES.cause.close:
        return True
    left, left_other = measure_excess(plain, best), measure_excess(plain, other)
    return left > RULES.verdict.much_left and left_other < RULES.verdict.close_misfit**2 * left
