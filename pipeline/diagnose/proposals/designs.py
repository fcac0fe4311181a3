"""Recordings that could be made next: a catalogue around what a session has, and their features as the plain model
would give them.

The features of a recording that was not made have their operators and noise from its input, for which the plain model
supplies an output: what is compared later are predictions, not these values.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from functools import cache

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from pipeline.diagnose.features.blocks import UNIT_NOISE, assembled
from pipeline.diagnose.features.kinds import (
    AMPLIFIER,
    EXTRA_MASS,
    SPHS_VOLTAGE,
    STEP_CAPACITANCE,
    STEP_VOLTAGE,
    TAP_RING,
    WEIGHT_GAIN,
    RecordingFeatures,
)
from pipeline.diagnose.features.reduce import reduce
from pipeline.diagnose.mechanisms.mechanism import CYCLES, RAMPS, SPHS_FORCE, STEP_SENSED, SWEEPS, Mechanism
from pipeline.diagnose.simulation.parameters import Physical
from pipeline.diagnose.simulation.session import Session
from pipeline.diagnose.simulation.voltage_waves import follow_voltage
from pipeline.physics import excitation
from pipeline.physics.rig import TONNES_PER_KG
from schemas.arrays import Complex, Float
from schemas.metadata import RecordingMetadata
from schemas.recording import Channel, Recording

Key = str | float
Test = frozenset[tuple[str, Key]]
"""Keys and values of the `recording` block of a test, without the rest before it and the room it is made in."""

_NS = 1_000_000_000
"""Nanoseconds of a second."""
_PAUSE_S = 60.0
"""Time between two recordings of a session, s."""
_SEED = 3
"""Of the noise of recordings that were not made."""
_RATE_HZ = {"chirp": 1000.0, "sphs": 1000.0, "cyclic": 100.0, "step": 500.0, "relaxation": 100.0}
"""Sample rate at which each test would be recorded, Hz."""
OFTEN = {"chirp": 10, "cyclic": 10, "sphs": 3, "step": 10}
"""How many times as many sweeps, cycles, periods or voltage steps are made where a few do not decide. More periods show
what no model is right to."""
MOST_OFTEN = {"sphs": 10}
"""The same where nothing else decides."""
_TIMES = {2: "twice", 2 * OFTEN["chirp"]: "twenty times"}
_STEPS = {3: "three", 3 * OFTEN["step"]: "thirty"}
_PERIODS = {100: "a hundred", 100 * OFTEN["sphs"]: "three hundred", 100 * MOST_OFTEN["sphs"]: "a thousand"}
_USUAL_HZ, _WIDE_HZ = 100.0, 300.0
"""Ends of the band of a test, and of one that has the resonance of most load cells in it."""
_KINDS = {
    "chirp": SWEEPS,
    "cyclic": CYCLES,
    "relaxation": RAMPS,
    "sphs": SPHS_FORCE | {SPHS_VOLTAGE},
    "step": STEP_SENSED | {STEP_VOLTAGE},
    "tap": {TAP_RING},
    "weight": {WEIGHT_GAIN},
}
_SWEEP_S, _REST_S = 6.0, 2.0
"""Duration of a sweep and of the rest before the next, s."""
_SPHS: dict[str, Key] = {
    "period_s": 2.0,
    "frequency_start_hz": 0.5,
    "lines": "odd",
}
"""What all SPHS of the catalogue have in common."""
_USUAL_STRAIN = 0.02
"""Strain of tests where a session has none."""
_LONG_REST_S, _LONG_HOLD_S = 7200.0, 7200.0
"""Rest in which a film recovers, and hold that shows slow relaxations, s."""
_REST, _WARMER, _TEMPERATURE = "rest_before_s", "warmer_k", "temperature_degc"
_TO_WARM_S, _ROOM_DEGC = 3600.0, 23.0
"""Time in which a film takes the temperature of a room, s; and that of a usual room, °C."""
WARMER_K = 10.0
"""How much warmer a room is made to tell causes apart."""
_EXTRA_KG = "extra_clamp_mass_kg"
_USUAL_CLAMP_KG, _WEIGHTS_KG = 0.1, (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
"""Mass of a clamp where no file gives one, and masses of a usual set of weights, kg."""
_CARRIED = ("actuation_n_per_kv2", "actuation_sd", "layers")
"""What a recording tells of the specimen, and the next one would tell again."""
_CALIBRATION_SD = {"tap": (7e-4, 3e-3), "weight": (1e-3,)}
"""Standard deviations that calibrations have in a laboratory: of ln f and of the damping ratio; of the gain."""


@dataclass(frozen=True)
class Proposal:
    """A recording to make.

    Parameters
    ----------
    design : keys of the contract's `recording` block; with `warmer_k` the room is that much warmer than now, and its
        temperature recorded
    text : how a person would ask for it
    more : recordings of the same protocol to make after it, where one does not decide
    """

    design: Mapping[str, Key]
    text: str
    more: tuple[Mapping[str, Key], ...] = ()

    @property
    def designs(self) -> tuple[Mapping[str, Key], ...]:
        """All recordings of the proposal."""
        return (self.design, *self.more)

    @property
    def test(self) -> str:
        """The kind of test: its protocol, or `relaxation` for a mechanical step."""
        mechanical = self.design.get("loading") == "mechanical"
        protocol = str(self.design["protocol"])
        return "relaxation" if protocol == "step" and mechanical else protocol


def select_showing(proposals: Sequence[Proposal], causes: Sequence[Mechanism]) -> list[Proposal]:
    """Proposals in which at least one of these mechanisms shows plainly."""
    return [p for p in proposals if any(_KINDS[p.test] & m.shows and p.test not in m.faint for m in causes)]


def list_proposals(session: Session, warmer_k: float | None) -> list[Proposal]:
    """Tests around what a session has, and the calibrations of its rig.

    They are long enough to decide: smaller, slower, after rest, at lower voltage, of the other polarity, faster. None
    is larger than what the session has: that could bring effects of its own, or the end of the film.

    Parameters
    ----------
    session : what was measured so far
    warmer_k : how much warmer a room is made; None: no warmer room is proposed
    """
    largest = session.scale.strain if session.scale.strain > 0 else _USUAL_STRAIN
    swings = [2 * r.values.get("largest_strain", 0.0) for r in session.recordings if r.protocol == "chirp"]
    swing = max(swings, default=0.0) or largest / 2
    found: list[Proposal] = []
    for level in (round(0.3 * swing, 4), round(swing, 4)):
        for stop_hz in (_USUAL_HZ, _WIDE_HZ):
            found.append(_propose_chirp(level, stop_hz, 2))
    for level in (round(0.2 * largest, 4), round(0.5 * largest, 4), round(largest, 4)):
        for frequency, cycles in ((0.02, 4.0), (1.0, 30.0)):
            found.append(_propose_cycles(level, frequency, cycles))
    for level in (round(0.5 * largest, 4), round(largest, 4)):
        found.append(
            Proposal(
                {"protocol": "step", "loading": "mechanical", "strain_pp": level, "hold_s": 600.0},
                f"a step of {100 * level:.2g} % strain held for ten minutes",
            )
        )
    rested: dict[str, Key] = {_REST: _LONG_REST_S}
    held: dict[str, Key] = {
        "protocol": "step",
        "loading": "mechanical",
        "strain_pp": round(largest, 4),
        "hold_s": _LONG_HOLD_S,
    }
    hold = f"of {100 * largest:.2g} % strain held for two hours"
    found += [
        Proposal(held, f"a step {hold}"),
        Proposal(
            {**held, **rested}, f"three steps {hold}, with two hours of rest before each", 2 * ({**held, **rested},)
        ),
    ]
    chirps = [p for p in found if p.test == "chirp" and p.design["frequency_stop_hz"] == _USUAL_HZ]
    found += [Proposal({**p.design, **rested}, f"{p.text}, after two hours of rest") for p in chirps]
    found += [
        Proposal(
            {**p.design, _WARMER: 0.0},
            f"{p.text}, then again after an hour in a room {warmer_k:g} K warmer, the temperature recorded",
            ({**p.design, _WARMER: warmer_k, _REST: _TO_WARM_S},),
        )
        for p in chirps
        if warmer_k is not None
    ]
    if session.scale.voltage_kv > 0:
        found += _propose_electrical(session.scale.voltage_kv)
    weight: dict[str, Key] = {"protocol": "weight", "loading": "calibration"}
    tapped: dict[str, Key] = {"protocol": "tap", "loading": "calibration"}
    extra_kg = _choose_extra_kg(session)
    return [
        *found,
        Proposal(weight, "known weights on the load cell, without film"),
        Proposal(tapped, "taps on the clamp, without film"),
        Proposal(
            tapped,
            f"taps on the clamp, without film, and again with {1000 * extra_kg:g} g more on it",
            ({**tapped, _EXTRA_KG: extra_kg},),
        ),
    ]


def _choose_extra_kg(session: Session) -> float:
    """About the mass of the clamp, as sets of weights have it."""
    clamp = next((rig.clamp_mass_kg for rig in session.rigs if rig.clamp_mass_kg), _USUAL_CLAMP_KG)
    return float(min(_WEIGHTS_KG, key=lambda kg: abs(np.log(kg / clamp))))


def repeat_proposal(proposal: Proposal, often: Mapping[str, int]) -> Proposal | None:
    """The same sweeps, cycles, periods or voltage steps, made more often.

    Parameters
    ----------
    proposal : the test
    often : test → how many times as many

    Returns
    -------
    None for other tests, and for those with a rest or another room
    """
    design = proposal.design
    if proposal.test not in often or {_WARMER, _REST} & set(design):
        return None
    if proposal.test == "chirp":
        number = int(float(design["repeats"])) * often["chirp"]
        return _propose_chirp(float(design["strain_pp"]), float(design["frequency_stop_hz"]), number)
    if proposal.test == "cyclic":
        cycles = float(design["cycles"]) * often["cyclic"]
        return _propose_cycles(float(design["strain_pp"]), float(design["frequency_hz"]), cycles)
    kv, polarity = float(design["drive_kv"]), float(design.get("polarity", 1.0))
    if proposal.test == "step":
        return _propose_steps(kv, polarity, int(float(design["cycles"])) * often["step"])
    periods = int(float(design["periods"])) * often["sphs"]
    return _propose_sphs(kv, polarity, float(design["frequency_stop_hz"]), periods)


def _propose_sphs(kv: float, polarity: float, stop_hz: float, periods: int) -> Proposal:
    """So many periods of an SPHS."""
    side, sign = _describe_polarity(polarity)
    wide = "" if stop_hz == _USUAL_HZ else f", to {stop_hz:g} Hz"
    return Proposal(
        {
            "protocol": "sphs",
            "loading": "electrical",
            "drive_kv": kv,
            "frequency_stop_hz": stop_hz,
            **_SPHS,
            "periods": float(periods),
            **sign,
        },
        f"an SPHS with a peak of {kv:g} kV{side}, {_PERIODS[periods]} periods of 2 s{wide}",
    )


def _propose_steps(kv: float, polarity: float, number: int) -> Proposal:
    """So many voltage steps."""
    side, sign = _describe_polarity(polarity)
    return Proposal(
        {
            "protocol": "step",
            "loading": "electrical",
            "drive_kv": kv,
            "on_s": 5.0,
            "off_s": 5.0,
            "cycles": float(number),
            **sign,
        },
        f"{_STEPS[number]} voltage steps of {kv:g} kV{side}, 5 s on and 5 s off",
    )


def _describe_polarity(polarity: float) -> tuple[str, dict[str, Key]]:
    """Words and keys of a design."""
    return ("", {}) if polarity > 0 else (" of the opposite polarity", {"polarity": -1.0})


def _propose_chirp(level: float, stop_hz: float, number: int) -> Proposal:
    """So many sweeps."""
    return Proposal(
        {
            "protocol": "chirp",
            "loading": "mechanical",
            "strain_pp": level,
            "frequency_start_hz": 1.0,
            "frequency_stop_hz": stop_hz,
            "sweep": "log",
            "repeats": float(number),
        },
        f"a chirp from 1 to {stop_hz:g} Hz at {100 * level:.2g} % strain (peak to peak), {_TIMES[number]}",
    )


def _propose_cycles(level: float, frequency_hz: float, number: float) -> Proposal:
    """So many cycles."""
    return Proposal(
        {
            "protocol": "cyclic",
            "loading": "mechanical",
            "strain_pp": level,
            "frequency_hz": frequency_hz,
            "cycles": number,
        },
        f"{number:g} cycles of {100 * level:.2g} % strain (peak to peak) at {frequency_hz:g} Hz",
    )


def _propose_electrical(highest: float) -> list[Proposal]:
    """Tests with voltage, up to the highest that the session has."""
    found = []
    for share in (0.125, 0.25, 0.5, 1.0):
        for polarity in (1.0, -1.0):
            kv = round(share * highest, 2)
            found.append(_propose_sphs(kv, polarity, _USUAL_HZ, 100))
            if polarity > 0 and share == 1.0:
                found.append(_propose_sphs(kv, polarity, _WIDE_HZ, 100))
            found.append(_propose_steps(kv, polarity, 3))
    return found


def reduce_tests(session: Session, physical: Physical) -> Callable[[Test], RecordingFeatures]:
    """Features of tests of the specimen on the session's rig, each made once however often it is proposed.

    Parameters
    ----------
    session, physical : what was measured so far, and the plain model in physical units
    """
    return cache(lambda test: _reduce_test(session, physical, dict(test)))


def imagine_features(
    session: Session, reduced: Callable[[Test], RecordingFeatures], proposal: Proposal
) -> list[RecordingFeatures]:
    """Features of the proposed recordings, made after the session's last one, on its rig.

    Parameters
    ----------
    session : what was measured so far
    reduced : of `reduce_tests`
    proposal : the recordings

    Raises
    ------
    NotIdentifiableError
        as `reduce`
    """
    made: list[RecordingFeatures] = []
    for number, design in enumerate(proposal.designs):
        last = made[-1] if made else session.recordings[-1]
        pause_s = float(design.get(_REST, _PAUSE_S))
        started_at = last.started_at + timedelta(seconds=last.duration_s + pause_s)
        if design["loading"] == "calibration":
            made.append(_imagine_calibration(session, proposal, number, started_at))
        else:
            test = reduced(frozenset((k, v) for k, v in design.items() if k not in (_REST, _WARMER)))
            made.append(_place_test(session, test, design, number, started_at))
    return made


def _place_test(
    session: Session, test: RecordingFeatures, design: Mapping[str, Key], place: int, started_at: datetime
) -> RecordingFeatures:
    """A test at its place after a session, after a rest and in a room as its design says."""
    last = session.recordings[-1]
    values = {**test.values, **{k: v for k, v in last.values.items() if k in _CARRIED}}
    if _REST in design:
        values[_REST] = float(design[_REST])
    if _WARMER in design:
        now = next(
            filter(np.isfinite, (r.values.get(_TEMPERATURE, np.nan) for r in session.recordings[::-1])), _ROOM_DEGC
        )
        values[_TEMPERATURE] = now + float(design[_WARMER])
    return replace(test, recording_id=f"next-{place + 1}", started_at=started_at, values=values)


def _imagine_calibration(session: Session, proposal: Proposal, place: int, started_at: datetime) -> RecordingFeatures:
    """A calibration of the rig; what it would read is predicted later, its noise is what laboratories reach."""
    sd, extra_kg = np.array(_CALIBRATION_SD[proposal.test]), float(proposal.designs[place].get(_EXTRA_KG, 0.0))
    kind = TAP_RING if proposal.test == "tap" else WEIGHT_GAIN
    value = np.zeros(sd.size) if kind == TAP_RING else np.ones(1)
    block = assembled(kind, proposal.text, value, (UNIT_NOISE,), np.diag(sd**2)[None], is_complex=False)
    last = session.recordings[-1]
    return replace(
        last,
        recording_id=f"next-{place + 1}",
        protocol=proposal.test,
        loading="calibration",
        started_at=started_at,
        duration_s=_PAUSE_S,
        blocks=(block,),
        noise=(),
        values={k: v for k, v in last.values.items() if k in _CARRIED} | {EXTRA_MASS: extra_kg * TONNES_PER_KG},
        warnings=(),
    )


def _reduce_test(session: Session, physical: Physical, design: Mapping[str, Key]) -> RecordingFeatures:
    """Features of a test of the specimen, with the output that the plain model gives for its input."""
    last = session.recordings[-1]
    number = session.loaded[int(session.rig[-1])][0]
    kind = Proposal(design, "").test
    rng = np.random.default_rng(_SEED)
    time, given = _INPUTS[kind](design, session.scale.length_mm, 1 / _RATE_HZ[kind])
    electrical = design["loading"] == "electrical"
    channels: dict[str, Float] = {"voltage" if electrical else "displacement": given}
    drive = given**2 if electrical else given
    length = next_fast_len(2 * given.size, real=True)
    frequency = np.asarray(np.fft.rfftfreq(length, 1 / _RATE_HZ[kind]), dtype=np.float64)
    spectrum = rfft(drive, length)

    def answer(response: Complex) -> Float:
        """Causal answer to a drive that begins at rest, without wrapping around."""
        return np.asarray(irfft(spectrum * response, length)[: given.size])

    channels["force"] = answer(_compute_response(physical, number, frequency, electrical))
    kinds = session.kinds
    if electrical and kinds & AMPLIFIER:
        channels["command"] = given / physical.amplifier[number]
    if kind == "step" and STEP_CAPACITANCE in kinds:
        followed = follow_voltage(
            physical,
            physical.film.stiffness(frequency),
            -_compute_response(physical, number, frequency, True),
            physical.actuation,
        )
        channels["capacitance"] = answer(-physical.pf_per_n * followed)
    begin = int(last.started_at.timestamp() * _NS)
    stamps = begin + np.rint(time * _NS).astype(np.int64)
    made = {
        quantity: Channel(
            quantity, stamps, values + rng.normal(0.0, _estimate_noise(session, number, quantity), values.size)
        )
        for quantity, values in channels.items()
    }
    keys = {k: v for k, v in design.items() if k not in ("polarity", "hold_s")}
    metadata = RecordingMetadata.parse(
        {
            **{k: (f"{v:g}" if isinstance(v, float) else v) for k, v in keys.items()},
            "recording_id": "next",
            "specimen_id": session.specimen_id,
            "started_at": last.started_at.isoformat(),
            "total_length_mm": f"{session.scale.length_mm:g}",
        }
    )
    return reduce(Recording(metadata=metadata, rig=last.rig, channels=made))


def _estimate_noise(session: Session, rig: int, quantity: str) -> float:
    law = session.laws.get((rig, quantity))
    return 0.0 if law is None else float(np.sqrt(np.median(law.white)))


def _compute_response(physical: Physical, number: int, frequency: Float, electrical: bool) -> Complex:
    """F/x0 or −F/V² of the plain model at frequencies (m,)."""
    rig, k = physical.rigs[number], physical.film.stiffness(frequency)
    clamp = rig.clamp(2 * np.pi * frequency)
    return -physical.actuation * rig.electrical(k, clamp) if electrical else rig.mechanical(k, clamp)


def _make_clock(duration_s: float, interval_s: float) -> Float:
    return np.asarray(np.arange(round(duration_s / interval_s)) * interval_s)


def _make_chirp(design: Mapping[str, Key], length_mm: float, interval_s: float) -> tuple[Float, Float]:
    repeats = int(float(design["repeats"]))
    time = _make_clock(_REST_S + repeats * (_SWEEP_S + _REST_S), interval_s)
    total: Float = np.zeros(time.size)
    for repeat in range(repeats):
        one = excitation.sweep(
            time - _REST_S - repeat * (_SWEEP_S + _REST_S),
            start_hz=float(design["frequency_start_hz"]),
            stop_hz=float(design["frequency_stop_hz"]),
            duration_s=_SWEEP_S,
            amplitude=float(design["strain_pp"]) * length_mm / 2,
            exponent=-0.3,
            taper_start_s=0.5,
            taper_stop_s=0.05,
        )
        total = total + one
    return time, total


def _make_cyclic(design: Mapping[str, Key], length_mm: float, interval_s: float) -> tuple[Float, Float]:
    frequency, cycles = float(design["frequency_hz"]), int(float(design["cycles"]))
    time = _make_clock(1.0 + cycles / frequency, interval_s)
    peak = float(design["strain_pp"]) * length_mm
    return time, excitation.raised_cosine(time - 1.0, frequency_hz=frequency, peak_to_peak=peak, cycles=cycles)


def _make_relaxation(design: Mapping[str, Key], length_mm: float, interval_s: float) -> tuple[Float, Float]:
    time = _make_clock(8.0 + float(design["hold_s"]), interval_s)
    return time, excitation.ramp(time, start_s=8.0, duration_s=0.2, height=float(design["strain_pp"]) * length_mm)


def _make_sphs(design: Mapping[str, Key], length_mm: float, interval_s: float) -> tuple[Float, Float]:
    period = round(float(design["period_s"]) / interval_s)
    lines = excitation.excited_lines("odd", int(float(design["frequency_stop_hz"]) * float(design["period_s"])))
    wave = excitation.square_root_drive(0.95 * excitation.schroeder_multisine(period, lines), float(design["drive_kv"]))
    rest = np.zeros(round(0.5 / interval_s))
    given = np.concatenate([rest, np.tile(wave, int(float(design["periods"])))]) * float(design.get("polarity", 1.0))
    return _make_clock(given.size * interval_s, interval_s), np.asarray(given, dtype=np.float64)


def _make_step(design: Mapping[str, Key], length_mm: float, interval_s: float) -> tuple[Float, Float]:
    on, off, cycles = (float(design[k]) for k in ("on_s", "off_s", "cycles"))
    time = _make_clock(1.0 + cycles * (on + off), interval_s)
    kv = float(design["drive_kv"]) * float(design.get("polarity", 1.0))
    return time, excitation.pulses(time, levels=(kv,) * int(cycles), on_s=on, off_s=off, first_s=1.0)


_INPUTS: dict[str, Callable[[Mapping[str, Key], float, float], tuple[Float, Float]]] = {
    "chirp": _make_chirp,
    "cyclic": _make_cyclic,
    "relaxation": _make_relaxation,
    "sphs": _make_sphs,
    "step": _make_step,
}
