"""Pages shared among workers: no worker waits for another one's."""

from __future__ import annotations

from concurrent.futures import Executor, Future
from pathlib import Path
from threading import Timer
from typing import Any

from reports import build
from reports.plan import Planned
from reports.results import DATABASE


class FirstIsSlow(Executor):
    """Done at once, but for the first task, which ends when the last of `count` pages is asked for; `late` where that does not come."""

    def __init__(self, count: int) -> None:
        self.left, self.late = count, False
        self.made: list[tuple[str, list[str], str]] = []
        self.first: Future[Any] = Future()
        self.timer = Timer(5.0, self.end, kwargs={"late": True})

    def end(self, late: bool = False) -> None:
        self.late = self.late or late
        if not self.first.done():
            self.first.set_result(self.made)

    def submit(self, _fn: Any, /, *args: Any, **_kwargs: Any) -> Future[Any]:
        begins = not self.timer.is_alive() and not self.late
        future = self.first if begins else Future()
        made: list[tuple[str, list[str], str]] = [(one.path, [], "") for one in args[-1]]
        self.left -= len(made)
        if begins:
            self.made = made
            self.timer.start()
        else:
            future.set_result(made)
        if not self.left:
            self.timer.cancel()
            self.end()
        return future


def test_a_long_task_does_not_keep_the_others_from_being_asked_for(tmp_path: Path) -> None:
    (tmp_path / DATABASE).touch()
    pages = [Planned(f"recordings/{i}.html", "recording", str(i)) for i in range(3000)]
    executor = FirstIsSlow(len(pages))
    made = build._shared(tmp_path, "1GB", False, False, iter(pages), len(pages), lambda: executor, 2)
    assert sorted(path for path, _, _ in made) == sorted(one.path for one in pages)
    assert not executor.late
