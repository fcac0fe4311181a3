"""MCAP files with one JSON or protobuf message per sample, read by a mapping."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from google.protobuf import descriptor_pb2
from mcap.writer import Writer

from ingest.mapping import FileMapping
from ingest.mcap_reader import read_mcap
from schemas.errors import RefusedError, UnmappedError
from tests.helpers.mcap_files import METADATA, START, block, descriptor_set, message_type

MS = 1_000_000
Message = tuple[str, int, bytes]


def write(
    path: Path,
    messages: Sequence[Message],
    *,
    encoding: str = "json",
    schema: tuple[str, str, bytes] = ("any", "jsonschema", b"{}"),
    metadata: dict[str, str] | None = None,
) -> Path:
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        if metadata is not None:
            writer.add_metadata("recording", metadata)
        schema_id = writer.register_schema(*schema)
        ids: dict[str, int] = {}
        for topic, log_time, data in messages:
            if topic not in ids:
                ids[topic] = writer.register_channel(topic, encoding, schema_id)
            writer.add_message(ids[topic], log_time, data, log_time)
        writer.finish()
    return path


def mapping(columns: dict[str, Any], **more: Any) -> FileMapping:
    return FileMapping.parse({"format": "mcap", "columns": columns, "recording": METADATA, **more}, stem="run")


def as_json(topic: str, rows: Sequence[Any], step: int = MS) -> list[Message]:
    return [(topic, START + i * step, json.dumps(row).encode()) for i, row in enumerate(rows)]


def test_json_fields_with_log_time(tmp_path: Path) -> None:
    rows = [{"wrench": {"force": {"z": 0.5 * i}}, "raw": [i, 10 * i]} for i in range(20)]
    path = write(tmp_path / "run.mcap", as_json("/cell", rows))
    recording = read_mcap(
        path,
        mapping(
            {
                "force": {"column": "/cell", "field": "wrench.force.z", "unit": "mN", "scale": 2.0, "offset": 1.0},
                "displacement": {"column": "/cell", "field": "raw", "index": 1, "unit": "um", "resolution": 0.5},
            }
        ),
    )
    force, displacement = recording.channels
    assert recording.problems == recording.notes == ()
    assert recording.metadata["recording_id"] == "run_7"
    assert (force.quantity, force.unit) == ("force", "mN")
    assert force.values.tolist() == [1.0 + i for i in range(20)]
    assert force.time_ns.tolist() == [START + i * MS for i in range(20)]
    assert displacement.values.tolist() == [10.0 * i for i in range(20)]
    assert displacement.metadata == {"resolution": "0.5"}


def test_json_with_a_time_field(tmp_path: Path) -> None:
    rows = [{"t": 0.25 * i, "f": float(i)} for i in range(8)]
    path = write(tmp_path / "run.mcap", as_json("/cell", rows, step=7))
    recording = read_mcap(
        path, mapping({"force": {"column": "/cell", "field": "f", "unit": "N"}}, time={"column": "t", "unit": "s"})
    )
    started = 1_772_000_000 * 10**9
    assert recording.channels[0].time_ns.tolist() == [started + i * 250 * MS for i in range(8)]


def test_json_with_times_as_text(tmp_path: Path) -> None:
    rows = [{"at": f"2026-02-25T06:13:2{i}+00:00", "f": float(i)} for i in range(5)]
    path = write(tmp_path / "run.mcap", as_json("/cell", rows, step=7))
    recording = read_mcap(
        path, mapping({"force": {"column": "/cell", "field": "f", "unit": "N"}}, time={"column": "at", "format": "iso"})
    )
    assert recording.channels[0].time_ns.tolist() == [START + i * 1000 * MS for i in range(5)]


def test_topics_with_rates_of_their_own(tmp_path: Path) -> None:
    messages = as_json("/cell", [{"v": i} for i in range(10)]) + as_json(
        "/laser", [{"v": -i} for i in range(4)], 3 * MS
    )
    recording = read_mcap(
        write(tmp_path / "run.mcap", messages),
        mapping(
            {
                "force": {"column": "/cell", "field": "v", "unit": "N"},
                "displacement": {"column": "/laser", "field": "v", "unit": "mm"},
            }
        ),
    )
    assert [c.values.size for c in recording.channels] == [10, 4]
    assert recording.channels[1].time_ns.tolist() == [START + i * 3 * MS for i in range(4)]


def test_bad_messages_and_values_are_counted(tmp_path: Path) -> None:
    messages = as_json("/cell", [{"v": 1.0}, {"v": None}, {"other": 2}, {"v": "high"}, {"v": 3.0}, {"v": True}])
    messages += [("/cell", START + 9 * MS, b"{not json"), ("/cell", START + 10 * MS, b"[" * 100_000)]
    recording = read_mcap(
        write(tmp_path / "run.mcap", messages), mapping({"force": {"column": "/cell", "field": "v", "unit": "N"}})
    )
    assert np.array_equal(recording.channels[0].values, [1, np.nan, np.nan, np.nan, 3, 1], equal_nan=True)
    assert "/cell: 2 messages could not be decoded" in recording.problems
    assert any("high" in problem for problem in recording.problems)


def test_a_sparse_column_has_no_sample_where_the_field_is_absent(tmp_path: Path) -> None:
    messages = as_json("/cell", [{"v": 1.0}, {}, {"v": None}, {"v": 4.0}])
    recording = read_mcap(
        write(tmp_path / "run.mcap", messages),
        mapping({"force": {"column": "/cell", "field": "v", "unit": "N", "sparse": True}}),
    )
    assert recording.channels[0].values.tolist() == [1.0, 4.0]
    assert recording.channels[0].time_ns.tolist() == [START, START + 3 * MS]


def descriptors() -> bytes:
    """Two files, the importing one first, as some writers put them."""
    fields = descriptor_pb2.FieldDescriptorProto
    files = descriptor_pb2.FileDescriptorSet()
    reading = files.file.add(name="reading.proto", package="lab", syntax="proto3", dependency=["vector.proto"])
    message = reading.message_type.add(name="Reading")
    message.field.add(name="force", number=1, type=fields.TYPE_MESSAGE, label=1, type_name=".lab.Vector")
    message.field.add(name="counts", number=2, type=fields.TYPE_SINT32, label=3)
    message.field.add(name="stamp", number=3, type=fields.TYPE_FIXED64, label=1)
    message.field.add(name="name", number=4, type=fields.TYPE_STRING, label=1)
    vector = files.file.add(name="vector.proto", package="lab", syntax="proto3")
    inner = vector.message_type.add(name="Vector")
    for number, name in enumerate("xyz", start=1):
        inner.field.add(name=name, number=number, type=fields.TYPE_FLOAT, label=1)
    return files.SerializeToString()


def readings(path: Path) -> Path:
    ordered = descriptor_pb2.FileDescriptorSet.FromString(descriptors())
    ordered.file.sort(key=lambda f: f.name, reverse=True)
    kind = message_type(ordered.SerializeToString(), "lab.Reading")
    messages = [
        (
            "/cell",
            START + i * MS,
            kind(
                force={"z": 0.5 * i} if i != 3 else None, counts=[i, -i] if i != 2 else [], stamp=i * 2 * MS
            ).SerializeToString(),
        )
        for i in range(6)
    ]
    return write(path, messages, encoding="protobuf", schema=("lab.Reading", "protobuf", descriptors()))


def test_protobuf_fields_by_the_schema_in_the_file(tmp_path: Path) -> None:
    recording = read_mcap(
        readings(tmp_path / "run.mcap"),
        mapping(
            {
                "force": {"column": "/cell", "field": "force.z", "unit": "N"},
                "displacement": {"column": "/cell", "field": "counts.1", "unit": "um"},
            },
            time={"column": "stamp", "unit": "ns"},
        ),
    )
    force, displacement = recording.channels
    assert np.array_equal(force.values, [0, 0.5, 1, np.nan, 2, 2.5], equal_nan=True)
    assert np.array_equal(displacement.values, [0, -1, np.nan, -3, -4, -5], equal_nan=True)
    assert force.time_ns.tolist() == [START + i * 2 * MS for i in range(6)]


@pytest.mark.parametrize(
    ("field", "expected"),
    [
        ("torque", "force, counts, stamp, name"),
        ("force.w", "x, y, z"),
        ("force", "holds more"),
        ("counts", "holds more"),
        ("counts.one", "a list"),
        ("stamp.seconds", "without deeper"),
        ("name", "numbers"),
    ],
)
def test_a_protobuf_field_that_is_not_there_is_refused(tmp_path: Path, field: str, expected: str) -> None:
    with pytest.raises(RefusedError) as caught:
        read_mcap(readings(tmp_path / "run.mcap"), mapping({"force": {"column": "/cell", "field": field, "unit": "N"}}))
    assert expected in str(caught.value)


@pytest.mark.parametrize("data", [b"", b"\xff" * 30, descriptors()[:-20], descriptor_set()])
def test_a_protobuf_schema_that_cannot_be_used_is_refused(tmp_path: Path, data: bytes) -> None:
    path = write(
        tmp_path / "run.mcap", [("/cell", START, b"")], encoding="protobuf", schema=("lab.Reading", "protobuf", data)
    )
    with pytest.raises(RefusedError, match=r"lab\.Reading"):
        read_mcap(path, mapping({"force": {"column": "/cell", "field": "force.z", "unit": "N"}}))


def test_sample_blocks_by_a_mapping(tmp_path: Path) -> None:
    """The topic of another laboratory, renamed and scaled; the file's own metadata, corrected by the mapping's."""
    path = write(
        tmp_path / "run.mcap",
        [
            ("/load_cell", START, block(START, 1e-3, [1.0, 2.0])),
            ("/load_cell", START + 2 * MS, block(START + 2 * MS, 1e-3, [3.0])),
        ],
        encoding="protobuf",
        schema=("dealab.SampleBlock", "protobuf", descriptor_set()),
        metadata={**METADATA, "operator": "first", "specimen_id": "wrong"},
    )
    recording = read_mcap(path, mapping({"force": {"column": "/load_cell", "unit": "mN", "scale": 10.0}}))
    assert recording.channels[0].values.tolist() == [10.0, 20.0, 30.0]
    assert recording.channels[0].time_ns.tolist() == [START, START + MS, START + 2 * MS]
    assert (recording.metadata["operator"], recording.metadata["specimen_id"]) == ("first", "acrylic_3")


@pytest.mark.parametrize(
    ("column", "expected"),
    [
        ({"column": "/nothing", "field": "v", "unit": "N"}, '"/cell"'),
        ({"column": "/cell", "field": "w", "unit": "N"}, "one of v"),
        ({"column": "/cell", "unit": "N"}, "no numbers"),
        ({"column": 3, "unit": "N"}, "a topic"),
        ({"column": "/cell", "field": "v"}, "no unit"),
    ],
)
def test_a_wrong_mapping_is_refused_with_what_there_is(tmp_path: Path, column: dict[str, Any], expected: str) -> None:
    path = write(tmp_path / "run.mcap", as_json("/cell", [{"v": 1.0}]))
    with pytest.raises(RefusedError) as caught:
        read_mcap(path, mapping({"force": column}))
    assert expected in str(caught.value)


def test_other_encodings_are_refused(tmp_path: Path) -> None:
    path = write(
        tmp_path / "run.mcap", [("/cell", START, b"x")], encoding="ros1", schema=("a/B", "ros1msg", b"float64 v")
    )
    with pytest.raises(RefusedError, match='"ros1"'):
        read_mcap(path, mapping({"force": {"column": "/cell", "field": "v", "unit": "N"}}))


def test_without_a_mapping_it_is_unmapped(tmp_path: Path) -> None:
    path = write(tmp_path / "run.mcap", as_json("/cell", [{"v": 1.0}]))
    with pytest.raises(UnmappedError, match=r"/cell \(json, any\)"):
        read_mcap(path)


def test_damage_in_a_mapped_file_is_told(tmp_path: Path) -> None:
    path = write(tmp_path / "run.mcap", as_json("/cell", [{"v": i} for i in range(50)]))
    content = path.read_bytes()
    path.write_bytes(content[:-30])
    recording = read_mcap(path, mapping({"force": {"column": "/cell", "field": "v", "unit": "N"}}))
    assert recording.channels[0].values.size == 50
    assert len(recording.problems) == 1


@pytest.mark.parametrize("encoding", ["json", "protobuf"])
def test_true_and_false_in_messages_are_told(tmp_path: Path, encoding: str) -> None:
    """A flag beside the force was a force of 0 and 1 N without a word."""
    rows = [{"closed": i > 2} for i in range(5)]
    if encoding == "json":
        path = write(tmp_path / "run.mcap", as_json("/cell", rows))
    else:
        files = descriptor_pb2.FileDescriptorSet()
        fields = descriptor_pb2.FieldDescriptorProto
        valve = files.file.add(name="valve.proto", package="lab", syntax="proto3").message_type.add(name="Valve")
        valve.field.add(name="closed", number=1, type=fields.TYPE_BOOL, label=1)
        described = files.SerializeToString()
        kind = message_type(described, "lab.Valve")
        messages = [("/cell", START + i * MS, kind(**row).SerializeToString()) for i, row in enumerate(rows)]
        path = write(tmp_path / "run.mcap", messages, encoding=encoding, schema=("lab.Valve", encoding, described))
    raw = read_mcap(path, mapping({"force": {"column": "/cell", "field": "closed", "unit": "N"}}))
    assert raw.channels[0].values.tolist() == [0, 0, 0, 1, 1]
    assert raw.notes == ("force: true and false are read as 1 and 0",)
