"""Levels of a recording, each against what is expected of it: by its own metadata, or by the other recordings.

A level is a logarithm of a ratio with its standard deviation: the amplitude seen over that stated, the rest force over
that of the other recordings. A fault moves some levels by amounts that it predicts and leaves the others.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.diagnose.features.kinds import RecordingFeatures
from pipeline.diagnose.features.observed import AMPLITUDE, FLAT, FLAT_INPUT, FREQUENCY, HELD, SEEN, STATED, VOLTAGE
from pipeline.diagnose.rules import RULES
from schemas.metadata import RigConstants

STRAIN, RATE, DRIVE, TENSION, SENSED, LENGTH, ACTUATION = (
    "strain", "rate", "drive", "tension", "sensed", "length", "actuation",
)  # fmt: skip
REST_FORCE = "rest_force_n"
"""The feature of a recording that is its tension before anything moves."""
NOISE = "noise "
"""Before a quantity: the level of its noise."""
_TOLD = "command"
"""The channel that is told and not measured: its noise is that of a generator's numbers, which differ by the kind of test."""
_NU = 10.0
"""Degrees of freedom of the distribution of levels: tails as heavy as those of habits in a laboratory."""
_SWEEP_READS = -0.03
"""Logarithm of what is read of the highest frequency of a sweep over what it is: its end is tapered."""
_FEWEST_OTHERS = 2
"""Fewest other recordings that make an expectation."""


@dataclass(frozen=True)
class Level:
    """ln of what is seen over what is expected, its standard deviation, and whether the sign is the opposite one."""

    value: float
    sd: float
    opposite: bool = False

    def z(self, shift: float = 0.0, opposite: bool = False) -> float:
        """Standard deviations from what a fault predicts."""
        return abs(self.value - shift) / self.sd + (RULES.fault.suspect if opposite != self.opposite else 0.0)


@dataclass(frozen=True)
class Levels:
    """Levels of one recording by name, and what is seen of it that no other recording need be asked for.

    foreign : whether its sizes are none of those of the other recordings, which have one film
    own_rig : whether its rig is by its constants none of that of the others, which have one
    flat, held : share of its samples on a flat top; quantity → share of the record in which it stands still
    clipped : the channel with the flat tops
    """

    by_name: Mapping[str, Level]
    foreign: bool
    flat: float
    held: Mapping[str, float]
    own_rig: bool = False
    clipped: str = "force"

    @property
    def is_suspect(self) -> bool:
        """Whether the recording must not be asked about the film before its levels are explained."""
        rules = RULES.fault
        odd = any(level.z() > rules.suspect for level in self.by_name.values())
        return odd or self.foreign or self.flat > rules.flat or max(self.held.values(), default=0.0) > rules.held

    def log_likelihood(
        self,
        shifts: Mapping[str, float],
        *,
        open_levels: frozenset[str] = frozenset(),
        may_open: frozenset[str] = frozenset(),
        flipped: bool = False,
    ) -> float:
        """Of the levels under a fault that moves some of them; `open_levels` may be anywhere, those that `may_open` be anywhere or as they
        are in the others, as likely; `flipped` turns the tension.

        Any level may stray without a fault: a load cell is tared, a range or a filter is changed.
        """
        rules, total = RULES.fault, 0.0
        for name, level in self.by_name.items():
            anywhere = -float(np.log(rules.anywhere / level.sd))
            if name in open_levels:
                total += anywhere
                continue
            z = level.z(shifts.get(name, 0.0), flipped and name == TENSION)
            expected = log_likelihood_of(z)
            if name in may_open:
                total += float(np.logaddexp(expected, anywhere)) - float(np.log(2))
                continue
            may_stray = name in (TENSION, SENSED) or name.startswith(NOISE)
            total += float(np.logaddexp(expected, np.log(rules.stray) + anywhere)) if may_stray else expected
        return total


def log_likelihood_of(z: float) -> float:
    """Of a level that many standard deviations from what is expected, less that of one as expected (Student's t)."""
    return -0.5 * (_NU + 1) * float(np.log1p(z**2 / _NU))


def read_levels(recordings: Sequence[RecordingFeatures]) -> tuple[Levels, ...]:
    """Levels of each recording of a session, in the order given."""
    return tuple(_read_one(recordings, i) for i in range(len(recordings)))


def _read_one(recordings: Sequence[RecordingFeatures], number: int) -> Levels:
    own, rules = recordings[number], RULES.fault
    others = [r for i, r in enumerate(recordings) if i != number]
    found: dict[str, Level] = {}
    for name, pair, sd in (
        (STRAIN, AMPLITUDE, rules.strain_sd), (DRIVE, VOLTAGE, rules.drive_sd), (RATE, FREQUENCY, rules.rate_sd),
    ):  # fmt: skip
        ratio = _compare_stated(own, pair)
        if ratio is not None:
            found[name] = Level(ratio, sd)
    if RATE in found and own.protocol == "chirp":
        found[RATE] = _compare_sweeps(
            found[RATE].value, [r for r in others if (r.protocol, r.loading) == (own.protocol, own.loading)]
        )
    for name, key in ((TENSION, REST_FORCE), (SENSED, "capacitance_rest_pf")):
        level = _compare_rest(own.values.get(key), [r.values[key] for r in others if key in r.values])
        if level is not None:
            found[name] = level
    found |= _compare_noise(own, others)
    flat = {"force": own.values.get(FLAT, 0.0), "displacement": own.values.get(FLAT_INPUT, 0.0)}
    return Levels(
        found,
        _is_foreign(own, others),
        max(flat.values()),
        {k.removeprefix(HELD): v for k, v in own.values.items() if k.startswith(HELD)},
        _has_own_rig(own, others),
        max(flat, key=lambda name: flat[name]),
    )


def _compare_stated(own: RecordingFeatures, pair: str) -> float | None:
    """ln of what is seen over what is stated, None where either is not known."""
    if STATED + pair not in own.values:
        return None
    return float(np.log(own.values[SEEN + pair] / own.values[STATED + pair]))


def _compare_sweeps(own: float, others: Sequence[RecordingFeatures]) -> Level:
    """How far a sweep goes against what it states: as the other sweeps do, for all of them are tapered at their end."""
    read = [v for r in others if (v := _compare_stated(r, FREQUENCY)) is not None]
    if not read or np.ptp(read) > RULES.fault.sweep_rate_sd:
        return Level(own - _SWEEP_READS, RULES.fault.sweep_rate_sd)
    return Level(own - float(np.median(read)), RULES.fault.sweep_alike_sd)


def read_sweeps(recordings: Sequence[RecordingFeatures]) -> float | None:
    """ln of the highest frequency that sweeps show over that stated, their taper apart: the median; None where none shows any."""
    read = [
        v - _SWEEP_READS
        for r in recordings
        if r.protocol == "chirp" and (v := _compare_stated(r, FREQUENCY)) is not None
    ]
    return float(np.median(read)) if read else None


def _compare_rest(own: float | None, others: Sequence[float]) -> Level | None:
    """A level at rest against that of the others, None where these do not agree about one."""
    if own is None or len(others) < _FEWEST_OTHERS or own == 0:
        return None
    middle = float(np.median(others))
    spread = float(np.median(np.abs(np.asarray(others) - middle))) / 0.6745
    if middle == 0 or spread > RULES.fault.rest_spread * abs(middle):
        return None
    sd = float(np.hypot(RULES.fault.rest_sd, spread / abs(middle)))
    return Level(float(np.log(abs(own / middle))), sd, bool(own * middle < 0))


def _compare_noise(own: RecordingFeatures, others: Sequence[RecordingFeatures]) -> dict[str, Level]:
    """Density of the noise of each channel against that of the same channel in the others."""
    found = {}
    expected = [read_density(r) for r in others]
    for name, value in read_density(own).items():
        known = [v for density in expected if (v := density.get(name, 0.0)) > 0]
        if len(known) >= _FEWEST_OTHERS and value > 0:
            found[NOISE + name] = Level(0.5 * float(np.log(value / np.median(known))), RULES.fault.noise_sd)
    return found


def read_density(features: RecordingFeatures) -> dict[str, float]:
    """Noise per Hz by quantity."""
    density: dict[str, list[float]] = {}
    for n in features.noise:
        if n.quantity == _TOLD:
            continue
        density.setdefault(n.quantity, []).append(float(np.median(n.power)) * n.interval_s)
    return {name: float(np.median(v)) for name, v in density.items()}


def _is_foreign(own: RecordingFeatures, others: Sequence[RecordingFeatures]) -> bool:
    """Whether the others have one film by their metadata, and this recording has another one."""
    if len(others) < _FEWEST_OTHERS:
        return False
    sizes = {_size(r) for r in others if r.loading == own.loading} or {_size(r) for r in others}
    return len(sizes) == 1 and _size(own) not in sizes


def _has_own_rig(own: RecordingFeatures, others: Sequence[RecordingFeatures]) -> bool:
    """Whether the others have one rig by their metadata, and this recording another one."""
    rigs = {name_clamp(r.rig) for r in others}
    return len(others) >= _FEWEST_OTHERS and len(rigs) == 1 and name_clamp(own.rig) not in rigs


def _size(features: RecordingFeatures) -> tuple[float, ...]:
    names = ("strain_length_mm", "actuation_n_per_kv2")
    return tuple(float(f"{features.values[n]:.6g}") for n in names if n in features.values)


def name_clamp(rig: RigConstants) -> tuple[float | None, ...]:
    """What makes two rigs two."""
    return rig.clamp_mass_kg, rig.load_cell_stiffness_n_per_mm, rig.load_cell_damping_n_s_per_mm
