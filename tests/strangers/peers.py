"""The test files of other readers through ours, held against what those readers make of them: one line for each file.

python -m tests.strangers.peers [FOLDER…] [--table FILE]      files below these folders; without any: DEALAB_PEERS, and the test files of
                                               scipy, h5py and pandas where they are installed

Each column that our readers list is read and must equal the peer's values, or is refused by name; a file that our
reader refuses says why. Peers: scipy and mat73 for MATLAB, h5py for HDF5, nptdms, pyuff, and openpyxl, xlrd, pyxlsb and odfpy through
pandas for spreadsheets. Where a peer is not installed, its files are skipped and it is said so. The files are no part of this
repository: copy them from the peers' own repositories. What the last run found: `peers.md`.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import importlib.metadata
import importlib.util
import multiprocessing
import os
import resource
import sys
import warnings
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import date, datetime, time, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from ingest.arrays import ArrayFile
from ingest.columns import ColumnFile
from ingest.mapping import FileMapping, format_of_suffix
from ingest.mapping_keys import RECORDING
from ingest.read import open_columns
from schemas.errors import DealabError, MissingExtraError
from schemas.visible import shown
from tests.helpers.machine import today
from tests.strangers.peer_values import PeerValues, values_by_peer

EQUAL, REFUSED, WRONG, SKIPPED, DIFFERS = "equal", "refused", "WRONG", "skipped", "differs, explained"
_FORMATS = ("matlab", "hdf5", "tdms", "uff", "excel")
_ENGINES = {".xlsx": "openpyxl", ".xlsm": "openpyxl", ".xls": "xlrd", ".xlsb": "pyxlsb", ".ods": "odf"}
_MODULES = {"matlab": "scipy", "hdf5": "h5py", "tdms": "nptdms", "uff": "pyuff"}
_EPOCHS = (datetime(1899, 12, 30), datetime(1899, 12, 31), datetime(1904, 1, 1))
"""What spreadsheets count days from: since March 1900, before it, and on old Macintoshes."""
_MILLISECOND = 1.01e-3 / 86_400
"""In days."""
_EXPLAINED = {
    "biff5-rich-text-string.xls": "letters of a text without a code page",
    "covered.ods": "a cell that a merged one covers: odfpy leaves it out",
    "date.ods": "a time in microseconds: pandas keeps hundredths of a second",
    "encoded_entities.xlsx": "a cell of one line end: ours is empty",
    "has_x000D_.xlsx": "an escaped carriage return: openpyxl leaves it escaped",
    "has_x000D_inline.xlsx": "an escaped carriage return: openpyxl leaves it escaped",
    "shared_strings02.xlsx": "an escaped escape, `_x005F_`: openpyxl resolves it once too often",
    "shared_strings03.xlsx": "U+FFFE, which is no character: ours leaves its escape",
    "testfile16.mat": "the lines of a table of letters: mat73 takes its columns for lines",
    "minimal_package.xlsx": "blanks in front of texts: ours are without",
    "whitespace_trim.xlsx": "blanks in front of texts: ours are without",
    "issue_419.xlsb": "the text of a formula: pyxlsb gives 0",
}
"""Files on which the two readers differ in a way that is known, none of it in a number."""
_MEMORY = 3 << 30
"""Bytes that the readers of one file may take: some of the files are bombs."""
_SECONDS = 120
TABLE = Path(__file__).parent / "peers.md"
"""Where the last table is kept."""
_COLUMNS = 24
"""Columns of a matrix that are compared."""


def judge(path: Path) -> tuple[str, str]:
    """The verdict on one file, and what it rests on."""
    found = format_of_suffix(path.suffix) or ""
    peer = _ENGINES.get(path.suffix.lower(), "") if found == "excel" else _MODULES[found]
    if found == "matlab" and b"\x89HDF" in path.read_bytes()[:520]:
        peer = "mat73"
    if importlib.util.find_spec(peer) is None:
        return SKIPPED, f"the peer {peer} is not installed"
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            theirs: PeerValues | str = values_by_peer(path, found)
    except Exception as error:  # whatever a peer raises for its own damaged test files
        theirs = f"{peer}: {type(error).__name__}: {error}"
    if found == "excel":
        return _judge_sheets(path, theirs)
    try:
        file = open_columns(path, found, FileMapping(RECORDING, found, {}, None, {}, {}, {}))
    except MissingExtraError as error:
        return SKIPPED, str(error)
    except DealabError as error:
        return REFUSED, str(error) + (f" ({theirs})" if isinstance(theirs, str) else "")
    if isinstance(theirs, str):
        return (
            WRONG if file.names() else REFUSED
        ), f"the peer fails ({theirs}); ours reads {len(file.names())} columns"
    return _summary(_compared(file, theirs), file.problems)


def _summary(verdicts: list[tuple[str, str]], problems: tuple[str, ...] = ()) -> tuple[str, str]:
    wrong = [what for verdict, what in verdicts if verdict == WRONG]
    refused = Counter(what for verdict, what in verdicts if verdict == REFUSED)
    equal = sum(verdict == EQUAL for verdict, _ in verdicts)
    told = [f"{equal} columns equal"] if equal else []
    told += [f"{number} × {what}" if number > 1 else what for what, number in refused.most_common(4)]
    told += list(problems[:2])
    if wrong:
        return WRONG, f"{len(wrong)} of {len(verdicts)} columns: {'; '.join(wrong[:3])}"
    return (EQUAL if equal else REFUSED), "; ".join(told) or "no columns"


def _compared(file: ColumnFile, theirs: PeerValues) -> list[tuple[str, str]]:
    """A verdict on each column that one of the two readers has."""
    theirs = _aligned(theirs, file)
    positions = file.names() if isinstance(file, ArrayFile) or _is_unique(file.names()) else range(len(file.names()))
    verdicts = [verdict for name in positions for verdict in _column(file, name, theirs.arrays.get(name))]
    listed = file.held if isinstance(file, ArrayFile) else {str(p): p for p in positions}
    lacking = [name for name in theirs.arrays if str(name) not in listed]
    verdicts += [(WRONG, f"{name} is not listed") for name in lacking]
    if isinstance(file, ArrayFile):
        verdicts += [(REFUSED, f"{name} is {held.refusal}") for name, held in file.held.items() if held.refusal]
    return verdicts


def _aligned(theirs: PeerValues, file: ColumnFile) -> PeerValues:
    """The peer's values by our names: `raw.field.3` is `raw.3.field` of a structure array, `cell.0` its only element `cell`."""
    if not isinstance(file, ArrayFile):
        return theirs
    found = dict(theirs.arrays)
    read = {name for name, held in file.held.items() if not held.refusal}
    for key in (_parts, _parts_but_first):
        free = {key(name): name for name in file.held if name in read and name not in found}
        found = {name if name in read else free.get(key(str(name)), name): v for name, v in found.items()}
    return PeerValues(found)


def _parts(name: str) -> tuple[str, ...]:
    return tuple(sorted(name.split(".")))


def _parts_but_first(name: str) -> tuple[str, ...]:
    """Without the numbers of first elements: a lone one need not be counted."""
    return tuple(part for part in _parts(name) if part != "0")


def _is_unique(names: tuple[str, ...]) -> bool:
    return "" not in names and len(set(names)) == len(names)


def _column(file: ColumnFile, name: str | int, expected: Any) -> Iterator[tuple[str, str]]:
    if expected is None:
        yield WRONG, f"{name} is unknown to the peer"
        return
    array = np.asarray(expected)
    many = array.ndim == 2 and 1 not in array.shape
    for index in range(min(array.shape[1], _COLUMNS)) if many else (None,):
        wanted = array[:, index] if many else array.reshape(-1) if array.ndim < 3 else array
        try:
            if wanted.dtype.kind == "c" and wanted.ndim == 1:
                ours: Any = np.asarray(file.cells(name, index))
            elif wanted.dtype.kind in "biuf":
                ours = file.numbers(name, index).values
            else:
                yield _words(file, name, index, wanted)
                continue
        except DealabError as error:
            yield REFUSED, _without_names(error, name)
            continue
        same = ours.shape == wanted.shape and np.array_equal(ours, wanted.astype(ours.dtype), equal_nan=True)
        yield (EQUAL, "") if same else (WRONG, f"{name}: {ours.reshape(-1)[:3]} is not {wanted.reshape(-1)[:3]}")


def _words(file: ColumnFile, name: str | int, index: int | None, wanted: Any) -> tuple[str, str]:
    """Text and dates, as the cells that other columns of a table are chosen by."""
    try:
        ours = [_plain(cell) for cell in file.cells(name, index)]
    except DealabError as error:
        return REFUSED, _without_names(error, name)
    theirs = [_plain(cell) for cell in np.asarray(wanted).reshape(-1).tolist()]
    return (EQUAL, "") if ours == theirs else (WRONG, f"{name}: {ours[:3]} is not {theirs[:3]}")


def _without_names(error: DealabError, name: str | int) -> str:
    return error.problem.replace(f'"{name}"', "a column").replace(f"set {name} ", "a set ")


def _judge_sheets(path: Path, theirs: PeerValues | str) -> tuple[str, str]:
    """All sheets of a workbook, cell by cell."""
    from ingest.excel_reader import sheet_names, sheet_rows

    try:
        ours = {name: sheet_rows(path, name) for name in sheet_names(path)}
    except DealabError as error:
        return REFUSED, str(error) + (f" ({theirs})" if isinstance(theirs, str) else "")
    if isinstance(theirs, str):
        return REFUSED, f"the peer fails: {theirs[:150]}; ours reads {len(ours)} sheets"
    verdicts = []
    for name, wanted in theirs.sheets.items():
        if name not in ours:
            verdicts.append((WRONG, f"sheet {name} is not listed"))
            continue
        cells = {(r, c): _plain(v) for r, row in enumerate(ours[name]) for c, v in enumerate(row)}
        expected = {place: _plain(value) for place, value in wanted.items()}
        places = [p for p in {*cells, *expected} if not _alike(cells.get(p), expected.get(p))]
        first = min(places, default=(0, 0))
        verdicts.append(
            (WRONG, f"{name}: {len(places)} cells, {first}: {cells.get(first)!r} is not {expected.get(first)!r}")
            if places
            else (EQUAL, "")
        )
    return _summary(verdicts)


def _plain(cell: Any) -> Any:
    """A cell in one form: numbers as doubles, dates as text, nothing as None."""
    if isinstance(cell, np.ndarray) and cell.ndim == 0:
        cell = cell.item()
    if cell is None or cell == "" or (isinstance(cell, float) and cell != cell):
        return None
    if isinstance(cell, bool | np.bool_):
        return float(cell)
    if isinstance(cell, int | float | np.integer | np.floating):
        return float(cell)
    if isinstance(cell, datetime):
        return cell.replace(tzinfo=None).isoformat(timespec="milliseconds")
    if isinstance(cell, date):
        return datetime(cell.year, cell.month, cell.day).isoformat(timespec="milliseconds")
    if isinstance(cell, time):
        return timedelta(hours=cell.hour, minutes=cell.minute, seconds=cell.second, microseconds=cell.microsecond)
    if isinstance(cell, bytes):
        cell = cell.decode("utf-8", "replace")
    return str(cell).rstrip("\x00 ") or None if isinstance(cell, str) else cell


def _alike(ours: Any, theirs: Any) -> bool:
    if isinstance(ours, float) and isinstance(theirs, float):
        return bool(np.isclose(ours, theirs, rtol=1e-12, atol=0))
    if isinstance(ours, str | timedelta) and isinstance(theirs, float | str) and ours != theirs:
        days = [(_serial(ours, epoch), _serial(theirs, epoch)) for epoch in _EPOCHS]
        return any(a is not None and b is not None and abs(a - b) < _MILLISECOND for a, b in days)
    return bool(ours == theirs)


def _serial(cell: str | float | timedelta, epoch: datetime) -> float | None:
    """A date or duration as the number of days that a spreadsheet stores."""
    if isinstance(cell, float):
        return cell
    try:
        apart = cell if isinstance(cell, timedelta) else datetime.fromisoformat(cell) - epoch
    except ValueError:
        return None
    return apart / timedelta(days=1)


def in_child(path: Path) -> tuple[str, str]:
    """The verdict of a child process, which alone dies of a file that takes all memory or never ends."""
    context = multiprocessing.get_context("fork")
    ours, theirs = context.Pipe(duplex=False)
    child = context.Process(target=_answer, args=(path, theirs))
    child.start()
    theirs.close()
    try:
        if ours.poll(_SECONDS):
            return ours.recv()
    except EOFError:
        pass
    finally:
        child.kill()
        child.join()
    return WRONG, f"no answer within {_SECONDS} s, or a crash (exit status {child.exitcode})"


def _answer(path: Path, pipe: Any) -> None:
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
    try:
        verdict, what = judge(path)
    except Exception as error:  # a bug of ours: this is what the command is for
        verdict, what = WRONG, f"{type(error).__name__}: {error}"
    if verdict == WRONG and path.name in _EXPLAINED:
        verdict, what = DIFFERS, _EXPLAINED[path.name]
    pipe.send((verdict, what))


def files_below(folders: list[Path]) -> list[Path]:
    """The files that a binary reader is for, in the order of their names."""
    found = {
        path
        for folder in folders
        for path in folder.rglob("*")
        if format_of_suffix(path.suffix) in _FORMATS and path.is_file()
    }
    return sorted(found)


def known_folders() -> dict[str, Path]:
    """Where peers' test files may be: what the environment names, and packages that bring theirs."""
    found = {"DEALAB_PEERS": Path(os.environ["DEALAB_PEERS"])} if "DEALAB_PEERS" in os.environ else {}
    for package, place in (
        ("scipy", "io/matlab/tests/data"),
        ("h5py", "tests/data_files"),
        ("pandas", "tests/io/data"),
    ):
        spec = importlib.util.find_spec(package)
        if spec is not None and spec.origin is not None and (Path(spec.origin).parent / place).is_dir():
            found[package] = Path(spec.origin).parent / place
    return found


@dataclass(frozen=True)
class Judged:
    """The verdict on a file below a folder, and what it rests on."""

    folder: str
    path: Path
    verdict: str
    what: str


def table_of(judged: Sequence[Judged]) -> str:
    """All verdicts in Markdown: how many of each by folder and ending, then every file that is not simply equal."""
    verdicts = (EQUAL, REFUSED, DIFFERS, WRONG, SKIPPED)
    lines = [
        "# Test files of other readers, as those read them and as ours do",
        "",
        f"Made by `python -m tests.strangers.peers FOLDER… --table {TABLE.name}`, a folder for each repository; not edited by hand.",
        "",
        f"| repository | files | {' | '.join(verdicts)} |",
        f"|---|---|{'---:|' * len(verdicts)}",
    ]
    counts = Counter((one.folder, one.path.suffix.lower(), one.verdict) for one in judged)
    for folder, ending in sorted({(one.folder, one.path.suffix.lower()) for one in judged}):
        row = " | ".join(str(counts[folder, ending, verdict] or "") for verdict in verdicts)
        lines.append(f"| {folder.replace('+', '/')} | {ending} | {row} |")
    total = " | ".join(str(sum(one.verdict == verdict for one in judged) or "") for verdict in verdicts)
    lines += [f"| all | | {total} |", "", "Equal: all values that the peer reads are ours, arrays to the last bit and numbers in sheets within 1e-12; columns of such a file that are refused by name are not counted here."]  # fmt: skip
    lines += ["", "| file | verdict | why |", "|---|---|---|"]
    for one in judged:
        if one.verdict != EQUAL:
            # Messages of readers may hold folders of this machine.
            why = shown(one.what.replace(str(one.path), one.path.name))[:200].replace("|", "/")
            lines.append(f"| {one.path.name} | {one.verdict} | {why} |")
    return "\n".join([*lines, "", f"{today()} · {', '.join(_versions())}", ""])


def _versions() -> Iterator[str]:
    for name in ("scipy", "mat73", "h5py", "npTDMS", "pyuff", "openpyxl", "xlrd", "pyxlsb", "odfpy"):
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            yield f"{name} {importlib.metadata.version(name)}"


def main(arguments: list[str]) -> int:
    """One line for each file; 1 where one is wrong."""
    parser = argparse.ArgumentParser(prog="python -m tests.strangers.peers", description=__doc__)
    parser.add_argument("folders", nargs="*", type=Path, metavar="FOLDER")
    parser.add_argument("--table", type=Path, metavar="FILE", help="also write all verdicts as Markdown")
    folders: Mapping[str, Path] = known_folders()
    options = parser.parse_args(arguments)
    given = options.folders or list(folders.values())
    if "DEALAB_PEERS" not in folders and not options.folders:
        print(f"{SKIPPED}: DEALAB_PEERS names no folder: UFF, TDMS, HDF5 and spreadsheets of peers are not looked at")
    # Once here, not once in each child.
    for module in ("pandas", *_ENGINES.values(), *_MODULES.values(), "scipy.io", "mat73", "python_calamine"):
        with contextlib.suppress(ImportError):
            importlib.import_module(module)
    judged: list[Judged] = []
    for folder in given:
        for path in files_below([folder]):
            one = Judged(folder.name, path, *in_child(path))
            judged.append(one)
            print(f"{path.name:<48} {one.verdict}{': ' if one.what else ''}{shown(one.what)[:260]}", flush=True)
    counts = Counter(one.verdict for one in judged)
    print(", ".join(f"{number} {verdict}" for verdict, number in sorted(counts.items())) or "no files")
    if options.table:
        options.table.write_text(table_of(judged), encoding="utf-8")
    return 1 if counts[WRONG] else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
