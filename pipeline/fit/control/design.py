"""Controllers for one self-sensing film beside the gains that the thesis prints: what a step of the demand would do.

Force goes with V², and capacitance follows the film's relaxation: to be quick in capacitance, force has to overshoot.
So there are two goals. *Gentle*: as quick as a force allows that overshoots by 10 %. *Quick*: a rise within 0.5 s, the
thesis' goal (section 5.3), with the least overshoot of the force.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pipeline.fit.control.identify import Plant
from pipeline.fit.control.loops import Courses, Electronics, measure_performance, simulate_loops
from pipeline.fit.control.shaping import ShapedLoop, shape_loop
from pipeline.physics.controllers import Controller, FilmInverse, Predictive, ProportionalIntegral
from pipeline.physics.sensed_film import SensedFilms
from schemas.arrays import Float

GENTLE, QUICK, PRINTED = "gentle", "quick", "printed"
SHAPED, INVERSE, PREDICTIVE = "PI, shaped", "film inverse and PI", "predictive"
THESIS_PI = "PI, thesis"
THESIS_GAINS = (10.0, 2.0)
"""V/pF and V/pF/s as the thesis prints them (section 5.3)."""
RISE_S, FORCE_OVERSHOOT_PERCENT = 0.5, 10.0
HOLD_S = 60.0
_SEARCH_S = 5.0
_SHAPE_S = 30.0
_COURSE_S = np.unique(np.round(np.concatenate([[0.0], np.geomspace(0.02, HOLD_S, 90)]), 2))
_PERCENT = (2.5, 97.5)


@dataclass(frozen=True)
class Range:
    """Of the film as fitted, and the 95 % limits over the films that the fit leaves possible; None: never came."""

    value: float | None
    lower: float | None
    upper: float | None


@dataclass(frozen=True)
class ControllerDesign:
    """One controller, and what it would do.

    `proportional_gain`, `integral_gain` in V/pF and V/pF/s, with a square-root drive where `square_root_drive`; None
    for a predictive one. `force_limit_percent`: by how much V² may stand above that which holds the demand. Margins are
    those that 95 % of the possible films keep. `settled_share` of those settle within the hold.
    """

    goal: str
    controller: str
    demand_step_pf: float
    proportional_gain: float | None
    integral_gain: float | None
    square_root_drive: bool
    force_limit_percent: float | None
    phase_margin_deg: float | None
    gain_margin: float | None
    crossover_hz: float | None
    rise_time_s: Range
    settling_time_s: Range
    overshoot_percent: Range
    force_overshoot_percent: Range
    peak_kv: Range
    settled_share: float


@dataclass(frozen=True)
class DesignCourses:
    """Courses of one controller at (t,) s after the change of the demand, film as fitted; limits over the possible
    films are (2, t).
    """

    goal: str
    controller: str
    time_s: Float
    voltage_kv: Float
    capacitance_pf: Float
    capacitance_limits_pf: Float
    force_n: Float
    force_limits_n: Float


@dataclass(frozen=True)
class Candidate:
    """A controller to be tried, with what its row says about it."""

    goal: str
    name: str
    controller: Controller
    pi: ProportionalIntegral | None = None
    force_limit: float | None = None
    shaped: ShapedLoop | None = None


def choose_demand(plant: Plant) -> float:
    """A step of the capacitance in pF that takes half the largest voltage at rest, to two digits."""
    return float(f"{float(plant.film.gain_pf_per_kv2[0]) * plant.largest_kv**2 / 4:.2g}")


def find_force_limit(
    film: SensedFilms, trim: ProportionalIntegral, demand_pf: float, electronics: Electronics
) -> float:
    """Least V² over that at rest with which the inverse of the film rises within 0.5 s, by bisection; at most that of
    the largest voltage.
    """
    low, high = 1.0, electronics.largest_kv**2 * float(film.gain_pf_per_kv2[0]) / demand_pf
    while high / low > 1.005:
        middle = (low * high) ** 0.5
        inverse = FilmInverse(film, trim, middle, electronics.lag_s)
        rise = measure_performance(simulate_loops(film, inverse, demand_pf, _SEARCH_S, electronics)).rise_time_s[0]
        low, high = (low, middle) if rise <= RISE_S else (middle, high)
    return high


def propose_controllers(
    plant: Plant,
    demand_pf: float,
    electronics: Electronics,
    *,
    force_overshoot_percent: float = FORCE_OVERSHOOT_PERCENT,
) -> list[Candidate]:
    """All controllers that are tried: the printed gains, and three for each goal.

    Parameters
    ----------
    plant : what is known of the film
    demand_pf : step that they are designed for
    electronics : the rest of the loop
    force_overshoot_percent : limit of the gentle ones

    Raises
    ------
    NotIdentifiableError
        No PI gains keep the margins.
    """
    lowers = bool(plant.film.gain_pf_per_kv2[0] < 0)
    printed = ProportionalIntegral(*THESIS_GAINS, lowers, electronics.gain_kv_per_v, electronics.largest_kv)
    found = [Candidate(PRINTED, THESIS_PI, printed, printed)]
    limit = 1 + force_overshoot_percent / 100
    gentle = _shape(plant, demand_pf, electronics, limit)
    quick_limit = find_force_limit(plant.film, gentle.controller, demand_pf, electronics)
    for goal, most in ((GENTLE, limit), (QUICK, quick_limit)):
        shaped = gentle if goal == GENTLE else _shape(plant, demand_pf, electronics, most)
        pi = shaped.controller
        inverse = FilmInverse(plant.film, pi, most, electronics.lag_s)
        plan = Predictive(plant.film, electronics.largest_kv, most, electronics.lag_s)
        found += [
            Candidate(goal, SHAPED, pi, pi, None, shaped),
            Candidate(goal, INVERSE, inverse, pi, most, shaped),
            Candidate(goal, PREDICTIVE, plan, None, most),
        ]
    return found


def try_controllers(
    plant: Plant, candidates: list[Candidate], demand_pf: float, electronics: Electronics
) -> tuple[list[ControllerDesign], list[DesignCourses]]:
    """What each controller does with the film as fitted and with those that are possible.

    Parameters
    ----------
    plant, demand_pf, electronics : as in `propose_controllers`
    candidates : controllers

    Returns
    -------
    A row and the courses of each
    """
    both = SensedFilms(
        *(
            np.concatenate([getattr(plant.film, name), getattr(plant.possible, name)])
            for name in ("springs", "tau_s", "gain_pf_per_kv2", "force_n_per_kv2")
        )
    )
    rows, drawn = [], []
    for one in candidates:
        courses = simulate_loops(both, one.controller, demand_pf, HOLD_S, electronics)
        rows.append(_describe(one, courses))
        drawn.append(_thin(one, courses))
    return rows, drawn


def design_controllers(
    plant: Plant, *, electronics: Electronics | None = None, force_overshoot_percent: float = FORCE_OVERSHOOT_PERCENT
) -> tuple[list[ControllerDesign], list[DesignCourses]]:
    """All controllers for a plant, and what they do.

    Parameters
    ----------
    plant : what is known of the film
    electronics : None: a voltage up to the largest that the film was driven with, decisions every 20 ms
    force_overshoot_percent : limit of the gentle ones
    """
    electronics = electronics or Electronics(plant.largest_kv, interval_s=0.02)
    demand = choose_demand(plant)
    candidates = propose_controllers(plant, demand, electronics, force_overshoot_percent=force_overshoot_percent)
    return try_controllers(plant, candidates, demand, electronics)


def _shape(plant: Plant, demand_pf: float, electronics: Electronics, limit: float) -> ShapedLoop:
    return shape_loop(
        plant.film, plant.possible, demand_pf, _SHAPE_S, electronics, force_overshoot_percent=100 * (limit - 1)
    )


def _describe(one: Candidate, courses: Courses) -> ControllerDesign:
    done = measure_performance(courses)
    shaped, pi = one.shaped, one.pi
    return ControllerDesign(
        goal=one.goal,
        controller=one.name,
        demand_step_pf=courses.demand_pf,
        proportional_gain=None if pi is None else float(np.asarray(pi.proportional_gain)),
        integral_gain=None if pi is None else float(np.asarray(pi.integral_gain)),
        square_root_drive=pi is None or pi.square_root_drive,
        force_limit_percent=None if one.force_limit is None else 100 * (one.force_limit - 1),
        phase_margin_deg=None
        if shaped is None or not np.isfinite(shaped.phase_margin_deg)
        else shaped.phase_margin_deg,
        gain_margin=None if shaped is None or not np.isfinite(shaped.gain_margin) else shaped.gain_margin,
        crossover_hz=None if shaped is None else shaped.crossover_hz,
        rise_time_s=_range(done.rise_time_s),
        settling_time_s=_range(done.settling_time_s),
        overshoot_percent=_range(np.round(done.overshoot_percent, 2)),
        force_overshoot_percent=_range(done.force_overshoot_percent),
        peak_kv=_range(done.peak_kv),
        settled_share=float(np.isfinite(done.settling_time_s[1:]).mean()),
    )


def _range(values: Float) -> Range:
    """Limits of those that came; None above where more than 2.5 % never did."""
    own, others = values[0], np.where(np.isfinite(values[1:]), values[1:], np.inf)
    low, high = np.quantile(others, np.array(_PERCENT) / 100, method="inverted_cdf")
    return Range(*(float(x) if np.isfinite(x) else None for x in (own, low, high)))


def _thin(one: Candidate, courses: Courses) -> DesignCourses:
    at = np.minimum(np.searchsorted(courses.time_s, _COURSE_S - 1e-9), courses.time_s.size - 1)
    chosen = replace(
        courses,
        time_s=courses.time_s[at],
        voltage_kv=courses.voltage_kv[:, at],
        capacitance_pf=courses.capacitance_pf[:, at],
        force_n=courses.force_n[:, at],
    )
    return DesignCourses(
        one.goal,
        one.name,
        chosen.time_s,
        chosen.voltage_kv[0],
        chosen.capacitance_pf[0],
        np.percentile(chosen.capacitance_pf[1:], _PERCENT, axis=0),
        chosen.force_n[0],
        np.percentile(chosen.force_n[1:], _PERCENT, axis=0),
    )
