"""What RecordingWriter writes, read back by the mcap package and protobuf, and by the reader."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader

from ingest.mcap_reader import read_mcap
from ingest.mcap_writer import RecordingWriter
from schemas.errors import RefusedError, UsageError
from schemas.metadata import RecordingMetadata, RigConstants
from tests.helpers.mcap_files import METADATA, START, message_type, parsed_block
from tests.tools.release import writer_example

MS = 1_000_000
ROOT = Path(__file__).resolve().parent.parent.parent


def test_the_file_keeps_the_contract_by_the_word_of_others(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    force = np.arange(2500) * 0.25
    rig = {"rig_id": "a", "clamp_mass_kg": "0.05", "force_noise_sd": "0.001"}
    with RecordingWriter(path, METADATA, rig) as writer:
        writer.add_channel("force", "mN", resolution=0.5, filter_hz=2000, delay_s=1e-4, sensor="HBM S2M")
        writer.add_channel("displacement", "µm")
        writer.append("force", START, 1e-3, force)
        writer.append("displacement", START, 2e-3, [1.0, 2.0])
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.channel_message_counts == {1: 3, 2: 1}
        assert {c.topic: c.metadata for c in summary.channels.values()} == {
            "/force": {
                "unit": "mN",
                "resolution": "0.5",
                "filter_hz": "2000.0",
                "delay_s": "0.0001",
                "sensor": "HBM S2M",
            },
            "/displacement": {"unit": "µm"},
        }
        records = {r.name: r.metadata for r in reader.iter_metadata()}
        assert RecordingMetadata.parse(records["recording"]) == RecordingMetadata.parse(METADATA)
        assert RigConstants.parse(records["rig"]) == RigConstants.parse(rig)
        blocks = []
        for schema, channel, message in reader.iter_messages("/force"):
            assert schema is not None
            assert (schema.name, schema.encoding, channel.message_encoding) == (
                "dealab.SampleBlock",
                "protobuf",
                "protobuf",
            )
            parsed = message_type(schema.data, schema.name).FromString(message.data)
            assert message.log_time == parsed.start_time_ns
            assert message.sequence == len(blocks)
            blocks.append(parsed)
    assert [len(b.values) for b in blocks] == [1000, 1000, 500]
    assert [b.start_time_ns for b in blocks] == [START, START + 1000 * MS, START + 2000 * MS]
    assert {b.sample_interval_s for b in blocks} == {1e-3}
    assert [v for b in blocks for v in b.values] == force.tolist()


finite = st.floats(allow_nan=False, width=64)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    stretches=st.lists(
        st.tuples(
            st.integers(0, 5),  # gap before the stretch, in intervals
            st.lists(finite | st.just(float("nan")), min_size=1, max_size=40),
        ),
        min_size=1,
        max_size=12,
    ),
    interval=st.sampled_from([1e-3, 1 / 3000, 0.1, 2.5e-7, 7.0]),
    block_size=st.integers(1, 30),
    compression=st.sampled_from(["zstd", "lz4", "none"]),
)
def test_what_is_appended_is_what_is_read(
    tmp_path: Path,
    stretches: list[tuple[int, list[float]]],
    interval: float,
    block_size: int,
    compression: str,
) -> None:
    path = tmp_path / "run.mcap"
    path.unlink(missing_ok=True)
    times: list[int] = []
    values: list[float] = []
    position = 0
    with RecordingWriter(path, METADATA, compression=compression, block_size=block_size) as writer:
        writer.add_channel("voltage", "kV")
        for gap, stretch in stretches:
            position += gap
            start = START + round(position * interval * 1e9)
            writer.append("voltage", start, interval, stretch)
            times += [start + round(i * interval * 1e9) for i in range(len(stretch))]
            values += stretch
            position += len(stretch)
    recording = read_mcap(path)
    assert recording.problems == recording.notes == ()
    (channel,) = recording.channels
    assert np.abs(channel.time_ns - np.array(times)).max() <= 2
    assert np.array_equal(channel.values, np.array(values), equal_nan=True)
    assert all(np.diff(channel.time_ns) > 0)


def test_long_runs_do_not_drift(tmp_path: Path) -> None:
    """At an interval that is no whole number of ns, block starts must not add up their roundings."""
    path = tmp_path / "run.mcap"
    interval = 1 / 3
    with RecordingWriter(path, METADATA, block_size=7) as writer:
        writer.add_channel("voltage", "kV")
        for at in range(0, 90_000, 90):
            writer.append("voltage", START + round(at * interval * 1e9), interval, np.zeros(90))
    times = read_mcap(path).channels[0].time_ns
    exact = START + np.array([i * 10**9 // 3 for i in range(90_000)])
    assert np.abs(times - exact).max() <= 2


def test_channels_of_one_clock_share_one_time_array(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with RecordingWriter(path, METADATA) as writer:
        for quantity, unit in (("force", "N"), ("displacement", "mm"), ("temperature", "degC")):
            writer.add_channel(quantity, unit)
        writer.append("force", START, 1e-3, np.arange(3000.0))
        writer.append("displacement", START, 1e-3, np.arange(3000.0))
        writer.append("temperature", START, 1.0, np.arange(3.0))
    force, displacement, temperature = read_mcap(path).channels
    assert force.time_ns is displacement.time_ns
    assert temperature.time_ns.tolist() == [START, START + 1000 * MS, START + 2000 * MS]


def test_the_name_appears_only_when_the_recording_is_complete(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    writer = RecordingWriter(path, METADATA).open()
    writer.add_channel("force", "N")
    writer.append("force", START, 1e-3, [1.0])
    assert [p.name for p in tmp_path.iterdir()] == ["run.mcap.part"]
    writer.close()
    writer.close()
    assert [p.name for p in tmp_path.iterdir()] == ["run.mcap"]
    with pytest.raises(UsageError, match="closed"):
        writer.append("force", START + MS, 1e-3, [1.0])


def test_an_exception_ends_the_recording_and_is_noted(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"

    def stopped() -> None:
        with RecordingWriter(path, METADATA) as writer:
            writer.add_channel("force", "N")
            writer.append("force", START, 1e-3, [1.0, 2.0])
            raise KeyboardInterrupt("stop pressed")

    with pytest.raises(KeyboardInterrupt):
        stopped()
    recording = read_mcap(path)
    assert recording.channels[0].values.tolist() == [1.0, 2.0]
    assert recording.problems == ()
    assert recording.notes == ("the recording was ended early: KeyboardInterrupt: stop pressed",)


_KILLED = """
import os, sys, numpy as np
from ingest.mcap_writer import RecordingWriter
from tests.helpers.mcap_files import METADATA, START
writer = RecordingWriter(sys.argv[1], METADATA).open()
writer.add_channel("voltage", "kV")
for second in range(100):
    writer.append("voltage", START + second * 10**9, 0.1, np.arange(10) + 10.0 * second)
os._exit(9)
"""


def test_what_a_killed_script_leaves_is_salvaged_by_renaming(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-c", _KILLED, str(path)], env=environment, check=False, timeout=60)
    assert done.returncode == 9
    part = tmp_path / "run.mcap.part"
    with pytest.raises(UsageError, match=r"unfinished recording run\.mcap\.part is in the way"):
        RecordingWriter(path, METADATA).open()
    part.rename(path)
    recording = read_mcap(path)
    values = recording.channels[0].values
    assert values.tolist() == list(range(values.size))
    # all but the last 30 s of the 100
    assert values.size >= 700
    assert any("its end is missing" in problem for problem in recording.problems)


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(b"precious")
    with pytest.raises(UsageError, match="exists"):
        RecordingWriter(path, METADATA).open()
    assert path.read_bytes() == b"precious"
    assert len(list(tmp_path.iterdir())) == 1


def test_wrong_metadata_is_refused_before_the_test_begins(tmp_path: Path) -> None:
    for changed, reason in (
        ({"specimen_id": ""}, "specimen_id is missing"),
        ({"started_at": "2026-03-01T14:05:00"}, "started_at"),
        ({"recording_id": "../../x"}, "recording_id"),
        ({"protocol": "poke"}, "protocol"),
        ({"film_length_mm": "-1"}, "film_length_mm"),
    ):
        with pytest.raises(RefusedError, match=reason):
            RecordingWriter(tmp_path / "run.mcap", {**METADATA, **changed})
    with pytest.raises(RefusedError, match="clamp_mass_kg"):
        RecordingWriter(tmp_path / "run.mcap", METADATA, {"clamp_mass_kg": "heavy"})
    for options, reason in (({"compression": "rar"}, "compression"), ({"block_size": 0}, "block_size")):
        with pytest.raises(UsageError, match=reason):
            RecordingWriter(tmp_path / "run.mcap", METADATA, **options)
    with pytest.raises(UsageError, match="does not end in"):
        RecordingWriter(tmp_path / "run.csv", METADATA)
    assert not list(tmp_path.iterdir())


def test_wrong_use_is_told_and_leaves_the_recording_whole(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with RecordingWriter(path, METADATA) as writer:
        with pytest.raises(RefusedError, match='quantity "weight" is unknown'):
            writer.add_channel("weight", "N")
        with pytest.raises(RefusedError, match="dimension"):
            writer.add_channel("force", "mm")
        writer.add_channel("force", "N")
        with pytest.raises(UsageError, match="added before"):
            writer.add_channel("force", "N")
        with pytest.raises(UsageError, match="resolution is nan"):
            writer.add_channel("voltage", "V", resolution=float("nan"))
        with pytest.raises(UsageError, match="has not been added"):
            writer.append("voltage", START, 1e-3, [1.0])
        writer.append("force", START, 1e-3, [1.0, 2.0])
        for start, interval, values, reason in (
            (START + MS, 1e-3, [3.0], "time goes back"),
            (START, 1e-3, [3.0], "time goes back"),
            (-1, 1e-3, [3.0], "1970"),
            (2**63, 1e-3, [3.0], "2262"),
            (START + 10 * MS, 0.0, [3.0], "sample_interval_s"),
            (START + 10 * MS, float("nan"), [3.0], "sample_interval_s"),
            (START + 10 * MS, 1e300, [3.0, 4.0], "2262"),
            (START + 10 * MS, 1e-3, [], "one row"),
            (START + 10 * MS, 1e-3, [[1.0]], "1 × 1"),
            (START + 10 * MS, 1e-3, 3.0, "a single value"),
            (START + 10 * MS, 1e-3, ["a"], "real number"),
            (START + 10 * MS, 1e-3, [1j], "real number"),
        ):
            with pytest.raises(UsageError, match=reason):
                writer.append("force", start, interval, values)
        writer.append("force", START + 2 * MS, 1e-3, np.array([3, 4], dtype=np.int16))
    recording = read_mcap(path)
    assert recording.problems == recording.notes == ()
    assert recording.channels[0].values.tolist() == [1.0, 2.0, 3.0, 4.0]


def test_appended_arrays_may_be_reused_by_the_caller(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    buffer = np.zeros(10)
    with RecordingWriter(path, METADATA) as writer:
        writer.add_channel("force", "N")
        for number in range(5):
            buffer[:] = number
            writer.append("force", START + number * 10 * MS, 1e-3, buffer)
    assert read_mcap(path).channels[0].values.tolist() == [float(i // 10) for i in range(50)]


def test_the_same_appends_give_the_same_bytes(tmp_path: Path) -> None:
    contents = []
    for name in ("a.mcap", "b.mcap"):
        with RecordingWriter(tmp_path / name, METADATA) as writer:
            writer.add_channel("force", "N")
            writer.append("force", START, 1e-3, np.arange(5000.0))
        contents.append((tmp_path / name).read_bytes())
    assert contents[0] == contents[1]


def test_a_block_is_what_protobuf_would_write() -> None:
    from ingest.mcap_writer import sample_block

    for size in (1, 15, 16, 2047, 2048, 300_000):
        values = np.linspace(-1, 1, size)
        parsed = parsed_block(sample_block(START, 1e-3, values))
        assert (parsed.start_time_ns, parsed.sample_interval_s) == (START, 1e-3)
        assert np.array_equal(np.array(parsed.values), values)


_ALONE = """
import sys

class Blocked:
    def find_spec(self, name, path=None, target=None):
        library = name.partition(".")[0]
        ours = ("numpy", "mcap", "google", "lz4", "zstandard", "schemas", "ingest", "tests")
        if library not in ours and library not in sys.stdlib_module_names:
            raise ModuleNotFoundError(f"No module named {name}", name=name)

sys.meta_path.insert(0, Blocked())
"""
"""Only what a rig's computer installs for writing can be imported after this."""
_UNCOMMON = """
from ingest.mcap_writer import RecordingWriter
from schemas.errors import MissingExtraError
from tests.helpers.mcap_files import METADATA
with RecordingWriter("lbf.mcap", METADATA) as writer:
    try:
        writer.add_channel("force", "lbf")
    except MissingExtraError as error:
        print(error)
    writer.add_channel("force", "mN")
    writer.append("force", 1_772_000_000_000_000_000, 1e-3, [1.0])
"""


def _run_alone(code: str, folder: Path) -> str:
    """What a script says that can import nothing but what the writer needs."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    words = [sys.executable, "-c", _ALONE + code]
    done = subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_readmes_example_runs_with_what_a_rig_installs(tmp_path: Path) -> None:
    _run_alone(writer_example(), tmp_path)
    recording = read_mcap(tmp_path / "P-12_chirp-1.mcap")
    assert {channel.quantity: channel.values.size for channel in recording.channels} == {
        "displacement": 44_000,
        "force": 44_000,
    }
    assert recording.problems == ()


def test_a_unit_that_only_pint_knows_is_refused_in_words_where_pint_is_not(tmp_path: Path) -> None:
    assert _run_alone(_UNCOMMON, tmp_path) == (
        'lbf.mcap: force: reading the unit "lbf" needs pint, which is not installed; expected one of N, newton, mN, kN, cN, µN, uN. '
        "Install pint, or give the values in one of these units\n"
    )
    assert [channel.unit for channel in read_mcap(tmp_path / "lbf.mcap").channels] == ["mN"]
