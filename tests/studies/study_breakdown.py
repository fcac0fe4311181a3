"""How often is a breakdown wrongly censored, a survivor called failed, and how often does the detector leave it open?

    python -m tests.studies.study_breakdown [--generator FILE.py] [--n N] [--seed S] [--families a,b] [--wrong N]

Five families of collapse and five of survival, 1000 records each, from circuits (`breakdown_bench`); wanted are at most 1 % of collapses
wrongly censored and 0.5 % of survivals called failures. `--generator` asks any other, such as `breakdown_records`, on which the
detector's weights are fitted. A generator is a module with `draw(seed, family)`, which gives an object with `time_s` (n,) in s, `channels` (name →
(unit, (n,) values)), `metadata` and `truth` (failed, lifetime_s, family, decidable, last_above_90_s, visible_until_s,
broke_in_staircase), and with a list `FAMILIES` unless `--families` names them. `N` records are spread over the families.
"""

from __future__ import annotations

import argparse
import importlib.util
import sys
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from pipeline.transform.breakdown import detect_breakdown
from reports.pages.campaign.places import clopper_pearson
from schemas.errors import DealabError, RefusedError
from schemas.lifetimes import LifetimeRow
from schemas.metadata import RecordingMetadata, RigConstants
from schemas.quantities import QUANTITIES
from schemas.recording import Channel, Recording
from schemas.units import conversion
from tests.studies import breakdown_bench

MOST_CENSORED, MOST_FALSE = 0.01, 0.005
"""Shares that are wanted at most: of failures that are censored, of survivors that are called failed."""
_START_NS = 1_772_000_000_000_000_000
_SURE = {"recording_id": "drawn", "specimen_id": "S", "protocol": "lifetime", "loading": "electrical"}


def classify(recording: Recording) -> LifetimeRow:
    """What the detector says of a recording; a refusal is an undecided life of 0 with its reason as a warning."""
    try:
        return detect_breakdown(recording)
    except DealabError as error:
        reason = f"refused: {error}"
        return LifetimeRow(specimen_id="S", lifetime_s=0.0, failed=False, decided=False, warnings=(reason,))


def recording_of(drawn: Any) -> Recording:
    """A drawn record as a recording. A voltage in units of the converter has no scale: its set point is left out."""
    known = {f for f in RecordingMetadata.__dataclass_fields__ if f not in ("extra", "started_at")}
    metadata = _SURE | {k: v for k, v in drawn.metadata.items() if k in known and v is not None}
    stamps = _START_NS + np.round(np.asarray(drawn.time_s) * 1e9).astype(np.int64)
    channels = {}
    for name, (unit, values) in drawn.channels.items():
        values = np.asarray(values, dtype=np.float64)
        try:
            to = conversion(unit, QUANTITIES[name].unit)
            values = to.scale * values + to.offset
        except RefusedError:
            if name == "voltage":
                metadata.pop("voltage_setpoint_kv", None)
        channels[name] = Channel(name, stamps, values)
    about = RecordingMetadata(started_at=datetime(2026, 3, 1, tzinfo=UTC), **metadata)
    return Recording(about, RigConstants(), channels)


@dataclass
class Score:
    """What became of the records of one family; `wrong` names them."""

    records: int = 0
    decidable: int = 0
    censored: list[str] = field(default_factory=list)
    false: list[str] = field(default_factory=list)
    undecided: list[str] = field(default_factory=list)
    undecided_decidable: int = 0
    failures: int = 0
    late: list[float] = field(default_factory=list)
    staircases: int = 0
    staircase_voltages: int = 0

    def add(self, name: str, truth: dict[str, Any], found: LifetimeRow, interval: float) -> None:
        self.records += 1
        decidable = bool(truth.get("decidable", True))
        self.decidable += decidable
        self.failures += bool(truth["failed"]) and decidable
        failed = found.failed and not found.staircase  # a staircase has no life at one voltage
        if truth.get("broke_in_staircase"):
            self.staircases += 1
            self.staircase_voltages += found.breakdown_voltage_kv is not None
        if found.undecided:
            self.undecided.append(name)
            self.undecided_decidable += decidable
        elif truth["failed"] and not failed and decidable:
            self.censored.append(name)
        elif failed and not truth["failed"] and decidable:
            self.false.append(name)
        elif truth["failed"] and failed:
            self.late.append(abs(found.lifetime_s - truth["lifetime_s"]) / interval)

    def __add__(self, other: Score) -> Score:
        return Score(*(getattr(self, name) + getattr(other, name) for name in self.__dataclass_fields__))

    def __str__(self) -> str:
        survivors = self.decidable - self.failures
        parts = [f"{self.records:6d} records"]
        if self.failures:
            parts.append(f"wrongly censored {rate(len(self.censored), self.failures)}")
        if survivors:
            parts.append(f"false failures {rate(len(self.false), survivors)}")
        parts.append(f"undecided {rate(self.undecided_decidable, self.decidable)}")
        if self.decidable < self.records:
            hidden = self.records - self.decidable
            parts.append(
                f"of {hidden} that cannot be decided, {len(self.undecided) - self.undecided_decidable} said so"
            )
        if self.late:
            parts.append(f"life off by {np.median(self.late):.2f} samples (95 %: {np.quantile(self.late, 0.95):.1f})")
        if self.staircases:
            parts.append(f"breakdown voltage in {self.staircase_voltages} of {self.staircases} staircases")
        return "; ".join(parts)


def rate(number: int, of: int) -> str:
    """A share in per cent with its exact 95 % interval (Clopper and Pearson)."""
    if of == 0:
        return "none"
    low, high = clopper_pearson(number, of)
    return f"{100 * number / of:.2f} % ({100 * low:.2f} to {100 * high:.2f}, {number} of {of})"


def study(generator: ModuleType | Any, families: Iterable[str], records: int, seed: int) -> dict[str, Score]:
    """Scores per family, `records` spread over them."""
    scores: dict[str, Score] = defaultdict(Score)
    names = list(families)
    for number in range(records):
        family = names[number % len(names)]
        drawn = generator.draw(seed + number // len(names), family)
        interval = float(np.median(np.diff(drawn.time_s)))
        found = classify(recording_of(drawn))
        words = next((w for w in found.warnings if w.startswith("refused")), found.evidence or found.censored_because)
        name = f"{family} {seed + number // len(names)}, every {interval * 1e3:.3g} ms: {words}"
        scores[family].add(name, drawn.truth, found, interval)
    return dict(scores)


def _load(path: str | None) -> ModuleType:
    if path is None:
        return breakdown_bench
    spec = importlib.util.spec_from_file_location(Path(path).stem, path)
    if spec is None or spec.loader is None:
        raise SystemExit(f"{path} is no Python module")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def _report(scores: dict[str, Score], wrong: int) -> Iterator[str]:
    for family, score in scores.items():
        yield f"- {family}: {score}"
    total = sum(scores.values(), Score())
    yield f"- all: {total}"
    for title, names in (
        ("wrongly censored", total.censored),
        ("false failure", total.false),
        ("undecided", total.undecided),
    ):
        yield from (f"  {title}: {name}" for name in names[:wrong])


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--generator", help="path of a module with draw(seed, family); the bench without it")
    parser.add_argument("--families", help="names, separated by commas; all that the module lists without it")
    parser.add_argument("--n", type=int, default=10_000, help="records of all families together")
    parser.add_argument("--seed", type=int, default=20_260_301)
    parser.add_argument("--wrong", type=int, default=0, help="so many verdicts of each kind of mistake are shown")
    arguments = parser.parse_args()
    generator = _load(arguments.generator)
    families = arguments.families.split(",") if arguments.families else getattr(generator, "FAMILIES", None)
    if not families:
        raise SystemExit("the generator lists no FAMILIES: name them with --families")
    scores = study(generator, families, arguments.n, arguments.seed)
    for line in _report(scores, arguments.wrong):
        print(line)
    total = sum(scores.values(), Score())
    censored = len(total.censored) > MOST_CENSORED * total.failures
    return int(censored or len(total.false) > MOST_FALSE * (total.decidable - total.failures))


if __name__ == "__main__":
    sys.exit(main())
