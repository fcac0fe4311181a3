"""A page that cannot be made is told, stands in its place with a sentence, and is made again; all others are there."""

from __future__ import annotations

from pathlib import Path

import pytest

from reports import plan
from reports.blocks import Page
from reports.build import build_reports
from reports.site import Site
from tests.helpers import synthetic_lab


@pytest.mark.long
def test_one_page_fails_and_all_others_are_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lab = synthetic_lab.small_story().write(tmp_path / "lab")
    whole = build_reports(lab)
    assert not whole.problems
    (lab / "reports" / "manifest.json").unlink(missing_ok=True)
    made = plan._ABOUT["campaign"]

    def fail(site: Site, item: str) -> Page:
        raise ZeroDivisionError("float division by zero")

    monkeypatch.setitem(plan._ABOUT, "campaign", fail)
    found = build_reports(lab, force=True)
    assert found.pages_written == whole.pages_written
    assert found.problems
    assert all(path.startswith("campaigns/") for path in found.problems)
    told = found.describe_problems()
    assert told is not None
    assert "ZeroDivisionError" in told
    (path, *_) = found.problems
    assert "this page could not be made" in (lab / "reports" / path).read_text(encoding="utf-8")
    # Nothing but the page that failed is made again.
    monkeypatch.setitem(plan._ABOUT, "campaign", made)
    again = build_reports(lab)
    assert (again.pages_written, again.problems) == (len(found.problems), {})
    assert "this page could not be made" not in (lab / "reports" / path).read_text(encoding="utf-8")
