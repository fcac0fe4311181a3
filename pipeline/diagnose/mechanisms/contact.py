"""Mechanism of the contact: the film slips in its clamp."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pipeline.diagnose.mechanisms.mechanism import FORCES, SHAPE, Context, Mechanism, Parameter, Values
from pipeline.diagnose.simulation.effects import BySize, Course, Effect
from pipeline.physics.film import arm_step
from schemas.arrays import Complex, Float

_TURNS, _MOST_TURNS = 2, 10
"""Periods of a sweep that are followed, and most of a sinusoid: the slider finds its mean place within them."""
_FEW_PATHS = 40
"""Paths that are followed one by one rather than together: as many as take the same time."""
_LOSS = 1e-3
"""Least loss factor at which the film is taken to relax within a period."""


def _slip(values: Values, variant: str) -> Effect:
    overload, hardening, creep = values["overload"], values["hardening"], values["creep_s"]
    if overload <= 0:
        return Effect()

    def slides(course: Course) -> Float:
        held = course.largest_tension_n / (1 + overload)
        wave = course.tension
        if np.abs(wave).max() <= held:
            return wave
        shape = wave.shape
        # What never comes near the holding force needs no path.
        near = np.flatnonzero(np.abs(wave).reshape(-1, shape[-1]).max(axis=1) > held)
        path = np.ascontiguousarray(wave.reshape(-1, shape[-1])[near].T)
        k = np.broadcast_to(course.stiffness, shape).reshape(-1, shape[-1])[near, 0]
        interval = np.broadcast_to(course.interval_s, shape).reshape(-1, shape[-1])[near].T
        static, arm, decay = _film(k, course.static, interval)
        held_by = static + hardening * course.static
        stiff = held_by + arm
        # Slip flows with the excess over the holding force, until the springs about it have taken that up.
        flow = -np.expm1(-interval * stiff / course.static / creep) / stiff
        first, last = np.full((2, near.size), float(_TURNS if course.periodic else 1))
        if course.periodic and course.cycles is not None:
            first, last = (np.minimum(np.broadcast_to(c, shape[:-1]).ravel()[near], _MOST_TURNS) for c in course.cycles)
        slipped, relaxed = _follow(path, decay, held_by * flow, arm * flow, held, (first, last))
        out = path - static / held_by * slipped - relaxed
        result = wave.reshape(-1, shape[-1]).copy()
        result[near] = out.T
        return np.asarray(result.reshape(shape))

    return Effect(tension=(BySize(slides),))


def _follow(
    path: Float, decay: Float, to_slip: Float, to_arm: Float, held: float, turns: tuple[Float, Float]
) -> tuple[Float, Float]:
    """Forces that slip has taken along paths: of the springs that hold, and of the arm, which relaxes.

    Parameters
    ----------
    path : (P, S) tension N, of S paths at P times, which begin without slip and are followed again and again
    decay : (P, S) share of the arm's force that an interval leaves
    to_slip, to_arm : (P, S) what the excess over `held` N adds to either
    turns : (S,) each, the first and last of the times that a path is followed whose mean is asked for

    Returns
    -------
    (P, S) each, means of these turns
    """
    first, last = turns
    if path.shape[1] <= _FEW_PATHS:
        columns = [x.T.tolist() for x in (path, decay, to_slip, to_arm)]
        means: list[Float] = []
        for begin, end, *own in zip(first, last, *columns, strict=True):
            forces = np.array(_follow_one(held, int(end), *own)).reshape(2, int(end), path.shape[0])
            means.append(forces[:, int(begin) - 1 :].mean(axis=1))
        both = np.array(means)
        return both[:, 0].T, both[:, 1].T
    slipped, relaxed = np.zeros((2, *path.shape))
    state = np.zeros((2, path.shape[1]))
    for turn in range(1, int(last.max()) + 1):
        slip, relaxing, state = _follow_together(path, decay, to_slip, to_arm, held, state)
        counts = ((turn >= first) & (turn <= last)) / (last - first + 1)
        slipped += counts * slip
        relaxed += counts * relaxing
    return slipped, relaxed


def _follow_together(
    path: Float, decay: Float, to_slip: Float, to_arm: Float, held: float, state: Float
) -> tuple[Float, Float, Float]:
    """Both forces (P, S) along one turn of many paths, and at its end (2, S), from those before it: `state` (2, S)."""
    # In place, for these steps are many and short.
    slipped, relaxed = np.empty_like(path), np.empty_like(path)
    slip, relaxing = state
    pull, more = np.empty((2, path.shape[1]))
    least, most = np.full(path.shape[1], -held), np.full(path.shape[1], held)
    for i, (tension, left, slips, loads) in enumerate(zip(path, decay, to_slip, to_arm, strict=True)):
        relaxing = np.multiply(relaxing, left, out=relaxed[i])
        np.subtract(tension, slip, out=pull)
        pull -= relaxing
        np.maximum(pull, least, out=more)
        np.minimum(more, most, out=more)
        pull -= more
        slip = np.add(slip, np.multiply(pull, slips, out=more), out=slipped[i])
        relaxing += np.multiply(pull, loads, out=more)
    return slipped, relaxed, np.stack([slip, relaxing])


def _follow_one(
    held: float,
    turns: int,
    path: list[float],
    decay: list[float],
    to_slip: list[float],
    to_arm: list[float],
) -> tuple[list[float], list[float]]:
    """The same along all turns of one path, in plain numbers: arrays of few are many times slower."""
    slip = relaxing = 0.0
    slipped, relaxed = [], []
    for tension, left, slips, loads in [*zip(path, decay, to_slip, to_arm, strict=True)] * turns:
        relaxing *= left
        pull = tension - slip - relaxing
        if pull > held or pull < -held:
            pull -= held if pull > 0 else -held
            slip += pull * slips
            relaxing += pull * loads
        slipped.append(slip)
        relaxed.append(relaxing)
    return slipped, relaxed


def _film(k: Complex, static: float, interval_s: Float) -> tuple[Float, Float, Float]:
    """Main spring, what one arm adds to it within an interval, and the share of its force that an interval leaves: the film near one
    frequency.

    They follow from k (S,) at that frequency; a k without loss is one spring. interval_s : (P, S); the decay has that shape.
    """
    rise, loss = k.real - static, k.imag
    relaxes = (rise > 0) & (loss > _LOSS * np.abs(k))
    turn = np.where(relaxes, rise / np.where(relaxes, loss, 1.0), 1.0)
    arm = np.where(relaxes, rise * (1 + 1 / turn**2), 0.0)
    # τ = turn/ω; a period has as many intervals as points. Slip flows evenly over an interval, and what it strains relaxes in it.
    passed = 2 * np.pi / interval_s.shape[0] / turn
    decay, gain = arm_step(passed)
    return np.where(relaxes, static, np.abs(k)), arm * gain, decay * np.ones_like(interval_s)


def _force(values: Values, variant: str, context: Context) -> Mapping[str, float | str]:
    return {
        "slip_force": 1 / (1 + values["overload"]),
        "slip_force_n": context.loads.tension_n / (1 + values["overload"]),
        "hardening": values["hardening"],
    }


CLAMP_SLIP = Mechanism(
    id="clamp_slip",
    stage="contact",
    depends_on=("amplitude",),
    equation="slider of holding force F_s with a holding spring in series with the film; "
    "beyond F_s it slips, dx/dt = (|F| - F_s) sgn F/(k0 creep_s)",
    source="Iwan (Jenkins) element, Iwan 1966",
    parameters=(
        Parameter("overload", "1", "largest tension over the slip force, less 1", 0.05, 10.0),
        Parameter("hardening", "1", "holding spring over the film's k0", 0.03, 3.0, SHAPE),
        Parameter("creep_s", "s", "time in which an excess would slip against k0 alone", 1e-3, 0.3, SHAPE, least=1e-6),
    ),
    shows=FORCES,
    faint=("sphs", "step"),
    confusable={
        "amplitude_softening": "that is smooth and leaves the phase; slip raises it beyond a threshold",
        "cyclic_softening": "slip comes back with every cycle",
    },
    effect=_slip,
    onset=True,
    report=_force,
)  # fmt: skip
MECHANISMS = (CLAMP_SLIP,)
