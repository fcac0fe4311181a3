"""Fixtures shared by all parts."""

from __future__ import annotations

import os
from collections import Counter
from pathlib import Path

import pytest
from hypothesis import settings

ROOT = Path(__file__).resolve().parent.parent

# One thread of linear algebra in each process, as the nightly's workers have: several processes with two each wait for
# each other, and sums in another order move borderline figures. Before numpy is imported, which reads it once.
for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")

# No deadline: a loaded machine is slow, which is no failure. The same cases every time, so that a change is judged by
# what it changes; `make fuzz` draws new ones with DEALAB_HYPOTHESIS=new.
settings.register_profile("same", deadline=None, derandomize=True)
settings.register_profile("new", deadline=None, derandomize=False, print_blob=True)
settings.load_profile(os.environ.get("DEALAB_HYPOTHESIS", "same"))


_QUICK = {"unit", "readers", "physics"}
"""Folders whose tests are quick unless they are marked `slow`, `study` or `long`."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Every test has the name of its folder as a marker, `quick` where it is quick, and `long` after the first cases of a test that says
    so; see `pyproject.toml`."""
    cases: Counter[str] = Counter()
    for item in items:
        after = item.get_closest_marker("long_after")
        if after is not None:
            name = item.nodeid.partition("[")[0]
            cases[name] += 1
            if cases[name] > after.args[0]:
                item.add_marker("long")
        folder = item.path.relative_to(ROOT / "tests").parts[0]
        item.add_marker(folder)
        if folder in _QUICK and not any(item.get_closest_marker(name) for name in ("slow", "study", "long")):
            item.add_marker("quick")


@pytest.fixture(scope="session")
def real_data() -> Path:
    """Folder of public measured data; the test is skipped where it is absent."""
    folder = Path(os.environ.get("DEALAB_REAL_DATA", ROOT.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"DEALAB_REAL_DATA: no folder {folder}")
    return folder
