"""Mechanisms of the film that depend on its strain: softening with and without memory, stiffening, slack."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pipeline.diagnose.mechanisms.mechanism import (
    ELECTRICAL,
    FORCES,
    MECHANICAL,
    SHAPE,
    Context,
    Mechanism,
    Parameter,
    Values,
)
from pipeline.diagnose.simulation.effects import BySize, Course, Effect, Film, View
from schemas.arrays import Float


def _amplitude(course: Course) -> Float:
    """Strain amplitude: half the swing of a period, half the strain on the way along a course."""
    if course.periodic:
        return np.asarray((course.strain.max(axis=-1, keepdims=True) - course.strain.min(axis=-1, keepdims=True)) / 2)
    return np.maximum.accumulate(np.abs(course.strain), axis=-1) / 2


def _soft(values: Values, variant: str) -> Effect:
    drop, scale, exponent = values["drop"], values["strain_scale"], values["exponent"]
    at_once = 1.0 if variant == "instant" else values["at_once"]

    def loss(relative: Float) -> Float:
        power = np.maximum(relative, 0.0) ** exponent
        half = scale**exponent
        return np.asarray(drop * power * (1 + half) / (power + half))

    def softer(course: Course) -> Float:
        largest = course.scale.largest_strain
        amplitude = _amplitude(course) / largest
        if course.periodic and at_once > 0:
            strain = (course.strain - course.strain.mean(axis=-1, keepdims=True)) / largest
            # The mean square of a cosine is half that of its amplitude: on average nothing is gained.
            amplitude = np.sqrt((1 - at_once) * amplitude**2 + 2 * at_once * strain**2)
        return np.asarray(course.tension * (1 - loss(amplitude)))

    return Effect(tension=(softer,)) if drop else Effect()


def _soft_report(values: Values, variant: str, context: Context) -> Mapping[str, float | str]:
    return {
        "drop": values["drop"],
        "strain_scale": values["strain_scale"] * context.scale.strain,
        "exponent": values["exponent"],
        "at_once": 1.0 if variant == "instant" else values["at_once"],
    }


_LOGARITHMIC = "logarithmic"
_TESTS = ("sweep", "cyclic", "ramp")
"""Tests that move the film."""


def _wear(values: Values) -> Effect:
    """Loss with the logarithm of all cycles so far, each counted by its strain or not."""
    loss, first, by_strain = values["loss"], values["cycles"], values["strain_scale"] / (1 + values["strain_scale"])

    def worn(film: Film, view: View) -> Film:
        largest = view.scale.largest_strain
        own = view.elapsed if view.test in _TESTS else np.zeros((1, 1))
        path = view.path_before + own * view.strain
        done = (1 - by_strain) * (view.cycles_before + own) + by_strain * path / largest
        whole = (1 - by_strain) * view.scale.cycles + by_strain * view.scale.path / largest
        return Film(film.k * (1 - loss * np.log1p(done / first) / np.log1p(max(whole, 1e-9) / first)), film.share)

    return Effect(film=(worn,)) if loss else Effect()


def _damage(values: Values, variant: str) -> Effect:
    if variant == _LOGARITHMIC:
        return _wear(values)
    loss, cycles, scale, rejoined = values["loss"], values["cycles"], values["strain_scale"], values["rejoining"]

    def target(strain: Float, largest: float) -> Float:
        return np.asarray(loss * np.expm1(-strain / (scale * largest)) / np.expm1(-1 / scale))

    def damaged(film: Film, view: View) -> Film:
        largest = view.scale.largest_strain
        before, after = target(view.strain_before, largest), target(view.largest_strain, largest)
        return Film(film.k * (1 - after - (before - after) * np.exp(-view.elapsed / cycles)), film.share)

    def rejoins(course: Course) -> Float:
        # What a film has been through before is not known here: most of a session's tests come after its largest strain, and before
        # it there is little damage to come back from.
        largest, size = course.scale.largest_strain, np.abs(course.strain)
        so_far = size.max(axis=-1, keepdims=True) if course.periodic else np.maximum.accumulate(size, axis=-1)
        damage = target(so_far, largest) * -np.expm1(-_passed(course, so_far) / cycles)
        return np.asarray(course.tension * (1 + rejoined * damage * (size / largest) ** 2))

    if loss == 0:
        return Effect()
    return Effect(film=(damaged,), tension=(rejoins,) if rejoined else ())


def _passed(course: Course, largest: Float) -> Float:
    """Cycles (..., 1 or P) that a film has gone through at the largest strain so far."""
    if course.cycles is not None:
        first, last = course.cycles
        return np.asarray(((first + last) / 2 - 0.5)[..., None])
    if course.periodic:
        return np.full((1, 1), np.inf)
    path = np.cumsum(np.abs(np.diff(course.strain, axis=-1, prepend=course.strain[..., :1])), axis=-1)
    return np.asarray(path / np.maximum(2 * largest, 1e-30))


def _damage_report(values: Values, variant: str, context: Context) -> Mapping[str, float | str]:
    if variant == _LOGARITHMIC:
        return {"loss": values["loss"], "cycles": values["cycles"], "form": variant}
    return {
        "loss": values["loss"],
        "cycles": values["cycles"],
        "strain_scale": values["strain_scale"] * context.scale.strain,
        "rejoining": values["rejoining"],
    }


def _stiff(values: Values, variant: str) -> Effect:
    rise, uneven, power = values["stiffening"], values["asymmetry"], values["exponent"]

    def stiffer(course: Course) -> Float:
        relative = course.strain / course.scale.largest_strain
        # A strain measure under all springs (quasi-linear viscoelasticity): what it adds relaxes as strain does.
        tangent = rise * np.abs(relative) ** power * (1 - uneven + uneven * np.sign(relative))
        added = course.strain * tangent / (1 + power)
        return np.asarray(course.tension + course.carried(added))

    return Effect(tension=(stiffer,)) if rise else Effect()


def _slack(values: Values, variant: str) -> Effect:
    overload, residual, softness = values["overload"], values["residual"], values["softness"]
    if overload <= 0:
        return Effect()

    def buckles(course: Course) -> Float:
        floor = -course.largest_fall_n / (1 + overload)
        if floor >= 0 or course.tension.min() >= floor:  # where no tension falls, none reaches an onset
            return course.tension
        width = softness * course.largest_fall_n / (1 + overload)
        below = np.minimum((course.tension - floor) / width, 0.0)
        soft = residual * width * below + (1 - residual) * width * np.expm1(below)
        return np.asarray(np.where(course.tension < floor, floor + soft, course.tension))

    return Effect(tension=(BySize(buckles),))


def _slack_report(values: Values, variant: str, context: Context) -> Mapping[str, float | str]:
    onset = context.loads.fall_n / (1 + values["overload"])
    rest = context.rest_force_n
    return {
        "onset": onset / rest if rest > 0 else float("nan"),
        "onset_n": onset,
        "residual": values["residual"],
    }


AMPLITUDE_SOFTENING = Mechanism(
    id="amplitude_softening",
    stage="film",
    depends_on=("amplitude",),
    equation="k (1 − d h(A/A_max)), h(x) = x^p (1 + x_c^p)/(x^p + x_c^p); A the running strain amplitude, or the strain itself",
    source="Payne effect in the form of Kraus 1984",
    parameters=(
        Parameter("drop", "1", "loss at the session's largest amplitude", 0.005, 0.3, most=0.95),
        Parameter("strain_scale", "1", "amplitude of half the effect over the largest", 0.1, 3.0, SHAPE),
        Parameter("exponent", "1", "p", 0.6, 3.0, SHAPE, least=0.2, most=6.0),
        Parameter(
            "at_once",
            "1",
            "share of the squared amplitude that is the strain of the moment",
            0.0,
            0.2,
            SHAPE,
            log=False,
            most=1.0,
        ),
    ),
    shows=FORCES,
    faint=("sphs", "step"),
    confusable={
        "cyclic_softening": "it recovers: repeat the small strain after the large one",
        "slack": "slack is one-sided: even harmonics",
        "strain_stiffening": "the sign",
        "clamp_slip": "there the phase rises and a threshold shows",
    },
    effect=_soft,
    variants=("running", "instant"),
    report=_soft_report,
)

CYCLIC_SOFTENING = Mechanism(
    id="cyclic_softening",
    stage="film",
    depends_on=("largest_strain", "cycle"),
    equation="k (1 − D (1 − r (e/A)²)), D → d (1 − e^{−A_max/a}) as 1 − e^{−n/n0}, A_max the largest strain so far, A of all; "
    "or D = d ln(1 + n/n0)/ln(1 + N/n0), n all cycles so far, N of the session",
    source="Mullins effect with a damage variable that vanishes towards the largest strain, Ogden and Roxburgh 1999; "
    "softening with the logarithm of the number of cycles, Mars and Fatemi 2004",
    parameters=(
        Parameter("loss", "1", "loss after the session's largest strain", 0.005, 0.25, most=0.95),
        Parameter("cycles", "1", "n0", 0.5, 30.0, SHAPE),
        Parameter("strain_scale", "1", "a over the session's largest strain", 0.1, 3.0, SHAPE),
        Parameter(
            "rejoining",
            "1",
            "r, share of the loss that is not felt at the largest strain",
            0.0,
            0.6,
            SHAPE,
            log=False,
            most=1.0,
        ),
    ),
    shows=MECHANICAL | ELECTRICAL,
    faint=("sphs", "step"),
    confusable={
        "amplitude_softening": "that is reversible: the order of the strains",
        "baseline_drift": "that goes on at rest",
        "thermal_softening": "that follows time, not strain: repeat the first sweep in the end",
    },
    effect=_damage,
    variants=("", _LOGARITHMIC),
    report=_damage_report,
)

SLACK = Mechanism(
    id="slack",
    stage="film",
    depends_on=("amplitude",),
    equation="tension below a floor follows a soft branch: T → floor + residual k e",
    source="buckling of a film that loses its pre-stretch",
    parameters=(
        Parameter("overload", "1", "largest fall of the tension over the fall at which the film is slack, less 1", 0.02, 2.0),
        Parameter("residual", "1", "stiffness that is left", 0.0, 0.4, SHAPE, log=False, most=0.9),
        Parameter("softness", "1", "width of the bend over the floor", 0.01, 0.3, SHAPE),
    ),
    shows=FORCES,
    faint=("sphs", "step"),
    confusable={
        "strain_stiffening": "slack is one-sided: the sign of the even harmonic",
        "amplitude_softening": "even harmonics and an onset",
        "sensor_saturation": "the level against the range",
    },
    effect=_slack,
    onset=True,
    report=_slack_report,
)  # fmt: skip

STRAIN_STIFFENING = Mechanism(
    id="strain_stiffening",
    stage="film",
    depends_on=("amplitude",),
    equation="k acts on e (1 + S |x|^p (1 − q ± q)/(1 + p)), x strain e over the largest, + where it is positive: the tangent rises by S there",
    source="leading terms of Gent and Ogden laws about the pre-stretch, of higher power the nearer the film is to locking; "
    "quasi-linear viscoelasticity, Fung 1972",
    parameters=(
        Parameter("stiffening", "1", "rise of the tangent at the largest strain", 0.005, 0.6),
        Parameter("asymmetry", "1", "share q that changes with the sign of the strain", 0.0, 1.0, SHAPE, log=False, most=1.0),
        Parameter("exponent", "1", "p", 1.0, 4.0, SHAPE, least=0.5, most=8.0),
    ),
    shows=FORCES,
    faint=("sphs", "step"),
    confusable={
        "amplitude_softening": "the sign, and harmonics",
        "slack": "slack has an onset and one side only",
    },
    effect=_stiff,
)  # fmt: skip
MECHANISMS = (AMPLITUDE_SOFTENING, CYCLIC_SOFTENING, SLACK, STRAIN_STIFFENING)
