"""The chosen regression of a campaign's lives with limits by simulation, in words."""

from __future__ import annotations

from pipeline.commands.show.life_plans import read_lives
from pipeline.commands.show.rows import in_plain
from pipeline.fit.survival.groups import usable_lives
from pipeline.fit.survival.kaplan_meier import Estimate
from pipeline.fit.survival.life_models import fit_life_models
from pipeline.fit.survival.resampling import SimulatedLimits, simulate_limits
from pipeline.lab.lab import Lab
from schemas.errors import UsageError
from schemas.numbers import bounds


def show_lives(lab: Lab, campaign: str, draws: int, seed: int) -> str:
    """What the regression chosen by the night says, each number with limits of the likelihood and by simulation.

    Parameters
    ----------
    lab : whose database is read
    campaign : whose lives are meant
    draws, seed : of the simulation

    Raises
    ------
    UsageError, NotIdentifiableError, RefusedError, LabError
        There is no such campaign, its lives carry no regression or no simulation, or there is no database.
    """
    rows = usable_lives(read_lives(lab))
    found = fit_life_models([row for row in rows if row.campaign == campaign])
    if not found or found[0].chosen is None:
        known = sorted({row.campaign for row in rows if row.campaign})
        reasons = "; ".join(found[0].refused) if found else "nothing was varied in it, or it has no lives"
        raise UsageError(
            f'no regression of lives in campaign "{campaign[:80]}": {reasons}',
            expected=f"a campaign whose lives have one; there are lives of: {', '.join(known) or 'none'}",
        )
    one, chosen = found[0], found[0].chosen.regression
    limits = simulate_limits(one.lives, one.covariates, chosen.family, draws=draws, seed=seed)
    return in_plain("\n".join([f"{campaign}: {chosen.specimens} lives, {chosen.failures} failed", *_describe(limits)]))


def _describe(limits: SimulatedLimits) -> list[str]:
    fit = limits.regression
    pairs = [(c.name, c.value, limits.coefficients[c.name]) for c in fit.coefficients]
    pairs.append(("scatter of ln t", fit.sigma, limits.sigma))
    if fit.shape is not None and limits.shape is not None:
        pairs.append(("shape", fit.shape, limits.shape))
    width = max(len(name) for name, *_ in pairs)
    return [
        f"  {fit.family}; 95 % limits of the {fit.method.partition(';')[0]}, then of the {limits.method}"
        f" ({limits.fitted} of {limits.draws} simulated tests fitted)",
        *(f"  {name:<{width}}  {_shown(own)}   {_shown(drawn)}" for name, own, drawn in pairs),
    ]


def _shown(estimate: Estimate) -> str:
    return bounds(float(estimate.value), float(estimate.lower), float(estimate.upper))
