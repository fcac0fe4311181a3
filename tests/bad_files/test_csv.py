"""One defect per text file, each with the words a person needs to mend it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from ingest.canonical import canonical
from ingest.mapping import find_mapping
from ingest.read import read_raw
from schemas.errors import DealabError, RefusedError, UnmappedError
from schemas.recording import RawRecording, Recording

TOML = """
[csv]
delimiter = ";"
decimal = ","
unit_row = true
[time]
column = "t"
unit = "s"
[columns.displacement]
column = "x"
unit = "mm"
[columns.force]
column = "F"
unit = "N"
[recording]
recording_id = "{stem}"
protocol = "cyclic"
loading = "mechanical"
specimen_id = "s1"
started_at = "2026-03-01T14:00:00+00:00"
[rig]
load_cell_range_n = 2.0
"""
ROWS = [f"{i / 100:.2f};{np.sin(i / 5):.5f};{np.cos(i / 5):.5f}".replace(".", ",") for i in range(60)]
HEAD = "t;x;F\ns;mm;N\n"
GOOD = HEAD + "\n".join(ROWS) + "\n"


def take(tmp_path: Path, content: bytes, toml: str = TOML) -> Recording:
    path = tmp_path / "run.csv"
    path.write_bytes(content)
    (tmp_path / "run.csv.toml").write_text(toml, encoding="utf-8")
    raw = read_raw(path, find_mapping(path))
    assert isinstance(raw, RawRecording)
    return canonical(raw, where=path.name)


def test_the_good_file_is_good(tmp_path: Path) -> None:
    found = take(tmp_path, GOOD.encode())
    assert found.status == "ok"
    assert not found.notes
    assert found.channels["force"].values[:2] == pytest.approx([1.0, 0.98007])


@dataclass(frozen=True)
class Defect:
    """A change to the good file or its mapping and the words its refusal must hold."""

    words: tuple[str, ...]
    content: str = GOOD
    toml: str = TOML
    raw: bytes | None = None


def with_row(row: str) -> str:
    return GOOD.replace(ROWS[30], row)


REFUSED = {
    "empty": Defect(("empty",), raw=b""),
    "only nulls": Defect(("empty",), raw=bytes(4096)),
    "header alone": Defect(("no rows of data",), HEAD),
    "wrong delimiter": Defect(('"t"', "not in the file", '"t;x;F"'), toml=TOML.replace('";"', '"|"')),
    "decimal point": Defect(('decimal mark ","',), GOOD.replace(",", ".")),
    "thousands": Defect(('holds "1.234"', "thousands"), with_row("0,30;1.234;0,5")),
    "unit row contradicts": Defect(('"m"', '"mm"', "displacement"), GOOD.replace("s;mm;N", "s;m;N")),
    "unit of wrong dimension": Defect(
        ('"V"', "force", "converts to N"), GOOD.replace("mm;N", "mm;V"), TOML.replace('unit = "N"', 'unit = "V"')
    ),
    "column gone": Defect(('"F"', '"t", "x", "G"'), GOOD.replace("t;x;F", "t;x;G")),
    "text column": Defect(("force", "no numbers", "abc"), HEAD + "".join(f"{i};{i};abc\n" for i in range(9))),
    "backwards": Defect(("runs backwards", "sample"), HEAD + "\n".join(ROWS[30:] + ROWS[:30]) + "\n"),
    "dead load cell": Defect(("force is 0.5 N", "not connected"), HEAD + "".join(f"{i};{i};0,5\n" for i in range(9))),
    "beyond the load cell": Defect(("force", "range", "2 N"), HEAD + "".join(f"{i};{i};{i + 500}\n" for i in range(9))),
    "no zone": Defect(("started_at", "zone"), toml=TOML.replace("+00:00", "")),
    "no protocol": Defect(("protocol is missing",), toml=TOML.replace('protocol = "cyclic"', "")),
    "id that leaves the folder": Defect(("recording_id", "../../x"), toml=TOML.replace("{stem}", "../../x")),
    "utf-16": Defect(("UTF-16",), raw=GOOD.encode("utf-16")),
    "all lost": Defect(("force", "none of its 9 samples"), HEAD + "".join(f"{i};{i};\n" for i in range(9))),
    "most rows short": Defect(("do not have 3 fields",), HEAD + "1;2;3\n" + "1;2\n" * 9),
}


@pytest.mark.parametrize("name", list(REFUSED))
def test_refused(tmp_path: Path, name: str) -> None:
    defect = REFUSED[name]
    with pytest.raises(RefusedError) as refused:
        take(tmp_path, defect.content.encode() if defect.raw is None else defect.raw, defect.toml)
    for word in defect.words:
        assert word in str(refused.value)
    assert refused.value.where


DAMAGED = {
    "cut in a number": Defect(("last",), GOOD[:-3]),
    "cut in a row": Defect(("middle of a line",), GOOD[:-12]),
    "text cell": Defect(("OVLD",), with_row("0,30;0,5;OVLD")),
    "empty cell": Defect(("1 of 60 samples",), with_row("0,30;;0,5")),
    "short row": Defect(("1 rows",), with_row("0,30;0,5")),
    "row without time": Defect(("no time",), with_row(";0,5;0,5")),
    "spike beyond the range": Defect(("load cell's range", "7.5 N"), with_row("0,30;0,5;7,5")),
    "infinite": Defect(("1 of 60 samples",), with_row("0,30;inf;0,5")),
    "instant with two values": Defect(("two values",), GOOD.replace(ROWS[31], ROWS[30].replace(";0", ";1", 1))),
}


@pytest.mark.parametrize("name", list(DAMAGED))
def test_damaged(tmp_path: Path, name: str) -> None:
    defect = DAMAGED[name]
    found = take(tmp_path, defect.content.encode(), defect.toml)
    assert found.status == "damaged"
    for word in defect.words:
        assert any(word in problem for problem in found.problems), found.problems
    assert all(c.values.size >= 59 for c in found.channels.values())


def test_without_mapping_it_is_unmapped(tmp_path: Path) -> None:
    (tmp_path / "run.csv").write_text(GOOD)
    with pytest.raises(UnmappedError, match="no mapping"):
        read_raw(tmp_path / "run.csv", find_mapping(tmp_path / "run.csv"))


def test_every_cut_is_noticed_or_refused(tmp_path: Path) -> None:
    whole = take(tmp_path, GOOD.encode())
    for end in range(len(GOOD) - 1, len(GOOD) - 80, -1):
        found = take(tmp_path, GOOD[:end].encode())
        if GOOD[end - 1] == "\n":
            continue  # a cut between two lines leaves no trace
        only_line_end_missing = GOOD[end] == "\n"
        assert found.status == ("ok" if only_line_end_missing else "damaged"), GOOD[:end][-40:]
        values = found.channels["force"].values
        assert np.array_equal(values, whole.channels["force"].values[: values.size])


def test_random_damage_never_escapes(tmp_path: Path) -> None:
    rng = np.random.default_rng(11)
    outcomes = set()
    for _ in range(100):
        content = bytearray(GOOD.encode())
        for place in rng.integers(0, len(content), rng.integers(1, 20)):
            content[place] = rng.integers(256)
        try:
            outcomes.add(take(tmp_path, bytes(content)).status)
        except DealabError as refused:
            outcomes.add(type(refused).__name__)
    assert {"damaged", "RefusedError"} <= outcomes
