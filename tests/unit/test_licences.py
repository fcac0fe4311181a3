"""The list of licences: whose they are, and that it is of the versions that are pinned."""

from __future__ import annotations

import re
from email.message import Message

import pytest

from tests.conftest import ROOT
from tests.tools.licences import ALWAYS, DOCUMENT, find_needed, read_licence
from tests.unit.test_requirements import pins

TEXT = (ROOT / DOCUMENT).read_text(encoding="utf-8")
ROWS = {row[0]: row for row in re.findall(r"^\| ([\w.-]+) \| (\S+) \| ([^|]+) \| ([^|]+) \|$", TEXT, re.MULTILINE)}


def test_all_that_is_imported_is_listed_at_the_pinned_version() -> None:
    """That licences and reasons are today's is held with the other generated parts, in `test_readme.py`."""
    pinned = pins((ROOT / "requirements" / "development-3.11.txt").read_text(encoding="utf-8"))
    assert {name: row[1] for name, row in ROWS.items() if name != "library"} == {
        name: pinned[name] for name in find_needed()
    }


def test_libraries_are_asked_for_by_dealab_by_others_and_by_extras() -> None:
    needed = find_needed()
    assert ALWAYS in needed["numpy"]
    assert ALWAYS in needed["six"], "pandas asks for dateutil, which asks for it"
    assert needed["nptdms"] == {"tdms"}
    assert needed["dask"] == {"cluster"}
    assert not {"pytest", "hatchling", "ruff"} & needed.keys()


def test_none_is_without_a_licence_and_the_lgpl_is_named() -> None:
    assert [name for name, row in ROWS.items() if row[2] == "not said"] == []
    weak = {name for name, row in ROWS.items() if "GPL" in row[2]}
    named = re.search(r"^Under the LGPL: ([^.]*)\.", TEXT, re.MULTILINE)
    assert named is not None
    assert set(named[1].split(", ")) == weak


@pytest.mark.parametrize(
    ("fields", "licence"),
    [
        ([("License-Expression", "MIT"), ("Classifier", "License :: OSI Approved :: BSD License")], "MIT"),
        ([("License", "Long text"), ("Classifier", "License :: OSI Approved :: BSD License")], "BSD License"),
        ([("Classifier", "License :: OSI Approved"), ("License", "BSD 3\n\nRedistribution …")], "BSD 3"),
        ([("Classifier", "Topic :: Science")], "not said"),
    ],
)
def test_a_licence_is_read_from_whatever_says_it(fields: list[tuple[str, str]], licence: str) -> None:
    about = Message()
    for name, value in fields:
        about[name] = value
    assert read_licence(about) == licence  # type: ignore[arg-type]
