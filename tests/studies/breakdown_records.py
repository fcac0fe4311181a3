"""Lifetime records drawn from families of endings: what the detector of breakdowns is developed and calibrated on.

The film's voltage and the current through it are made of pieces of exponential relaxation and straight lines with known
instants; monitor, ammeter and load cell look at them with their own faults. `draw(seed, family)` gives one record with
its truth. It shares no code with the detector. Any other module with such a `draw` can take its place in
`tests.studies.study_breakdown`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
RATES = (1.0, 2.0, 10.0, 50.0, 100.0, 250.0, 500.0, 1000.0)
SPARK_S = (5e-5, 1e-3)
"""Time constants with which a spark empties the film."""


@dataclass
class Trace:
    """A signal as pieces goal + (v0 − goal) e^{−(t − t0)/τ}, or v0 + slope (t − t0) for τ = 0, from left to right."""

    pieces: list[tuple[float, float, float, float]] = field(default_factory=lambda: [(-1.0, 0.0, 0.0, 1.0)])

    def at(self, t: float) -> float:
        t0, v0, goal, tau = self.pieces[-1]
        return v0 + goal * (t - t0) if tau == 0 else goal + (v0 - goal) * float(np.exp(-(t - t0) / tau))

    def relax(self, t: float, goal: float, tau: float) -> None:
        self.pieces.append((t, self.at(t), goal, tau))

    def ramp(self, t: float, goal: float, seconds: float) -> None:
        self.pieces.append((t, self.at(t), (goal - self.at(t)) / seconds, 0.0))
        self.pieces.append((t + seconds, goal, goal, 1.0))

    def jump(self, t: float, goal: float) -> None:
        self.pieces.append((t, goal, goal, 1.0))

    def sample(self, t: Float) -> Float:
        starts = np.array([piece[0] for piece in self.pieces])
        t0, v0, goal, tau = np.array(self.pieces)[np.maximum(np.searchsorted(starts, t, side="right") - 1, 0)].T
        with np.errstate(divide="ignore", invalid="ignore"):
            bent = goal + (v0 - goal) * np.exp(-np.minimum((t - t0) / tau, 700.0))
        return np.where(tau == 0, v0 + goal * (t - t0), bent)


@dataclass
class Bench:
    """One test while it is being drawn: times in s, voltages in kV, currents in µA."""

    rng: np.random.Generator
    rate: float
    kv: float
    start: float
    planned: float
    voltage: Trace = field(default_factory=Trace)
    arc: Trace = field(default_factory=Trace)
    """Current beside the leakage: through sparks and arcs."""
    leak_share: Trace = field(default_factory=Trace)
    """Conductance of the film as a multiple of its usual one."""
    command: Trace = field(default_factory=Trace)
    monitor_lost: list[tuple[float, float, float]] = field(default_factory=list)
    """(from, to, reading in shares of the set point)."""
    events: list[tuple[float, str]] = field(default_factory=list)
    limit: float = 450.0
    stop: float = 0.0
    gap: tuple[float, float] | None = None
    failed: bool = False
    end: float = 0.0
    broke_in_staircase: bool = False
    watched: bool = True
    """The operator writes down where the film failed."""

    def uniform(self, low: float, high: float) -> float:
        return float(self.rng.uniform(low, high))

    def spread(self, low: float, high: float) -> float:
        return float(np.exp(self.rng.uniform(np.log(low), np.log(high))))

    def chance(self, share: float) -> bool:
        return bool(self.rng.random() < share)

    def some_time(self) -> float:
        """An instant of the life well before its planned end."""
        return self.start + self.uniform(0.15, 0.9) * self.planned

    def fail(self, t: float) -> None:
        self.failed, self.end = True, t
        self.events.append((t, "failed"))

    def end_after(self, t: float, kind: str) -> None:
        self.end = t
        self.events.append((t, kind))


def _discharge(b: Bench, t: float) -> None:
    """The supply stops and the voltage runs out through the resistor, or through the monitor's divider alone."""
    tau = b.uniform(1.6e-3, 33e-3) if b.chance(0.7) else b.spread(0.04, 0.6)
    if b.chance(0.02):
        tau = b.spread(*SPARK_S)  # a switch that earths the film
    b.voltage.relax(t, 0.0, tau)
    b.arc.jump(t, 0.0)
    b.stop = t + b.uniform(0.6, 6.0)


def _after_failure(b: Bench, t: float, *, least: float = 1.0) -> float:
    """When somebody, or an interlock, ends the test; the discharge is added. Gives that instant."""
    off = t + least + b.spread(0.1, 8.0)
    tripped = b.chance(0.4)
    if not tripped:
        b.command.jump(off, 0.0)
    b.voltage.relax(off, 0.0, b.uniform(1.6e-3, 33e-3))
    b.arc.jump(off, 0.0)
    b.stop = off + b.uniform(0.2, 4.0) if b.chance(0.6) else off
    return off


def abrupt_short(b: Bench) -> None:
    t = b.some_time()
    b.fail(t)
    b.voltage.relax(t, b.voltage.at(t) * (0.0 if b.chance(0.5) else b.uniform(0.0, 0.05)), b.spread(*SPARK_S))
    b.arc.jump(t, b.limit)
    _after_failure(b, t)


def short_then_trip(b: Bench) -> None:
    """The overcurrent trips the supply at once: the current is a spike."""
    t = b.some_time()
    b.fail(t)
    b.voltage.relax(t, 0.0, b.spread(*SPARK_S))
    b.arc.jump(t, b.limit * b.uniform(1.0, 5.0))
    trip = t + b.spread(0.002, 0.5)
    b.arc.jump(trip, 0.0)
    if b.chance(0.5):
        b.command.jump(trip, 0.0)
    b.stop = trip + b.uniform(0.7, 5.0)


def restarted(b: Bench) -> None:
    """A short trips the supply; it comes back by itself, and the burnt film holds for a while."""
    t = b.some_time()
    b.fail(t)
    full = b.voltage.at(t)
    b.voltage.relax(t, full * b.uniform(0.0, 0.1), b.spread(*SPARK_S))
    b.arc.jump(t, b.limit)
    back = t + b.uniform(0.55, 3.0) + 2 / b.rate
    b.arc.jump(back, 0.0)
    b.voltage.relax(back, full, b.spread(3e-3, 40e-3))
    b.stop = back + b.uniform(1.0, 10.0)


def limited_hunting(b: Bench) -> None:
    t = b.some_time()
    b.fail(t)
    full = b.voltage.at(t)
    first = full * b.uniform(0.03, 0.6)
    b.voltage.relax(t, first, b.spread(*SPARK_S))
    b.arc.jump(t, b.limit)
    low, high = sorted((full * b.uniform(0.02, 0.3), full * b.uniform(0.1, 0.75)))
    period, off = 1 / b.spread(0.3, 30.0), t + 1.2 + b.spread(0.1, 8.0)
    now = t + b.uniform(0.05, 0.3) * period + 5e-3
    while now < off and len(b.voltage.pieces) < 400:
        b.voltage.ramp(now, low + (high - low) * b.uniform(0.7, 1.0), 0.8 * period)
        b.voltage.relax(now + 0.8 * period, low * b.uniform(0.8, 1.2), b.spread(*SPARK_S))
        now += period * b.uniform(0.9, 1.1)
    b.voltage.relax(max(off, now), 0.0, 5e-3)
    b.arc.jump(max(off, now), 0.0)
    if b.chance(0.6):
        b.command.jump(max(off, now), 0.0)
    b.stop = max(off, now) + b.uniform(0.0, 3.0)


def arc_through_resistor(b: Bench) -> None:
    """A resistor before the film: the voltage at the monitor follows the arc with a time constant."""
    t = b.some_time()
    b.fail(t)
    rest, tau = (0.0, b.spread(1e-3, 20e-3)) if b.chance(0.6) else (b.uniform(0.02, 0.3), b.spread(1e-3, 60e-3))
    b.voltage.relax(t, b.voltage.at(t) * rest, tau)
    b.arc.jump(t, b.limit * b.uniform(0.3, 1.0))
    _after_failure(b, t)


def _heal(b: Bench, t: float) -> float:
    """A discharge that clears itself; gives the instant at which the voltage is back."""
    held, recharge = b.spread(0.002, 0.25), b.spread(3e-3, 40e-3)
    full = b.voltage.at(t)
    b.voltage.relax(t, full * b.uniform(0.0, 0.5), b.spread(*SPARK_S))
    b.arc.jump(t, b.limit)
    b.voltage.relax(t + held, full, recharge)
    b.arc.jump(t + held, 0.0)
    b.events.append((t, "healed"))
    return t + held + 8 * recharge


def _unrest(b: Bench) -> None:
    """Discharges that heal, or moments without monitor, early in any life."""
    t = b.start + 0.02 * b.planned
    for _ in range(int(b.rng.integers(1, 4))):
        if t > b.start + 0.13 * b.planned - 1:
            return
        if b.chance(0.7):
            t = _heal(b, t)
        else:
            b.monitor_lost.append((t, t + b.uniform(0.01, 0.3), 0.0))
        t += 0.8


def self_clearing(b: Bench) -> None:
    """Discharges that heal, more and more often, then one that does not."""
    final = b.start + b.uniform(0.4, 0.9) * b.planned
    t = b.start + 0.1 * b.planned
    while True:
        t += b.rng.exponential(b.planned / 10) + 0.8
        if t > final - 2:
            break
        t = _heal(b, t)
    b.fail(final)
    b.voltage.relax(final, b.voltage.at(final) * b.uniform(0, 0.2), b.spread(*SPARK_S))
    b.arc.jump(final, b.limit)
    _after_failure(b, final)


def self_clearing_survivor(b: Bench) -> None:
    t = b.start + 0.1 * b.planned
    for _ in range(int(b.rng.integers(1, 12))):
        t += b.rng.exponential(b.planned / 12) + 0.8
        if t > b.start + b.planned - 3:
            break
        t = _heal(b, t)
    planned_end(b)


def creeping(b: Bench) -> None:
    """The insulation fades: the current rises to the supply's limit, the voltage sags, then collapses or goes on sagging."""
    t = b.some_time()
    seconds = min(b.spread(2.0, 100.0), t - b.start - 0.5)
    rise = b.spread(4.0, 100.0)
    b.leak_share.ramp(t - seconds, rise, seconds)
    full = b.voltage.at(t)
    if b.chance(0.3):  # without a spark: the voltage is what the limit leaves
        b.fail(t)
        tau = b.spread(0.2, 3.0)
        b.voltage.relax(t, full * b.uniform(0.05, 0.5), tau)
        b.leak_share.relax(t, rise * 10, tau)
        _after_failure(b, t, least=3 * tau + 1)
        return
    b.voltage.ramp(t - 0.3 * seconds, full * b.uniform(0.93, 1.0), 0.3 * seconds)
    b.fail(t)
    b.voltage.relax(t, full * b.uniform(0.0, 0.3), b.spread(*SPARK_S))
    b.arc.jump(t, b.limit)
    _after_failure(b, t)


def operator_off(b: Bench) -> None:
    t = b.some_time()
    b.end_after(t, "off")
    b.command.jump(t, 0.0)
    _discharge(b, t)


def planned_end(b: Bench) -> None:
    t = b.start + b.planned + b.uniform(-0.3, 0.3)
    b.end_after(t, "off")
    b.command.jump(t, 0.0)
    _discharge(b, t)
    if b.chance(0.3):
        b.stop = t


def interlock_trip(b: Bench) -> None:
    """The supply stops by itself: the command stays."""
    t = b.some_time()
    b.end_after(t, "supply")
    _discharge(b, t)


def supply_sag(b: Bench) -> None:
    t = b.some_time()
    full, low = b.voltage.at(t), b.uniform(0.15, 0.85)
    tau = b.spread(0.08, 2.0)
    b.voltage.relax(t, full * low, tau)
    if b.chance(0.7):
        back = t + tau * b.uniform(1.0, 5.0)
        b.events.append((t, "supply"))
        b.voltage.relax(back, full, b.spread(0.02, 1.0))
        planned_end(b)
    else:
        b.end_after(t, "supply")
        b.stop = t + 5 * tau + b.uniform(1.0, 10.0)


def monitor_glitch(b: Bench) -> None:
    t = b.start + 0.05 * b.planned
    for _ in range(int(b.rng.integers(1, 8))):
        t += b.rng.exponential(b.planned / 10) + 0.5
        seconds = b.spread(0.5 / b.rate, 3.0 if b.chance(0.4) else max(0.3, 0.6 / b.rate))
        if t + seconds > b.start + b.planned - 2:
            break
        b.monitor_lost.append((t, t + seconds, float(b.rng.choice([0.0, 0.0, -0.1, 0.3, 1.5]))))
        b.events.append((t, "monitor"))
        t += seconds
    planned_end(b)


def monitor_lost(b: Bench) -> None:
    """The monitor's cable comes off for good; current and force go on."""
    t = b.some_time()
    planned_end(b)
    b.monitor_lost.append((t, np.inf, float(b.rng.choice([0.0, 0.0, 0.02]))))
    b.events.insert(0, (t, "monitor"))
    b.end = t


def record_ends(b: Bench) -> None:
    b.end = b.stop = b.some_time()


def gap(b: Bench) -> None:
    begin = b.some_time()
    b.gap = (begin, begin + b.uniform(5.0, 20.0) + 6 / b.rate)
    if b.chance(0.5):
        planned_end(b)
    else:
        t = b.uniform(*b.gap)
        b.voltage.relax(t, 0.0, 1e-3)
        b.arc.jump(t, b.limit)
        b.stop = b.gap[1] + 5
    b.end, b.events = begin, []


def humidity(b: Bench) -> None:
    """Leakage that wanders, the film untouched."""
    t = b.start
    for _ in range(6):
        seconds = b.planned / 6.1
        b.leak_share.ramp(t, b.spread(0.5, 30.0), seconds)
        t += seconds
    (planned_end if b.chance(0.6) else operator_off)(b)


def corona(b: Bench) -> None:
    t = b.start
    while t < b.start + b.planned - 1:
        t += b.rng.exponential(b.planned / 60) + 2e-3
        b.arc.jump(t, b.limit * b.spread(0.01, 1.0))
        b.arc.jump(t + 1.5e-3, 0.0)
    (planned_end if b.chance(0.6) else operator_off)(b)


def staircase(b: Bench) -> None:
    """After the planned test the voltage is raised until breakdown, or until the operator has had enough."""
    t = b.start + b.planned
    b.end, level, step, hold = t, b.kv, b.uniform(0.2, 1.0), b.uniform(1.5, 5.0)
    top = b.kv * b.uniform(1.15, 1.6)
    while level < top:
        level += step
        b.voltage.relax(t, level, 5e-3)
        b.command.jump(t, level / 1.5)
        t += hold
    t -= b.uniform(0.1, 0.7) * hold
    if b.chance(0.8):
        b.broke_in_staircase = True
        b.events.append((t, "failed"))
        b.voltage.relax(t, level * (0.0 if b.chance(0.5) else b.uniform(0.0, 0.3)), b.spread(*SPARK_S))
        b.arc.jump(t, b.limit)
        _after_failure(b, t)
    else:
        b.events.append((t, "off"))
        b.command.jump(t, 0.0)
        _discharge(b, t)


COLLAPSES: dict[str, Callable[[Bench], None]] = {
    f.__name__: f
    for f in (
        abrupt_short, short_then_trip, restarted, limited_hunting, arc_through_resistor, self_clearing, creeping,
    )
}  # fmt: skip
SURVIVALS: dict[str, Callable[[Bench], None]] = {
    f.__name__: f
    for f in (
        operator_off, planned_end, interlock_trip, supply_sag, monitor_glitch, monitor_lost, record_ends, gap, humidity,
        corona, self_clearing_survivor, staircase,
    )
}  # fmt: skip
FAMILIES = tuple(COLLAPSES | SURVIVALS)


@dataclass(frozen=True)
class Drawn:
    """A record with the truth about it. `channels`: name → (unit, (n,) values) at `time_s` (n,) in s."""

    time_s: Float
    channels: dict[str, tuple[str, Float]]
    metadata: dict[str, Any]
    truth: dict[str, Any]


def draw(seed: int, family: str) -> Drawn:
    """One record of a family."""
    rng = np.random.default_rng([seed, FAMILIES.index(family)])
    rate = float(rng.choice(RATES))
    kv = float(np.round(rng.uniform(2.0, 9.5), 1))
    longest = 60.0 if rate >= 250 else 300.0
    planned = float(np.round(np.exp(rng.uniform(np.log(max(8.0, 30 / rate)), np.log(longest))), 1))
    applied = float(rng.uniform(0.5, 3.0) + 3 / rate)
    seconds = float(rng.uniform(0.02, 3.0))
    b = Bench(rng, rate, kv, applied + 0.95 * seconds, planned)
    b.voltage.ramp(applied, kv, seconds)
    b.command.ramp(applied, kv / 1.5, seconds)
    b.leak_share.jump(-0.5, 1.0)
    b.limit = b.spread(20.0, 1000.0)
    b.start = max(b.start, applied + seconds + 0.3)
    if b.chance(0.2) and family not in ("self_clearing", "self_clearing_survivor"):
        _unrest(b)
    (COLLAPSES | SURVIVALS)[family](b)
    life_start = applied + 0.95 * seconds
    return _recorded(b, family, life_start)


def _recorded(b: Bench, family: str, life_start: float) -> Drawn:
    rng = b.rng
    t = np.arange(0.0, b.stop, 1 / b.rate)
    if b.chance(0.3):
        t = t + rng.uniform(-0.1, 0.1, t.size) / b.rate
    if b.gap:
        t = t[(t <= b.gap[0]) | (t >= b.gap[1])]
    averaging = b.rate <= 50 and b.chance(0.4)

    def look(f: Callable[[Float], Float]) -> Float:
        if not averaging:
            return f(t)
        return np.mean([f(t - share / b.rate) for share in np.linspace(0, 0.9, 10)], axis=0)

    true = look(b.voltage.sample)
    monitor = true.copy()
    for begin, end, share in b.monitor_lost:
        monitor[(t >= begin) & (t < end)] = share * b.kv
    noise = b.kv * b.spread(3e-4, 1e-2)
    step = 15 / 2 ** int(rng.choice([12, 16, 16, 24]))
    monitor = np.round((monitor + rng.normal(0, noise, t.size) + b.uniform(-0.003, 0.003) * b.kv) / step) * step
    if b.chance(0.15):
        monitor = -monitor
    if b.chance(0.2) and t.size > 50:
        monitor[rng.integers(10, t.size - 10, 2)] = np.nan
    unit = str(rng.choice(["kV", "kV", "V"]))
    channels = {"voltage": (unit, monitor * (1000 if unit == "V" else 1))}
    if b.chance(0.45):
        channels["command"] = ("V", look(b.command.sample) + rng.normal(0, 1e-3, t.size))
    if b.chance(0.6):
        gohm = b.spread(0.5, 50.0)
        current = look(
            lambda s: np.minimum(b.voltage.sample(s) / gohm * b.leak_share.sample(s) + b.arc.sample(s), 5 * b.limit)
        )
        if b.chance(0.25):  # an ammeter on the film's side sees it charge and discharge
            # but not a film that empties through its own spark
            inside = (look(b.arc.sample) > 0) | (b.failed & (t >= b.end - 1.5 / b.rate))
            charging = 1000 * b.spread(0.05, 1.0) * np.gradient(true, t) * ~inside
            current = current + (np.abs(charging) if b.chance(0.05) else charging)
        full = b.limit * b.spread(1.0, 4.0)
        current = np.clip(current + rng.normal(0, full * b.spread(1e-4, 5e-3), t.size), -full, full)
        channels["leakage_current"] = ("µA", current)
    if b.chance(0.5):
        drop = b.spread(0.01, 0.2)
        force = 1.0 - 0.02 * np.log1p(t) - drop * (true / b.kv) ** 2 + rng.normal(0, drop * b.spread(2e-3, 0.3), t.size)
        if b.failed and b.chance(0.2):
            force[t > b.end] -= b.uniform(0.05, 0.8)  # the film tears
        channels["force"] = ("N", force)
    metadata: dict[str, Any] = {
        "recording_id": "drawn",
        "protocol": "lifetime",
        "loading": "electrical",
        "specimen_id": "S",
    }
    if b.chance(0.8):
        metadata["voltage_setpoint_kv"] = b.kv
    if b.chance(0.85):
        metadata["test_duration_s"] = b.planned
    site = str(rng.choice(["rod", "lead", "active", "edge"])) if b.failed or b.broke_in_staircase else "none"
    if b.chance(0.03):
        site = "none" if site != "none" else "rod"
    if b.chance(0.5):
        metadata["failure_site"] = site
    elif b.chance(0.3):
        metadata["failure_site"] = "unknown"
    truth = {
        "failed": b.failed,
        "family": family,
        "lifetime_s": b.end - life_start,
        "decidable": _decidable(b, family, channels, float(t[-1])),
        "last_above_90_s": b.end,
        "visible_until_s": float(t[-1]),
        "broke_in_staircase": b.broke_in_staircase,
        "events": sorted(b.events),
    }
    return Drawn(t, channels, metadata, truth)


def _decidable(b: Bench, family: str, channels: dict[str, tuple[str, Float]], last_s: float) -> bool:
    """Whether anybody could tell from the record: the fall is on it, and something tells its cause from the others."""
    if family in ("record_ends", "gap", "planned_end"):
        return True
    if b.failed and last_s < b.end + max(0.1, 1 / b.rate):
        return False
    if family == "monitor_lost":
        return "leakage_current" in channels or "force" in channels
    if family == "restarted" or b.rate <= 50:
        return "leakage_current" in channels and (family != "short_then_trip" or b.rate >= 50)
    return True
