"""Parsers of compiled code at arm's length: in a child process, which alone dies of a damaged file.

HDF5's library, scipy's MATLAB reader and calamine trust lengths and addresses in the file; some damaged files make them
crash or go round for ever, which no exception can catch. Does not belong here: the parsers, and limits of a whole item (the nightly
has its own).
"""

from __future__ import annotations

import contextlib
import faulthandler
import gc
import math
import os
import pickle
import signal
import struct
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from schemas.errors import RefusedError

Given = ParamSpec("Given")
Value = TypeVar("Value")
_SHORTEST_S = 0.7
_BYTES_PER_S = 2.5e5
"""Slowest parsing of a sound file, one of many small arrays: HDF5 takes 370 bytes for an array of four numbers and 0.2 ms of a
processor to list it, up to 0.7 ms on a machine whose cores are all busy; MDF takes 230 bytes for a channel and 0.15 ms."""
_SET_PARENT_DEATH_SIGNAL = 1
"""PR_SET_PDEATHSIG of Linux."""
_CRASHES = tuple(
    getattr(signal, name) for name in ("SIGSEGV", "SIGBUS", "SIGABRT", "SIGFPE", "SIGILL") if hasattr(signal, name)
)
"""Signals that compiled code ends with."""
_TIME = struct.Struct("d")
"""How a child tells the processor time that a call has taken, ahead of its answer."""


def apart(path: Path, call: Callable[Given, Value], *args: Given.args, **options: Given.kwargs) -> Value:
    """The value of a single call that parses a file; see `Apart`."""
    return Apart(path)(call, *args, **options)


def shield(path: Path, call: Callable[Given, Value], *args: Given.args, **options: Given.kwargs) -> Value:
    """The value of a call that may take as long as it likes, but costs nobody else anything when it crashes; see `Apart`."""
    return Apart(path, bytes_per_s=None)(call, *args, **options)


class Apart:
    """Calls that parse one file, each made in a child process; they share the processor time that the file may take.

    `bytes_per_s` is what sound files of the format are parsed with at least, None for any time.
    """

    def __init__(self, path: Path, *, bytes_per_s: float | None = _BYTES_PER_S) -> None:
        self._path = path
        self._left_s = math.inf if bytes_per_s is None else _SHORTEST_S + path.stat().st_size / bytes_per_s

    def __call__(self, call: Callable[Given, Value], *args: Given.args, **options: Given.kwargs) -> Value:
        """The value of a call; errors that it raises are raised here.

        Raises `RefusedError` when the child dies, or when all calls together take more processor time than a file of
        that size can. Time of other programs does not count. Without `fork` (Windows) the call is made in this process.
        """
        if not hasattr(os, "fork"):
            return call(*args, **options)
        if self._left_s <= 0:
            raise _refusal(self._path, -signal.SIGPROF)
        good, value, used_s = _in_child(self._path, self._left_s, lambda: call(*args, **options))
        self._left_s -= used_s
        if not good:
            raise value
        result: Value = value
        return result


def _in_child(path: Path, seconds: float, call: Callable[[], Any]) -> tuple[bool, Any, float]:
    """(whether it came to an end, its value or error, processor time in s) of a call in a child process."""
    reading, writing = os.pipe()
    parent = os.getpid()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # the child touches nothing that other threads may hold
        child = os.fork()
    if child == 0:
        os.close(reading)
        _answer(writing, parent, seconds, call)
    os.close(writing)
    try:
        with open(reading, "rb") as pipe:
            answer = pipe.read()
    except BaseException:
        with contextlib.suppress(ProcessLookupError):
            os.kill(child, signal.SIGKILL)
        raise
    finally:
        _, status = os.waitpid(child, 0)
    if status:
        raise _refusal(path, os.waitstatus_to_exitcode(status))
    # What the call took, as the child has it: to begin and to end a child of a process with much memory takes time of its own.
    (used_s,) = _TIME.unpack_from(answer)
    good, value = pickle.loads(memoryview(answer)[_TIME.size :])  # noqa: S301 - made by our own child a moment ago
    return good, value, used_s


def end_with_parent() -> None:
    """Lets the kernel end this process when the one that started it ends, even by a kill (Linux)."""
    if sys.platform != "linux":
        return
    import ctypes

    ctypes.CDLL(None, use_errno=True).prctl(_SET_PARENT_DEATH_SIGNAL, signal.SIGKILL)


def _answer(writing: int, parent: int, seconds: float, call: Callable[[], Any]) -> None:
    """The child: makes the call, writes what came of it, and ends without what a Python process does at its end."""
    code = 1
    try:
        end_with_parent()
        if os.getppid() != parent:  # gone before the kernel was told
            return
        gc.freeze()  # a collection that went through all that the parent holds would count as the file's time
        faulthandler.disable()  # the parent says what happened, and libraries of compiled code only how
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, 2)
        for number in (signal.SIGPROF, signal.SIGTERM, signal.SIGINT, *_CRASHES):
            signal.signal(number, signal.SIG_DFL)  # what the parent does about them is not for a child to do
        if seconds < math.inf:
            signal.setitimer(signal.ITIMER_PROF, seconds)
        begin = time.process_time()
        try:
            answer = pickle.dumps((True, call()), protocol=5)
        except Exception as error:
            answer = _pickled(error)
        used_s = time.process_time() - begin
        signal.setitimer(signal.ITIMER_PROF, 0)
        with open(writing, "wb") as pipe:
            pipe.write(_TIME.pack(used_s))
            pipe.write(answer)
        code = 0
    finally:
        os._exit(code)


def _pickled(error: Exception) -> bytes:
    """An exception for the way back, without what was handled when it was raised; one that cannot travel goes as its text."""
    # Where `tblib` is at work (distributed installs it) these would travel too, and errors of compiled code cannot.
    error.__cause__ = error.__context__ = None
    try:
        answer = pickle.dumps((False, error))
        pickle.loads(answer)  # noqa: S301
    except Exception:
        return pickle.dumps((False, ValueError(f"{type(error).__name__}: {error}")))
    return answer


def _refusal(path: Path, code: int) -> RefusedError:
    if -code == signal.SIGPROF:
        what = "its parser does not come to an end"
    elif -code in _CRASHES:
        what = f"its parser crashed ({signal.Signals(-code).name})"
    else:
        what = f"its parser was ended (exit status {code})"
    return RefusedError(
        f"the file cannot be read: {what}",
        where=path.name,
        expected="a whole file",
        remedy="Copy the file again, or save it anew",
    )
