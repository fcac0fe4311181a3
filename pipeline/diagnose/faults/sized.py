"""Sizes that the actuation contradicts: are they wrong, or does a mechanism take from what the voltage does?

The plain model tells the actuation from all voltages at once. A mechanism that lowers it at high voltages lowers that mean as well, and
sizes that are right seem wrong as long as no cause is at work. So the search for causes is asked with the actuation free, and with the
one that sizes and permittivity promise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import expit

from pipeline.diagnose.faults.fault import SIZE_WRONG, Fault
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.search.evidence import Evidence
from pipeline.diagnose.search.plain_fit import PlainFit
from pipeline.diagnose.simulation.parameters import ACTUATION

_LEAST = 1e-6
"""Least standard deviation of the logarithm of the actuation, over that of its promise: a fit says 0 where it was not computed."""


def find_doubt(faults: Sequence[Fault]) -> Fault | None:
    """The fault that sizes are wrong by a factor that is no usual slip; None where there is none."""
    return next((f for f in faults if f.cause == SIZE_WRONG and f.alike), None)


def believe_sizes(plain: PlainFit) -> PlainFit:
    """The plain fit with a model that believes the sizes whatever the actuation says."""
    return replace(plain, model=replace(plain.model, is_sized=True))


def weigh_sizes(freed: Evidence, sized: Evidence) -> float:
    """Probability that the sizes are wrong.

    Parameters
    ----------
    freed, sized : what the search for causes found with the actuation free, and with the one that the sizes promise

    Notes
    -----
    Evidence of both, the prior odds `fault.prior`, and the volumes that the two priors of the logarithm of the actuation leave: normal
    about the promise, and anywhere within `fault.anywhere`.
    """
    model, best = sized.noise_fit.of.model, freed.best
    place = model.index(ACTUATION)
    if place is None or best is None:
        return RULES.fault.no_slip
    sd = float(model.prior_sd[place])
    known = max(float(np.sqrt(max(best.model.covariance[place, place], 0.0))), _LEAST * sd)
    both = 1 / np.hypot(1 / sd, 1 / known)
    log_volume_sized = float(np.log(both / sd))
    log_volume_freed = float(np.log(np.sqrt(2 * np.pi) * min(known, RULES.fault.anywhere) / RULES.fault.anywhere))
    wrong = freed.log_evidence + log_volume_freed + float(np.log(RULES.fault.prior))
    right = sized.log_evidence + log_volume_sized + float(np.log1p(-RULES.fault.prior))
    return float(expit(wrong - right))


def replace_doubt(faults: Sequence[Fault], doubt: Fault, probability: float) -> tuple[Fault, ...]:
    """The faults with that probability of the doubt; without it where it is as good as excluded."""
    if probability < 1 - RULES.fault.named:
        return tuple(f for f in faults if f is not doubt)
    return tuple(replace(f, probability=probability) if f is doubt else f for f in faults)
