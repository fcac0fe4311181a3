"""Results that are finished and not yet published, one file per item, so that a killed night loses none of them.

A file holds a header (what was done and how it ended, and the size of each table; JSON) and the item's rows of each
table (Arrow streams). It is written under a temporary name and renamed; its checksum tells a file that the machine lost
half of.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import zlib
from collections.abc import Container, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final

import pyarrow as pa

from ingest.atomic import written_whole
from schemas.errors import AccidentError, LabError

RECORDING: Final = "recording"
SPECIMEN: Final = "specimen"
DIAGNOSIS: Final = "diagnosis"
GROUP: Final = "group"
"""Stages that items belong to."""
OK, DAMAGED, QUARANTINED, PENDING, FAILED = "ok", "damaged", "quarantined", "pending", "failed"
USABLE = (OK, DAMAGED)
ACCIDENT: Final = "accident"
"""Fact of an outcome that says nothing about its item: the machine had trouble, and the next night tries again."""
_MAGIC = b"dealab-journal-2\n"
_ENDING = ".entry"


@dataclass(frozen=True, slots=True)
class Freshness:
    """What a result was made from. Two of them are equal where the result needs not be made again."""

    input_hash: str
    code_version: str
    settings_hash: str

    def differences(self, now: Freshness) -> tuple[str, ...]:
        """Which of the three differ, in words."""
        pairs = (
            ("input", self.input_hash, now.input_hash),
            ("code", self.code_version, now.code_version),
            ("settings", self.settings_hash, now.settings_hash),
        )
        return tuple(name for name, old, new in pairs if old != new)


@dataclass(frozen=True, slots=True)
class Outcome:
    """How an item ended.

    Parameters
    ----------
    item_id, stage : which item, and its stage
    freshness : what it was made from
    outcome : ok, damaged, quarantined, pending or failed
    seconds : time it took
    error : why it failed or was refused, None when it did not
    facts : what the plan has to know about it, plain JSON values; `ACCIDENT` among them
    """

    item_id: str
    stage: str
    freshness: Freshness
    outcome: str
    seconds: float = 0.0
    error: str | None = None
    facts: Mapping[str, Any] = field(default_factory=dict)

    @property
    def accident(self) -> bool:
        """Whether an accident of the night ended it, which is no verdict on what it is about."""
        return bool(self.facts.get(ACCIDENT))


def is_accident(error: BaseException) -> bool:
    """Whether an exception tells of the machine (a disk, rights, a broken installation) rather than of the data.

    Libraries raise `OSError` for damaged files as well, without a number.
    """
    return isinstance(error, AccidentError | ImportError) or (isinstance(error, OSError) and error.errno is not None)


def make_item_id(stage: str, name: str) -> str:
    """The name of an item: its stage and the content, specimen or group that it is about."""
    return f"{stage}:{name}"


def entry_name(item_id: str) -> str:
    """The name of an item's file: a hash, since item ids hold whatever people called their specimens."""
    return f"{hashlib.sha256(item_id.encode()).hexdigest()[:40]}{_ENDING}"


def entry_path(folder: Path, item_id: str) -> Path:
    """The file of an item."""
    return folder / entry_name(item_id)


def write_entry(folder: Path, outcome: Outcome, tables: Mapping[str, pa.Table]) -> Path:
    """Keeps an item's outcome and rows; a complete file when this returns. Raises `LabError` for an unwritable lab."""
    streams = {name: _make_stream(table) for name, table in sorted(tables.items()) if table.num_rows}
    about = asdict(outcome) | {"tables": {name: stream.size for name, stream in streams.items()}}
    header = json.dumps(about, ensure_ascii=True).encode("ascii")
    content = b"".join([len(header).to_bytes(8, "little"), header, *streams.values()])
    path = entry_path(folder, outcome.item_id)
    try:
        with written_whole(path, durable=False) as temporary, temporary.open("wb") as file:
            file.write(_MAGIC)
            file.write(zlib.crc32(content).to_bytes(4, "little"))
            file.write(content)
    except OSError as error:
        raise explain_unwritable(folder, error) from error
    return path


def explain_unwritable(folder: Path, error: OSError) -> LabError:
    """The error of a lab that cannot be written: it stops the night, since no item is to blame."""
    if error.errno in (errno.EISDIR, errno.ENOTDIR, errno.EEXIST, errno.ENOTEMPTY):
        return LabError(
            f"something stands in the place of a file or folder of the lab: {error.strerror}",
            where=str(error.filename2 or error.filename or folder),
            remedy="Remove it, or move it out of the lab, and run the nightly again; what is finished is kept",
        )
    return LabError(
        f"the lab cannot be written: {error.strerror or error}",
        where=str(folder),
        remedy="Free disk space or permissions and run the nightly again; what is finished is kept",
    )


def read_outcome(path: Path) -> Outcome | None:
    """The outcome in an entry; None for a file that is not whole."""
    content = _read_content(path)
    return None if content is None else _parse_outcome(content)


def read_tables(path: Path, only: Container[str] | None = None) -> dict[str, pa.Table]:
    """The rows in an entry that `read_outcome` found whole: of all tables, or of those named."""
    content = _read_content(path)
    if content is None:
        raise LabError(
            "results that a worker has kept are not in the lab",
            where=str(path),
            remedy="Let nobody change .work in the lab, give all workers of a cluster the lab under the same path, and"
            " run the nightly again",
        )
    header, at = _read_header(content)
    body = pa.py_buffer(content)
    tables = {}
    for name, size in header["tables"].items():
        if only is None or name in only:
            tables[name] = pa.ipc.open_stream(body.slice(at, size)).read_all()
        at += size
    return tables


def list_entries(folder: Path) -> Iterator[tuple[Path, Outcome]]:
    """All whole entries of a journal, in no order."""
    if folder.is_dir():
        with os.scandir(folder) as found:
            for one in found:
                outcome = read_outcome(Path(one.path)) if one.name.endswith(_ENDING) else None
                if outcome is not None:
                    yield Path(one.path), outcome


def _read_content(path: Path) -> bytes | None:
    try:
        data = path.read_bytes()
    except OSError:
        return None
    start = len(_MAGIC) + 4
    if not data.startswith(_MAGIC) or zlib.crc32(data[start:]) != int.from_bytes(data[len(_MAGIC) : start], "little"):
        return None
    return data[start:]


def _read_header(content: bytes) -> tuple[dict[str, Any], int]:
    """The header of an entry, and where its tables begin."""
    end = 8 + int.from_bytes(content[:8], "little")
    header: dict[str, Any] = json.loads(content[8:end])
    return header, end


def _parse_outcome(content: bytes) -> Outcome:
    values, _ = _read_header(content)
    del values["tables"]
    return Outcome(**{**values, "freshness": Freshness(**values["freshness"])})


def _make_stream(table: pa.Table) -> pa.Buffer:
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, table.schema.remove_metadata()) as stream:
        stream.write_table(table)
    return sink.getvalue()
