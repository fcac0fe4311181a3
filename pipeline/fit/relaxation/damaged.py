"""Damaged recordings beside whole ones: how much they may weigh in a fit of both.

A record that was cut, lost blocks or touched the end of a range may be as good as any, or wrong in a way that its own noise
does not show. The whole recordings of the specimen judge it: what its lines add to the misfit of the best relaxation of
any order, per value, is the factor on its variance (Birge 1932), taken at the upper end of what such a misfit may mean, since
a damaged recording has to show that it is good. Beyond `CONTRADICTED` it is not used at all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from scipy.special import gammaincinv

from pipeline.fit.relaxation.assemble import assemble
from pipeline.fit.relaxation.reference import Reference, find_reference
from pipeline.transform.response import FrequencyResponse
from schemas.errors import NotIdentifiableError
from schemas.metadata import RigConstants

DOUBT = 0.05
"""Probability that the factor on the variance of a damaged recording is still too small."""
CONTRADICTED = 4.0
"""Misfit per value, in variances, beyond which a damaged recording contradicts the whole ones: twice its own noise."""


def weighed(
    responses: Sequence[FrequencyResponse], rigs: Sequence[RigConstants | None], damage: Sequence[str]
) -> tuple[tuple[FrequencyResponse, ...], tuple[str, ...]]:
    """The responses, those of damaged recordings with the variance that the whole ones leave them, and what was done.

    `damage` has what is wrong with each recording, "" where it is whole. A recording that contradicts the others comes back
    with no usable line, and the reason. Without whole recordings nothing can be judged: all are used, and that is said.
    """
    damaged = [i for i, what in enumerate(damage) if what]
    if not damaged:
        return tuple(responses), ()
    alone = _reference(responses, rigs, [i for i, what in enumerate(damage) if not what])
    found, remarks = list(responses), []
    for i in damaged:
        name = responses[i].recording_id or "a recording"
        if not responses[i].usable.any():
            continue
        added = None if alone is None else _added(alone, responses, rigs, damage, i)
        if added is None:
            remarks.append(f"{name} is damaged, and no whole recording can judge it")
            continue
        chi2, data = added
        misfit = chi2 / data
        if misfit > CONTRADICTED:
            reason = f"damaged, and {misfit:.2g} variances per value off the whole recordings"
            found[i] = responses[i].mark(responses[i].usable, reason)
            remarks.append(f"{name} is left out: {reason}")
        else:
            factor = max(1.0, chi2 / float(2 * gammaincinv(data / 2, DOUBT)))
            found[i] = replace(responses[i], variance=factor * responses[i].variance)
            remarks.append(
                f"{name} is damaged; the whole recordings leave it {1 / factor:.0%} of its weight"
                f" ({misfit:.2g} variances per value)"
            )
    return tuple(found), tuple(remarks)


def _reference(
    responses: Sequence[FrequencyResponse], rigs: Sequence[RigConstants | None], chosen: Sequence[int]
) -> Reference | None:
    """The best relaxation of any order of some of the responses; None where they carry none or have no variance."""
    try:
        observations, _, unknown = assemble([responses[i] for i in chosen], [rigs[i] for i in chosen])
    except NotIdentifiableError:
        return None
    return None if unknown else find_reference(observations)


def _added(
    alone: Reference,
    responses: Sequence[FrequencyResponse],
    rigs: Sequence[RigConstants | None],
    damage: Sequence[str],
    index: int,
) -> tuple[float, float] | None:
    """Rise of χ² with this response added, in units of the misfit that the whole ones have among themselves, and its values."""
    chosen = [i for i, what in enumerate(damage) if not what or i == index]
    together = _reference(responses, rigs, chosen)
    if together is None:
        return None
    data = max(together.observations.data - alone.observations.data, 1.0)
    return max(together.chi2 - alone.chi2, 0.0) / alone.dispersion, data
