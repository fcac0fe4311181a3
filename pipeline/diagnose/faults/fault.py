"""What a fault of everyday life is: its cause, the recordings it is in, and what would put it right. Types, and how they say sizes."""

from __future__ import annotations

from dataclasses import dataclass

from schemas.numbers import significant

UNIT_SLIP, SIGN_FLIPPED, CHANNELS_SWAPPED = "unit_slip", "sign_flipped", "channels_swapped"
SAMPLE_RATE_WRONG, CLOCK_DRIFT, CHANNEL_SKEW = "sample_rate_wrong", "clock_drift", "channel_skew"
STRAIN_WRONG, SIZE_WRONG = "strain_wrong", "size_wrong"
DEAD_CHANNEL, FOREIGN_RECORDING, FOREIGN_RIG = "dead_channel", "foreign_recording", "foreign_rig"
SPECIMEN_CHANGED = "specimen_changed"


@dataclass(frozen=True)
class Correction:
    """What would put a recording right.

    Parameters
    ----------
    key : of the recording's metadata (`strain_pp`), its mapping (`columns.force.scale`) or its rig's file
        (`rig.clamp_mass_kg`)
    value_now, value_proposed : as they would be written; empty where nothing is written now
    probability : that this is what is wrong
    """

    recording_id: str
    cause: str
    key: str
    value_now: str
    value_proposed: str
    probability: float


@dataclass(frozen=True)
class Fault:
    """One fault.

    Parameters
    ----------
    cause : its id
    recordings : ids of those it is in, in the order of the session
    probability : posterior probability of the cause, given that the recordings are as they are
    finding : what shows it, a sentence without its end
    corrections : what would put it right, the most probable first
    sets_aside : whether the recordings are left out of the diagnosis of the others; else they are put right in it
    bars : whether nothing else can be asked of the session before it is put right
    alike : mechanisms that would show in the same way
    left_per_value : χ² per value that the recordings leave once they are put right, NaN where they cannot be
    """

    cause: str
    recordings: tuple[str, ...]
    probability: float
    finding: str
    corrections: tuple[Correction, ...] = ()
    sets_aside: bool = True
    left_per_value: float = float("nan")
    bars: bool = False
    alike: tuple[str, ...] = ()


def say_times(factor: float) -> str:
    """How far off a value is, recorded over true, in words."""
    return (
        f"{significant(factor, 3)} times too large" if factor >= 1 else f"{significant(1 / factor, 3)} times too small"
    )
