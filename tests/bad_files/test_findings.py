"""What the fuzzing has found, one defect per file, and the fuzzing itself in short."""

from __future__ import annotations

import contextlib
import struct
from pathlib import Path

import numpy as np
import pytest

from ingest.mapping import FileMapping
from ingest.read import read_raw
from ingest.tables import ResponseTable
from schemas.errors import RefusedError
from schemas.recording import RawRecording
from tests.bad_files import seeds
from tests.bad_files.fuzz import Tally, batch
from tests.bad_files.seeds import Seed


def named(made: list[Seed], name: str) -> Seed:
    return next(seed for seed in made if seed.name == name)


def test_matlab_number_type_beyond_the_table(tmp_path: Path) -> None:
    """scipy looks a number type up without asking whether there is one, and crashes."""
    seed = named(seeds.matlab(), "v5")
    damaged = bytearray(seed.content)
    double = struct.pack("<II", 9, 24 * 3 * 8)  # the tag before the numbers: their type and how many bytes they take
    damaged[damaged.index(double)] = 0xFF
    path = tmp_path / "run.mat"
    path.write_bytes(damaged)
    with pytest.raises(RefusedError, match="cannot be read"):
        read_raw(path, seed.mapping)


def test_hdf5_name_that_is_no_text(tmp_path: Path) -> None:
    """h5py gives such a name as bytes. The other datasets are as they were."""
    h5py = pytest.importorskip("h5py")
    seed = named(seeds.hdf5(), "groups")
    path = tmp_path / "run.h5"
    path.write_bytes(seed.content)
    with h5py.File(path, "r+") as file:
        file["rig"][b"\xff\xfe"] = np.arange(3.0)
    raw = read_raw(path, seed.mapping)
    assert isinstance(raw, RawRecording)
    assert {c.quantity: c.values.size for c in raw.channels} == {"force": 24, "displacement": 24}


def test_tdms_warnings_stay_out_of_the_terminal(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """nptdms writes a damaged file's bytes to the terminal."""
    pytest.importorskip("nptdms")
    (seed,) = seeds.tdms()
    path = tmp_path / "run.tdms"
    path.write_bytes(seed.content[:-100].replace(b"unit_string", b"unit\xff\x1b[2J\x00\x00"))
    with contextlib.suppress(RefusedError):
        read_raw(path, seed.mapping)
    assert "".join(capfd.readouterr()) == ""


def test_a_checksum_over_samples_speaks_of_samples(tmp_path: Path) -> None:
    """Without chunks a wrong checksum may mean any sample: the recording is damaged, and says what may have changed."""
    seed = named(seeds.native_mcap(), "without chunks")
    damaged = bytearray(seed.content)
    damaged[damaged.index(struct.pack("<d", 1 + 20 / 1024))] ^= 1
    path = tmp_path / "run.mcap"
    path.write_bytes(damaged)
    raw = read_raw(path, None)
    assert isinstance(raw, RawRecording)
    assert any("samples and metadata may have changed" in problem for problem in raw.problems)


@pytest.mark.long_after(3)
@pytest.mark.parametrize("reader", list(seeds.READERS))
def test_mutated_files_keep_every_promise(reader: str, tmp_path: Path) -> None:
    """A few hundred of the cases of `make fuzz`; the slow and the large are left to it, for other tests run here too."""
    tally = Tally()
    tally.join(batch(reader, 1, range(240 if reader == "mcap" else 40), tmp_path))
    broken = [(number, what) for number, what in tally.findings if not what.startswith(("hang", "memory"))]
    assert broken == []
    assert tally.outcomes.total() == tally.cases
    assert len(tally.outcomes) >= 2, "the mutations are neither all harmless nor all fatal"


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "measured",
    ["s,l\n1,inf,1\n2,1,inf\n3,1,0.1\n4,1,0.2\n5,1,0.3\n", "m,p\n1,inf,inf\n2,1,-inf\n3,1,0.1\n4,1,0.2\n5,1,0.3\n"],
)
def test_infinite_responses_are_left_out_in_silence(tmp_path: Path, measured: str) -> None:
    """Multiplied out, infinite parts gave numerical warnings in the terminal."""
    first, second = measured[0], measured[2]
    names = {"s": "storage", "l": "loss", "m": "magnitude", "p": "phase"}
    units = {"s": "N/mm", "l": "N/mm", "m": "N/mm", "p": "rad"}
    path = tmp_path / "run.csv"
    path.write_text("f," + measured)
    columns = {names[c]: {"column": c, "unit": units[c]} for c in (first, second)}
    mapping = FileMapping.parse(
        {
            "kind": "frequency_response",
            "columns": {"frequency": {"column": "f", "unit": "Hz"}, **columns},
            "recording": {"recording_id": "r"},
        },
        stem="run",
        suffix=".csv",
        source="run.csv.toml",
    )
    table = read_raw(path, mapping)
    assert isinstance(table, ResponseTable)
    assert table.frequency_hz.tolist() == [3.0, 4.0, 5.0]
