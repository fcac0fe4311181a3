"""The nightly: what is new, what has to be made again, made, checked, published, reported.

The order of work: look at the raw files, read new contents in workers, decide who owns which recording id, analyse the
specimens and groups whose recordings changed, publish samples and database, write the reports. Whatever is finished
lies in the journal until it is published, so that a night that was killed is taken up where it ended.
"""

from __future__ import annotations

import contextlib
import os
import signal
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from types import FrameType

from pipeline.lab.annotations import excluded, read_annotations
from pipeline.lab.lab import Lab
from pipeline.lab.lock import exclusive
from pipeline.lab.settings import Settings
from pipeline.lab.settings import load as load_settings
from pipeline.nightly.context import Context, Track
from pipeline.nightly.derive import derive
from pipeline.nightly.ledger import Ledger, learn
from pipeline.nightly.look import likely_new, look
from pipeline.nightly.planning import write_rows
from pipeline.nightly.publish import Counts, Night, attention, count, discard_work, made_again, missing, publish_night
from pipeline.nightly.read import adopt_journal, include, read
from pipeline.nightly.stages import MODULES
from pipeline.nightly.workers import KeptPool, LocalPool, SerialExecutor, load, prepared
from schemas.errors import DealabError


@dataclass(frozen=True)
class Summary:
    """How a night went, for the terminal, an e-mail and the exit status.

    `attention` names every file that was refused or is damaged and every analysis that failed, with its reason;
    `report_problem` says why the pages could not be written.
    """

    run_id: str
    seconds: float
    counts: Counts
    analysed: int
    missing: int
    attention: tuple[str, ...]
    notes: tuple[str, ...]
    report_problem: str | None = None

    @property
    def exit_status(self) -> int:
        """0 all done, 1 the report could not be written, 3 some recordings were refused, are damaged or failed."""
        if self.report_problem is not None:
            return 1
        return 3 if self.attention else 0

    def paragraph(self) -> str:
        """The night in a few sentences."""
        c = self.counts
        parts = [
            f"Run {self.run_id}: {_files(c.found)} found, {c.ingested} taken in, {c.reused} unchanged since an earlier run",
            f"{c.quarantined} refused, {c.damaged} damaged, {c.failed} analyses failed",
        ]
        also = [
            f"{number} {what}"
            for number, what in (
                (c.duplicates, "duplicates"),
                (c.pending, "still being written"),
                (c.unmapped, "without a mapping"),
                (self.missing, "known recordings whose file has gone"),
            )
            if number
        ]
        if also:
            parts.append(", ".join(also))
        done = f"{self.analysed} results made again" if self.analysed else "nothing had to be done again"
        return "; ".join(parts) + f". {done[0].upper()}{done[1:]}; {self.seconds:.1f} s."


_PRELOAD, _REPORTS = tuple(MODULES.values()), "reports.build"


def nightly(
    raw: Sequence[str | os.PathLike[str]],
    lab: Lab,
    *,
    jobs: int,
    rigs: Path | None = None,
    cluster: str | None = None,
    track: Track = lambda items, _count, _what: items,
) -> Summary:
    """The whole job over raw files and folders; see the module's docstring.

    Parameters
    ----------
    raw : files and folders with recordings, and URLs of such (the extra `remote`)
    jobs : number of worker processes; 0 does everything in this process
    rigs : folder with rig files, None to look beside the recordings
    cluster : address of a dask scheduler whose workers are used instead; they have to see the same folders
    track : shows progress

    Raises
    ------
    LabError : another nightly is at work, nothing was found, the lab cannot be written, the result failed its checks.
        The published database is then as it was, and what was finished is kept for the next run.
    UsageError : a path that does not exist
    """
    lab.create()
    with exclusive(lab), _terminable():
        started, clock = datetime.now(UTC), time.monotonic()
        settings = load_settings(lab)
        open_executor, workers = _executors(settings, jobs, cluster)
        local = jobs > 0 and cluster is None
        if local and likely_new(raw, lab):
            prepared(_PRELOAD)  # what workers need loads while the night finds out what there is to do
        kept = contextlib.closing(KeptPool(open_executor, jobs if local else 0))
        with Ledger(lab.ledger) as ledger, kept as lend:
            context = Context(lab, settings, ledger, rigs, workers, lend, track)
            last_run = learn(lab, ledger)
            annotations = read_annotations(lab)
            found = look(raw, lab, ledger)
            if found.some_new and local:
                prepared(_PRELOAD)
            reports = _imported(_REPORTS)
            adopt_journal(context)
            out = excluded(annotations)
            read(context, found)
            include(context, out)
            derive(context)
            lend.load(_REPORTS)
            write_rows(ledger, found.roots, out)
            night = Night(f"{last_run + 1:06d}", started, found, annotations)
            publish_night(context, night)
            reports.join()
            problem = _report(lab, None if cluster else lend, workers)
            discard_work(context)
            return _summary(context, night, time.monotonic() - clock, problem)


def _summary(context: Context, night: Night, seconds: float, problem: str | None) -> Summary:
    return Summary(
        night.run_id,
        seconds,
        count(context, night),
        made_again(context),
        missing(context),
        attention(context),
        (*night.found.notes, *(f"{path}: no mapping, passed over" for path in night.found.unmapped)),
        problem,
    )


def _report(lab: Lab, open_executor: Callable[[int], Executor] | None, jobs: int) -> str | None:
    """Writes the pages; a page that fails is told, but the database is published all the same."""
    from reports.build import build_reports

    try:
        build_reports(lab.folder, workers=open_executor and (lambda: open_executor(jobs)), jobs=jobs)
    except DealabError as error:
        return str(error)
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        return f"{type(error).__name__}: {error} ({Path(place.filename).name}, line {place.lineno})"
    return None


def _imported(module: str) -> threading.Thread:
    """Imports a module beside what is done now: the night waits for workers and the database more than it computes."""
    thread = threading.Thread(target=load, args=(module,), daemon=True)
    thread.start()
    return thread


def _executors(settings: Settings, jobs: int, cluster: str | None) -> tuple[Callable[[int], Executor], int]:
    """How to get an executor, and how many workers there are."""
    if cluster is not None:
        from pipeline.nightly.cluster import executors

        return executors(cluster)

    def local(count: int) -> Executor:
        if count == 0 or jobs == 0:
            return SerialExecutor()
        return LocalPool(count, deadline_s=settings.deadline_s, memory_mb=settings.memory_mb, preload=_PRELOAD)

    return local, jobs


@contextlib.contextmanager
def _terminable() -> Iterator[None]:
    """Being told to end (SIGTERM) is an interrupt: workers are stopped and the lock is given back."""

    def interrupt(_number: int, _frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    try:
        before = signal.signal(signal.SIGTERM, interrupt)
    except ValueError:  # not in the main thread: whoever runs us handles signals
        yield
        return
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _files(number: int) -> str:
    return "1 file" if number == 1 else f"{number} files"
