"""The samples Parquet, read by pyarrow and DuckDB as users do, and its envelope."""

from __future__ import annotations

import os
import threading
from pathlib import Path
from typing import Any

import duckdb
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ingest.samples import PREVIEW_POINTS, preview, read_samples, samples_table, write_samples, write_table
from schemas.errors import LabError
from schemas.metadata import RecordingMetadata, RigConstants
from schemas.recording import Channel, Recording, Source
from tests.helpers.mcap_files import METADATA, START

MS = 1_000_000


def recording(*channels: Channel, **metadata: str) -> Recording:
    return Recording(
        RecordingMetadata.parse({**METADATA, **metadata}),
        RigConstants(),
        {c.quantity: c for c in channels},
        Source("raw/run.mcap", "ab" * 32, 1234),
    )


def channel(quantity: str, positions: Any, values: Any, **more: Any) -> Channel:
    return Channel(quantity, START + np.array(positions, dtype=np.int64) * MS, np.array(values, dtype=float), **more)


def parquet(lab: Path, relative: str) -> pa.Table:
    with (lab / relative).open("rb") as file:
        return pq.ParquetFile(file).read()


def test_rows_are_the_instants_at_which_any_channel_has_a_sample(tmp_path: Path) -> None:
    relative = write_samples(
        recording(
            channel("force", [0, 1, 2, 3, 4], [0.0, 1.0, np.nan, 3.0, 4.0]),
            channel("temperature", [1, 4, 7], [20.0, 21.0, 22.0]),
        ),
        tmp_path,
    )
    assert relative == "samples/protocol=cyclic/month=2026-02/run_7.parquet"
    table = parquet(tmp_path, relative)
    assert table.to_pydict() == {
        "time_ns": [START + i * MS for i in (0, 1, 2, 3, 4, 7)],
        "force": [0.0, 1.0, None, 3.0, 4.0, None],
        "temperature": [None, 20.0, None, None, 21.0, 22.0],
    }
    assert table.schema.field("time_ns").type == pa.int64()
    assert table.schema.field("force").type == pa.float64()


def test_the_month_is_that_of_utc(tmp_path: Path) -> None:
    late = recording(channel("force", [0], [1.0]), started_at="2026-01-01T00:30:00+01:00")
    assert write_samples(late, tmp_path) == "samples/protocol=cyclic/month=2025-12/run_7.parquet"


def test_duckdb_reads_a_lab_of_them(tmp_path: Path) -> None:
    write_samples(recording(channel("force", [0, 1], [1.0, 2.0]), recording_id="a"), tmp_path)
    write_samples(recording(channel("force", [0], [4.0]), channel("voltage", [0], [3.0]), recording_id="b"), tmp_path)
    with duckdb.connect() as connection:
        found = connection.execute(
            f"SELECT count(*), sum(force), sum(voltage), any_value(protocol), any_value(month), typeof(any_value(time_ns)) "
            f"FROM read_parquet('{tmp_path}/samples/**/*.parquet', union_by_name=true, hive_partitioning=true)"
        ).fetchall()
    assert found == [(3, 7.0, 3.0, "cyclic", "2026-02", "BIGINT")]


def test_the_file_says_what_it_is(tmp_path: Path) -> None:
    relative = write_samples(
        recording(
            channel("force", [0], [1.0], resolution=5e-4, filter_hz=2000.0, delay_s=1e-4, sensor="HBM S2M"),
            channel("output", [0], [1.0], unit="lux"),
        ),
        tmp_path,
    )
    schema = parquet(tmp_path, relative).schema
    about = {k.decode(): v.decode() for k, v in schema.metadata.items()}
    assert about["dealab.source_sha256"] == "ab" * 32
    assert about["dealab.schema_version"] == "1"
    assert about["dealab.recording_id"] == "run_7"
    assert about["dealab.software_version"]
    units = {f.name: f.metadata[b"unit"].decode() for f in schema}
    assert units == {"time_ns": "ns", "force": "N", "output": "lux"}
    channels = read_samples(tmp_path / relative)
    force = channels["force"]
    assert (force.resolution, force.filter_hz, force.delay_s, force.sensor, force.unit) == (
        5e-4,
        2000.0,
        1e-4,
        "HBM S2M",
        None,
    )
    assert channels["output"].unit == "lux"


quantities = st.sampled_from(["force", "displacement", "voltage", "temperature", "input"])


@settings(max_examples=80, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.dictionaries(
        quantities,
        st.dictionaries(st.integers(0, 60), st.floats(width=64, allow_nan=False), min_size=1, max_size=40),
        min_size=1,
        max_size=5,
    )
)
def test_what_is_written_is_what_is_read(tmp_path: Path, content: dict[str, dict[int, float]]) -> None:
    written = recording(*(channel(q, sorted(s), [s[i] for i in sorted(s)]) for q, s in content.items()))
    found = read_samples(tmp_path / write_samples(written, tmp_path))
    assert list(found) == list(content)
    for quantity, original in written.channels.items():
        assert np.array_equal(found[quantity].time_ns, original.time_ns)
        assert found[quantity].values.tobytes() == original.values.tobytes()


def test_channels_of_one_clock_keep_one_time_array(tmp_path: Path) -> None:
    shared = START + np.arange(100, dtype=np.int64)
    written = recording(Channel("force", shared, np.arange(100.0)), Channel("voltage", shared, np.arange(100.0)))
    found = read_samples(tmp_path / write_samples(written, tmp_path))
    assert found["force"].time_ns is found["voltage"].time_ns


@pytest.mark.parametrize(
    ("step", "share"),
    [
        pytest.param(1 / 16384, 0.4, id="step is a binary fraction"),
        pytest.param(10 / 32768, 0.55, id="10 V over 15 bits"),
        pytest.param(5e-4, 0.65, id="step of a decimal resolution"),
    ],
)
def test_samples_of_a_converter_shrink_against_the_defaults(tmp_path: Path, step: float, share: float) -> None:
    rng = np.random.default_rng(3)
    size = 400_000
    times = START + np.arange(size, dtype=np.int64) * 100_000
    wave = 3.0 * np.sin(2 * np.pi * 5e-4 * np.arange(size))
    channels = [
        Channel(q, times, np.round((wave + rng.normal(0, 4 * step, size)) / step) * step) for q in ("force", "voltage")
    ]
    written = recording(*channels)
    ours = (tmp_path / write_samples(written, tmp_path)).stat().st_size
    pq.write_table(samples_table(written), tmp_path / "defaults.parquet")
    assert ours < share * (tmp_path / "defaults.parquet").stat().st_size


def test_numbers_that_do_not_repeat_shrink_too(tmp_path: Path) -> None:
    size = 200_000
    times = START + np.arange(size, dtype=np.int64) * 100_000
    written = recording(Channel("force", times, 3.0 + np.random.default_rng(3).normal(0, 0.01, size)))
    assert (tmp_path / write_samples(written, tmp_path)).stat().st_size < 6.6 * size


def test_writing_is_all_or_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    written = recording(channel("force", [0, 1], [1.0, 2.0]))
    path = tmp_path / write_samples(written, tmp_path)
    before = path.read_bytes()

    def full(*args: object, **kwargs: object) -> None:
        next(path.parent.glob(".*.tmp"), path).touch()
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(pq, "write_table", full)
    with pytest.raises(OSError, match="No space"):
        write_samples(recording(channel("force", [0], [5.0])), tmp_path)
    assert path.read_bytes() == before
    assert [p.name for p in path.parent.iterdir()] == ["run_7.parquet"]


def test_a_reader_meets_the_old_or_the_new_file(tmp_path: Path) -> None:
    """Two writers and a reader at once: every look finds a whole file."""
    tables = [samples_table(recording(channel("force", range(n), np.full(n, float(n))))) for n in (500, 3000)]
    path = tmp_path / "samples.parquet"
    write_table(tables[0], path)

    def rewrite(table: pa.Table) -> None:
        for _ in range(15):
            write_table(table, path)

    writers = [threading.Thread(target=rewrite, args=(table,)) for table in tables]
    for writer in writers:
        writer.start()
    while any(writer.is_alive() for writer in writers):
        values = read_samples(path)["force"].values
        assert values.size in (500, 3000)
        assert (values == values.size).all()
    assert [p.name for p in tmp_path.iterdir()] == ["samples.parquet"]


def test_the_file_has_the_rights_of_any_new_file(tmp_path: Path) -> None:
    previous = os.umask(0o022)
    try:
        path = tmp_path / write_samples(recording(channel("force", [0], [1.0])), tmp_path)
    finally:
        os.umask(previous)
    assert path.stat().st_mode & 0o777 == 0o644


def test_no_flipped_bit_of_a_sample_is_read(tmp_path: Path) -> None:
    """Bytes that compression alone would give other values for; what a page's place and kind say is read, or told."""
    noise = np.random.default_rng(7).normal(size=3000)
    file = tmp_path / write_samples(recording(channel("force", range(3000), noise)), tmp_path)
    whole = file.read_bytes()
    footer = int.from_bytes(whole[-8:-4], "little") + 8
    told = 0
    places = range(5, len(whole) - footer, 97)
    for place in places:
        file.write_bytes(whole[:place] + bytes([whole[place] ^ 1 << place % 8]) + whole[place + 1 :])
        try:
            found = read_samples(file)["force"]
        except LabError:
            told += 1
        else:
            assert np.array_equal(found.values, noise)
    assert told > 0.9 * len(places)


def test_other_files_are_told_from_samples(tmp_path: Path) -> None:
    with pytest.raises(LabError, match="missing"):
        read_samples(tmp_path / "none.parquet")
    (tmp_path / "noise.parquet").write_bytes(b"noise" * 100)
    with pytest.raises(LabError, match="cannot be read"):
        read_samples(tmp_path / "noise.parquet")
    pq.write_table(pa.table({"a": [1]}), tmp_path / "other.parquet")
    with pytest.raises(LabError, match="cannot be read"):
        read_samples(tmp_path / "other.parquet")


@settings(max_examples=100, deadline=None)
@given(
    size=st.integers(1, 300),
    points=st.integers(1, 50),
    lost=st.floats(0, 0.5),
    seed=st.integers(0, 10_000),
)
def test_the_envelope_is_that_of_each_stretch(size: int, points: int, lost: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    values = np.where(rng.random(size) < lost, np.nan, rng.normal(size=size))
    found = channel("force", np.cumsum(rng.integers(1, 4, size)), values)
    time, low, high = preview(found, points)
    assert time.size == low.size == high.size == min(size, points)
    assert time[0] == 0
    edges = np.searchsorted((found.time_ns - found.time_ns[0]) * 1e-9, time)
    for i, (begin, end) in enumerate(zip(edges, [*edges[1:], size], strict=True)):
        stretch = values[begin:end][np.isfinite(values[begin:end])]
        assert end > begin
        if stretch.size:
            assert (low[i], high[i]) == (stretch.min(), stretch.max())
        else:
            assert np.isnan(low[i])
            assert np.isnan(high[i])


def test_a_preview_keeps_the_one_spike_of_a_long_recording() -> None:
    values = np.zeros(1_000_003)
    values[777_777] = 9.0
    time, low, high = preview(Channel("force", START + np.arange(values.size), values))
    assert time.size == PREVIEW_POINTS
    assert high.max() == 9.0
    assert (low == 0).all()
