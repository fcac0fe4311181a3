"""The items of the stages: what they are called, what they are made from, which rows are theirs.

Light on purpose: the night plans with this module, only the workers import what the stages compute with.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ingest.discover import SourceFile
from ingest.rigs import find_rig
from pipeline.analyse.inputs import RecordingInput
from pipeline.analyse.rows.recordings import recordings_table, refused_row
from pipeline.lab.journal import FAILED, QUARANTINED, Freshness, Outcome, write_entry
from pipeline.lab.paths import source_text
from pipeline.nightly.freshness import digest
from schemas.errors import DealabError

RECORDING, SPECIMEN, DIAGNOSIS, GROUP = "recording", "specimen", "diagnosis", "group"
MODULES: Mapping[str, str] = {
    RECORDING: "pipeline.nightly.stage_recording",
    SPECIMEN: "pipeline.nightly.stage_specimen",
    DIAGNOSIS: "pipeline.nightly.stage_diagnosis",
    GROUP: "pipeline.nightly.stage_groups",
}
"""The module of each stage: it has `run(task)`, and its source, with all it imports, is the stage's code version."""

RECORDING_TABLES: Mapping[str, str] = {
    "previews": "true",
    "frequency_responses": "stage = 'measured'",
    "distortions": "true",
    "lifetimes": "true",
    "slow_changes": "true",
    "loop_responses": "true",
    "electrode_cycles": "true",
    "electrode_migrations": "true",
    "calibrations": "true",
    "cycle_fits": "true",
    "cycle_curves": "true",
    "carried": "true",
}
"""Tables with rows of the recording stage, by recording_id, and which of their rows these are."""

SPECIMEN_TABLES: Mapping[str, str] = {
    "frequency_responses": "stage <> 'measured'",
    "model_fits": "coalesce(extension, '') = ''",
    "predictions": "true",
    "order_ladders": "true",
    "step_responses": "true",
    "sensing_fits": "true",
    "controller_gains": "true",
    "electrode_coats": "true",
    "coverage_fits": "true",
}
"""Tables with rows of the specimen stage, by specimen_id, and which of their rows these are."""

DIAGNOSIS_TABLES: Mapping[str, str] = {
    "diagnoses": "true",
    "discrepancies": "true",
    "diagnosis_candidates": "true",
    "diagnosis_parameters": "true",
    "diagnosis_blocks": "true",
    "diagnosis_curves": "true",
    "model_fits": "coalesce(extension, '') <> ''",
}
"""Tables with rows of the diagnosis stage, by specimen_id, and which of their rows these are."""

SPECIMEN_KINDS = frozenset({"FrequencyResponse", "RelaxationCurve", "StepAnalysis", "CycleFits", "Coat"})
"""Kinds of carried results that make a specimen worth analysing."""
CALIBRATION_KINDS = frozenset({"TapCalibration", "WeightCalibration"})
"""Kinds of carried results that sharpen a rig's constants."""
DIAGNOSIS_KIND = "SessionFeatures"
"""The kind of carried result that diagnoses are made from; no other stage takes it, and it is large."""


@dataclass(frozen=True)
class Group:
    """One analysis over many specimens: the kinds of carried results it takes, the tables it fills as a whole.

    `mention` is the key of the metadata without which a recording tells it nothing; None: it takes no metadata.
    """

    kinds: frozenset[str]
    tables: tuple[str, ...]
    mention: str | None = None


GROUPS: Mapping[str, Group] = {
    "survival": Group(
        frozenset({"Lifetime", "LifetimeRow"}),
        (
            "survival_curves",
            "survival_summaries",
            "survival_comparisons",
            "lifetime_distributions",
            "failure_causes",
            "voltage_life",
            "voltage_residuals",
        ),
    ),
    "force_maps": Group(frozenset({"ForceMapReadings"}), ("force_maps", "force_map_fits", "force_comparisons")),
    "weak_regions": Group(
        frozenset({"Lifetime", "LifetimeRow"}), ("weak_regions", "electrode_layouts", "film_maps"), mention="rods"
    ),
}


def item_id(stage: str, name: str) -> str:
    """The name of an item: its stage and the content, specimen or group that it is about."""
    return f"{stage}:{name}"


def perform(task: RecordingTask | DerivedTask) -> Outcome:
    """Runs a task in whatever process this is, and keeps its results in the journal."""
    outcome: Outcome = importlib.import_module(MODULES[task.stage]).run(task)
    return outcome


@dataclass(frozen=True)
class RecordingTask:
    """One content to be read.

    Parameters
    ----------
    source : the file, its mapping, and its size and time when it was hashed
    sha256 : of its content
    rigs : folder of rig files, None to look beside the recordings
    lab : the lab's folder
    staged : file that gets the samples, until the recording is accepted
    journal : folder that gets the results
    code_version, settings_hash : of the stage, as the night began
    """

    source: SourceFile
    sha256: str
    rigs: Path | None
    lab: Path
    staged: Path
    journal: Path
    code_version: str
    settings_hash: str
    stage: str = RECORDING

    @property
    def item_id(self) -> str:
        return item_id(RECORDING, self.sha256)


@dataclass(frozen=True)
class DerivedTask:
    """An item made from the results of recordings.

    Parameters
    ----------
    item_id, stage : which item; its name after the colon is what it is about
    freshness : what it is made from
    recordings : its recordings' results
    journal : folder that gets the results
    calibrations : results of the calibrations of their rigs
    settings : settings of the stage
    snapshot, members : of a group, the published database, None where nothing of it is needed, and a file that says where
        the results of its recordings are (`pipeline.lab.inputs`): there may be many thousand, so the worker fetches them,
        not the night
    """

    item_id: str
    stage: str
    freshness: Freshness
    recordings: tuple[RecordingInput, ...]
    journal: Path
    calibrations: tuple[RecordingInput, ...] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)
    snapshot: Path | None = None
    members: Path | None = None

    @property
    def name(self) -> str:
        return self.item_id.partition(":")[2]


def mapping_hash(source: SourceFile) -> str:
    """Hash of a file's mapping; of its error where it is wrong or there is none."""
    return source.mapping.hash if source.mapping is not None else digest(str(source.error))


def input_hash(mapping_hash: str, sha256: str, rig_hash: str) -> str:
    """Hash of what the results of a file are made from: its content, its mapping and its rig's file."""
    return digest([sha256, mapping_hash, rig_hash])


def rig_hash(source: SourceFile, rig_id: str | None, rigs: Path | None) -> str:
    """Hash of the file of a recording's rig; of its error where it is wrong, empty where there is none."""
    try:
        rig = find_rig(rig_id, source.path, root=source.root, rigs=rigs)
    except DealabError as error:
        return digest(str(error))
    return "" if rig is None else rig.hash


def recording_casualty(task: RecordingTask, reason: str) -> Outcome:
    """The outcome of a file whose worker did not come back, kept like any other."""
    problem = DealabError(
        f"reading or analysing it failed twice: {reason}",
        where=task.source.path.name,
        remedy="Raise deadline_s or memory_mb in the lab's settings.toml if the file is fine",
    )
    row = refused_row({}, str(problem), "recording") | {
        "source_path": source_text(task.source),
        "source_sha256": task.sha256,
        "source_present": True,
    }
    made_from = input_hash(mapping_hash(task.source), task.sha256, rig_hash(task.source, None, task.rigs))
    outcome = Outcome(
        task.item_id,
        task.stage,
        Freshness(made_from, task.code_version, task.settings_hash),
        QUARANTINED,
        0.0,
        reason,
        {"rig_id": None, "status": QUARANTINED, "problem": str(problem), "refusal": as_facts(problem)},
    )
    write_entry(task.journal, outcome, {"recordings": recordings_table([row])})
    return outcome


def derived_casualty(task: DerivedTask, reason: str) -> Outcome:
    """The outcome of an item whose worker did not come back, kept like any other."""
    outcome = Outcome(task.item_id, task.stage, task.freshness, FAILED, 0.0, f"failed twice: {reason}")
    write_entry(task.journal, outcome, {})
    return outcome


def as_facts(problem: DealabError) -> dict[str, str]:
    """An error as plain values; `DealabError(**facts)` is it again."""
    return {
        "problem": problem.problem,
        "where": problem.where,
        "expected": problem.expected,
        "remedy": problem.remedy,
    }
