"""Foreign files through the night: our own small ones, and a larger corpus where it is (`DEALAB_STRANGERS`)."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tests.strangers.check import OK, WRONG, cases_in, judge

HERE = Path(__file__).resolve().parent
CORPUS = Path(os.environ.get("DEALAB_STRANGERS", HERE.parents[2] / "shared" / "strangers"))


@pytest.mark.long_after(1)
@pytest.mark.parametrize("case", cases_in(HERE / "files"), ids=lambda case: case.name)
def test_own_files_come_out_as_they_must(case: Path) -> None:
    verdict, what = judge(case)
    assert verdict == OK, what


@pytest.mark.parametrize("case", cases_in(CORPUS) if CORPUS.is_dir() else [], ids=lambda case: case.name)
def test_files_of_strangers_come_out_as_they_must(case: Path) -> None:
    verdict, what = judge(case, results=False)
    assert verdict != WRONG, what
