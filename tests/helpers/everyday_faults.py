"""Edits of a session's recordings, each a fault of everyday life: what was wrong in the laboratory, not in the film.

    edited = EDITS["force of one sweep in mN"](session.recordings)

Whatever is edited is a copy. Recordings are chosen by what they are, so that every session has them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from pipeline.diagnose.faults.fault import Correction
from schemas.recording import Channel, Recording

Recordings = Sequence[Recording]
Values = NDArray[np.float64]
STANDARD_GRAVITY = 9.80665


@dataclass(frozen=True)
class Edit:
    """A fault: the id that should be said, the recordings it is in (none: all of the session), and how it comes about.

    `instead`: other ids that say the same of these recordings, since nothing in them tells the difference.
    `key`, `proposed`: what would put it right, and its value, over that which is written now where there is one; no key where nothing
    that is written would.
    """

    cause: str
    chosen: Callable[[Recordings], tuple[int, ...]]
    edit: Callable[[Recording], Recording]
    instead: tuple[str, ...] = ()
    key: str = ""
    proposed: float = 1.0

    def __call__(self, recordings: Recordings) -> list[Recording]:
        """The session with the fault."""
        chosen = self.chosen(recordings)
        return [self.edit(r) if i in chosen else r for i, r in enumerate(recordings)]

    def culprits(self, recordings: Recordings) -> tuple[str, ...]:
        """Ids of the recordings with the fault."""
        return tuple(recordings[i].metadata.recording_id for i in self.chosen(recordings))

    def is_put_right(self, correction: Correction) -> bool:
        """Whether a correction is the one that would put it right."""
        if correction.key != self.key:
            return False
        proposed = float(correction.value_proposed) / float(correction.value_now or 1.0)
        if self.key.endswith("time_scale"):
            return abs((proposed - 1) / (self.proposed - 1) - 1) < 0.1
        return abs(proposed / self.proposed - 1) < 0.03


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


def lose(recording: Recording, quantity: str, first: float, stop: float) -> Recording:
    """The recording without the samples that one channel has between two shares of the record."""
    channel = recording.channels[quantity]
    a, b = int(first * channel.values.size), int(stop * channel.values.size)
    kept = replace(
        channel, time_ns=np.delete(channel.time_ns, slice(a, b)), values=np.delete(channel.values, slice(a, b))
    )
    return replace(recording, channels={**recording.channels, quantity: kept})


def all_of(recordings: Recordings) -> tuple[int, ...]:
    return tuple(range(len(recordings)))


def mechanical(recordings: Recordings) -> tuple[int, ...]:
    return tuple(i for i, r in enumerate(recordings) if r.metadata.loading == "mechanical")


def electrical(recordings: Recordings) -> tuple[int, ...]:
    return tuple(i for i, r in enumerate(recordings) if r.metadata.loading == "electrical")


def all_but_first(recordings: Recordings) -> tuple[int, ...]:
    """Mechanical tests but the first of them."""
    return mechanical(recordings)[1:]


def sweeps(recordings: Recordings) -> tuple[int, ...]:
    return tuple(i for i in mechanical(recordings) if recordings[i].metadata.protocol == "chirp")


def from_seventh(recordings: Recordings) -> tuple[int, ...]:
    return tuple(range(6, len(recordings)))


def sines(recordings: Recordings) -> tuple[int, ...]:
    return tuple(i for i in mechanical(recordings) if recordings[i].metadata.protocol == "cyclic")


def from_fifth(recordings: Recordings) -> tuple[int, ...]:
    return tuple(range(4, len(recordings)))


def with_large_force(recordings: Recordings) -> tuple[int, ...]:
    """Mechanical tests in which the force swings by a fifth of the largest swing or more."""
    own = mechanical(recordings)
    swing = [float(np.ptp(recordings[i].channels["force"].values)) for i in own]
    return tuple(i for i, size in zip(own, swing, strict=True) if size > 0.2 * max(swing))


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
LAST_SWEEP = pick("chirp", "mechanical", -1)
SINE = pick("cyclic", "mechanical", 0)
LARGEST_SINE = pick("cyclic", "mechanical", -1)
STEP = pick("step", "mechanical", 0)
MULTISINE = pick("sphs", "electrical", 0)
Chosen = Callable[[Recordings], tuple[int, ...]]


def scaled(cause: str, chosen: Chosen, quantity: str, factor: float) -> Edit:
    """A channel that is recorded a factor too large."""
    return Edit(cause, chosen, multiply(quantity, factor), key=f"columns.{quantity}.scale", proposed=1 / factor)


def timed(chosen: Chosen, factor: float) -> Edit:
    """A clock that claims a factor too much time."""
    return Edit(
        "sample_rate_wrong", chosen, partial(change_clock, factor=factor), key="time.scale", proposed=1 / factor
    )


def drifting(chosen: Chosen, drift: float) -> Edit:
    """A force whose clock runs fast against that of the input."""
    return Edit(
        "clock_drift", chosen, partial(drift_clock, quantity="force", drift=drift),
        key="columns.force.time_scale", proposed=1 - drift,
    )  # fmt: skip


def delayed(chosen: Chosen, seconds: float) -> Edit:
    """A force that is stamped late."""
    late = partial(offset_clock, quantity="force", seconds=seconds)
    return Edit("channel_skew", chosen, late, key="columns.force.delay_s", proposed=seconds)


def read_otherwise(chosen: Chosen, share: float) -> Edit:
    """A force that is read with another gain."""
    return Edit(
        "gain_error", chosen, lambda r: change_channel(r, "force", scale_signal(share)),
        key="columns.force.scale", proposed=1 / share,
    )  # fmt: skip


def filed(**factors: float) -> Edit:
    """A rig's file with a constant a factor too large."""
    ((key, factor),) = factors.items()
    return Edit("rig_constants", all_of, lambda r: change_rig(r, **factors), key=f"rig.{key}", proposed=1 / factor)


def stated(cause: str, chosen: Chosen, *, instead: tuple[str, ...] = (), **factors: float) -> Edit:
    """Metadata that are a factor too large; the first of them is what is to be put right."""
    key, factor = next(iter(factors.items()))
    return Edit(cause, chosen, lambda r: change_metadata(r, **factors), instead, key=key, proposed=1 / factor)


EDITS: Mapping[str, Edit] = {
    "force of one sweep in mN": scaled("unit_slip", SWEEP, "force", 1e3),
    "force of one sweep in kN": scaled("unit_slip", FIRST_SWEEP, "force", 1e-3),
    "force of a sine in kgf": scaled("unit_slip", SINE, "force", 1 / STANDARD_GRAVITY),
    "force of all in kgf": scaled("unit_slip", all_of, "force", 1 / STANDARD_GRAVITY),
    "force of all doubled": scaled("unit_slip", all_of, "force", 2.0),
    "force of all halved": scaled("unit_slip", all_of, "force", 0.5),
    "force of all in mN": scaled("unit_slip", all_of, "force", 1e3),
    "displacement of one sweep doubled": scaled("unit_slip", SWEEP, "displacement", 2.0),
    "displacement of a sine in cm": scaled("unit_slip", SINE, "displacement", 0.1),
    "displacement of all in m": scaled("unit_slip", mechanical, "displacement", 1e-3),
    "displacement of all in inches": scaled("unit_slip", mechanical, "displacement", 1 / 25.4),
    "voltage of all in V": scaled("unit_slip", electrical, "voltage", 1e3),
    "voltage of all in MV": scaled("unit_slip", electrical, "voltage", 1e-3),
    "voltage of all halved": scaled("unit_slip", electrical, "voltage", 0.5),
    "voltage of one multisine as effective value": scaled("unit_slip", MULTISINE, "voltage", 0.5 / 2**0.5),
    "force of one sweep with its sign flipped": scaled("sign_flipped", SWEEP, "force", -1.0),
    "force of one multisine with its sign flipped": scaled("sign_flipped", MULTISINE, "force", -1.0),
    "force of all with its sign flipped": scaled("sign_flipped", all_of, "force", -1.0),
    "displacement of all with its sign flipped": scaled("sign_flipped", all_of, "displacement", -1.0),
    "channels of one sweep swapped": Edit("channels_swapped", SWEEP, swap_channels),
    "channels of a sine swapped": Edit("channels_swapped", SINE, swap_channels),
    "channels of all mechanical tests swapped": Edit("channels_swapped", mechanical, swap_channels),
    "clock of one sweep 5 % off": timed(SWEEP, 1.05),
    "sample rate of one sweep halved": timed(SWEEP, 2.0),
    "clock of all mechanical tests 5 % off": timed(mechanical, 1.05),
    "clock of one multisine 6 % off": timed(MULTISINE, 0.94),
    "clock of all tests 6 % off": timed(all_of, 0.94),
    "clock of the force 200 ppm fast in one sweep": drifting(SWEEP, 2e-4),
    "clock of the force 100 ppm slow in the first sweep": drifting(FIRST_SWEEP, -1e-4),
    "clock of the force 100 ppm fast in the last sweep": drifting(LAST_SWEEP, 1e-4),
    "clock of the force 80 ppm slow in one multisine": drifting(MULTISINE, -8e-5),
    "clock of the force 60 ppm fast in all": drifting(all_of, 6e-5),
    "force of one sweep 2 ms late": delayed(SWEEP, 2e-3),
    "force of all sweeps 4.5 ms late": delayed(sweeps, 4.5e-3),
    "force of all mechanical tests 1.6 ms late": delayed(mechanical, 1.6e-3),
    "one sine clipped at 60 %": Edit(
        "sensor_saturation", LARGEST_SINE, lambda r: change_channel(r, "force", clip(0.6))
    ),
    "one sweep clipped at 60 %": Edit("sensor_saturation", SWEEP, lambda r: change_channel(r, "force", clip(0.6))),
    "displacement of one sine clipped at 60 %": Edit(
        "sensor_saturation", LARGEST_SINE, lambda r: change_channel(r, "displacement", clip(0.6))
    ),
    "displacement of one sweep clipped at 20 %": Edit(
        "sensor_saturation", SWEEP, lambda r: change_channel(r, "displacement", clip(0.2))
    ),
    "one sine clipped at 10 %": Edit(
        "sensor_saturation", LARGEST_SINE, lambda r: change_channel(r, "force", clip(0.1))
    ),
    "force of one relaxation clipped where it rests": Edit(
        "sensor_saturation",
        STEP,
        lambda r: change_channel(r, "force", lambda v: np.maximum(v, v[:50].max() + 0.05 * np.ptp(v))),
    ),
    "force of one sweep drops out": Edit(
        "dead_channel", SWEEP, lambda r: change_channel(r, "force", drop_out(0.4, 0.45))
    ),
    "force of one sweep dead": Edit("dead_channel", SWEEP, lambda r: change_channel(r, "force", drop_out(0.0, 1.0))),
    "force of one sine nothing but noise": Edit(
        "dead_channel",
        SINE,
        lambda r: change_channel(r, "force", lambda v: np.resize(v[: max(v.size // 40, 8)], v.size)),
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
    "force of one sweep without samples for a while": Edit(
        "dead_channel", SWEEP, lambda r: lose(r, "force", 0.5, 0.62)
    ),
    "displacement of one relaxation without samples for a while": Edit(
        "dead_channel", pick("step", "mechanical", 0), lambda r: lose(r, "displacement", 0.4, 0.53)
    ),
    "force read 0.8 times from the seventh recording on": read_otherwise(from_seventh, 0.8),
    "force read 0.92 times from the fifth recording on": read_otherwise(from_fifth, 0.92),
    "force read 1.04 times where it is large": read_otherwise(with_large_force, 1.04),
    "film clamped anew from the seventh recording on": Edit(
        "specimen_changed", from_seventh, lambda r: change_channel(r, "force", scale_motion(0.8))
    ),
    "clamp mass ten times": filed(clamp_mass_kg=10.0),
    "clamp mass in g": filed(clamp_mass_kg=1e3),
    "load cell's stiffness ten times": filed(load_cell_stiffness_n_per_mm=10.0),
    "strain_pp of one sweep doubled": stated("strain_wrong", SWEEP, strain_pp=2.0),
    "strain_pp of all doubled": stated("strain_wrong", mechanical, strain_pp=2.0, instead=("size_wrong",)),
    "strain_pp of all sines halved": stated("strain_wrong", sines, strain_pp=0.5),
    "strain_pp of all mechanical tests but the first doubled": stated("strain_wrong", all_but_first, strain_pp=2.0),
    "thickness doubled": stated("size_wrong", all_of, film_thickness_mm=2.0),
    "length doubled": stated("size_wrong", all_of, film_length_mm=2.0, total_length_mm=2.0, instead=("strain_wrong",)),
    "width halved": stated("size_wrong", all_of, film_width_mm=0.5, active_width_mm=0.5),
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
