"""Edits of a session's recordings, each a fault of everyday life: what was wrong in the laboratory, not in the film.

    edited = EDITS["force of one sweep in mN"](session.recordings)

Whatever is edited is a copy. Recordings are chosen by what they are, so that every session has them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from schemas.recording import Channel, Recording

Recordings = Sequence[Recording]
Values = NDArray[np.float64]
STANDARD_GRAVITY = 9.80665


@dataclass(frozen=True)
class Edit:
    """A fault: the id that should be said, the recordings it is in (none: all of the session), and how it comes about.

    `instead`: other ids that say the same of these recordings, since nothing in them tells the difference.
    """

    cause: str
    chosen: Callable[[Recordings], tuple[int, ...]]
    edit: Callable[[Recording], Recording]
    instead: tuple[str, ...] = ()

    def __call__(self, recordings: Recordings) -> list[Recording]:
        """The session with the fault."""
        chosen = self.chosen(recordings)
        return [self.edit(r) if i in chosen else r for i, r in enumerate(recordings)]

    def culprits(self, recordings: Recordings) -> tuple[str, ...]:
        """Ids of the recordings with the fault."""
        return tuple(recordings[i].metadata.recording_id for i in self.chosen(recordings))


def change_channel(recording: Recording, quantity: str, change: Callable[[Values], Values]) -> Recording:
    """The recording with other values of one channel."""
    channel = recording.channels[quantity]
    changed = replace(channel, values=np.asarray(change(channel.values.copy())))
    return replace(recording, channels={**recording.channels, quantity: changed})


def change_clock(recording: Recording, factor: float, quantities: Sequence[str] | None = None) -> Recording:
    """The recording with times since its start stretched by a factor, of some channels or of all."""
    channels = {}
    for name, channel in recording.channels.items():
        start, stretched = channel.time_ns[0], channel.time_ns
        if quantities is None or name in quantities:
            stretched = start + np.rint((channel.time_ns - start) * factor).astype(np.int64)
        channels[name] = replace(channel, time_ns=stretched)
    return replace(recording, channels=channels)


def drift_clock(recording: Recording, quantity: str, drift: float) -> Recording:
    """The recording with one channel sampled by a clock that runs slow by a share, and stamped as if it did not."""
    channel = recording.channels[quantity]
    time = (channel.time_ns - channel.time_ns[0]) * 1e-9
    follow = CubicSpline(time, channel.values)
    return change_channel(recording, quantity, lambda _: follow(np.minimum(time * (1 - drift), time[-1])))


def change_metadata(recording: Recording, **factors: float) -> Recording:
    """The recording with some keys of its metadata multiplied."""
    known = {key: getattr(recording.metadata, key) for key in factors}
    values = {key: value * factors[key] for key, value in known.items() if value is not None}
    return replace(recording, metadata=replace(recording.metadata, **values))


def change_rig(recording: Recording, **factors: float) -> Recording:
    """The recording with some constants of its rig's file multiplied."""
    values = {key: getattr(recording.rig, key) * factor for key, factor in factors.items()}
    return replace(recording, rig=replace(recording.rig, **values))


def swap_channels(recording: Recording) -> Recording:
    """Force recorded as displacement and displacement as force."""
    x, f = recording.channels["displacement"], recording.channels["force"]
    swapped = {"displacement": replace(x, values=f.values), "force": replace(f, values=x.values)}
    return replace(recording, channels={**recording.channels, **swapped})


def scale_signal(share: float) -> Callable[[Values], Values]:
    """Force as another gain of the load cell reads it: its noise and its converter stay out of account."""
    return lambda v: float(np.median(v[:100])) * share + (v - float(np.median(v[:100]))) * share


def scale_motion(share: float) -> Callable[[Values], Values]:
    """The same, of a film that was brought to the same tension at rest again."""
    return lambda v: float(np.median(v[:100])) + (v - float(np.median(v[:100]))) * share


def clip(share: float) -> Callable[[Values], Values]:
    """All beyond a share of the largest rise of a channel at that value."""

    def clipped(values: Values) -> Values:
        middle = float(np.median(values))
        return np.minimum(values, middle + share * (values.max() - middle))

    return clipped


def drop_out(first: float, stop: float) -> Callable[[Values], Values]:
    """A channel that holds its value between two shares of the record."""

    def held(values: Values) -> Values:
        a, b = int(first * values.size), int(stop * values.size)
        values[a:b] = values[a]
        return values

    return held


def all_of(recordings: Recordings) -> tuple[int, ...]:
    return tuple(range(len(recordings)))


def mechanical(recordings: Recordings) -> tuple[int, ...]:
    return tuple(i for i, r in enumerate(recordings) if r.metadata.loading == "mechanical")


def sweeps(recordings: Recordings) -> tuple[int, ...]:
    return tuple(i for i in mechanical(recordings) if recordings[i].metadata.protocol == "chirp")


def from_seventh(recordings: Recordings) -> tuple[int, ...]:
    return tuple(range(6, len(recordings)))


def pick(protocol: str, loading: str, number: int) -> Callable[[Recordings], tuple[int, ...]]:
    """The recording of a protocol with that number among its like, from 0."""

    def picked(recordings: Recordings) -> tuple[int, ...]:
        like = [i for i, r in enumerate(recordings) if (r.metadata.protocol, r.metadata.loading) == (protocol, loading)]
        return (like[number],)

    return picked


def offset_clock(recording: Recording, quantity: str, seconds: float) -> Recording:
    """The recording with one channel stamped that much later."""
    channel: Channel = recording.channels[quantity]
    later = replace(channel, time_ns=channel.time_ns + round(seconds * 1e9))
    return replace(recording, channels={**recording.channels, quantity: later})


def multiply(quantity: str, factor: float) -> Callable[[Recording], Recording]:
    """A channel in another unit than its file says."""
    return lambda r: change_channel(r, quantity, lambda v: v * factor) if quantity in r.channels else r


SWEEP = pick("chirp", "mechanical", 1)
FIRST_SWEEP = pick("chirp", "mechanical", 0)
SINE = pick("cyclic", "mechanical", 0)
LARGEST_SINE = pick("cyclic", "mechanical", -1)
MULTISINE = pick("sphs", "electrical", 0)

EDITS: Mapping[str, Edit] = {
    "force of one sweep in mN": Edit("unit_slip", SWEEP, multiply("force", 1e3)),
    "force of one sweep in kN": Edit("unit_slip", FIRST_SWEEP, multiply("force", 1e-3)),
    "force of a sine in kgf": Edit("unit_slip", SINE, multiply("force", 1 / STANDARD_GRAVITY)),
    "force of all in kgf": Edit("unit_slip", all_of, multiply("force", 1 / STANDARD_GRAVITY)),
    "displacement of one sweep doubled": Edit("unit_slip", SWEEP, multiply("displacement", 2.0)),
    "displacement of a sine in cm": Edit("unit_slip", SINE, multiply("displacement", 0.1)),
    "voltage of one multisine as effective value": Edit("unit_slip", MULTISINE, multiply("voltage", 0.5 / 2**0.5)),
    "force of one sweep with its sign flipped": Edit("sign_flipped", SWEEP, multiply("force", -1.0)),
    "force of one multisine with its sign flipped": Edit("sign_flipped", MULTISINE, multiply("force", -1.0)),
    "channels of one sweep swapped": Edit("channels_swapped", SWEEP, swap_channels),
    "channels of a sine swapped": Edit("channels_swapped", SINE, swap_channels),
    "clock of one sweep 5 % off": Edit("sample_rate_wrong", SWEEP, lambda r: change_clock(r, 1.05)),
    "sample rate of one sweep halved": Edit("sample_rate_wrong", SWEEP, lambda r: change_clock(r, 2.0)),
    "clock of all mechanical tests 5 % off": Edit("sample_rate_wrong", mechanical, lambda r: change_clock(r, 1.05)),
    "clock of the force 200 ppm fast in one sweep": Edit("clock_drift", SWEEP, lambda r: drift_clock(r, "force", 2e-4)),
    "clock of the force 60 ppm fast in all": Edit("clock_drift", all_of, lambda r: drift_clock(r, "force", 6e-5)),
    "force of one sweep 2 ms late": Edit("channel_skew", SWEEP, lambda r: offset_clock(r, "force", 2e-3)),
    "one sine clipped at 60 %": Edit(
        "sensor_saturation", LARGEST_SINE, lambda r: change_channel(r, "force", clip(0.6))
    ),
    "one sweep clipped at 60 %": Edit("sensor_saturation", SWEEP, lambda r: change_channel(r, "force", clip(0.6))),
    "displacement of one sine clipped at 60 %": Edit(
        "sensor_saturation", LARGEST_SINE, lambda r: change_channel(r, "displacement", clip(0.6))
    ),
    "force of all with its sign flipped": Edit("sign_flipped", all_of, multiply("force", -1.0)),
    "displacement of all with its sign flipped": Edit("sign_flipped", all_of, multiply("displacement", -1.0)),
    "force of one sweep drops out": Edit(
        "dead_channel", SWEEP, lambda r: change_channel(r, "force", drop_out(0.4, 0.45))
    ),
    "force of one sweep dead": Edit("dead_channel", SWEEP, lambda r: change_channel(r, "force", drop_out(0.0, 1.0))),
    "force of one sine nothing but noise": Edit(
        "dead_channel",
        SINE,
        lambda r: change_channel(r, "force", lambda v: np.resize(v[: max(v.size // 40, 8)], v.size)),
    ),
    "force read 0.8 times from the seventh recording on": Edit(
        "gain_error", from_seventh, lambda r: change_channel(r, "force", scale_signal(0.8))
    ),
    "film clamped anew from the seventh recording on": Edit(
        "specimen_changed", from_seventh, lambda r: change_channel(r, "force", scale_motion(0.8))
    ),
    "displacement of a sine nothing but noise": Edit(
        "dead_channel",
        SINE,
        lambda r: change_channel(
            r, "displacement", lambda v: np.random.default_rng(1).normal(v[0], 1e-4 * np.ptp(v), v.size)
        ),
    ),
    "voltage of one multisine lost for a while": Edit(
        "dead_channel", MULTISINE, lambda r: change_channel(r, "voltage", drop_out(0.5, 0.6))
    ),
    "clock of one multisine 6 % off": Edit("sample_rate_wrong", MULTISINE, lambda r: change_clock(r, 0.94)),
    "clock of all tests 6 % off": Edit("sample_rate_wrong", all_of, lambda r: change_clock(r, 0.94)),
    "force of all sweeps 4.5 ms late": Edit("channel_skew", sweeps, lambda r: offset_clock(r, "force", 4.5e-3)),
    "force of all halved": Edit("unit_slip", all_of, multiply("force", 0.5)),
    "clamp mass ten times": Edit("rig_constants", all_of, lambda r: change_rig(r, clamp_mass_kg=10.0)),
    "clamp mass in g": Edit("rig_constants", all_of, lambda r: change_rig(r, clamp_mass_kg=1e3)),
    "load cell's stiffness ten times": Edit(
        "rig_constants", all_of, lambda r: change_rig(r, load_cell_stiffness_n_per_mm=10.0)
    ),
    "strain_pp of one sweep doubled": Edit("strain_wrong", SWEEP, lambda r: change_metadata(r, strain_pp=2.0)),
    "strain_pp of all doubled": Edit(
        "strain_wrong", mechanical, lambda r: change_metadata(r, strain_pp=2.0), ("size_wrong",)
    ),
    "thickness doubled": Edit("size_wrong", all_of, lambda r: change_metadata(r, film_thickness_mm=2.0)),
    "length doubled": Edit(
        "size_wrong", all_of, lambda r: change_metadata(r, film_length_mm=2.0, total_length_mm=2.0), ("strain_wrong",)
    ),
    "width halved": Edit("size_wrong", all_of, lambda r: change_metadata(r, film_width_mm=0.5, active_width_mm=0.5)),
}
"""Faults by a sentence about each."""


def mix_in(recordings: Recordings, others: Recordings, number: int) -> list[Recording]:
    """The session with one recording of another specimen's session under its own name, `number` in both of them."""
    own, foreign = recordings[number].metadata, others[number]
    metadata = replace(
        foreign.metadata,
        specimen_id=own.specimen_id,
        recording_id=own.recording_id,
        started_at=own.started_at,
        rest_before_s=own.rest_before_s,
    )
    return [replace(foreign, metadata=metadata) if i == number else r for i, r in enumerate(recordings)]
