"""Gains of a PI controller by the shape of its open loop, with margins that hold for the films that a fit leaves
possible.

The controller has a square-root drive, so that the open loop is linear in V²:

    L(jω) = (Kp + Ki/jω) a g/κ(jω) · 1/(1 + jωτ) · 1/(1 + jω/ω_f) · e^(−jωh 3/2)

a the amplifier's gain times its largest voltage, g/κ the film's (`SensedFilms.response`), τ and ω_f of amplifier and
filter, h the interval of decision (held for h, decided one h late at most).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.fit.control.loops import Electronics, measure_performance, simulate_loops
from pipeline.physics.controllers import ProportionalIntegral
from pipeline.physics.sensed_film import SensedFilms
from schemas.arrays import Bool, Complex, Float
from schemas.errors import NotIdentifiableError

PHASE_MARGIN_DEG, GAIN_MARGIN = 60.0, 2.0
"""Least margins, in degrees and as a factor (6 dB): what textbooks ask for (Åström and Murray 2008, section 9.3)."""
CERTAINTY = 0.95
"""Share of the possible films that keep the margins."""
_FREQUENCY_HZ = np.geomspace(1e-4, 60.0, 400)
_ZEROS_S = np.geomspace(0.02, 8.0, 15)
_CROSSOVERS_HZ = np.geomspace(0.01, 4.0, 25)


@dataclass(frozen=True)
class Margins:
    """Margins of n loops, (n,) each: phase in degrees at |L| = 1, gain as a factor where the phase passes −180°, and
    the crossover in Hz.
    """

    phase_deg: Float
    gain: Float
    crossover_hz: Float


@dataclass(frozen=True)
class ShapedLoop:
    """Gains, and the margins that 95 % of the possible films keep; `force_kept`: the force's limit is kept by the film
    as fitted.
    """

    controller: ProportionalIntegral
    phase_margin_deg: float
    gain_margin: float
    crossover_hz: float
    force_kept: bool


def open_loop(films: SensedFilms, proportional: float, integral: float, electronics: Electronics) -> Complex:
    """(n, m) L of the loop at the module's frequencies, sign taken out, for gains in V/pF and V/pF/s of a square-root
    drive.
    """
    s = 2j * np.pi * _FREQUENCY_HZ
    own = electronics
    scale = own.gain_kv_per_v * own.largest_kv
    around = scale * (proportional + integral / s) / (1 + s * own.time_constant_s)
    around *= np.exp(-1.5 * s * own.interval_s) / (1 + s / (2 * np.pi * own.filter_hz))
    return np.asarray(around * films.response(_FREQUENCY_HZ) * np.sign(films.gain_pf_per_kv2)[:, None])


def find_margins(loop: Complex) -> Margins:
    """Margins of open loops (n, m) at the module's frequencies, whose gain falls with frequency."""
    size, phase = np.abs(loop), np.degrees(np.unwrap(np.angle(loop), axis=1))
    phase -= 360 * np.round((phase[:, :1] + 45) / 360)
    log_f = np.log(_FREQUENCY_HZ)
    at, crossing = _cross(np.log(size), log_f)
    turn, turned = _cross(phase + 180, log_f)
    rows = np.arange(len(loop))
    phase_at = np.array([np.interp(at[i], log_f, phase[i]) for i in rows])
    size_at = np.array([np.interp(turn[i], log_f, np.log(size[i])) for i in rows])
    return Margins(np.where(crossing, 180 + phase_at, np.inf), np.where(turned, np.exp(-size_at), np.inf), np.exp(at))


def shape_loop(
    film: SensedFilms,
    possible: SensedFilms,
    demand_pf: float,
    hold_s: float,
    electronics: Electronics,
    *,
    overshoot_percent: float = 10.0,
    force_overshoot_percent: float = 10.0,
) -> ShapedLoop:
    """The gains that settle first, of those that keep the margins and the limits of both overshoots.

    Parameters
    ----------
    film : the film as fitted
    possible : films that the fit leaves possible
    demand_pf, hold_s : the step that is asked for
    electronics : the rest of the loop
    overshoot_percent, force_overshoot_percent : limits for the film as fitted

    Returns
    -------
    Where no pair keeps the limit of the force, the pair whose force overshoots least

    Raises
    ------
    NotIdentifiableError
        No pair keeps the margins, or none settles within the hold.
    """
    tried = []
    for zero in _ZEROS_S:
        unit = np.abs(open_loop(film, zero, 1.0, electronics))[0]
        for crossover in _CROSSOVERS_HZ:
            integral = 1 / float(np.interp(crossover, _FREQUENCY_HZ, unit))
            tried.append((zero * integral, integral))
    gains = np.array(tried)
    own = np.concatenate([open_loop(film, p, i, electronics) for p, i in gains])
    margins = find_margins(own)
    kept = gains[(margins.phase_deg >= PHASE_MARGIN_DEG) & (margins.gain >= GAIN_MARGIN)]
    parts = film.springs, film.tau_s, film.gain_pf_per_kv2, film.force_n_per_kv2
    many = SensedFilms(*(np.repeat(part, len(kept), axis=0) for part in parts))
    lowers = bool(film.gain_pf_per_kv2[0] < 0)
    done = measure_performance(
        simulate_loops(many, _root_drive(kept[:, 0], kept[:, 1], lowers, electronics), demand_pf, hold_s, electronics)
    )
    settled = np.isfinite(done.settling_time_s) & (done.overshoot_percent <= overshoot_percent)
    gentle = settled & (done.force_overshoot_percent <= force_overshoot_percent)
    by = np.where(gentle, done.settling_time_s, np.where(settled, 1e6 + done.force_overshoot_percent, np.inf))
    for index in np.argsort(by, kind="stable"):
        if not np.isfinite(by[index]):
            break
        found = find_margins(open_loop(possible, float(kept[index, 0]), float(kept[index, 1]), electronics))
        phase, gain = (float(np.quantile(m, 1 - CERTAINTY)) for m in (found.phase_deg, found.gain))
        if phase >= PHASE_MARGIN_DEG and gain >= GAIN_MARGIN:
            proportional, integral = (float(g) for g in kept[index])
            controller = _root_drive(proportional, integral, lowers, electronics)
            crossover = float(np.median(found.crossover_hz))
            return ShapedLoop(controller, phase, gain, crossover, bool(gentle[index]))
    raise NotIdentifiableError(
        f"no PI gains keep margins of {PHASE_MARGIN_DEG:g}° and {GAIN_MARGIN:g} and settle within {hold_s:g} s",
        expected="a film whose fit is sure enough, and a demand that its voltage reaches",
    )


def _root_drive(
    proportional: float | Float, integral: float | Float, lowers: bool, electronics: Electronics
) -> ProportionalIntegral:
    return ProportionalIntegral(
        proportional,
        integral,
        lowers,
        electronics.gain_kv_per_v,
        electronics.largest_kv,
        square_root_drive=True,
    )


def _cross(falling: Float, x: Float) -> tuple[Float, Bool]:
    """(n,) x where each row first falls below 0 by a chord, and whether it does."""
    below = falling < 0
    there = below.any(axis=1)
    after = np.clip(np.argmax(below, axis=1), 1, x.size - 1)
    rows = np.arange(len(falling))
    high, low = falling[rows, after - 1], falling[rows, after]
    share = np.clip(high / np.where(high == low, 1.0, high - low), 0.0, 1.0)
    return np.asarray(x[after - 1] + share * (x[after] - x[after - 1])), np.asarray(there)
