"""Mechanisms of the film that depend on frequency or time, not on amplitude: arms, power law, warming, a strip in series."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pipeline.diagnose.mechanisms.mechanism import (
    ELECTRICAL,
    MECHANICAL,
    SHAPE,
    Context,
    Mechanism,
    Parameter,
    Values,
)
from pipeline.diagnose.simulation.effects import Effect, Film, View
from pipeline.physics.film import arm_response, series_share
from schemas.arrays import Complex, Float

_LOWEST_HZ = 1e-6
"""Frequency below which a power law is constant, Hz."""
_APART = "apart"
"""Variant of a film whose temperature is not the one that is recorded beside it: a sensor in the air shows the room."""
_MOST_SHIFT = 12.0
"""Logarithm by which warming changes the relaxation times at most: beyond five decades a film rests or is rigid throughout."""
_MOST_SOFTENING = 50.0
"""Logarithm by which warming changes the stiffness at most: a film whose main spring has vanished turns any amount into heat over that."""


def _arm(values: Values, variant: str) -> Effect:
    ratio, tau, spread = values["stiffness_ratio"], values["time_constant_s"], values["spread"]

    def more(film: Film, view: View) -> Film:
        z = view.power_of_jw(spread, tau=tau, lowest_hz=_LOWEST_HZ)
        return Film(film.k + ratio * view.k0 * arm_response(z), film.share)

    return Effect(film=(more,)) if ratio else Effect()


def _power(values: Values, variant: str) -> Effect:
    ratio, exponent, shortest = values["stiffness_ratio"], values["exponent"], values["shortest_s"]

    def more(film: Film, view: View) -> Film:
        z = view.power_of_jw(exponent, lowest_hz=_LOWEST_HZ)
        return Film(film.k + ratio * view.k0 * z / (1 + shortest**exponent * z), film.share)

    return Effect(film=(more,)) if ratio else Effect()


def _warm(values: Values, variant: str) -> Effect:
    per_kelvin, rise, tau, heating, shift = (
        values[n] for n in ("per_kelvin", "rise_k", "time_constant_s", "self_heating_k", "shift")
    )

    def softer(film: Film, view: View) -> Film:
        supposed, until = (rise * -np.expm1(-t / tau) for t in (view.session_s, view.first_temperature_s))
        # A temperature that is recorded from the middle on counts from what was supposed until then.
        is_known = np.isfinite(view.temperature_k) & (variant != _APART)
        warming = np.where(is_known, view.temperature_k + until, supposed)
        softening = per_kelvin * (warming + heating * _dissipated(film, view))
        softened = np.exp(np.clip(-softening, -_MOST_SOFTENING, _MOST_SOFTENING))
        if view.shifted is not None:
            faster = np.clip(-shift * softening, -_MOST_SHIFT, _MOST_SHIFT)
            softened = softened * view.shifted(faster)
        return Film(film.k * softened, film.share)

    return Effect(film=(softer,)) if per_kelvin else Effect()


def _dissipated(film: Film, view: View) -> Float:
    """(1 or S, 1 or J) energy that the film has turned into heat since the recording began: over that of a cycle of the session's
    largest strain in which the loss is as large as k0.

    Nothing flows away meanwhile: films cool in minutes. Sinusoids count, of which each cycle of amplitude e leaves π e² Im k.
    """
    own = np.maximum(film.k.imag, 0.0) / view.k0 * (view.strain / view.scale.largest_strain) ** 2
    if view.test == "cyclic":
        return np.asarray(own * view.elapsed)
    if view.test != "sweep":
        return np.zeros((1, 1))
    passed = np.abs(np.diff(view.elapsed, axis=-1))
    each = (own[..., 1:] + own[..., :-1]) / 2 * passed
    upwards = view.elapsed[:, -1:] >= view.elapsed[:, :1]
    total = each.sum(axis=-1, keepdims=True)
    so_far = np.concatenate([np.zeros_like(total), np.cumsum(each, axis=-1)], axis=-1)
    # Sweeps before this one in the recording were like it.
    before = view.elapsed.min(axis=-1, keepdims=True) / np.maximum(passed.sum(axis=-1, keepdims=True), 1e-12)
    return np.asarray(np.where(upwards, so_far, total - so_far) + before * total)


def _strip(values: Values, variant: str) -> Effect:
    compliant, tau, relaxing = values["compliance_share"], values["time_constant_s"], values["relaxing"]
    if compliant == 0:
        return Effect()

    def in_series(film: Film, view: View) -> Film:
        s: Complex = np.asarray(2j * np.pi * view.frequency_hz * tau, dtype=complex)
        passive = view.k0 * (1 - compliant) / compliant * (1 + relaxing * arm_response(s))
        share = series_share(film.k, passive)
        return Film(film.k * share, film.share * share)

    return Effect(film=(in_series,))


def _ratio(values: Values, variant: str, context: Context) -> Mapping[str, float | str]:
    return {
        "ratio": 1 - values["compliance_share"],
        "time_constant_s": values["time_constant_s"],
        "relaxing": values["relaxing"],
    }


MISSING_RELAXATION = Mechanism(
    id="missing_relaxation",
    stage="film",
    depends_on=("frequency",),
    equation="k + k_x (jωτ)^β/(1 + (jωτ)^β): an arm that the model lacks, stretched where β < 1",
    source="generalised Maxwell model (thesis, eq 4.1); Cole and Cole 1941 for β < 1",
    parameters=(
        Parameter("stiffness_ratio", "1", "k_x over k0", 0.01, 0.6),
        Parameter("time_constant_s", "s", "τ", 1e-3, 30.0, SHAPE),
        Parameter("spread", "1", "β", 0.5, 1.0, SHAPE, log=False, least=0.45, most=1.0),
    ),
    shows=MECHANICAL | ELECTRICAL,
    faint=("sphs",),
    absorbed=True,
    relaxes=True,
    as_arm=lambda ratio, time_s: {"stiffness_ratio": ratio, "time_constant_s": time_s, "spread": 1.0},
    confusable={
        "power_law_relaxation": "its slope goes on over more than two decades: a decade below 0.1 Hz",
        "passive_strip": "only a strip changes H against its prediction from k",
        "sensor_delay": "a delay is no relaxation: test of positivity, electrical tests",
    },
    effect=_arm,
)

POWER_LAW_RELAXATION = Mechanism(
    id="power_law_relaxation",
    stage="film",
    depends_on=("frequency",),
    equation="k + K (jω · 1 s)^α/(1 + (jωτ)^α), τ beyond the fastest test or near it: where the film turns to glass the slope ends",
    source="fractional (spring-pot) element, Nutting 1921, in series with a spring: fractional Maxwell model, Schiessel et al. 1995",
    parameters=(
        Parameter("stiffness_ratio", "1", "K over k0", 0.02, 0.6),
        Parameter("exponent", "1", "α", 0.1, 0.5, SHAPE, log=False, least=0.02, most=0.95),
        Parameter("shortest_s", "s", "τ", 1e-7, 3e-3, SHAPE, most=0.1),
    ),
    shows=MECHANICAL | ELECTRICAL,
    faint=("sphs",),
    absorbed=True,
    relaxes=True,
    confusable={"missing_relaxation": "one slow arm bends within two decades: a decade below 0.1 Hz"},
    effect=_power,
)

THERMAL_SOFTENING = Mechanism(
    id="thermal_softening",
    stage="film",
    depends_on=("temperature", "session_time"),
    varies_with=("cycle",),
    equation="k(jω a) e^{−β ΔT}, ln a = −s β ΔT: time–temperature shift with softening; ΔT measured, or first order in the session's time, "
    "and what the film dissipates in a recording",
    source="time–temperature superposition, first order in the temperature (Williams, Landel and Ferry 1955)",
    parameters=(
        Parameter("per_kelvin", "1/K", "β", 0.001, 0.03, signed=True, least=-0.2, most=0.2),
        Parameter("self_heating_k", "K", "warming by a cycle of the largest strain whose loss is as large as k0", 1e-3, 0.1, SHAPE),
        Parameter("time_constant_s", "s", "time constant of the warming", 100.0, 3000.0, SHAPE),
        Parameter("shift", "1", "s, logarithm by which relaxation times shorten over that by which the film softens", 0.1, 30.0, SHAPE),
        Parameter("rise_k", "K", "warming in the end where no temperature was recorded; only β × rise is known then", 5.0, 5.0, SHAPE, least=5.0, most=5.0),
    ),
    shows=MECHANICAL | ELECTRICAL,
    faint=("sphs", "step"),
    variants=("recorded", _APART),
    confusable={
        "cyclic_softening": "rest recovers it, strain does not matter: repeat the first sweep in the end, or record temperature",
        "gain_error": "a gain that drifts is in the reading of weights as well",
        "baseline_drift": "a drift shifts the level and leaves the response",
    },
    effect=_warm,
)  # fmt: skip

PASSIVE_STRIP = Mechanism(
    id="passive_strip",
    stage="film",
    depends_on=(),
    equation="k k_P/(k + k_P), F_A k_P/(k + k_P), k_P = k_P0 (1 + r jωτ/(1 + jωτ))",
    source="two films in series (thesis, section 5.2)",
    parameters=(
        Parameter("compliance_share", "1", "1 − k_P/(k0 + k_P): share of the compliance that is the strip's", 0.1, 0.8, most=0.98),
        Parameter("time_constant_s", "s", "relaxation time of the strip", 0.01, 10.0, SHAPE),
        Parameter("relaxing", "1", "spring of its arm over its k_P0", 0.3, 4.0, SHAPE),
    ),
    shows=MECHANICAL | ELECTRICAL,
    confusable={"missing_relaxation": "only a strip changes H against its prediction from k"},
    effect=_strip,
    absorbed=True,
    softening=lambda values: 1 - values["compliance_share"],
    report=_ratio,
)  # fmt: skip
MECHANISMS = (MISSING_RELAXATION, POWER_LAW_RELAXATION, THERMAL_SOFTENING, PASSIVE_STRIP)
