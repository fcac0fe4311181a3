"""Sizes for a requirement: every number of layers and strips at every voltage and thickness, and which of them nothing
betters.

A design counts as meeting the requirement where it gives the force at the stroke and at the frequency asked for, all at
once, and stays away from pull-in and breakdown, each with 95 % probability. Of those the front is kept: the designs
beside which no other is at least as good in all of

    force left at the stroke ↑   stroke left at the force ↑   distance to the limiting field ↑   voltage ↓   films ↓

Force and stroke are compared in steps (`_STEP`), for a design that is 1 % stronger is no other design. Forces and
springs of several films follow from those of one; their limits are linearised as in `specification`, without sampling.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.fit.actuator.known import Driven
from pipeline.fit.actuator.specification import NORMAL_90, Asked, breakdown_margin, pull_in_margin
from schemas.arrays import Bool, Float, Int

_STEP = 1.25
"""Factor of force or stroke within which two designs give the same."""
_MOST_SPARE = 3.0
"""Force and stroke beyond this many times what is asked for are worth nothing more."""
_VOLTAGES = 25
_LEAST_VOLTAGE = 0.1
"""Of the highest voltage: where the search begins."""


@dataclass(frozen=True)
class Space:
    """What is searched.

    Parameters
    ----------
    thicknesses_mm : undeformed thicknesses of a layer
    highest_kv : highest voltage
    most_layers, most_strips : of films side by side and behind each other
    """

    thicknesses_mm: tuple[float, ...]
    highest_kv: float
    most_layers: int = 400
    most_strips: int = 400


@dataclass(frozen=True)
class Design:
    """One way to meet a requirement.

    Parameters
    ----------
    voltage_kv, thickness_mm : across a layer, and that layer undeformed
    layers, strips, films : side by side in a strip, strips behind each other, their product
    force_n, force_n_lower : force left at the stroke asked for, and its lower limit (95 % on one side)
    stroke_mm, stroke_mm_lower : stroke left at the force asked for, and its lower limit
    margin, margin_lower : limiting field over the field, pull-in or breakdown, whichever is nearer; None: neither is
        known
    limited_by : `pull-in` or `breakdown`
    field_mv_per_m : voltage over stretched thickness
    """

    voltage_kv: float
    thickness_mm: float
    layers: int
    strips: int
    films: int
    force_n: float
    force_n_lower: float
    stroke_mm: float
    stroke_mm_lower: float
    margin: float | None
    margin_lower: float | None
    limited_by: str | None
    field_mv_per_m: float


@dataclass(frozen=True)
class Found:
    """What a search found: the front by voltage, then films, how many designs were tried, and how many met the
    requirement.

    `unsafe`: of those tried, that many were closer to a limiting field than allowed.
    """

    front: tuple[Design, ...]
    tried: int
    met: int
    unsafe: int


@dataclass(frozen=True)
class _Reach:
    """Force (n,) at the stroke and stroke (n,) at the force, with lower limits."""

    force: Float
    force_lower: Float
    stroke: Float
    stroke_lower: Float


def search_designs(one: Callable[[float, float], Driven], space: Space, asked: Asked) -> Found:
    """All designs that meet a requirement and that no other betters.

    Parameters
    ----------
    one : a single film of an undeformed thickness in mm at a voltage in kV, with the mass that it moves
    space : what is searched
    asked : force and stroke at once, up to a frequency

    Returns
    -------
    An empty front where no design of the space meets it
    """
    layers, strips = (m.ravel() for m in np.meshgrid(_counts(space.most_layers), _counts(space.most_strips)))
    kept: list[Design] = []
    met = unsafe = tried = 0
    for thickness in space.thicknesses_mm:
        for voltage in space.highest_kv * np.geomspace(_LEAST_VOLTAGE, 1.0, _VOLTAGES):
            driven = one(thickness, float(voltage))
            tried += layers.size
            margin, margin_lower, limited_by = nearest_limit(driven)
            if margin_lower is not None and margin_lower < 1:
                unsafe += layers.size
                continue
            reach = _reach(driven, layers, strips, asked)
            good = reach.force_lower >= asked.force_n
            met += int(good.sum())
            for i in _fewest(reach, layers * strips, good, asked):
                kept.append(
                    Design(
                        voltage_kv=float(voltage),
                        thickness_mm=thickness,
                        layers=int(layers[i]),
                        strips=int(strips[i]),
                        films=int(layers[i] * strips[i]),
                        force_n=float(reach.force[i]),
                        force_n_lower=float(reach.force_lower[i]),
                        stroke_mm=float(reach.stroke[i]),
                        stroke_mm_lower=float(reach.stroke_lower[i]),
                        margin=margin,
                        margin_lower=margin_lower,
                        limited_by=limited_by,
                        field_mv_per_m=driven.field_mv_per_m or float("nan"),
                    )
                )
    front = [kept[i] for i in np.flatnonzero(find_front(_objectives(kept, asked)))]
    return Found(tuple(sorted(front, key=lambda d: (d.voltage_kv, d.films, -d.force_n))), tried, met, unsafe)


def fewest_films(one: Driven, asked: Asked, most_layers: int = 2000, most_strips: int = 2000) -> tuple[int, int] | None:
    """Layers and strips, fewest films, with which films like one meet a requirement; None where no such number does."""
    layers, strips = (m.ravel() for m in np.meshgrid(_counts(most_layers), _counts(most_strips)))
    good = _reach(one, layers, strips, asked).force_lower >= asked.force_n
    if not good.any():
        return None
    best = int(np.argmin(np.where(good, layers * strips, np.iinfo(np.int64).max)))
    # Between the numbers of the grid: as few layers as do with these strips, and the strips beside them.
    options = []
    for m in range(max(1, int(strips[best] * 0.9)), int(strips[best] * 1.1) + 2):
        n = np.arange(1, int(layers[best] * 1.2) + 2)
        enough = np.flatnonzero(_reach(one, n, np.full(n.size, m), asked).force_lower >= asked.force_n)
        if enough.size:
            options.append((int(n[enough[0]]) * m, int(n[enough[0]]), m))
    return min(options)[1:] if options else (int(layers[best]), int(strips[best]))


def nearest_limit(driven: Driven) -> tuple[float | None, float | None, str | None]:
    """Limiting field over field, its lower limit (95 % on one side), and which it is: the one whose lower limit is
    nearer."""
    found = []
    for name, margin in (("pull-in", pull_in_margin(driven)), ("breakdown", breakdown_margin(driven))):
        if margin is not None:
            value, sd = margin
            found.append((value * float(np.exp(-NORMAL_90 * sd)), value, name))
    if not found:
        return None, None, None
    lower, value, name = min(found)
    return value, lower, name


def find_front(objectives: Float) -> Bool:
    """Which rows no other row betters: at least as good in all columns, better in one.

    Parameters
    ----------
    objectives : (n, q), more is better

    Returns
    -------
    (n,)
    """
    keep = np.ones(len(objectives), dtype=bool)
    for i, row in enumerate(objectives):
        if keep[i]:
            # Whoever is bettered by a row is bettered by one of the front, so rows that are out need not be asked.
            keep &= ~((objectives <= row).all(axis=1) & (objectives < row).any(axis=1))
    return keep


def _counts(most: int) -> Int:
    """Whole numbers from 1: all up to 30, then about 4 % apart."""
    grid = np.unique(
        np.round(np.geomspace(30, max(most, 30), 2 + int(25 * np.log(max(most, 30) / 30)))).astype(np.int64)
    )
    return np.asarray([n for n in np.union1d(np.arange(1, 31), grid) if n <= most], dtype=np.int64)


def _reach(one: Driven, layers: Int, strips: Int, asked: Asked) -> _Reach:
    """Force at the stroke, and stroke at the force, of films like one, (n,) each.

    Without mass the spring of n layers and m strips is n/m of one film's. With it the inertia stays, and the slopes of
    ln K are those of one film times a complex share, so that three products of them with the covariance are all that is
    needed.
    """
    hz = np.array([asked.frequency_hz])
    own = complex(one.ratio * one.fit.model.stiffness(hz)[0])
    inertia = own - complex(one.spring(hz)[0])
    films = layers / strips * own
    spring = films - inertia
    held, share = np.abs(spring), films / spring
    slopes = one.ratio * one.fit.slopes(hz)[0] / own
    c = one.fit.covariance
    rr, ri, ii = (
        float(a @ c @ b)
        for a, b in ((slopes.real, slopes.real), (slopes.real, slopes.imag), (slopes.imag, slopes.imag))
    )
    by_fit = share.real**2 * rr - 2 * share.real * share.imag * ri + share.imag**2 * ii
    by_film = by_fit + share.real**2 * one.ratio_sd**2
    force = layers * one.force_n
    taken = held * asked.stroke_mm
    noise = force**2 * one.permittivity_sd**2
    # Thickness lowers the force and stiffens the film: both lower what is left.
    thick = (force + taken * share.real) ** 2 * one.thickness_sd**2
    sd = np.sqrt(noise + taken**2 * by_film + thick)
    stroke = (force - asked.force_n) / held
    stroke_thick = (force / held + stroke * share.real) ** 2 * one.thickness_sd**2
    stroke_sd = np.sqrt(noise / held**2 + stroke**2 * by_film + stroke_thick)
    return _Reach(force - taken, force - taken - NORMAL_90 * sd, stroke, stroke - NORMAL_90 * stroke_sd)


def _spare(value: Float, asked: float) -> Int:
    """Steps of what is given beyond what is asked for."""
    share = np.clip(value / asked, 1.0, _MOST_SPARE)
    return np.asarray(np.floor(np.log(share) / np.log(_STEP) + 1e-9), dtype=np.int64)


def _fewest(reach: _Reach, films: Int, good: Bool, asked: Asked) -> list[int]:
    """Of each pair of steps of force and stroke the design with fewest films."""
    best: dict[tuple[int, int], int] = {}
    chosen = np.flatnonzero(good)
    force, stroke = _spare(reach.force_lower, asked.force_n), _spare(reach.stroke_lower, asked.stroke_mm)
    for i in chosen[np.lexsort((-reach.force_lower[chosen], films[chosen]))]:
        best.setdefault((int(force[i]), int(stroke[i])), int(i))
    return list(best.values())


def _objectives(designs: Sequence[Design], asked: Asked) -> Float:
    """(n, 5), more is better."""
    if not designs:
        return np.zeros((0, 5))
    force = _spare(np.array([d.force_n_lower for d in designs]), asked.force_n)
    stroke = _spare(np.array([d.stroke_mm_lower for d in designs]), asked.stroke_mm)
    margin = np.array([d.margin_lower or 0.0 for d in designs])
    return np.stack([force, stroke, margin, [-d.voltage_kv for d in designs], [-d.films for d in designs]], axis=1)
