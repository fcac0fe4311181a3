"""What can be hidden in a session: every mechanism id of the contract, and effects that are in no list.

An `Effect` is an id, a severity in the unit of the id's main severity key, and the shape of the truth rig's own form of
it. Severity 0 is exactly the plain rig. For the onset-type mechanisms (`slack`, `wrinkling`, `clamp_slip`,
`sensor_saturation`) the severity is (largest load of the plain session)/(onset) − 1.

Does not belong here: what an effect does to the signals, which the stages (`drive`, `actuation`, `mechanics`, `sensors`)
do, and how it is scaled to a session, which `hidden` does.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

Shape = float | str
TESTS = ("chirp", "sphs", "step", "cyclic", "relaxation")
"""Kinds of recordings; `step` is electrical, `relaxation` is the mechanical step."""


@dataclass(frozen=True)
class Kind:
    """An effect as such.

    `key` is the severity key that the knob is in; `typical` and `strong` are values of it. `shape` gives the default of
    each shape parameter, `ranges` what `random_effect` may draw instead (two numbers: log-uniform; texts: one of them).
    `shows`: tests that show it plainly at the typical severity when the session is young; `silent`: tests that it leaves
    alone. What is in neither is small, or needs a history.
    """

    id: str
    key: str
    typical: float
    strong: float
    shows: tuple[str, ...]
    silent: tuple[str, ...]
    form: str
    shape: Mapping[str, Shape] = field(default_factory=dict)
    ranges: Mapping[str, tuple[float, float] | tuple[str, ...]] = field(default_factory=dict)
    listed: bool = True
    signed: bool = False
    onset: bool = False
    exact: bool = False
    """The severity defines the extension's parameter; else it is the nearest value, forms differ too much for more."""


_MECHANICAL = ("chirp", "cyclic", "relaxation")
_ELECTRICAL = ("sphs", "step")

_ALL = (
    Kind(
        "rig_constants", "mass_error", 0.06, 0.2, ("chirp", "sphs"), ("cyclic", "relaxation"),
        "true constants differ from the file by severity × the parts, beyond what the file's sd allows",
        {"mass_part": 1.0, "stiffness_part": 0.0}, {}, signed=True, exact=True,
    ),
    Kind(
        "load_cell_damping", "damping_ratio", 0.015, 0.05, ("chirp",), ("cyclic", "relaxation"),
        "drag: damper that grows with the clamp's speed; second_mode: small damped mass tuned near the clamp",
        {"form": "drag", "tuning": 1.03}, {"form": ("drag", "second_mode"), "tuning": (0.9, 1.15)},
    ),
    Kind(
        "drive_lag", "rise_time_constant_s", 2e-3, 1e-2, ("sphs", "step"), _MECHANICAL,
        "rise and fall of different rate blended over 50 V, slew limit approached as tanh, small second pole; and again behind the monitor",
        {"fall_ratio": 4.0, "slew_kv_per_s": 1000.0, "behind": 0.0}, {"fall_ratio": (1.5, 6.0), "slew_kv_per_s": (300.0, 3000.0)},
    ),
    Kind(
        "amplitude_softening", "drop", 0.12, 0.3, ("chirp", "cyclic"), _ELECTRICAL,
        "Payne-like: stiffness follows a running amplitude along the path, 1 − D (1 − exp(−(A/A_c)^1.2))",
        {"scale_share": 0.4}, {"scale_share": (0.2, 0.8)},
    ),
    Kind(
        "cyclic_softening", "loss", 0.08, 0.25, ("chirp", "cyclic"), _ELECTRICAL,
        "Mullins-like damage that follows the largest strain so far along the path, less of it near that strain",
        {"cycles": 3.0, "curvature": 1.5}, {"cycles": (1.5, 10.0), "curvature": (0.7, 2.5)},
    ),
    Kind(
        "missing_relaxation", "stiffness_ratio", 0.25, 0.6, _MECHANICAL, (),
        "stretched exponential k_x exp(−(t/τ)^β) as a ladder of arms",
        {"time_constant_s": 3.0, "beta": 0.6}, {"time_constant_s": (0.5, 15.0), "beta": (0.45, 0.8)},
    ),
    Kind(
        "power_law_relaxation", "stiffness_ratio", 0.2, 0.6, _MECHANICAL, (),
        "K (s·1 s)^α as a ladder of 30 arms from 10 µs to 10⁵ s",
        {"exponent": 0.25}, {"exponent": (0.12, 0.4)}, exact=True,
    ),
    Kind(
        "baseline_drift", "per_decade", 0.03, 0.1, TESTS, (),
        "weak power law ((1 + t/t0)^0.08 − 1) that starts again in each recording, or runs over the session",
        {"form": "recording", "onset_s": 1.0}, {"form": ("recording", "session"), "onset_s": (0.3, 5.0)},
    ),
    Kind(
        "thermal_softening", "per_kelvin", 0.015, 0.03, (), (),
        "exp(−β ΔT), ΔT with two time constants over the session and self-heating by what the film dissipates",
        {"rise_k": 5.0, "fast_s": 200.0, "slow_s": 1200.0, "self_heating": 0.2},
        {"rise_k": (3.0, 8.0), "fast_s": (80.0, 400.0), "slow_s": (600.0, 2400.0)},
    ),
    Kind(
        "field_dependent_permittivity", "fraction", 0.08, 0.2, _ELECTRICAL, _MECHANICAL,
        "saturating: ε falls by a tanh((E/E_ref)²)/tanh 1; quartic: by a (E/E_ref)⁴",
        {"form": "saturating"}, {"form": ("saturating", "quartic")},
    ),
    Kind(
        "frequency_dependent_permittivity", "per_decade", 0.03, 0.08, _ELECTRICAL, _MECHANICAL,
        "ladder of eight Debye relaxations of the squared field, 1 ms to 10 s",
        {}, {}, exact=True,
    ),
    Kind(
        "electrode_degradation", "loss", 0.2, 0.4, _ELECTRICAL, ("chirp", "relaxation"),
        "stretched exponential of the exposure ∫V²dt over the session; force and capacitance; cracks open with strain",
        {"exposure_share": 0.33, "stretch": 0.7}, {"exposure_share": (0.2, 0.8), "stretch": (0.6, 1.0)},
    ),
    Kind(
        "slack", "overload", 0.5, 2.0, ("chirp",), _ELECTRICAL,
        "buckling: tension falls into a soft branch as x/(1 − x) with residual stiffness; the preload is lower than in the plain rig",
        {"residual": 0.04, "softness": 0.08}, {"residual": (0.005, 0.1), "softness": (0.03, 0.15)}, onset=True,
    ),
    Kind(
        "strain_stiffening", "stiffening", 0.2, 0.6, ("chirp", "cyclic", "relaxation"), _ELECTRICAL,
        "Gent-type limit of a strain measure under all springs; stiffening of the tangent at the largest strain so driven",
        {"offset_share": 0.3}, {"offset_share": (0.1, 0.5)},
    ),
    Kind(
        "sensor_delay", "delay_s", 4e-4, 2e-3, ("chirp", "sphs"), (),
        "two_pole: two equal poles of that total delay; shift: pure delay",
        {"channel": "force", "form": "two_pole"},
        {"channel": ("force", "displacement"), "form": ("two_pole", "shift")}, exact=True,
    ),
    Kind(
        "gain_error", "gain", 0.05, 0.2, _MECHANICAL, (),
        "one channel times 1 + g",
        {"channel": "force"}, {"channel": ("force", "displacement", "voltage")}, signed=True, exact=True,
    ),
    Kind(
        "drive_offset", "offset_kv", 0.2, 0.5, _ELECTRICAL, _MECHANICAL,
        "the film sees more voltage than the monitor, by V0 that creeps ± 20 % over the session; rectified: dead zone V0",
        {"form": "offset"}, {"form": ("offset", "rectified")}, signed=True,
    ),
    Kind(
        "leakage", "droop", 0.06, 0.2, _ELECTRICAL, _MECHANICAL,
        "series resistance and a film current half ohmic, half sinh(3V/V_max), that builds up within seconds",
        {"build_up_s": 1.5}, {"build_up_s": (0.3, 4.0)},
    ),
    Kind(
        "wrinkling", "overload", 0.3, 1.0, _ELECTRICAL, _MECHANICAL,
        "force stops growing above the onset with hysteresis of the onset, delay and slow recovery",
        {"rise_s": 0.15, "recovery_s": 1.2, "hysteresis": 0.08},
        {"rise_s": (0.05, 0.5), "recovery_s": (0.5, 2.0), "hysteresis": (0.03, 0.15)}, onset=True,
    ),
    Kind(
        "clamp_slip", "overload", 0.6, 4.0, ("chirp", "cyclic"), _ELECTRICAL,
        "four sliders without rate whose forces spread, each with its spring; slip kept from recording to recording",
        {"spread": 1.6, "hardening": 0.5}, {"spread": (1.2, 2.5), "hardening": (0.2, 1.0)}, onset=True,
    ),
    Kind(
        "mains_hum", "amplitude_n", 5e-3, 2e-2, ("chirp", "sphs", "step", "relaxation"), (),
        "mains whose frequency wanders by 0.02 Hz, a third of it at twice that, any phase",
        {"second": 0.35, "mains_hz": 50.0}, {"second": (0.1, 0.6)}, exact=True,
    ),
    Kind(
        "sensor_saturation", "overload", 0.25, 1.0, ("cyclic",), _ELECTRICAL,
        "soft clip: slope 1 up to the limit, then as x/(1 + x³)^(1/3) to a ceiling a few per cent above it",
        {"softness": 0.05}, {"softness": (0.01, 0.08)}, onset=True,
    ),
    Kind(
        "passive_strip", "compliance_share", 0.35, 0.6, ("chirp", "sphs", "step", "cyclic", "relaxation"), (),
        "film of other width and own relaxation (two arms) in series; share = 1 − ratio at low frequency",
        {"time_constant_s": 0.5, "relaxing": 1.5}, {"time_constant_s": (0.05, 3.0), "relaxing": (0.6, 3.0)},
    ),
    Kind(
        "edge_tear", "loss", 0.08, 0.25, (), _ELECTRICAL,
        "an edge tear grows by jumps at random points of the path: stiffness drops stepwise for good",
        {"jumps": 3.0}, {"jumps": (2.0, 5.0)}, listed=False,
    ),
    Kind(
        "clamp_misalignment", "share", 0.08, 0.3, ("chirp", "cyclic", "relaxation"), _ELECTRICAL,
        "displacement squared and its rate leak into the tension; share of k0 e at the largest strain",
        {"rate_s": 0.01}, {"rate_s": (0.003, 0.03)}, listed=False,
    ),
    Kind(
        "frame_attraction", "share", 0.15, 0.3, _ELECTRICAL, _MECHANICAL,
        "film drawn to the frame as V⁴ times a charge that builds up over seconds; share of F_A at the largest voltage",
        {"charge_s": 4.0}, {"charge_s": (1.5, 10.0)}, listed=False,
    ),
    Kind(
        "load_cell_hysteresis", "share", 0.02, 0.08, ("chirp", "cyclic", "relaxation"), (),
        "play operators and a creep that remembers the sign of the last large load; share of the largest force",
        {"creep_s": 5.0}, {"creep_s": (2.0, 15.0)}, listed=False,
    ),
    Kind(
        "humidity", "modulation", 0.04, 0.15, (), (),
        "the room's humidity control: stiffness swings with a period of 20 min",
        {"period_s": 1200.0, "phase": 0.6}, {"period_s": (900.0, 1500.0)}, listed=False,
    ),
    Kind(
        "acoustic_resonance", "stiffness_ratio", 0.15, 0.6, ("chirp",), (),
        "transverse mode of the film near 80 Hz with 1.5 % damping, stiffness share of k(80 Hz)",
        {"frequency_hz": 80.0, "damping": 0.015}, {"frequency_hz": (70.0, 90.0), "damping": (0.01, 0.03)}, listed=False,
    ),
    Kind(
        "voltage_crosstalk", "n_s_per_kv", 1e-4, 5e-4, _ELECTRICAL, _MECHANICAL,
        "the rate of the voltage leaks into the force channel through a 1 ms filter",
        {}, {}, listed=False, signed=True,
    ),
)  # fmt: skip
KINDS: Mapping[str, Kind] = MappingProxyType({kind.id: kind for kind in _ALL})
MECHANISMS: tuple[str, ...] = tuple(kind.id for kind in _ALL if kind.listed)
UNLISTED: tuple[str, ...] = tuple(kind.id for kind in _ALL if not kind.listed)


@dataclass(frozen=True)
class Effect:
    """One hidden effect. `shape` overrides defaults of its kind. `ValueError` for what the kind does not have."""

    id: str
    severity: float
    shape: Mapping[str, Shape] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.id not in KINDS:
            raise ValueError(f"no effect {self.id!r}; there are {', '.join(KINDS)}")
        if unknown := set(self.shape) - set(self.kind.shape):
            raise ValueError(f"{self.id} has no {sorted(unknown)}; it has {sorted(self.kind.shape)}")
        if not np.isfinite(self.severity) or (self.severity < 0 and not self.kind.signed):
            raise ValueError(f"severity {self.severity} of {self.id}")

    @property
    def kind(self) -> Kind:
        return KINDS[self.id]

    def number(self, name: str) -> float:
        """A shape parameter that is a number."""
        return float(self.shape.get(name, self.kind.shape[name]))

    def text(self, name: str) -> str:
        """A shape parameter that is a choice; `ValueError` where the choice does not exist."""
        chosen, known = str(self.shape.get(name, self.kind.shape[name])), self.kind.ranges.get(name, ())
        if chosen not in known:
            raise ValueError(f"{self.id}: {name} {chosen!r}; there are {known}")
        return chosen


def hide(id: str, severity: float | None = None, **shape: Shape) -> Effect:
    """An effect, at its typical severity if none is given."""
    if severity is None and id in KINDS:
        severity = KINDS[id].typical
    return Effect(id, 0.0 if severity is None else severity, shape)


def random_effect(id: str, severity: float, rng: np.random.Generator) -> Effect:
    """An effect of that severity with its shape drawn from the kind's ranges."""
    shape: dict[str, Shape] = {}
    for name, allowed in KINDS[id].ranges.items():
        low, high = allowed[0], allowed[-1]
        if isinstance(low, str):
            shape[name] = str(rng.choice(np.asarray(allowed)))
        else:
            shape[name] = float(np.exp(rng.uniform(np.log(low), np.log(high))))
    return Effect(id, severity, shape)


def as_effects(effects: Iterable[Effect | str | tuple[str, float]]) -> tuple[Effect, ...]:
    """Effects from ids, (id, severity) pairs or effects; none twice."""
    made = tuple(
        effect if isinstance(effect, Effect) else hide(effect) if isinstance(effect, str) else hide(*effect)
        for effect in effects
    )
    if len({effect.id for effect in made}) < len(made):
        raise ValueError("an effect twice")
    return made
