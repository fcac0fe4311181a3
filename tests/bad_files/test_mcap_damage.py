"""Damaged MCAP files: what is whole is kept and nothing else, and what is lost is told."""

from __future__ import annotations

import functools
import random
import struct
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import CompressionType

from ingest.mcap_reader import read_mcap
from schemas.errors import RefusedError, UnmappedError
from schemas.recording import RawRecording
from tests.helpers.mcap_files import (
    DEFINITIONS,
    MAGIC,
    METADATA,
    START,
    block,
    channel,
    chunk,
    message,
    metadata,
    packaged,
    record,
    schema,
    values_of,
    whole,
)

MS = 1_000_000


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("mcap") / "good.mcap"
    packaged(path)
    return path


def read(path: Path, content: bytes) -> RawRecording | None:
    """What is read, None when it is refused; anything else fails the test."""
    path.unlink(
        missing_ok=True
    )  # a file that is written over is put on the disk at once, which takes longer than reading
    path.write_bytes(content)
    try:
        return read_mcap(path)
    except (RefusedError, UnmappedError):
        return None


def content_of(recording: RawRecording) -> dict[str, list[tuple[int, float]]]:
    return {c.quantity: list(zip(c.time_ns.tolist(), c.values.tolist(), strict=True)) for c in recording.channels}


def chunk_blocks(path: Path) -> list[tuple[int, list[int]]]:
    """Where each chunk ends and the numbers of the blocks in it, as the mcap package has indexed them."""
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    return [
        (
            i.chunk_start_offset + i.chunk_length,
            list(range((i.message_start_time - START) // (16 * MS), (i.message_end_time - START) // (16 * MS) + 1)),
        )
        for i in sorted(summary.chunk_indexes, key=lambda i: i.chunk_start_offset)
    ]


@functools.cache
def quantity_values(quantity: str) -> list[float]:
    return values_of(quantity, 192).tolist()


def samples_of(blocks: list[int]) -> dict[str, list[tuple[int, float]]]:
    """The samples of these blocks of a `packaged` file."""
    numbers = [16 * b + i for b in blocks for i in range(16)]
    return {q: [(START + n * MS, quantity_values(q)[n]) for n in numbers] for q in ("force", "displacement")}


def test_the_undamaged_file_is_read_whole(good: Path) -> None:
    recording = read_mcap(good)
    assert recording.problems == recording.notes == ()
    assert recording.metadata == METADATA
    assert content_of(recording) == samples_of(list(range(12)))


def test_cut_at_every_byte_it_gives_all_its_whole_chunks(good: Path, tmp_path: Path) -> None:
    content = good.read_bytes()
    chunks = chunk_blocks(good)
    assert len(chunks) >= 5
    assert [b for _, blocks in chunks for b in blocks] == list(range(12))
    for size in range(len(content)):
        recording = read(tmp_path / "cut.mcap", content[:size])
        kept = [b for end, blocks in chunks if end <= size for b in blocks]
        if not kept:
            assert recording is None, size
            continue
        assert recording is not None, size
        assert recording.problems, size
        assert content_of(recording) == samples_of(kept), size


@functools.cache
def originals() -> dict[str, set[tuple[int, float]]]:
    return {quantity: set(samples) for quantity, samples in samples_of(list(range(12))).items()}


def is_right_or_told(recording: RawRecording | None) -> bool:
    """Nothing but original samples under original names; anything missing or different comes with a problem."""
    if recording is None:
        return True
    found = content_of(recording)
    if not recording.problems:
        return found == samples_of(list(range(12))) and recording.metadata == METADATA
    return all(set(samples) <= originals().get(q, set()) for q, samples in found.items())


@pytest.mark.long
def test_one_flipped_bit_in_every_byte(good: Path, tmp_path: Path) -> None:
    content = good.read_bytes()
    rng = random.Random(7)
    salvaged = 0
    for place in range(len(content)):
        flipped = bytearray(content)
        flipped[place] ^= 1 << rng.randrange(8)
        recording = read(tmp_path / "flipped.mcap", bytes(flipped))
        assert is_right_or_told(recording), place
        salvaged += recording is not None
    # one bit costs at most a chunk of the seven: the first holds the definitions, which the summary repeats
    assert salvaged == len(content)


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_any_other_damage(good: Path, tmp_path: Path, data: st.DataObject) -> None:
    content = bytearray(good.read_bytes())
    for _ in range(data.draw(st.integers(1, 4), label="damages")):
        at = data.draw(st.integers(0, len(content) - 1), label="place")
        kind = data.draw(st.sampled_from(["overwrite", "remove", "insert", "repeat"]), label="kind")
        length = data.draw(st.integers(1, 40), label="length")
        if kind == "overwrite":
            new = data.draw(st.binary(min_size=length, max_size=length), label="bytes")
            content[at : at + length] = new[: len(content) - at]
        elif kind == "remove":
            del content[at : at + length]
        elif kind == "insert":
            content[at:at] = data.draw(st.binary(max_size=length), label="bytes")
        else:
            content[at:at] = content[at : at + length]
    assert is_right_or_told(read(tmp_path / "damaged.mcap", bytes(content)))


@settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(content=st.binary(max_size=300))
def test_noise_is_refused_or_empty(tmp_path: Path, content: bytes) -> None:
    assert read(tmp_path / "noise.mcap", content) is None
    assert read(tmp_path / "noise.mcap", MAGIC + content) is None
    assert read(tmp_path / "noise.mcap", whole(chunk(content))) is None


def test_a_damaged_length_costs_one_chunk_at_most(good: Path, tmp_path: Path) -> None:
    """What lies behind it is found through the index."""
    content = good.read_bytes()
    starts = [end for end, _ in chunk_blocks(good)]
    for length in (0, 5, 40, 700, 10**6, 2**63, 2**64 - 1):
        damaged = bytearray(content)
        place = content.index(b"\x06", starts[1])
        damaged[place + 1 : place + 9] = struct.pack("<Q", length)
        recording = read(tmp_path / "length.mcap", bytes(damaged))
        assert recording is not None
        assert content_of(recording) == samples_of(list(range(12)))
        assert any("index" in problem for problem in recording.problems)


def test_definitions_lost_with_their_chunk_come_from_the_summary(good: Path, tmp_path: Path) -> None:
    content = bytearray(good.read_bytes())
    end, blocks = chunk_blocks(good)[0]
    content[end - 20] ^= 0x40
    recording = read(tmp_path / "first.mcap", bytes(content))
    assert recording is not None
    assert content_of(recording) == samples_of([b for b in range(12) if b not in blocks])
    assert any(
        "checksum" in p and "lost is what was recorded from 2026-02-25T06:13:20.000Z" in p for p in recording.problems
    )
    assert "force: 1 block missing (sequence 0)" in recording.problems
    assert {c.quantity: c.unit for c in recording.channels} == {"force": "N", "displacement": "mm"}


def test_a_lost_chunk_in_the_middle_names_the_missing_blocks(good: Path, tmp_path: Path) -> None:
    content = bytearray(good.read_bytes())
    end, blocks = chunk_blocks(good)[3]
    content[end - 10] ^= 1
    recording = read(tmp_path / "middle.mcap", bytes(content))
    assert recording is not None
    assert f"force: 2 blocks missing (sequence {blocks[0]}–{blocks[-1]})" in recording.problems
    gaps = np.diff(recording.channels[0].time_ns)
    assert gaps.max() == 33 * MS
    assert (gaps == MS).sum() == gaps.size - 1


def test_a_flip_in_the_metadata_is_told(good: Path, tmp_path: Path) -> None:
    content = bytearray(good.read_bytes())
    content[content.index(b"acrylic_3") + 2] ^= 1
    recording = read(tmp_path / "metadata.mcap", bytes(content))
    assert recording is not None
    assert recording.metadata["specimen_id"] != METADATA["specimen_id"]
    assert any("metadata may have changed" in problem for problem in recording.problems)


def test_a_message_lost_without_a_checksum_is_missed_in_the_statistics(tmp_path: Path) -> None:
    """Without chunks and checksums, the numbers at the file's end are what is left to compare with."""
    path = tmp_path / "bare.mcap"
    packaged(path, data_crc=False, use_chunking=False)
    content = bytearray(path.read_bytes())
    last = content.rindex(b"\x05" + struct.pack("<Q", 22 + len(block(START, 1e-3, range(16)))))
    content[last] = 0x85  # an opcode that readers pass over
    recording = read(path, bytes(content))
    assert recording is not None
    assert any("24 messages, 23 were found" in problem for problem in recording.problems)


def force(number: int, values: object, sequence: int | None = None, interval: float = 1e-3) -> bytes:
    start = START + number * MS
    return message(1, number if sequence is None else sequence, start, block(start, interval, values))


def two_chunks(*more: bytes) -> bytes:
    first = chunk(DEFINITIONS + force(0, [1.0, 2.0], 0))
    return whole(metadata(METADATA), first, chunk(force(2, [3.0, 4.0], 1)), *more)


def test_duplicate_chunks_are_taken_once(tmp_path: Path) -> None:
    again = chunk(force(2, [3.0, 4.0], 1))
    recording = read(tmp_path / "twice.mcap", two_chunks(again, again))
    assert recording is not None
    assert recording.channels[0].values.tolist() == [1.0, 2.0, 3.0, 4.0]
    assert recording.problems == ()
    assert any("2 chunks recorded twice" in note for note in recording.notes)


def test_duplicate_blocks_in_another_chunk_are_taken_once(tmp_path: Path) -> None:
    again = chunk(force(2, [3.0, 4.0], 1) + force(4, [5.0, 6.0], 2), "lz4")
    recording = read(tmp_path / "twice.mcap", two_chunks(again))
    assert recording is not None
    assert recording.channels[0].values.tolist() == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    assert recording.problems == ()
    assert any("2 samples recorded twice" in note for note in recording.notes)


def test_conflicting_overlaps_keep_the_first_and_are_told(tmp_path: Path) -> None:
    other = chunk(force(3, [40.0, 50.0, 60.0], 2))
    recording = read(tmp_path / "overlap.mcap", two_chunks(other))
    assert recording is not None
    assert recording.channels[0].values.tolist() == [1.0, 2.0, 3.0, 4.0, 50.0, 60.0]
    assert recording.problems == (
        "force: 1 sample left out: blocks overlap with other values from 2026-02-25T06:13:20.003Z on",
    )


def test_blocks_out_of_order_are_sorted(tmp_path: Path) -> None:
    late = chunk(DEFINITIONS + force(4, [5.0, 6.0], 2))
    recording = read(
        tmp_path / "order.mcap",
        whole(metadata(METADATA), late, chunk(force(0, [1.0, 2.0], 0)), chunk(force(2, [3.0, 4.0], 1))),
    )
    assert recording is not None
    assert recording.channels[0].values.tolist() == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    assert recording.channels[0].time_ns.tolist() == [START + i * MS for i in range(6)]
    assert recording.problems == ()


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        (chunk(force(4, [9.0], 2), "xz"), 'unknown compression "xz"'),
        (chunk(force(4, [9.0], 2), crc=12345), "checksum"),
        (chunk(force(4, [9.0], 2), stored=b"no frame at all"), "cannot be inflated"),
        (chunk(force(4, [9.0], 2), "lz4", stored=b"no frame at all"), "cannot be inflated"),
        (chunk(force(4, [9.0], 2), size=10), "10 are declared"),
        (chunk(force(4, [9.0], 2), "lz4", size=10), "10 are declared"),
        (chunk(force(4, [9.0], 2), size=10_000), "10000 are declared"),
        (chunk(force(4, [9.0], 2), "lz4", size=10_000), "10000 are declared"),
        (chunk(force(4, [9.0], 2), "", size=10), "another size"),
        (chunk(force(4, [9.0], 2), size=2**64 - 1), "256 MiB"),
        (chunk(force(4, [9.0], 2), size=200 << 20), "512 times"),
        (record(6, b"short"), "beyond its end"),
        (record(6, struct.pack("<QQQII", 0, 0, 0, 0, 2**32 - 1)), "beyond its end"),
    ],
)
def test_a_bad_chunk_is_left_out_with_its_reason(tmp_path: Path, bad: bytes, reason: str) -> None:
    recording = read(tmp_path / "bad.mcap", two_chunks(bad))
    assert recording is not None
    assert recording.channels[0].values.tolist() == [1.0, 2.0, 3.0, 4.0]
    assert any("1 chunk left out" in problem and reason in problem for problem in recording.problems)


def test_only_bad_chunks_is_refused_with_the_reasons(tmp_path: Path) -> None:
    path = tmp_path / "all.mcap"
    path.write_bytes(whole(metadata(METADATA), DEFINITIONS, chunk(force(0, [1.0]), "snappy")))
    with pytest.raises(RefusedError, match=r'no usable samples.*unknown compression "snappy"'):
        read_mcap(path)


@pytest.mark.parametrize("crc", [0, None])
def test_a_chunk_with_damage_inside_is_read_up_to_it(tmp_path: Path, crc: int | None) -> None:
    content = force(4, [5.0, 6.0], 2) + struct.pack("<BQ", 5, 2**40) + b"rest"
    recording = read(tmp_path / "inside.mcap", two_chunks(chunk(content, crc=crc)))
    assert recording is not None
    assert recording.channels[0].values.tolist() == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    assert any("1 chunk read in part" in problem for problem in recording.problems)


def test_messages_outside_chunks_are_read(tmp_path: Path) -> None:
    recording = read(tmp_path / "bare.mcap", whole(DEFINITIONS, metadata(METADATA), force(0, [1.0]), force(1, [2.0])))
    assert recording is not None
    assert recording.channels[0].values.tolist() == [1.0, 2.0]
    assert recording.problems == ()


def test_messages_of_an_undefined_channel_are_told(tmp_path: Path) -> None:
    recording = read(tmp_path / "undefined.mcap", two_chunks(chunk(message(9, 0, START, block(START, 1e-3, [1.0])))))
    assert recording is not None
    assert recording.problems == ("1 message left out: their channels are defined nowhere",)


def test_a_second_definition_does_not_replace_the_first(tmp_path: Path) -> None:
    recording = read(tmp_path / "redefined.mcap", two_chunks(chunk(channel(1, "/force", {"unit": "kN"}))))
    assert recording is not None
    assert recording.channels[0].unit == "N"
    assert any("defined twice" in problem for problem in recording.problems)


def test_a_second_metadata_record_is_noted_and_not_used(tmp_path: Path) -> None:
    recording = read(
        tmp_path / "metadata.mcap", two_chunks(metadata({"recording_id": "other"}), metadata({"a": "b"}, "rig"))
    )
    assert recording is not None
    assert recording.metadata == METADATA
    assert recording.rig == {"a": "b"}
    assert any('metadata record "recording" says something else' in note for note in recording.notes)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (struct.pack("<Bq", 0x09, START) + struct.pack("<Bd", 0x11, -1.0) + b"\x1a\x08" + bytes(8), "above 0"),
        (struct.pack("<Bq", 0x09, START) + struct.pack("<Bd", 0x11, float("nan")) + b"\x1a\x08" + bytes(8), "above 0"),
        (struct.pack("<Bq", 0x09, START) + struct.pack("<Bd", 0x11, float("inf")) + b"\x1a\x08" + bytes(8), "above 0"),
        (struct.pack("<Bq", 0x09, START) + b"\x1a\x08" + bytes(8), "above 0"),
        (struct.pack("<Bq", 0x09, START) + struct.pack("<Bd", 0x11, 1e-10) + b"\x1a\x10" + bytes(16), "below 1 ns"),
        (struct.pack("<Bq", 0x09, START) + struct.pack("<Bd", 0x11, 1e300) + b"\x1a\x10" + bytes(16), "2262"),
        (struct.pack("<Bq", 0x09, 2**63 - 5) + struct.pack("<Bd", 0x11, 1.0) + b"\x1a\x10" + bytes(16), "2262"),
        (struct.pack("<Bq", 0x09, -(2**63)) + struct.pack("<Bd", 0x11, 1e10) + b"\x1a\x10" + bytes(16), "2262"),
        (struct.pack("<Bq", 0x09, START) + struct.pack("<Bd", 0x11, 1.0) + b"\x1a\x07" + bytes(7), "whole number"),
        (struct.pack("<Bq", 0x09, START) + struct.pack("<Bd", 0x11, 1.0) + b"\x1a\xff\xff\x7f" + bytes(8), "beyond"),
        (b"\x09abc", "beyond"),
        (b"\x1a" + b"\xff" * 12, "does not end"),
        (b"\x0c" + bytes(40), "impossible type"),
        (bytes(40), "number 0"),
        (b"\x23" * 30, "beyond|does not end"),
        (b"noise of some kind, long enough", "."),
    ],
)
def test_a_bad_block_is_left_out_with_its_reason(tmp_path: Path, content: bytes, reason: str) -> None:
    import re

    recording = read(tmp_path / "block.mcap", two_chunks(chunk(message(1, 2, START + 4 * MS, content))))
    assert recording is not None
    assert recording.channels[0].values.tolist() == [1.0, 2.0, 3.0, 4.0]
    assert len(recording.problems) == 1
    assert re.search(f"force: 1 block left out: .*({reason})", recording.problems[0])


def test_many_different_problems_are_told_shortly(tmp_path: Path) -> None:
    bad = [record(0x0C, b"\xff" * 4) for _ in range(500)]
    recording = read(tmp_path / "many.mcap", two_chunks(*bad))
    assert recording is not None
    assert len(recording.problems) == 51
    assert recording.problems[-1] == "and 450 more problems"


HOSTILE = [
    "../../etc/passwd",
    "'; DROP TABLE recordings; --",
    "<script>alert(1)</script>",
    "\u202e\x00\n" * 50,
    "x" * 70000,
]


@pytest.mark.parametrize("text", HOSTILE)
def test_hostile_texts_come_through_unchanged_or_are_refused(tmp_path: Path, text: str) -> None:
    """A reader's job is to hand them on as they are; who uses them, checks them."""
    definitions = schema() + channel(1, f"/{text}", {"unit": text, text: text})
    recording = read(tmp_path / "hostile.mcap", whole(metadata({"recording_id": text}), definitions, force(0, [1.0])))
    assert recording is not None
    assert recording.metadata == {"recording_id": text}
    assert recording.channels[0].quantity == text
    assert all(len(note) < 1000 for note in (*recording.problems, *recording.notes))


@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.LZ4, CompressionType.NONE])
def test_each_compression_is_read(tmp_path: Path, compression: CompressionType) -> None:
    path = tmp_path / "file.mcap"
    packaged(path, compression=compression)
    recording = read_mcap(path)
    assert recording.problems == ()
    assert content_of(recording) == samples_of(list(range(12)))
    assert all(a[0] < b[0] for samples in content_of(recording).values() for a, b in pairwise(samples))


def test_other_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "other.mcap"
    for content, reason in ((b"", "empty"), (b"a,b\n1,2\n" * 100, "does not begin"), (MAGIC, "no usable samples")):
        path.write_bytes(content)
        with pytest.raises(RefusedError, match=reason):
            read_mcap(path)
