"""What of a recording the diagnosis keeps: linear functionals of its samples, with the noise measured within the record.

A block is a set of numbers of one kind (a sweep's response, a group of cycles, the windows after the edges of a step): their
values, their noise covariance, what they depend on, and the operator by which the same numbers follow from a frequency
response. No estimator stands between measurement and simulation: both go through the same functional. Belongs here: the
types and their meaning. How a protocol is reduced is in `features.<protocol>`, what a simulation predicts in `simulation`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime

from schemas.arrays import Float
from schemas.metadata import RigConstants

CLOCK = "clock"
"""Name in a block's support, where a clock was put right: true frequencies over those that were claimed."""
CHIRP_RESPONSE = "chirp.response"
"""F/x0 of one sweep in bands, N/mm, complex."""
CHIRP_HARMONIC = "chirp.harmonic"
"""Second or third harmonic of the force of a sweep, N, complex, phase relative to that multiple of the input's phase."""
CHIRP_LEVEL = "chirp.level"
"""Mean force of a sweep against the rest before it, N, and the rest levels after the first against the first."""
SPHS_RESPONSE = "sphs.response"
"""−F/V² at the excited lines of the early and of the late periods, N/kV², complex."""
SPHS_DETECTION = "sphs.detection"
"""−F at lines that were not excited, less the linear answer to what little the input has there, N, complex."""
SPHS_VOLTAGE = "sphs.voltage"
"""Voltage over command at the lines of the command, kV/V, complex."""
SPHS_CAPACITANCE = "sphs.capacitance"
"""C/V² at the excited lines, pF/kV², complex."""
VOLTAGE_CHIRP_RESPONSE = "electrical_chirp.response"
"""−F/V² of one sweep of the voltage in bands, N/kV², complex."""
VOLTAGE_CHIRP_HARMONIC = "electrical_chirp.harmonic"
"""Second or third harmonic of −F in such a sweep, N, complex, phase relative to that multiple of the phase of V²."""
VOLTAGE_CHIRP_CAPACITANCE = "electrical_chirp.capacitance"
"""C/V² of such a sweep in bands, pF/kV², complex."""
VOLTAGE_CHIRP_AMPLIFIER = "electrical_chirp.voltage"
"""Voltage over command of such a sweep in bands, kV/V, complex."""
CYCLIC_RESPONSE = "cyclic.response"
"""Fundamental of the force of a group of cycles over that of the displacement, N/mm, complex."""
CYCLIC_HARMONIC = "cyclic.harmonic"
"""Second and third harmonic of the force of a group of cycles, N, complex, phase as for chirps."""
CYCLIC_LEVEL = "cyclic.level"
"""Mean force of a group of cycles against the rest before them, N."""
CYCLIC_CAPACITANCE = "cyclic.capacitance"
"""First and second harmonic of the capacitance of a group of cycles over the fundamental of the displacement, pF/mm."""
STEP_FORCE = "step.force"
"""Drop of the force in windows after the edges of a group of cycles, against the rest before the first edge, N."""
STEP_CAPACITANCE = "step.capacitance"
"""Change of the capacitance in the same windows, pF."""
STEP_VOLTAGE = "step.voltage"
"""Voltage over the command's plateau in windows after the command's edges, kV/V."""
RELAXATION_FORCE = "relaxation.force"
"""Force in windows after a step of displacement, against the rest before it, N."""
CYCLE_FORCE = "cycle.force"
"""Force in windows of a large load-unload cycle, against the rest before it, N."""
EXTRA_MASS = "extra_clamp_mass_n_s2_per_mm"
REST_INPUT = "rest_displacement_mm"
"""Key of the displacement at rest, before a mechanical test moves."""
RING_HZ, FILED_RING_HZ = "ring_hz", "filed_ring_hz"
"""Values of a tap that contradicts its rig's file: where it rings, and where the clamp of the file would."""
"""Among the values of a recording: a known mass on the clamp beside its own."""
REST_HUM = "rest.hum"
"""Mains in the rest at 50 and 100 Hz (see `features.rest`), standard normal without mains."""
TAP_RING = "tap.ring"
"""Logarithm of the clamp-alone frequency in Hz, and its damping ratio."""
WEIGHT_GAIN = "weight.gain"
"""Recorded force over the weight that was hung."""
CALIBRATIONS = frozenset({TAP_RING, WEIGHT_GAIN})
"""Kinds in which there is no film: what contradicts the rig's file there is the rig or the sensor itself."""

DRIFTING = frozenset({CHIRP_LEVEL, CYCLIC_LEVEL, STEP_FORCE, RELAXATION_FORCE, CYCLE_FORCE})
"""Kinds that a slow drift of the force shows in, smoothly over the record."""

UNDER_VOLTAGE = frozenset({SPHS_RESPONSE, VOLTAGE_CHIRP_RESPONSE})
"""Kinds of responses −F/V²."""
SENSED = frozenset({SPHS_CAPACITANCE, VOLTAGE_CHIRP_CAPACITANCE, STEP_CAPACITANCE})
"""Kinds of capacitances under voltage."""
CAPACITANCE = SENSED | {CYCLIC_CAPACITANCE}
"""Kinds of the sensing region: they are proportional to what it makes of a tension or a displacement."""
AMPLIFIER = frozenset({SPHS_VOLTAGE, VOLTAGE_CHIRP_AMPLIFIER, STEP_VOLTAGE})
"""Kinds that show what the amplifier makes of the command: no film and no rig changes them."""

KINDS = (
    CHIRP_RESPONSE,
    CHIRP_HARMONIC,
    CHIRP_LEVEL,
    SPHS_RESPONSE,
    SPHS_DETECTION,
    SPHS_VOLTAGE,
    SPHS_CAPACITANCE,
    VOLTAGE_CHIRP_RESPONSE,
    VOLTAGE_CHIRP_HARMONIC,
    VOLTAGE_CHIRP_CAPACITANCE,
    VOLTAGE_CHIRP_AMPLIFIER,
    CYCLIC_RESPONSE,
    CYCLIC_HARMONIC,
    CYCLIC_LEVEL,
    CYCLIC_CAPACITANCE,
    STEP_FORCE,
    STEP_CAPACITANCE,
    STEP_VOLTAGE,
    RELAXATION_FORCE,
    CYCLE_FORCE,
    REST_HUM,
    TAP_RING,
    WEIGHT_GAIN,
)


@dataclass(frozen=True)
class FeatureBlock:
    """Numbers of one kind that belong together, real: of complex ones first all real, then all imaginary parts.

    Parameters
    ----------
    kind : one of the kinds above
    label : place within the recording, for people: "sweep 2", "cycles 4 to 6", "edges at 5.0 kV"
    value : (n,) in the unit of the kind
    components : parts of the noise, "<quantity>/<exponent of 1/f>"
    basis : (len(components), n, n) covariance of each part with coefficient 1: variance of a sample for exponent 0, density
        per Hz at 1 Hz for others. A session puts the coefficients in, which it reads off its stretches without signal
    is_complex : n is twice the number of complex values
    frequency_hz, amplitude, voltage_kv, cycle, time_s : (n,) what each number depends on, NaN where not defined: frequency;
        strain amplitude of the driven end at that frequency or time; voltage (largest, or of the plateau); cycle, sweep or
        period number (mean of the group, from 1); seconds since the start of the recording
    support : arrays by name that the prediction needs (operator, waveform, harmonic weights; see `predict`)
    """

    kind: str
    label: str
    value: Float
    components: tuple[str, ...]
    basis: Float
    is_complex: bool
    frequency_hz: Float
    amplitude: Float
    voltage_kv: Float
    cycle: Float
    time_s: Float
    support: Mapping[str, Float] = field(default_factory=dict)

    @property
    def size(self) -> int:
        return self.value.size

    @property
    def quantities(self) -> tuple[str, ...]:
        """Channels whose noise is in it, that of the output first."""
        return tuple(dict.fromkeys(name.split("/")[0] for name in self.components))


def read_clock(support: Mapping[str, Float]) -> float:
    """True frequencies of a block over those that were claimed, from its support."""
    return float(support[CLOCK][0]) if CLOCK in support else 1.0


@dataclass(frozen=True, eq=False)
class NoiseSample:
    """Periodogram of a channel where it holds no signal: rest, residuals between lines.

    `frequency_hz` (m,), `power` (m,) with the density per sample as expectation (σ² for white noise), `weight` (m,) number of
    independent ordinates. `interval_s` is that of the samples; `setting` is the interval in which the converter took them, in s,
    and its step: the white part is the same in recordings of one setting, unless they say otherwise. Two of them are equal if
    they are one, so that what is made of them can be remembered.
    """

    quantity: str
    interval_s: float
    frequency_hz: Float
    power: Float
    weight: Float
    setting: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class RecordingFeatures:
    """A recording reduced to features.

    Parameters
    ----------
    recording_id, specimen_id, protocol, loading, started_at, duration_s : of the recording
    rig : constants of the rig in force
    blocks : its features
    noise : where it shows nothing but noise
    nodes : (J,) Hz, frequencies of the response that the operators of the blocks take
    values : numbers by name that sessions and predictions need and that are no features: `strain_length_mm`, `rest_force_n`,
        `largest_strain`, `exposure_kv2_s`, `largest_voltage_kv`, `temperature_degc`, `rest_before_s`, `force_range_n`,
        `actuation_n_per_kv2` and `actuation_sd` (from geometry, relative), `layers`, ...; absent where not known
    settings : texts by name (`command` recorded or not, ...)
    warnings : what could not be reduced and why
    """

    recording_id: str
    specimen_id: str
    protocol: str
    loading: str
    started_at: datetime
    duration_s: float
    rig: RigConstants
    blocks: tuple[FeatureBlock, ...]
    noise: tuple[NoiseSample, ...]
    nodes: Float
    values: Mapping[str, float] = field(default_factory=dict)
    settings: Mapping[str, str] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()

    @property
    def size(self) -> int:
        return sum(b.size for b in self.blocks)
