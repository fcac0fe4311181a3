"""Metadata of a recording and constants of a rig: typed, checked, unknown keys kept.

All values arrive as text (MCAP metadata) or as TOML values; `RecordingMetadata.parse` and `RigConstants.parse` turn
them into numbers, times and choices once. A key that is missing or malformed raises `RefusedError` that names the key,
the value and what was expected. A key that is not in the contract goes to `extra` unchanged.
"""

from __future__ import annotations

import dataclasses
import difflib
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from typing import Any, Self, cast

from schemas.alike import find_alike
from schemas.errors import RefusedError
from schemas.protocols import LOADINGS, PROTOCOL_NAMES, Protocol, protocol
from schemas.quantities import QUANTITIES

RECORDING_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,79}")
OWN_KEY = "x_"
"""Keys that begin so are the laboratory's own: nobody asks whether they are misspelt."""
_ALIKE = 0.84
"""Likeness (`difflib`) from which a key is asked about: a letter more, less or swapped in 12, or a missing unit."""
_LIMIT = 10_000
"""Longest text that a key may hold, in characters."""


def _text(value: Any) -> str:
    text = str(value)
    if len(text) > _LIMIT:
        raise ValueError(f"at most {_LIMIT} characters, it has {len(text)}")
    if "\x00" in text or (not text.isascii() and any("\ud800" <= c <= "\udfff" for c in text)):
        raise ValueError("text without NUL characters and half characters")
    return text


def _identifier(value: Any) -> str:
    text = _text(value)
    if not RECORDING_ID.fullmatch(text):
        raise ValueError("1 to 80 of A-Z a-z 0-9 . _ -, the first a letter or digit")
    return text


def _name(value: Any) -> str:
    text = _text(value).strip()
    if not text:
        raise ValueError("a name that is not empty")
    return text


def _label(value: Any) -> str:
    """A name that things are grouped by: blanks around it do not make it another."""
    return _text(value).strip()


def _number(value: Any) -> float:
    if isinstance(value, bool):
        raise ValueError("a number")
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        raise ValueError("a number with a decimal point") from None
    if not math.isfinite(number):
        raise ValueError("a finite number")
    return number


def _positive(value: Any) -> float:
    number = _number(value)
    if number <= 0:
        raise ValueError("a number above 0")
    return number


def _not_negative(value: Any) -> float:
    number = _number(value)
    if number < 0:
        raise ValueError("a number not below 0")
    return number


def _temperature(value: Any) -> float:
    number = _number(value)
    if number <= -273.15:
        raise ValueError("a temperature above −273.15 °C")
    return number


def _count(value: Any) -> int:
    number = _number(value)
    if number < 1 or number != int(number):
        raise ValueError("a whole number of at least 1")
    return int(number)


def _masses(value: Any) -> tuple[float, ...]:
    """Masses of which some are not 0: a level without any is often written as a mass of 0."""
    parts = value if isinstance(value, list | tuple) else str(value).split(",")
    masses = tuple(_not_negative(part) for part in parts if str(part).strip())
    if not any(masses):
        raise ValueError("masses of which one at least is above 0")
    return masses


def instant(value: Any) -> datetime:
    """A UTC time from ISO 8601 text (or a TOML time) with zone; `ValueError` without one."""
    time = value if isinstance(value, datetime) else _parsed_time(str(value))
    if time.tzinfo is None:
        raise ValueError("an ISO 8601 time with zone, such as 2026-03-01T14:05:00+01:00")
    return time.astimezone(UTC)


def _parsed_time(text: str) -> datetime:
    try:
        return datetime.fromisoformat(text.strip())
    except ValueError:
        raise ValueError("an ISO 8601 time with zone, such as 2026-03-01T14:05:00+01:00") from None


def _share(value: Any) -> float:
    """From 0 to 1; a number above 1 is percent."""
    number = _number(value)
    share = number / 100 if number > 1 else number
    if not 0 <= share <= 1:
        raise ValueError("a number from 0 to 1, or percent up to 100")
    return share


def _choice(*allowed: str) -> Callable[[Any], str]:
    def check(value: Any) -> str:
        text = _text(value).strip()
        if text not in allowed:
            alike = find_alike(text, allowed)
            raise ValueError("one of " + ", ".join(allowed) + (f" (did you mean {alike}?)" if alike else ""))
        return text

    return check


def _key(parser: Callable[[Any], Any], meaning: str = "", *, required: bool = False) -> Any:
    about = {"parser": parser, "meaning": meaning}
    return field(metadata=about) if required else field(default=None, metadata=about)


@dataclass(frozen=True, kw_only=True)
class RecordingMetadata:
    """Keys of a recording, contract section 2. Lengths in mm, times in s, frequencies in Hz, voltages in kV."""

    recording_id: str = _key(
        _identifier,
        "identity of the recording: 1 to 80 of `A-Z a-z 0-9 . _ -`, the first a letter or digit",
        required=True,
    )
    protocol: str = _key(_text, "kind of test", required=True)
    loading: str = _key(_choice(*LOADINGS), "what is loaded", required=True)
    specimen_id: str = _key(_name, "the specimen", required=True)
    started_at: datetime = _key(instant, "start of the test, ISO 8601 with time zone", required=True)
    campaign: str | None = _key(_label, "the campaign it belongs to")
    material: str | None = _key(_label, "the film's material")
    configuration: str | None = _key(_label, "how the specimen is built: the group it is compared in")
    rig_id: str | None = _key(_label, "the rig; names the file of its constants")
    operator: str | None = _key(_text, "who measured")
    notes: str | None = _key(_text, "anything worth knowing")
    film_length_mm: float | None = _key(_positive, "length of the undeformed film")
    film_width_mm: float | None = _key(_positive, "width of the undeformed film")
    film_thickness_mm: float | None = _key(_positive, "thickness of the undeformed film, all layers together")
    stretch_1: float | None = _key(_positive, "pre-stretch along the force")
    stretch_2: float | None = _key(_positive, "pre-stretch across it; absent: uniaxial, 1/√stretch_1")
    layers: int | None = _key(_count, "layers of film with electrodes in between")
    active_length_mm: float | None = _key(_positive, "length of the electrode")
    active_width_mm: float | None = _key(_positive, "width of the electrode")
    active_drawn: str | None = _key(
        _choice("undeformed", "stretched"), "state of the film in which the electrode was drawn and its size taken"
    )
    sensing_length_mm: float | None = _key(_positive, "length of the sensing electrode")
    sensing_width_mm: float | None = _key(_positive, "width of the sensing electrode")
    sensing_region: str | None = _key(
        _choice("separate", "active"), "whether the capacitance is that of an electrode of its own or of the active one"
    )
    total_length_mm: float | None = _key(_positive, "stretched length between the clamps")
    constrained_length_mm: float | None = _key(_not_negative, "stretched length that is held rigid and takes no part")
    relative_permittivity: float | None = _key(_positive, "relative permittivity of the film as known beforehand")
    relative_permittivity_sd: float | None = _key(_not_negative, "its standard deviation; absent: 10 %")
    crosslink_modulus_kpa: float | None = _key(_not_negative, "equilibrium law of large cycles: crosslinks")
    entanglement_modulus_kpa: float | None = _key(_not_negative, "equilibrium law of large cycles: entanglements")
    largest_stretch: float | None = _key(
        _positive, "equilibrium law of large cycles: stretch at which the chains are at their end"
    )
    frequency_start_hz: float | None = _key(
        _not_negative, "first frequency of a sweep or sequence; a linear sweep may begin at 0"
    )
    frequency_stop_hz: float | None = _key(_not_negative, "last frequency of a sweep or sequence")
    sweep: str | None = _key(_choice("linear", "log"), "how the frequency of a sweep runs")
    repeats: int | None = _key(_count, "sweeps in the record")
    period_s: float | None = _key(_positive, "from the start of one repeat to the start of the next, rest included")
    periods: int | None = _key(_count, "periods of a sequence")
    lines: str | None = _key(_choice("full", "odd", "random_odd"), "harmonics that a sequence excites")
    frequency_hz: float | None = _key(_positive, "frequency of a sinusoid")
    cycles: int | None = _key(_count, "cycles of a sinusoid")
    strain_pp: float | None = _key(_positive, "strain of the stretched length, peak to peak: 0.10 is 10 %")
    drive_kv: float | None = _key(_not_negative, "peak voltage")
    on_s: float | None = _key(_positive, "time at voltage in each step")
    off_s: float | None = _key(_not_negative, "time without voltage in each step")
    controller: str | None = _key(
        _choice("open", "closed"), "whether the steps are those of the voltage or of a closed loop"
    )
    proportional_gain: float | None = _key(_number, "proportional gain of the loop")
    integral_gain: float | None = _key(_number, "integral gain of the loop")
    masses_kg: tuple[float, ...] | None = _key(
        _masses, "masses of a weight calibration in the order they were hung, comma-separated"
    )
    extra_clamp_mass_kg: float | None = _key(_not_negative, "mass on the clamp beside its own in this recording")
    load_n: float | None = _key(
        _positive, "load of a creep test; of an isotonic one the constant load, where no force channel shows it"
    )
    voltage_setpoint_kv: float | None = _key(_positive, "set point of a lifetime test")
    test_duration_s: float | None = _key(_positive, "planned end of a lifetime test")
    failure_site: str | None = _key(
        _choice("rod", "lead", "active", "edge", "none", "unknown"), "where the film failed"
    )
    failure_region: str | None = _key(
        _choice("left", "centre", "right"), "third of the film, along the rods, in which it failed"
    )
    rest_before_s: float | None = _key(_not_negative, "how long the film had rested; absent: as long as it takes")
    rods: int | None = _key(_count, "rods that hold the width of the film")
    rod_spacing_mm: float | None = _key(_positive, "distance of the axes of neighbouring rods, in the stretched film")
    rod_diameter_mm: float | None = _key(_positive, "diameter of a rod")
    electrode_gap_mm: float | None = _key(
        _not_negative,
        "distance that separate electrodes keep from the axes of the rods; absent: one electrode over all of the film",
    )
    coats: int | None = _key(_count, "coats of electrode so far")
    temperature_c: float | None = _key(
        _temperature, "temperature of the test, or of a table's rows, °C, where no column says it"
    )
    humidity: float | None = _key(_share, "relative humidity of the test: 0 to 1, or percent above 1")
    electrode: str | None = _key(_label, "material of the electrode")
    batch: str | None = _key(_label, "batch of film, or of specimens")
    reference_temperature_c: float | None = _key(
        _temperature, "where a master curve of several temperatures stands, °C; absent: at the one nearest to 23 °C"
    )
    vertical_shift: str | None = _key(
        _choice("none", "free"), "whether the temperatures of a master curve have vertical shifts as well; absent: none"
    )
    extra: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def parse(cls, raw: Mapping[str, Any], *, where: str = "") -> Self:
        """Metadata from text or TOML values. Raises `RefusedError` for what is missing or malformed."""
        metadata = cls(**_parsed(cls, raw, where))
        metadata.definition(where=where)
        _check_sweep(metadata, where)
        return metadata

    def definition(self, *, where: str = "") -> Protocol:
        """The protocol of this recording."""
        return protocol(self.protocol, self.loading, where=where)

    def to_text(self) -> dict[str, str]:
        """The keys as MCAP metadata has them: text, absent keys left out; `parse` reads it back."""
        return _as_text(self)

    @property
    def pre_stretch(self) -> float | None:
        """`stretch_1`; a film whose undeformed sizes are given without it is mounted as it is: 1. None where neither is given."""
        if self.stretch_1 is not None:
            return self.stretch_1
        sizes = (self.film_length_mm, self.film_width_mm, self.film_thickness_mm)
        return None if all(size is None for size in sizes) else 1.0

    @property
    def stretched_length_mm(self) -> float | None:
        """Length of the film between the clamps at its pre-stretch in mm, None where the metadata do not say."""
        if self.total_length_mm is not None:
            return self.total_length_mm
        if self.film_length_mm is None or self.pre_stretch is None:
            return None
        return self.film_length_mm * self.pre_stretch

    @property
    def driven_travel_mm(self) -> float | None:
        """Travel of the clamp that `strain_pp` and the length promise in mm, None where the metadata do not say."""
        length = self.stretched_length_mm
        return None if self.strain_pp is None or length is None else self.strain_pp * length

    @property
    def lateral_stretch(self) -> float | None:
        """`stretch_2`; where absent the film is uniaxial: 1/√pre_stretch."""
        if self.stretch_2 is not None:
            return self.stretch_2
        return None if self.pre_stretch is None else 1 / math.sqrt(self.pre_stretch)

    @property
    def undeformed_section_mm2(self) -> float | None:
        """Cross-section of the whole film in mm²: `film_thickness_mm` is that of all layers together."""
        if self.film_width_mm is None or self.film_thickness_mm is None:
            return None
        return self.film_width_mm * self.film_thickness_mm

    @property
    def layer_thickness_mm(self) -> float | None:
        """Undeformed thickness of one layer in mm: what the voltage lies across where a stack has electrodes in between."""
        return None if self.film_thickness_mm is None else self.film_thickness_mm / (self.layers or 1)


@dataclass(frozen=True, kw_only=True)
class TableMetadata:
    """Keys of a table that stands instead of recordings (lifetimes, frequency response): those that fit a table.

    The same names, units and checks as `RecordingMetadata`; only `recording_id`, the table's own name, is required.
    """

    recording_id: str = _key(_identifier, required=True)
    protocol: str | None = _key(_choice(*PROTOCOL_NAMES))
    loading: str | None = _key(_choice(*LOADINGS))
    specimen_id: str | None = _key(_name)
    started_at: datetime | None = _key(instant)
    campaign: str | None = _key(_label)
    material: str | None = _key(_label)
    configuration: str | None = _key(_label)
    rig_id: str | None = _key(_label)
    operator: str | None = _key(_text)
    notes: str | None = _key(_text)
    film_length_mm: float | None = _key(_positive)
    film_width_mm: float | None = _key(_positive)
    film_thickness_mm: float | None = _key(_positive)
    stretch_1: float | None = _key(_positive)
    stretch_2: float | None = _key(_positive)
    layers: int | None = _key(_count)
    strain_pp: float | None = _key(_positive)
    voltage_setpoint_kv: float | None = _key(_positive)
    test_duration_s: float | None = _key(_positive)
    failure_site: str | None = _key(_choice("rod", "lead", "active", "edge", "none", "unknown"))
    failure_region: str | None = _key(_choice("left", "centre", "right"))
    temperature_c: float | None = _key(_temperature)
    humidity: float | None = _key(_share)
    electrode: str | None = _key(_label)
    batch: str | None = _key(_label)
    reference_temperature_c: float | None = _key(_temperature)
    vertical_shift: str | None = _key(_choice("none", "free"))
    extra: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def parse(cls, raw: Mapping[str, Any], *, where: str = "") -> Self:
        """Metadata from TOML values. Raises `RefusedError` for what is missing or malformed."""
        return cls(**_parsed(cls, raw, where))

    def to_text(self) -> dict[str, str]:
        """The keys as text, absent keys left out; `parse` reads it back."""
        return _as_text(self)


@dataclass(frozen=True, kw_only=True)
class RigConstants:
    """Constants of a rig with their standard deviations; None where the file does not say.

    Units: kg, N/mm, N s/mm, N, kV/V, Hz. `clamp_frequency_hz` is the measured frequency of the clamp without film: it ties
    mass and stiffness together far closer than each is known. `force_gain` is recorded force over true force, 1 where it
    was never calibrated. `noise_sd` is the standard deviation of one raw sample by quantity, canonical units.
    """

    rig_id: str | None = _key(_label, "the rig, as its file is named")
    clamp_mass_kg: float | None = _key(_not_negative, "mass that moves with the clamp at the load cell")
    clamp_mass_kg_sd: float | None = _key(_not_negative)
    load_cell_stiffness_n_per_mm: float | None = _key(_positive, "stiffness of the load cell")
    load_cell_stiffness_n_per_mm_sd: float | None = _key(_not_negative)
    load_cell_damping_n_s_per_mm: float | None = _key(_not_negative, "damping of the load cell")
    load_cell_damping_n_s_per_mm_sd: float | None = _key(_not_negative)
    load_cell_range_n: float | None = _key(_positive, "largest force it can read")
    load_cell_range_n_sd: float | None = _key(_not_negative)
    amplifier_gain_kv_per_v: float | None = _key(_positive, "output voltage over command")
    amplifier_gain_kv_per_v_sd: float | None = _key(_not_negative)
    amplifier_rise_time_constant_s: float | None = _key(
        _positive, "time constant with which the output follows a command that rises"
    )
    amplifier_rise_time_constant_s_sd: float | None = _key(_not_negative)
    amplifier_fall_time_constant_s: float | None = _key(_positive, "the same of one that falls")
    amplifier_fall_time_constant_s_sd: float | None = _key(_not_negative)
    amplifier_slew_kv_per_s: float | None = _key(_positive, "largest rate of the output")
    amplifier_slew_kv_per_s_sd: float | None = _key(_not_negative)
    clamp_frequency_hz: float | None = _key(_positive, "measured frequency of the clamp without film")
    clamp_frequency_hz_sd: float | None = _key(_not_negative)
    force_gain: float | None = _key(_positive, "recorded over true force")
    force_gain_sd: float | None = _key(_not_negative)
    noise_sd: Mapping[str, float] = field(default_factory=dict)
    extra: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def parse(cls, raw: Mapping[str, Any], *, where: str = "") -> Self:
        """Constants from text or TOML values. Raises `RefusedError` for what is malformed."""
        noise, rest = {}, {}
        for key, value in raw.items():
            name = key.removesuffix("_noise_sd")
            if name != key and name in QUANTITIES:
                noise[name] = cast(float, _checked(_not_negative, f"rig.{key}", value, where))
            else:
                rest[key] = value
        return cls(**_parsed(cls, rest, where, prefix="rig."), noise_sd=noise)

    def loaded(self, mass_kg: float | None) -> Self:
        """The same rig with a further mass on its clamp, which the file does not know of; that lowers the frequency as well."""
        if not mass_kg or not self.clamp_mass_kg:
            return self
        mass = self.clamp_mass_kg + mass_kg
        slower = float((self.clamp_mass_kg / mass) ** 0.5)
        hz, sd = self.clamp_frequency_hz, self.clamp_frequency_hz_sd
        return replace(
            self,
            clamp_mass_kg=mass,
            clamp_frequency_hz=None if hz is None else hz * slower,
            clamp_frequency_hz_sd=None if sd is None else sd * slower,
        )

    def to_text(self) -> dict[str, str]:
        """The keys as MCAP metadata has them; `parse` reads it back."""
        return _as_text(self) | {f"{name}_noise_sd": repr(value) for name, value in self.noise_sd.items()}


def list_faults(raw: Mapping[str, Any], cls: type, *, where: str = "") -> tuple[RefusedError, ...]:
    """All that is wrong with metadata, key by key, where `parse` of the class raises the first of it."""
    faults: list[RefusedError] = []
    required = {f.name for f in dataclasses.fields(cls) if "parser" in f.metadata and f.default is dataclasses.MISSING}
    parsers = {f.name: f.metadata["parser"] for f in dataclasses.fields(cls) if "parser" in f.metadata}
    for key, value in raw.items():
        required.discard(key)
        try:
            if key in parsers and not (isinstance(value, str) and value.strip() == ""):
                _checked(parsers[key], key, value, where)
            elif key not in parsers:
                table = "rig" if cls is RigConstants else "recording"
                if table == "rig" and key in known_keys(cls):  # the noise of a channel
                    _checked(_not_negative, key, value, where)
                else:
                    check_keys({k: v for k, v in raw.items() if k == key or k in parsers}, cls, table, where)
        except RefusedError as error:
            faults.append(error)
    remedy = "Add it to the recording's metadata or to its TOML"
    faults += [RefusedError(f"required key {key} is missing", where=where, remedy=remedy) for key in sorted(required)]
    if cls is RecordingMetadata and not {"protocol", "loading"} & required:
        try:
            protocol(str(raw["protocol"]), str(raw["loading"]), where=where)
        except RefusedError as error:
            faults.append(error)
    return tuple(faults)


def _check_sweep(metadata: RecordingMetadata, where: str) -> None:
    """Raises `RefusedError` for a sweep that cannot be: at 0 Hz alone, or from 0 by equal ratios."""
    ends = metadata.frequency_start_hz, metadata.frequency_stop_hz
    if 0 in ends and (metadata.sweep == "log" or ends[0] == ends[1]):
        raise RefusedError(
            f"a {metadata.sweep or ''} sweep from {ends[0]} to {ends[1]} Hz cannot be".replace("  ", " "),
            where=where,
            expected="frequencies above 0; one end of a linear sweep may be 0",
            remedy="Correct frequency_start_hz, frequency_stop_hz or sweep",
        )


def describe_key(key: str) -> str:
    """What a key of a recording means, in words."""
    meaning: str = _find_field(key).metadata["meaning"]
    return meaning


def check_value(key: str, value: Any, *, where: str = "") -> None:
    """Raises `RefusedError` where a key of a recording cannot have that value."""
    _checked(_find_field(key).metadata["parser"], key, value, where)


def _find_field(key: str) -> dataclasses.Field[Any]:
    return next(f for f in dataclasses.fields(RecordingMetadata) if f.name == key)


def near_miss(key: str, cls: type) -> str | None:
    """The known key that an unknown one seems to be a misspelling of; None where it looks like none of them."""
    if key.startswith(OWN_KEY):
        return None
    found = difflib.get_close_matches(key, known_keys(cls), n=1, cutoff=_ALIKE)
    return found[0] if found else None


def known_keys(cls: type) -> tuple[str, ...]:
    """The names of the keys that a class of metadata has."""
    fields = dataclasses.fields(cls)
    noise = tuple(f"{name}_noise_sd" for name in QUANTITIES) if any(f.name == "noise_sd" for f in fields) else ()
    return (*(f.name for f in fields if "parser" in f.metadata), *noise)


def check_keys(given: Mapping[str, Any], cls: type, name: str, where: str) -> None:
    """Asks about keys that are nearly those of the contract. Raises `RefusedError` for the first."""
    known = known_keys(cls)
    for key in given:
        if key not in known and (meant := near_miss(key, cls)) is not None and meant not in given:
            raise RefusedError(
                f'key "{name}.{key[:80]}" is unknown: did you mean {meant}?',
                where=where,
                expected="a key of the contract, or one that looks like none of them",
                remedy=f"Correct the mapping TOML; a key of your own may begin with {OWN_KEY}",
            )


def _checked(parser: Callable[[Any], Any], key: str, value: Any, where: str) -> Any:
    try:
        return parser(value)
    except ValueError as error:
        shown = str(value)
        shown = shown if len(shown) <= 80 else shown[:77] + "..."
        raise RefusedError(f'{key} is "{shown}"', where=where, expected=str(error)) from None


def _parsed(cls: type, raw: Mapping[str, Any], where: str, prefix: str = "") -> dict[str, Any]:
    parsers = {f.name: f.metadata["parser"] for f in dataclasses.fields(cls) if "parser" in f.metadata}
    values: dict[str, Any] = {}
    extra: dict[str, str] = {}
    for key, value in raw.items():
        if key not in parsers:
            extra[str(key)] = _checked(_text, prefix + str(key), value, where)
        elif not (isinstance(value, str) and value.strip() == ""):
            values[key] = _checked(parsers[key], prefix + key, value, where)
    for f in dataclasses.fields(cls):
        if f.default is dataclasses.MISSING and f.default_factory is dataclasses.MISSING and f.name not in values:
            raise RefusedError(
                f"required key {prefix}{f.name} is missing",
                where=where,
                remedy=f"Add {f.name} to the recording's metadata or to its TOML",
            )
    values["extra"] = extra
    return values


def _as_text(metadata: Any) -> dict[str, str]:
    text: dict[str, str] = dict(metadata.extra)
    for f in dataclasses.fields(metadata):
        value = getattr(metadata, f.name)
        if value is None or "parser" not in f.metadata:
            continue
        if isinstance(value, datetime):
            text[f.name] = value.isoformat()
        elif isinstance(value, tuple):
            text[f.name] = ",".join(repr(v) for v in value)
        else:
            text[f.name] = str(value)
    return text
