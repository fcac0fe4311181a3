"""Rigs of a campaign: what is true of them, what their file says, and their channels."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pipeline.physics.rig import TONNES_PER_KG, Rig
from pipeline.simulate.drive import Amplifier
from pipeline.simulate.self_sensing import SwitchingSpikes
from pipeline.simulate.sensors import Sensor
from pipeline.simulate.tables import known_only, number, parse, subtable
from schemas.errors import RefusedError, UsageError
from schemas.metadata import RigConstants
from schemas.quantities import QUANTITIES
from schemas.units import conversion

DEFAULT_CHANNELS: Mapping[str, Mapping[str, float]] = {
    "command": {"sample_rate_hz": 2000.0, "noise_sd": 5e-4, "low": -10.0, "high": 10.0},
    "voltage": {"sample_rate_hz": 2000.0, "noise_sd": 3e-3, "low": -16.384, "high": 16.384},
    "force": {"sample_rate_hz": 2000.0, "noise_sd": 1e-3},
    "displacement": {"sample_rate_hz": 2000.0, "noise_sd": 5e-4, "low": -4.0, "high": 4.0},
    "capacitance": {"sample_rate_hz": 100.0, "noise_sd": 2e-3, "low": 0.0, "high": 65.536},
    "demand": {"sample_rate_hz": 100.0, "noise_sd": 0.0, "low": 0.0, "high": 65.536},
    "force_1": {"sample_rate_hz": 100.0, "noise_sd": 1e-3, "low": -5.0, "high": 5.0},
    "force_2": {"sample_rate_hz": 100.0, "noise_sd": 1e-3, "low": -5.0, "high": 5.0},
    "leakage_current": {"sample_rate_hz": 100.0, "noise_sd": 0.05, "low": -1000.0, "high": 1000.0},
}
"""Channels where the campaign does not say otherwise, canonical units; the force's range is that of the load cell."""


@dataclass(frozen=True)
class TrueConstants:
    """Constants of a rig; the damping of the load cell by its value or by the damping ratio of the clamp alone."""

    clamp_mass_kg: float = number(above=0)
    load_cell_stiffness_n_per_mm: float = number(above=0)
    load_cell_damping_n_s_per_mm: float | None = number(None, at_least=0)
    damping_ratio: float | None = number(None, at_least=0)
    load_cell_range_n: float = number(2.0, above=0)
    amplifier_gain_kv_per_v: float = number(1.5, above=0)
    rise_time_constant_s: float = number(3e-4, at_least=0)
    fall_time_constant_s: float = number(3e-4, at_least=0)

    def __post_init__(self) -> None:
        if (self.load_cell_damping_n_s_per_mm is None) == (self.damping_ratio is None):
            raise ValueError("give one of load_cell_damping_n_s_per_mm and damping_ratio")

    @property
    def rig(self) -> Rig:
        damping = self.load_cell_damping_n_s_per_mm
        if damping is None:
            product = self.load_cell_stiffness_n_per_mm * self.clamp_mass_kg * TONNES_PER_KG
            damping = 2 * (self.damping_ratio or 0.0) * math.sqrt(product)
        return Rig(self.clamp_mass_kg * TONNES_PER_KG, self.load_cell_stiffness_n_per_mm, damping)

    @property
    def amplifier(self) -> Amplifier:
        return Amplifier(self.amplifier_gain_kv_per_v, self.rise_time_constant_s, self.fall_time_constant_s)


@dataclass(frozen=True)
class RigSetup:
    """A rig: true constants, the constants that its file states, and its sensors by quantity."""

    name: str
    true: TrueConstants
    stated: RigConstants
    sensors: Mapping[str, Sensor]
    spikes: SwitchingSpikes


def read_rig(name: str, table: Mapping[str, Any], noise: Mapping[str, Any], where: str) -> RigSetup:
    """A rig from its campaign table `[rigs.<name>]`.

    `file` holds the constants that the rig's file states where they differ from the true ones, and their `…_sd`;
    `channels.<quantity>` what differs from the default channels; `spikes` the interference in the capacitance.
    `noise` are the campaign's standard deviations by quantity.
    """
    own = {k: v for k, v in table.items() if k not in ("file", "channels", "spikes")}
    true = parse(TrueConstants, own, where)
    channels = subtable(table, "channels", where)
    known_only(channels, tuple(DEFAULT_CHANNELS), f"{where}.channels")
    sensors = {}
    for quantity, defaults in DEFAULT_CHANNELS.items():
        values: dict[str, Any] = dict(defaults)
        if quantity == "force":
            values |= {"low": -true.load_cell_range_n, "high": true.load_cell_range_n}
        if quantity in noise:
            values["noise_sd"] = noise[quantity]
        place = f"{where}.channels.{quantity}"
        sensor = parse(Sensor, values | dict(subtable(channels, quantity, f"{where}.channels")), place)
        if sensor.unit is not None:
            try:
                conversion(sensor.unit, QUANTITIES[quantity].unit)
            except RefusedError as error:
                raise UsageError(error.problem, where=place, expected=error.expected) from None
        sensors[quantity] = sensor
    spikes = parse(SwitchingSpikes, subtable(table, "spikes", where), f"{where}.spikes")
    return RigSetup(name, true, _stated(name, true, sensors, subtable(table, "file", where), where), sensors, spikes)


def file_constants(rig: Rig) -> dict[str, float]:
    """Constants of a rig by the keys of a rig file."""
    mass, stiffness, damping, _ = rig.numbers
    return {
        "clamp_mass_kg": mass / TONNES_PER_KG,
        "load_cell_stiffness_n_per_mm": stiffness,
        "load_cell_damping_n_s_per_mm": damping,
    }


def _stated(
    name: str, true: TrueConstants, sensors: Mapping[str, Sensor], file: Mapping[str, Any], where: str
) -> RigConstants:
    values: dict[str, Any] = {
        "rig_id": name,
        **file_constants(true.rig),
        "clamp_mass_kg": true.clamp_mass_kg,
        "load_cell_range_n": true.load_cell_range_n,
        "amplifier_gain_kv_per_v": true.amplifier_gain_kv_per_v,
    }
    values |= {f"{quantity}_noise_sd": s.noise_sd for quantity, s in sensors.items() if s.noise_sd}
    try:
        stated = RigConstants.parse({**values, **file}, where=f"{where}.file")
    except RefusedError as error:
        raise UsageError(error.problem, where=error.where, expected=error.expected) from None
    known_only(stated.extra, (), f"{where}.file")
    return stated
