"""What the published models imply, recomputed from their printed parameters, and where that disagrees with what is printed.

Source as in `reports.pages.campaign.reference`. Every number here is computed from the printed tables; nothing of the measurements enters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from reports.figures.curves import stiffness
from reports.pages.campaign.reference import POLYACRYLATE, SILICONE, STACK, ReferenceFilm, ReferenceModel
from schemas.arrays import Complex, Float
from schemas.numbers import NBSP, percent, significant, span

LINEAR, LOGARITHMIC = "linear", "logarithmic"
EXAMPLE_FIRST = ReferenceModel(1, (0.5, 2.0), (0.6,), 0.0, 0.0)
"""The first-order example of figure 4-2."""
EXAMPLE_SECOND = ReferenceModel(2, (0.5, 1.0, 1.0), (1.0, 0.1), 0.0, 0.0)
"""The second-order example of figure 4-3."""
_STACK_AREA_MM2, _STACK_LENGTH_MM, _STACK_STRETCH = 100.0, 10.0, 2.0
_LAYER_AREA_MM2, _LAYER_LENGTH_MM, _LAYER_STRETCH = 50.0, 50.0, 1.4
"""Undeformed section and length of the two polyacrylate samples, the single layer with its 50 × 50 mm taken as exposed."""


@dataclass(frozen=True)
class Check:
    """One printed statement: where it stands, what it says, what the printed parameters give, and what follows."""

    where: str
    printed: str
    recomputed: str
    reading: str
    agrees: bool = False


def of(model: ReferenceModel, frequency_hz: Float) -> Complex:
    """k(jω) of printed parameters (n,) N/mm."""
    return stiffness(model.row(), frequency_hz)


def grid(low_hz: float, high_hz: float, spacing: str, count: int = 2000) -> Float:
    """Frequencies that an error is a mean over."""
    return np.geomspace(low_hz, high_hz, count) if spacing == LOGARITHMIC else np.linspace(low_hz, high_hz, count)


def difference(a: ReferenceModel, b: ReferenceModel, frequency_hz: Float) -> tuple[float, float]:
    """Mean | |a| − |b| | in N/mm and mean |arg(a/b)| in degrees (thesis, eq 4.14) between two printed models."""
    first, second = of(a, frequency_hz), of(b, frequency_hz)
    off = float(np.mean(np.abs(np.abs(first) - np.abs(second))))
    return off, float(np.mean(np.abs(np.degrees(np.angle(first / second)))))


def relaxation_times(model: ReferenceModel) -> tuple[float, ...]:
    """τ = c/k of the printed arms, s."""
    return tuple(c / k for k, c in zip(model.k[1:], model.c, strict=True))


def largest_phase_deg(model: ReferenceModel) -> float:
    """Of a first-order model: asin(k1/(2 k0 + k1))."""
    return float(np.degrees(np.arcsin(model.k[1] / (2 * model.k[0] + model.k[1]))))


def with_dashpot(model: ReferenceModel) -> ReferenceModel:
    """The same model with its last spring rigid, as far as numbers go."""
    return replace(model, k=(*model.k[:-1], 1e9))


def checks(clamp_hz: float | None = None) -> tuple[Check, ...]:
    """All of them; the one about the printed correction needs the frequency of a clamp alone on its load cell."""
    found = [*_stack(), *_layers(), *_silicone(), _same_material(), *_equations()]
    if clamp_hz is not None and np.isfinite(clamp_hz):
        found.append(_correction(clamp_hz))
    return tuple(found)


def _stack() -> list[Check]:
    first, second, third = STACK.models
    at5 = [of(m, np.array([5.0]))[0] for m in STACK.models]
    less = [
        f"order {m.order}: magnitude −{percent(1 - m.magnitude_error / first.magnitude_error)}, phase"
        f" −{percent(1 - m.phase_error / first.phase_error)}"
        for m in (second, third)
    ]
    band = grid(STACK.low_hz, STACK.high_hz, LOGARITHMIC)
    rigid = float(np.max(np.abs(of(with_dashpot(third), band) / of(third, band) - 1)))
    stretched = _STACK_LENGTH_MM * _STACK_STRETCH
    wrong = first.k[0] * stretched / _STACK_AREA_MM2
    right = wrong * _STACK_STRETCH
    return [
        Check(
            "section 4.4.1, table 4.2", f"second order lowers the errors by about 40{NBSP}%, third by about 80{NBSP}%",
            "; ".join(less), "The two figures mix the two errors.",
        ),
        Check(
            "section 4.4.1, figure 4-8", f"2.3 to 3{NBSP}N/mm at 5{NBSP}Hz",
            "; ".join(f"order {i}: {significant(abs(k))}{NBSP}N/mm, {np.degrees(np.angle(k)):.1f}°" for i, k in enumerate(at5, 1)),
            "Agrees. Only the third order is still rising there.", agrees=True,
        ),
        Check(
            "section 4.4.1", f"0.16{NBSP}MPa from an area of 100{NBSP}mm²",
            f"{significant(wrong, 2)}{NBSP}MPa with 100{NBSP}mm², {significant(right, 2)}{NBSP}MPa with the stretched 50{NBSP}mm²",
            "The number needs the stretched area, which is used here.",
        ),
        Check(
            "table 4.2, third order", f"k₃ = {significant(third.k[3], 2)}{NBSP}N/mm",
            f"a rigid k₃ changes k by at most {percent(rigid)} up to {STACK.high_hz:g}{NBSP}Hz",
            "The third arm is a dashpot in this band: its spring cannot be known from these data.",
        ),
    ]  # fmt: skip


def _layers() -> list[Check]:
    first, _, third = POLYACRYLATE.models
    most = first.magnitude_error + third.magnitude_error
    found = {
        "1 to 100 Hz, equal steps": difference(first, third, grid(1, 100, LINEAR))[0],
        "1 to 70 Hz, equal steps": difference(first, third, grid(1, 70, LINEAR))[0],
        "1 to 100 Hz, equal ratios": difference(first, third, grid(1, 100, LOGARITHMIC))[0],
    }
    band = grid(POLYACRYLATE.low_hz, POLYACRYLATE.high_hz, LOGARITHMIC)
    rigid = float(np.max(np.abs(of(with_dashpot(third), band) / of(third, band) - 1)))
    return [
        Check(
            "table 4.4 against 4.3",
            f"magnitude errors {first.magnitude_error:g} (first) and {third.magnitude_error:g}{NBSP}N/mm (third): the models are"
            f" at most {most:g}{NBSP}N/mm apart",
            "; ".join(f"{name}: {value:.2f}{NBSP}N/mm apart" for name, value in found.items()),
            "Possible only with frequencies in equal ratios or below about 70 Hz; the grid is not stated.",
        ),
        Check(
            "section 4.4.2, table 4.4", f"errors of the third order are 8{NBSP}% of those of the first",
            f"phase {percent(third.phase_error / first.phase_error)}, magnitude {percent(third.magnitude_error / first.magnitude_error)}",
            "True of the phase only.",
        ),
        Check(
            "table 4.3, third order", f"k₃ = {significant(third.k[3], 2)}{NBSP}N/mm",
            f"a rigid k₃ changes k by up to {percent(rigid)}", "Here the third arm is real.", agrees=True,
        ),
        Check(
            "tables 4.3 and 4.4, first order", f"{first.phase_error:g}° mean phase error",
            f"a first order cannot turn further than {largest_phase_deg(first):.1f}°; the third reaches"
            f" {np.degrees(np.angle(of(third, band))).max():.1f}°",
            "Agrees: no k₁ and c₁ follow the phase.", agrees=True,
        ),
    ]  # fmt: skip


def _silicone() -> list[Check]:
    (model,) = SILICONE.models
    k = of(model, grid(SILICONE.low_hz, SILICONE.high_hz, LINEAR))
    at = of(model, np.array([50.0, 100.0]))
    low, high = float(np.abs(k).min()), float(np.abs(k).max())
    return [
        Check(
            "table 4.4, silicone", f"magnitude error {model.magnitude_error:g}{NBSP}N/mm",
            f"the film has {span(low, high)}{NBSP}N/mm: the error is {model.magnitude_error / high:.1f} times the film",
            "The correction near the resonance dominates; this cannot show that the first order suffices.",
        ),
        Check(
            "section 4.4.2, silicone", "near constant stiffness and zero phase",
            f"{np.degrees(np.angle(at[0])):.1f}° at 50{NBSP}Hz, {np.degrees(np.angle(at[1])):.1f}° at 100{NBSP}Hz",
            "The fitted model has a phase.",
        ),
    ]  # fmt: skip


def _same_material() -> Check:
    """Neo-Hookean: dN/dλ = μ (1 + 2 λ⁻³), so that μ = k l₀/A₀/(1 + 2 λ⁻³)."""
    f = np.array([1.0, 5.0])
    stack = np.abs(of(STACK.models[-1], f)) * _STACK_LENGTH_MM / _STACK_AREA_MM2 / (1 + 2 * _STACK_STRETCH**-3)
    layer = np.abs(of(POLYACRYLATE.models[-1], f)) * _LAYER_LENGTH_MM / _LAYER_AREA_MM2 / (1 + 2 * _LAYER_STRETCH**-3)
    return Check(
        "table 4.2 against 4.3",
        "the same polyacrylate, as a stack and as a single layer",
        f"after geometry and stretch the single layer is {layer[0] / stack[0]:.1f} times stiffer at 1{NBSP}Hz,"
        f" {layer[1] / stack[1]:.1f} times at 5{NBSP}Hz",
        "Exposed length, load cell or calibration of one of the two is not as printed.",
    )


def _equations() -> list[Check]:
    k0, k1 = EXAMPLE_FIRST.k
    third = POLYACRYLATE.models[-1]
    return [
        Check(
            "eq 4.11 and 4.13", "k₁ − 1/(c₁s + k₁)",
            f"static stiffness of the example of figure 4-2: {k0 + k1 - 1 / k1:g}{NBSP}N/mm as printed, {k0:g}{NBSP}N/mm with k₁²",
            "k₁ − k₁²/(c₁s + k₁) is used here.",
        ),
        Check(
            "eq 4.3", "D without k₀",
            f"static stiffness of the third order of table 4.3: 0 as printed, {third.k[0]:g}{NBSP}N/mm with k₀",
            "D with k₀ is used here.",
        ),
        Check(
            "section 4.2.1", "n = 1 is a Kelvin–Voigt model", "a spring beside a spring and damper in series",
            "That is the standard linear solid (Zener); it becomes Kelvin–Voigt for a rigid k₁.",
        ),
    ]  # fmt: skip


def _correction(clamp_hz: float) -> Check:
    """Printed eq 4.21 returns k (kL + Mω²)/(kL − Mω²)."""
    f = np.array([0.2, 0.5, 0.77]) * clamp_hz
    ratio = (f / clamp_hz) ** 2
    factor = (1 + ratio) / (1 - ratio)
    return Check(
        "eq 4.18 to 4.22",
        "inertia of the clamp with the opposite sign",
        f"an elastic film of this rig (clamp alone at {significant(clamp_hz)}{NBSP}Hz) comes out "
        + ", ".join(f"{v:.2f} times too stiff at {significant(x, 2)}{NBSP}Hz" for x, v in zip(f, factor, strict=True)),
        "F + Mẍ′ + cẋ′ is used here; the blocked force is free of the resonance, eq 4.22 is not.",
    )


def bands() -> Sequence[tuple[ReferenceFilm, tuple[float, ...]]]:
    """The films with the four frequencies at which their printed models are evaluated."""
    return (
        (STACK, (0.01, 0.1, 1.0, 5.0)),
        (POLYACRYLATE, (1.0, 10.0, 50.0, 100.0)),
        (SILICONE, (1.0, 10.0, 50.0, 100.0)),
    )
