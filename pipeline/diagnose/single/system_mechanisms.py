"""A system of another kind: models of its records with one mechanism each, and what they predict of a part left out.

The plain model is y″ + d y′ + w₀² y = g u of one mode, with further ones beside it where one is asked to be too few; every
mechanism adds one term with one or two parameters to the first (`oscillator`). All are fitted to everything, and for the held-out error to each of two parts, whose other one they
predict (`system_parts`). Means are not compared (`SystemRecord`). An arm that relaxes and a delay are linear: they say
that the order of the plain model is at fault.

Severities are relative to the largest output A of all records:

    stiffening        3k₃A²/w₀², the rise of the tangent there
    drop              −k₃A²/w₀², the loss of stiffness there
    residual          1 − 2|k₂|A/w₀², the tangent that is left there on the softer side
    damping_ratio     c V/(2w₀) at the largest speed V
    overload          true over read output at A, less 1
    slip_force        k q_s/(w₀² A), and hardening k/w₀²
    stiffness_ratio   k₁/w₀², and time_constant_s τ
    delay_s           Δ

Does not belong here: how the models are compared (`comparison`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.diagnose.adequacy import is_at_end
from pipeline.diagnose.mechanisms import Mechanism
from pipeline.diagnose.mechanisms.contact import CLAMP_SLIP
from pipeline.diagnose.mechanisms.film_amplitude import AMPLITUDE_SOFTENING, SLACK, STRAIN_STIFFENING
from pipeline.diagnose.mechanisms.film_time import MISSING_RELAXATION
from pipeline.diagnose.mechanisms.rig import LOAD_CELL_DAMPING
from pipeline.diagnose.mechanisms.sensor import SENSOR_DELAY, SENSOR_SATURATION
from pipeline.diagnose.results import Estimate
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.single.comparison import TriedModel, draw_parameters
from pipeline.diagnose.single.oscillator import (
    ARM,
    BAND_LIMITED,
    CEILING,
    CUBIC,
    DAMPING,
    DELAY,
    DRAG,
    FURTHER,
    GAIN,
    HOLDS,
    QUADRATIC,
    RATE,
    SLIP,
    STIFFNESS,
    Mode,
    Oscillator,
    SystemRecord,
    count_steps,
    make_linear,
    memory_s,
)
from pipeline.diagnose.single.oscillator_fit import (
    LOWER,
    UPPER,
    Fit,
    LinearStarts,
    Problem,
    clip_parameters,
    fit_all,
    join_compared,
)
from pipeline.diagnose.single.system_parts import estimate_noise_sd, split_in_two
from schemas.arrays import Bool, Float, Int
from schemas.errors import NotIdentifiableError

_LINEAR = (STIFFNESS, DAMPING, GAIN)
_LARGEST = 1e100
"""Values of a record from which sums of their powers leave the range of doubles."""
_AT_ONCE = 0.95
"""Resonance over half the sampling rate from which a record shows none."""
MOST_RESONANCES = 1 + len(FURTHER)
"""Resonances that a linear simulation may have."""
_DRAWN = 200
"""Parameters that are drawn from what a fit leaves open."""
_SEED = 7
"""Of these draws."""
_BLOCKS = 50
"""Most blocks that a part is drawn anew from: the error grows and falls with the amplitude, which lasts."""
_SAFETY = 0.7
"""Damping on which run-ins are counted, over that of the linear fit, which a bent resonance broadens."""


@dataclass(frozen=True)
class Part:
    """A part that was left out.

    Parameters
    ----------
    name : in words
    values : its place in `left_out`
    places : (H,) its places among all compared values
    """

    name: str
    values: slice
    places: Int


@dataclass(frozen=True)
class Simulated:
    """A model's simulations of all records, fitted to everything.

    Parameters
    ----------
    mechanism : of the model; empty for the plain one
    outputs : (n,) per record, in its unit
    compared : (n,) per record, where it is compared
    parameters : (PARAMETERS,)
    """

    mechanism: str
    outputs: tuple[Float, ...]
    compared: tuple[Bool, ...]
    parameters: Float


@dataclass(frozen=True)
class SystemQuestion:
    """Models of a system, what they are compared on, and what the pages show.

    Parameters
    ----------
    measured : (N,) compared values of all records
    left_out : (H,) those of the parts left out, one after the other
    sd, noise : standard deviation of the noise of one value, and in words how it was told
    plain, models : the plain model, and those with a mechanism
    resonances : of the plain model
    further : a linear model with one resonance more; None where that has no finite simulation or is not tried
    parts : what was left out
    angular_frequency, damping_ratio : of the linear system, rad/s and share of the critical one
    amplitude : largest output
    names, times : of all records, and (n,) s
    measured_outputs : (n,) per record as compared
    simulations : the plain model's first
    without : mechanisms, in words, whose models have no finite simulation and are left out
    hold : what the input does between samples
    """

    measured: Float
    left_out: Float
    sd: float
    noise: str
    plain: TriedModel
    models: tuple[TriedModel, ...]
    resonances: int
    further: TriedModel | None
    parts: tuple[Part, ...]
    angular_frequency: float
    damping_ratio: float
    amplitude: float
    names: tuple[str, ...]
    times: tuple[Float, ...]
    measured_outputs: tuple[Float, ...]
    simulations: tuple[Simulated, ...]
    without: tuple[str, ...] = ()
    hold: str = BAND_LIMITED


Report = Callable[[Float, float, float], Mapping[str, Float]]
"""Parameters (…, PARAMETERS), largest speed over A w, and w in rad/s → severities by key."""


@dataclass(frozen=True)
class _SystemMechanism:
    """A mechanism of the list as a term of a system's equation.

    Parameters
    ----------
    mechanism : of the list
    variant, equation : in words, and with the term
    rows : parameters that are free beyond the linear ones
    starts : of them, each tried
    report : severities by key
    nothing : the first of them without the term
    negative : the mechanism that the term stands for where the first of its parameters is negative, and its report
    """

    mechanism: Mechanism
    variant: str
    equation: str
    rows: tuple[int, ...]
    starts: tuple[tuple[float, ...], ...]
    report: Report
    negative: tuple[Mechanism, Report] | None = None
    nothing: float = 0.0

    def choose_sign(self, value: float) -> tuple[Mechanism, Report]:
        """The mechanism and its report by the value of the first parameter."""
        return (self.mechanism, self.report) if value >= 0 or self.negative is None else self.negative


def _report_stiffening(p: Float, speed: float, w: float) -> Mapping[str, Float]:
    return {"stiffening": 3 * p[..., CUBIC] / p[..., STIFFNESS]}


def _report_drop(p: Float, speed: float, w: float) -> Mapping[str, Float]:
    return {"drop": -p[..., CUBIC] / p[..., STIFFNESS]}


def _report_quadratic(p: Float, speed: float, w: float) -> Mapping[str, Float]:
    return {"residual": 1 - 2 * np.abs(p[..., QUADRATIC]) / p[..., STIFFNESS]}


def _report_drag(p: Float, speed: float, w: float) -> Mapping[str, Float]:
    return {"damping_ratio": p[..., DRAG] * speed / 2 / np.sqrt(p[..., STIFFNESS])}


def _report_ceiling(p: Float, speed: float, w: float) -> Mapping[str, Float]:
    # The largest reading is 1: y = 1/√(1 − l) before the ceiling.
    return {"overload": 1 / np.sqrt(np.maximum(1 - p[..., CEILING], 1e-6)) - 1}


def _report_slip(p: Float, speed: float, w: float) -> Mapping[str, Float]:
    return {
        "slip_force": p[..., ARM] * np.exp(-p[..., SLIP]) / p[..., STIFFNESS],
        "hardening": p[..., ARM] / p[..., STIFFNESS],
    }


def _report_arm(p: Float, speed: float, w: float) -> Mapping[str, Float]:
    return {"stiffness_ratio": p[..., ARM] / p[..., STIFFNESS], "time_constant_s": np.exp(-p[..., RATE]) / w}


def _report_delay(p: Float, speed: float, w: float) -> Mapping[str, Float]:
    return {"delay_s": p[..., DELAY] / w}


MECHANISMS: tuple[_SystemMechanism, ...] = (
    _SystemMechanism(
        STRAIN_STIFFENING,
        "cubic stiffness",
        "y″ + d y′ + w₀² y + k₃ y³ = g u",
        (CUBIC,),
        ((0.0,),),
        _report_stiffening,
        (AMPLITUDE_SOFTENING, _report_drop),
    ),
    _SystemMechanism(
        SLACK,
        "quadratic stiffness",
        "y″ + d y′ + w₀² y + k₂ y² = g u",
        (QUADRATIC,),
        ((0.0,),),
        _report_quadratic,
        nothing=1.0,
    ),
    _SystemMechanism(
        LOAD_CELL_DAMPING,
        "damping grows with speed",
        "y″ + d y′ + c |y′| y′ + w₀² y = g u",
        (DRAG,),
        ((0.0,),),
        _report_drag,
    ),
    _SystemMechanism(
        SENSOR_SATURATION,
        "reading bends to a ceiling",
        "reading y/√(1 + y²/L²)",
        (CEILING,),
        ((0.0,),),
        _report_ceiling,
    ),
    _SystemMechanism(
        CLAMP_SLIP,
        "friction that yields",
        "y″ + d y′ + w₀² y + k q = g u, q′ = y′ − |y′| q/q_s",
        (ARM, SLIP),
        ((0.05, np.log(2.0)), (0.05, np.log(20.0))),
        _report_slip,
    ),
    _SystemMechanism(
        MISSING_RELAXATION,
        "an arm that relaxes",
        "y″ + d y′ + w₀² y + k₁ q = g u, q′ = y′ − q/τ",
        (ARM, RATE),
        ((0.05, np.log(0.3)), (0.05, np.log(3.0))),
        _report_arm,
    ),
    _SystemMechanism(SENSOR_DELAY, "output late", "reading y(t − Δ)", (DELAY,), ((0.0,),), _report_delay),
)
"""The mechanisms that a system is asked for."""


def list_asked() -> frozenset[str]:
    """Ids of the mechanisms that a system is asked for, of either sign."""
    both = ((m.mechanism, *(m.negative[:1] if m.negative else ())) for m in MECHANISMS)
    return frozenset(mechanism.id for ones in both for mechanism in ones)


def ask_system(
    records: Sequence[SystemRecord],
    resonances: int = 1,
    *,
    sd: float | None = None,
    hold: str | None = None,
    starts: LinearStarts | None = None,
) -> SystemQuestion:
    """Models of one system's records, fitted to everything and to each of two parts.

    Parameters
    ----------
    records : all with one sampling interval
    resonances : of the plain model
    sd : standard deviation of the noise of one output, where the caller knows it, for instance from periods that repeat
    hold : what the input does between samples; None: what fits the records best
    starts : of the records, where they are asked more than once

    Raises
    ------
    NotIdentifiableError : records too short, or a resonance that they do not tell
    """
    samples = sum(r.input.size for r in records)
    if samples < RULES.single.shortest:
        raise NotIdentifiableError(
            f"the records have {samples} samples",
            expected=f"at least {RULES.single.shortest} to say what bends a resonance",
        )
    if not any(np.ptp(r.input) > 0 for r in records):
        raise NotIdentifiableError("the input does not change", expected="an input that moves the system")
    largest = max(float(np.abs(values).max()) for r in records for values in (r.input, r.output))
    if not largest < _LARGEST:
        raise NotIdentifiableError(
            f"a value as large as {largest:.3g}",
            expected=f"values below {_LARGEST:g}, whose squares can still be added up",
        )
    starts = LinearStarts(records) if starts is None else starts
    begun = _begin_holds(records, resonances, starts) if hold is None else {}
    hold = _choose_hold(begun) if hold is None else hold
    more = starts.find(resonances + 1, hold) if resonances < MOST_RESONANCES else ()
    beside = _recall_beside(records, more)
    if hold in begun and begun[hold].oscillator.run_in * records[0].interval_s >= beside:
        oscillator, start = begun[hold].oscillator, begun[hold].parameters
    else:
        oscillator, start = _start_plain(records, starts.find(resonances, hold), beside, hold)
    known, noise = (sd, "given") if sd is not None else estimate_noise_sd(records)
    steps = _measure_steps(oscillator, start)
    if steps > known:
        # What steps half as long change is what the steps err, and they err a sixteenth.
        oscillator, steps = oscillator.refine(), steps / 16
    measured_outputs = tuple(_centre_output(oscillator, r) for r in records)
    measured = join_compared(oscillator, measured_outputs)
    everything = np.ones(measured.size, dtype=bool)
    name, loud = split_in_two(oscillator, measured_outputs)
    linear = _list_linear_rows(resonances)
    # The plain model, the mechanisms on it, and one resonance more.
    asked: list[tuple[Float, tuple[int, ...], tuple[tuple[float, ...], ...], _SystemMechanism | None]] = [
        (start, linear, ((),), None),
        *((start, linear, term.starts, term) for term in MECHANISMS),
    ]
    if more:
        asked.append((_express(more, oscillator.angular_frequency), _list_linear_rows(resonances + 1), ((),), None))
    problems, owners = [], []
    for number, (begin, rows, tries, term) in enumerate(asked):
        own = term.rows if term else ()
        for given in tries:
            theta = begin.copy()
            theta[list(own)] = given
            for fold, fitted in enumerate((everything, ~loud, loud)):
                problems.append(Problem(theta, (*rows, *own), fitted))
                owners.append((number, fold))
    fits: dict[tuple[int, int], Fit] = {}
    for owner, fit in zip(owners, fit_all(oscillator, measured, problems), strict=True):
        if owner not in fits or fit.cost < fits[owner].cost:
            fits[owner] = fit
    finite = [all(np.isfinite(fits[number, fold].cost) for fold in range(3)) for number in range(len(asked))]
    if not finite[0]:
        raise NotIdentifiableError(
            "a linear resonance has no finite simulation of the records",
            expected="a system that a resonance resembles",
        )
    decay = 2 / min(start[rows[1]] for rows in _list_modes(resonances)) / oscillator.angular_frequency
    memory = int(max(RULES.single.memory * decay / records[0].interval_s, measured.size / _BLOCKS, 1))
    found = {
        number: _try_model(term, [fits[number, fold] for fold in range(3)], oscillator, measured, loud, memory)
        for number, (_, _, _, term) in enumerate(asked)
        if finite[number]
    }
    compared = tuple(oscillator.compared(r) for r in records)
    louder, quieter = np.flatnonzero(loud), np.flatnonzero(~loud)
    tried = [number for number in found if number <= len(MECHANISMS)]
    return SystemQuestion(
        measured=measured,
        left_out=np.concatenate([measured[louder], measured[quieter]]),
        sd=float(np.hypot(known, steps)),
        noise="what the simulation resolves" if steps > known else noise,
        plain=found[0],
        models=tuple(found[number] for number in tried[1:]),
        resonances=resonances,
        further=found.get(1 + len(MECHANISMS)),
        parts=(
            Part(name[0], slice(0, louder.size), louder),
            Part(name[1], slice(louder.size, measured.size), quieter),
        ),
        angular_frequency=oscillator.angular_frequency * float(np.sqrt(start[STIFFNESS])),
        damping_ratio=float(start[DAMPING] / 2 / np.sqrt(start[STIFFNESS])),
        amplitude=oscillator.amplitude,
        names=tuple(r.name for r in records),
        times=tuple(np.arange(float(r.input.size)) * r.interval_s for r in records),
        measured_outputs=measured_outputs,
        simulations=tuple(
            Simulated(found[number].mechanism, fits[number, 0].records, compared, fits[number, 0].parameters)
            for number in tried
        ),
        without=tuple(term.variant for number, term in enumerate(MECHANISMS, 1) if not finite[number]),
        hold=hold,
    )


def _list_modes(resonances: int) -> tuple[tuple[int, ...], ...]:
    """Rows of κ, δ, γ of each resonance."""
    return (_LINEAR, *FURTHER[: resonances - 1])


def _list_linear_rows(resonances: int) -> tuple[int, ...]:
    return tuple(row for rows in _list_modes(resonances) for row in rows)


def _express(modes: Sequence[Mode], omega: float) -> Float:
    """(PARAMETERS,) of resonances in units of a reference frequency; the one that is nearest to it is the first."""
    first, *others = sorted(modes, key=lambda mode: abs(np.log(mode.angular_frequency / omega)))
    start = make_linear(
        2 * first.ratio * first.angular_frequency / omega,
        first.gain / omega**2,
        [
            ((m.angular_frequency / omega) ** 2, 2 * m.ratio * m.angular_frequency / omega, m.gain / omega**2)
            for m in others
        ],
    )
    start[STIFFNESS] = (first.angular_frequency / omega) ** 2
    return clip_parameters(start)


@dataclass(frozen=True)
class _Begun:
    """A linear fit to everything: its oscillator, parameters (PARAMETERS,), and mean square error."""

    oscillator: Oscillator
    parameters: Float
    misfit: float


def _begin_holds(records: Sequence[SystemRecord], resonances: int, starts: LinearStarts) -> dict[str, _Begun]:
    """So many linear resonances fitted to everything, by what the input does between samples; without those that the records do not tell."""
    found: dict[str, _Begun] = {}
    for hold in HOLDS:
        try:
            oscillator, theta = _start_plain(records, starts.find(resonances, hold), 0.0, hold)
        except NotIdentifiableError:
            continue
        measured = join_compared(oscillator, [_centre_output(oscillator, r) for r in records])
        simulated = join_compared(oscillator, [values[0] for values in oscillator(theta[:, None])])
        found[hold] = _Begun(oscillator, theta, float(np.mean((simulated - measured) ** 2)))
    return found


def _choose_hold(begun: Mapping[str, _Begun]) -> str:
    """What the input does between samples: that with which the records are simulated best; band-limited where nothing tells."""
    misfit = {hold: one.misfit for hold, one in begun.items()}
    best = min(misfit, key=lambda hold: misfit[hold], default=BAND_LIMITED)
    worth = RULES.single.other_hold * misfit.get(BAND_LIMITED, np.inf)
    return best if misfit.get(best, np.inf) < worth or (BAND_LIMITED not in misfit and misfit) else BAND_LIMITED


def _recall_beside(records: Sequence[SystemRecord], more: Sequence[Mode]) -> float:
    """Seconds for which the resonances of a further model remember their start; 0 where the records are too short for that."""
    last = sum(r.input.size for r in records) * records[0].interval_s
    beside = max((_recall(mode) for mode in more), default=0.0)
    return beside if beside < RULES.single.run_in * last else 0.0


def _start_plain(
    records: Sequence[SystemRecord], modes: Sequence[Mode], beside: float, hold: str
) -> tuple[Oscillator, Float]:
    """The oscillator in units of the linear fit to everything from resonances, and its parameters (PARAMETERS,).

    Its run-in lasts at least `beside`, in seconds.

    Raises `NotIdentifiableError` where the records do not tell a resonance.
    """
    amplitude = max(float(np.abs(r.output - (0 if r.from_rest else r.output.mean())).max()) for r in records)
    for _ in range(2):
        for mode in modes:
            _check_memory(records, mode)
        main = modes[0]
        memory = max(beside, *(_recall(mode) for mode in modes))
        omega = main.angular_frequency
        oscillator = Oscillator(records, amplitude, omega, _SAFETY * 2 * main.ratio, memory=memory, hold=hold)
        start = _express(modes, omega)
        measured = join_compared(oscillator, [_centre_output(oscillator, r) for r in records])
        problem = Problem(start, _list_linear_rows(len(modes)), np.ones(measured.size, dtype=bool))
        theta = fit_all(oscillator, measured, [problem])[0].parameters
        frequency = float(np.sqrt(theta[STIFFNESS]))
        if abs(frequency - 1) < 0.1:
            break
        modes = [_read_mode(theta[list(rows)], omega) for rows in _list_modes(len(modes))]
    return oscillator, theta


def _read_mode(entries: Float, omega: float) -> Mode:
    """A resonance from its κ, δ, γ in units of a reference frequency."""
    root = float(np.sqrt(entries[0]))
    return Mode(omega * root, float(entries[1]) / 2 / root, float(entries[2]) * omega**2)


def _recall(mode: Mode) -> float:
    """Seconds for which a resonance remembers its start: damped as little as it may be, or as much, where that slows the slower of two poles."""
    damping = 2 * mode.ratio
    return max(memory_s(mode.angular_frequency, one) for one in (_SAFETY * damping, damping / _SAFETY))


def _check_memory(records: Sequence[SystemRecord], mode: Mode) -> None:
    """Raises `NotIdentifiableError` where a system remembers longer than its records last, or takes too long to simulate."""
    last = sum(r.input.size for r in records) * records[0].interval_s
    memory = _recall(mode)
    found = (
        f"the best resonance, {mode.angular_frequency / (2 * np.pi):.3g} Hz with a damping ratio of {mode.ratio:.2g},"
    )
    is_too_long = memory > RULES.single.run_in * last and not all(r.periodic for r in records)
    if is_too_long and mode.angular_frequency >= _AT_ONCE * np.pi / records[0].interval_s:
        raise NotIdentifiableError(
            f"{found} is as fast as the samples: the output follows the input at once, or without a resonance",
            expected="a system whose resonance lies within what is sampled; a pure gain has nothing to ask",
            remedy="Sample faster, if there should be a resonance",
        )
    if is_too_long:
        raise NotIdentifiableError(
            f"{found} remembers its start for {memory:.3g} s and the records last {last:.3g} s",
            expected="records that outlast it, or one steady period (period_s)",
            remedy="Look for spikes in the input and output, which fit no resonance",
        )
    steps = count_steps(records, mode.angular_frequency, _SAFETY * 2 * mode.ratio)
    if steps > RULES.single.most_steps:
        raise NotIdentifiableError(
            f"{found} takes {steps:.3g} steps to simulate",
            expected=f"at most {RULES.single.most_steps}",
            remedy="Look for spikes in the input and output, which fit no resonance",
        )


def _measure_steps(oscillator: Oscillator, start: Float) -> float:
    """Root mean square of what steps half as long change in the simulation of a model (PARAMETERS,)."""
    both = (join_compared(o, [values[0] for values in o(start[:, None])]) for o in (oscillator, oscillator.refine()))
    coarse, fine = both
    return float(np.sqrt(np.mean((coarse - fine) ** 2)))


def _centre_output(oscillator: Oscillator, record: SystemRecord) -> Float:
    """(n,) the record's output as it is compared."""
    if record.from_rest:
        return record.output
    return np.asarray(record.output - float(record.output[oscillator.compared(record)].mean()))


def _try_model(
    term: _SystemMechanism | None,
    fits: Sequence[Fit],
    oscillator: Oscillator,
    measured: Float,
    loud: Bool,
    memory: int,
) -> TriedModel:
    """A model from its fits to everything, to the quiet and to the loud part."""
    rng = np.random.default_rng(_SEED)
    unseen: list[Float] = []
    drawn: list[Float] = []
    for fit, left in ((fits[1], loud), (fits[2], ~loud)):
        seen = fit.problem.fitted
        changes = draw_parameters(fit.jacobian[seen], (fit.simulated - measured)[seen], memory, _DRAWN, rng)
        # What runs away predicts nothing.
        predicted, slope = (np.nan_to_num(x[left], posinf=0, neginf=0) for x in (fit.simulated, fit.jacobian))
        unseen.append(predicted)
        drawn.append(predicted + changes @ slope.T)
    whole = fits[0]
    if term is None:
        id, variant, equation, severity, nothing, at_limit = "", "", "", dict[str, Estimate](), 0.0, False
    else:
        mechanism, report = term.choose_sign(float(whole.parameters[term.rows[0]]))
        id, variant, equation, nothing = mechanism.id, term.variant, term.equation, term.nothing
        severity = _estimate_severity(report, whole, oscillator, measured, memory, rng)
        row = term.rows[0]
        at_limit = is_at_end(float(whole.parameters[row]), 0.0, float(LOWER[row]), float(UPPER[row]))
    delay = severity.get("delay_s")
    return TriedModel(
        mechanism=id,
        variant=variant,
        equation=equation,
        severity=severity,
        whole=whole.simulated,
        unseen=np.concatenate(unseen),
        drawn=np.concatenate(drawn, axis=1),
        nothing=nothing,
        at_limit=at_limit,
        # So much lies in how the input moves from sample to sample: held, it is half an interval later than going straight.
        unresolved=delay is not None and abs(delay.value) < oscillator.records[0].interval_s,
    )


def _estimate_severity(
    report: Report, whole: Fit, oscillator: Oscillator, measured: Float, memory: int, rng: np.random.Generator
) -> dict[str, Estimate]:
    """Severities by key, from the fit to everything and what it leaves open."""
    changes = draw_parameters(whole.jacobian, whole.simulated - measured, memory, _DRAWN, rng)
    around = np.tile(whole.parameters, (_DRAWN, 1))
    around[:, list(whole.problem.free)] += changes
    around = clip_parameters(around)
    speed = _find_largest_speed(oscillator, whole)
    values = report(whole.parameters, speed, oscillator.angular_frequency)
    found = {}
    for key, spread in report(around, speed, oscillator.angular_frequency).items():
        value, (low, high) = float(values[key]), np.quantile(spread, [0.05, 0.95])
        found[key] = Estimate(value, float(np.std(spread)), min(float(low), value), max(float(high), value))
    return found


def _find_largest_speed(oscillator: Oscillator, fit: Fit) -> float:
    """Largest |y′| of a simulation over A w."""
    unit = oscillator.amplitude * oscillator.angular_frequency
    return max(
        float(np.abs(np.gradient(y, r.interval_s)).max()) / unit
        for r, y in zip(oscillator.records, fit.records, strict=True)
    )
