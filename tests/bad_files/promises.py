"""What every reader promises for whatever bytes it is given, and the check of one file against that.

A file is refused with a reason, or read. What is read has ordered times and finite or lost values. What was made from a
file with checksums and is called `ok` is that file's content to the last bit; what is called damaged is a part of it
where each part has its own checksum. No value comes from another file.
"""

from __future__ import annotations

import os
import traceback
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ingest.canonical import canonical
from ingest.read import read_raw
from schemas.errors import DealabError
from schemas.recording import RawRecording, Recording
from tests.bad_files.beside import SECRET
from tests.bad_files.seeds import NOTHING, PARTS, Seed

REFUSED, DAMAGED, OK, TABLE = "refused", "damaged", "ok", "table"
LONGEST_S = 1.0
LARGEST_MB = 300.0

Samples = Mapping[str, frozenset[tuple[int, float]]]


@dataclass(frozen=True)
class Truth:
    """The content of an undamaged seed."""

    samples: Samples
    metadata: Any
    kind: type


@dataclass(frozen=True)
class Verdict:
    """What became of a file: how it was read, how long that took, and which promise was broken, if any."""

    outcome: str
    seconds: float
    broken: str | None = None
    found: str = ""
    """What was read or why not, to compare."""


class _AnotherFileError(Exception):
    """What was read is not of the file, whatever becomes of it later."""


def truth(seed: Seed, path: Path) -> Truth:
    """The content of a seed as its reader gives it; the readers' own tests hold that against known numbers."""
    path.write_bytes(seed.content)
    found = _read(seed, path)
    if isinstance(found, Recording):
        assert found.problems == (), (seed, found.problems)
        return Truth(_samples(found), found.metadata, Recording)
    return Truth({}, None, type(found))


def examined(seed: Seed, original: Truth, path: Path) -> Verdict:
    """Reads a file that was made from a seed."""
    started = _processor_s()
    try:
        found = _read(seed, path)
    except DealabError as error:
        seconds = _processor_s() - started
        too_long = None if len(str(error)) < 4000 else f"a reason of {len(str(error))} characters"
        return Verdict(REFUSED, seconds, too_long, str(error))
    except _AnotherFileError as error:
        return Verdict(OK, _processor_s() - started, str(error))
    except Exception:
        return Verdict("crash", _processor_s() - started, "crash: " + traceback.format_exc(limit=-4))
    seconds = _processor_s() - started
    if not isinstance(found, Recording):
        return Verdict(TABLE, seconds, None, repr(found))
    broken = _disorder(found)
    if broken is None and seed.sealed != NOTHING:
        broken = _difference(found, original, seed.sealed)
    return Verdict(found.status, seconds, broken, _describe(found))


def _describe(recording: Recording) -> str:
    """All of a recording, to the last bit, as a text to compare."""
    channels = {n: (c.time_ns.tobytes(), c.values.tobytes()) for n, c in recording.channels.items()}
    return repr((sorted(channels.items()), recording.metadata, recording.problems))


def _processor_s() -> float:
    """Processor time of this process and of the children that it has waited for: other programs do not count."""
    used = os.times()
    return used.user + used.system + used.children_user + used.children_system


def _read(seed: Seed, path: Path) -> Any:
    raw = read_raw(path, seed.mapping)
    leaked = [c.quantity for c in raw.channels if np.any(c.values == SECRET)] if isinstance(raw, RawRecording) else []
    if leaked:
        raise _AnotherFileError(f"values of another file in {', '.join(leaked)}")
    return canonical(raw, where=path.name) if isinstance(raw, RawRecording) else raw


def _samples(recording: Recording) -> Samples:
    return {
        name: frozenset(zip(c.time_ns.tolist(), c.values.tolist(), strict=True))
        for name, c in recording.channels.items()
    }


def _disorder(recording: Recording) -> str | None:
    for name, channel in recording.channels.items():
        if channel.time_ns.shape != channel.values.shape:
            return f"{name}: {channel.time_ns.shape} times for {channel.values.shape} values"
        if np.any(np.diff(channel.time_ns) <= 0):
            return f"{name}: times are not ascending"
        if np.any(np.isinf(channel.values)):
            return f"{name}: infinite values"
        if recording.status == OK and np.any(np.isnan(channel.values)):
            return f"{name}: lost samples in a recording called ok"
    return None


def _difference(recording: Recording, original: Truth, sealed: str) -> str | None:
    found = _samples(recording)
    if recording.status == OK:
        if found != original.samples:
            return "other samples than the original's, called ok"
        return None if recording.metadata == original.metadata else "other metadata than the original's, called ok"
    for name, samples in found.items() if sealed == PARTS else ():
        lost = {pair for pair in samples if pair[1] != pair[1]}
        other = samples - lost - original.samples.get(name, frozenset())
        if other:
            return f"{name}: {len(other)} samples that the original does not have, as {sorted(other)[0]}"
    return None
