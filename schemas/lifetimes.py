"""One row of the table `lifetimes`: how long a specimen lived under voltage, and why it is not known more precisely.

Whoever detects a breakdown or reads a table of lifetimes makes these rows; the survival analysis takes them. Detection
and statistics do not belong here.
"""

from __future__ import annotations

from dataclasses import dataclass

END_OF_TEST = "end of test"
SWITCHED_OFF = "switched off"
END_OF_RECORD = "end of record"
TRUNCATED = "record damaged"
GAP = "gap in the record"
SAGGED = "voltage sagged"
MONITOR_LOST = "monitor lost"
RAISED = "voltage raised after the fixed test"
"""Beginnings of `censored_because`; details may follow after a colon."""
OUTSIDE_THE_FILM = ("lead", "none")
"""Sites of failures that the thickness of the film says nothing about. One whose site nobody noted may be in the film."""


@dataclass(frozen=True, kw_only=True)
class LifetimeRow:
    """Life of one specimen in s at `voltage_kv`.

    `lifetime_s` counts from 95 % of the set voltage to the breakdown when `failed`, else it is the time survived and
    `censored_because` says why the observation ended. `glitches` counts collapses that recovered within 0.5 s;
    `breakdown_voltage_kv` is the voltage at breakdown where the voltage was being raised. `staircase` says
    that it rose before a fixed test was over: such a row has a breakdown voltage but no life at one voltage.
    `test_duration_s` is the planned duration. `decided` is false where the record cannot tell a breakdown from a
    switch-off, None where nobody asked (a table of lifetimes); `warnings` names that and all contradictions. The four
    probabilities are those of the causes of the fall of the voltage that ended the record (None where nothing fell);
    `evidence` says from what they come, `contradiction` what in the record speaks against the verdict.
    """

    specimen_id: str
    lifetime_s: float
    failed: bool
    recording_id: str | None = None
    configuration: str | None = None
    campaign: str | None = None
    voltage_kv: float | None = None
    censored_because: str | None = None
    glitches: int | None = None
    breakdown_voltage_kv: float | None = None
    failure_site: str | None = None
    failure_region: str | None = None
    test_duration_s: float | None = None
    staircase: bool = False
    decided: bool | None = None
    probability_failed: float | None = None
    probability_switched_off: float | None = None
    probability_supply: float | None = None
    probability_monitor: float | None = None
    evidence: str | None = None
    contradiction: str | None = None
    warnings: tuple[str, ...] = ()

    @property
    def undecided(self) -> bool:
        """The record cannot tell whether the film broke down."""
        return self.decided is False

    @property
    def probabilities(self) -> dict[str, float]:
        """Probability of each cause of the fall that ended the record; empty where nothing fell or nobody asked."""
        named = {
            "failed": self.probability_failed,
            "switched off": self.probability_switched_off,
            "supply": self.probability_supply,
            "monitor": self.probability_monitor,
        }
        return {cause: share for cause, share in named.items() if share is not None}

    @property
    def name(self) -> str:
        """How warnings call it: the specimen, with its recording where there is one."""
        return self.specimen_id if self.recording_id is None else f"{self.specimen_id} ({self.recording_id})"
