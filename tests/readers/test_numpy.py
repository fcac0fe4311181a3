"""NumPy files, written by NumPy and byte by byte: sound, odd, cut and dangerous."""

from __future__ import annotations

import datetime
import io
import pickle
import struct
import zipfile
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from ingest import numpy_reader
from ingest.draft import make_draft
from ingest.inspect import DAMAGED, FITS, inspect
from ingest.mapping import FileMapping
from ingest.mapping_keys import OPTIONS
from ingest.numpy_reader import read_numpy
from ingest.reader_kit import check_reader
from schemas.errors import RefusedError

ALL = FileMapping("recording", None, {}, None, {}, {}, {})
TIME = np.arange(400) / 100
READER = SimpleNamespace(suffixes=(".npy", ".npz"), options=OPTIONS["numpy"], read=read_numpy)
MAPPING = """
[time]
column = "arr_0"
index = 0
unit = "s"
[columns.displacement]
column = "arr_0"
index = 1
unit = "mm"
[columns.force]
column = "arr_0"
index = 2
unit = "N"
[recording]
recording_id = "{stem}"
protocol = "cyclic"
loading = "mechanical"
specimen_id = "L-1"
started_at = "2026-03-01T13:05:00Z"
frequency_hz = 0.16
"""


def array_bytes(head: str, body: bytes, version: int = 1) -> bytes:
    """An array byte by byte, as the format's description has it."""
    text = head.encode("utf-8" if version > 2 else "latin-1") + b"\n"
    return b"\x93NUMPY" + bytes([version, 0]) + struct.pack("<H" if version == 1 else "<I", len(text)) + text + body


@pytest.mark.parametrize("version", [1, 2, 3])
def test_an_array_written_byte_by_byte_is_read(tmp_path: Path, version: int) -> None:
    path = tmp_path / "run.npy"
    head = "{'descr': '>i2', 'fortran_order': True, 'shape': (3, 2), }"
    path.write_bytes(array_bytes(head, struct.pack(">6h", 1, 2, 3, -4, 500, 6), version))
    file = read_numpy(path, ALL)
    assert file.names() == ("arr_0",)
    assert file.numbers("arr_0", 0).values.tolist() == [1, 2, 3]
    assert file.numbers("arr_0", 1).values.tolist() == [-4, 500, 6]
    with pytest.raises(RefusedError, match="3 × 2"):
        file.numbers("arr_0")


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_an_archive_is_read_by_the_names_of_its_arrays(tmp_path: Path, save: object) -> None:
    path = tmp_path / "run.npz"
    kind = np.dtype([("t", "<f8"), ("ch", "<f4", (2,)), ("Größe", "<i4")])
    table = np.zeros(3, kind)
    table["t"], table["ch"], table["Größe"] = [0, 1, 2], [[1, 2], [3, 4], [5, 6]], [7, 8, 9]
    arrays = {
        "force": np.arange(3, dtype=">f4"),
        "table": table,
        "lag": np.array([1500, -1], "m8[ms]"),
        "at": np.array(["2026-03-01T14:05:00.25", "NaT"], "M8[ns]"),
        "word": np.array(["ok", "cut"]),
        "one": np.float64(3.5),
        "complex": np.array([1j]),
        "none": np.zeros((0, 2)),
        "objects": np.array([{"a": 1}], dtype=object),
    }
    save(path, **arrays)  # type: ignore[operator]
    file = read_numpy(path, ALL)
    assert set(file.names()) == {
        "force", "table/t", "table/ch", "table/Größe", "lag", "at", "word", "one", "complex",
    }  # fmt: skip
    assert file.numbers("force").values.tolist() == [0, 1, 2]
    assert file.numbers("table/ch", 1).values.tolist() == [2, 4, 6]
    assert file.numbers("table/Größe").values.tolist() == [7, 8, 9]
    assert file.numbers("lag").values.tolist() == [1.5, -0.001]
    assert file.unit("lag") == "s"
    assert file.cells("at") == [datetime.datetime(2026, 3, 1, 14, 5, 0, 250_000), None]
    assert file.cells("word") == ["ok", "cut"]
    assert file.numbers("one").values.tolist() == [3.5]
    for name, said in (("complex", "complex numbers"), ("none", "empty"), ("objects", "never opened")):
        with pytest.raises(RefusedError, match=said):
            file.numbers(name)


def test_pickled_objects_are_never_opened(tmp_path: Path) -> None:
    opened = tmp_path / "opened"

    class Trap:
        def __reduce__(self) -> tuple[object, tuple[str]]:
            return Path.touch, (opened,)  # type: ignore[return-value]

    head = "{'descr': '|O', 'fortran_order': False, 'shape': (1,), }"
    for name, content in (("a.npy", array_bytes(head, pickle.dumps([Trap()]))), ("b.npy", pickle.dumps(Trap()))):
        path = tmp_path / name
        path.write_bytes(content)
        with pytest.raises(RefusedError, match=r"never opened|cannot be read"):
            read_numpy(path, ALL).numbers("arr_0")
    assert not opened.exists()


@pytest.mark.parametrize("suffix", [".npy", ".npz"])
def test_the_kit_passes(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"run{suffix}"
    (np.save if suffix == ".npy" else np.savez_compressed)(path, TIME)
    check_reader(READER, path, {"arr_0": list(TIME)})


def test_a_matrix_is_drafted(tmp_path: Path) -> None:
    path = tmp_path / "run.npz"
    np.savez(path, time_s=TIME, force_N=np.sin(TIME), travel_mm=np.cos(TIME))
    content = make_draft(path).content
    assert content["time"] == {"column": "time_s", "unit": "s"}
    assert content["columns"]["force"] == {"column": "force_N", "unit": "N"}


def test_a_cut_array_keeps_its_whole_rows(tmp_path: Path) -> None:
    path = tmp_path / "run.npy"
    np.save(path, np.column_stack((TIME, np.sin(TIME), np.cos(TIME))))
    path.with_name("run.npy.toml").write_text(MAPPING, encoding="utf-8")
    assert inspect(path).verdict == FITS
    path.write_bytes(path.read_bytes()[: -24 * 100 - 5])
    found = inspect(path)
    assert found.verdict == DAMAGED
    assert found.problems == ("arr_0 has 299 of 400 rows: the file is cut",)
    assert found.channels[0].samples == 299


def test_a_cut_array_that_stands_by_columns_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.npy"
    np.save(path, np.asfortranarray(np.column_stack((TIME, TIME))))
    path.write_bytes(path.read_bytes()[:-8])
    with pytest.raises(RefusedError, match="it is cut"):
        read_numpy(path, ALL)


def test_sizes_are_checked_before_anything_is_inflated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "run.npz"
    np.savez_compressed(path, bomb=np.zeros(1 << 20), force=TIME)
    assert path.stat().st_size < 20_000
    monkeypatch.setattr(numpy_reader, "_LARGEST", 1 << 20)
    file = read_numpy(path, ALL)
    with pytest.raises(RefusedError, match="8 MiB"):
        file.numbers("bomb")
    assert file.numbers("force").values.size == TIME.size
    head = "{'descr': '<f8', 'fortran_order': False, 'shape': (99999999999,), }"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("bomb.npy", array_bytes(head, b"\x00" * 80))
    with pytest.raises(RefusedError, match="MiB"):
        read_numpy(path, ALL).numbers("bomb")


@pytest.mark.parametrize(
    "head",
    ["{'descr': '<f8', 'fortran_order': False, 'shape': (-1,), }", "{'descr': '<f8', 'shape': (1,)}", "[1, 2]",
     "__import__('os')", "{'descr': 'zz', 'fortran_order': False, 'shape': (1,), }", "(" * 5000],
)  # fmt: skip
def test_a_head_that_is_none_is_refused(tmp_path: Path, head: str) -> None:
    path = tmp_path / "run.npy"
    path.write_bytes(array_bytes(head, bytes(8)))
    with pytest.raises(RefusedError, match="cannot be read as NumPy"):
        read_numpy(path, ALL).numbers("arr_0")


def test_a_member_with_another_size_than_its_head_says_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.npz"
    stream = io.BytesIO()
    np.save(stream, TIME)
    for content in (stream.getvalue()[:-8], stream.getvalue() + b"more"):
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("F.npy", content)
        with pytest.raises(RefusedError, match="bytes"):
            read_numpy(path, ALL).numbers("F")
