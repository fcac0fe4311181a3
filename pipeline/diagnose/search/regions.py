"""What no listed mechanism does, in general terms: a stage of the simulation that depends on something, in any smooth way.

    command → [drive] → V → [actuation] → F_A → [film] → T → [contact] → [rig] → F, x → [sensor] → [drift] → recorded

A region is a stage and what it depends on: "the actuation depends on the voltage". Its function is a sum of a few shapes, each of which
vanishes with its weight; the weights have independent normal priors of one common width, smaller for finer shapes, so that smooth
functions are likelier than ragged ones (a Gaussian process of finite rank: Rasmussen and Williams 2006, section 2.7). A listed mechanism
is a region of which the formula is known.

Belongs here: which regions there are, and their shapes. How probable they are is in `posterior`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pipeline.diagnose.features.kinds import STEP_FORCE, UNDER_VOLTAGE
from pipeline.diagnose.simulation.effects import Course, Effect, Factor, Film, Reading, View, Wave
from pipeline.diagnose.simulation.session import Session
from pipeline.physics.rig import Rig
from schemas.arrays import Complex, Float

STEP = 1e-4
"""Size of the effects by which features are differentiated."""
_SINES = 8
"""Shapes of one variable."""
_LOSS = 0.5
"""Width of the prior of a change in quadrature over that of one in phase."""
_KNOTS, _FINE_KNOTS = 14, 26
"""Frequencies at which a response is free; where a resonance may be narrow."""
_POWERS = (1, 2, 4, 8)
"""Powers of the voltage of every moment."""
_LOW_VOLTAGES = (0.1, 0.3)
"""Shares of the largest voltage at which what a low voltage lacks has gone."""
_CHARGING = ((1, 0.0), (2, 0.0), (2, 0.3), (2, 3.0))
"""Powers of the voltage of a test, and the times s in which what follows it charges; 0: long before the test."""
_SETTLING_S = (0.3, 1.0, 3.0, 10.0)
"""Times after which something within a recording has settled, s."""
_DRIFTING_S = (1.0, 5.0, 30.0, 200.0)
"""The same of a drift, s."""
_RATE_S = 0.1
"""Time by which strain rates are made strains, s."""
_PICKED_UP_S = 0.01
"""Time by which rates of the voltage are made voltages, s."""
_READING_POWERS = (2, 3, 5, 9)
"""Powers of a force in its reading."""
_POINTS = 25
"""Points at which a function is told."""
_LEAST_RANGE_K = 0.1
"""Range of temperatures over which anything may depend on them, K."""

Weight = Callable[[View], Float | Complex]
Shape = Callable[[Float], Float]


@dataclass(frozen=True)
class Region:
    """A stage that depends on something in a way that no law says.

    Parameters
    ----------
    stage, covariate : where, and on what
    text : the same in words
    effects : (K,) one of size `STEP` for each shape
    width : (K,) relative widths of the priors of the shapes' weights
    at, unit : (M,) values of the covariate at which the function is told, and their unit
    shapes : (M, K) the shapes there, as relative changes in phase
    also : a stage in which the same would show alike
    """

    stage: str
    covariate: str
    text: str
    effects: tuple[Effect, ...]
    width: Float
    at: Float
    unit: str
    shapes: Float
    also: str = ""

    @property
    def alike(self) -> tuple[str, str]:
        """Stages of which it may be the form."""
        return self.stage, self.also or self.stage

    @property
    def depends_on(self) -> str:
        """The covariate in the words of the contract."""
        return "amplitude" if self.covariate == "strain" else self.covariate

    @property
    def id(self) -> str:
        """Name of the hypothesis in the tables."""
        return f"{self.stage}/{self.covariate}"

    def weigh(self, weights: Float) -> Effect:
        """The effect with weights (K,) of its shapes, of any size."""
        changed = {}
        for name, weigh in _WEIGHING.items():
            parts = [(part, w) for e, w in zip(self.effects, weights, strict=True) for part in getattr(e, name)]
            if parts:
                changed[name] = (weigh([part for part, _ in parts], np.array([w for _, w in parts])),)
        return Effect(**changed)


def list_regions(session: Session) -> Iterator[Region]:
    """All regions that a session may show.

    Parameters
    ----------
    session : the recordings
    """
    frequency = session.covariate("frequency_hz")
    known = frequency[np.isfinite(frequency) & (frequency > 0)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.1, 10.0)
    yield from _list_of_film(session, low, high)
    yield _of_frequency(
        "rig", "the clamp or its frame resonates in another way", _change_clamp,
        np.geomspace(max(low, high / 40), 1.3 * high, _FINE_KNOTS),
    )  # fmt: skip
    yield from _list_of_sensor(session, low, high)
    if session.scale.voltage_kv > 0:
        yield from _list_of_actuation(session, low, high)


def _list_of_film(session: Session, low: float, high: float) -> Iterator[Region]:
    if session.scale.strain > 0:
        largest = session.scale.strain
        shares = np.linspace(0, 1, _POINTS)
        by_size, widths, told = [], [], []
        for number, shape in enumerate(_SHAPES, 1):
            for turn, width in ((1.0, 1.0), (1j, _LOSS)):
                by_size.append(_change_stiffness(_turn(_of_strain(shape), turn)))
                widths.append(width / number)
                told.append(shape(shares) * (turn == 1.0))
        yield Region(
            "film", "amplitude", "the stiffness depends on the amplitude of the strain", tuple(by_size),
            np.array(widths), shares * largest, "1", np.array(told).T,
        )  # fmt: skip
        yield _of_one(
            "film", "largest_strain", "the stiffness depends on the largest strain so far", _change_stiffness,
            _of_strain_before, shares * largest, "1",
        )  # fmt: skip
        strain = np.linspace(-1, 1, _POINTS)
        bends: list[Callable[[Float, Float], Float]] = [
            lambda x, r: x**2, lambda x, r: x**3, lambda x, r: np.minimum(x, 0.0), lambda x, r: x**5,
        ]  # fmt: skip
        yield Region(
            "film", "strain", "the force depends on the strain in a bent way", tuple(_bend_tension(session, b) for b in bends),
            np.array([1.0, 1.0, 0.7, 0.7]), strain * largest, "1", np.array([b(strain, strain) for b in bends]).T,
        )  # fmt: skip
        rubs: list[Callable[[Float, Float], Float]] = [
            lambda x, r: x * r * _RATE_S,
            lambda x, r: np.tanh(r / _RATE_S),
            lambda x, r: np.abs(x) * np.tanh(r / _RATE_S),
            lambda x, r: x**2 * np.tanh(r / _RATE_S),
        ]
        rising = np.full(_POINTS, 1e3)
        yield Region(
            "contact", "amplitude", "something rubs or slips", tuple(_bend_tension(session, b) for b in rubs),
            np.ones(len(rubs)), shares * largest, "1", np.array([b(shares, rising * (i > 0)) for i, b in enumerate(rubs)]).T,
        )  # fmt: skip
        yield from _list_of_speed(session)
    knots = np.geomspace(low, high, _KNOTS)
    yield _of_frequency("film", "the stiffness depends on the frequency in another way", _change_stiffness, knots)
    yield _of_session_time("film", "the stiffness changes over the session", _change_stiffness, session)
    longest = max(r.duration_s for r in session.recordings)
    time = np.geomspace(min(_SETTLING_S) / 10, longest, _POINTS)
    yield Region(
        "film", "cycle", "the stiffness changes within a recording",
        tuple(_change_stiffness(_of_record_time(s)) for s in _SETTLING_S), np.ones(len(_SETTLING_S)),
        time, "s", np.array([-np.expm1(-time / s) for s in _SETTLING_S]).T,
    )  # fmt: skip
    if session.scale.exposure_kv2_s > 0:
        yield _of_exposure("film", "the stiffness depends on the time under voltage", _change_stiffness, session)
    temperature = session.states.temperature_k
    if np.isfinite(temperature).all() and np.ptp(temperature) > _LEAST_RANGE_K:
        yield _of_one(
            "film", "temperature", "the stiffness depends on the temperature", _change_stiffness,
            lambda shape: _of_state("temperature_k", shape, session), np.linspace(temperature.min(), temperature.max(), _POINTS), "K",
        )  # fmt: skip


def _list_of_speed(session: Session) -> Iterator[Region]:
    rates = 2 * np.pi * session.covariate("frequency_hz") * session.covariate("amplitude")
    moving = rates[np.isfinite(rates) & (rates > 0)]
    if moving.size == 0:
        return
    fastest, shares = float(moving.max()) / session.scale.strain, np.linspace(0, 1, _POINTS)
    drags: list[Callable[[Float, Float], Float]] = [
        lambda x, r: r / fastest, lambda x, r: r * np.abs(r) / fastest**2, lambda x, r: (r / fastest) ** 3,
    ]  # fmt: skip
    yield Region(
        "rig", "rate", "a force follows the speed of the driven end", tuple(_bend_tension(session, b) for b in drags),
        np.ones(len(drags)), shares * float(moving.max()) * session.scale.length_mm, "mm/s",
        np.array([b(shares, shares * fastest) for b in drags]).T,
    )  # fmt: skip


def _list_of_sensor(session: Session, low: float, high: float) -> Iterator[Region]:
    def change_gain(weight: Weight) -> Effect:
        return Effect(force=(lambda view: 1 + STEP * weight(view),))

    yield _of_frequency(
        "sensor",
        "the force channel responds in another way over frequency",
        change_gain,
        np.geomspace(low, high, _KNOTS),
    )
    force = np.linspace(-1, 1, _POINTS)
    yield Region(
        "sensor", "amplitude", "the reading depends on the force in a bent way",
        tuple(Effect(reading=(_bend_reading(p),)) for p in _READING_POWERS), np.array([1.0, 1.0, 0.7, 0.5]),
        force, "largest force", np.array([force**p for p in _READING_POWERS]).T,
    )  # fmt: skip
    yield _of_session_time("sensor", "the gain of the force changes over the session", change_gain, session)
    time = np.geomspace(min(_DRIFTING_S) / 10, max(_DRIFTING_S), _POINTS)
    yield Region(
        "drift", "record_time", "the force drifts within recordings",
        tuple(Effect(drift=(_drift(s),)) for s in _DRIFTING_S), np.ones(len(_DRIFTING_S)),
        time, "s", np.array([-np.expm1(-time / s) for s in _DRIFTING_S]).T,
    )  # fmt: skip


def _list_of_actuation(session: Session, low: float, high: float) -> Iterator[Region]:
    highest = session.scale.voltage_kv
    knots = np.geomspace(low, high, _KNOTS)
    voltage = np.linspace(0, 1, _POINTS)
    at_once = [(power, _bend_squared(power, highest)) for power in _POWERS]
    charging = [(power, _change_actuation(_of_level(power, after_s, highest))) for power, after_s in _CHARGING]
    by_voltage = Region(
        "actuation", "voltage", "the actuation depends on the voltage in another way than by its square",
        tuple(effect for _, effect in at_once + charging), np.ones(len(at_once + charging)),
        voltage * highest, "kV", np.array([voltage**power for power, _ in at_once + charging]).T,
    )  # fmt: skip
    by_frequency = _of_frequency("actuation", "the actuation depends on the frequency", _change_actuation, knots)
    by_time = _of_session_time("actuation", "the actuation changes over the session", _change_actuation, session)
    by_exposure = _of_exposure(
        "actuation", "the actuation depends on the time under voltage", _change_actuation, session
    )
    # Another share of the voltage on the film shows as another actuation does.
    yield from (replace(r, also="drive") for r in (by_voltage, by_frequency, by_time, by_exposure))
    offsets: tuple[Shape, ...] = (np.ones_like, np.sign, *(_make_low_voltage(end) for end in _LOW_VOLTAGES))
    yield Region(
        "drive", "voltage", "the voltage on the film is off by some volts",
        tuple(Effect(film_voltage=(_bend_voltage(b, highest),)) for b in offsets), np.ones(len(offsets)),
        voltage * highest, "kV", np.array([b(voltage) for b in offsets]).T,
    )  # fmt: skip
    picked: tuple[Callable[[Wave], Float], ...] = (
        lambda wave: wave.film_kv / highest,
        lambda wave: (wave.film_kv / highest) ** 2,
        lambda wave: _PICKED_UP_S * _measure_rate(wave) / highest,
        lambda wave: _PICKED_UP_S * _measure_rate(wave) * wave.film_kv / highest**2,
    )
    yield Region(
        "sensor", "voltage", "the force channel picks up the voltage, past film and rig",
        tuple(_pick_up(shape, _measure_actuation(session)) for shape in picked), np.ones(len(picked)),
        voltage * highest, "kV", np.array([voltage, voltage**2, 0 * voltage, 0 * voltage]).T,
    )  # fmt: skip
    yield _of_frequency(
        "drive", "the voltage follows the command in another way",
        lambda weight: Effect(monitor=(lambda view: 1 + STEP * weight(view),)), knots,
    )  # fmt: skip


def _make_low_voltage(end: float) -> Shape:
    """A change of the voltage that ends at a share of the largest one."""
    return lambda z: np.asarray(np.sign(z) * np.exp(-np.abs(z) / end))


def _make_sine(number: int) -> Shape:
    """A shape over 0 … 1 that vanishes at 0."""
    return lambda z: np.asarray(np.sin(np.pi * number * z / 2))


_SHAPES = tuple(_make_sine(number) for number in range(1, _SINES + 1))
"""The widths of their weights fall as 1/n."""


def _of_one(
    stage: str,
    covariate: str,
    text: str,
    make: Callable[[Weight], Effect],
    of: Callable[[Shape], Weight],
    at: Float,
    unit: str,
) -> Region:
    """A region of one variable, at values from where its shapes vanish to where they end."""
    share = (at - at[0]) / max(float(at[-1] - at[0]), 1e-12)
    width = 1 / np.arange(1.0, _SINES + 1)
    shapes = np.array([shape(share) for shape in _SHAPES]).T
    return Region(stage, covariate, text, tuple(make(of(shape)) for shape in _SHAPES), width, at, unit, shapes)


def _of_session_time(stage: str, text: str, make: Callable[[Weight], Effect], session: Session) -> Region:
    time = session.states.session_s
    at = np.linspace(time.min(), time.max(), _POINTS)
    return _of_one(stage, "session_time", text, make, lambda shape: _of_state("session_s", shape, session), at, "s")


def _of_exposure(stage: str, text: str, make: Callable[[Weight], Effect], session: Session) -> Region:
    whole = max(session.scale.exposure_kv2_s, 1e-12)

    def of(shape: Shape) -> Weight:
        return lambda view: shape(np.clip(view.exposure_kv2_s / whole, 0, 1))

    return _of_one(stage, "exposure", text, make, of, np.linspace(0, whole, _POINTS), "kV² s")


def _of_frequency(stage: str, text: str, make: Callable[[Weight], Effect], knots: Float) -> Region:
    """A response that is free at frequencies, in phase and in quadrature, and straight between."""
    step = float(np.log(knots[1] / knots[0]))

    def triangle(place: float, turn: complex) -> Weight:
        return lambda view: (
            turn * np.maximum(0.0, 1 - np.abs(np.log(np.maximum(view.frequency_hz, 1e-9) / place)) / step)
        )

    effects = tuple(make(triangle(place, turn)) for place in knots for turn in (1.0, 1j))
    shapes = np.repeat(np.eye(knots.size), 2, axis=1) * np.tile([1.0, 0.0], knots.size)
    return Region(stage, "frequency", text, effects, np.ones(len(effects)), knots, "Hz", shapes)


def _turn(weight: Weight, by: complex) -> Weight:
    return lambda view: np.asarray(by * weight(view), dtype=np.complex128)


def _of_strain(shape: Shape) -> Weight:
    return lambda view: shape(np.clip(view.strain / view.scale.largest_strain, 0, 1.5))


def _of_strain_before(shape: Shape) -> Weight:
    return lambda view: shape(np.clip(view.strain_before / view.scale.largest_strain, 0, 1.5))


def _of_record_time(after_s: float) -> Weight:
    return lambda view: -np.expm1(-view.recording_s / after_s)


def _of_state(name: str, shape: Shape, session: Session) -> Weight:
    values = getattr(session.states, name)
    low, width = float(values.min()), max(float(np.ptp(values)), 1e-9)
    return lambda view: shape((getattr(view, name) - low) / width)


def _of_level(power: int, after_s: float, highest_kv: float) -> Weight:
    """A power of the voltage of a test, as something that charges."""

    def charged(view: View) -> Complex:
        return np.asarray((view.voltage_kv / highest_kv) ** power / (1 + 2j * np.pi * view.frequency_hz * after_s))

    return charged


def _change_stiffness(weight: Weight) -> Effect:
    def stiffer(film: Film, view: View) -> Film:
        return Film(film.k * (1 + STEP * weight(view)), film.share)

    return Effect(film=(stiffer,))


def _change_actuation(weight: Weight) -> Effect:
    return Effect(actuation=(lambda view: 1 + STEP * weight(view),))


def _change_clamp(weight: Weight) -> Effect:
    def change(own: Complex, rig: Rig, view: View, k: Complex) -> Complex:
        return np.asarray(own + STEP * weight(view))

    return Effect(clamp=(change,))


def _bend_voltage(shape: Shape, highest_kv: float) -> Callable[[Wave], Wave]:
    return lambda wave: replace(
        wave, film_kv=wave.film_kv + STEP * highest_kv * shape(wave.film_kv / highest_kv) * (wave.film_kv != 0)
    )


def _bend_squared(power: int, highest_kv: float) -> Effect:
    """What acts follows the voltage of every moment in another way than by its square."""

    def bend(wave: Wave) -> Wave:
        share = np.abs(wave.film_kv) / highest_kv
        return replace(wave, squared=wave.squared * (1 + STEP * share**power))

    return Effect(squared=(bend,))


def _pick_up(shape: Callable[[Wave], Float], largest_n: float) -> Effect:
    return Effect(picked_up=(lambda wave: STEP * largest_n * shape(wave),))


def _measure_rate(wave: Wave) -> Float:
    """(S, W) slope of the voltage over time, kV/s; 0 at plateaus."""
    if wave.interval_s is None:
        return np.zeros_like(wave.film_kv)
    after, before = (np.roll(wave.film_kv, shift, axis=1) for shift in (-1, 1))
    return np.asarray((after - before) / (2 * wave.interval_s))


def _measure_actuation(session: Session) -> float:
    """Largest force by voltage of a session, N."""
    found = [
        np.abs(p.block.value).max() * (session.scale.voltage_kv**2 if p.block.kind in UNDER_VOLTAGE else 1.0)
        for p in session.places
        if p.block.kind in UNDER_VOLTAGE | {STEP_FORCE} and p.block.size
    ]
    return float(max(found, default=1.0))


def _drift(after_s: float) -> Callable[[Float, Float, float], Float]:
    def rise(recording_s: Float, session_s: Float, rest_force_n: float) -> Float:
        return np.asarray(STEP * max(abs(rest_force_n), 1e-3) * -np.expm1(-recording_s / after_s))

    return rise


def _bend_tension(session: Session, shape: Callable[[Float, Float], Float]) -> Effect:
    """A tension that depends on the strain over the largest, and on its rate."""
    largest, length = session.scale.strain, session.scale.length_mm

    def tension(course: Course) -> Float:
        x = course.strain / largest
        # A step whose film is asked at one time alone has no rate.
        rate = np.gradient(x, axis=-1) / np.broadcast_to(course.interval_s, x.shape) if x.shape[-1] > 1 else 0.0 * x
        return np.asarray(course.tension + STEP * course.static * length * largest * shape(x, rate))

    return Effect(tension=(tension,))


def _bend_reading(power: int) -> Callable[[Reading], Float]:
    def bent(reading: Reading) -> Float:
        if reading.largest_n <= 0:  # no mechanical test says what a large force is
            return reading.force
        return np.asarray(reading.force + STEP * reading.largest_n * (reading.force / reading.largest_n) ** power)

    return bent


def _add_up(changes: Sequence[Float | Complex | float], weights: Float) -> Float | Complex | float:
    """Changes by effects of size `STEP`, each times its weight."""
    return sum((w / STEP * change for w, change in zip(weights.tolist(), changes, strict=True)), 0.0)


def _weigh_factors(parts: Sequence[Factor], weights: Float) -> Factor:
    return lambda view: 1 + _add_up([part(view) - 1 for part in parts], weights)


def _weigh_stiffness(parts: Sequence[Callable[[Film, View], Film]], weights: Float) -> Callable[[Film, View], Film]:
    def stiffer(film: Film, view: View) -> Film:
        return replace(film, k=film.k + _add_up([part(film, view).k - film.k for part in parts], weights))

    return stiffer


def _weigh_clamp(
    parts: Sequence[Callable[[Complex, Rig, View, Complex], Complex]], weights: Float
) -> Callable[[Complex, Rig, View, Complex], Complex]:
    def change(own: Complex, rig: Rig, view: View, k: Complex) -> Complex:
        return np.asarray(own + _add_up([part(own, rig, view, k) - own for part in parts], weights))

    return change


def _weigh_voltage(parts: Sequence[Callable[[Wave], Wave]], weights: Float) -> Callable[[Wave], Wave]:
    def bend(wave: Wave) -> Wave:
        more = _add_up([part(wave).film_kv - wave.film_kv for part in parts], weights)
        return replace(wave, film_kv=np.asarray(wave.film_kv + more))

    return bend


def _weigh_squared(parts: Sequence[Callable[[Wave], Wave]], weights: Float) -> Callable[[Wave], Wave]:
    def bend(wave: Wave) -> Wave:
        more = _add_up([part(wave).squared - wave.squared for part in parts], weights)
        return replace(wave, squared=np.asarray(wave.squared + more))

    return bend


def _weigh_picked(parts: Sequence[Callable[[Wave], Float]], weights: Float) -> Callable[[Wave], Float]:
    return lambda wave: np.asarray(_add_up([part(wave) for part in parts], weights))


def _weigh_drift(
    parts: Sequence[Callable[[Float, Float, float], Float]], weights: Float
) -> Callable[[Float, Float, float], Float]:
    return lambda *at: np.asarray(_add_up([part(*at) for part in parts], weights))


def _weigh_tension(parts: Sequence[Callable[[Course], Float]], weights: Float) -> Callable[[Course], Float]:
    return lambda course: np.asarray(
        course.tension + _add_up([part(course) - course.tension for part in parts], weights)
    )


def _weigh_reading(parts: Sequence[Callable[[Reading], Float]], weights: Float) -> Callable[[Reading], Float]:
    return lambda reading: np.asarray(
        reading.force + _add_up([part(reading) - reading.force for part in parts], weights)
    )


_WEIGHING: dict[str, Callable[[Any, Float], Any]] = {
    "film": _weigh_stiffness,
    "clamp": _weigh_clamp,
    "force": _weigh_factors,
    "actuation": _weigh_factors,
    "monitor": _weigh_factors,
    "film_voltage": _weigh_voltage,
    "squared": _weigh_squared,
    "picked_up": _weigh_picked,
    "drift": _weigh_drift,
    "tension": _weigh_tension,
    "reading": _weigh_reading,
}
"""What an effect changes → how several of them, in proportion to their weights, become one."""
