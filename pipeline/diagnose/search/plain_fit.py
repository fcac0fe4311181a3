"""The plain model of a session: its order, and the optimum of all its parameters.

The order, one to three, is that which the recordings ask for together. Every order is searched from many starts, for a
search that ended early would be taken for a discrepancy.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import nnls

from pipeline.diagnose.features.kinds import (
    AMPLIFIER,
    CAPACITANCE,
    CHIRP_LEVEL,
    CHIRP_RESPONSE,
    CYCLE_FORCE,
    CYCLIC_LEVEL,
    CYCLIC_RESPONSE,
    RELAXATION_FORCE,
    SENSED,
    TAP_RING,
    UNDER_VOLTAGE,
    WEIGHT_GAIN,
)
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.simulation.parameters import SENSING, STRAIN, STRESS, TENSION, BaseModel
from pipeline.diagnose.simulation.session import Session
from pipeline.diagnose.simulation.simulation import Simulation
from pipeline.physics.film import RelaxationModel, debye
from pipeline.physics.least_squares import Solution, minimise
from pipeline.physics.rig import RIGID, Rig
from schemas.arrays import Complex, Float
from schemas.errors import NotIdentifiableError
from schemas.protocols import MECHANICAL

_MECHANICAL = frozenset({CHIRP_RESPONSE, CYCLIC_RESPONSE, RELAXATION_FORCE, CYCLE_FORCE, TAP_RING, WEIGHT_GAIN})
_LEVELS = frozenset({CHIRP_LEVEL, CYCLIC_LEVEL})
_PER_DECADE = 6
"""Arms of a fine ladder per decade of time."""
_MOST = 30
"""Steps of a search at most."""
_IDLE = 0.05
"""Share of the stiffness with which an arm that the mechanical tests do not show is placed anew."""
_OF_ARM = 0.3
"""Share of the stiffness that an arm has where it is placed before anything is known of it."""
_ALIKE = 1.2
"""Ratio of strains within which sweeps are of one strain."""
_PLACES = 6
"""Places at which a further arm is tried."""
_STIFFNESSES, _TIMES = (0.03, 0.1, 0.3, 3.0), (0.03, 1.0, 30.0)
"""Over the first guess at a film that only electrical responses show. The guess is a tenth of the load cell's stiffness
where they do not even tell the order of magnitude, and most films are softer."""
_OTHER_CLAMPS = tuple(float(v) for v in np.exp(np.arange(-10, 11) / 10))
"""Masses over those of the rigs' files for which the film is looked at, and how many of them are tried."""


@dataclass(frozen=True)
class PlainFit:
    """The plain model at its optimum. `misfit` (N,) is the whitened residual of the features, `mechanical` (P,) the entries
    with the film and the rig of the mechanical tests alone, where there are others."""

    model: BaseModel
    theta: Float
    solution: Solution
    chi2: float
    misfit: Float
    mechanical: Float | None = None


def fit_plain(session: Session, simulation: Simulation, *, order: int | None = None) -> PlainFit:
    """The plain model of the order that the recordings ask for, or of `order`, fitted to all features.

    The order is found on the mechanical features, where there are enough of them: they say most of the arms, at a
    fraction of the cost. Where there are none, it is found on all but the voltages: what these are missed by, film and
    rig cannot mend, and beside a large χ² that stays no end of a search is seen to be better than another. Raises
    `NotIdentifiableError` where no response of the film is among the features.
    """
    if _responds_to_motion(session):
        chosen = [p.block.kind in _MECHANICAL for p in session.places]
        shown = sum(p.block.size for p, own in zip(session.places, chosen, strict=True) if own)
        if shown <= session.base_model(RULES.plain.orders[-1]).size:
            # Fewer values than entries say nothing of the number of arms; the mean forces show slow ones.
            chosen = [own or p.block.kind in _LEVELS for p, own in zip(session.places, chosen, strict=True)]
    else:
        chosen = [p.block.kind not in AMPLIFIER for p in session.places]
    if all(chosen) or not any(chosen):
        return _search_near_and_far(session, simulation, order)
    part = session.part(chosen)
    found = _search_near_and_far(part, Simulation(part), order)
    if order is None and found.chi2 > RULES.plain.astray * part.size:
        found = _begin_at_small_strain(part, found) or found
    model = session.base_model(found.model.arms)
    if found.model.is_widened:
        model = model.widened
    start = _make_theta(session, model, found.model.physical(found.theta).film)
    carry_entries(found, model, start)
    model = choose_sensing(session, simulation, model, start)
    starts = [start, *_place_idle_arms(session, model, start)]
    found = min((refit_plain(session, simulation, model, s) for s in starts), key=lambda f: f.chi2)
    whole = found if order else _add_arms_that_suffice(session, simulation, found)
    # The mechanical tests alone know nothing of arms that others show.
    return replace(whole, mechanical=start if whole.model.arms == found.model.arms else None)


def _begin_at_small_strain(session: Session, found: PlainFit) -> PlainFit | None:
    """The film that the sweeps of the smallest strain show, where strains of all sizes have no film in common.

    What depends on the strain vanishes with it: there the film has the arms and the rig the constants that a strong cause hides.

    Parameters
    ----------
    session : mechanical tests
    found : the best fit of all of them

    Returns
    -------
    None where there is no sweep, or where those of the smallest strain show no film either
    """
    strain = np.array(
        [
            session.recordings[p.recording].values.get("largest_strain", np.nan)
            if p.block.kind == CHIRP_RESPONSE
            else np.nan
            for p in session.places
        ]
    )
    if not np.isfinite(strain).any():
        return None
    small = session.part([bool(s < _ALIKE * np.nanmin(strain)) for s in strain])
    alone = _search_near_and_far(small, Simulation(small), None)
    is_film = alone.chi2 < RULES.fit.strong * small.size and alone.model.arms >= found.model.arms
    return alone if is_film else None


def _add_arms_that_suffice(session: Session, simulation: Simulation, found: PlainFit) -> PlainFit:
    """The plain model with the arms with which nothing but noise is left, where there are such: tests of other kinds may show more of
    them than the mechanical ones. Arms that leave something are none of the film's.

    Parameters
    ----------
    session, simulation : with all features
    found : the optimum with the arms that the mechanical tests show
    """
    enough = RULES.plain.sound * session.size
    best = found
    for arms in range(found.model.arms + 1, RULES.plain.orders[-1] + 1):
        if best.chi2 < enough:
            break
        model = _make_model_like(session, found.model, arms)
        times = list_arm_times(session)
        best = min(
            (refit_plain(session, simulation, model, _add_arm(model, best, float(tau))) for tau in times),
            key=lambda f: f.chi2,
        )
    dispersion = max(1.0, best.chi2 / max(session.size - best.theta.size, 1))
    worth = RULES.plain.arm_worth * dispersion * (best.model.arms - found.model.arms)
    return best if best.chi2 < enough and found.chi2 - best.chi2 > worth else found


def list_arm_times(session: Session) -> Float:
    """(T,) relaxation times s at which a further arm is tried."""
    return np.geomspace(*_bound_arm_times(session, estimate_stiffness(session)[0]), _PLACES)


def begin_arm(session: Session, model: BaseModel, theta: Float, ratio: float, time_s: float) -> tuple[BaseModel, Float]:
    """The plain model with one more arm than `model` has at entries theta (P,), and where its search begins.

    The arm begins with a stiffness of `ratio` times that at rest, and relaxes in `time_s`.
    """
    more = _make_model_like(session, model, model.arms + 1)
    film = model.physical(theta).film
    arms = sorted([*zip(film.tau, film.k, strict=True), (time_s, ratio * film.k0)], reverse=True)
    start = more.theta(RelaxationModel(film.k0, tuple(k for _, k in arms), tuple(t for t, _ in arms), 0.0))
    start[more.film.stop :] = theta[model.film.stop :]
    return more, start


def _make_model_like(session: Session, model: BaseModel, arms: int) -> BaseModel:
    """A plain model that is as free as another, with so many arms."""
    own = replace(session.base_model(arms), sensing=model.sensing, is_sized=model.is_sized)
    return own.widened if model.is_widened else own


def carry_entries(found: PlainFit, model: BaseModel, theta: Float) -> None:
    """Writes what a fit says of a model's entries (P,) of the same names into them."""
    for i, name in enumerate(found.model.names):
        place = model.index(name)
        if place is not None:
            theta[place] = found.theta[i]


def _place_idle_arms(session: Session, model: BaseModel, start: Float) -> list[Float]:
    """Starts with the arms that the mechanical tests do not show at other times: what other tests show may be theirs.

    Parameters
    ----------
    session, model : with all features
    start : (P,) film and rig of the mechanical tests
    """
    film = model.physical(start).film
    idle = [i for i, k in enumerate(film.k) if k < RULES.fit.vanished * film.k0]
    if not idle:
        return []
    starts = []
    for tau in list_arm_times(session):
        at = {i: float(tau) * 3.0**n for n, i in enumerate(idle)}
        arms = [
            (at.get(i, t), _IDLE * film.k0 if i in at else k)
            for i, (t, k) in enumerate(zip(film.tau, film.k, strict=True))
        ]
        arms.sort(reverse=True)
        theta = model.theta(RelaxationModel(film.k0, tuple(k for _, k in arms), tuple(t for t, _ in arms), 0.0))
        theta[model.film.stop :] = start[model.film.stop :]
        starts.append(theta)
    return starts


def choose_sensing(session: Session, simulation: Simulation, model: BaseModel, theta: Float) -> BaseModel:
    """The plain model whose sensing region follows what its own capacitance shows, with the film of the mechanical tests.

    Parameters
    ----------
    session, simulation : with all features
    model, theta : the plain model at the film and the rig of the mechanical tests (P,)
    """
    own = np.concatenate([np.full(p.block.size, p.block.kind in SENSED) for p in session.places])
    if not own.any():
        return model

    def whiten_own(values: Float) -> Float:
        return np.asarray(session.whiten(np.where(own, values, 0.0))[own])

    seen = whiten_own(session.value)

    def measure_left(of: BaseModel) -> float:
        """Sum of squares that the best scale leaves of the capacitances."""
        made = whiten_own(simulation.predict(of, theta))
        return float(seen @ seen - (seen @ made) ** 2 / max(float(made @ made), np.finfo(float).tiny))

    return min((replace(model, sensing=each) for each in (STRAIN, TENSION, STRESS)), key=measure_left)


def _responds_to_motion(session: Session) -> bool:
    """Whether the features say how stiff the film is by themselves, without what the voltage does to it."""
    kinds = session.kinds
    return bool(kinds & {CHIRP_RESPONSE, CYCLIC_RESPONSE}) or (RELAXATION_FORCE in kinds and not kinds & UNDER_VOLTAGE)


def refit_plain(
    session: Session, simulation: Simulation, model: BaseModel, start: Float, *, most: int = 40
) -> PlainFit:
    """The optimum of a plain model from a start nearby."""
    about = simulation.about(model.physical(start))
    begin = _scale_sensing(session, about, model, start)
    found = minimise(
        lambda several: compute_residuals(session, about, model, several), begin, *make_bounds(model), most=most
    )
    return PlainFit(model, found.x, found, found.chi2, found.residual[: session.size])


def fit_from_ladders(
    session: Session, simulation: Simulation, model: BaseModel, near: PlainFit | None = None
) -> PlainFit:
    """The best optimum next to rough films that the responses show, and next to another fit of the same model.

    It takes a fraction of the time of `fit_plain`, and may fall short of it.
    """
    f, k = estimate_stiffness(session)
    films = (_cluster_arms(f, k, model.arms)[0], _spread_arms(f, k, model.arms))
    starts = [_make_theta(session, model, film) for film in films] + ([] if near is None else [near.theta])
    return min((refit_plain(session, simulation, model, start) for start in starts), key=lambda f: f.chi2)


def _search_near_and_far(session: Session, simulation: Simulation, order: int | None) -> PlainFit:
    """The search near the rigs' files, or that farther away where only it comes near to the data."""
    found = _choose_order(session, simulation, order)
    if found.chi2 < RULES.plain.astray * session.size:
        return found
    farther = _choose_order(session, simulation, order, widened=True)
    return farther if farther.chi2 < RULES.plain.astray * session.size else found


def _choose_order(session: Session, simulation: Simulation, order: int | None, *, widened: bool = False) -> PlainFit:
    """Orders one after the other, each from the optimum of that below and from rough ladders."""
    found = _fit_order(session, simulation, 1, widened=widened)
    for arms in range(2, (order or RULES.plain.orders[-1]) + 1):
        more = _fit_order(session, simulation, arms, found, widened=widened)
        dispersion = max(1.0, more.chi2 / max(session.size - more.theta.size, 1))
        if order is None and found.chi2 - more.chi2 <= RULES.plain.arm_worth * dispersion:
            break
        found = more
    return found


def compute_residuals(session: Session, simulation: Simulation, model: BaseModel, several: Float) -> Float:
    """(B, N + P′) whitened residuals of several θ (B, P), and their deviations from the prior."""
    data = session.whiten((session.value - simulation.predict_several(model, several)).T).T
    return np.concatenate([data, np.array([compute_deviations(model, theta) for theta in several])], axis=1)


def compute_deviations(model: BaseModel, theta: Float) -> Float:
    """(P′,) deviations of θ from its prior in standard deviations, for the entries that have one."""
    known = np.isfinite(model.prior_sd)
    return np.asarray((theta[: known.size][known] - model.prior_mean[known]) / model.prior_sd[known])


def make_bounds(model: BaseModel) -> tuple[Float, Float]:
    """Least and largest values (P,) of the entries."""
    return np.array([e.low for e in model.entries]), np.array([e.high for e in model.entries])


def _fit_order(
    session: Session, simulation: Simulation, arms: int, lower: PlainFit | None = None, *, widened: bool = False
) -> PlainFit:
    model = session.base_model(arms)
    if widened:
        model = model.widened

    starts = _make_starts(session, model, lower)
    near = model.physical(starts[0]) if lower is None else lower.model.physical(lower.theta)
    about = simulation.about(near)

    def residuals(several: Float) -> Float:
        return compute_residuals(session, about, model, several)

    def searched(starts: Sequence[Float]) -> list[Solution]:
        """The finite ends of searches from these starts, up to the first that has found what there is, or on which
        several agree."""
        ends: list[Solution] = []
        for start in starts:
            begin = _scale_sensing(session, about, model, start)
            end = minimise(residuals, begin, *make_bounds(model), most=_MOST)
            if np.isfinite(end.chi2):
                ends.append(end)
                best = min(e.chi2 for e in ends)
                same = sum(
                    e.converged and e.chi2 < best + max(RULES.plain.same_optimum * best, RULES.plain.same_optimum_chi2)
                    for e in ends
                )
                if end.converged and (end.chi2 < RULES.plain.sound * session.size or same >= RULES.plain.agreeing):
                    break
        return ends

    found = searched(starts)
    if min((end.chi2 for end in found), default=np.inf) >= RULES.plain.astray * session.size:
        found += searched(_try_other_clamps(session, model))
    if not found:
        raise NotIdentifiableError("the plain model has no finite simulation", where=session.specimen_id)
    best = min(found, key=lambda end: end.chi2)
    return PlainFit(model, best.x, best, best.chi2, best.residual[: session.size])


def _make_starts(session: Session, model: BaseModel, lower: PlainFit | None) -> list[Float]:
    """Starts of θ: arms from a ladder fitted to rough stiffnesses, arms spread over the band, one more arm than
    `lower`."""
    f, k = estimate_stiffness(session)
    starts = []
    if lower is not None:
        starts = [_add_arm(model, lower, tau) for tau in np.geomspace(*_bound_arm_times(session, f), _PLACES)[::-1]]
    films = [_cluster_arms(f, k, model.arms)[0], _spread_arms(f, k, model.arms)]
    if not _responds_to_motion(session):
        films += _scale_films(films[1])
    elif model.arms == 1:
        films += _place_one_arm(session, f, k)
    starts += [_make_theta(session, model, film) for film in films]
    return starts


def _place_one_arm(session: Session, f: Float, k: Complex) -> list[RelaxationModel]:
    """Films with one arm at times all over what the recordings show: a slow one is a spring to the responses."""
    lowest = float(np.abs(k).min())
    times = np.geomspace(*_bound_arm_times(session, f), _PLACES)[::-1]
    return [RelaxationModel((1 - _OF_ARM) * lowest, (_OF_ARM * lowest,), (float(tau),), 0.0) for tau in times]


def _scale_films(film: RelaxationModel) -> list[RelaxationModel]:
    """Films as much softer and stiffer than this one, faster and slower, as electrical responses leave open.

    The force that a voltage makes hardly depends on a film that is much softer than the load cell, until resonance.
    """
    return [
        RelaxationModel(s * film.k0, tuple(s * k for k in film.k), tuple(t * tau for tau in film.tau), film.c_inf)
        for s in _STIFFNESSES
        for t in _TIMES
    ]


def _try_other_clamps(session: Session, model: BaseModel) -> list[Float]:
    """Starts with clamps of the masses that leave the film smoothest: from the wrong side of a resonance no slope leads
    over it."""
    tried = []
    for ratio in _OTHER_CLAMPS:
        f, k = estimate_stiffness(session, ratio)
        film, misfit = _cluster_arms(f, k, model.arms)
        tried.append((misfit, model.with_clamps(_make_theta(session, model, film), ratio)))
    tried.sort(key=lambda pair: pair[0])
    return [start for _, start in tried[: RULES.plain.clamps]]


def _bound_arm_times(session: Session, f: Float) -> tuple[float, float]:
    """Shortest and longest relaxation time at which another arm is tried: a slow one shows over a whole recording only."""
    longest = max((r.duration_s for r in session.recordings if r.loading == MECHANICAL), default=0.0)
    return 0.2 / (2 * np.pi * f.max()), max(30 / (2 * np.pi * f.min()), longest)


def _add_arm(model: BaseModel, lower: PlainFit, tau: float) -> Float:
    """θ of the lower order with one more arm at `tau`, which takes its spring from the arms' mean."""
    film = lower.model.physical(lower.theta).film
    arms = [(t, 0.8 * k) for t, k in zip(film.tau, film.k, strict=True)] + [(tau, 0.2 * sum(film.k) / len(film.k))]
    arms.sort(reverse=True)
    theta = model.theta(RelaxationModel(film.k0, tuple(k for _, k in arms), tuple(t for t, _ in arms), 0.0))
    theta[model.film.stop :] = lower.theta[lower.model.film.stop :]
    return theta


def _make_theta(session: Session, model: BaseModel, film: RelaxationModel) -> Float:
    theta = model.theta(film)
    theta[_find_sensing(model)] = 1.0
    return theta


def _find_sensing(model: BaseModel) -> list[int]:
    """Places of the entries that the capacitances are proportional to."""
    return [i for i, name in enumerate(model.names) if name in SENSING]


def _scale_sensing(session: Session, simulation: Simulation, model: BaseModel, theta: Float) -> Float:
    """Entries (P,) with those of the sensing region where they fit best beside the others: the search takes steps of logarithms, and pF per N
    may be thousands."""
    places, scaled = _find_sensing(model), theta.copy()
    if not places:
        return scaled
    own = np.concatenate([np.full(p.block.size, p.block.kind in CAPACITANCE) for p in session.places])
    columns = []
    for place in places:
        alone = theta.copy()
        alone[places] = 0.0
        alone[place] = 1.0
        columns.append(session.whiten(np.where(own, simulation.predict(model, alone), 0.0)))
    seen = session.whiten(np.where(own, session.value, 0.0))
    if all(np.isfinite(c).all() for c in columns):
        scaled[places] = np.linalg.lstsq(np.column_stack(columns), seen, rcond=None)[0]
    return scaled


def estimate_stiffness(session: Session, ratio: float = 1.0) -> tuple[Float, Complex]:
    """Frequencies Hz (m,) and k(jω) N/mm (m,) as the responses have it with the rig as its file says, its clamp `ratio`
    times as heavy.

    Raises `NotIdentifiableError` where no response of the film is among the features.
    """
    frequencies, stiffness = [np.zeros(0)], [np.zeros(0, dtype=complex)]
    for p in session.places:
        if p.block.kind not in (CHIRP_RESPONSE, CYCLIC_RESPONSE):
            continue
        n = p.block.size // 2
        f, g = p.block.frequency_hz[:n], p.block.value[:n] + 1j * p.block.value[n:]
        rig = _load_clamp(session, int(session.rig[p.recording]), ratio)
        clamp = rig.clamp(2 * np.pi * f)
        clear = np.abs(clamp) > RULES.features.clear_response
        frequencies.append(f[clear])
        stiffness.append(rig.film_stiffness(g, clamp)[clear])
    if sum(f.size for f in frequencies) == 0:
        _append_electrical(session, frequencies, stiffness, ratio)
    if sum(f.size for f in frequencies) == 0:
        _append_relaxations(session, frequencies, stiffness)
    f, k = np.concatenate(frequencies), np.concatenate(stiffness)
    sound = np.isfinite(k) & (f > 0)
    if sound.sum() < 2:
        raise NotIdentifiableError(
            "no recording shows the film's response over frequency",
            where=session.specimen_id,
            expected="a chirp, an sphs, a relaxation or cyclic recordings at several frequencies",
        )
    return f[sound], k[sound]


def measure_roughness(session: Session, ratio: float = 1.0) -> float:
    """How far the responses are from those of any film that relaxes, relative, root mean square, with clamps `ratio` times as heavy."""
    f, k = estimate_stiffness(session, ratio)
    return _cluster_arms(f, k, RULES.plain.orders[-1])[1]


def _append_electrical(session: Session, frequencies: list[Float], stiffness: list[Complex], ratio: float) -> None:
    """The same from electrical responses, with the actuation that the geometry promises; the order of magnitude is what counts."""
    for p in session.places:
        if p.block.kind not in UNDER_VOLTAGE:
            continue
        n = p.block.size // 2
        f, h = p.block.frequency_hz[:n], p.block.value[:n] + 1j * p.block.value[n:]
        rig = _load_clamp(session, int(session.rig[p.recording]), ratio)
        drive = session.recordings[p.recording].values.get("actuation_n_per_kv2", float(np.abs(h).max()))
        k = np.ones(f.size, dtype=complex)
        if rig.compliance > 0:
            k = rig.film_stiffness_of_actuation(h, drive, rig.clamp(2 * np.pi * f))
        frequencies.append(f)
        cell = min(rig.stiffness, 1e9)
        stiffness.append(np.where(k.real > 0.02 * cell, k, 0.1 * cell))


def _append_relaxations(session: Session, frequencies: list[Float], stiffness: list[Complex]) -> None:
    """The same from the first holds of relaxations G(t), which show the film at ω = 1/t, roughly: Re k = G, Im k = −(π/2) dG/d ln t
    (Booij and Thoone 1982)."""
    for p in session.places:
        if p.block.kind != RELAXATION_FORCE:
            continue
        since, strain = p.block.support["since_s"], p.block.support["strain"]
        length = session.recordings[p.recording].values["strain_length_mm"]
        first = (np.cumsum(np.diff(since, prepend=0.0) < 0) == 0) & (since > 0)
        if np.count_nonzero(first) < 2:
            continue
        t, g = since[first], p.block.value[first] / (strain[first] * length)
        slope = np.gradient(g, np.log(t))
        frequencies.append(1 / (2 * np.pi * t))
        stiffness.append(g + 1j * np.maximum(-0.5 * np.pi * slope, 0.0))


def _load_clamp(session: Session, number: int, ratio: float) -> Rig:
    """A rig as its file says, its clamp `ratio` times as heavy and with what is known to be on it."""
    prior = session.priors[number]
    if prior is None:
        return RIGID
    return replace(prior.rig, mass=ratio * prior.rig.mass + session.loaded[number][1])


def _fit_ladder(f: Float, k: Complex, times: Float) -> tuple[float, Float, float]:
    """Springs ≥ 0 of arms at `times` under k, least squares relative to |k|: k0, (len(times),) and the misfit, root
    mean square."""
    design = np.column_stack([np.ones(f.size, dtype=complex), debye(2 * np.pi * f, times)]) / np.abs(k)[:, None]
    target = k / np.abs(k)
    springs, left = nnls(np.vstack([design.real, design.imag]), np.concatenate([target.real, target.imag]))
    return max(float(springs[0]), 0.02 * float(np.abs(k).min())), springs[1:], float(left) / np.sqrt(f.size)


def _cluster_arms(f: Float, k: Complex, arms: int) -> tuple[RelaxationModel, float]:
    """As many arms as asked for out of a fine ladder, neighbours merged, nearest first; with the ladder's misfit."""
    low, high = 0.1 / (2 * np.pi * f.max()), 10 / (2 * np.pi * f.min())
    times = np.geomspace(low, high, int(np.log10(high / low) * _PER_DECADE) + 1)
    k0, springs, misfit = _fit_ladder(f, k, times)
    groups = [(float(np.log(t)), float(v)) for t, v in zip(times, springs, strict=True) if v > 1e-4 * k0]
    while len(groups) > arms:
        gap = int(np.argmin(np.diff([g[0] for g in groups])))
        (a, p), (b, q) = groups[gap], groups[gap + 1]
        groups[gap : gap + 2] = [((a * p + b * q) / (p + q), p + q)]
    while len(groups) < arms:
        taken = np.array([g[0] for g in groups] or [0.0])
        places = np.linspace(np.log(low), np.log(high), 25)
        groups.append((float(places[np.argmax(np.min(np.abs(places[:, None] - taken), axis=1))]), 0.05 * k0))
    return _make_film(k0, groups), misfit


def _spread_arms(f: Float, k: Complex, arms: int) -> RelaxationModel:
    """Arms evenly spread over the band."""
    ends = np.log([0.3 / (2 * np.pi * f.max()), 3 / (2 * np.pi * f.min())])
    places = np.linspace(ends[0], ends[1], arms + 2)[1:-1]
    k0, springs, _ = _fit_ladder(f, k, np.exp(places))
    return _make_film(k0, [(float(t), max(float(v), 0.05 * k0)) for t, v in zip(places, springs, strict=True)])


def _make_film(k0: float, groups: Sequence[tuple[float, float]]) -> RelaxationModel:
    ordered = sorted(groups, reverse=True)
    return RelaxationModel(k0, tuple(v for _, v in ordered), tuple(float(np.exp(t)) for t, _ in ordered), 0.0)
