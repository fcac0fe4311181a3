"""Lifetime records from a circuit that is integrated in time: supply with a current limit, film, spark gap and divider.

Written apart from the detector and from `breakdown_records`, whose endings are drawn as curves: here a film is a capacitance, an
arc a conductance that strikes and goes out, and the voltage is what the supply can hold. `draw(seed, family)` as there.

Units: kV, µA, GΩ, nF, s; so that kV/GΩ = µA and µA/nF = kV/s.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.studies.breakdown_records import Drawn

Float = NDArray[np.float64]
COLLAPSES = ("abrupt_short", "limited_hunting", "discharge_into_arc", "repeated_clearing", "creeping_leakage")
SURVIVALS = ("switched_off", "tripped", "sagged", "cleared_and_lived", "monitor_off")
FAMILIES = COLLAPSES + SURVIVALS
BATCH = 250
"""Seeds that are integrated side by side."""
BEFORE_S, AFTER_S, STEP_S, KEPT = 8.0, 6.0, 4e-4, 3
"""What is integrated before and after an ending, in which steps, and each how many-th of them is kept."""
RATES = (5.0, 10.0, 50.0, 100.0, 250.0, 1000.0)


@dataclass(frozen=True)
class _Batch:
    """(m,) instants about the ending, (m, B) voltage and current of the supply, and by name what was drawn, (B,) each."""

    time: Float
    voltage: NDArray[np.float32]
    current: NDArray[np.float32]
    drawn: dict[str, Float]


def draw(seed: int, family: str) -> Drawn:
    """One record of a family."""
    return _record(
        _integrate(family, seed // BATCH),
        seed % BATCH,
        np.random.default_rng([seed, 2, FAMILIES.index(family)]),
        family,
    )


@lru_cache(maxsize=len(FAMILIES))
def _integrate(family: str, batch: int) -> _Batch:
    rng = np.random.default_rng([batch, 1, FAMILIES.index(family)])

    def spread(low: float, high: float, *more: int) -> Float:
        return np.exp(rng.uniform(np.log(low), np.log(high), (*more, BATCH)))

    kv, farad, bleed = rng.uniform(2, 9, BATCH), spread(0.1, 2.0), spread(0.02, 0.4)
    inner, leak = spread(2e-4, 2e-3), spread(0.3, 30.0)
    limit = spread(20.0, 1000.0) + kv / bleed + kv / leak
    arc = spread(1e-6, 3e-4)
    # Short circuits: from when to when; a strike voltage makes them go out and come again.
    begin, end = np.full((6, BATCH), np.inf), np.full((6, BATCH), np.inf)
    hunts = np.zeros(BATCH, dtype=bool)
    source_off, reach = np.full(BATCH, np.inf), np.zeros(BATCH)
    low, sag_s, back_s = np.ones(BATCH), spread(0.02, 1.0), np.full(BATCH, np.inf)
    leak_time, leak_rise = np.full(BATCH, np.inf), np.zeros(BATCH)
    off_after = rng.uniform(0.7, 5.0, BATCH)
    if family in COLLAPSES:
        begin[0], end[0] = 0.0, np.inf
        source_off = off_after
    if family == "limited_hunting":
        hunts[:] = True
    if family == "discharge_into_arc":
        arc = spread(1e-3, 3e-2)
        limit = np.minimum(limit, rng.uniform(0.02, 0.6, BATCH) * kv / arc + kv / bleed)
    if family in ("repeated_clearing", "cleared_and_lived"):
        begin[1:] = -np.sort(rng.uniform(0.7, BEFORE_S - 1, (5, BATCH)), axis=0)
        begin[1:][rng.random((5, BATCH)) < 0.4] = np.inf
        end[1:] = begin[1:] + spread(5e-4, 0.08, 5)
        hunts = (rng.random(BATCH) < 0.3) & (family == "repeated_clearing")
    if family == "creeping_leakage":
        leak_time, leak_rise = -spread(0.5, BEFORE_S - 0.5), spread(0.3, 3.0) * limit / kv
        quiet = rng.random(BATCH) < 0.3
        begin[0, quiet] = np.inf
        leak_rise[quiet] = (3 * limit / kv)[quiet]
        reach = np.where(quiet, 1.0, 0.0)
    if family in ("switched_off", "tripped", "cleared_and_lived", "monitor_off"):
        source_off = np.zeros(BATCH)
    if family == "sagged":
        low = rng.uniform(0.1, 0.85, BATCH)
        back_s = np.where(rng.random(BATCH) < 0.5, sag_s * rng.uniform(1, 4, BATCH), np.inf)

    count = round((BEFORE_S + AFTER_S) / STEP_S)
    kept_v, kept_i = np.empty((2, -(-count // KEPT), BATCH), dtype=np.float32)
    v, lit = kv.copy(), np.zeros(BATCH, dtype=bool)
    strike = kv * rng.uniform(0.1, 0.6, BATCH)
    hold = limit * rng.uniform(1.5, 4.0, BATCH)
    struck = np.zeros(BATCH, dtype=bool)
    for i in range(count):
        t = i * STEP_S - BEFORE_S
        shorted = ((begin <= t) & (t < end)).any(axis=0)
        if hunts.any():
            new = shorted & ~struck
            struck |= shorted
            lit = np.where(new, True, lit & (v / arc > hold) | (~lit & struck & (v > strike)))

            shorted = np.where(hunts & (begin[0] <= t), lit, shorted)
        film = 1 / leak + leak_rise * np.clip(
            (t - leak_time) / np.maximum(-leak_time, 1e-9), 0, None
        ) ** 2 * np.isfinite(leak_time)
        film = film * (1 + 20 * reach * np.clip(t, 0, None))
        goal = kv * np.where(t < 0, 1.0, np.where(t < back_s, 1 - (1 - low) * (1 - np.exp(-max(t, 0.0) / sag_s)), 1.0))
        g = 1 / bleed + film + shorted / arc
        held = (v + STEP_S / farad * goal / inner) / (1 + STEP_S / farad * (g + 1 / inner))
        asked = (goal - held) / inner
        given = np.where(t >= source_off, 0.0, np.clip(asked, 0.0, limit))
        v = np.where(given == asked, held, (v + STEP_S / farad * given) / (1 + STEP_S / farad * g))
        if i % KEPT == 0:
            kept_v[i // KEPT], kept_i[i // KEPT] = v, given - v / bleed
    time: Float = np.arange(float(kept_v.shape[0])) * STEP_S * KEPT - BEFORE_S
    drawn = {
        "kv": kv,
        "limit": limit,
        "leak": kv / leak,
        "off": source_off,
        "bleed": bleed,
        "arc": np.where(hunts, 0, arc),
    }
    return _Batch(time, kept_v, kept_i, drawn)


def _record(batch: _Batch, number: int, rng: np.random.Generator, family: str) -> Drawn:
    """What a bench writes down of one ending: `end` s after its first sample."""
    own = {name: float(values[number]) for name, values in batch.drawn.items()}
    kv, rate = own["kv"], float(rng.choice(RATES))
    applied, rise = rng.uniform(0.5, 2.0) + 3 / rate, rng.uniform(0.02, 1.5)
    start = applied + 0.95 * rise
    life = BEFORE_S + float(np.exp(rng.uniform(np.log(1.0), np.log(60.0))))
    end = start + life
    seconds = min(AFTER_S - 0.01, own["off"] + rng.uniform(0.7, 3.0)) if np.isfinite(own["off"]) else AFTER_S - 0.01
    time = np.arange(0.0, end + seconds, 1 / rate) + rng.uniform(0, 1 / rate)
    time = time[time < end + seconds]

    def look(values: NDArray[np.float32], before: float) -> Float:
        """A quantity at the record's instants: rises with the voltage, is as usual, and ends as integrated."""
        found = np.interp(time - end, batch.time, values[:, number])
        early = time - end < batch.time[0]
        return np.where(early, before * np.clip((time - applied) / rise, 0, 1), found)

    voltage = look(batch.voltage, kv)
    true = voltage.copy()
    failed = family in COLLAPSES
    if family == "monitor_off":
        # A plug that comes off before the end, for a while or for good; the life goes on.
        lost = end - rng.uniform(0.3, 0.9) * life
        voltage[(time >= lost) & (time < lost + (np.inf if rng.random() < 0.5 else rng.uniform(0.7, 5.0)))] = 0.0
    noise = kv * float(np.exp(rng.uniform(np.log(2e-4), np.log(8e-3))))
    step = 20 / 2 ** int(rng.choice([12, 14, 16]))
    channels = {"voltage": ("kV", np.round((voltage + rng.normal(0, noise, time.size)) / step) * step)}
    seen = {name: rng.random() < share for name, share in (("command", 0.5), ("leakage_current", 0.6), ("force", 0.4))}
    if family == "monitor_off":
        seen["leakage_current"] = seen["force"] = True
    if seen["command"]:
        off = own["off"] if family != "tripped" and (not failed or rng.random() < 0.6) else np.inf
        on = np.clip((time - applied) / rise, 0, 1) * (time - end < off)
        channels["command"] = ("V", kv / 1.5 * on + rng.normal(0, 1e-3, time.size))
    if seen["leakage_current"]:
        current = np.minimum(look(batch.current, own["leak"]), 1.2 * own["limit"])
        channels["leakage_current"] = (
            "µA",
            current + rng.normal(0, own["limit"] * 10 ** rng.uniform(-4, -2.3), time.size),
        )
    if seen["force"]:
        drop = 10 ** rng.uniform(-2, -0.7)
        channels["force"] = (
            "N",
            1 - drop * (true / kv) ** 2 + drop * 10 ** rng.uniform(-2.5, -0.7) * rng.normal(0, 1, time.size),
        )
    known: dict[str, Any] = {
        "recording_id": "drawn",
        "protocol": "lifetime",
        "loading": "electrical",
        "specimen_id": "S",
    }
    if rng.random() < 0.9:
        known["voltage_setpoint_kv"] = kv
    if rng.random() < 0.8:
        ended = family in ("cleared_and_lived", "monitor_off") or (family == "switched_off" and rng.random() < 0.5)
        known["test_duration_s"] = life if ended else life * rng.uniform(1.2, 5)
    if rng.random() < 0.4:
        known["failure_site"] = str(rng.choice(["rod", "lead", "active", "edge"])) if failed else "none"
    truth = {
        "failed": failed, "family": family, "lifetime_s": life, "last_above_90_s": end, "decidable": True,
        "visible_until_s": float(time[-1]), "broke_in_staircase": False,
    }  # fmt: skip
    return Drawn(time, channels, known, truth)
