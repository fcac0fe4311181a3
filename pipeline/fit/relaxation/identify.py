"""Identification of a specimen's relaxation models: every order, with intervals, and the order that the data carry.

    responses → Observations → best relaxation of any order (alarm, spread, noise) → orders by variable projection, polished
    on the raw responses with the rig inside the model → order test → intervals and errors

Method `forward` fits the measured responses; `corrected` fits a response that was divided by the resonance, for comparison.
Does not belong here: electrical responses (`electrical`), large cycles (`time_domain`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from pipeline.fit.relaxation.assemble import assemble
from pipeline.fit.relaxation.details import Context
from pipeline.fit.relaxation.metrics import Geometry, errors
from pipeline.fit.relaxation.observations import Lines, Observations
from pipeline.fit.relaxation.order import LEVEL, arc_length, choose, tail_probability
from pipeline.fit.relaxation.positivity import positivity
from pipeline.fit.relaxation.reference import find_reference, refuse_hopeless, with_estimated_noise
from pipeline.fit.relaxation.results import CORRECTED, FORWARD, MECHANICAL, RelaxationFit, SpecimenFits, Spread
from pipeline.fit.relaxation.search import OrderFit, Search
from pipeline.fit.relaxation.spread import by_group, with_spread
from pipeline.fit.relaxation.unresolved import PASSES, describe_left_out, is_resolved, lowered, without_first_windows
from pipeline.physics.rig import missing_constants, rig_prior
from pipeline.transform.correction import HIGHEST_AMPLIFICATION, correct_mechanical
from pipeline.transform.relaxation import RelaxationCurve
from pipeline.transform.response import STIFFNESS, FrequencyResponse
from schemas.errors import NotIdentifiableError
from schemas.metadata import RigConstants
from schemas.numbers import p_equals

ORDERS = (1, 2, 3)
CERTAIN = 200.0
"""Likelihood ratio beyond which the length of the curve does not matter."""
IRRELEVANT = 0.2
GRID = 0.3
"""χ² that arms between the points of the reference's grid may gain."""
NO_MODULUS = (
    "no modulus: without the stiffness of the load cell in a rig's file the response is that of film and cell together"
)
Rigs = RigConstants | None | Sequence[RigConstants | None]


def fit_specimen(
    responses: Sequence[FrequencyResponse],
    rig: Rigs = None,
    *,
    relaxations: Sequence[RelaxationCurve] = (),
    relaxation_rig: Rigs = None,
    orders: Sequence[int] = ORDERS,
    gains: bool | None = None,
    geometry: Geometry | None = None,
    profile_all: bool = False,
    specimen_id: str | None = None,
) -> SpecimenFits:
    """Models of every order in `orders` from all mechanical recordings of a specimen together.

    Parameters
    ----------
    responses : measured stiffness (stage `measured`); only usable lines are taken, each with its variance. A response whose
        variance is NaN throughout gets weights from the misfit of the best relaxation of any order, and says so
    rig : constants of the rig, one for all or one per response; None where the response is the film's own (tables)
    relaxations, relaxation_rig : relaxation curves in time and their rigs (default: the rig of the responses)
    gains : a factor per recording group as a random effect; None: where the recordings differ beyond their noise
    geometry : stretched length and section, for the modulus
    profile_all : profile likelihood for every order, not only for the chosen one and below

    Raises `NotIdentifiableError` where nothing is usable or there are fewer values than parameters.
    """
    curve_rig = relaxation_rig if relaxation_rig is not None else (rig if not _several(rig) else None)
    response_rigs, curve_rigs = per_recording(rig, len(responses)), per_recording(curve_rig, len(relaxations))
    observations, warnings, unknown = assemble(responses, response_rigs, relaxations, curve_rigs)
    measured = [film_stiffness(r, c) for r, c in zip(responses, response_rigs, strict=True)]
    if geometry is not None and any(missing_constants(one) for one in response_rigs):
        geometry = None  # of a held step the cell is stiff
        warnings += (NO_MODULUS,)
    name = specimen_id or _specimen(responses, relaxations)

    def fits_of(kept: Observations, told: tuple[str, ...]) -> SpecimenFits:
        return identify(
            kept,
            unknown,
            orders=orders,
            specimen_id=name,
            loading=MECHANICAL,
            method=FORWARD,
            measured=measured,
            geometry=geometry,
            gains=gains,
            profile_all=profile_all,
            warnings=warnings + told,
        )

    found = fits_of(observations, ())
    if measured:
        return found
    kept, unresolved = observations, found.selected_order
    for _ in range(PASSES):
        fewer = None if is_resolved(found.selected) else without_first_windows(kept, found.selected)
        if fewer is None:
            break
        kept = fewer
        found = fits_of(kept, (describe_left_out(observations, kept, unresolved),))
    return lowered(found)


def fit_corrected(
    response: FrequencyResponse,
    *,
    orders: Sequence[int] = ORDERS,
    geometry: Geometry | None = None,
    profile_all: bool = False,
    specimen_id: str | None = None,
) -> SpecimenFits:
    """Models fitted to a divided response with its propagated variance: method `corrected`, for comparison.

    The error of the rig's constants is common to all lines (`systematic`): each of its columns is a nuisance parameter. Raises
    like `fit_specimen`.
    """
    observations, warnings, unknown = assemble([response], [None], divided=True)
    return identify(
        observations,
        unknown,
        orders=orders,
        specimen_id=specimen_id or _specimen([response], ()),
        loading=MECHANICAL,
        method=CORRECTED,
        measured=[response.only_usable()],
        geometry=geometry,
        profile_all=profile_all,
        warnings=warnings,
    )


def identify(
    observations: Observations,
    unknown: frozenset[int],
    *,
    orders: Sequence[int],
    specimen_id: str,
    loading: str,
    method: str,
    measured: Sequence[FrequencyResponse],
    geometry: Geometry | None = None,
    gains: bool | None = None,
    profile_all: bool = False,
    warnings: tuple[str, ...] = (),
) -> SpecimenFits:
    """The whole identification of assembled observations; `measured` are film stiffnesses for the errors of eq 4.14."""
    wanted, refused = _possible(observations, orders)
    reference = find_reference(observations)
    refuse_hopeless(reference)
    if unknown:
        reference = with_estimated_noise(reference, unknown)
        names = ", ".join(sorted(observations.groups[g] for g in unknown))
        refused += (
            f"no variance given ({names}): noise taken as a constant share, from the misfit of the best relaxation",
        )
    parts = by_group(reference)
    alarm = positivity(parts, variance_estimated=bool(unknown))
    reference, spread = with_spread(reference, parts, gains=gains)
    search = Search(reference)
    found, p_values = _orders(search, wanted[-1])
    context = Context(search.observations, reference, search.bounds, profile_all)
    details = {n: context.detailed(found[n]) for n in wanted}
    choices = choose(
        wanted,
        p_values,
        {n: d.bic for n, d in details.items()},
        {n: d.held_out_error for n, d in details.items()},
    )
    selected = choices["test"]
    fits = []
    for n in wanted:
        fit = context.finished(details[n], found[n], profile=profile_all or n <= selected, adequate=n >= selected)
        fits.append(with_errors(replace(fit, order_p_value=p_values.get(n)), measured, geometry))
    low, high = observations.omega_range
    return SpecimenFits(
        specimen_id=specimen_id,
        loading=loading,
        method=method,
        fits=tuple(fits),
        selected_order=selected,
        choices=choices,
        positivity=alarm,
        spread=spread,
        frequency_low_hz=low / (2 * np.pi),
        frequency_high_hz=high / (2 * np.pi),
        warnings=warnings + refused + _remarks(alarm.raised, alarm.statement, p_values, wanted, choices, spread),
    )


def _orders(search: Search, highest: int) -> tuple[dict[int, OrderFit], dict[int, float | None]]:
    """Fits of order 1 … highest, and p of each order against the next (0 included).

    The order above the highest is fitted for the test alone, and only where it could matter: no order gains more than the best
    relaxation of any order, so that where even that is no gain, p against it is a lower limit that suffices.
    """
    reference = search.reference
    spring = search.spring_only()
    found: dict[int, OrderFit] = {}
    solutions, chi2 = {0: spring}, {0: spring.chi2}
    p_values: dict[int, float | None] = {}

    def p_of(n: int, larger: float) -> float:
        ratio = (chi2[n] - larger) / reference.dispersion
        if ratio < 1e-6:
            return 1.0
        if ratio > CERTAIN:
            return float(np.exp(-ratio / 2))
        return tail_probability(ratio, arc_length(search.observations, solutions[n], search.bounds))

    for n in range(1, highest + 1):
        found[n] = search.order(n, found.get(n - 1))
        solutions[n], chi2[n] = found[n].solution, found[n].chi2
        p_values[n - 1] = p_of(n - 1, chi2[n])
    limit = p_of(highest, min(reference.chi2, chi2[highest]) - GRID)
    if limit > IRRELEVANT:
        p_values[highest] = limit
    else:
        p_values[highest] = p_of(highest, search.order(highest + 1, found.get(highest)).chi2)
    return found, p_values


def _possible(observations: Observations, orders: Sequence[int]) -> tuple[tuple[int, ...], tuple[str, ...]]:
    """Orders that have no more parameters than there are distinct frequencies or times; raises where none is left."""
    distinct = _distinct(observations)
    asked = tuple(sorted(set(orders)))
    wanted = tuple(n for n in asked if 2 * n + 1 <= distinct)
    if not wanted:
        raise NotIdentifiableError(
            f"{distinct} distinct frequencies or times for {2 * asked[0] + 1} parameters of order {asked[0]}",
            where=", ".join(observations.groups[:3]),
            expected=f"at least {2 * asked[0] + 1} different frequencies",
            remedy="Record a sweep, or more frequencies",
        )
    left_out = [n for n in asked if n not in wanted]
    if left_out:
        return wanted, (
            f"order {', '.join(map(str, left_out))} not fitted: only {distinct} distinct frequencies or times",
        )
    return wanted, ()


def _distinct(observations: Observations) -> int:
    values = [b.omega if isinstance(b, Lines) else -b.omega for b in observations.blocks]
    rounded = np.round(np.log(np.abs(np.concatenate(values))), 3) * np.sign(np.concatenate(values))
    return int(np.unique(rounded).size)


def with_errors(fit: RelaxationFit, measured: Sequence[FrequencyResponse], geometry: Geometry | None) -> RelaxationFit:
    """The fit with the errors of eq 4.14 over the usable lines of `measured` film stiffnesses, and the modulus of k0."""
    usable = [r.only_usable() for r in measured]
    usable = [r for r in usable if r.frequency_hz.size]
    if usable:
        f = np.concatenate([r.frequency_hz for r in usable])
        found = errors(fit.model.stiffness(f), np.concatenate([r.value for r in usable]))
        if found is not None:
            fit = replace(fit, magnitude_error=found.magnitude, phase_error_deg=found.phase_deg)
    if geometry is not None and fit.model.k0 > 0:
        fit = replace(fit, modulus_mpa=geometry.modulus_mpa(fit.model.k0))
    return fit


def film_stiffness(response: FrequencyResponse, rig: RigConstants | None) -> FrequencyResponse:
    """Film stiffness for the errors: the divided response where there is a rig, the response itself otherwise."""
    if response.quantity != STIFFNESS or rig_prior(rig) is None or rig is None:
        return response
    try:
        corrected = correct_mechanical(response, rig)
    except NotIdentifiableError:
        return response
    amplification = corrected.amplification
    assert amplification is not None
    return replace(corrected, usable=response.usable & (amplification <= HIGHEST_AMPLIFICATION) & corrected.usable)


_RULES = {"bic": "BIC", "held_out": "the held-out error", "test": "the likelihood-ratio test"}


def _remarks(
    raised: bool,
    statement: str,
    p_values: Mapping[int, float | None],
    wanted: tuple[int, ...],
    choices: Mapping[str, int],
    spread: Spread,
) -> tuple[str, ...]:
    found = []
    if raised:
        found.append(statement)
    elastic, last = p_values.get(0), p_values.get(wanted[-1])
    if elastic is not None and elastic >= 0.01:
        found.append("no relaxation resolved: a spring alone describes the response")
    if last is not None and last < LEVEL and choices["test"] == wanted[-1]:
        found.append(
            f"order {wanted[-1] + 1} would fit better still ({p_equals(last)}); the orders in the lab's settings.toml end"
            f" at {wanted[-1]}"
        )
    others = {rule: n for rule, n in choices.items() if n != choices["test"]}
    for rule, n in others.items():
        found.append(f"{_RULES.get(rule, rule)} would choose order {n}")
    if spread.gain_sd:
        found.append(f"recordings differ by a factor, standard deviation {100 * spread.gain_sd:.2g} %")
    if spread.relative_sd:
        found.append(f"recordings differ in shape by {100 * spread.relative_sd:.2g} % per value beyond noise")
    return tuple(found)


def _several(rig: Rigs) -> bool:
    return rig is not None and not isinstance(rig, RigConstants)


def per_recording(rig: Rigs, count: int) -> list[RigConstants | None]:
    """One rig per recording from one for all or a sequence."""
    if rig is None or isinstance(rig, RigConstants):
        return [rig] * count
    if len(rig) != count:
        raise ValueError(f"{len(rig)} rigs for {count} recordings")
    return list(rig)


def _specimen(responses: Sequence[FrequencyResponse], relaxations: Sequence[RelaxationCurve]) -> str:
    names = [r.specimen_id for r in responses] + [c.specimen_id for c in relaxations]
    return next((name for name in names if name), "")
