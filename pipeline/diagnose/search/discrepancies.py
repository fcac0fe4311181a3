"""What the plain simulation gets wrong, place by place, in numbers and words; what an extended one leaves."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from pipeline.diagnose.adequacy import combine
from pipeline.diagnose.features import kinds
from pipeline.diagnose.results import Discrepancy
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.search.extended_model import ExtendedFit
from pipeline.diagnose.search.patterns import compute_block_p
from pipeline.diagnose.simulation.session import Place, Session
from schemas.arrays import Float, Int
from schemas.places import WITHIN, is_beyond_noise

_LEANS = 0.7
"""Mean over root mean square of what is missed from which it is to one side."""
_WORDS = {
    kinds.CHIRP_RESPONSE: "the response F/x₀ of the sweep",
    kinds.CHIRP_HARMONIC: "the harmonics of the force in the sweep",
    kinds.CHIRP_LEVEL: "the mean force of the sweeps",
    kinds.SPHS_RESPONSE: "the response −F/V²",
    kinds.SPHS_DETECTION: "the lines that were not excited",
    kinds.SPHS_VOLTAGE: "the voltage over the command",
    kinds.SPHS_CAPACITANCE: "the capacitance over V²",
    kinds.VOLTAGE_CHIRP_RESPONSE: "the response −F/V² of the sweep",
    kinds.VOLTAGE_CHIRP_HARMONIC: "the harmonics of the force in the sweep of the voltage",
    kinds.VOLTAGE_CHIRP_CAPACITANCE: "the capacitance over V² of the sweep",
    kinds.VOLTAGE_CHIRP_AMPLIFIER: "the voltage over the command of the sweep",
    kinds.CYCLIC_RESPONSE: "the response F/x₀ of the cycles",
    kinds.CYCLIC_HARMONIC: "the harmonics of the force of the cycles",
    kinds.CYCLIC_LEVEL: "the mean force of the cycles",
    kinds.CYCLIC_CAPACITANCE: "the capacitance of the cycles",
    kinds.STEP_FORCE: "the force after the edges of the voltage",
    kinds.STEP_CAPACITANCE: "the capacitance after the edges of the voltage",
    kinds.STEP_VOLTAGE: "the voltage after the edges of the command",
    kinds.RELAXATION_FORCE: "the force after the step of displacement",
    kinds.CYCLE_FORCE: "the force of the load–unload cycle",
    kinds.REST_HUM: "the mains in the rest",
    kinds.TAP_RING: "the clamp's ring after a tap",
    kinds.WEIGHT_GAIN: "the reading of the weights",
}


def list_discrepancies(fit: ExtendedFit, weight: Float | None = None) -> tuple[Discrepancy, ...]:
    """Every block of the session in its bands or spans of time, with χ² and a sentence; worst first.

    All are listed, also those within the noise: a page chooses by probability, in which the noise's own uncertainty
    counts.

    Parameters
    ----------
    fit : the plain model at its optimum
    weight : (N,) of the residuals, where the noise of some tests is louder than that of their rests
    """
    return tuple(sorted(_test_everywhere(fit, weight), key=lambda d: (d.p_value, -d.chi2 / d.degrees_of_freedom)))


def compute_least_p(fit: ExtendedFit) -> float:
    """Probability that the noise alone makes one of all places differ as much as the worst one does (Bonferroni).

    Parameters
    ----------
    fit : the plain model at its optimum
    """
    everywhere = _measure_everywhere(fit.of.session, fit.of.compute_data_residual(fit.x))
    return combine(place.probability for place in everywhere)


def describe_what_stays(plain: ExtendedFit, extended: ExtendedFit) -> tuple[str, ...]:
    """The worst places where causes mend next to nothing of what is far beyond the noise, in words.

    Parameters
    ----------
    plain, extended : the plain model, and the one with the causes
    """
    found = [
        now
        for before, now in zip(_test_everywhere(plain), _test_everywhere(extended), strict=True)
        if now.p_value < RULES.detectable.stays_level
        and now.chi2 > RULES.detectable.stays_rms**2 * now.degrees_of_freedom
        and now.chi2 > RULES.detectable.stays_share * before.chi2
    ]
    worst = sorted(found, key=lambda d: -d.chi2 / d.degrees_of_freedom)[: RULES.detectable.most_told]
    more = (f"{len(found) - len(worst)} more places of this kind.",) if len(found) > len(worst) else ()
    return (*(f"{d.recording_id}: {d.statement[0].lower()}{d.statement[1:]}" for d in worst), *more)


@dataclass(frozen=True)
class _Measured:
    """A band or a span of time of a block: its label, its rows of the block, χ² there and its probability."""

    place: Place
    where: str
    rows: Int
    chi2: float
    probability: float


def _measure_everywhere(session: Session, residual: Float) -> Iterator[_Measured]:
    """Every block in its bands or spans of time, in the order of the session, from a whitened residual (N,)."""
    for number, p in enumerate(session.places):
        doubt = session.doubt_noise(number)
        for where, rows in _split_block(p):
            r = residual[p.first + rows]
            chi2 = float(r @ r)
            # Slow noise of which no rest shows anything may well be louder than it is expected to be.
            spread = float(np.sqrt(RULES.detectable.noise_spread**2 + np.mean(doubt[rows] ** 2)))
            yield _Measured(p, where, rows, chi2, compute_block_p(chi2, rows.size, spread))


def _test_everywhere(fit: ExtendedFit, weight: Float | None = None) -> list[Discrepancy]:
    """The same with a sentence for each."""
    session = fit.of.session
    simulated, residual = fit.of.predict(fit.x), fit.of.compute_data_residual(fit.x)
    residual = residual if weight is None else weight * residual
    everywhere = list(_measure_everywhere(session, residual))
    return [
        Discrepancy(
            session.recordings[m.place.recording].recording_id,
            m.where,
            m.chi2,
            m.rows.size,
            m.probability,
            _write_statement(session, m, simulated, is_beyond_noise(m.probability, len(everywhere))),
        )
        for m in everywhere
    ]


def name_kind(kind: str) -> str:
    """A kind of features in words."""
    return _WORDS[kind]


def _split_block(p: Place) -> list[tuple[str, Int]]:
    """Label and rows of the parts of a block: bands for responses, spans of time for courses."""
    rows = np.arange(p.block.size)
    f, t = p.block.frequency_hz, p.block.time_s
    if p.block.size < RULES.detectable.split_from:
        return [(p.block.label, rows)]
    if np.isfinite(f).all() and (f > 0).all() and np.ptp(np.log(f)) > 0:
        return [(f"{p.block.label}, {_write_range(f[own], 'Hz')}", own) for own in _split_rows(np.log(f), rows)]
    if np.isfinite(t).all() and np.ptp(t) > 0:
        since = t - t.min()
        return [(f"{p.block.label}, {_write_range(since[own], 's')}", own) for own in _split_rows(t, rows)]
    return [(p.block.label, rows)]


def _split_rows(along: Float, rows: Int) -> list[Int]:
    """Rows in parts of equal length along a coordinate."""
    edges = np.linspace(along.min(), along.max(), RULES.detectable.spans + 1)
    number = np.clip(np.searchsorted(edges, along, side="right") - 1, 0, RULES.detectable.spans - 1)
    return [rows[number == i] for i in range(RULES.detectable.spans) if (number == i).any()]


def _write_range(values: Float, unit: str) -> str:
    """A range with its unit."""
    low, high = float(values.min()), float(values.max())
    return f"{low:.3g} to {high:.3g} {unit}" if high > low * 1.0001 else f"{low:.3g} {unit}"


def _write_statement(session: Session, m: _Measured, simulated: Float, is_beyond: bool) -> str:
    """A sentence with size, sign where there is one, and how many times the noise; from the simulated features (N,)."""
    p = m.place
    value = p.block.value[m.rows]
    sd = session.sd[p.first + m.rows]
    difference = simulated[p.first + m.rows] - value
    rms = float(np.sqrt(np.mean((difference / sd) ** 2)))
    subject = f"{_WORDS[p.block.kind][0].upper()}{_WORDS[p.block.kind][1:]} ({m.where})"
    if not is_beyond:
        return f"{subject} is {WITHIN}."
    if p.block.kind == kinds.TAP_RING:
        return _write_ring(subject, difference, sd, value)
    if p.block.kind == kinds.REST_HUM:
        return f"{subject}: there is more power at the mains' frequency than in its neighbourhood."
    turn = _measure_turn(value, difference) if p.block.is_complex else None
    if turn is not None:
        angle, is_ahead = turn
        lean = "" if is_ahead is None else f", simulated too {'early' if is_ahead else 'late'}"
        return (
            f"{subject} is missed by {_write_figure(angle)}° of its phase{lean}: {_write_figure(rms)} times the noise."
        )
    size = float(np.sqrt(np.mean(value**2)))
    relative = float(np.sqrt(np.mean(difference**2)) / size) if size > 0 else float("nan")
    mean = float(np.mean(difference / sd))
    lean = ""
    if abs(mean) > _LEANS * rms and not p.block.is_complex:
        lean = ", simulated too high" if mean * float(np.sign(np.mean(value))) > 0 else ", simulated too low"
    share = f"{_write_figure(100 * relative)} % of it" if relative < 3 else "more than there is"
    return f"{subject} is missed by {share}{lean}: {_write_figure(rms)} times the noise."


def _measure_turn(value: Float, difference: Float) -> tuple[float, bool | None] | None:
    """The mean phase in degrees by which a simulated response is turned, and whether it is ahead; None where more of what is missed is magnitude.

    Parameters
    ----------
    value, difference : (2n,) real parts, then imaginary parts, of the response and of what the simulation adds to it
    """
    half = value.size // 2
    measured, off = (x[:half] + 1j * x[half:] for x in (value, difference))
    size = np.abs(measured)
    if not half or not (size > 0).all() or np.sum(np.abs(off) ** 2) > np.sum(size**2):
        return None
    along = off * np.exp(-1j * np.angle(measured))
    if np.sum(along.imag**2) <= np.sum(along.real**2):
        return None
    angle = np.degrees(np.angle(1 + off / measured))
    whole, mean = float(np.sqrt(np.mean(angle**2))), float(np.mean(angle))
    return whole, mean > 0 if abs(mean) > _LEANS * whole else None


def _write_ring(subject: str, difference: Float, sd: Float, value: Float) -> str:
    """What is missed of a clamp's ring: its frequency or its damping, whichever is farther off."""
    worse = int(np.argmax(np.abs(difference / sd)))
    share = np.expm1(difference[0]) if worse == 0 else difference[1] / value[1]
    what = "frequency" if worse == 0 else "damping"
    times = float(np.abs(difference[worse] / sd[worse]))
    lean = "high" if difference[worse] > 0 else "low"
    return (
        f"{subject} has its {what} simulated {_write_figure(100 * abs(float(share)))} % too {lean}: {_write_figure(times)} times the noise;"
        " clamp or load cell were others then."
    )


def _write_figure(value: float) -> str:
    """Two digits without powers of ten: "1.3", "27", "2700"."""
    rounded = float(f"{value:.2g}")
    return f"{rounded:.0f}" if rounded >= 10 else f"{rounded:g}"
