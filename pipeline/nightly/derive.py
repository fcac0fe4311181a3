"""The night's third step: specimens, diagnoses and groups, made again in workers where their recordings changed.

Does not belong here: what is computed (`pipeline.analyse`), how results of recordings are fetched
(`pipeline.lab.inputs`).
"""

from __future__ import annotations

import contextlib
import functools
import itertools
import tempfile
import time
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from operator import attrgetter
from pathlib import Path
from typing import Any

from pipeline.analyse.analysis import Analysis
from pipeline.analyse.inputs import RecordingInput
from pipeline.lab.inputs import Included, fetch_inputs, fetch_results, read_members, split_kinds, write_members
from pipeline.lab.journal import (
    ACCIDENT,
    DIAGNOSIS,
    FAILED,
    GROUP,
    OK,
    SPECIMEN,
    Freshness,
    Outcome,
    is_accident,
    make_item_id,
    write_entry,
)
from pipeline.lab.reader import Reader, open_published
from pipeline.nightly.freshness import digest_lists, leave_out_fresh
from pipeline.nightly.ledger import book_accident, book_outcomes
from pipeline.nightly.stages import (
    CALIBRATION_KINDS,
    DIAGNOSIS_KIND,
    GROUPS,
    SPECIMEN_KINDS,
    STAGES,
    Night,
)
from schemas.errors import DealabError, LabError

_Calibrations = Callable[[frozenset[str]], tuple[Included, ...]]
_RIGS_AT_ONCE = 32
"""Sets of rigs whose calibrations are remembered."""
_INCLUDED = "SELECT * FROM included WHERE"
_FIRST = {DIAGNOSIS: 0, GROUP: 1, SPECIMEN: 2}
"""None needs another's result. The longest come first, so that no worker is left alone with one at the end."""


@dataclass(frozen=True)
class DerivedTask:
    """An item to be made from the results of recordings.

    Parameters
    ----------
    item_id, stage : which item; its name after the colon is what it is about
    freshness : what it is made from
    recordings : its recordings' results
    journal : folder that gets the results
    calibrations : results of the calibrations of their rigs
    settings : settings of the stage
    snapshot, members : of a group, the published database, None where nothing of it is needed, and a file that says
        where the results of its recordings are (`pipeline.lab.inputs`): there may be many thousand, so the worker
        fetches them, not the night
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

    def perform(self) -> Outcome:
        """Makes the item and keeps its results. Whatever goes wrong ends as an outcome with its reason.

        Raises
        ------
        LabError : the lab cannot be read or written
        MemoryError : memory ends
        """
        started, accident = time.monotonic(), False
        try:
            analysis = _ANALYSES[self.stage](self)
        except (LabError, MemoryError):
            raise
        except DealabError as error:
            analysis = Analysis(failures=[str(error)])
        except Exception as error:
            analysis = Analysis(failures=[f"{type(error).__name__}: {error}\n{traceback.format_exc()}"])
            accident = is_accident(error)
        outcome = self._describe(analysis, round(time.monotonic() - started, 3), accident=accident)
        write_entry(self.journal, outcome, analysis.joined())
        return outcome

    def give_up(self, reason: str) -> Outcome:
        """Keeps that the item's worker did not come back: failed, until the next night tries again."""
        outcome = self._describe(Analysis(failures=[f"failed twice: {reason}"]), 0.0, accident=True)
        write_entry(self.journal, outcome, {})
        return outcome

    def _describe(self, analysis: Analysis, seconds: float, *, accident: bool) -> Outcome:
        """How making the item ended. An accident is made from nothing that could be the same the next night."""
        return Outcome(
            self.item_id,
            self.stage,
            replace(self.freshness, input_hash="") if accident else self.freshness,
            FAILED if analysis.failures else OK,
            seconds,
            "\n".join(analysis.failures) or None,
            {"notes": analysis.notes, ACCIDENT: accident},
        )


def _analyse_specimen(task: DerivedTask) -> Analysis:
    from pipeline.analyse.inputs import measured
    from pipeline.analyse.specimen import analyse_specimen

    recordings, calibrations = (tuple(map(measured, given)) for given in (task.recordings, task.calibrations))
    return analyse_specimen(task.name, recordings, calibrations, orders=tuple(task.settings["orders"]))


def _analyse_diagnosis(task: DerivedTask) -> Analysis:
    from pipeline.analyse.diagnosis import analyse_diagnosis
    from pipeline.analyse.inputs import measured

    recordings, calibrations = (tuple(map(measured, given)) for given in (task.recordings, task.calibrations))
    return analyse_diagnosis(task.name, recordings, calibrations)


def _analyse_group(task: DerivedTask) -> Analysis:
    from pipeline.analyse.groups import ANALYSES

    group = GROUPS[task.name]
    members = () if task.members is None else read_members(task.members, task.journal)
    with contextlib.nullcontext() if task.snapshot is None else Reader(task.snapshot) as reader:
        given = fetch_results(members, reader, group.kinds, mention=group.mention)
    return ANALYSES[task.name](given)


_ANALYSES: Mapping[str, Callable[[DerivedTask], Analysis]] = {
    SPECIMEN: _analyse_specimen,
    DIAGNOSIS: _analyse_diagnosis,
    GROUP: _analyse_group,
}
"""What the results of each stage say is up to the modules that are imported here (`Stage.modules`)."""


@dataclass(frozen=True)
class _Item:
    """An item about a specimen and the recordings that it is made from."""

    item_id: str
    stage: str
    recordings: tuple[Included, ...]
    calibrations: tuple[Included, ...] = ()

    @property
    def input_hash(self) -> str:
        return digest_lists(map(_identify, part) for part in (self.recordings, self.calibrations))


def derive_results(night: Night) -> None:
    """Makes what is not fresh of all that follows from the included recordings, which is booked as `derived`."""
    ledger = night.ledger
    ledger.add("derived", _list_all_items(night))
    ledger.run("INSERT INTO expected SELECT item_id, stage, input_hash FROM derived")
    for stage in _FIRST:
        leave_out_fresh(ledger, stage, *night.version(stage))
    _make_stale(night)


def list_items(specimen_id: str, recordings: Iterable[Included], calibrations: _Calibrations) -> Iterator[_Item]:
    """The items of a specimen.

    A diagnosis is one of them where the specimen was measured in a way that a model describes, also where the diagnosis
    will have nothing to say.
    """
    recordings = tuple(recordings)
    fitted = tuple(one for one in recordings if one.kinds & SPECIMEN_KINDS)
    if fitted:
        yield _Item(make_item_id(SPECIMEN, specimen_id), SPECIMEN, fitted, calibrations(_name_rigs(fitted)))
    asked = tuple(one for one in recordings if one.kinds & (SPECIMEN_KINDS | {DIAGNOSIS_KIND}))
    if any(not one.kinds & CALIBRATION_KINDS for one in asked):
        yield _Item(make_item_id(DIAGNOSIS, specimen_id), DIAGNOSIS, asked, calibrations(_name_rigs(asked)))


def _name_rigs(recordings: Iterable[Included]) -> frozenset[str]:
    return frozenset(one.rig_id for one in recordings if one.rig_id is not None)


def _list_all_items(night: Night) -> Iterator[tuple[Any, ...]]:
    """All items, each with its stage, what it is made from and how many recordings that is."""
    of_rigs = _find_calibrations(night)
    with_specimen = _list_included(night, f"{_INCLUDED} specimen_id IS NOT NULL ORDER BY specimen_id, recording_id")
    for specimen_id, members in itertools.groupby(with_specimen, attrgetter("specimen_id")):
        for item in list_items(specimen_id, members, of_rigs):
            yield item.item_id, item.stage, item.input_hash, len(item.recordings)
    for name in GROUPS:
        count = itertools.count()
        identities = (_identify(one) for one, _ in zip(_list_members(night, name), count, strict=False))
        input_hash = digest_lists((identities, ()))
        if number := next(count):
            yield make_item_id(GROUP, name), GROUP, input_hash, number


def _make_stale(night: Night) -> None:
    ledger = night.ledger
    count = ledger.number("SELECT count(*) FROM expected JOIN derived USING (item_id)")
    if not count:
        return
    # Groups fetch what they need themselves.
    alone = not ledger.number(
        "SELECT count(*) FROM expected JOIN derived d USING (item_id) WHERE d.stage <> ?", [GROUP]
    )
    with (
        contextlib.nullcontext() if alone else open_published(night.lab.database) as reader,
        tempfile.TemporaryDirectory(prefix="members-", dir=night.lab.work) as folder,
    ):
        for _, outcome in night.perform(_make_tasks(night, reader, Path(folder)), count, "analyses"):
            book_outcomes(ledger, [outcome], done=True)
            if outcome.accident:
                book_accident(ledger, outcome, night.run_id)


def _make_tasks(night: Night, reader: Reader | None, folder: Path) -> Iterator[DerivedTask]:
    """The tasks of what has to be made, with what they are made from: fetched here, or where to fetch it."""
    of_rigs = _find_calibrations(night)
    place = " ".join(f"WHEN '{stage}' THEN {number}" for stage, number in _FIRST.items())
    stale = night.ledger.each(
        "SELECT item_id, d.stage, d.input_hash FROM expected JOIN derived d USING (item_id)"
        f" ORDER BY CASE d.stage {place} END, CASE d.stage WHEN '{DIAGNOSIS}' THEN -members END, item_id"
    )
    for item, stage, input_hash in stale:
        task = DerivedTask(item, stage, Freshness(input_hash, *night.version(stage)), (), night.lab.journal)
        if stage == GROUP:
            file = folder / task.name
            some_published = write_members(file, _list_members(night, task.name))
            yield replace(task, snapshot=night.lab.database if some_published else None, members=file)
            continue
        members = _list_included(night, f"{_INCLUDED} specimen_id = ? ORDER BY recording_id", [task.name])
        (made_from,) = (one for one in list_items(task.name, members, of_rigs) if one.stage == stage)
        only, but = (DIAGNOSIS_KIND, "") if stage == DIAGNOSIS else ("", DIAGNOSIS_KIND)
        yield replace(
            task,
            recordings=fetch_inputs(made_from.recordings, reader, only=only, but=but),
            calibrations=fetch_inputs(made_from.calibrations, reader, only=only, but=but),
            settings=night.settings.choose(STAGES[stage].settings),
        )


def _list_members(night: Night, group: str) -> Iterator[Included]:
    """The recordings of a group."""
    kinds = GROUPS[group].kinds
    return (one for one in _list_included(night, f"{_INCLUDED} kinds <> '' ORDER BY recording_id") if one.kinds & kinds)


def _find_calibrations(night: Night) -> _Calibrations:
    """Gives the calibrations of some rigs, by recording."""

    @functools.lru_cache(maxsize=_RIGS_AT_ONCE)
    def of_rigs(rigs: frozenset[str]) -> tuple[Included, ...]:
        query = f"{_INCLUDED} rig_id = ? AND calibrates"
        found = (one for rig in rigs for one in _list_included(night, query, [rig]))
        return tuple(sorted(found, key=attrgetter("recording_id")))

    return of_rigs


def _list_included(night: Night, query: str, values: tuple[Any, ...] | list[Any] = ()) -> Iterator[Included]:
    for name, specimen_id, rig_id, kinds, _, *made_from, entry in night.ledger.each(query, values):
        journal_entry = None if entry is None else night.lab.journal / entry
        yield Included(name, specimen_id, rig_id, split_kinds(kinds), Freshness(*made_from), journal_entry)


def _identify(one: Included) -> list[str]:
    made_from = one.made_from
    return [one.recording_id, made_from.input_hash, made_from.code_version, made_from.settings_hash]
