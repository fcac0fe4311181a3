"""Campaigns of the virtual rig: a plan becomes recordings, each with what is true behind it.

Pure: the same campaign gives the same recordings, in any order. The format of campaign files is described in `plan`;
files of recordings are written in `write`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from pipeline.physics.controllers import Controller
from pipeline.simulate.bench import Bench
from pipeline.simulate.effects import EFFECTS
from pipeline.simulate.lifetime import Life
from pipeline.simulate.plan import Campaign, Planned, load_campaign, packaged_campaigns, read_campaign
from pipeline.simulate.procedures.base import Clock
from pipeline.simulate.rigs import file_constants
from pipeline.simulate.self_sensing import ClosedLoop
from pipeline.simulate.sensors import random_stream
from schemas.errors import RefusedError, UsageError
from schemas.metadata import RecordingMetadata
from schemas.recording import Channel, Recording

__all__ = [
    "Campaign", "SimulatedRecording", "load_campaign", "packaged_campaigns", "read_campaign", "simulate", "simulate_one",
]  # fmt: skip


@dataclass(frozen=True)
class SimulatedRecording:
    """A recording as the laboratory gets it, and what is true behind it.

    `format` and `folder` say how it is kept, `units` in which units the rig writes channels that it does not write in
    the canonical one.
    """

    recording: Recording
    truth: Mapping[str, Any]
    format: str
    folder: str
    units: Mapping[str, str]

    @property
    def recording_id(self) -> str:
        return self.recording.metadata.recording_id


def simulate(campaign: Campaign, chosen: Sequence[Planned] | None = None) -> Iterator[SimulatedRecording]:
    """The recordings of a campaign, or some of them, in their order. Each has random streams of its own, so that order does not matter."""
    for planned in campaign.planned if chosen is None else chosen:
        yield simulate_one(campaign, planned)


def bench_for(campaign: Campaign, planned: Planned) -> Bench:
    """What is true in one test, hidden effects included."""
    bench = Bench(planned.procedure.film(planned.specimen), planned.rig.true.rig, planned.rig.true.amplifier)
    bench = bench.with_stage("sensor", planned.rig.spikes.stage())
    if planned.specimen is not None:
        for mechanism, values in planned.specimen.effects.items():
            rng = random_stream(campaign.seed, planned.recording_id, "effect", mechanism)
            where = f"specimens.{planned.specimen.name}.effects.{mechanism}"
            bench = EFFECTS[mechanism].apply(bench, values, where, rng)
    return bench


def simulate_one(campaign: Campaign, planned: Planned, controller: Controller | None = None) -> SimulatedRecording:
    """One recording of a campaign; a closed loop with another controller than the PI of its gains, where one is given."""
    procedure = planned.procedure
    bench = bench_for(campaign, planned)
    highest = max(s.sample_rate_hz for s in planned.sensors.values())
    factor = max(1, math.ceil(1 / (highest * procedure.finest_interval_s(bench)) - 1e-9))
    samples = math.floor(procedure.duration_s * highest + 1e-6)
    clock = Clock(1 / (highest * factor), samples * factor)
    rng = random_stream(campaign.seed, planned.recording_id, "test")
    factors = {q: factor * round(highest / s.sample_rate_hz) for q, s in planned.sensors.items()}
    finished = set()
    if isinstance(procedure, ClosedLoop):
        # The controller has sampled its own channels already.
        every = factors["capacitance"]
        signals = procedure.run_with(bench, clock, every, planned.sensors["capacitance"], rng, controller)
        finished = {"capacitance", "demand"}
    else:
        signals = procedure.run(bench, planned.specimen, clock, rng)
    start_ns = round(planned.started_at.timestamp()) * 1_000_000_000
    channels = {}
    for quantity, sensor in planned.sensors.items():
        if quantity in finished:
            values = signals[quantity][:: factors[quantity]]
        else:
            stream = random_stream(campaign.seed, planned.recording_id, "noise", quantity)
            values = sensor.digitise(signals[quantity], clock.interval_s, factors[quantity], stream)
        interval_ns = 1e9 / sensor.sample_rate_hz
        times = start_ns + np.rint(np.arange(values.size) * interval_ns).astype(np.int64)
        channels[quantity] = Channel(
            quantity,
            times,
            values,
            resolution=sensor.resolution,
            filter_hz=sensor.filter_hz or None,
            delay_s=sensor.delay_s or None,
            sensor=sensor.sensor,
        )
    units = {q: s.unit for q, s in planned.sensors.items() if s.unit is not None}
    recording = Recording(_metadata(campaign, planned), planned.rig.stated, channels)
    return SimulatedRecording(recording, tell_truth(campaign, planned), planned.format, planned.folder, units)


def _metadata(campaign: Campaign, planned: Planned) -> RecordingMetadata:
    subject = {"specimen_id": f"{planned.rig.name}-clamp", "rig_id": planned.rig.name}
    named = planned.label or planned.specimen
    if named is not None:
        subject = named.metadata()
    values = {
        **subject,
        "recording_id": planned.recording_id,
        "protocol": planned.procedure.protocol,
        "loading": planned.procedure.loading,
        "started_at": planned.started_at,
        "campaign": campaign.name,
        "notes": planned.notes or "simulated by the virtual rig",
        **planned.procedure.metadata(planned.specimen),
    }
    if campaign.operator is not None:
        values["operator"] = campaign.operator
    try:
        return RecordingMetadata.parse(values, where=planned.recording_id)
    except RefusedError as error:
        raise UsageError(error.problem, where=error.where, expected=error.expected) from None


def tell_truth(campaign: Campaign, planned: Planned) -> dict[str, Any]:
    """What is true behind a recording, plain values: rig, film, effects, life."""
    bench = bench_for(campaign, planned)
    film = bench.film
    known: dict[str, Any] = {
        "recording_id": planned.recording_id,
        "rig": file_constants(bench.rig),
        "amplifier": {k: v for k, v in asdict(bench.amplifier).items() if v != math.inf},
        "noise_sd": {q: s.noise_sd for q, s in planned.sensors.items()},
    }
    if planned.specimen is not None:
        specimen = planned.specimen
        known["specimen_id"] = specimen.name
        known["film"] = asdict(specimen.model)
        known["effects"] = {mechanism: dict(values) for mechanism, values in specimen.effects.items()}
        if film.active is not None:
            known["force_per_voltage_squared_n_per_kv2"] = film.force_per_voltage_squared
            known["parts"] = [asdict(part) for part in film.parts]
    if isinstance(planned.procedure, Life):
        life = planned.procedure
        failed = math.isfinite(life.life_s)
        known["lifetime_s"] = life.life_s if failed else life.group.test_duration_s
        known["failed"] = failed
    return known
