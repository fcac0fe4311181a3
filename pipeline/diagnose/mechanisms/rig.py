"""Mechanisms of the rig: constants of clamp and load cell, and damping beyond them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pipeline.diagnose.features import kinds
from pipeline.diagnose.mechanisms.mechanism import (
    ELECTRICAL,
    MECHANICAL,
    SHAPE,
    Mechanism,
    Parameter,
    Values,
)
from pipeline.diagnose.simulation.effects import Effect, View
from pipeline.diagnose.simulation.nodes import carried
from pipeline.physics.rig import Rig
from schemas.arrays import Complex

_ROUNDS, _FOUND, _NO_DRAG = 12, 1e-6, 1e-300
"""Steps of Newton's method for the drag at most, change of its logarithm that is none, and what is no drag."""


def _constants(values: Values, variant: str) -> Effect:
    def change(rig: Rig) -> Rig:
        return replace(
            rig,
            mass=rig.mass * (1 + values["mass_error"]),
            stiffness=rig.stiffness * (1 + values["stiffness_error"]),
        )

    return Effect(rig=(change,))


def _damping(values: Values, variant: str) -> Effect:
    ratio, yielding = values["damping_ratio"], values["yielding"]

    def more(rig: Rig) -> Rig:
        # As much as takes the same work from the clamp alone, which swings at its own frequency.
        return replace(rig, damping=rig.damping + ratio / (1 + yielding**2) * rig.critical_damping)

    def gives_way(own: Complex, rig: Rig, view: View, k: Complex) -> Complex:
        # The spring behind the damper takes up what moves faster (Zener's solid), beside what `more` has counted.
        turned = 2j * np.pi * view.frequency_hz / rig.clamp_omega
        return np.asarray(own + 2 * ratio * turned * (1 / (1 + yielding * turned) - 1 / (1 + yielding**2)))

    def dragged(own: Complex, rig: Rig, view: View, k: Complex) -> Complex:
        # Linear damping that takes as much work from a sinusoid; the motion that it brakes is found with it.
        omega = 2 * np.pi * view.frequency_hz
        critical = rig.critical_damping * rig.compliance
        fastest = view.scale.force_rate_n_per_s or np.inf
        # The film's strain moves the clamp by k/kL of the whole: x′ = x0 (k/kL)/(own + k/kL). The drag adds to its imaginary part.
        alone_with_film = rig.loaded(k, own)
        still, moving = alone_with_film.real**2, alone_with_film.imag
        speed = view.strain * view.scale.length_mm * omega * np.abs(k) / fastest
        growth = values["growth"]
        # log d + p/2 log |own + k/kL + jd|² = log of the drag at |…| = 1: nearly straight in log d, so that Newton's steps are few.
        level = np.log(np.maximum(omega * ratio * critical * speed**growth, _NO_DRAG))
        log_drag = level - growth / 2 * np.log(np.maximum(still + moving**2, _NO_DRAG))
        for _ in range(_ROUNDS):
            drag = np.exp(log_drag)
            whole = np.maximum(still + (moving + drag) ** 2, _NO_DRAG)
            slope = np.maximum(1 + growth * drag * (moving + drag) / whole, 0.5)
            step = (log_drag + growth / 2 * np.log(whole) - level) / slope
            log_drag = log_drag - step
            if np.abs(step).max(initial=0.0) < _FOUND:
                break
        return np.asarray(own + 1j * np.exp(log_drag))

    def third(rig: Rig, view: View, k: Complex, k_third: Complex) -> Complex:
        # A force that follows |v|^p v of a sinusoid v has a third harmonic of p/(p + 4) of its fundamental, in phase with v³, and brakes a
        # small faster motion beside it (p + 2)/2 times as strongly as the sinusoid itself.
        growth, omega = values["growth"], 2 * np.pi * view.frequency_hz
        own = rig.clamp(omega)
        drag = dragged(own, rig, view, k) - own
        share = 1j * k * rig.compliance / rig.loaded(k, own + drag)
        speed = share / np.maximum(np.abs(share), _NO_DRAG)
        size = np.abs(drag * share) * rig.stiffness * view.strain * view.scale.length_mm
        at_third = rig.clamp(3 * omega) + 3 * (growth + 2) / 2 * drag
        return np.asarray(-size * growth / (growth + 4) * speed**3 * rig.electrical(k_third, at_third))

    def second(own: Complex, rig: Rig, view: View, k: Complex) -> Complex:
        # A small mass on the clamp, as heavy as brings that damping when it is tuned to the clamp: μ/(4ζ₂).
        omega = 2 * np.pi * view.frequency_hz
        r = omega / (values["tuning"] * rig.clamp_omega)
        spring, share = 1 + 2j * values["width"] * r, 4 * values["width"] * ratio
        of_the_second: Complex = np.asarray(spring - r**2, dtype=complex)
        if view.few:
            carried(of_the_second)
        return np.asarray(own - rig.compliance * rig.mass * share * omega**2 * spring / of_the_second)

    if variant == "damper":
        return Effect(rig=(more,), clamp=(gives_way,) if yielding > 0 else ())
    if variant == "drag":
        return Effect(clamp=(dragged,), clamp_third=(third,))
    return Effect(clamp=(second,))


RIG_CONSTANTS = Mechanism(
    id="rig_constants",
    stage="rig",
    depends_on=("frequency",),
    equation="M (1 + δM), kL (1 + δL) in G and H",
    source="M ẍ′ = T − kL x′ − cL ẋ′, F = kL x′ (thesis, eq 4.16, sign of the inertia corrected)",
    parameters=(
        Parameter(
            "mass_error", "1", "true mass over that of the rig file, less 1", 0.01, 0.2, signed=True,
            factor=True, least=-0.8,
        ),
        Parameter(
            "stiffness_error", "1", "true load-cell stiffness over that of the file, less 1", 0.01, 0.2,
            signed=True, factor=True, least=-0.8,
        ),
    ),
    shows=MECHANICAL | ELECTRICAL | {kinds.TAP_RING},
    faint=("step", "cyclic", "relaxation", "cycle"),
    confusable={
        "missing_relaxation": "the error of the rig changes its sign at the clamp's frequency, an arm's does not",
        "load_cell_damping": "magnitude beside the resonance against phase within it",
    },
    effect=_constants,
    absorbed=True,
    as_filed=lambda mass_error, stiffness_error: {"mass_error": mass_error, "stiffness_error": stiffness_error},
)  # fmt: skip

LOAD_CELL_DAMPING = Mechanism(
    id="load_cell_damping",
    stage="rig",
    depends_on=("frequency", "rate"),
    equation="cL + 2ζ√(kL M) with a spring behind it, or 2ζ√(kL M) (v/v0)^p with the clamp's speed v, or a small damped mass on the clamp",
    source="the same equation of motion; Zener's solid; equivalent linear damping and second mass: Den Hartog, Mechanical Vibrations, "
    "sections 8.7 and 3.3",
    parameters=(
        Parameter("damping_ratio", "1", "damping ratio that is missing", 0.002, 0.03, most=0.5),
        Parameter("tuning", "1", "frequency of the second mass over that of the clamp", 0.85, 1.2, SHAPE, least=0.3),
        Parameter(
            "growth", "1", "exponent p of the damping over the speed; v0: the fastest that the clamp was seen to move", 0.1, 1.5, SHAPE, least=0.0, most=3.0,
        ),
        # A narrower one stores energy and takes none: a resonance of the frame is no damping.
        Parameter("width", "1", "damping ratio ζ₂ of the second mass", 0.02, 0.2, SHAPE, least=0.02, most=1.0),
        Parameter(
            "yielding", "1", "the clamp's own frequency over the one from which the spring behind the damper gives way", 0.0, 1.0, SHAPE,
            log=False, most=5.0,
        ),
    ),
    shows=MECHANICAL | ELECTRICAL | {kinds.TAP_RING},
    faint=("step", "cyclic", "relaxation", "cycle"),
    confusable={"rig_constants": "phase within the resonance against magnitude beside it"},
    effect=_damping,
    absorbed=True,
    variants=("drag", "second_mode", "damper"),
)  # fmt: skip
MECHANISMS = (RIG_CONSTANTS, LOAD_CELL_DAMPING)
