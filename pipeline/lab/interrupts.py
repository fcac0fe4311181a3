"""Being told to end, by Ctrl-C or by the system, while a lab is written: an interrupt, whoever hears of it first."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Iterator
from types import FrameType

from schemas.database import interrupt_queries

_TOLD_BY = (signal.SIGINT, signal.SIGTERM)


@contextlib.contextmanager
def end_when_told() -> Iterator[None]:
    """Makes SIGTERM an interrupt like Ctrl-C: workers are stopped and the lock is given back.

    DuckDB turns an interrupt that falls into a query into an error of its own, which may become others on its way; any
    error after an interrupt is the interrupt again. A signal that this process was started to ignore stays ignored.
    """
    told: list[int] = []

    def interrupt(number: int, _frame: FrameType | None) -> None:
        told.append(number)
        interrupt_queries()
        raise KeyboardInterrupt

    before = {}
    try:
        for number in _TOLD_BY:
            if signal.getsignal(number) != signal.SIG_IGN:
                before[number] = signal.signal(number, interrupt)
    except ValueError:  # not in the main thread: whoever runs us handles signals
        yield
        return
    try:
        yield
    except Exception:
        if told:
            raise KeyboardInterrupt from None
        raise
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
