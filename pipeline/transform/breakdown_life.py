"""The life that a record shows, as a row, with the evidence and in words what it leaves open.

Belongs here: the result of `breakdown` and how its parts become one. Does not belong here: the verdict itself.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from pipeline.transform.breakdown_falls import FAST_S
from pipeline.transform.breakdown_signal import Trace
from schemas.lifetimes import LifetimeRow
from schemas.metadata import RecordingMetadata

_SERIES = 3


@dataclass(frozen=True, kw_only=True)
class Lifetime(LifetimeRow):
    """Life of the specimen of one recording, with the evidence.

    `start_s`, `end_s`: start of life and its end (breakdown or last sample survived) in s since the first sample of the
    voltage. `confirmed_by`: channels that step in the tenth of a second of the breakdown. `contradicted_by`: recorded
    channels that do not. `dropouts`, `dips`, `interruptions`: lost samples of the monitor, falls that recovered but were
    no glitches, and times the command itself was off for a moment.
    """

    start_s: float
    end_s: float
    confirmed_by: tuple[str, ...] = ()
    contradicted_by: tuple[str, ...] = ()
    dropouts: int = 0
    dips: int = 0
    interruptions: int = 0


@dataclass
class Counts:
    """What happened on the way, filled while the events are gone through."""

    glitches: int = 0
    dips: int = 0
    interruptions: int = 0
    notes: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Verdict:
    """How the observation of a life ended, at sample `last`."""

    last: int
    failed: bool
    because: str | None = None
    decided: bool = True
    notes: tuple[str, ...] = ()
    confirmed_by: tuple[str, ...] = ()
    contradicted_by: tuple[str, ...] = ()


def lifetime(
    metadata: RecordingMetadata,
    trace: Trace,
    counts: Counts,
    verdict: Verdict,
    start_s: float,
    end_s: float,
    *,
    breakdown_voltage: float | None = None,
    staircase: bool = False,
) -> Lifetime:
    """The life from `start_s` to `end_s` (s since the first sample of the voltage) with everything that was noted."""
    notes = [*counts.notes, *verdict.notes]
    if counts.glitches >= _SERIES:
        notes.append(f"a series of {counts.glitches} glitches: a self-clearing film or a bad contact")
    if trace.dropouts:
        notes.append(f"{trace.dropouts} single samples of the monitor lost")
    if counts.interruptions:
        notes.append(f"the command was off for a moment {counts.interruptions} times")
    if verdict.failed and "force" in verdict.contradicted_by:
        notes.append("the force does not step with the collapse")
    if verdict.failed and "leakage_current" in verdict.contradicted_by:
        notes.append("the leakage current does not jump with the collapse")
    if trace.interval > FAST_S:
        notes.append(f"sampled every {trace.interval * 1e3:.3g} ms: falls within 20 ms are not resolved")
    return Lifetime(
        specimen_id=metadata.specimen_id,
        recording_id=metadata.recording_id,
        configuration=metadata.configuration,
        campaign=metadata.campaign,
        voltage_kv=trace.set_point,
        lifetime_s=max(end_s - start_s, 0.0),
        failed=verdict.failed,
        censored_because=verdict.because,
        glitches=counts.glitches,
        breakdown_voltage_kv=breakdown_voltage,
        failure_site=metadata.failure_site,
        failure_region=metadata.failure_region,
        test_duration_s=metadata.test_duration_s,
        staircase=staircase,
        decided=verdict.decided,
        warnings=tuple(dict.fromkeys(notes)),
        start_s=start_s,
        end_s=end_s,
        confirmed_by=verdict.confirmed_by,
        contradicted_by=verdict.contradicted_by,
        dropouts=trace.dropouts,
        dips=counts.dips,
        interruptions=counts.interruptions,
    )


def site_contradiction(metadata: RecordingMetadata, *, failed: bool) -> tuple[str, ...]:
    """What the record shows against the `failure_site` that somebody wrote down."""
    site = metadata.failure_site
    if failed and site == "none":
        return ("a breakdown in the record, but failure_site is none",)
    if not failed and site not in (None, "none", "unknown"):
        return (f"no breakdown in the record, but failure_site is {site}",)
    return ()
