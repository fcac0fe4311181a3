"""The labs whose reports the tests look at."""

from __future__ import annotations

from pathlib import Path

import pytest

from reports.build import build_reports
from tests.helpers import synthetic_lab


@pytest.fixture(scope="session")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A lab with findings of every kind, its report built."""
    folder = synthetic_lab.whole_story().write(tmp_path_factory.mktemp("whole") / "lab")
    build_reports(folder)
    return folder


@pytest.fixture(scope="session")
def site(lab: Path) -> Path:
    """The report of that lab."""
    return lab / "reports"
