"""A night from its first look to its pages, step by step: `nightly` reads as the picture in the package's docstring.

Whatever is finished lies in the journal until it is published, so that a night that was killed is taken up where it
ended.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from ingest.discover import check_given
from ingest.remote import is_url
from pipeline.lab.annotations import find_broken_lines, list_excluded, read_annotations
from pipeline.lab.interrupts import end_when_told
from pipeline.lab.lab import Lab
from pipeline.lab.lock import hold_lab
from pipeline.lab.settings import load_settings
from pipeline.nightly.derive import derive_results
from pipeline.nightly.ledger import Ledger, learn_lab
from pipeline.nightly.look import NO_MAPPING, Found, has_newer_folder, look_at_files
from pipeline.nightly.ownership import write_rows
from pipeline.nightly.publish import (
    Counts,
    count_files,
    count_missing,
    count_results,
    discard_work,
    list_attention,
    list_rigs_without_constants,
    list_without_result,
    publish_night,
)
from pipeline.nightly.read import adopt_journal, include_recordings, read_contents
from pipeline.nightly.stages import STAGES, Night
from pipeline.nightly.workers import Track, Workers, load_module
from schemas.errors import DealabError, UsageError, describe_error
from schemas.numbers import NBSP, seconds


@dataclass(frozen=True)
class Summary:
    """How a night went, for the terminal, an e-mail and the exit status.

    Parameters
    ----------
    run_id : number of the run
    took_s : how long it took but for its pages, s: the pages say the same, from `runs`
    pages_s : how long writing the pages took, s
    counts : of its files
    analysed : results that were made
    missing : known recordings whose file has gone
    attention : every broken line of the annotations, every file that was refused or is damaged, every accident and
        every analysis that failed, with its reason
    without_result : every recording or table in the lab that was taken in and led to no result, with what was missing
    notes : what was passed over, and which rigs have no constants
    report_problem : why the pages could not be written
    """

    run_id: str
    took_s: float
    pages_s: float
    counts: Counts
    analysed: int
    missing: int
    attention: tuple[str, ...]
    without_result: tuple[str, ...]
    notes: tuple[str, ...]
    report_problem: str | None = None

    @property
    def exit_status(self) -> int:
        """How it ended: 0 all done, 1 the report could not be written, 3 some recordings were refused, are damaged or
        failed; 4 none of these, but some recordings or tables led to no result."""
        if self.report_problem is not None:
            return 1
        if self.attention:
            return 3
        return 4 if self.without_result else 0

    def paragraph(self) -> str:
        """The night in a few sentences."""
        c = self.counts
        parts = [
            f"Run {self.run_id}: {_spell_files(c.found)} found, {c.ingested} taken in, "
            f"{c.reused} unchanged since an earlier run",
            f"{c.quarantined} refused, {c.damaged} damaged, {c.failed} analyses failed",
        ]
        also = [
            f"{number} {what}"
            for number, what in (
                (c.duplicates, "duplicates"),
                (c.pending, "left for the next night"),
                (c.unmapped, "without a mapping"),
                (self.missing, "known recordings whose file has gone"),
            )
            if number
        ]
        if also:
            parts.append(", ".join(also))
        if self.without_result:
            number = len(self.without_result)
            parts.append(f"{number} {'recording' if number == 1 else 'recordings'} led to no result")
        done = f"{self.analysed} results made" if self.analysed else "nothing had to be done again"
        times = f"took {seconds(self.took_s)}, its pages {seconds(self.pages_s)} more".replace(NBSP, " ")
        return "; ".join(parts) + f". {done[0].upper()}{done[1:]}; {times}."


_REPORTS = "reports.build"
_SHARED = 100
"""Names in a raw folder that workers of a cluster are asked about."""
_TASKS = ("pipeline.nightly.read", "pipeline.nightly.derive")
_PRELOAD = (*_TASKS, *(module for stage in STAGES.values() for module in stage.modules))
"""Modules that workers are started with: the tasks, and all that they compute with."""


def nightly(
    raw: Sequence[str | os.PathLike[str]],
    lab: Lab,
    *,
    jobs: int,
    rigs: Path | None = None,
    cluster: str | None = None,
    track: Track = lambda items, _count, _what: items,
) -> Summary:
    """The whole job over raw files and folders.

    Parameters
    ----------
    raw : files and folders with recordings, and URLs of such (the extra `remote`)
    jobs : number of worker processes; 0 does everything in this process
    rigs : folder with rig files, None to look beside the recordings
    cluster : address of a dask scheduler whose workers are used instead; they have to see the same folders
    track : shows progress: passes on the tasks with their outcomes, given how many there are and what they are; 0 of a
        step that has no tasks

    Raises
    ------
    LabError : another nightly is at work, nothing was found, the lab cannot be written, the result failed its checks.
        The published database is then as it was, and what was finished is kept for the next run.
    UsageError : a path that does not exist, among the raw ones or for rig files
    """
    if rigs is not None and not os.path.isdir(rigs):
        raise UsageError("there is no such folder", where=str(rigs), expected="a folder of rig files")
    check_given(path for path in raw if not is_url(path))  # before a lab is made for a slip of the pen
    lab.create()
    with end_when_told(), hold_lab(lab), _prepare(raw, lab, jobs, rigs, cluster, track) as night:
        night.workers.announce("files")
        found = look_at_files(
            raw, lab, night.ledger, run_id=night.run_id, deadline_s=night.settings.deadline_s, rigs=rigs
        )
        if found.some_new:
            night.workers.prepare()
        reports = _load_beside(_REPORTS)
        adopt_journal(night)
        out = list_excluded(night.annotations)
        read_contents(night, found)
        include_recordings(night, out)
        derive_results(night)
        night.workers.load(_REPORTS)
        night.workers.announce("database")
        write_rows(night.ledger, found.roots, out)
        finished_at = publish_night(night, found)
        clock = time.monotonic()
        reports.join()
        night.workers.announce("pages")
        problem = _write_report(night)
        discard_work(night)
        took_s = (finished_at - night.started_at).total_seconds()
        return _summarise(night, found, took_s, time.monotonic() - clock, problem)


@contextlib.contextmanager
def _prepare(
    raw: Sequence[str | os.PathLike[str]],
    lab: Lab,
    jobs: int,
    rigs: Path | None,
    cluster: str | None,
    track: Track,
) -> Iterator[Night]:
    """What the steps of a night share: the lab with what it knows, and workers, which begin to load what they need."""
    started, settings = datetime.now(UTC), load_settings(lab)
    workers = Workers(settings, jobs, cluster, _PRELOAD, track)
    if has_newer_folder(raw, lab):
        workers.prepare()
    with Ledger(lab.ledger) as ledger, contextlib.closing(workers):
        workers.refuse_blind(list(_list_shared(raw, lab)))
        number = learn_lab(lab, ledger) + 1
        yield Night(lab, settings, ledger, workers, rigs, f"{number:06d}", started, read_annotations(lab))


def _list_shared(raw: Sequence[str | os.PathLike[str]], lab: Lab) -> Iterator[str]:
    """Files that every worker has to see: the ledger, which only this night has, and what stands in the raw folders."""
    yield os.path.abspath(lab.ledger)
    for given in raw:
        if is_url(given):
            continue
        place = os.path.abspath(given)
        yield place
        if os.path.isdir(place):
            with (
                contextlib.suppress(OSError),
                os.scandir(place) as items,
            ):  # a closed folder is told of when it is looked at
                yield from (item.path for item in itertools.islice(items, _SHARED))


def _summarise(night: Night, found: Found, took_s: float, pages_s: float, problem: str | None) -> Summary:
    return Summary(
        night.run_id,
        took_s,
        pages_s,
        count_files(night, found),
        count_results(night),
        count_missing(night),
        (*find_broken_lines(night.lab), *list_attention(night)),
        list_without_result(night),
        (
            *map(str, found.passed),
            *(f"{path}: {NO_MAPPING}" for path in found.unmapped),
            *list_rigs_without_constants(night),
        ),
        problem,
    )


def _write_report(night: Night) -> str | None:
    """Writes the pages; one that fails is told, but the others and the database are published all the same."""
    from reports.build import build_reports

    workers = night.workers
    try:
        made = build_reports(night.lab.folder, workers=workers.lend if workers.local else None, jobs=workers.jobs)
    except DealabError as error:
        return str(error)
    except Exception as error:
        return describe_error(error)
    return made.describe_problems()


def _load_beside(module: str) -> threading.Thread:
    """Imports a module beside what is done now: the night waits for workers and the database more than it computes."""
    thread = threading.Thread(target=load_module, args=(module,), daemon=True)
    thread.start()
    return thread


def _spell_files(number: int) -> str:
    return "1 file" if number == 1 else f"{number} files"
