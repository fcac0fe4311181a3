"""Files that are cut at any place: what is whole is read and called damaged, what is lost is told, nothing is made up."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.feather
import pyarrow.parquet
import pytest

from ingest.canonical import canonical
from ingest.mapping import FileMapping
from ingest.read import read_raw
from schemas.errors import RefusedError
from schemas.recording import RawRecording, Recording
from tests.helpers.cut_workbooks import write_excel, write_open_document
from tests.helpers.mcap_files import METADATA

ABOUT = {**METADATA, "started_at": "2026-02-25T06:13:20+00:00"}
ROWS = 400
TIME = np.arange(ROWS) / 100
CHANNELS = {"force": ("F", "N", np.sin(4 * TIME) + 2), "displacement": ("x", "mm", np.cos(4 * TIME))}
TABLE = {"t": TIME, **{name: values for name, _, values in CHANNELS.values()}}


def mapping(suffix: str, *, by_number: bool = False, time: bool = True, **options: Any) -> FileMapping:
    places = {name: place if by_number else name for place, name in enumerate(TABLE)}
    columns = {q: {"column": places[name], "unit": unit} for q, (name, unit, _) in CHANNELS.items()}
    content: dict[str, Any] = {"recording": ABOUT, "columns": columns, **options}
    if time:
        content["time"] = {"column": places["t"], "unit": "s"}
    return FileMapping.parse(content, stem="run", suffix=suffix, source=f"run{suffix}.toml")


def read(path: Path, found: FileMapping) -> Recording:
    raw = read_raw(path, found)
    assert isinstance(raw, RawRecording)
    return canonical(raw, where=path.name)


def written(write: Callable[[Path], Any], tmp_path: Path) -> bytes:
    path = tmp_path / "whole"
    write(path)
    return path.read_bytes()


def feather(path: Path, how: str = "lz4") -> None:
    pyarrow.feather.write_feather(pa.table(TABLE), str(path), compression=how, chunksize=70)


def stream(path: Path) -> None:
    table = pa.table(TABLE)
    with pa.OSFile(str(path), "wb") as file, pa.ipc.new_stream(file, table.schema) as writer:
        writer.write_table(table, max_chunksize=70)


def archive(path: Path, save: Callable[..., None] = np.savez_compressed) -> None:
    with path.open("wb") as file:
        save(file, **TABLE)


def universal(path: Path, *, said_bytes: int = 8 * ROWS) -> None:
    """Two sets of type 58 in binary numbers."""
    none = f"{'NONE':<80}\n"
    parts = []
    for name, unit, values in CHANNELS.values():
        head = (
            f"{-1:6}\n{58:6}b{1:6}{2:6}{11:12}{said_bytes:12}{0:6}{0:6}{0:12}{0:12}\n{name:<80}\n{none * 4}"
            f"{1:5}{0:10}{0:5}{0:10} {'NONE':<10}{1:10}{1:4} {'NONE':<10}{1:10}{1:4}\n"
            f"{4:10}{ROWS:10}{1:10}{0.0:13.5e}{0.01:13.5e}{0.0:13.5e}\n"
            f"{17:10}{0:5}{0:5}{0:5} {'Time':<20} {'s':<20}\n{13:10}{0:5}{0:5}{0:5} {name:<20} {unit:<20}\n"
            + f"{0:10}{0:5}{0:5}{0:5} {'NONE':<20} {'NONE':<20}\n"
            * 2
        )
        parts.append(head.encode() + values.astype("<f8").tobytes() + f"{-1:6}\n".encode())
    path.write_bytes(b"".join(parts))


LINES = list(zip(*(values.tolist() for values in TABLE.values()), strict=True))
FORMATS: dict[str, tuple[str, Callable[[Path], Any], dict[str, Any]]] = {
    "Feather": (".feather", feather, {}),
    "Feather without compression": (".feather", lambda path: feather(path, "uncompressed"), {}),
    "Arrow": (".arrow", stream, {}),
    "NumPy archive": (".npz", archive, {}),
    "NumPy archive without compression": (".npz", lambda path: archive(path, np.savez), {}),
    "universal file": (".uff", universal, {"time": False}),
    "universal file that says no size": (".uff", lambda path: universal(path, said_bytes=0), {"time": False}),
    "Excel": (".xlsx", lambda path: path.write_bytes(write_excel(list(TABLE), LINES, book_first=True)), {"by_number": True}),
    "openpyxl": (".xlsx", lambda path: path.write_bytes(write_excel(list(TABLE), LINES, book_first=False)), {"by_number": True}),
    "OpenDocument": (".ods", lambda path: path.write_bytes(write_open_document(list(TABLE), LINES)), {"excel": {"sheet": "run"}}),
}  # fmt: skip
"""Name → ending, writer, and how it is mapped."""


@pytest.mark.long_after(1)
@pytest.mark.parametrize("name", FORMATS)
def test_a_cut_file_gives_what_is_whole(name: str, tmp_path: Path) -> None:
    suffix, write, options = FORMATS[name]
    content = written(write, tmp_path)
    path, found = tmp_path / f"run{suffix}", mapping(suffix, **options)
    path.write_bytes(content)
    assert read(path, found).status == "ok"
    kept = []
    for share in (0.02, 0.3, 0.5, 0.7, 0.85, 0.95, 0.999):
        path.write_bytes(content[: int(share * len(content))])
        try:
            recording = read(path, found)
        except RefusedError:
            continue
        assert recording.status == "damaged"
        assert recording.problems[0]
        for quantity, (_, _, values) in CHANNELS.items():
            channel = recording.channels[quantity]
            places = np.round((channel.time_ns - channel.time_ns[0]) / 1e7).astype(int)
            there = np.isfinite(channel.values)
            assert channel.values[there] == pytest.approx(values[places[there]], abs=1e-9)
        kept.append(min(int(np.isfinite(c.values).sum()) for c in recording.channels.values()))
    assert kept == sorted(kept)
    assert len(kept) >= 3, "refused where something was left"
    assert kept[-1] > 0.85 * ROWS


def test_parquet_without_its_end_says_why_nothing_can_be_had(tmp_path: Path) -> None:
    content = written(lambda path: pyarrow.parquet.write_table(pa.table(TABLE), path), tmp_path)
    path = tmp_path / "run.parquet"
    for size in (13, len(content) // 2, len(content) - 1):
        path.write_bytes(content[:size])
        with pytest.raises(RefusedError, match="its end is missing, and with it the only list"):
            read(path, mapping(".parquet"))


@pytest.mark.parametrize("book_first", [True, False])
def test_names_of_columns_that_are_lost_are_the_reason_that_is_told(tmp_path: Path, book_first: bool) -> None:
    content = write_excel(list(TABLE), LINES, book_first=book_first)
    path = tmp_path / "run.xlsx"
    path.write_bytes(content[: len(content) // 2])
    with pytest.raises(RefusedError, match="the list of its texts is lost: 3 cells of text are empty") as refused:
        read(path, mapping(".xlsx"))
    assert "can be mapped by number" in str(refused.value)
    assert "up to" in str(refused.value)


def test_a_number_whose_format_is_lost_is_no_number(tmp_path: Path) -> None:
    """It may be a date, which stands as a number of days."""
    content = write_excel(list(TABLE), LINES, book_first=True, format_of_first=True)
    path = tmp_path / "run.xlsx"
    path.write_bytes(content[: len(content) // 2])
    with pytest.raises(RefusedError, match="numbers that may be dates are empty"):
        read(path, mapping(".xlsx", by_number=True))


def test_a_sheet_whose_name_is_lost_is_not_guessed(tmp_path: Path) -> None:
    content = write_excel(list(TABLE), LINES, book_first=False)
    path = tmp_path / "run.xlsx"
    path.write_bytes(content[: len(content) // 2])
    with pytest.raises(RefusedError, match="the names of its sheets are lost"):
        read(path, mapping(".xlsx", by_number=True, excel={"sheet": "run"}))


def test_an_array_that_is_lost_whole_is_named(tmp_path: Path) -> None:
    content = written(archive, tmp_path)
    path = tmp_path / "run.npz"
    path.write_bytes(content[: len(content) // 2])
    with pytest.raises(RefusedError, match=r'column "x" is not in the file \(the file ends too early'):
        read(path, mapping(".npz"))


def test_a_cut_archive_is_not_believed_about_its_size(tmp_path: Path) -> None:
    """A head that says a billion rows, and a few bytes."""
    file = io.BytesIO()
    head = "{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000,), }\n"
    with zipfile.ZipFile(file, "w") as packed:
        packed.writestr("t.npy", b"\x93NUMPY\x01\x00" + len(head).to_bytes(2, "little") + head.encode() + bytes(8000))
    path = tmp_path / "run.npz"
    path.write_bytes(file.getvalue()[:4000])
    with pytest.raises(RefusedError, match="t is left out: it is cut"):
        read(path, mapping(".npz"))


def test_an_arrow_file_whose_directory_is_damaged_is_read(tmp_path: Path) -> None:
    content = bytearray(written(feather, tmp_path))
    content[-20] ^= 0xFF
    path = tmp_path / "run.feather"
    path.write_bytes(content)
    recording = read(path, mapping(".feather"))
    assert recording.status == "damaged"
    assert recording.channels["force"].values.size == ROWS


def test_numbers_that_look_like_a_mark_do_not_end_a_set(tmp_path: Path) -> None:
    """Binary numbers are passed over by the size that the head says: the last set is told from its neighbour."""
    content = written(universal, tmp_path)
    mark = content.rindex(b"    -1\n", 0, len(content) - 7)  # where the second set begins
    path = tmp_path / "run.uff"
    path.write_bytes(content[:mark].removesuffix(b"    -1\n") + b"    -1\n" + content[mark : -8 * 100])
    recording = read(path, mapping(".uff", time=False))
    assert recording.status == "damaged"
    assert "set 1 has 300 of 400 values: it is cut" in recording.problems


def test_binary_values_of_an_unknown_type_are_refused(tmp_path: Path) -> None:
    content = written(universal, tmp_path)
    path = tmp_path / "run.uff"
    path.write_bytes(content.replace(f"{4:10}{ROWS:10}".encode(), f"{3:10}{ROWS:10}".encode()))
    with pytest.raises(RefusedError, match="set 0 has values of type 3; expected one of the types 2, 4, 5, 6"):
        read(path, mapping(".uff", time=False))


def test_a_damaged_head_of_an_array_is_refused_in_the_same_words_each_time(tmp_path: Path) -> None:
    content = written(lambda path: archive(path, np.savez), tmp_path).replace(b"False", b"Falsa")
    start = content.index(b"\x93NUMPY")
    path = tmp_path / "run.npy"
    path.write_bytes(content[start:])
    with pytest.raises(RefusedError, match="its head does not describe an array"):
        read(path, mapping(".npy"))
