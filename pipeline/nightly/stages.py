"""What a night makes, in four stages: the code and the settings that the results of each depend on.

    recording    what one content holds: its row, samples, previews, responses, results that the later stages take
    specimen     what the recordings of a specimen say together: averages, models, predictions
    diagnosis    what the simulation of a specimen gets wrong, and why
    group        what is said about many specimens at once: survival, force maps, weak regions

An item is one piece of a stage's work, named `stage:` and what it is about: the content by its SHA-256, the specimen,
the group. Also what the steps of a night share (`Night`). Does not belong here: how an item is made, which its task
knows (`pipeline.nightly.read`, `pipeline.nightly.derive`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from ingest.formats import identify_plugins
from pipeline.lab.annotations import Annotation
from pipeline.lab.journal import DIAGNOSIS, GROUP, RECORDING, SPECIMEN, Outcome
from pipeline.lab.lab import Lab
from pipeline.lab.settings import Settings
from pipeline.nightly.freshness import digest, hash_code
from pipeline.nightly.ledger import Ledger
from pipeline.nightly.workers import AnyTask, Casualty, Workers

SPECIMEN_KINDS = frozenset({"FrequencyResponse", "RelaxationCurve", "StepAnalysis", "CycleFits", "Coat"})
"""Kinds of carried results that make a specimen worth analysing."""
CALIBRATION_KINDS = frozenset({"TapCalibration", "WeightCalibration"})
"""Kinds of carried results that sharpen a rig's constants."""
DIAGNOSIS_KIND = "SessionFeatures"
"""The kind of carried result that diagnoses are made from; no other stage takes it, and it is large."""


@dataclass(frozen=True)
class Group:
    """One analysis over many specimens: the kinds of carried results it takes.

    `mention` is the key of the metadata without which a recording tells it nothing; None: it takes no metadata. The
    tables that it fills as a whole say so themselves (`schemas.tables.find_rows_made_by`).
    """

    kinds: frozenset[str]
    mention: str | None = None


GROUPS: Mapping[str, Group] = {
    "survival": Group(frozenset({"Lifetime", "LifetimeRow"})),
    "force_maps": Group(frozenset({"ForceMapReadings"})),
    "weak_regions": Group(frozenset({"Lifetime", "LifetimeRow"}), mention="rods"),
}


@dataclass(frozen=True)
class Stage:
    """One of the stages of a night.

    Parameters
    ----------
    name : what its items are named after
    modules : what its results depend on: the source of these modules, and of all of ours that they import, is the
        stage's code version. Code of the night that merely moves results about is no part of it.
    settings : the settings of the lab that its results depend on
    """

    name: str
    modules: tuple[str, ...]
    settings: tuple[str, ...] = ()

    def version(self, settings: Settings) -> tuple[str, str]:
        """Hash of its code, of the readers of other packages where it reads files, and of the settings that it uses."""
        code, plugins = hash_code(self.modules), identify_plugins() if self.name == RECORDING else ()
        return digest([code, *plugins]) if plugins else code, digest(settings.choose(self.settings))


STAGES: Mapping[str, Stage] = {
    stage.name: stage
    for stage in (
        Stage(
            RECORDING,
            ("ingest.intake", "ingest.samples", "pipeline.analyse.recording", "pipeline.analyse.carried"),
        ),
        Stage(
            SPECIMEN,
            ("pipeline.lab.inputs", "pipeline.analyse.inputs", "pipeline.analyse.specimen"),
            ("orders",),
        ),
        Stage(
            DIAGNOSIS,
            ("pipeline.lab.inputs", "pipeline.analyse.inputs", "pipeline.analyse.diagnosis"),
        ),
        Stage(
            GROUP,
            ("pipeline.lab.inputs", "pipeline.analyse.groups"),
        ),
    )
}
"""The stages in the order in which their results depend on each other."""


@dataclass(frozen=True)
class Night:
    """What the steps of a night share.

    Parameters
    ----------
    lab, settings : the lab, and what it chose
    ledger : what is known of every raw file, content and result, from earlier nights and from this one
    workers : where contents are read and results are made
    rigs : folder with rig files, None to look beside the recordings
    run_id, started_at : number and time of this night
    annotations : what people said about recordings before it began
    """

    lab: Lab
    settings: Settings
    ledger: Ledger
    workers: Workers
    rigs: Path | None
    run_id: str
    started_at: datetime
    annotations: Sequence[Annotation]

    def version(self, stage: str) -> tuple[str, str]:
        """Hash of a stage's code, and of the settings that it uses."""
        return STAGES[stage].version(self.settings)

    def perform(self, tasks: Iterable[AnyTask], count: int, what: str) -> Iterator[tuple[AnyTask, Outcome]]:
        """Has tasks done by the workers; outcomes as they are ready, also of those whose workers did not come back."""
        for task, result in self.workers.perform(tasks, count, what):
            yield task, task.give_up(result.reason) if isinstance(result, Casualty) else result
