"""Text files with a lone quotation mark, or with blanks, comments or lines without end: read, or refused, in a moment."""

from __future__ import annotations

import contextlib
import time

import pytest

from ingest.csv_dialect import Dialect
from ingest.csv_reader import parse_csv
from schemas.errors import RefusedError

ROWS = b"1.0,2.0\n" * 100_000


@pytest.mark.parametrize(
    ("content", "dialect", "refusal"),
    [
        (b't,"F\n' + ROWS, Dialect(), "a quotation mark in the header is never closed"),
        (b't,F\n1.0,2.0\n"1.0,2.0\n' + ROWS, Dialect(), ""),
        (b"\n" * 2_000_000 + b"t,F\n" + ROWS[:80], Dialect(), ""),
        (b"# x\n" * 1_000_000, Dialect(), ""),
        (b"t," + b"(" * 200_000 + b"\n" + ROWS[:80], Dialect(), ""),
        (b"x" * 2_000_000 + b",F\n" + ROWS[:80], Dialect(), "a line is 2000003 bytes long"),
        (b"t,F\n1.0," + b"9" * 2_000_000 + b"\n" + ROWS[:80], Dialect(), "a line is 2000005 bytes long"),
        (b"t,F\n" + ROWS[:80] + b"1.0," + b"9" * 900_000, Dialect(), ""),
        (b";" * 5_000_000 + b"\n", Dialect(delimiter=";"), "a line is 5000001 bytes long"),
        (b"t F\n" + b" " * 400_000 + b"1.0 2.0\n3.0 4.0\n", Dialect(delimiter="whitespace"), ""),
    ],
)
def test_text_is_read_in_a_time_that_grows_with_its_length(content: bytes, dialect: Dialect, refusal: str) -> None:
    begin = time.process_time()
    with pytest.raises(RefusedError, match=refusal) if refusal else contextlib.nullcontext():
        parse_csv(content, dialect, where="run.csv")
    assert time.process_time() - begin < 5.0


@pytest.mark.parametrize("rows", [100, 20_000])
def test_a_lone_quotation_mark_costs_its_own_row(rows: int) -> None:
    content = b't,F\n1.0,2.0\n"1.5,2.0\n' + ROWS[: 8 * rows]
    found = parse_csv(content, Dialect(), where="run.csv")
    assert found.table.num_rows == rows + 1
    assert "1 rows do not have 2 fields" in found.problems[0]


def test_a_name_with_a_lone_quotation_mark_is_read_as_the_remedy_says() -> None:
    assert parse_csv(b't,"F\n1,2\n3,4\n', Dialect(quote=""), where="run.csv").names() == ("t", '"F')
