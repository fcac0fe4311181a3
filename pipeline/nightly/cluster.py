"""Workers of a dask.distributed cluster in place of local ones, behind the same `concurrent.futures.Executor`.

The workers have to see the raw folders and the lab under the same paths, have the same dealab installed, and work one
task at a time (`dask worker --nthreads 1`). An item whose worker dies is given to another one as often as the scheduler
allows (`distributed.scheduler.allowed-failures`), then counts as lost. Limits of time and memory are those of the
cluster's workers: the lab's own `deadline_s` and `memory_mb` are for local ones.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor, Future
from typing import Any

from schemas.errors import LabError

_CONNECT_S = "20s"


def executors(address: str) -> tuple[Callable[[int], Executor], int]:
    """A function that gives executors on the cluster at `address` (its argument is ignored), and the cluster's size.

    Raises `LabError` when the cluster cannot be reached or the extra is not installed.
    """
    try:
        from distributed import Client
    except ImportError:
        raise LabError(
            "dask.distributed is not installed", remedy='Install the extra: pip install "dealab[cluster]"'
        ) from None
    try:
        client: Any = Client(address, timeout=_CONNECT_S)
    except (OSError, ValueError) as error:
        raise LabError(
            f"the cluster does not answer: {error}", where=address, expected="the address of a dask scheduler"
        ) from None
    return lambda _jobs: _ClusterExecutor(client), max(1, sum(client.ncores().values()))


class _ClusterExecutor(Executor):
    """dask's own executor with the whole interface of the standard library's."""

    def __init__(self, client: Any) -> None:
        self._executor = client.get_executor(pure=False, retries=0)

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = self._executor.submit(fn, *args, **kwargs)
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Without waiting, dask cancels what is outstanding."""
        self._executor.shutdown(wait=wait and not cancel_futures)
