"""SampleBlock messages in every form that the protobuf encoding allows, and the times of their samples."""

from __future__ import annotations

import struct
from fractions import Fraction

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from ingest.mcap_blocks import BlockCollector, block_times, parse_block
from tests.helpers.mcap_files import START, parsed_block, varint


def _values(stretches: list[memoryview]) -> list[bytes]:
    joined = b"".join(stretches)
    return [joined[i : i + 8] for i in range(0, len(joined), 8)]


doubles = st.floats(width=64, allow_nan=False)
start_field = st.integers(-(2**63), 2**63 - 1).map(lambda v: b"\x09" + struct.pack("<q", v))
interval_field = doubles.map(lambda v: b"\x11" + struct.pack("<d", v))
packed_field = st.lists(doubles, max_size=40).map(
    lambda v: b"\x1a" + varint(8 * len(v)) + struct.pack(f"<{len(v)}d", *v)
)
single_field = doubles.map(lambda v: b"\x19" + struct.pack("<d", v))
unknown_field = st.one_of(
    st.tuples(st.integers(4, 2000), st.integers(0, 2**63)).map(lambda t: varint(t[0] << 3) + varint(t[1])),
    st.tuples(st.integers(4, 2000), st.binary(min_size=8, max_size=8)).map(lambda t: varint(t[0] << 3 | 1) + t[1]),
    st.tuples(st.integers(4, 2000), st.binary(max_size=20)).map(
        lambda t: varint(t[0] << 3 | 2) + varint(len(t[1])) + t[1]
    ),
    st.tuples(st.integers(4, 2000), st.binary(min_size=4, max_size=4)).map(lambda t: varint(t[0] << 3 | 5) + t[1]),
    st.integers(4, 100).map(lambda n: varint(n << 3 | 3) + b"\x2b\x08\x05\x2c" + varint(n << 3 | 4)),
)


@settings(max_examples=300, deadline=None)
@given(st.lists(st.one_of(start_field, interval_field, packed_field, single_field, unknown_field), max_size=12))
def test_any_message_is_read_as_protobuf_reads_it(parts: list[bytes]) -> None:
    content = b"".join(parts)
    expected = parsed_block(content)
    start, interval, values = parse_block(memoryview(content))
    assert (start, interval) == (expected.start_time_ns, expected.sample_interval_s)
    assert _values(values) == [struct.pack("<d", v) for v in expected.values]


@settings(max_examples=300, deadline=None)
@given(st.binary(max_size=80))
def test_no_bytes_make_it_fail(content: bytes) -> None:
    collector = BlockCollector()
    collector.add(memoryview(content), 0, 0)
    collector.add(memoryview(b"\x09" + content), 0, 0)
    samples = collector.samples({})
    assert samples.time_ns.size == samples.values.size


@settings(max_examples=100, deadline=None)
@given(
    st.lists(
        st.tuples(
            st.integers(-(10**18), 2 * 10**18),
            st.sampled_from([1e-3, 1e-4, 1 / 3, 1.7e-5, 1e-9, 60.0]),
            st.integers(1, 400),
        ),
        min_size=1,
        max_size=30,
    )
)
def test_times_are_the_start_plus_whole_intervals(blocks: list[tuple[int, float, int]]) -> None:
    starts, intervals, counts = (np.array(column) for column in zip(*blocks, strict=True))
    times = block_times(starts.astype(np.int64), intervals.astype(np.float64), counts.astype(np.int64))
    exact = [Fraction(s) + i * Fraction(d) * 10**9 for s, d, n in blocks for i in range(n)]
    assert times.size == len(exact)
    # half a nanosecond of rounding, and what doubles lose on offsets of hours
    assert max(abs(int(t) - e) for t, e in zip(times, exact, strict=True)) <= Fraction(51, 100)


def test_times_of_more_samples_than_fit_a_slab() -> None:
    counts = np.array([200_000, 1, 70_000, 3], dtype=np.int64)
    starts = START + np.array([0, 10**12, 2 * 10**12, 3 * 10**12])
    times = block_times(starts, np.full(4, 1e-6), counts)
    expected = np.concatenate([s + 1000 * np.arange(n) for s, n in zip(starts, counts, strict=True)])
    assert np.array_equal(times, expected)


def _block(start: int, values: list[float]) -> memoryview:
    content = b"\x09" + struct.pack("<q", start) + b"\x11" + struct.pack("<d", 1e-3)
    return memoryview(content + b"\x1a" + varint(8 * len(values)) + struct.pack(f"<{len(values)}d", *values))


@settings(max_examples=200, deadline=None)
@given(
    blocks=st.lists(
        st.tuples(st.integers(0, 30), st.lists(st.sampled_from([1.0, 2.0, float("nan")]), min_size=1, max_size=8)),
        min_size=1,
        max_size=10,
    ),
    order=st.randoms(use_true_random=False),
)
def test_overlaps_leave_ascending_times_and_nothing_invented(
    blocks: list[tuple[int, list[float]]], order: object
) -> None:
    order.shuffle(blocks)  # type: ignore[attr-defined]
    collector = BlockCollector()
    given_samples = set()
    for sequence, (position, values) in enumerate(blocks):
        collector.add(_block(START + position * 10**6, values), START + position * 10**6, sequence)
        given_samples |= {(START + (position + i) * 10**6, str(v)) for i, v in enumerate(values)}
    samples = collector.samples({})
    kept = {(int(t), str(float(v))) for t, v in zip(samples.time_ns, samples.values, strict=True)}
    assert all(np.diff(samples.time_ns) > 0)
    assert kept <= given_samples
    assert {t for t, _ in kept} == {t for t, _ in given_samples}
    told = " ".join(samples.problems + samples.notes)
    if len(kept) < sum(len(values) for _, values in blocks):
        assert "twice" in told or "overlap" in told
    if len(given_samples) > len(kept):
        assert "overlap" in told


def test_missing_numbers_are_told_once_each() -> None:
    collector = BlockCollector()
    for sequence in (2, 3, 7, 8, 10):
        start = START + sequence * 10**6
        collector.add(_block(start, [1.0]), start, sequence)
    assert collector.samples({}).problems == ("6 blocks missing (sequence 0–1, 4–6, 9)",)


def test_blocks_without_numbers_lack_none() -> None:
    collector = BlockCollector()
    for number in range(4):
        collector.add(_block(START + number * 10**6, [1.0]), START + number * 10**6, 0)
    samples = collector.samples({})
    assert samples.problems == samples.notes == ()


def test_another_log_time_is_noted_and_not_used() -> None:
    collector = BlockCollector()
    collector.add(_block(START, [1.0]), START + 77, 0)
    samples = collector.samples({})
    assert samples.time_ns.tolist() == [START]
    assert samples.notes == ("log_time is not start_time_ns in 1 block; start_time_ns is used",)
