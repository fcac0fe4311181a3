"""A specimen's session: its recordings in time order, the state that runs through them, and the noise of their features.

Exposure, the largest strain so far, time and temperature carry over from recording to recording; each block of features
belongs to one state. Belongs here: what does not depend on parameters. The simulation is in `predict`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.sparse
from numpy.typing import NDArray

from pipeline.diagnose.features.kinds import (
    AMPLIFIER,
    CHIRP_RESPONSE,
    CYCLIC_CAPACITANCE,
    CYCLIC_RESPONSE,
    EXTRA_MASS,
    SENSED,
    FeatureBlock,
    NoiseSample,
    RecordingFeatures,
)
from pipeline.diagnose.features.noise_density import NoiseLaw, noise_law
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.simulation.effects import Scale
from pipeline.diagnose.simulation.parameters import (
    ACTUATION,
    PER_DISPLACEMENT,
    PER_FORCE,
    BaseModel,
    Entry,
    film_entries,
    rig_entries,
)
from pipeline.physics.rig import RigPrior, rig_prior
from schemas.arrays import Bool, Float, Int
from schemas.errors import NotIdentifiableError
from schemas.metadata import RigConstants
from schemas.protocols import ELECTRICAL, MECHANICAL

_TIMES_BEYOND = 30.0
"""How far beyond both ends of what tests show the time of an arm is searched."""
_NAMES = {("step", MECHANICAL): "relaxation", ("chirp", ELECTRICAL): "electrical chirp"}
"""Tests by protocol and loading that have a name of their own."""
_LEAST_VARIANCE = 1e-10
"""Share of a block's mean variance that is added to its diagonal: functionals may be nearly dependent."""


@dataclass(frozen=True)
class Place:
    """Where a block is in a session: number of its recording, first and last place of its values, its state."""

    recording: int
    block: FeatureBlock
    first: int
    stop: int
    state: int


@dataclass(frozen=True)
class States:
    """One row per state (S,); meanings as in `effects.View`."""

    recording: Int
    rig: Int
    cycle: Float
    recording_s: Float
    session_s: Float
    strain: Float
    strain_before: Float
    largest_strain: Float
    voltage_kv: Float
    exposure_kv2_s: Float
    exposure_start_kv2_s: Float
    temperature_k: Float
    first_temperature_s: Float
    rest_force_n: Float
    cycles_before: Float
    path_before: Float

    @property
    def size(self) -> int:
        return self.recording.size


@dataclass(frozen=True)
class Session:
    """Recordings of one specimen in time order.

    Parameters
    ----------
    recordings : (R,) features
    rigs : constants of the rigs in use; `rig` (R,) is the number of each recording's rig
    loaded : for each rig the first one that has the same constants, itself or an earlier one, and the known mass on its clamp, N s²/mm
    start_s : (R,) start of each recording since that of the first
    places : blocks with their places in the vector of all features
    states : the state of the film, rig and electrodes at each block
    value : (N,) all features
    scale : what the whole session has
    laws : noise law by rig and quantity
    unasked : what is left out because its noise is not known, a sentence each
    """

    specimen_id: str
    recordings: tuple[RecordingFeatures, ...]
    rigs: tuple[RigConstants, ...]
    rig: Int
    start_s: Float
    places: tuple[Place, ...]
    states: States
    value: Float
    scale: Scale
    laws: dict[tuple[int, str], NoiseLaw]
    loaded: tuple[tuple[int, float], ...]
    unasked: tuple[str, ...] = ()

    @property
    def size(self) -> int:
        return self.value.size

    @cached_property
    def recording_of(self) -> Int:
        """(N,) number of the recording of each value."""
        return np.concatenate([np.full(p.stop - p.first, p.recording) for p in self.places])

    @cached_property
    def kind(self) -> NDArray[np.str_]:
        """(N,) kind of each value."""
        return np.concatenate([np.full(p.stop - p.first, p.block.kind) for p in self.places])

    @cached_property
    def kinds(self) -> frozenset[str]:
        return frozenset(p.block.kind for p in self.places)

    @cached_property
    def protocols(self) -> tuple[str, ...]:
        """Protocols present, named as by `name_test`, in the order of the session."""
        return tuple(dict.fromkeys(name_test(r) for r in self.recordings))

    def covariate(self, name: str) -> Float:
        """(N,) frequency_hz, amplitude, voltage_kv, cycle or time_s of each value, `session_s` and `temperature_k` too."""
        if name == "session_s":
            return np.concatenate([p.block.time_s + self.start_s[p.recording] for p in self.places])
        if name == "temperature_k":
            return np.concatenate([np.full(p.block.size, self.states.temperature_k[p.state]) for p in self.places])
        return np.concatenate([getattr(p.block, name) for p in self.places])

    def covariance(self, number: int) -> Float:
        """(n, n) noise covariance of block `number`."""
        place = self.places[number]
        total: Float | float = 0.0
        for name, basis in zip(place.block.components, place.block.basis, strict=True):
            quantity, exponent = name.split("/")
            total = total + self._coefficient(place.recording, quantity, int(exponent)) * basis
        full = np.diag(total) if np.ndim(total) == 1 else np.asarray(total)
        return np.asarray(full + _LEAST_VARIANCE * np.mean(np.diag(full)) * np.eye(full.shape[0]))

    def doubt_noise(self, number: int) -> Float:
        """(n,) relative standard deviation of the noise variance of block `number`: what the rests leave open of coloured noise."""
        place = self.places[number]
        doubted, total = np.zeros(place.block.size), np.zeros(place.block.size)
        for name, basis in zip(place.block.components, place.block.basis, strict=True):
            quantity, exponent = name.split("/")
            law = self.laws.get((int(self.rig[place.recording]), quantity))
            own = self._coefficient(place.recording, quantity, int(exponent)) * (
                basis if basis.ndim == 1 else np.diag(basis)
            )
            total += own
            doubted += 0.0 if law is None else (own * law.doubt(int(exponent))) ** 2
        return np.asarray(np.sqrt(doubted) / np.maximum(total, np.finfo(float).tiny))

    def _coefficient(self, recording: int, quantity: str, exponent: int) -> float:
        if quantity == "unit":
            return 1.0
        law = self.laws.get((int(self.rig[recording]), quantity))
        return 0.0 if law is None else law.coefficient(recording, exponent)

    @cached_property
    def _whitening(self) -> scipy.sparse.csr_array:
        """(N, N) inverse Cholesky factors of the blocks, one below the other."""
        rows, columns, data = [], [], []
        for i, place in enumerate(self.places):
            full = self.covariance(i)
            if place.block.basis.ndim == 2:
                inverse = 1 / np.sqrt(np.diag(full))
                row = column = np.arange(inverse.size)
            else:
                inverse = np.linalg.inv(np.linalg.cholesky(full))
                row, column = np.tril_indices(inverse.shape[0])
                inverse = inverse[row, column]
            rows.append(row + place.first)
            columns.append(column + place.first)
            data.append(inverse)
        places = np.concatenate(rows), np.concatenate(columns)
        return scipy.sparse.csr_array((np.concatenate(data), places), shape=(self.size, self.size))

    @cached_property
    def sd(self) -> Float:
        """(N,) standard deviation of each value."""
        return np.concatenate([np.sqrt(np.diag(self.covariance(i))) for i in range(len(self.places))])

    def whiten(self, values: Float) -> Float:
        """(N,) or (N, m) residuals with unit covariance."""
        return np.asarray(self._whitening @ values)

    def part(self, blocks: Sequence[bool] | Bool) -> Session:
        """The session with some of its blocks only (one flag per block); states and noise laws stay those of the whole."""
        places, values, at = [], [], 0
        for keep, place in zip(blocks, self.places, strict=True):
            if keep:
                places.append(replace(place, first=at, stop=at + place.block.size))
                values.append(place.block.value)
                at += place.block.size
        if not places:
            raise NotIdentifiableError("no block of features is left", where=self.specimen_id)
        return replace(self, places=tuple(places), value=np.concatenate(values))

    def base_model(self, arms: int, *, dashpot: bool = False) -> BaseModel:
        """The plain model with that many arms, with the entries of θ that these recordings depend on."""
        own = [of == number for number, (of, _) in enumerate(self.loaded)]
        priors = tuple(prior if alone else None for prior, alone in zip(self.priors, own, strict=True))
        entries = film_entries(arms, dashpot, self.times_s)
        for number, prior in enumerate(priors):
            entries += rig_entries(number, prior)
        electrical = [r for r in self.recordings if r.loading == "electrical"]
        if electrical:
            known = [r for r in electrical if "actuation_n_per_kv2" in r.values]
            if known:
                values = known[0].values
                mean, layers = float(np.log(values["actuation_n_per_kv2"])), values.get("layers", 1.0)
                # A thickness is that of all layers together; many a laboratory writes that of one.
                also = mean - float(np.log(layers)) if layers > 1 else None
                entries.append(Entry(ACTUATION, mean, max(values["actuation_sd"], 1e-6), also=also))
            else:
                entries.append(Entry(ACTUATION, float(np.log(1e-3))))
        for number, rig in enumerate(self.rigs):
            if any(p.block.kind in AMPLIFIER and self.rig[p.recording] == number for p in self.places):
                entries.append(_amplifier_entry(f"log amplifier {number}", rig))
        if self.kinds & SENSED:
            entries.append(Entry(PER_FORCE, low=-np.inf, high=np.inf))
        if CYCLIC_CAPACITANCE in self.kinds:
            entries.append(Entry(PER_DISPLACEMENT, low=-np.inf, high=np.inf))
        return BaseModel(arms, dashpot, tuple(entries), priors, self.loaded)

    @cached_property
    def priors(self) -> tuple[RigPrior | None, ...]:
        """What is known of each rig beforehand; None where nothing is."""
        return tuple(rig_prior(rig) for rig in self.rigs)

    @cached_property
    def times_s(self) -> tuple[float, float]:
        """Shortest and longest relaxation time that these recordings can show."""
        frequency = self.covariate("frequency_hz")
        known = frequency[np.isfinite(frequency) & (frequency > 0)]
        longest = max(r.duration_s for r in self.recordings)
        high = float(known.max()) if known.size else 10.0
        low = min(float(known.min()) if known.size else 1.0, 1 / longest)
        return 1 / (2 * np.pi * high * _TIMES_BEYOND), _TIMES_BEYOND / (2 * np.pi * low)


def name_test(recording: RecordingFeatures) -> str:
    """The protocol of a recording; a mechanical step is `relaxation`, a sweep of the voltage `electrical chirp`."""
    return _NAMES.get((recording.protocol, recording.loading), recording.protocol)


def make_session(
    recordings: Sequence[RecordingFeatures], laws: Mapping[tuple[int, str], NoiseLaw] | None = None
) -> Session:
    """A session of one specimen's recordings, in the order of their start whatever the order given.

    `laws` of the noise are found in the recordings where they are not given.
    Raises `NotIdentifiableError` without recordings and for recordings of several specimens.
    """
    ordered = sorted(recordings, key=lambda r: (r.started_at, r.recording_id))
    if not ordered:
        raise NotIdentifiableError("a specimen without recordings that can be simulated")
    specimens = sorted({r.specimen_id for r in ordered})
    if len(specimens) > 1:
        raise NotIdentifiableError(f"recordings of {', '.join(specimens)}", expected="one specimen")
    rigs: list[RigConstants] = []
    loaded: list[tuple[int, float]] = []
    number = []
    for r in ordered:
        same = next((i for i, rig in enumerate(rigs) if _mechanics(rig) == _mechanics(r.rig)), len(rigs))
        clamp = same, r.values.get(EXTRA_MASS, 0.0)
        if clamp not in loaded:
            rigs.append(r.rig)
            loaded.append(clamp)
        number.append(loaded.index(clamp))
    laws = _laws(ordered, number) if laws is None else dict(laws)
    ordered, unasked = _leave_out_unknown_noise(ordered, number, laws)
    if not any(r.blocks for r in ordered):
        raise NotIdentifiableError(
            " ".join(
                ["no recording has features that could be simulated", *(f"({one.rstrip('.')})" for one in unasked)]
            ),
            where=specimens[0],
            expected="a chirp, an sphs, steps, cycles or relaxation, with a rest that shows the noise",
        )
    start = np.array([(r.started_at - ordered[0].started_at).total_seconds() for r in ordered])
    cycles = [_count_cycles(r) for r in ordered]
    states, places = _states(ordered, number, start, cycles)
    total = Scale(
        strain=max((r.values.get("largest_strain", 0.0) for r in ordered), default=0.0),
        voltage_kv=max((r.values.get("largest_voltage_kv", 0.0) for r in ordered), default=0.0),
        exposure_kv2_s=sum(r.values.get("exposure_kv2_s", 0.0) for r in ordered),
        duration_s=float(start[-1] + ordered[-1].duration_s),
        cycles=sum(cycles),
        path=sum(n * r.values.get("largest_strain", 0.0) for n, r in zip(cycles, ordered, strict=True)),
        length_mm=next((r.values["strain_length_mm"] for r in ordered if "strain_length_mm" in r.values), 1.0),
        force_rate_n_per_s=max((_measure_force_rate(r) for r in ordered), default=0.0),
    )
    return Session(
        specimen_id=specimens[0],
        recordings=tuple(ordered),
        rigs=tuple(rigs),
        rig=np.array(number),
        start_s=start,
        places=tuple(places),
        states=states,
        value=np.concatenate([p.block.value for p in places]),
        scale=total,
        laws=laws,
        loaded=tuple(loaded),
        unasked=unasked,
    )


def _amplifier_entry(name: str, rig: RigConstants) -> Entry:
    """Logarithm of the amplifier's gain in kV/V: as the rig's file has it, or anything where it says nothing."""
    gain = rig.amplifier_gain_kv_per_v
    if gain is None:
        return Entry(name, 0.0)
    return Entry(
        name, float(np.log(gain)), (rig.amplifier_gain_kv_per_v_sd or RULES.features.amplifier_sd * gain) / gain
    )


def _mechanics(rig: RigConstants) -> RigConstants:
    """What makes two rigs one: everything but ranges and noise, which change with the settings of a recording."""
    return replace(rig, load_cell_range_n=None, load_cell_range_n_sd=None, noise_sd={}, extra={})


def follow_sweep(block: FeatureBlock) -> Float:
    """(n,) mechanical cycles since the start of a sweep at each line of its response: the integral of its frequency over time."""
    n = block.size // 2
    f, time = block.support["profile_hz"], block.time_s[:n]
    order = np.argsort(time)
    passed = np.empty(n)
    steps = np.diff(time[order]) * (f[order][1:] + f[order][:-1]) / 2
    passed[order] = np.concatenate([[0.0], np.cumsum(steps)])
    return passed


def _measure_force_rate(recording: RecordingFeatures) -> float:
    """Largest rate of the force that a recording's driven sinusoids have, N/s: amplitude times angular frequency."""
    found = 0.0
    for block in recording.blocks:
        n = block.size // 2
        f = block.frequency_hz[:n]
        if block.kind == CHIRP_RESPONSE:
            at, mm = block.support["profile_hz"], block.support["profile_mm"]
            rising = np.argsort(at)
            travel = np.interp(f, at[rising], mm[rising])
        elif block.kind == CYCLIC_RESPONSE:
            travel = block.amplitude[:n] * recording.values.get("strain_length_mm", 1.0)
        else:
            continue
        force = np.hypot(block.value[:n], block.value[n:]) * travel
        found = max(found, float(np.max(2 * np.pi * f * force, initial=0.0)))
    return found


def _count_cycles(recording: RecordingFeatures) -> float:
    """Mechanical cycles of a recording: of its sweeps by their frequency over time, of others as they are numbered."""
    if recording.loading != MECHANICAL:
        return 0.0
    total = 0.0
    for block in recording.blocks:
        if block.kind == CHIRP_RESPONSE:
            total += float(follow_sweep(block).max())
    if total:
        return total
    numbers = [float(np.nanmax(b.cycle)) for b in recording.blocks if np.isfinite(b.cycle).any()]
    return max(numbers, default=1.0)


def _states(
    ordered: Sequence[RecordingFeatures], rigs: Sequence[int], start: Float, cycles: Sequence[float]
) -> tuple[States, list[Place]]:
    """States of all blocks and the blocks' places. Blocks of one recording and one cycle share their state."""
    rows: list[dict[str, float]] = []
    places: list[Place] = []
    largest, exposed, at = 0.0, 0.0, 0
    passed, path = 0.0, 0.0
    first_temperature, since = next(
        ((r.values["temperature_degc"], start[i]) for i, r in enumerate(ordered) if "temperature_degc" in r.values),
        (np.nan, np.nan),
    )
    for i, r in enumerate(ordered):
        own = r.values.get("largest_strain", 0.0)
        known: dict[tuple[float, float], int] = {}
        for block in r.blocks:
            cycle = float(np.nanmean(block.cycle)) if np.isfinite(block.cycle).any() else 1.0
            voltage = float(np.nanmax(block.voltage_kv)) if np.isfinite(block.voltage_kv).any() else 0.0
            key = cycle, voltage
            if key not in known:
                time = float(np.nanmean(block.time_s)) if np.isfinite(block.time_s).any() else r.duration_s / 2
                known[key] = len(rows)
                rows.append(
                    {
                        "recording": i,
                        "rig": rigs[i],
                        "cycle": cycle,
                        "recording_s": time,
                        "session_s": start[i] + time,
                        "strain": own,
                        "strain_before": largest,
                        "largest_strain": max(largest, own),
                        "voltage_kv": voltage,
                        "exposure_kv2_s": exposed
                        + r.values.get("exposure_kv2_s", 0.0) * min(time / max(r.duration_s, 1e-9), 1.0),
                        "exposure_start_kv2_s": exposed,
                        "temperature_k": r.values.get("temperature_degc", np.nan) - first_temperature,
                        "first_temperature_s": since,
                        "rest_force_n": r.values.get("rest_force_n", np.nan),
                        "cycles_before": passed,
                        "path_before": path,
                    }
                )
            places.append(Place(i, block, at, at + block.size, known[key]))
            at += block.size
        passed, path = passed + cycles[i], path + cycles[i] * own
        largest = max(largest, own)
        exposed += r.values.get("exposure_kv2_s", 0.0)
    columns = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    columns["recording"], columns["rig"] = columns["recording"].astype(np.int64), columns["rig"].astype(np.int64)
    return States(**columns), places


def _leave_out_unknown_noise(
    ordered: Sequence[RecordingFeatures], rigs: Sequence[int], laws: Mapping[tuple[int, str], NoiseLaw]
) -> tuple[list[RecordingFeatures], tuple[str, ...]]:
    """The recordings without blocks of whose output no noise is known, and what is left out: where no recording of a rig shows the noise of a
    channel, any misfit of it would be without bound."""
    kept, unasked = [], []
    for r, rig in zip(ordered, rigs, strict=True):
        # The first part of a block's noise is that of its output; without that of its input it is still bounded.
        outputs = [block.quantities[0] for block in r.blocks]
        known = [q == "unit" or (rig, q) in laws for q in outputs]
        kept.append(replace(r, blocks=tuple(b for b, is_known in zip(r.blocks, known, strict=True) if is_known)))
        left_out = [b for b, is_known in zip(r.blocks, known, strict=True) if not is_known]
        lacking = sorted({q for b in left_out for q in b.quantities if (rig, q) not in laws})
        if lacking:
            unasked.append(
                f"{r.recording_id}: no recording on its rig shows the noise of {' and '.join(lacking)}; what they say is left out. "
                "An output that stands still where its input rests shows none: export it as it was measured."
            )
    return kept, tuple(unasked)


def _laws(ordered: Sequence[RecordingFeatures], rigs: Sequence[int]) -> dict[tuple[int, str], NoiseLaw]:
    samples: dict[tuple[int, str], list[tuple[int, NoiseSample]]] = {}
    for i, r in enumerate(ordered):
        for sample in r.noise:
            samples.setdefault((rigs[i], sample.quantity), []).append((i, sample))
    return {key: noise_law(tuple(found), len(ordered)) for key, found in samples.items()}
