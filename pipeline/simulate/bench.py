"""One test on the virtual rig: the stages from command to recorded signal, and where an effect plugs in.

    command → drive → V → actuation → F_A → film, contact, rig → F, x → sensor → drift → recorded

Film, contact and rig are one stage of the composition: the clamp moves and the film feels it. An effect changes the
constants of the bench (another film, another amplifier) or appends a function to a stage; several effects are several
such changes, in any number. What the individual effects are belongs to `effects`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.signal import lfilter

from pipeline.physics.film import RelaxationModel
from pipeline.physics.motion import StateSpace, assemble, integrate
from pipeline.physics.rig import Rig
from pipeline.simulate.drive import Amplifier
from schemas.arrays import Float
from schemas.errors import UsageError

STAGES = ("drive", "actuation", "mechanics", "sensor", "drift")
"""In the order of composition."""


@dataclass(frozen=True)
class Signals:
    """What moves during a test, each (n,) on one clock of `interval_s`, canonical units, by quantity.

    Besides the quantities of recordings: `film_voltage` (kV, what reaches the film; `voltage` is what the monitor shows),
    `actuation` (N, Maxwell force of the active part) and `permittivity_change` (share by which a field has changed it).
    """

    interval_s: float
    values: Mapping[str, Float]

    @property
    def time_s(self) -> Float:
        return np.arange(next(iter(self.values.values())).size, dtype=np.float64) * self.interval_s

    def __getitem__(self, quantity: str) -> Float:
        return self.values[quantity]

    def __contains__(self, quantity: object) -> bool:
        return quantity in self.values

    def with_values(self, **changed: Float) -> Signals:
        return replace(self, values={**self.values, **changed})


Stage = Callable[[Signals], Signals]


@dataclass(frozen=True)
class Softening:
    """What is left of a film's stiffness in a test by how far it swings: the describing function of that test.

    `drop` is lost at `largest_mm`; `half_at` of it brings half of what a far larger swing would. Nothing stays from one test to
    the next.
    """

    drop: float
    largest_mm: float
    half_at: float

    def left(self, displacement_mm: Float) -> float:
        """Share of the stiffness in a test with that displacement (n,)."""
        swing = float(np.abs(displacement_mm - displacement_mm[0]).max()) / self.largest_mm
        return 1 - self.drop * swing * (1 + self.half_at) / (swing + self.half_at)


@dataclass(frozen=True)
class Slip:
    """A film end that friction holds in its clamp, up to `holds_n` more or less than the tension before the test.

    Beyond that it slides, and `hardening` times the film's spring at rest pulls it back (a slider with kinematic hardening).
    """

    holds_n: float
    hardening: float

    def felt(self, film: RelaxationModel, displacement_mm: Float, interval_s: float) -> Float:
        """What a film feels of a displacement of the driven end: (n,) mm. The film's own damper is left out of its tension."""
        decays = [math.exp(-interval_s / tau) for tau in film.tau]
        rises = [k * tau / interval_s * (1 - d) for k, tau, d in zip(film.k, film.tau, decays, strict=True)]
        stiffness, back = film.k0 + sum(rises), self.hardening * film.k0
        arms, spring, slipped = [0.0] * len(decays), 0.0, 0.0
        path = displacement_mm - displacement_mm[0]
        lost = np.empty_like(path)
        last = 0.0
        # Each step needs the one before; plain floats are quickest here.
        for i, moved in enumerate(path.tolist()):
            step, last = moved - last, moved
            pull = spring + film.k0 * step - back * slipped
            pull += sum(d * q + r * step for d, q, r in zip(decays, arms, rises, strict=True))
            slides = 0.0
            if abs(pull) > self.holds_n:
                slides = math.copysign(abs(pull) - self.holds_n, pull) / (stiffness + back)
            spring += film.k0 * (step - slides)
            arms = [d * q + r * (step - slides) for d, q, r in zip(decays, arms, rises, strict=True)]
            slipped += slides
            lost[i] = slipped
        return np.asarray(displacement_mm - lost)


@dataclass(frozen=True)
class Film:
    """A film as the rig feels it.

    Parameters
    ----------
    parts : relaxation models in series; a film of one relaxation everywhere is one part, no film is none
    active : index of the part under the active electrode; None without electrode
    force_per_voltage_squared : N/kV², Maxwell force of that part over V²
    pretension_n : N, tension at the pre-stretch before the test
    sensing : index of the part under the sensing electrode; None without
    sensing_length_mm : mm, its stretched length
    rest_capacitance_pf : pF, its capacitance at rest
    shared : the sensing part is the active one
    permittivity_per_kv2, permittivity_time_s : change of the permittivity under a field, as a share per kV², and its
        time constant in s
    softening : how the film softens with its swing; None: not at all
    slip : how it slips in its clamp; None: not at all
    """

    parts: tuple[RelaxationModel, ...] = ()
    active: int | None = None
    force_per_voltage_squared: float = 0.0
    pretension_n: float = 0.0
    sensing: int | None = None
    sensing_length_mm: float = 0.0
    rest_capacitance_pf: float = 0.0
    shared: bool = False
    permittivity_per_kv2: float = 0.0
    permittivity_time_s: float = 1.0
    softening: Softening | None = None
    slip: Slip | None = None

    def parts_in(self, displacement_mm: Float | None) -> tuple[RelaxationModel, ...]:
        """The parts as they are in a test with that displacement (n,), None where nothing is moved."""
        if self.softening is None or displacement_mm is None:
            return self.parts
        left = self.softening.left(displacement_mm)
        return tuple(
            replace(part, k0=left * part.k0, k=tuple(left * k for k in part.k), c_inf=left * part.c_inf)
            for part in self.parts
        )


@dataclass(frozen=True)
class Bench:
    """Everything that is true in one test. `added` holds functions that run after the stage they are listed under."""

    film: Film
    rig: Rig
    amplifier: Amplifier
    added: Mapping[str, tuple[Stage, ...]] = field(default_factory=dict)

    def with_stage(self, name: str, function: Stage) -> Bench:
        """The same bench with one more function after the stage `name`."""
        if name not in STAGES:
            raise ValueError(f"no stage {name!r}, only {', '.join(STAGES)}")
        return replace(self, added={**self.added, name: (*self.added.get(name, ()), function)})

    def equations(self) -> StateSpace:
        """Equations of motion of film, clamp and load cell."""
        return assemble(self.film.parts, self.rig, active=self.film.active, watched=self.film.sensing)

    def stages(self) -> tuple[tuple[str, Stage], ...]:
        """The composition as (stage name, function) in order."""
        own: dict[str, Stage] = {
            "drive": self._drive,
            "actuation": self._actuate,
            "mechanics": self._move,
            "sensor": _unchanged,
            "drift": _unchanged,
        }
        return tuple((name, function) for name in STAGES for function in (own[name], *self.added.get(name, ())))

    def run(self, inputs: Signals) -> Signals:
        """All stages on the inputs: `displacement` (mm) or `command` (V), or `actuation` (N) itself."""
        signals = inputs
        for _, function in self.stages():
            signals = function(signals)
        return signals

    def run_stage(self, name: str, signals: Signals) -> Signals:
        """Only the functions of one stage."""
        for stage, function in self.stages():
            if stage == name:
                signals = function(signals)
        return signals

    def _drive(self, signals: Signals) -> Signals:
        """Adds `film_voltage` and `voltage` to signals that have a `command`; others pass unchanged."""
        if "command" not in signals:
            return signals
        film, monitor = self.amplifier.amplify(signals["command"], signals.interval_s)
        return signals.with_values(film_voltage=film, voltage=monitor)

    def _actuate(self, signals: Signals) -> Signals:
        if "film_voltage" not in signals:
            return signals
        square = signals["film_voltage"] ** 2
        actuation = self.film.force_per_voltage_squared * square
        if not self.film.permittivity_per_kv2:
            return signals.with_values(actuation=actuation)
        keep = math.exp(-signals.interval_s / self.film.permittivity_time_s)
        # The film has had no field before the first sample.
        change = lfilter([0.0, 1 - keep], [1.0, -keep], self.film.permittivity_per_kv2 * square)
        return signals.with_values(actuation=actuation * (1 + change), permittivity_change=change)

    def _move(self, signals: Signals) -> Signals:
        inputs = [signals.values.get("displacement"), signals.values.get("actuation")]
        film = replace(self.film, parts=self.film.parts_in(inputs[0]))
        if film.slip is not None and inputs[0] is not None:
            if len(film.parts) != 1:
                raise UsageError(
                    "a film of several parts cannot slip in its clamp", expected="one relaxation everywhere"
                )
            inputs[0] = film.slip.felt(film.parts[0], inputs[0], signals.interval_s)
        outputs = integrate(replace(self, film=film).equations(), inputs, signals.interval_s)
        moved = signals.with_values(force=self.film.pretension_n + outputs[0])
        if self.film.sensing is None:
            return moved
        return moved.with_values(
            capacitance=capacitance(self.film, outputs[1], signals.values.get("permittivity_change"))
        )


def _unchanged(signals: Signals) -> Signals:
    return signals


def capacitance(film: Film, extension_mm: Float, permittivity_change: Float | float | None = None) -> Float:
    """Capacitance in pF of a sensing part that is longer than at rest by `extension_mm`.

    A part of its own is free to contract sideways: C/C0 = λ_SR (thesis, eq 5.1 to 5.4). One that is active as well is
    held to its width: C/C0 = λ², and the field changes its permittivity (thesis, eq 5.12 and section 5.4.2).
    """
    stretch = 1 + extension_mm / film.sensing_length_mm
    if not film.shared:
        return film.rest_capacitance_pf * stretch
    change = 0.0 if permittivity_change is None else permittivity_change
    return np.asarray(film.rest_capacitance_pf * stretch**2 * (1 + change))
