"""One row of the table `lifetimes`: how long a specimen lived under voltage, and why it is not known more precisely.

Whoever detects a breakdown or reads a table of lifetimes makes these rows; the survival analysis takes them. Detection
and statistics do not belong here.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass

from schemas.life_covariates import OwnCovariate

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

FILM, LEAD, EDGE, ELECTRODE, OTHER = "film", "lead", "edge", "electrode", "other"
FAILURE_MODES = (FILM, LEAD, EDGE, ELECTRODE, OTHER)
"""What failures are told apart by when modes compete, whatever a laboratory calls them."""
_MODE_OF_SITE: Mapping[str, str] = {"rod": FILM, "active": FILM, "lead": LEAD, "edge": EDGE}
_WORDS_OF_MODES: Mapping[str, tuple[str, ...]] = {
    LEAD: (
        "lead",
        "leads",
        "contact",
        "wire",
        "cable",
        "connector",
        "feed",
        "tab",
        "terminal",
        "solder",
        "zuleitung",
        "anschluss",
        "kontakt",
        "kabel",
        "connexion",
        "fil",
    ),
    EDGE: (
        "edge",
        "border",
        "rim",
        "margin",
        "flashover",
        "frame",
        "clamp",
        "rand",
        "elektrodenrand",
        "kante",
        "klemme",
        "einspannung",
        "grip",
        "mors",
        "bord",
        "cadre",
    ),
    ELECTRODE: (
        "electrode",
        "electrodes",
        "carbon",
        "coating",
        "delamination",
        "delaminated",
        "conductivity",
        "elektrode",
        "ablösung",
        "électrode",
    ),
    FILM: (
        "film",
        "membrane",
        "dielectric",
        "breakdown",
        "pinhole",
        "puncture",
        "punctured",
        "tear",
        "rod",
        "active",
        "folie",
        "fläche",
        "durchschlag",
        "durchgeschlagen",
        "riss",
        "loch",
        "mitte",
        "claquage",
    ),
}
"""The first mode with a word in the text counts: "breakdown at the lead" is one of the lead."""
_LEAST_OF_COMPOUND = 5
"""Letters of a word that counts as well where another one begins with it: `Anschlussfehler`, `connectors`."""


def classify_failure_mode(written: str) -> str:
    """The failure mode that a laboratory's own words mean; `other` where none of its words is known.

    Parameters
    ----------
    written : as it stands in the table
    """
    words = re.findall(r"[^\W\d_]+", written.lower())
    for mode, known in _WORDS_OF_MODES.items():
        begins = tuple(word for word in known if len(word) >= _LEAST_OF_COMPOUND)
        if any(word in known or word.startswith(begins) for word in words):
            return mode
    return OTHER


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

    Where a failure was only found at an inspection, `lifetime_s` is that inspection and `alive_at_s` the last one before
    it that found the specimen alive (0: there was none, the life is left-censored); None: the life is known exactly, or
    right-censored. `entered_s` is the age at which the specimen came under watch where that is not 0: one that had
    failed before would not be in the table. `failure_mode` is one of `FAILURE_MODES`, `written_mode` what the table
    says. `temperature_c`, `humidity` (0 to 1), `frequency_hz` (of an alternating voltage), `electrode` and `batch` are
    what the life may depend on beside the voltage, `covariates` what else the laboratory says it may depend on.
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
    alive_at_s: float | None = None
    entered_s: float | None = None
    failure_mode: str | None = None
    written_mode: str | None = None
    temperature_c: float | None = None
    humidity: float | None = None
    frequency_hz: float | None = None
    electrode: str | None = None
    batch: str | None = None
    covariates: tuple[OwnCovariate, ...] = ()

    @property
    def undecided(self) -> bool:
        """The record cannot tell whether the film broke down."""
        return self.decided is False

    @property
    def mode(self) -> str | None:
        """The mode of a failure: as the table says, else that of the failure site; None where neither tells it."""
        return (self.failure_mode or _MODE_OF_SITE.get(self.failure_site or "")) if self.failed else None

    def condition(self, name: str) -> float | str | None:
        """What the life may depend on, by its name: a member of its own, or one of the laboratory's covariates."""
        if name in self.__dataclass_fields__:
            found: float | str | None = getattr(self, name)
            return found
        return next((one.value for one in self.covariates if one.name == name), None)

    @property
    def lower_s(self) -> float:
        """What the life is known to be not shorter than, in s."""
        return self.lifetime_s if self.alive_at_s is None or not self.failed else self.alive_at_s

    @property
    def upper_s(self) -> float:
        """What the life is known to be not longer than, in s; infinite for a survivor."""
        return self.lifetime_s if self.failed else math.inf

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
