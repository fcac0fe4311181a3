"""What a film can do as an actuator, held against what is asked for: of old that suppresses a tremor (thesis, section
1.3).

    blocked force F = a V²,   free stroke x(f) = F/|K(j2πf)|,   bandwidth: |K| = √2 |K(f₀)|,
    efficiency F x(f)/4 over ½ C V²
    force left at a stroke x: F − |K| x, where the load moves with the film's own phase

a = F_A/V² as the ends feel it, K(jω) the film's stiffness less the inertia of what it moves. A film gives its force and
its stroke at once only in part: on the line from F to x it gives most work at half of each. Layers side by side add
their forces, strips behind each other their strokes. Slow is what the lowest frequency f₀ recorded shows: slower still
a film relaxes on, by nobody knows how much. Limits are those of quantities whose logarithms are normal.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from pipeline.fit.actuator.known import Driven
from schemas.arrays import Float

FORCE_N, STROKE_MM, FREQUENCY_HZ = 0.4, 1.0, 10.0
"""What the tremor of a hand asks for: an amplitude up to 1 mm at up to 10 Hz, against a force up to 0.4 N."""
NORMAL_95, NORMAL_90 = 1.959964, 1.644854
_WIDEST_HZ = 1e4
"""Frequency up to which a bandwidth is looked for; the model says nothing beyond what was measured."""
_LARGE_STRAIN = 0.1
"""Strain from which on a note says that the model is one of small signals."""


@dataclass(frozen=True)
class Asked:
    """What an actuator is to give: force in N and stroke in mm, at once and up to a frequency in Hz."""

    force_n: float = FORCE_N
    stroke_mm: float = STROKE_MM
    frequency_hz: float = FREQUENCY_HZ


@dataclass(frozen=True)
class Requirement:
    """One quantity of an actuator with its 95 and 90 % limits, beside what is asked for.

    `meets`: the whole 95 % interval does. `multiple`: how many layers (force) or strips (stroke) would, each giving
    half of what it can so that both are there at once; counted from the unfavourable limit. None where nothing can be
    multiplied.
    """

    quantity: str
    value: float
    value_lower: float
    value_upper: float
    value_lower_90: float
    value_upper_90: float
    unit: str
    required: float | None
    meets: bool | None
    multiple: int | None
    multiplied: str | None
    note: str


@dataclass(frozen=True)
class ForceStroke:
    """A point of the line from blocked force to free stroke at one frequency, with 95 and 90 % limits of the force."""

    frequency_hz: float
    stroke_mm: float
    force_n: float
    force_n_lower: float
    force_n_upper: float
    force_n_lower_90: float
    force_n_upper_90: float


def specify(
    driven: Driven, highest_hz: float, length_mm: float | None = None, asked: Asked | None = None
) -> list[Requirement]:
    """The sheet of one actuator.

    Parameters
    ----------
    driven : the actuator under voltage
    highest_hz : highest frequency that the film's model rests on
    length_mm : stretched length of all strips, to say where a stroke is a large strain; None: not known
    asked : what it is held against; None: the tremor of a hand

    Returns
    -------
    Force, slow stroke, stroke at the frequency asked for, and, where they are known or exist, bandwidth, efficiency,
    capacitance, the current of a sinusoidal voltage, field, and how far the voltage is from pull-in and breakdown
    """
    asked = asked or Asked()
    hz = asked.frequency_hz
    force, by_force = driven.force_n, driven.force_slopes()
    at = np.array([driven.lowest_hz, hz])
    spring, by_spring = np.abs(driven.spring(at)), driven.spring_slopes(at).real
    strokes, soft = force / spring, driven.sd(by_force - by_spring)
    sheet = [_judge_force(driven, asked.force_n)]
    beyond = "" if highest_hz >= hz else f"; the model rests on frequencies up to {highest_hz:.3g} Hz"
    large = ["", ""]
    if length_mm is not None:
        large = [
            f"; {100 * x / length_mm:.2g} % of the length, no small strain" if x > _LARGE_STRAIN * length_mm else ""
            for x in strokes
        ]
    slow = f"free, at {driven.lowest_hz:.3g} Hz, the lowest recorded; slower it is larger{large[0]}"
    sheet.append(_judge("slow stroke", float(strokes[0]), float(soft[0]), "mm", None, None, slow))
    note = f"free, at {hz:g} Hz{beyond}{large[1]}"
    sheet.append(_judge("stroke", float(strokes[1]), float(soft[1]), "mm", asked.stroke_mm, "strips", note))
    width = bandwidth(driven)
    if width is not None:
        value, sd = width
        note = "the stroke falls to 71 % of the slow one" + ("; beyond what was measured" if value > highest_hz else "")
        sheet.append(_judge("bandwidth", value, sd, "Hz", hz, None, note))
    if driven.capacitance_nf is not None:
        sheet += _judge_supply(driven, float(strokes[1]), float(soft[1]), hz)
    return sheet + _judge_field(driven)


def specify_force(force_n: float, relative_sd: float, voltage_kv: float) -> list[Requirement]:
    """The sheet of a specimen of whose stiffness nothing is known: its blocked force against that of a tremor."""
    return [_judge("force", force_n, relative_sd, "N", FORCE_N, "layers", _blocked(voltage_kv))]


def draw_force_stroke(driven: Driven, frequency_hz: float, points: int = 21) -> list[ForceStroke]:
    """The line from blocked force to free stroke with its limits.

    Parameters
    ----------
    driven : the actuator
    frequency_hz : of the motion
    points : of the line

    Returns
    -------
    From stroke 0 to the free stroke. Limits are those of a normal force at that stroke, and may fall below 0 near its
    end
    """
    at = np.array([frequency_hz])
    spring, by_spring = float(np.abs(driven.spring(at))[0]), driven.spring_slopes(at).real[0]
    stroke = np.linspace(0.0, driven.force_n / spring, points)
    held = spring * stroke
    sd = driven.sd(driven.force_n * driven.force_slopes() - held[:, None] * by_spring)
    left = driven.force_n - held
    columns = (stroke, left, *(left + z * sd for z in (-NORMAL_95, NORMAL_95, -NORMAL_90, NORMAL_90)))
    return [ForceStroke(frequency_hz, *row) for row in np.stack(columns, axis=1).tolist()]


def bandwidth(driven: Driven) -> tuple[float, float] | None:
    """Frequency in Hz from which on |K| is above √2 |K(f₀)|, and the standard deviation of its logarithm; None where it
    never is."""
    slow = np.array([driven.lowest_hz])

    def rise(log_f: Float) -> Float:
        return np.asarray(
            np.log(np.abs(driven.spring(np.exp(log_f))) / np.abs(driven.spring(slow))) - 0.5 * math.log(2)
        )

    grid = np.linspace(math.log(driven.lowest_hz), math.log(_WIDEST_HZ), 400)
    above = rise(grid) > 0
    first = int(np.argmax(above))
    if not first:
        return None
    root = float(brentq(lambda x: float(rise(np.array([x]))[0]), grid[first - 1], grid[first]))
    by_spring = driven.spring_slopes(np.array([driven.lowest_hz, math.exp(root)])).real
    up, down = rise(np.array([root + 1e-4, root - 1e-4]))
    steepness = float(up - down) / 2e-4
    return math.exp(root), float(driven.sd(by_spring[1] - by_spring[0])) / abs(steepness)


def pull_in_margin(driven: Driven) -> tuple[float, float] | None:
    """Pull-in voltage over the voltage, and the standard deviation of its logarithm; None where it is not known."""
    if driven.pull_in is None or driven.field_mv_per_m is None:
        return None
    slow = np.array([driven.lowest_hz])
    own = (driven.fit.slopes(slow)[0] / driven.fit.model.stiffness(slow)[0]).real
    sd = float(driven.sd(np.concatenate([0.5 * own, [-0.5, 0.5, 1.0]])))
    return driven.pull_in.field_mv_per_m / driven.field_mv_per_m, math.hypot(sd, driven.pull_in.sd)


def breakdown_margin(driven: Driven) -> tuple[float, float] | None:
    """Breakdown voltage over the voltage, and the standard deviation of its logarithm; None where it is not known."""
    if driven.breakdown is None or driven.field_mv_per_m is None:
        return None
    sd = math.hypot(driven.breakdown.sd, driven.thickness_sd)
    return driven.breakdown.field_mv_per_m / driven.field_mv_per_m, sd


def _judge_force(driven: Driven, required: float) -> Requirement:
    sd = float(driven.sd(driven.force_slopes()))
    return _judge("force", driven.force_n, sd, "N", required, "layers", _blocked(driven.voltage_kv))


def _blocked(voltage_kv: float) -> str:
    return f"blocked, at {voltage_kv:.3g} kV"


def _judge_supply(driven: Driven, stroke_mm: float, stroke_sd: float, hz: float) -> list[Requirement]:
    """Efficiency, capacitance and current."""
    capacitance = driven.capacitance_nf or 0.0
    energy = 0.5 * capacitance * driven.voltage_kv**2  # N mm, which is mJ, of nF and kV
    efficiency = driven.force_n * stroke_mm / 4 / energy
    note = f"work into a matched load at {hz:g} Hz over the electrical energy of a charge, losses of the film in it"
    # Force and energy rise with the permittivity and fall with the thickness alike: what the stroke leaves open is all.
    sheet = [_judge("efficiency", efficiency, stroke_sd, "", None, None, note)]
    sd = math.hypot(driven.permittivity_sd, driven.thickness_sd)
    sheet.append(_judge("capacitance", capacitance, sd, "nF", None, None, "of all films, at rest"))
    current = 2 * math.pi * hz * capacitance * driven.voltage_kv / 2
    note = f"peak, for a voltage from 0 to {driven.voltage_kv:.3g} kV as a sinusoid of {hz:g} Hz"
    return [*sheet, _judge("current", current, sd, "µA", None, None, note)]


def _judge_field(driven: Driven) -> list[Requirement]:
    """Field, and the distance to its limits."""
    sheet = []
    if driven.field_mv_per_m is not None:
        note = "voltage over stretched thickness"
        sheet.append(_judge("field", driven.field_mv_per_m, driven.thickness_sd, "MV/m", None, None, note))
    pull_in = pull_in_margin(driven)
    if pull_in is not None:
        note = (
            f"pull-in voltage over this one, under a constant pull, two laws of large strain, stiffness at {driven.lowest_hz:.3g}"
            " Hz; a voltage that stays on pulls in earlier"
        )
        sheet.append(_judge("pull-in margin", *pull_in, "×", 1.0, None, note))
    breakdown = breakdown_margin(driven)
    if breakdown is not None:
        note = "field at which films of this kind failed over this one; limits are of the next film, not of their mean"
        sheet.append(_judge("breakdown margin", *breakdown, "×", 1.0, None, note))
    return sheet


def _judge(
    quantity: str,
    value: float,
    relative_sd: float,
    unit: str,
    required: float | None,
    multiplied: str | None,
    note: str,
) -> Requirement:
    """Limits as of a quantity whose logarithm is normal."""
    lower, upper, lower_90, upper_90 = (
        value * math.exp(z * relative_sd) for z in (-NORMAL_95, NORMAL_95, -NORMAL_90, NORMAL_90)
    )
    multiple = math.ceil(2 * required / lower - 1e-9) if multiplied and required and lower > 0 else None
    return Requirement(
        quantity=quantity,
        value=value,
        value_lower=lower,
        value_upper=upper,
        value_lower_90=lower_90,
        value_upper_90=upper_90,
        unit=unit,
        required=required,
        meets=None if required is None else lower >= required,
        multiple=multiple,
        multiplied=multiplied if multiple else None,
        note=note,
    )
