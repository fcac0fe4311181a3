"""The check between a file and an analysis: a `RawRecording` becomes a `Recording` in canonical units, or is refused.

Refused (quarantined): metadata missing or malformed, an unknown protocol, a required channel that is missing, empty,
never changes in a dynamic test, runs backwards or lies beyond the load cell's range for most of its samples; required
channels that share no time; a unit of the wrong dimension. Kept but `damaged`, each with a problem: lost or non-finite
samples (NaN), instants told twice, forces at or beyond the range of the load cell, optional channels that cannot be used.
Nothing is repaired in silence, and nothing is shifted, sorted or resampled.

Does not belong here: reading files, and what takes an analysis to see (clipping, drift, delay).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any

import numpy as np

from ingest.plausible import find_impossible, find_losses_by_value, find_marks, find_spikes, is_strain
from ingest.timing import sampling_notes
from schemas.arrays import Bool, Float
from schemas.assumptions import assume_campaign
from schemas.errors import RefusedError
from schemas.metadata import RecordingMetadata, RigConstants, near_miss
from schemas.protocols import CALIBRATION, Protocol, find_unused_keys, missing_channels
from schemas.quantities import QUANTITIES, Quantity
from schemas.recording import Channel, RawChannel, RawRecording, Recording, Source
from schemas.units import ANY, conversion

_DYNAMIC = ("chirp", "sphs", "noise", "cyclic", "cycle", "step", "tap")
"""Protocols in which every required channel must change."""
_FORCES = ("force", "force_1", "force_2")
_LEAST_USED = 0.01
"""Least part of its range that a load cell is used to: below that a force in mN is no better guess."""
_REPEATED_INSTANTS = 0.01
"""Share of samples that may stand at an instant told twice with two values; beyond it the clock is too coarse."""
_LEAST_STRETCH, _LARGEST_STRETCH = 0.3, 8.0
"""Pre-stretches beyond which a percentage or a length was given: what across goes with 8 along is 0.35."""
_CLOCK_DIFFERENCE_S = 3600.0
NO_CAMPAIGN = "no campaign"
"""Campaign of the recorded lives that name none: they stand on a page together, as nothing tells them apart."""
_DRIVEN = 0.1
"""Share by which a strain may be driven otherwise than it is stated."""


def canonical(
    raw: RawRecording,
    *,
    where: str,
    rig_file: Mapping[str, Any] | None = None,
    source: Source | None = None,
) -> Recording:
    """The checked recording in canonical units.

    Parameters
    ----------
    raw : what a reader found
    where : name of the file, for messages
    rig_file : keys of the rig's own file; it wins over the recording's, key by key
    source : where the recording came from

    Raises
    ------
    RefusedError : with the field, the value found and what was expected
    """
    metadata = RecordingMetadata.parse(raw.metadata, where=where)
    rig = RigConstants.parse({**raw.rig, **(rig_file or {})}, where=where)
    definition = metadata.definition(where=where)
    problems, notes = list(raw.problems), list(raw.notes)
    for name, about in (("recording", metadata), ("rig", rig)):
        _tell_unknown_keys(name, about, problems, notes)
    _tell_unused_keys(metadata, notes)
    known = _known(raw.channels, notes, where)
    required = _required(definition, known, where)
    channels: dict[str, Channel] = {}
    for quantity, found in known.items():
        try:
            channels[quantity] = _checked(found, quantity in required, problems, notes, where)
        except _Unusable as reason:
            if quantity in required:
                raise RefusedError(
                    f"{quantity}: {reason.problem}", where=where, expected=reason.expected, remedy=reason.remedy
                ) from None
            problems.append(f"{quantity}: {reason.problem}: the channel is left out")
    _check_overlap(channels, required, where)
    if definition.name in _DYNAMIC:
        for quantity in required:
            _check_changes(channels[quantity], where)
    if metadata.drive_kv and {"voltage", "force"} <= channels.keys():
        _check_places(channels["voltage"], channels["force"], metadata.drive_kv, where)
    for quantity in _FORCES:
        if quantity in channels and rig.load_cell_range_n is not None:
            beside = channels.get("displacement") if quantity in required else None
            travel = metadata.driven_travel_mm
            _check_range(
                channels[quantity], rig.load_cell_range_n, quantity in required, beside, travel, problems, where
            )
    if definition.name in _DYNAMIC and metadata.loading != CALIBRATION:
        driving, responding = required[0], required[-1]
        channels[responding] = _without_spikes(channels[responding], channels[driving], problems)
    assumptions = raw.assumptions
    if definition.name == "lifetime" and not metadata.campaign:
        metadata = replace(metadata, campaign=NO_CAMPAIGN)
        assumptions += (assume_campaign(f'"{NO_CAMPAIGN}", with all other such lives'),)
    recording = Recording(metadata, rig, channels, source, assumptions=assumptions)
    notes += sampling_notes(channels)
    _note_clock(recording, notes)
    _note_sizes(recording, notes)
    return replace(recording, problems=tuple(dict.fromkeys(problems)), notes=tuple(dict.fromkeys(notes)))


def _tell_unknown_keys(
    name: str, about: RecordingMetadata | RigConstants, problems: list[str], notes: list[str]
) -> None:
    """Keys that the contract does not have: a near miss of one that is not given is a problem, what was meant is lost; the others are a note."""
    meant = {key: near_miss(key, type(about)) for key in about.extra}
    lost = {key: known for key, known in meant.items() if known is not None and getattr(about, known, None) is None}
    problems += [
        f'{name} key "{key[:80]}" is unknown: did you mean {known}? It is not used' for key, known in lost.items()
    ]
    others = [key[:80] for key in meant if key not in lost]
    if others:
        notes.append(f"keys of {name} that the contract does not have, kept and not used: {', '.join(others[:40])}")


def _tell_unused_keys(about: RecordingMetadata, notes: list[str]) -> None:
    """Keys of the contract that say how another kind of test was run: they change nothing here."""
    given = {field.name for field in fields(about) if getattr(about, field.name) is not None}
    unused = find_unused_keys(given, about.protocol, about.loading)
    if unused:
        notes.append(f"keys of recording that a {about.loading} {about.protocol} does not use: {', '.join(unused)}")


class _Unusable(Exception):
    """A channel that cannot be used: refused when it is required, left out with a problem when it is not."""

    def __init__(self, problem: str, expected: str = "", remedy: str = "") -> None:
        super().__init__(problem)
        self.problem, self.expected, self.remedy = problem, expected, remedy


def _known(channels: tuple[RawChannel, ...], notes: list[str], where: str) -> dict[str, RawChannel]:
    """Channels by quantity; others are left out with a note."""
    known: dict[str, RawChannel] = {}
    for channel in channels:
        name = channel.quantity
        if name not in QUANTITIES:
            notes.append(f'channel "{name[:80]}" is no quantity of the contract: left out')
        elif name in known:
            raise RefusedError(
                f"two channels hold {name}",
                where=where,
                expected="one channel per quantity",
                remedy="Map the right one in the TOML beside the file",
            )
        else:
            known[name] = channel
    return known


def _required(definition: Protocol, known: Mapping[str, RawChannel], where: str) -> tuple[str, ...]:
    """The required channels of the alternative that the recording has."""
    missing = missing_channels(definition, set(known))
    if missing:
        needed = " or ".join(", ".join(alternative) for alternative in definition.required)
        found = ", ".join(known) or "no channel of the contract"
        raise RefusedError(
            f"required channel {', '.join(missing)} is missing; found: {found}",
            where=where,
            expected=f"for protocol {definition.name} ({definition.loading}): {needed}",
            remedy="Record or map the channel",
        )
    return next(a for a in definition.required if set(a) <= known.keys())


def _checked(raw: RawChannel, required: bool, problems: list[str], notes: list[str], where: str) -> Channel:
    """One channel in its canonical unit, strictly ascending, NaN where a sample was lost."""
    name = raw.quantity
    canonical_unit = QUANTITIES[name].unit
    change = conversion(raw.unit, canonical_unit, where=f"{where}: {name}")
    if raw.values.size == 0:
        raise _Unusable("the channel is empty", "samples")
    time, values = _ascending(raw, problems, notes)
    chosen = find_losses_by_value(values)
    if chosen:
        raise _Unusable(
            f"of its samples {chosen} are lost: a choice by value and no damage",
            "all samples, or losses by chance",
            "Look how the file was made: a filter, an unsigned converter, a format that drops signs",
        )
    values = _without_marks(values, name, problems)
    finite = np.isfinite(values)
    lost = int(values.size - finite.sum())
    if lost == values.size:
        raise _Unusable(f"none of its {lost} samples is a finite number", "finite samples")
    if required and values.size - lost < 2:
        raise _Unusable("it has a single usable sample", "at least two")
    if lost:
        first = int(np.argmin(finite))
        at = (int(time[first]) - int(time[0])) * 1e-9
        problems.append(
            f"{name}: {lost} of {values.size} samples are missing or not finite (first at {at:.6g} s): NULL"
        )
        values = np.where(finite, values, np.nan)
    values = change.apply(values)
    if np.isinf(values).any():
        raise _Unusable("its values overflow in the canonical unit", f"values in {canonical_unit}")
    values = _possible(values, QUANTITIES[name], raw.unit, problems)
    resolution, filter_hz, delay = (_key(raw, key, where) for key in ("resolution", "filter_hz", "delay_s"))
    return Channel(
        quantity=name,
        time_ns=time,
        values=values,
        resolution=None if resolution is None else abs(change.apply_difference(resolution)),
        filter_hz=filter_hz,
        delay_s=delay,
        sensor=raw.metadata.get("sensor") or None,
        unit=raw.unit if canonical_unit == ANY else None,
    )


def _without_marks(values: Float, name: str, problems: list[str]) -> Float:
    """The samples without marks of instruments that look like numbers, each kind a problem."""
    for what, here in find_marks(values).items():
        problems.append(f"{name}: {int(here.sum())} of {values.size} samples are {what}: NULL")
        values = np.where(here, np.nan, values)
    return values


def _without_spikes(channel: Channel, driving: Channel, problems: list[str]) -> Channel:
    """The response without single samples that stand alone, each a problem."""
    finite = np.isfinite(driving.values)
    driven_by = np.interp(channel.time_ns, driving.time_ns[finite], driving.values[finite])
    spikes = find_spikes(channel.values, driven_by)
    for place in np.flatnonzero(spikes):
        at = (int(channel.time_ns[place]) - int(channel.time_ns[0])) * 1e-9
        problems.append(
            f"{channel.quantity}: one sample of {channel.values[place]:.4g} at {at:.6g} s stands alone, a spike: NULL"
        )
    return replace(channel, values=np.where(spikes, np.nan, channel.values)) if spikes.any() else channel


def _possible(values: Float, quantity: Quantity, unit: str, problems: list[str]) -> Float:
    """The values without those that the quantity cannot have. `_Unusable` when most of them are of that kind."""
    if quantity.name == "stretch" and is_strain(values):
        raise _Unusable(
            f"it begins at {values[np.isfinite(values)][0]:.4g} and has a median of {np.nanmedian(values):.4g}: a strain",
            "length over undeformed length, 1 where the film is not deformed",
            "Give offset = 1 in [columns.stretch] of the mapping TOML, in the column's unit: 100 where that is %",
        )
    impossible = find_impossible(values, quantity)
    count = int(impossible.sum())
    if not count:
        return values
    example = values[int(np.argmax(impossible))]
    finite = int(np.isfinite(values).sum())
    text = (
        f'{count} of {finite} values in "{unit[:40]}" are no {quantity.name} there can be,'
        f" such as {example:.4g} {quantity.unit}"
    )
    expected = f"{quantity.least:g} to {quantity.largest:g} {quantity.unit}"
    if 2 * count > finite:
        raise _Unusable(text, expected, f'Check the unit "{unit[:40]}", the column and its scale')
    problems.append(f"{quantity.name}: {text}: NULL; expected {expected}")
    return np.where(impossible, np.nan, values)


def _ascending(raw: RawChannel, problems: list[str], notes: list[str]) -> tuple[Any, Any]:
    """Times and values without instants told twice. `_Unusable` when time runs backwards."""
    time, values = raw.time_ns, raw.values
    steps = np.diff(time)
    if (steps > 0).all():
        return time, values
    back = np.flatnonzero(steps < 0)
    if back.size:
        i = int(back[0])
        raise _Unusable(
            f"time runs backwards {back.size} times: sample {i + 2} is {-int(steps[i]) * 1e-9:.6g} s before sample {i + 1}",
            "ascending time",
            "Check the recorder's clock and the zone (a change from summer time?), or give sample_rate_hz",
        )
    repeated = np.concatenate(([False], steps == 0))
    before = np.concatenate((values[:1], values[:-1]))
    equal = repeated & ((values == before) | (np.isnan(values) & np.isnan(before)))
    differing = int((repeated & ~equal).sum())
    if differing > max(1, _REPEATED_INSTANTS * time.size):
        raise _Unusable(
            f"{differing} of {time.size} samples stand at the same instant as the one before",
            "one sample per instant",
            "The time is too coarse for the sample rate: give sample_rate_hz in the mapping TOML",
        )
    if differing:
        problems.append(f"{raw.quantity}: {differing} instants have two values: the first was kept")
    if equal.any():
        notes.append(f"{raw.quantity}: {int(equal.sum())} samples told twice were dropped")
    return time[~repeated], values[~repeated]


def _key(raw: RawChannel, key: str, where: str) -> float | None:
    """A number of the channel's metadata. Raises `RefusedError` when it is malformed."""
    text = raw.metadata.get(key, "")
    if not str(text).strip():
        return None
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number) or (key == "filter_hz" and number <= 0) or (key == "resolution" and number < 0):
        expected = {"filter_hz": "a frequency above 0", "resolution": "a step not below 0"}.get(key, "a finite number")
        raise RefusedError(f'{raw.quantity}: {key} is "{str(text)[:80]}"', where=where, expected=expected)
    return number


def _check_overlap(channels: Mapping[str, Channel], required: tuple[str, ...], where: str) -> None:
    """The required channels must share a stretch of time."""
    spans = {q: (int(channels[q].time_ns[0]), int(channels[q].time_ns[-1])) for q in required}
    latest, earliest = max(spans, key=lambda q: spans[q][0]), min(spans, key=lambda q: spans[q][1])
    apart = (spans[latest][0] - spans[earliest][1]) * 1e-9
    if len(required) > 1 and apart >= 0:
        raise RefusedError(
            f"{latest} begins {apart:.6g} s after {earliest} has ended",
            where=where,
            expected="channels that share their time",
            remedy="Check the clocks of the recorders",
        )


def _check_changes(channel: Channel, where: str) -> None:
    values = channel.values[np.isfinite(channel.values)]
    if values.min() == values.max():
        hint = " (load cell not connected?)" if channel.quantity in _FORCES else " (sensor not connected?)"
        unit = channel.unit or QUANTITIES[channel.quantity].unit
        raise RefusedError(
            f"{channel.quantity} is {values[0]:.6g} {unit} in all {values.size} samples{hint}",
            where=where,
            expected="a channel that changes during the test",
            remedy="Check the sensor and measure again",
        )


def _check_places(voltage: Channel, force: Channel, drive_kv: float, where: str) -> None:
    """A voltage that never comes near 0 nor reaches what the metadata promise, beside a force that does both, is the force."""
    size, other = np.abs(voltage.values), np.abs(force.values)
    highest, reached = float(np.nanmax(size)), float(np.nanmax(other))
    never_off = float(np.nanmin(size)) > highest / 2
    if (
        never_off
        and abs(reached / drive_kv - 1) < _DRIVEN < abs(highest / drive_kv - 1)
        and np.nanmin(other) < reached / 2
    ):
        raise RefusedError(
            f"voltage never falls below {np.nanmin(size):.4g} kV and reaches {highest:.4g} kV, force reaches {reached:.4g} N",
            where=where,
            expected=f"a voltage that reaches {drive_kv:g} kV, drive_kv of the recording",
            remedy="Force and voltage are in each other's place. Exchange the two columns",
        )


def _check_range(
    channel: Channel,
    limit: float,
    required: bool,
    beside: Channel | None,
    travel: float | None,
    problems: list[str],
    where: str,
) -> None:
    """Forces at or beyond the load cell's range: some are a problem, most of them refuse the recording.

    Parameters
    ----------
    beside : the displacement that may be in the force's place, and the force in its
    travel : of the displacement, as the metadata promise it, mm
    """
    size = np.abs(channel.values)
    beyond: Bool = size >= limit
    count = int(beyond.sum())
    if not count:
        return
    largest = channel.values[int(np.nanargmax(size))]
    usable = int(np.isfinite(size).sum())
    text = (
        f"{channel.quantity}: {count} of {usable} samples at or beyond the load cell's range (largest {largest:.6g} N)"
    )
    if required and count > usable / 2:
        if beside is not None and travel is not None and _moves_by(channel, travel) and not _moves_by(beside, travel):
            raise RefusedError(
                text,
                where=where,
                expected=f"at most {limit:g} N, load_cell_range_n of the rig",
                remedy="Force and displacement are in each other's place: what is called force moves by the"
                f" {travel:.4g} mm that strain_pp says, what is called displacement does not. Exchange the two columns",
            )
        may_be_swapped = (
            beside is not None
            and float(np.nanmax(np.abs(beside.values))) < limit
            and not (travel is not None and _moves_by(beside, travel))
        )
        swapped = (
            ", whether force and displacement are in each other's place: what is called displacement lies within it,"
        )
        milli = abs(largest) / 1000
        in_milli = f" (of mN it would be at most {milli:.4g} N)" if _LEAST_USED * limit < milli < limit else ""
        raise RefusedError(
            text,
            where=where,
            expected=f"at most {limit:g} N, load_cell_range_n of the rig",
            remedy=f"Check the unit of the channel{in_milli}{swapped if may_be_swapped else ''} and the rig's load_cell_range_n",
        )
    problems.append(f"{text}; expected below {limit:g} N in size")


def _moves_by(channel: Channel, travel: float) -> bool:
    """Whether a channel's values span the travel that is promised, as well as strains are driven."""
    return bool(abs(float(np.nanmax(channel.values) - np.nanmin(channel.values)) / travel - 1) < _DRIVEN)


def _note_sizes(recording: Recording, notes: list[str]) -> None:
    """A film is thin and its pre-stretch one that elastomers bear: else a unit or another size was written down."""
    about = recording.metadata
    sides = {name: getattr(about, name) for name in ("film_length_mm", "film_width_mm")}
    thickness = about.layer_thickness_mm
    thinner = [name for name, side in sides.items() if side is not None and thickness is not None and side < thickness]
    if thinner and thickness is not None:
        notes.append(
            f"film_thickness_mm is {about.film_thickness_mm:g}, more than {' and '.join(thinner)} ({sides[thinner[0]]:g}): were they "
            "written in µm, or exchanged?"
        )
    for name in ("stretch_1", "stretch_2"):
        value = getattr(about, name)
        if value is not None and not _LEAST_STRETCH <= value <= _LARGEST_STRETCH:
            notes.append(f"{name} is {value:g}: a pre-stretch is length over undeformed length, 1.2 for 20 %")


def _note_clock(recording: Recording, notes: list[str]) -> None:
    apart = recording.start_ns * 1e-9 - recording.metadata.started_at.timestamp()
    if abs(apart) > _CLOCK_DIFFERENCE_S:
        side = "after" if apart > 0 else "before"
        notes.append(f"the first sample is {abs(apart) / 3600:.4g} h {side} started_at: the recorder's clock?")
