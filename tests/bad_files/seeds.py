"""Valid files of every reader, small, each made by other code than the reader's: what the fuzzing starts from.

Where a format has checksums, no mutation may make its reader report something else as whole. Text and array formats have
none: a changed digit there is another number.
"""

from __future__ import annotations

import io
import json
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import CompressionType, Writer

from ingest.mapping import FileMapping
from tests.helpers.binary_workbooks import write_xls, write_xlsb
from tests.helpers.cut_workbooks import write_excel, write_open_document
from tests.helpers.mcap_files import METADATA, START, packaged
from tests.helpers.xlsx_files import write_xlsx

ABOUT = {**METADATA, "started_at": "2026-02-25T06:13:20+00:00"}
TIME = np.arange(24) / 100
FORCE = np.sin(TIME * 40) + 2
TRAVEL = np.cos(TIME * 40)
PARTS, WHOLE, NOTHING = "parts", "whole", "nothing"
_PAIR = {"force": {"column": "F", "unit": "N"}, "displacement": {"column": "x", "unit": "mm"}}
_CLOCK = {"column": "t", "unit": "s"}


@dataclass(frozen=True)
class Seed:
    """A valid file and how it is read.

    Parameters
    ----------
    reader, name : which reader it exercises, and its own name
    suffix : ending of the file
    content : its bytes
    mapping : the TOML beside it, None where the format needs none
    sealed : what checksums cover: each of its `PARTS`, only the file as a `WHOLE`, or `NOTHING`
    """

    reader: str
    name: str
    suffix: str
    content: bytes
    mapping: FileMapping | None = None
    sealed: str = NOTHING


def _mapped(suffix: str, **content: Any) -> FileMapping:
    base: dict[str, Any] = {"recording": ABOUT, "columns": _PAIR, "time": _CLOCK}
    whole = {key: value for key, value in {**base, **content}.items() if value is not None}
    return FileMapping.parse(whole, stem="run", suffix=suffix, source=f"run{suffix}.toml")


def _made(write: Callable[[Path], Any], suffix: str) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"run{suffix}"
        write(path)
        return path.read_bytes()


def native_mcap() -> list[Seed]:
    """Files as the mcap package writes them, in each compression, with all checksums; and one without any."""
    seeds = []
    for compression in (CompressionType.ZSTD, CompressionType.LZ4, CompressionType.NONE):
        content = _made(lambda path, how=compression: packaged(path, blocks=6, compression=how), ".mcap")
        seeds.append(Seed("mcap", f"chunks, {compression.name.lower()}", ".mcap", content, sealed=PARTS))
    bare = _made(lambda path: packaged(path, blocks=4, use_chunking=False), ".mcap")
    seeds.append(Seed("mcap", "without chunks", ".mcap", bare, sealed=WHOLE))
    unsealed = _made(lambda path: packaged(path, blocks=4, data_crc=False, enable_crcs=False), ".mcap")
    seeds.append(Seed("mcap", "without checksums", ".mcap", unsealed))
    return seeds


def message_mcap() -> list[Seed]:
    """One JSON message per sample."""
    stream = io.BytesIO()
    writer = Writer(stream, chunk_size=400)
    writer.start()
    schema = writer.register_schema("any", "jsonschema", b"{}")
    channel = writer.register_channel("/cell", "json", schema)
    for i, (force, travel) in enumerate(zip(FORCE, TRAVEL, strict=True)):
        at = START + i * 10_000_000
        writer.add_message(channel, at, json.dumps({"wrench": {"z": force}, "x": [travel, i]}).encode(), at)
    writer.finish()
    columns = {
        "force": {"column": "/cell", "field": "wrench.z", "unit": "N"},
        "displacement": {"column": "/cell", "field": "x", "index": 0, "unit": "mm"},
    }
    mapping = _mapped(".mcap", format="mcap", columns=columns, time=None)
    return [Seed("mcap messages", "json", ".mcap", stream.getvalue(), mapping)]


def csv() -> list[Seed]:
    """A plain file, a German one with a unit row, and the three kinds of tables."""
    rows = list(zip(TIME, FORCE, TRAVEL, strict=True))
    plain = "t,F,x\n" + "".join(f"{t:.2f},{f:.5f},{x:.5f}\n" for t, f, x in rows)
    german = "Prüfung 7\nZeit;Kraft;Weg\ns;N;mm\n" + "".join(
        f"{t:.2f};{f:.5f};{x:.5f}\n".replace(".", ",") for t, f, x in rows
    )
    columns = {"force": {"column": "Kraft"}, "displacement": {"column": "Weg"}}
    options = {"delimiter": ";", "decimal": ",", "encoding": "cp1252", "skip_rows": 1, "unit_row": True}
    lives = "t,f,U,kind\n" + "".join(f"{7 * i + 1},{'yes' if i % 3 else 'no'},{5000 + i},a\n" for i in range(12))
    life = {
        "lifetime": {"column": "t", "unit": "min"},
        "failed": {"column": "f", "failed_values": ["yes"], "censored_values": ["no"]},
        "voltage": {"column": "U", "unit": "V"},
    }
    sweep = "f,s,l\n" + "".join(f"{1.3**i:.4f},{1 + 0.02 * i:.4f},{0.1 + 0.01 * i:.4f}\n" for i in range(12))
    response = {
        "frequency": {"column": "f", "unit": "Hz"},
        "storage": {"column": "s", "unit": "MPa"},
        "loss": {"column": "l", "unit": "MPa"},
    }
    table = {"time": None, "recording": {"recording_id": "table_1"}}
    return [
        Seed("csv", "plain", ".csv", plain.encode(), _mapped(".csv")),
        Seed(
            "csv",
            "decimal comma",
            ".csv",
            german.encode("cp1252"),
            _mapped(".csv", csv=options, columns=columns, time={"column": "Zeit"}),
        ),
        Seed("csv", "lifetimes", ".csv", lives.encode(), _mapped(".csv", kind="lifetimes", columns=life, **table)),
        Seed(
            "csv",
            "frequency response",
            ".csv",
            sweep.encode(),
            _mapped(".csv", kind="frequency_response", columns=response, **table),
        ),
    ]


def excel() -> list[Seed]:
    """A workbook of two sheets with its texts in the cells; one with its lists behind the sheet; OpenDocument and the binary ones."""
    rows: list[list[Any]] = [["t", "F", "x"], *(list(map(float, row)) for row in zip(TIME, FORCE, TRAVEL, strict=True))]
    content = _made(lambda path: write_xlsx(path, {"run": rows, "notes": [["slow", 1]]}), ".xlsx")
    lines = [list(map(float, row)) for row in zip(TIME, FORCE, TRAVEL, strict=True)]
    header = ["t", "F", "x"]
    cells = {(r, c): cell for r, row in enumerate([header, *lines]) for c, cell in enumerate(row)}
    return [
        Seed("excel", "Excel 97", ".xls", write_xls({"run": cells}), _mapped(".xls")),
        Seed("excel", "binary", ".xlsb", write_xlsb({"run": cells}), _mapped(".xlsb")),
        Seed("excel", "workbook", ".xlsx", content, _mapped(".xlsx", excel={"sheet": "run"})),
        Seed("excel", "lists", ".xlsx", write_excel(header, lines, book_first=True), _mapped(".xlsx")),
        Seed(
            "excel", "OpenDocument", ".ods", write_open_document(header, lines), _mapped(".ods", excel={"sheet": "run"})
        ),
    ]


def matlab() -> list[Seed]:
    """Version 5, compressed and not, with a structure; version 7.3."""
    import h5py
    import scipy.io

    data = np.column_stack((TIME, FORCE, TRAVEL))
    columns = {
        "force": {"column": "run.data", "index": 1, "unit": "N"},
        "displacement": {"column": "run.data", "index": 2, "unit": "mm"},
    }
    clock = {"column": "run.data", "index": 0, "unit": "s"}
    mapping = _mapped(".mat", columns=columns, time=clock)
    seeds = []
    for compressed in (False, True):
        content = _made(
            lambda path, how=compressed: scipy.io.savemat(path, {"run": {"data": data}}, do_compression=how), ".mat"
        )
        seeds.append(Seed("matlab", f"v5{', compressed' if compressed else ''}", ".mat", content, mapping))

    def seven(path: Path) -> None:
        with h5py.File(path, "w", userblock_size=512) as file:
            file["run/data"] = data.T
        with path.open("r+b") as raw:
            raw.write(b"MATLAB 7.3 MAT-file")

    return [*seeds, Seed("matlab", "v7.3", ".mat", _made(seven, ".mat"), mapping)]


def hdf5() -> list[Seed]:
    """Contiguous and chunked, compressed datasets with units."""
    import h5py

    def write(path: Path) -> None:
        with h5py.File(path, "w") as file:
            file["rig/t"] = TIME
            file.create_dataset("rig/F", data=FORCE, chunks=(8,), compression="gzip", fletcher32=True)
            file["rig/x"] = TRAVEL
            file["rig/F"].attrs["unit"] = "N"

    return [Seed("hdf5", "groups", ".h5", _made(write, ".h5"), _mapped(".h5", hdf5={"root": "rig"}))]


def tdms() -> list[Seed]:
    """Two segments with waveform properties."""
    import nptdms

    def write(path: Path) -> None:
        about = {"wf_start_time": np.datetime64("2026-02-25T06:13:20"), "wf_increment": 0.01, "wf_start_offset": 0.0}
        with nptdms.TdmsWriter(path) as writer:
            for part in (slice(0, 12), slice(12, 24)):
                channels = {"F": (FORCE[part], "N"), "x": (TRAVEL[part], "mm")}
                writer.write_segment(
                    [
                        nptdms.ChannelObject("rig", name, values, properties={**about, "unit_string": unit})
                        for name, (values, unit) in channels.items()
                    ]
                )

    return [
        Seed("tdms", "waveforms", ".tdms", _made(write, ".tdms"), _mapped(".tdms", tdms={"group": "rig"}, time=None))
    ]


def uff() -> list[Seed]:
    """Two time responses, laid out in columns as the format says, and the same in binary numbers."""
    channels = (("F", "N", FORCE), ("x", "mm", TRAVEL))
    content = "".join(_data_set_58(name, unit, values) for name, unit, values in channels).encode()
    binary = b"".join(_binary_set_58(name, unit, values) for name, unit, values in channels)
    return [
        Seed("uff", "time responses", ".uff", content, _mapped(".uff", time=None)),
        Seed("uff", "binary", ".uff", binary, _mapped(".uff", time=None)),
    ]


def _binary_set_58(name: str, unit: str, values: Any) -> bytes:
    """The same set with its numbers as bytes, the mark of its end right behind them."""
    head = _data_set_58(name, unit, values).splitlines(keepends=True)[:13]
    head[1] = f"{58:6}b{1:6}{2:6}{11:12}{8 * len(values):12}{0:6}{0:6}{0:12}{0:12}\n"
    return "".join(head).encode() + values.astype("<f8").tobytes() + f"{-1:6}\n".encode()


def _data_set_58(name: str, unit: str, values: Any) -> str:
    nothing = f"{'NONE':<80}\n" * 4
    unused = f"{0:10}{0:5}{0:5}{0:5} {'NONE':<20} {'NONE':<20}\n"
    numbers = [f"{value:20.11e}" for value in values]
    lines = "\n".join("".join(numbers[at : at + 4]) for at in range(0, len(numbers), 4))
    return (
        f"{-1:6}\n{58:6}\n{name:<80}\n{nothing}"
        f"{1:5}{0:10}{0:5}{0:10} {'NONE':<10}{1:10}{1:4} {'NONE':<10}{1:10}{1:4}\n"
        f"{4:10}{len(values):10}{1:10}{0.0:13.5e}{0.01:13.5e}{0.0:13.5e}\n"
        f"{17:10}{0:5}{0:5}{0:5} {'Time':<20} {'s':<20}\n{13:10}{0:5}{0:5}{0:5} {name:<20} {unit:<20}\n"
        f"{unused}{unused}{lines}\n{-1:6}\n"
    )


def mdf() -> list[Seed]:
    """A group of two channels, of both versions; as asammdf saves it, and as a program writes it that measures."""
    import asammdf

    from tests.helpers.mdf_files import put_samples_last

    def save(path: Path) -> None:
        version = "4.10" if path.suffix == ".mf4" else "3.30"
        with asammdf.MDF(version=version) as file:
            file.start_time = datetime.fromisoformat(ABOUT["started_at"])
            channels = (("F", "N", FORCE), ("x", "mm", TRAVEL))
            file.append([asammdf.Signal(values, TIME, name=name, unit=unit) for name, unit, values in channels])
            file.save(path)

    def measure(path: Path) -> None:
        save(path)
        put_samples_last(path)

    return [
        Seed("mdf", f"{name}, {suffix[1:]}", suffix, _made(write, suffix), _mapped(suffix, time=None))
        for suffix in (".mf4", ".mdf")
        for name, write in (("saved", save), ("measured", measure))
    ]


def lvm() -> list[Seed]:
    """A LabVIEW measurement without a column of times, and one with it in German."""
    end = "***End_of_Header***"
    head = f"LabVIEW Measurement\nSeparator\tTab\nDecimal_Separator\t{{}}\nX_Columns\t{{}}\n{end}\n\n"
    part = f"Channels\t2\nSamples\t24\t24\nY_Unit_Label\tN\tmm\nX0\t0\t0\nDelta_X\t0.01\t0.01\n{end}\nX_Value\tF\tx\n"
    rows = list(zip(TIME, FORCE, TRAVEL, strict=True))
    plain = head.format(".", "No") + part + "".join(f"\t{f:.5f}\t{x:.5f}\n" for _, f, x in rows)
    german = (
        head.format(",", "One") + part + "".join(f"{t:.2f}\t{f:.5f}\t{x:.5f}\n" for t, f, x in rows).replace(".", ",")
    )
    return [
        Seed("lvm", "without times", ".lvm", plain.encode(), _mapped(".lvm", time=None)),
        Seed("lvm", "decimal comma", ".lvm", german.encode(), _mapped(".lvm", time={"column": "X_Value", "unit": "s"})),
    ]


def trios() -> list[Seed]:
    """Exports of two steps in both layouts."""
    rows = [f"{t:.2f}\t{f:.5f}\t{x:.5f}" for t, f, x in zip(TIME, FORCE, TRAVEL, strict=True)]
    plain = "Operator\tMira\n" + "".join(
        f"[step]\nPart {i}\nt\tF\tx\ns\tN\tmm\n" + "\n".join(part) + "\n\n"
        for i, part in enumerate((rows[:9], rows[9:]))
    )
    labelled = (
        "[Header]\n[Step]\nStep name\tHold\nNumber of points\t24\nVariables\tt\tF\tx\nUnits\ts\tN\tmm\n"
        + "".join(f"Data point\t{row}\n" for row in rows)
    )
    mapping = _mapped(".txt", format="trios")
    return [
        Seed("trios", name, ".txt", text.encode(), mapping) for name, text in (("plain", plain), ("labelled", labelled))
    ]


def arrow() -> list[Seed]:
    """A Parquet file of DuckDB; Feather with and without compression; a stream."""
    import duckdb
    import pyarrow as pa
    import pyarrow.feather as feather

    table = pa.table({"t": TIME, "F": FORCE, "x": TRAVEL, "note": ["ok", None] * 12})

    def parquet(path: Path) -> None:
        with duckdb.connect() as base:
            base.register("run", table)
            base.execute(f"COPY run TO '{path}' (FORMAT parquet, COMPRESSION snappy)")

    def stream(path: Path) -> None:
        with pa.OSFile(str(path), "wb") as file, pa.ipc.new_stream(file, table.schema) as writer:
            writer.write_table(table, max_chunksize=10)

    seeds = [Seed("arrow", "parquet", ".parquet", _made(parquet, ".parquet"), _mapped(".parquet"))]
    for how in ("lz4", "uncompressed"):
        content = _made(lambda path, how=how: feather.write_feather(table, path, compression=how), ".feather")
        seeds.append(Seed("arrow", f"feather, {how}", ".feather", content, _mapped(".feather")))
    return [*seeds, Seed("arrow", "stream", ".arrow", _made(stream, ".arrow"), _mapped(".arrow"))]


def numpy() -> list[Seed]:
    """A matrix alone; arrays in a compressed archive."""
    clock = {"column": "arr_0", "index": 0, "unit": "s"}
    columns = {
        "force": {"column": "arr_0", "index": 1, "unit": "N"},
        "displacement": {"column": "arr_0", "index": 2, "unit": "mm"},
    }
    matrix = _made(lambda path: np.save(path, np.column_stack((TIME, FORCE, TRAVEL))), ".npy")
    archive = _made(lambda path: np.savez_compressed(path, t=TIME, F=FORCE, x=TRAVEL), ".npz")
    return [
        Seed("numpy", "matrix", ".npy", matrix, _mapped(".npy", columns=columns, time=clock)),
        Seed("numpy", "archive", ".npz", archive, _mapped(".npz")),
    ]


def compressed() -> list[Seed]:
    """The plain text of `csv`, as each program compresses it."""
    import bz2
    import gzip
    import lzma
    import zipfile

    plain, *_ = csv()
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("run.csv", plain.content)
    contents = {
        ".csv.gz": gzip.compress(plain.content) + bytes(400),  # a last block that was filled up
        ".csv.bz2": bz2.compress(plain.content),
        ".csv.xz": lzma.compress(plain.content),
        ".csv.zip": stream.getvalue(),
    }
    return [
        Seed("compressed", suffix[5:], suffix, content, plain.mapping, sealed=WHOLE)
        for suffix, content in contents.items()
    ]


READERS: Mapping[str, Callable[[], list[Seed]]] = {
    "mcap": native_mcap,
    "mcap messages": message_mcap,
    "csv": csv,
    "excel": excel,
    "matlab": matlab,
    "hdf5": hdf5,
    "tdms": tdms,
    "mdf": mdf,
    "uff": uff,
    "lvm": lvm,
    "trios": trios,
    "arrow": arrow,
    "numpy": numpy,
    "compressed": compressed,
}
"""The seeds of each reader."""
