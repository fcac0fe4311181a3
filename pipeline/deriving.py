"""The night's second half: specimens and groups, made again where their recordings changed."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, replace

from pipeline.execute import Casualty
from pipeline.freshness import digest
from pipeline.night import Context
from pipeline.stages.tasks import (
    CALIBRATION_KINDS,
    DIAGNOSIS,
    DIAGNOSIS_KIND,
    GROUP,
    GROUPS,
    SPECIMEN,
    SPECIMEN_KINDS,
    DerivedTask,
    derived_casualty,
    item_id,
)
from pipeline.store.inputs import Included, fetch
from pipeline.store.journal import Freshness
from pipeline.store.manifest import published
from pipeline.store.reader import Reader

_ByRig = dict[str | None, list[Included]]


@dataclass(frozen=True)
class _Item:
    """An item of these stages and the recordings that it is made from."""

    item_id: str
    stage: str
    recordings: tuple[Included, ...]
    calibrations: tuple[Included, ...] = ()

    @property
    def input_hash(self) -> str:
        return digest([[_identity(one) for one in part] for part in (self.recordings, self.calibrations)])


def derive(context: Context, recordings: Sequence[Included]) -> frozenset[str]:
    """Makes what is not fresh; returns all items that there have to be."""
    calibrations = _calibrations(recordings)
    specimens, diagnoses = _specimens(recordings, calibrations), _diagnoses(recordings, calibrations)
    # None needs another's result. The longest first, so that no worker is left alone with one at the end.
    items = [*sorted(diagnoses, key=lambda item: -len(item.recordings)), *_groups(recordings), *specimens]
    _make(context, items)
    return frozenset(item.item_id for item in items)


def _specimens(recordings: Sequence[Included], calibrations: _ByRig) -> list[_Item]:
    by_specimen: dict[str, list[Included]] = {}
    for one in recordings:
        if one.specimen_id is not None and one.kinds & SPECIMEN_KINDS:
            by_specimen.setdefault(one.specimen_id, []).append(one)
    return [
        _Item(item_id(SPECIMEN, name), SPECIMEN, tuple(members), _of_rigs(calibrations, members))
        for name, members in sorted(by_specimen.items())
    ]


def _calibrations(recordings: Sequence[Included]) -> _ByRig:
    """The calibrations of each rig; looked for once, since there may be as many specimens as recordings."""
    found: _ByRig = {}
    for one in recordings:
        if one.rig_id is not None and one.kinds & CALIBRATION_KINDS:
            found.setdefault(one.rig_id, []).append(one)
    return found


def _of_rigs(calibrations: _ByRig, members: Sequence[Included]) -> tuple[Included, ...]:
    """The calibrations of the members' rigs, by recording."""
    found = [one for rig in {member.rig_id for member in members} - {None} for one in calibrations.get(rig, ())]
    return tuple(sorted(found, key=lambda one: one.recording_id))


def _diagnoses(recordings: Sequence[Included], calibrations: _ByRig) -> list[_Item]:
    """One per specimen that was measured in a way that a model describes, also where none of it can be asked."""
    by_specimen: dict[str, list[Included]] = {}
    for one in recordings:
        if one.specimen_id is not None and one.kinds & (SPECIMEN_KINDS | {DIAGNOSIS_KIND}):
            by_specimen.setdefault(one.specimen_id, []).append(one)
    return [
        _Item(item_id(DIAGNOSIS, name), DIAGNOSIS, tuple(members), _of_rigs(calibrations, members))
        for name, members in sorted(by_specimen.items())
        if any(not one.kinds & CALIBRATION_KINDS for one in members)
    ]


def _groups(recordings: Sequence[Included]) -> list[_Item]:
    items = []
    for name, group in GROUPS.items():
        members = tuple(one for one in recordings if one.kinds & group.kinds)
        if members:
            items.append(_Item(item_id(GROUP, name), GROUP, members))
    return items


def _make(context: Context, items: Sequence[_Item]) -> None:
    expected = {item.item_id: Freshness(item.input_hash, *context.version(item.stage)) for item in items}
    stale = [item for item in items if not context.is_fresh(item.item_id, expected[item.item_id])]
    if not stale:
        return
    alone = all(item.stage == GROUP for item in stale)  # groups fetch what they need themselves
    with contextlib.nullcontext() if alone else published(context.lab) as reader:
        tasks = (_task(context, item, expected[item.item_id], reader) for item in stale)
        for task, result in context.run(tasks, len(stale), "analyses"):
            if isinstance(result, Casualty):
                limits = replace(task.freshness, settings_hash=context.limits_hash)
                result = derived_casualty(replace(task, freshness=limits), result.reason)
            context.done[result.item_id] = result


def _task(context: Context, item: _Item, expected: Freshness, reader: Reader | None) -> DerivedTask:
    """The task of an item, with what it is made from: fetched here, or where to fetch it."""
    task = DerivedTask(item.item_id, item.stage, expected, (), context.lab.journal)
    if item.stage == GROUP:
        snapshot = None if all(one.entry for one in item.recordings) else context.lab.database
        return replace(task, snapshot=snapshot, stored=tuple(one.stored for one in item.recordings))
    only, but = (DIAGNOSIS_KIND, "") if item.stage == DIAGNOSIS else ("", DIAGNOSIS_KIND)
    return replace(
        task,
        recordings=fetch(item.recordings, reader, only=only, but=but),
        calibrations=fetch(item.calibrations, reader, only=only, but=but),
        settings=context.settings.of_stage(item.stage),
    )


def _identity(one: Included) -> list[str]:
    made_from = one.made_from
    return [one.recording_id, made_from.input_hash, made_from.code_version, made_from.settings_hash]
