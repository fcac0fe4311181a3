"""Sessions of one specimen: which recordings, in which order, with what noise, as the ingest would yield them.

Does not belong here: physics.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.metadata import RecordingMetadata, RigConstants
from schemas.recording import Channel, Recording
from tests.helpers.truth_rig import sensors
from tests.helpers.truth_rig.design import Plan, completed, plan
from tests.helpers.truth_rig.effects import Effect, Shape, as_effects
from tests.helpers.truth_rig.hidden import Loads, preload, resolve
from tests.helpers.truth_rig.material import Specimen, random_specimen
from tests.helpers.truth_rig.rig import Memory, Signals, TruthRig

Float = NDArray[np.float64]
Design = Mapping[str, Any]

_START = datetime(2026, 3, 2, 8, 0, tzinfo=UTC)
_RANGES_N = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0)
_HEADROOM = 1.2
_CONVERTER_HEADROOM = 1.2
_NOISE = {
    "displacement": 4e-4, "voltage": 2.5e-3, "capacitance": 2e-3, "command": 5e-4, "temperature": 0.02,
    "leakage_current": 0.05,
}  # fmt: skip
"""Standard deviation of one raw sample, canonical units; that of the force goes with the cell's range."""
_SPAN = {
    "displacement": 10.0, "voltage": 15.0, "capacitance": 50.0, "command": 10.0, "temperature": 100.0,
    "leakage_current": 500.0,
}  # fmt: skip
_ORDER = ("force", *_NOISE)
_CHANNELS = {
    "chirp": ("displacement", "force"),
    "sphs": ("command", "voltage", "force"),
    "cyclic": ("displacement", "force", "capacitance"),
    "step": ("command", "voltage", "force", "capacitance"),
    "relaxation": ("displacement", "force"),
    "cycle": ("displacement", "force"),
    "tap": ("force",),
    "weight": ("force",),
}


def full_designs() -> tuple[dict[str, Any], ...]:
    """The 30 recordings of a full session."""
    small, medium, large = 0.006, 0.02, 0.05

    def chirp(strain: float) -> dict[str, Any]:
        return {"protocol": "chirp", "strain_pp": strain}

    def sphs(kv: float) -> dict[str, Any]:
        return {"protocol": "sphs", "drive_kv": kv}

    def steps(kv: float) -> dict[str, Any]:
        return {"protocol": "step", "loading": "electrical", "drive_kv": kv}

    def cyclic(strain: float, hz: float, cycles: int) -> dict[str, Any]:
        return {"protocol": "cyclic", "strain_pp": strain, "frequency_hz": hz, "cycles": cycles}

    def relax(strain: float) -> dict[str, Any]:
        return {"protocol": "step", "loading": "mechanical", "strain_pp": strain}

    return (
        chirp(small), chirp(small), sphs(4.0), sphs(5.5), sphs(7.0), sphs(8.0), steps(3.0), steps(5.0),
        chirp(medium), chirp(medium), chirp(large), chirp(large), relax(0.03),
        cyclic(0.02, 1.0, 10), cyclic(0.04, 1.0, 10), cyclic(0.08, 1.0, 10), cyclic(0.12, 1.0, 10),
        cyclic(0.02, 1.0, 10), cyclic(0.06, 0.1, 4), cyclic(0.06, 0.3, 6), cyclic(0.06, 4.0, 20), cyclic(0.12, 0.3, 6),
        steps(7.0), steps(8.0), sphs(7.0), steps(7.0), relax(0.08), sphs(5.5), chirp(medium), chirp(small),
    )  # fmt: skip


def compact_designs() -> tuple[dict[str, Any], ...]:
    """The 10 recordings of a compact session."""
    chosen = (0, 3, 5, 7, 10, 14, 16, 23, 26, 29)
    return tuple(full_designs()[i] for i in chosen)


@dataclass(frozen=True)
class Truth:
    """What is true of a session: to score against, never to show to the diagnosis.

    `equivalent`: effect → what the contract's severity keys would say. `plain` the largest loads without effects.
    """

    specimen: Specimen
    effects: tuple[Effect, ...]
    equivalent: Mapping[str, Mapping[str, Shape]]
    plain: Loads
    rig: TruthRig


@dataclass(frozen=True)
class Session:
    """Recordings of one specimen in time order, with noise and without.

    `noise_free` are the same recordings before noise and converter, effects included. `designs` as completed.
    """

    truth: Truth
    seed: int
    recordings: tuple[Recording, ...]
    noise_free: tuple[Recording, ...]
    designs: tuple[Mapping[str, Any], ...]
    memory: Memory
    temperature: bool

    def make_recording(self, protocol: str, **design: Any) -> Recording:
        """The recording that this design would give after the session (see the package's docstring for the keys)."""
        return self.extended({"protocol": protocol, **design}).recordings[-1]

    def extended(self, *designs: Design) -> Session:
        """The session with further recordings after it."""
        return _grown(self, designs)


def full_session(
    seed: int,
    effects: Iterable[Effect | str | tuple[str, float]] = (),
    *,
    material: str | Specimen | None = None,
    temperature: bool = False,
) -> Session:
    """30 recordings: sweeps, SPHS, voltage steps, relaxation, cycles rising and again small, early ones repeated late.

    effects : ids (at typical severity), (id, severity) or `Effect`
    material : one of `MATERIALS`, a `Specimen`, or None for a random one
    temperature : record the temperature in every recording
    """
    return make_session(seed, full_designs(), effects, material=material, temperature=temperature)


def compact_session(
    seed: int,
    effects: Iterable[Effect | str | tuple[str, float]] = (),
    *,
    material: str | Specimen | None = None,
    temperature: bool = False,
) -> Session:
    """10 recordings: every protocol once or twice, the first sweep again at the end. Arguments as `full_session`."""
    return make_session(seed, compact_designs(), effects, material=material, temperature=temperature)


def make_session(
    seed: int,
    designs: Sequence[Design],
    effects: Iterable[Effect | str | tuple[str, float]] = (),
    *,
    material: str | Specimen | None = None,
    temperature: bool = False,
) -> Session:
    """A session of any designs. The same seed gives the same specimen, pauses and noise whatever the effects are."""
    given = as_effects(effects)
    if isinstance(material, Specimen):
        specimen = material
    else:
        specimen = random_specimen(_stream(seed, 0), kind=material, name=f"S-{seed}")
    pauses = _stream(seed, 2).uniform(30.0, 90.0, len(designs))
    timed = [{"rest_before_s": float(pause), **design} for pause, design in zip(pauses, designs, strict=True)]
    plain = _plain_loads(specimen, timed)
    hidden = resolve(given, specimen, plain, _stream(seed, 1))
    rig = TruthRig(specimen, hidden, plain)
    truth = Truth(specimen, given, hidden.equivalent, plain, rig)
    return _grown(Session(truth, seed, (), (), (), rig.fresh(), temperature), timed)


def _stream(*key: int) -> np.random.Generator:
    """Random numbers of their own for each purpose, so that one does not move another."""
    return np.random.default_rng(np.random.SeedSequence(key))


def _planned(specimen: Specimen, design: Design, cache: dict[str, Plan]) -> Plan:
    """The plan of a design; equal excitations are made once."""
    _, keys = completed(design)
    key = repr((design.get("protocol"), sorted((k, v) for k, v in keys.items() if k != "rest_before_s")))
    if key not in cache:
        cache[key] = plan(design, length_mm=specimen.length_mm, fastest_s=min(specimen.film.tau, default=1.0))
    return replace(cache[key], design=keys)


def _plain_loads(specimen: Specimen, designs: Sequence[Design]) -> Loads:
    """Largest loads of the session without effects: mechanical recordings are run, electrical ones need no film."""
    cache: dict[str, Plan] = {}
    plans = [_planned(specimen, design, cache) for design in designs]
    highest = max((float(np.abs(p.command).max()) for p in plans), default=0.0)
    force = specimen.force_per_voltage_squared * highest**2
    total = Loads(voltage=highest, tension=force, fall=force, reading=force)
    rig = TruthRig(specimen, resolve((), specimen, total, _stream(0)), total)
    seen: dict[int, Loads] = {}
    for p in plans:
        if p.loading == "mechanical":
            if id(p.displacement) not in seen:
                seen[id(p.displacement)] = rig.run(p, rig.fresh(), _stream(0)).loads
            total = total.with_loads(seen[id(p.displacement)])
        elif p.loading == "electrical":
            exposure = float((p.command**2).sum()) * p.step_s / 2 / max(highest, 1e-9) ** 2
            total = replace(total, exposure=total.exposure + exposure, duration=total.duration + p.duration_s)
        total = replace(total, duration=total.duration + float(p.design["rest_before_s"]))
    return total


def _grown(session: Session, designs: Sequence[Design]) -> Session:
    """The session with further recordings."""
    rig, memory = session.truth.rig, session.memory
    cache: dict[str, Plan] = {}
    noisy, clean, done = list(session.recordings), list(session.noise_free), list(session.designs)
    for design in designs:
        p = _planned(session.truth.specimen, design, cache)
        memory = rig.idle(memory, float(p.design["rest_before_s"]))
        index, started_s = len(done), memory.clock_s
        signals = rig.run(p, memory, _stream(session.seed, 3, index))
        memory = signals.memory
        pair = _recordings(session, p, signals, index, started_s)
        noisy.append(pair[0])
        clean.append(pair[1])
        done.append({"protocol": p.protocol, "loading": p.loading, **p.design})
    return replace(session, recordings=tuple(noisy), noise_free=tuple(clean), designs=tuple(done), memory=memory)


def _recordings(
    session: Session, p: Plan, signals: Signals, index: int, started_s: float
) -> tuple[Recording, Recording]:
    """One recording with noise and converter, and without. `started_s` since the start of the session."""
    specimen, plain = session.truth.specimen, session.truth.plain
    started = _START + timedelta(microseconds=round(started_s * 1e6))
    span = _force_range(specimen, plain)
    noise_sd = {**_NOISE, "force": specimen.noise_share * span}
    names = list(_CHANNELS[p.test])
    if session.temperature or p.design["temperature"] or p.design["warmer_k"] is not None:
        names.append("temperature")
    if p.design.get("leakage_current"):
        names.append("leakage_current")
    start_ns = round(started.timestamp() * 1e9)
    time_ns = start_ns + np.round(np.arange(p.samples) * (signals.interval_s * 1e9)).astype(np.int64)
    recorded, true = {}, {}
    for name in names:
        values = np.ascontiguousarray(signals.values[name])
        true[name] = Channel(name, time_ns, values)
        rng = _stream(session.seed, 4, index, _ORDER.index(name))
        step = sensors.resolution(_CONVERTER_HEADROOM * (span if name == "force" else _SPAN[name]))
        noise = sensors.noise(values.size, noise_sd[name], specimen.pink_share, rng)
        recorded[name] = Channel(name, time_ns, sensors.quantised(values + noise, step), resolution=step)
    extra, held = float(p.design["extra_clamp_mass_kg"]), float(p.design["pre_extension_mm"])
    rig = RigConstants(
        rig_id="truth-rig",
        load_cell_range_n=span,
        noise_sd={
            name: float(np.hypot(noise_sd[name], (recorded[name].resolution or 0.0) / 12**0.5)) for name in names
        },
        **specimen.rig_file,
    )
    geometry = dict(specimen.geometry)
    if held:
        geometry["total_length_mm"] += held
        geometry["stretch_1"] = geometry["total_length_mm"] / geometry["film_length_mm"]
    metadata = RecordingMetadata(
        recording_id=f"{specimen.name}-{index:03d}-{p.test}",
        protocol=p.protocol,
        loading=p.loading,
        specimen_id=specimen.name,
        started_at=started,
        campaign="hidden-effects",
        material=specimen.kind,
        rig_id="truth-rig",
        rest_before_s=float(p.design["rest_before_s"]),
        extra_clamp_mass_kg=extra or None,
        **geometry,
        **p.metadata,
    )
    return (
        Recording(metadata=metadata, rig=rig, channels=recorded),
        Recording(metadata=metadata, rig=rig, channels=true),
    )


def _force_range(specimen: Specimen, plain: Loads) -> float:
    """Range of the load cell: the smallest usual one with room above the plain session."""
    largest = _HEADROOM * (preload(specimen, plain) + plain.reading)
    return next((span for span in _RANGES_N if span >= largest), largest)
