"""MATLAB v5 and v7.3, HDF5, TDMS and UFF."""

from __future__ import annotations

import builtins
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import scipy.io

from ingest.mapping import FileMapping
from ingest.read import read_raw
from schemas.errors import MissingExtraError, RefusedError
from schemas.recording import RawRecording

START = "2026-03-01T14:00:00+00:00"
START_NS = 1_772_373_600_000_000_000
TIME = np.arange(5) / 100
FORCE = np.array([1.0, 2.0, 4.0, 8.0, 16.0])


_NOTHING = f"{'NONE':<80}\n" * 4
_UNUSED_AXIS = f"{0:10}{0:5}{0:5}{0:5} {'NONE':<20} {'NONE':<20}\n"
_UFF = (  # one data set of type 58: time response, five even doubles, as the format lays it out in columns
    f"{-1:6}\n{58:6}\n{'Force':<80}\n{_NOTHING}"
    f"{1:5}{0:10}{0:5}{0:10} {'NONE':<10}{1:10}{1:4} {'NONE':<10}{1:10}{1:4}\n"
    f"{4:10}{5:10}{1:10}{0.0:13.5e}{0.01:13.5e}{0.0:13.5e}\n"
    f"{17:10}{0:5}{0:5}{0:5} {'Time':<20} {'s':<20}\n"
    f"{13:10}{0:5}{0:5}{0:5} {'Force':<20} {'N':<20}\n"
    f"{_UNUSED_AXIS}{_UNUSED_AXIS}"
    f"{{values}}\n{{last}}\n{-1:6}\n"
)


def mapping(suffix: str, columns: dict[str, Any], time: dict[str, Any] | None = None, **rest: Any) -> FileMapping:
    content: dict[str, Any] = {"columns": columns, "recording": {"started_at": START}, **rest}
    if time is not None:
        content["time"] = time
    return FileMapping.parse(content, stem="run", suffix=suffix, source=f"run{suffix}.toml")


def read(path: Path, found: FileMapping) -> RawRecording:
    raw = read_raw(path, found)
    assert isinstance(raw, RawRecording)
    return raw


def matlab_columns(**time: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    return {"force": {"column": "run.data", "index": 1, "unit": "N"}}, {"column": "run.data", "index": 0, "unit": "s"}


def test_matlab_structure_and_matrix(tmp_path: Path) -> None:
    path = tmp_path / "run.mat"
    scipy.io.savemat(path, {"run": {"data": np.column_stack((TIME, FORCE)), "note": "x"}}, do_compression=True)
    raw = read(path, mapping(".mat", *matlab_columns()))
    assert raw.channels[0].values.tolist() == FORCE.tolist()
    assert raw.channels[0].time_ns.tolist() == [START_NS + i * 10_000_000 for i in range(5)]


def test_matlab_vectors_either_way_up(tmp_path: Path) -> None:
    path = tmp_path / "run.mat"
    scipy.io.savemat(path, {"t": TIME[None, :], "F": FORCE[:, None].astype(np.int16)})
    found = mapping(".mat", {"force": {"column": "F", "unit": "N"}}, {"column": "t", "unit": "s"})
    assert read(path, found).channels[0].values.tolist() == FORCE.tolist()


def test_matlab_transposed(tmp_path: Path) -> None:
    path = tmp_path / "run.mat"
    scipy.io.savemat(path, {"run": {"data": np.vstack((TIME, FORCE))}})
    raw = read(path, mapping(".mat", *matlab_columns(), matlab={"transpose": True}))
    assert raw.channels[0].values.tolist() == FORCE.tolist()


def test_matlab_mistakes_are_named(tmp_path: Path) -> None:
    path = tmp_path / "run.mat"
    scipy.io.savemat(path, {"run": {"data": np.column_stack((TIME, FORCE)), "name": "abc"}, "z": FORCE * 1j})
    time = {"column": "run.data", "index": 0, "unit": "s"}
    for column, problem in (
        ({"column": "run.dta"}, 'column "run.dta" is not in the file'),
        ({"column": "run.data"}, "is 5 × 2"),
        ({"column": "run.data", "index": 2}, "the matrix has 2 columns"),
        ({"column": "run.name"}, "not numbers"),
        ({"column": "z"}, "holds complex128"),
    ):
        with pytest.raises(RefusedError) as refused:
            read(path, mapping(".mat", {"force": {"unit": "N", **column}}, time))
        assert problem in refused.value.problem


@pytest.mark.long
@pytest.mark.slow
def test_damaged_matlab_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.mat"
    scipy.io.savemat(path, {"run": {"data": np.column_stack((TIME, FORCE))}}, do_compression=True)
    whole = path.read_bytes()
    rng = np.random.default_rng(3)
    refused = 0
    for _ in range(100):
        changed = bytearray(whole[: rng.integers(1, len(whole) + 1)])
        changed[rng.integers(len(changed))] ^= 1 << rng.integers(8)
        path.write_bytes(changed)
        try:
            read(path, mapping(".mat", *matlab_columns()))
        except RefusedError:
            refused += 1
    assert refused > 10


def test_hdf5_and_matlab_73(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    plain = tmp_path / "run.h5"
    with h5py.File(plain, "w") as file:
        file["rig/force"] = FORCE
        file["rig/force"].attrs["unit"] = "mN"
        file["rig/t"] = TIME
    found = mapping(".h5", {"force": {"column": "force"}}, {"column": "t", "unit": "s"}, hdf5={"root": "rig"})
    raw = read(plain, found)
    assert raw.channels[0].unit == "mN"
    assert raw.channels[0].values.tolist() == FORCE.tolist()
    matlab = tmp_path / "run.mat"
    with h5py.File(matlab, "w", userblock_size=512) as file:
        file["run/data"] = np.column_stack((TIME, FORCE)).T  # MATLAB stores columns first
    with matlab.open("r+b") as raw_file:
        raw_file.write(b"MATLAB 7.3 MAT-file")
    assert read(matlab, mapping(".mat", *matlab_columns())).channels[0].values.tolist() == FORCE.tolist()
    whole = plain.read_bytes()
    for size in (8, 100, len(whole) // 2):
        plain.write_bytes(whole[:size])
        with pytest.raises(RefusedError, match="cannot be read as HDF5"):
            read(plain, found)


def test_hdf5_dimensions_beyond_memory_are_refused(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "run.h5", "w") as file:
        file.create_dataset("F", shape=(1 << 40,), chunks=(1024,), dtype="f8")
    found = mapping(".h5", {"force": {"column": "F", "unit": "N"}}, {"sample_rate_hz": 10.0})
    with pytest.raises(RefusedError, match="values"):
        read(tmp_path / "run.h5", found)


def test_tdms_waveform(tmp_path: Path) -> None:
    nptdms = pytest.importorskip("nptdms")
    path = tmp_path / "run.tdms"
    properties = {
        "wf_start_time": np.datetime64("2026-03-01T14:00:00"),
        "wf_increment": 0.01,
        "wf_start_offset": 0.0,
        "unit_string": "mN",
    }
    with nptdms.TdmsWriter(path) as writer:
        writer.write_segment([nptdms.ChannelObject("rig", "force", FORCE, properties=properties)])
    found = mapping(".tdms", {"force": {"column": "force"}}, tdms={"group": "rig"})
    raw = read(path, found)
    assert raw.channels[0].unit == "mN"
    assert raw.channels[0].time_ns.tolist() == [START_NS + i * 10_000_000 for i in range(5)]
    assert not raw.problems


def test_tdms_cut_in_its_last_segment(tmp_path: Path) -> None:
    nptdms = pytest.importorskip("nptdms")
    path = tmp_path / "run.tdms"
    with nptdms.TdmsWriter(path) as writer:
        for _ in range(2):
            writer.write_segment([nptdms.ChannelObject("rig", "force", np.arange(100.0))])
    path.write_bytes(path.read_bytes()[:-400])
    with path.open("r+b") as file:  # a recorder that was switched off had not yet filled in the segment's length
        content = path.read_bytes()
        last = content.rindex(b"TDSm")
        file.seek(last + 12)
        file.write(b"\xff" * 8)
    found = mapping(".tdms", {"force": {"column": "rig/force", "unit": "N"}}, {"sample_rate_hz": 100.0})
    raw = read(path, found)
    assert 100 <= raw.channels[0].values.size < 200
    assert "last segment is incomplete" in raw.problems[0]
    path.write_bytes(b"not TDMS at all")
    with pytest.raises(RefusedError, match="cannot be read as TDMS"):
        read(path, found)


def test_uff(tmp_path: Path) -> None:
    with warnings.catch_warnings():
        pyuff = pytest.importorskip("pyuff")
    path = tmp_path / "run.uff"
    assert pyuff
    path.write_text(_UFF.format(values="".join(f"{v:20.11e}" for v in FORCE[:4]), last=f"{FORCE[4]:20.11e}"))
    for column in (0, "Force"):
        raw = read(path, mapping(".uff", {"force": {"column": column}}))
        assert raw.channels[0].unit == "N"
        assert raw.channels[0].values == pytest.approx(FORCE)
        assert raw.channels[0].time_ns.tolist() == [START_NS + i * 10_000_000 for i in range(5)]
    path.write_text("nonsense")
    with pytest.raises(RefusedError):
        read(path, mapping(".uff", {"force": {"column": 0}}))


@pytest.mark.parametrize(("suffix", "module"), [(".h5", "h5py"), (".tdms", "nptdms"), (".uff", "pyuff")])
def test_missing_reader_names_its_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str, module: str
) -> None:
    real = builtins.__import__

    def without(name: str, *arguments: Any, **options: Any) -> Any:
        if name == module:
            raise ImportError(name)
        return real(name, *arguments, **options)

    monkeypatch.setattr(builtins, "__import__", without)
    path = tmp_path / f"run{suffix}"
    path.write_bytes(b"x")
    with pytest.raises(MissingExtraError) as missing:
        read(path, mapping(suffix, {"force": {"column": "F", "unit": "N"}}, {"sample_rate_hz": 1.0}))
    assert f"`pip install {module}`" in missing.value.remedy
    assert missing.value.transient


@pytest.mark.parametrize("suffix", [".npz", ".h5", ".parquet"])
def test_true_and_false_in_place_of_a_quantity_are_told(tmp_path: Path, suffix: str) -> None:
    """A flag beside the force, mapped by mistake, made a force of 0 and 1 N without a word."""
    path = tmp_path / f"run{suffix}"
    arrays = {"t": TIME, "f": FORCE > 3}
    if suffix == ".npz":
        np.savez(path, **arrays)
    elif suffix == ".h5":
        with pytest.importorskip("h5py").File(path, "w") as file:
            file.update(arrays)
    else:
        pq.write_table(pa.table(arrays), path)
    raw = read(path, mapping(suffix, {"force": {"column": "f", "unit": "N"}}, {"column": "t", "unit": "s"}))
    assert raw.channels[0].values.tolist() == [0, 0, 1, 1, 1]
    assert sum("true and false are read as 1 and 0" in note for note in raw.notes) == 1


@pytest.mark.parametrize(
    ("version", "column"), [("5", "flag"), ("5", "run.flag"), ("5", "c"), ("7.3", "flag"), ("7.3", "run.flag")]
)
def test_logical_arrays_of_matlab_are_told(tmp_path: Path, version: str, column: str) -> None:
    """They are stored as bytes of 0 and 1, and were a force of 0 and 1 N without a word; a byte of 0 and 1 is none."""
    path = tmp_path / "run.mat"
    flags = FORCE > 3
    cells = np.array([False, False, True, True, True], dtype=object)
    if version == "5":
        byte = flags.astype(np.uint8)
        scipy.io.savemat(
            path, {"t": TIME, "flag": flags, "run": {"flag": flags, "byte": byte}, "c": cells, "byte": byte}
        )
    else:
        with pytest.importorskip("h5py").File(path, "w", userblock_size=512) as file:
            file["t"] = TIME[:, None]
            for name, matlab_class in (
                ("flag", "logical"),
                ("run/flag", "logical"),
                ("byte", "uint8"),
                ("run/byte", "uint8"),
            ):
                file[name] = flags.astype(np.uint8)[:, None]
                file[name].attrs["MATLAB_class"] = np.bytes_(matlab_class)
    for name, told in ((column, 1), (column.replace("flag", "byte").replace("c", "byte"), 0)):
        raw = read(path, mapping(".mat", {"force": {"column": name, "unit": "N"}}, {"column": "t", "unit": "s"}))
        assert raw.channels[0].values.tolist() == [0, 0, 1, 1, 1]
        assert sum("true and false are read as 1 and 0" in note for note in raw.notes) == told, name


def test_codes_of_an_enumeration_are_told(tmp_path: Path) -> None:
    """The states of a program, mapped by mistake, were a force of 0 to 2 N without a word."""
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "run.h5"
    with h5py.File(path, "w") as file:
        file["t"] = TIME
        file["state"] = np.array([0, 1, 2, 2, 0]).astype(h5py.enum_dtype({"OFF": 0, "HOLD": 2, "RAMP": 1}, "i1"))
    raw = read(path, mapping(".h5", {"force": {"column": "state", "unit": "N"}}, {"column": "t", "unit": "s"}))
    assert raw.notes == ("force: the numbers are codes: 0 = OFF, 1 = RAMP, 2 = HOLD",)
