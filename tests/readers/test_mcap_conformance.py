"""Every file of the MCAP conformance set yields exactly the records that its authors list, through the reader's walker."""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path
from typing import Any

import pytest

from ingest import mcap_records
from ingest.mcap_chunks import Chunk, opened
from ingest.mcap_records import CHUNK, FOOTER, LAYOUTS, MAGIC, MESSAGE_INDEX, ByteSource, FileSource, fields, walk


def _plain(value: Any) -> Any:
    """A field as the lists write it: numbers as text, bytes as lists of numbers."""
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, memoryview):
        return [str(byte) for byte in value]
    return str(value)


def _records(source: ByteSource, start: int) -> list[dict[str, Any]]:
    records: list[dict[str, Any]] = []
    for opcode, offset, length in walk(source, start):
        if opcode == CHUNK:
            with opened(source, Chunk.parse(source, offset, length)) as content:
                records += _records(content, 0)
        elif opcode != MESSAGE_INDEX:
            found = fields(opcode, source.read(offset, length))
            found.pop("crc", None)
            records.append({"type": LAYOUTS[opcode][0], "fields": {k: _plain(v) for k, v in found.items()}})
        if opcode == FOOTER:
            break
    return records


@pytest.fixture(scope="module")
def conformance(real_data: Path) -> Path:
    folder = real_data / "mcap_conformance"
    if not folder.is_dir():
        pytest.skip(f"no folder {folder}")
    return folder


def test_all_416_files_give_the_listed_records(conformance: Path) -> None:
    read = 0
    with (
        zipfile.ZipFile(conformance / "mcap_files.zip") as files,
        zipfile.ZipFile(conformance / "expected_json.zip") as lists,
    ):
        for name in files.namelist():
            if not name.endswith(".mcap"):
                continue
            expected = json.loads(lists.read(name.removesuffix(".mcap") + ".json"))["records"]
            found = _records(FileSource(io.BytesIO(files.read(name))), len(MAGIC))
            assert found == [{"type": r["type"], "fields": dict(r["fields"])} for r in expected], name
            read += 1
    assert read == 416


def test_the_scan_finds_nothing_wrong_with_any_of_them(conformance: Path, tmp_path: Path) -> None:
    """Both ways to every file: what the scan collects equals the messages and metadata that the lists have."""
    from ingest.mcap_scan import scan

    class Collector:
        def __init__(self) -> None:
            self.found: list[tuple[int, int, list[str]]] = []

        def add(self, content: memoryview, log_time: int, sequence: int) -> None:
            self.found.append((log_time, sequence, [str(b) for b in content]))

    with (
        zipfile.ZipFile(conformance / "mcap_files.zip") as files,
        zipfile.ZipFile(conformance / "expected_json.zip") as lists,
    ):
        for name in files.namelist():
            if not name.endswith(".mcap"):
                continue
            path = tmp_path / "file.mcap"
            path.write_bytes(files.read(name))
            collector = Collector()
            found = scan(path, lambda channel, schema, collector=collector: collector, ("myMetadata", "m"))
            records = json.loads(lists.read(name.removesuffix(".mcap") + ".json"))["records"]
            messages = [dict(r["fields"]) for r in records if r["type"] == "Message"]
            assert collector.found == [(int(m["log_time"]), int(m["sequence"]), m["data"]) for m in messages], name
            assert found.problems == [], name
            assert found.message_count == len(messages)


def test_opcodes_are_those_of_the_mcap_package() -> None:
    from mcap.opcode import Opcode

    for opcode in Opcode:
        assert getattr(mcap_records, opcode.name) == opcode.value
        assert LAYOUTS[opcode.value][0].upper() == opcode.name.replace("_", "")
