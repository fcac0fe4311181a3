"""Workers: tasks done in this process, in others on this machine or on a cluster, and what happens when one is lost.

All of them are behind one seam, `concurrent.futures.Executor`. A task that kills its worker, exceeds its memory or its
deadline is tried once more, alone; when that fails too it is a casualty with a reason. Everything else that can go
wrong with a task is data and comes back as its result. Does not belong here: what the tasks are.

Workers of a dask.distributed cluster have to see the raw folders and the lab under the same paths, have the same dealab
and libraries installed (they are asked, and refused where not), and work one task at a time (`dask worker --nthreads
1`). A task whose worker dies is given to another one as often as the scheduler allows
(`distributed.scheduler.allowed-failures`), then counts as lost. Limits of time and memory are those of the cluster's
workers: the lab's own `deadline_s` and `memory_mb` are for local ones.
"""

from __future__ import annotations

import contextlib
import functools
import importlib
import logging
import multiprocessing
import os
import signal
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future, wait
from dataclasses import dataclass
from importlib.abc import MetaPathFinder
from types import ModuleType
from typing import Any, Protocol, TypeAlias, TypeVar

from ingest.apart import end_with_parent
from ingest.extras import advise_install
from ingest.formats import identify_plugins
from pipeline.import_path import leave_working_folder, start_without_working_folder
from pipeline.lab.journal import Outcome
from pipeline.lab.settings import Settings
from schemas.errors import LabError
from schemas.version import MISSING, describe_software

Given = TypeVar("Given")
AnyTask = TypeVar("AnyTask", bound="Task")
Result = TypeVar("Result")
Track: TypeAlias = Callable[[Iterable[Any], int, str], Iterable[Any]]
"""Shows progress: (items, how many, what they are) to the same items."""
_END_WITH_PARENT = "pipeline.end_with_parent"
_RESTARTS = 20
"""How often a pool that broke as a whole is opened again before the night gives up."""
_CONTAINER = "/sys/fs/cgroup/memory.max"
"""Where Linux tells what memory a container may have."""
_LEAST_MB = 1024
"""Fewer MB do not hold what a worker loads and a usual recording."""
_CONNECT_S = "20s"
"""How long a cluster has to answer."""
_LOOK_S = 20.0
"""After so long without a result a cluster is asked whether it still has workers."""
_EMPTY_S = 300.0
"""How long a cluster may be without a worker: those that a batch system ended are started again within minutes."""
_NAMED = 5
"""Files that a worker does not see and that are named."""


class Task(Protocol):
    """An item to be made in a worker."""

    @property
    def name(self) -> str:
        """What people call it, for progress."""
        ...

    def perform(self) -> Outcome:
        """Makes the item and keeps its results in the journal."""
        ...

    def give_up(self, reason: str) -> Outcome:
        """The outcome of an item whose worker did not come back: an accident, which the next night tries again."""
        ...


def perform(task: Task) -> Outcome:
    """Does a task in whatever process this is."""
    return task.perform()


@dataclass(frozen=True)
class Casualty:
    """What is left of a task whose worker did not come back, twice; `reason` says what happened to it."""

    reason: str


class Workers:
    """The workers of a night, from its first task to its pages; `local` where they are processes of this machine.

    Parameters
    ----------
    settings : the lab's, for their limits of time and memory
    jobs : number of worker processes; 0 does everything in this process
    cluster : address of a dask scheduler whose workers are used instead
    preload : modules that local workers are started with
    track : shows progress

    Raises
    ------
    LabError : the cluster does not answer
    """

    def __init__(
        self, settings: Settings, jobs: int, cluster: str | None, preload: Sequence[str], track: Track
    ) -> None:
        self.local = jobs > 0 and cluster is None
        self._preload, self._track = preload, track

        def open_local(count: int) -> Executor:
            if count == 0 or jobs == 0:
                return SerialExecutor()
            memory_mb = share_memory(count) if settings.memory_mb is None else settings.memory_mb
            return LocalPool(count, deadline_s=settings.deadline_s, memory_mb=memory_mb, preload=preload)

        self._open, self.jobs = (open_local, jobs) if cluster is None else connect_cluster(cluster)
        self._pool = KeptPool(self._open, jobs if self.local else 0)

    def prepare(self) -> None:
        """Begins to load what local workers need, while whoever called goes on."""
        if self.local:
            prepare_workers(self._preload)

    def refuse_blind(self, places: Sequence[str]) -> None:
        """Raises `LabError` where a worker of a cluster does not see files that are there for the night."""
        executor = None if self.local else self._open(0)
        if isinstance(executor, _ClusterExecutor):
            executor.refuse_blind(places)

    def perform(self, tasks: Iterable[AnyTask], count: int, what: str) -> Iterator[tuple[AnyTask, Outcome | Casualty]]:
        """Tasks and their outcomes, or `Casualty`, as they are ready. Raises `LabError` as `run_all` does."""
        results: Iterable[Any] = run_all(tasks, perform, self._pool, jobs=self.jobs)
        yield from self._track(results, count, what)

    def announce(self, what: str) -> None:
        """Names a step of the night that has no tasks, for whoever follows its progress."""
        self._track((), 0, what)

    def load(self, module: str) -> None:
        """Lets the workers load a module, while whoever called goes on."""
        self._pool.load(module)

    def lend(self) -> Executor:
        """Local workers as an executor, for other work than tasks."""
        return self._pool(self.jobs)

    def close(self) -> None:
        """Ends the workers."""
        self._pool.close()


def run_all(
    tasks: Iterable[Given],
    function: Callable[[Given], Result],
    open_executor: Callable[[int], Executor],
    *,
    jobs: int,
) -> Iterator[tuple[Given, Result | Casualty]]:
    """Results as they are ready, in any order. Few tasks are held at a time, so `tasks` may be long and lazy.

    Raises `LabError` that a task raises (a full disk is not the task's fault) or when no worker can be kept alive.
    """
    unlucky: list[Given] = []
    for task, result in _run_once(tasks, function, open_executor, jobs):
        if isinstance(result, Casualty):
            unlucky.append(task)
        else:
            yield task, result
    for task in unlucky:
        yield from _run_once([task], function, open_executor, 1)


def _run_once(
    tasks: Iterable[Given], function: Callable[[Given], Result], open_executor: Callable[[int], Executor], jobs: int
) -> Iterator[tuple[Given, Result | Casualty]]:
    waiting = iter(tasks)
    first = next(waiting, None)
    if first is None:
        return
    restarts = 0
    executor = open_executor(jobs)
    running: dict[Future[Any], Given] = {}
    ready: list[Given] = [first]
    finished = False
    try:
        while True:
            while len(running) < 2 * max(jobs, 1):
                if not ready:
                    following = next(waiting, None)
                    if following is None:
                        break
                    ready.append(following)
                try:
                    running[executor.submit(function, ready[-1])] = ready[-1]
                except BrokenExecutor as error:
                    restarts += 1
                    if restarts > _RESTARTS:
                        raise LabError(
                            f"worker processes die as soon as they start{f': {error}' if str(error) else ''}",
                            remedy="Look at the limits of this account: memory, processes, open files (`ulimit -a`)",
                        ) from None
                    executor.shutdown(cancel_futures=True)
                    executor = open_executor(jobs)
                    continue
                ready.pop()
            if not running:
                break
            done, _ = wait(running, timeout=_LOOK_S, return_when=FIRST_COMPLETED)
            if not done and isinstance(executor, _ClusterExecutor):
                executor.refuse_empty()
            for future in done:
                yield running.pop(future), _take_result(future)
        finished = True
    finally:
        executor.shutdown(wait=finished, cancel_futures=not finished)


def _take_result(future: Future[Any]) -> Any:
    try:
        error = future.exception()
    except CancelledError:  # by dask, when its scheduler has gone: nobody else cancels what is waited for
        raise LabError(
            "the cluster has gone during the night",
            expected="a dask scheduler that runs as long as the night",
            remedy="Start it and its workers again, then the nightly; what is finished is kept",
        ) from None
    if error is None:
        return future.result()
    if isinstance(error, LabError):
        raise error
    return Casualty(_explain_loss(error))


def _explain_loss(error: BaseException) -> str:
    if isinstance(error, TimeoutError):
        return "it took longer than deadline_s allows"
    if isinstance(error, MemoryError):
        return "it needs more memory than a worker may have"
    code = getattr(error, "exitcode", None)
    if isinstance(code, int) and code < 0:
        with contextlib.suppress(ValueError):
            return f"its worker was killed ({signal.Signals(-code).name})"
    return f"its worker did not come back ({type(error).__name__}: {error})"


class SerialExecutor(Executor):
    """Runs everything at once in this process: for debugging, and for tests."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


def prepare_workers(preload: Sequence[str]) -> Any:
    """The context that worker processes start from.

    Where they are forked from a server of their own, it begins to import the modules of `preload`, while whoever called
    goes on.
    """
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    from multiprocessing.forkserver import ensure_running

    context = multiprocessing.get_context("forkserver")
    os.environ["DEALAB_PARENT"] = str(os.getpid())  # for `pipeline.end_with_parent`
    context.set_forkserver_preload([_END_WITH_PARENT, *preload])
    with start_without_working_folder():
        ensure_running()
    return context


def share_memory(workers: int) -> int:
    """What each of so many workers may take, MB: an equal part of three quarters of the memory that this account has.

    Without a limit one recording that needs too much has the kernel end whatever is largest. 0, which is no limit, on
    systems that know none.
    """
    try:
        import resource  # noqa: F401 - what limits are set with
    except ImportError:
        return 0
    there = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    with contextlib.suppress(OSError, ValueError), open(_CONTAINER) as file:  # "max" where the container has no limit
        there = min(there, int(file.read()))
    return max(_LEAST_MB, int(0.75 * there / workers) >> 20)


class LocalPool(Executor):
    """Worker processes of this machine. One that dies or is overdue costs its task only and is replaced.

    Parameters
    ----------
    jobs : number of processes
    deadline_s : longest time a task may take; then its worker is killed
    memory_mb : most memory of one worker, 0 for no limit
    preload : modules that workers are started with, so that each starts in milliseconds
    """

    def __init__(self, jobs: int, *, deadline_s: float, memory_mb: int = 0, preload: Sequence[str] = ()) -> None:
        from pebble import ProcessPool

        context = prepare_workers(preload)
        self._deadline_s = deadline_s
        self._pool = ProcessPool(max_workers=jobs, initializer=_start_worker, initargs=(memory_mb,), context=context)

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        try:
            future: Future[Any] = self._pool.schedule(fn, args=args, kwargs=kwargs, timeout=self._deadline_s)
        except RuntimeError as error:
            raise BrokenExecutor(str(error)) from error
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        if cancel_futures or not wait:
            self._pool.stop()
        else:
            self._pool.close()
        self._pool.join()


def connect_cluster(address: str) -> tuple[Callable[[int], Executor], int]:
    """A function that gives executors on the cluster at `address` (its argument is ignored), and the cluster's size.

    Raises `LabError` when the cluster cannot be reached or has no worker, when a worker has other software, and when
    the extra is not installed.
    """
    try:
        from distributed import Client
    except ImportError:
        raise LabError("dask.distributed is not installed", remedy=advise_install("cluster")) from None
    for name in (
        "distributed",
        "distributed.client",
    ):  # what it logs are pages of its own functions; what matters we tell
        logging.getLogger(name).setLevel(logging.CRITICAL)
    # In two steps, so that a client that cannot connect is closed here. Else dask closes it when it is garbage, which
    # may be within the start of the next client: that one then waits for itself.
    client: Any = Client.__new__(Client)
    try:
        client.__init__(address, timeout=_CONNECT_S)
    except Exception as error:  # of an address dask makes whatever its transports do
        client.close()
        raise LabError(
            f"the cluster does not answer: {error}", where=address, expected="the address of a dask scheduler"
        ) from None
    here = describe_readers_too()
    try:
        # Those that are being started again have no software to speak of yet, and are not to be trusted unasked.
        client.wait_for_workers(1, timeout=_CONNECT_S)
        refuse_other_software(here, client.run(describe_readers_too, on_error="return"))
    except LabError:
        client.close()
        raise
    except TimeoutError:
        client.close()
        raise LabError(
            "the cluster has no worker", where=address, expected="at least one `dask worker` of that scheduler"
        ) from None
    return lambda _jobs: _ClusterExecutor(client, here), max(1, sum(client.ncores().values()))


_REFUSED = 5
"""Workers with other software that are named."""


def refuse_other_software(here: Mapping[str, str], there: Mapping[str, Mapping[str, str] | BaseException]) -> None:
    """Raises `LabError` where a worker would compute with other code or libraries than the night books.

    Parameters
    ----------
    here : `describe_readers_too` of the night
    there : the same of each worker by its address, or why it could not say
    """
    wrong, names = [], {"dealab"}
    for address, found in sorted(there.items()):
        if isinstance(found, BaseException):
            wrong.append(f"{address} cannot say what it has ({type(found).__name__}: {str(found)[:100]})")
        elif other := [name for name in sorted({*here, *found}) if found.get(name, MISSING) != here.get(name, MISSING)]:
            wrong.append(f"{address} has {', '.join(f'{name} {found.get(name, MISSING)}' for name in other)}")
            names |= set(other)
    if wrong:
        raise LabError(
            f"workers of the cluster have other software: {'; '.join(wrong[:_REFUSED])}",
            expected=", ".join(f"{name} {here.get(name, MISSING)}" for name in sorted(names)),
            remedy="Install the same release of dealab with the same libraries for the workers and start them again",
        )


def _perform_with(here: Mapping[str, str], function: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
    """Calls a function on a worker that has the software `here`; others may have come since the night asked.

    Raises `LabError` where it has other.
    """
    from distributed import get_worker

    refuse_other_software(here, {get_worker().address: _describe_once()})
    return function(*args, **kwargs)


@functools.cache
def _describe_once() -> Mapping[str, str]:
    return describe_readers_too()


def describe_readers_too() -> dict[str, str]:
    """What results depend on: our software and libraries, and the readers of other packages."""
    readers = dict(plugin.split("=", 1) for plugin in identify_plugins())
    return describe_software() | {f"the reader of {name} from": origin for name, origin in readers.items()}


def list_unseen(places: Sequence[str]) -> list[str]:
    """Which of these paths are not there, asked where this runs."""
    return [place for place in places if not os.path.lexists(place)]


class _ClusterExecutor(Executor):
    """dask's own executor with the whole interface of the standard library's; `here` is the software of the night."""

    def __init__(self, client: Any, here: Mapping[str, str]) -> None:
        self._client, self._here = client, here
        self._executor = client.get_executor(pure=False, retries=0)
        self._empty_since: float | None = None

    def refuse_blind(self, places: Sequence[str]) -> None:
        """Raises `LabError` where a worker does not see files of the lab or the raw folders under the same paths."""
        found = self._client.run(list_unseen, list(places), on_error="return")
        for address, unseen in sorted(found.items()):
            if isinstance(unseen, BaseException):
                raise LabError(f"a worker of the cluster cannot look at files: {unseen}", where=address)
            unseen = [place for place in unseen if os.path.lexists(place)]  # what has gone meanwhile nobody sees
            if unseen:
                more = f" and {len(unseen) - _NAMED} more" if len(unseen) > _NAMED else ""
                raise LabError(
                    f"a worker of the cluster does not see {', '.join(unseen[:_NAMED])}{more}",
                    where=address,
                    expected="the lab and the raw folders under the same paths everywhere",
                    remedy="Mount them there, or run without --cluster",
                )

    def refuse_empty(self) -> None:
        """Raises `LabError` where the cluster has been without a worker for too long: nothing would ever come of it."""
        if self._client.ncores():
            self._empty_since = None
            return
        self._empty_since = self._empty_since or time.monotonic()
        if time.monotonic() - self._empty_since >= _EMPTY_S:
            raise LabError(
                f"the cluster has been without a worker for {_EMPTY_S / 60:g} minutes",
                expected="at least one `dask worker` of that scheduler",
                remedy="Start one, then the nightly; what is finished is kept",
            )

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = self._executor.submit(_perform_with, self._here, fn, *args, **kwargs)
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Without waiting, dask cancels what is outstanding."""
        self._executor.shutdown(wait=wait and not cancel_futures)


class KeptPool:
    """Lends one pool of `jobs` workers again and again, so that what they have loaded stays loaded.

    Pools of another size are opened anew. A borrower shuts down what it was lent as if it were its own. A pool that
    broke, or was left with tasks undone, is not lent again.
    """

    def __init__(self, open_pool: Callable[[int], Executor], jobs: int) -> None:
        self._open_pool, self._jobs = open_pool, jobs
        self._kept: Executor | None = None

    def __call__(self, jobs: int) -> Executor:
        # A single worker may have been left with little memory by what is tried again now.
        if jobs != self._jobs or jobs < 2:
            return self._open_pool(jobs)
        pool, self._kept = self._kept or self._open_pool(jobs), None
        return _Lent(pool, self._take_back)

    def load(self, module: str) -> None:
        """Lets the workers that are kept load a module, while whoever called goes on.

        A pool that broke meanwhile is given up.
        """
        if self._kept is None:
            return
        try:
            for _ in range(self._jobs):
                self._kept.submit(load_module, module)
        except BrokenExecutor:
            self._kept.shutdown(cancel_futures=True)
            self._kept = None

    def _take_back(self, pool: Executor) -> None:
        self.close()
        self._kept = pool

    def close(self) -> None:
        """Ends the workers of the pool that is kept."""
        if self._kept is not None:
            self._kept.shutdown()
            self._kept = None


class _Lent(Executor):
    """A pool that goes back where it came from."""

    def __init__(self, pool: Executor, back: Callable[[Executor], None]) -> None:
        self._pool, self._back = pool, back
        self._running: set[Future[Any]] = set()

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future = self._pool.submit(fn, *args, **kwargs)
        self._running.add(future)
        future.add_done_callback(self._running.discard)
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        if cancel_futures or not wait or not all(future.done() for future in tuple(self._running)):
            self._pool.shutdown(wait, cancel_futures=cancel_futures)
        else:
            self._back(self._pool)


def load_module(module: str) -> None:
    """Imports a module beforehand."""
    with contextlib.suppress(Exception):  # told when it is needed
        importlib.import_module(module)


def _start_worker(memory_mb: int) -> None:
    """A worker imports nothing from the working folder, leaves interrupts to its parent, dies with it, and keeps to its
    memory."""
    leave_working_folder()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    end_with_parent()
    if memory_mb:
        import resource

        resource.setrlimit(resource.RLIMIT_DATA, (memory_mb << 20, memory_mb << 20))
    _spare_pandas()


def _spare_pandas() -> None:
    """Lets pyarrow's first conversion happen where there is no pandas.

    That conversion imports pandas wherever it is installed: half a second and 60 MB in every worker, and none needs it.
    """
    import pyarrow as pa

    if "pandas" in sys.modules:
        return
    sys.meta_path.insert(0, absent := _Absent())
    try:
        pa.array([0])
    finally:
        sys.meta_path.remove(absent)


class _Absent(MetaPathFinder):
    """Finds that there is no pandas."""

    def find_spec(self, name: str, _path: Sequence[str] | None, _target: ModuleType | None = None) -> None:
        if name == "pandas":
            raise ModuleNotFoundError("pandas is not needed here", name=name)
