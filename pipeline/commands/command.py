"""What a command of the command line is, the arguments that several have, and progress of long ones.

Imports little on purpose, as every file of a command does: `dealab --help` is to come at once.
"""

from __future__ import annotations

import argparse
import os
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING, Any, NamedTuple, Self, TypeAlias

from pipeline.lab.lab import DEFAULT_LAB

if TYPE_CHECKING:
    from pathlib import Path

DONE, FAILED, ATTENTION = 0, 1, 3
"""Exit statuses: all done; could not do it; done, but some recordings were refused, are damaged or failed."""

PROGRESS_S = 20.0
"""From one line of progress to the next where nobody watches: a short night has none, a long one few."""
_LONGEST_NAME = 40
"""Letters of a name beside a bar."""

Argument: TypeAlias = Callable[[argparse.ArgumentParser], object]
"""Adds an argument to a parser."""


class Command(NamedTuple):
    """All about a command but its name and what it does, which `pipeline.cli` lists.

    Parameters
    ----------
    examples : what follows the name, a line each
    arguments : its arguments
    run : runs it with the parsed arguments and returns the exit status
    """

    examples: tuple[str, ...]
    arguments: tuple[Argument, ...]
    run: Callable[[argparse.Namespace], int]


def argument(*names: str, **options: Any) -> Argument:
    """An argument as `argparse.ArgumentParser.add_argument` takes it."""
    return lambda parser: parser.add_argument(*names, **options)


def parse_path(text: str) -> Path:
    """A path from the command line; an empty one, as of a variable that is not set, is not the working folder."""
    from pathlib import Path

    if not text:
        raise argparse.ArgumentTypeError("the path is empty")
    return Path(text)


def parse_folder(text: str) -> Path:
    """An existing folder from the command line: one that is not there is a slip of the pen, not an empty one."""
    if not os.path.isdir(text):
        raise argparse.ArgumentTypeError(f'there is no folder "{text[:200]}"')
    return parse_path(text)


def parse_jobs(text: str) -> int:
    """A number of processes from the command line."""
    if not text.isdecimal() or int(text) > 1024:
        raise argparse.ArgumentTypeError(f'"{text}" is not a number of processes from 0 to 1024')
    return int(text)


def parse_limit(text: str) -> int:
    """A limit from the command line, 0 for none."""
    if not text.isdecimal() or len(text) > 12:
        raise argparse.ArgumentTypeError(f'"{text[:40]}" is not a whole number from 0')
    return int(text)


def parse_number(text: str) -> float:
    """A finite number from the command line."""
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not abs(value) < float("inf"):
        raise argparse.ArgumentTypeError(f'"{text[:40]}" is not a number')
    return value


def parse_count(text: str) -> int:
    """A whole number from 1 from the command line."""
    if not text.isdecimal() or not 0 < int(text) <= 1_000_000:
        raise argparse.ArgumentTypeError(f'"{text[:40]}" is not a whole number from 1 to a million')
    return int(text)


def parse_positive(text: str) -> float:
    """A finite number above 0 from the command line."""
    value = parse_number(text)
    if value <= 0:
        raise argparse.ArgumentTypeError(f'"{text[:40]}" is not above 0')
    return value


def count_processors() -> int:
    """How many processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Progress:
    """Progress on stderr: a bar where somebody watches, else a line every `PROGRESS_S` as long as it lasts."""

    def __init__(self) -> None:
        self._is_watched = sys.stderr.isatty()
        self._began = time.monotonic()
        self._step = "begins"
        self._ended = threading.Event()
        self._teller = threading.Thread(target=self._tell, daemon=True)

    def __enter__(self) -> Self:
        if not self._is_watched:
            self._teller.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        if self._teller.is_alive():
            self._teller.join()

    def track(self, items: Iterable[Any], count: int, what: str) -> Iterable[Any]:
        """The tasks and their outcomes, while it is told how many are done; a step without tasks is only named."""
        if count == 0:
            self._step = what
            return items
        return _watch(items, count, what) if self._is_watched else self._count(items, count, what)

    def _count(self, items: Iterable[Any], count: int, what: str) -> Iterator[Any]:
        from schemas.visible import shown

        self._step = f"{what}: 0 of {count}"
        for done, (task, outcome) in enumerate(items, start=1):
            self._step = f"{what}: {done} of {count}, last {shown(task.name)[:_LONGEST_NAME]}"
            yield task, outcome

    def _tell(self) -> None:
        while not self._ended.wait(PROGRESS_S):
            print(f"dealab: after {time.monotonic() - self._began:.0f} s: {self._step}", file=sys.stderr, flush=True)


def _watch(items: Iterable[Any], count: int, what: str) -> Iterator[Any]:
    from tqdm import tqdm

    from schemas.visible import shown

    with tqdm(items, total=count, desc=what, file=sys.stderr, leave=False, dynamic_ncols=True) as bar:
        for task, outcome in bar:
            bar.set_postfix_str(shown(task.name)[:_LONGEST_NAME])
            yield task, outcome


LAB = argument("--lab", type=parse_path, default=DEFAULT_LAB, metavar="LAB", help="the lab (default ./lab)")
RAW = argument("raw", nargs="+", metavar="RAW", help="files, folders or URLs (s3://…) with recordings")
RIGS = argument("--rigs", type=parse_folder, help="folder with <rig_id>.toml (default: rigs/ beside the recordings)")
CLUSTER = argument("--cluster", metavar="ADDRESS", help="dask scheduler whose workers do the work (tcp://host:8786)")
