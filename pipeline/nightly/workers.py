"""Running items elsewhere: one seam, `concurrent.futures.Executor`, and what to do when a worker does not come back.

An item that kills its worker, exceeds its memory or its deadline is tried once more, alone; when that fails too it is
a casualty with a reason. Everything else that can go wrong with an item is data and comes back as its result.
Does not belong here: what the items are.
"""

from __future__ import annotations

import contextlib
import importlib
import multiprocessing
import os
import signal
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from dataclasses import dataclass
from importlib.abc import MetaPathFinder
from types import ModuleType
from typing import Any, TypeVar

from schemas.errors import LabError

Task = TypeVar("Task")
Result = TypeVar("Result")
_RESTARTS = 20
"""How often a pool that broke as a whole is opened again before the night gives up."""


@dataclass(frozen=True)
class Casualty:
    """An item whose worker did not come back, twice; `reason` says what happened to it."""

    reason: str


class SerialExecutor(Executor):
    """Runs everything at once in this process: for debugging, and for tests."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


def prepared(preload: Sequence[str]) -> Any:
    """The context that workers start from. Where workers are forked from a server of their own, it begins to import the modules of
    `preload`, while whoever called goes on."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    from multiprocessing.forkserver import ensure_running

    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(list(preload))
    ensure_running()
    return context


class LocalPool(Executor):
    """Worker processes of this machine. One that dies or is overdue costs its item only and is replaced.

    Parameters
    ----------
    jobs : number of processes
    deadline_s : longest time an item may take; then its worker is killed
    memory_mb : most memory of one worker, 0 for no limit
    preload : modules that workers are started with, so that each starts in milliseconds
    """

    def __init__(self, jobs: int, *, deadline_s: float, memory_mb: int = 0, preload: Sequence[str] = ()) -> None:
        from pebble import ProcessPool

        context = prepared(preload)
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


class KeptPool:
    """Lends one pool of `jobs` workers again and again, so that what they have loaded stays loaded; others are opened anew.

    A borrower shuts down what it was lent as if it were its own. A pool that broke, or was left with items undone, is not lent again.
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
        """Lets the workers that are kept load a module, while whoever called goes on. A pool that broke meanwhile is given up."""
        if self._kept is None:
            return
        try:
            for _ in range(self._jobs):
                self._kept.submit(load, module)
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


def load(module: str) -> None:
    """Imports a module beforehand."""
    with contextlib.suppress(Exception):  # told when it is needed
        importlib.import_module(module)


def run_all(
    tasks: Iterable[Task],
    function: Callable[[Task], Result],
    open_executor: Callable[[int], Executor],
    *,
    jobs: int,
) -> Iterator[tuple[Task, Result | Casualty]]:
    """Results as they are ready, in any order. Few tasks are held at a time, so `tasks` may be long and lazy.

    Raises `LabError` that a task raises (a full disk is not the item's fault) or when no worker can be kept alive.
    """
    unlucky: list[Task] = []
    for task, result in _round(tasks, function, open_executor, jobs):
        if isinstance(result, Casualty):
            unlucky.append(task)
        else:
            yield task, result
    for task in unlucky:
        yield from _round([task], function, open_executor, 1)


def _round(
    tasks: Iterable[Task], function: Callable[[Task], Result], open_executor: Callable[[int], Executor], jobs: int
) -> Iterator[tuple[Task, Result | Casualty]]:
    waiting = iter(tasks)
    first = next(waiting, None)
    if first is None:
        return
    restarts = 0
    executor = open_executor(jobs)
    running: dict[Future[Any], Task] = {}
    ready: list[Task] = [first]
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
                            f"worker processes die as soon as they start: {error}",
                            remedy="Look at the memory and process limits of this account",
                        ) from None
                    executor.shutdown(cancel_futures=True)
                    executor = open_executor(jobs)
                    continue
                ready.pop()
            if not running:
                break
            done, _ = wait(running, return_when=FIRST_COMPLETED)
            for future in done:
                yield running.pop(future), _result(future)
        finished = True
    finally:
        executor.shutdown(wait=finished, cancel_futures=not finished)


def _result(future: Future[Any]) -> Any:
    error = future.exception()
    if error is None:
        return future.result()
    if isinstance(error, LabError):
        raise error
    return Casualty(_reason(error))


def _reason(error: BaseException) -> str:
    if isinstance(error, TimeoutError):
        return "it took longer than deadline_s allows"
    if isinstance(error, MemoryError):
        return "it needs more memory than a worker may have"
    code = getattr(error, "exitcode", None)
    if isinstance(code, int) and code < 0:
        with contextlib.suppress(ValueError):
            return f"its worker was killed ({signal.Signals(-code).name})"
    return f"its worker did not come back ({type(error).__name__}: {error})"


def _start_worker(memory_mb: int) -> None:
    """A worker leaves interrupts to its parent, dies with it, and keeps to its memory."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    if sys.platform == "linux":
        import ctypes

        ctypes.CDLL(None, use_errno=True).prctl(1, signal.SIGKILL)
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
