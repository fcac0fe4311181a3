"""What arguments of the command line may be, and progress for whoever is watching. Imports as little as `cli` does."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Iterable
from typing import Any


class Version(argparse.Action):
    """Asks for the version only when it is asked for: that costs as much as all the rest of `--help`."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        from importlib import metadata

        parser.exit(message=f"dealab {metadata.version('dealab')}\n")


def tracked(items: Iterable[Any], count: int, what: str) -> Iterable[Any]:
    """Progress on stderr, only where somebody is watching."""
    if count == 0 or not sys.stderr.isatty():
        return items
    from tqdm import tqdm

    watched: Iterable[Any] = tqdm(items, total=count, desc=what, file=sys.stderr, leave=False)
    return watched


def jobs(text: str) -> int:
    if not text.isdecimal() or int(text) > 1024:
        raise argparse.ArgumentTypeError(f'"{text}" is not a number of processes from 0 to 1024')
    return int(text)


def days(text: str) -> float:
    if not text.isdecimal() or int(text) > 36_500:
        raise argparse.ArgumentTypeError(f'"{text}" is not a number of days')
    return int(text)


def processors() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def argument(*names: str, **options: Any) -> Callable[[argparse.ArgumentParser], object]:
    return lambda parser: parser.add_argument(*names, **options)
