"""Sessions of rigs that were written apart from the pipeline, diagnosed from their raw files, beside what they hide.

A rig is a package with a module `rig` that has `KINDS` and `write_session(seed, kind, folder)`, which writes a session's raw
files and returns what is hidden (`tests/foreign/README.md`). Nothing here looks into a rig.
"""

from __future__ import annotations

import importlib
import math
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from ingest.canonical import canonical
from ingest.read import read_raw
from pipeline.analyse.diagnosis_tables import diagnosis_tables
from pipeline.diagnose.diagnosis import diagnose
from pipeline.diagnose.features.kinds import RecordingFeatures
from pipeline.diagnose.features.reduce import reduce
from pipeline.diagnose.results import Diagnosis
from schemas.errors import DealabError
from tests.helpers.contradictions import find_contradictions

FOLDER = Path(__file__).resolve().parent.parent / "foreign"
CLEAN, SINGLE, UNLISTED, PAIR, FAULT = "clean", "single", "unlisted", "pair", "fault"
KINDS = (CLEAN, SINGLE, UNLISTED, PAIR, FAULT)
_SHOWN, _RANKED = 8, 24
"""Hypotheses of a posterior that are kept, with their probabilities and with their odds."""
_TOLD = ("listed", "fault", "unlisted", "stage", "depends_on", "severity", "form_distance", "strength", "strength_alone",
         "noise", "session")  # fmt: skip


@dataclass(frozen=True)
class Asked:
    """A session that is asked of a rig."""

    rig: str
    seed: int
    kind: str


@dataclass(frozen=True)
class Answer:
    """What is hidden in a session, and what was said of it.

    `faults`: id, recordings, and the corrections proposed (key, value now, value proposed, probability) of the first of them.
    `failed`: why it could not be diagnosed; `refused`: recordings of which no features can be made, with the reason. `contradictions`:
    what the tables of the diagnosis say against each other; None where that was not asked. `study`: seed of the study in which it was
    asked, 0 for those before seeds were kept. `log_odds`: of the likeliest hypotheses against the first of them; None where they were not kept.
    """

    rig: str
    seed: int
    kind: str
    truth: Mapping[str, Any]
    verdict: str = ""
    named: tuple[str, ...] = ()
    possible: tuple[str, ...] = ()
    probabilities: Mapping[str, float] | None = None
    stage: str = ""
    depends_on: tuple[str, ...] = ()
    faults: tuple[Mapping[str, Any], ...] = ()
    gain: float | None = None
    p_value: float = 1.0
    has_function: bool = False
    recordings: int = 0
    seconds: float = 0.0
    failed: str = ""
    refused: tuple[str, ...] = ()
    contradictions: tuple[str, ...] | None = None
    study: int = 0
    log_odds: Mapping[str, float] | None = None

    def as_line(self) -> dict[str, Any]:
        """For a file of JSON lines."""
        return asdict(self)


def find_rigs(folder: Path = FOLDER) -> list[str]:
    """Names of the rigs in a folder."""
    return sorted(path.parent.name for path in folder.glob("*/rig.py"))


def write_session(asked: Asked, raw: Path, folder: Path = FOLDER) -> Mapping[str, Any]:
    """Writes a session's raw files; returns what is hidden."""
    if str(folder) not in sys.path:
        sys.path.insert(0, str(folder))
    rig = importlib.import_module(f"{asked.rig}.rig")
    return dict(rig.write_session(asked.seed, asked.kind, raw))


def read_session(raw: Path) -> tuple[list[RecordingFeatures], list[str]]:
    """Features of the recordings in a folder, and why there are none of others."""
    features, refused = [], []
    for path in sorted(raw.rglob("*.mcap")):
        try:
            features.append(reduce(canonical(read_raw(path, None), where=path.name)))
        except DealabError as error:
            refused.append(f"{path.name}: {error}")
    return features, refused


def is_within_file(told: Mapping[str, Any], features: Sequence[RecordingFeatures]) -> bool:
    """Whether rig constants alone are hidden, off by no more than two of the standard deviations that the rig's own file states: such a
    file is right."""
    if list(told["listed"]) != ["rig_constants"] or not features:
        return False
    rig, severity = features[0].rig, told["severity"]
    stated = {
        "mass_error": (rig.clamp_mass_kg, rig.clamp_mass_kg_sd),
        "stiffness_error": (rig.load_cell_stiffness_n_per_mm, rig.load_cell_stiffness_n_per_mm_sd),
    }
    return all(
        value is not None and sd is not None and abs(float(severity.get(name, 0.0))) <= 2 * sd / value
        for name, (value, sd) in stated.items()
    )


def answer_session(asked: Asked, folder: Path = FOLDER) -> Answer:
    """A session made, read and diagnosed."""
    with TemporaryDirectory() as place:
        told = write_session(asked, Path(place), folder)
        features, refused = read_session(Path(place))
    truth = {name: told.get(name) for name in _TOLD} | {"within_file": is_within_file(told, features)}
    begin = time.process_time()
    try:
        found = diagnose(features)
    except Exception as error:  # what ends a diagnosis is its answer, and no end of a study
        return Answer(asked.rig, asked.seed, asked.kind, truth, failed=repr(error), refused=tuple(refused))
    answer = _tell(asked, truth, found, len(features), time.process_time() - begin, tuple(refused))
    return replace(answer, contradictions=tuple(find_contradictions(diagnosis_tables(found, features), alone=False)))


def _tell(
    asked: Asked, truth: Mapping[str, Any], found: Diagnosis, recordings: int, seconds: float, refused: tuple[str, ...]
) -> Answer:
    ranked = sorted(found.probabilities.items(), key=lambda item: -item[1])
    likely = ranked[:_SHOWN]
    return Answer(
        asked.rig, asked.seed, asked.kind, truth,
        verdict=found.verdict,
        named=tuple(found.mechanisms),
        possible=tuple(found.also_possible),
        probabilities={name: round(p, 4) for name, p in likely},
        stage=found.stage or "",
        depends_on=tuple(found.depends_on),
        faults=tuple(
            {
                "id": f.cause,
                "recordings": list(f.recordings),
                "corrections": [
                    [c.key, c.value_now, c.value_proposed, round(c.probability, 3)]
                    for c in f.corrections
                    if c.recording_id == f.recordings[0]
                ],
            }
            for f in found.faults
        ),
        gain=None if found.held_out is None else round(found.held_out.gain, 3),
        p_value=found.p_value,
        has_function=bool(found.terms),
        recordings=recordings,
        seconds=round(seconds, 1),
        refused=refused,
        log_odds={name: round(math.log(p / likely[0][1]), 2) for name, p in ranked[:_RANKED] if p > 0},
    )  # fmt: skip
