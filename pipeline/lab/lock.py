"""One nightly at a time per lab: a lock that the kernel gives back when its holder dies, and a note on who holds it."""

from __future__ import annotations

import contextlib
import json
import os
import socket
import time
from collections.abc import Iterator
from datetime import UTC, datetime

from pipeline.lab.lab import Lab
from schemas.errors import LabError

_NOBODY = "another process"
_LOOKS, _BETWEEN_S = 10, 0.05


def describe_holder(lab: Lab) -> str:
    """Who holds the lock, in words, as far as the note beside it says."""
    try:
        note = json.loads(lab.lock_holder.read_text(encoding="utf-8"))
        return f"process {note['pid']} on {note['host']}, since {note['since']}"
    except (OSError, ValueError, KeyError, TypeError):
        return _NOBODY


def _await_holder(lab: Lab) -> str:
    """The same a moment later where nothing is said yet: the note is written once the lock is held."""
    for _ in range(_LOOKS):
        if (found := describe_holder(lab)) != _NOBODY:
            return found
        time.sleep(_BETWEEN_S)
    return _NOBODY


@contextlib.contextmanager
def hold_lab(lab: Lab) -> Iterator[None]:
    """Holds the lab for this process; `LabError` at once, naming the holder, when it is held already.

    Also `LabError` for a link in the lab, through which something elsewhere would be written or removed.
    """
    from filelock import FileLock, Timeout

    lab.refuse_links()
    lock = FileLock(lab.lock, timeout=0)
    try:
        lock.acquire()
    except Timeout:
        raise LabError(
            f"a nightly is at work here: {_await_holder(lab)}",
            where=str(lab.folder),
            remedy="Wait until it has ended",
        ) from None
    except OSError as error:
        raise LabError(
            f"the lab cannot be locked: {error.strerror}",
            where=str(lab.lock),
            remedy="Make the lab folder writable for this user",
        ) from None
    try:
        note = {
            "pid": os.getpid(),
            "host": socket.gethostname(),
            "since": datetime.now(UTC).isoformat(timespec="seconds"),
        }
        lab.lock_holder.write_text(json.dumps(note), encoding="utf-8")
        yield
    finally:
        lab.lock_holder.unlink(missing_ok=True)
        lock.release()


def is_busy(lab: Lab) -> bool:
    """Whether a nightly is at work in the lab now."""
    from filelock import FileLock, Timeout

    if not lab.lock.exists():
        return False
    try:
        with FileLock(lab.lock, timeout=0):
            return False
    except Timeout:
        return True
    except OSError:
        return False
