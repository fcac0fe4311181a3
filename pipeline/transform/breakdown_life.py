"""The life that a record shows, as a row, with the evidence and in words what it leaves open.

Belongs here: the result of `breakdown` and how its parts become one. Does not belong here: the verdict itself.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from pipeline.transform.breakdown_falls import FAST_S
from pipeline.transform.breakdown_model import FAILED, posterior
from pipeline.transform.breakdown_signal import Trace
from schemas.life_covariates import from_metadata
from schemas.lifetimes import LifetimeRow
from schemas.metadata import RecordingMetadata

_SERIES = 3
_OPEN = " (not decided)"
"""Behind the likeliest reason of a life that the record does not tell: alone it would read as a fact."""
_CONFIRMS = {"leakage_current": ("jumps", "stays high"), "force": ("steps",)}
_SPEAKS_AGAINST = {
    "leakage_current": ("follows the voltage", "follows the voltage, slowly sampled", "goes on", "shows nothing"),
    "force": ("still", "silent"),
}
_WORDS = {
    "leakage_current": "the leakage current does not jump with the collapse",
    "force": "the force does not step with the collapse",
}


@dataclass(frozen=True, kw_only=True)
class Lifetime(LifetimeRow):
    """Life of the specimen of one recording, with the evidence.

    `start_s`, `end_s`: start of life and its end (breakdown or last sample survived) in s since the first sample of the
    voltage. `confirmed_by`: channels that change as they do in a breakdown. `contradicted_by`: recorded channels that do
    not. `dropouts`, `dips`, `interruptions`: lost samples of the monitor, falls that recovered but were no glitches, and
    times the command itself was off for a moment.
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
    """What happened on the way, filled while the falls are gone through."""

    glitches: int = 0
    dips: int = 0
    interruptions: int = 0
    doubtful: bool = False
    notes: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Verdict:
    """How the observation of a life ended, at sample `last`.

    `probabilities` of the causes of the fall that ended it (empty where nothing fell), `found` the evidence for them.
    """

    last: int
    failed: bool
    because: str | None = None
    decided: bool = True
    notes: tuple[str, ...] = ()
    probabilities: Mapping[str, float] = field(default_factory=dict)
    found: Mapping[str, str] = field(default_factory=dict)
    evidence: str | None = None

    def channels(self, outcomes: Mapping[str, tuple[str, ...]]) -> tuple[str, ...]:
        return tuple(name for name in ("force", "leakage_current") if self.found.get(name) in outcomes[name])


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
    broke: bool | None = None,
) -> Lifetime:
    """The life from `start_s` to `end_s` (s since the first sample of the voltage) with everything that was noted.

    `broke` says whether the film broke down in the end, where that is not the same as failing the test.
    """
    site = metadata.failure_site
    if broke is not None and site == "none":
        site = None  # it survived the fixed test, whatever came after
    broke = verdict.failed if broke is None else broke
    confirmed, against = verdict.channels(_CONFIRMS), verdict.channels(_SPEAKS_AGAINST)
    contradictions = _contradictions(site, verdict, broke=broke)
    notes = [*counts.notes, *verdict.notes, *contradictions]
    because = verdict.because
    if because is not None and not verdict.decided:
        because += _OPEN
    if counts.glitches >= _SERIES:
        notes.append(f"a series of {counts.glitches} glitches: a self-clearing film or a bad contact")
    if trace.dropouts:
        notes.append(f"{trace.dropouts} single samples of the monitor lost")
    if counts.interruptions:
        notes.append(f"the command was off for a moment {counts.interruptions} times")
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
        censored_because=because,
        glitches=counts.glitches,
        breakdown_voltage_kv=breakdown_voltage,
        failure_site=metadata.failure_site,
        failure_region=metadata.failure_region,
        test_duration_s=metadata.test_duration_s,
        staircase=staircase,
        decided=verdict.decided,
        probability_failed=verdict.probabilities.get("failed"),
        probability_switched_off=verdict.probabilities.get("switched off"),
        probability_supply=verdict.probabilities.get("supply"),
        probability_monitor=verdict.probabilities.get("monitor"),
        evidence=verdict.evidence,
        contradiction="; ".join(contradictions) or None,
        warnings=tuple(dict.fromkeys(notes)),
        temperature_c=metadata.temperature_c,
        humidity=metadata.humidity,
        frequency_hz=metadata.frequency_hz,
        electrode=metadata.electrode,
        batch=metadata.batch,
        covariates=from_metadata(metadata.extra, where=metadata.recording_id),
        start_s=start_s,
        end_s=end_s,
        confirmed_by=confirmed,
        contradicted_by=against,
        dropouts=trace.dropouts,
        dips=counts.dips,
        interruptions=counts.interruptions,
    )


def _contradictions(site: str | None, verdict: Verdict, *, broke: bool) -> tuple[str, ...]:
    """What speaks against the verdict: the `failure_site` that somebody wrote down, the current, the force.

    The site is held against what the rest of the record says, also where the site has turned the verdict.
    """
    found = []
    without = {name: outcome for name, outcome in verdict.found.items() if name != "failure_site"}
    shown = posterior(without)[FAILED] >= 0.5 if without else broke
    if shown and site == "none":
        found.append("a breakdown in the record, but failure_site is none")
    if not shown and site not in (None, "none", "unknown"):
        found.append(f"no breakdown in the record, but failure_site is {site}")
    if broke:
        found += [_WORDS[name] for name in verdict.channels(_SPEAKS_AGAINST)]
    elif "leakage_current" in verdict.channels(_CONFIRMS):
        found.append("the leakage current is that of a breakdown, the rest of the record is not")
    return tuple(found)
