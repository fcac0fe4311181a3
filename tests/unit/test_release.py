"""What is given away: the wheel holds what runs and nothing else, and what `make release-check` asks is what the documents show."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

from ingest.inspect import FITS
from tests.conftest import ROOT
from tests.tools import release


@pytest.fixture(scope="module")
def files() -> frozenset[str]:
    if not (ROOT / ".git").exists() or shutil.which("git") is None:
        pytest.skip("the project is not under git here: nothing else says which files are its own")
    return release.list_files(ROOT)


@pytest.mark.slow
def test_the_wheel_holds_what_runs_and_nothing_else(files: frozenset[str], tmp_path: Path) -> None:
    words = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", tmp_path]
    subprocess.run(words, cwd=ROOT, check=True, capture_output=True)
    (wheel,) = tmp_path.iterdir()
    # what somebody works on beside git's files is no fault of the wheel's
    found = frozenset(name for name in release.list_wheel(wheel) if name in files or not (ROOT / name).exists())
    assert release.compare("wheel", found, frozenset(filter(release.runs, files)))[0]
    assert wheel.name in release.commands_of_the_rig()[-1]


def test_what_is_not_code_and_runs_is_to_be_in_the_wheel(files: frozenset[str]) -> None:
    inside = set(filter(release.runs, files))
    assert {"reports/style.css", "reports/templates/page.html.j2", "pipeline/simulate/campaigns/first.toml"} < inside
    assert {"schemas/published/mapping.schema.json", "reports/interactive.js", "dealab.py"} < inside
    assert not {
        name for name in inside if name.startswith(("tests/", ".github/")) or name.endswith((".ipynb", ".md", ".png"))
    }


def test_what_is_missing_and_what_is_too_much_is_named(tmp_path: Path) -> None:
    wheel = tmp_path / "a.whl"
    with zipfile.ZipFile(wheel, "w") as archive:
        for name in ("schemas/units.py", "tests/spare.py", "dealab-1.dist-info/METADATA"):
            archive.writestr(name, "")
    found = release.list_wheel(wheel)
    assert release.compare("wheel", found, found)[0]
    assert release.compare("wheel", found, frozenset({"schemas/units.py", "dealab.py"})) == (
        False,
        "wheel: 1 missing: dealab.py; 1 too much: tests/spare.py",
    )


def test_a_python_without_hashes_of_its_own_gets_the_pinned_versions() -> None:
    assert release.pins("3.12")[0] == "--require-hashes"
    assert release.pins("3.99") == ["--requirement", str(ROOT / "requirements.txt")]
    assert all(Path(release.pins(version)[-1]).is_file() for version in ("3.12", "3.99"))


def test_the_verdict_that_is_waited_for_is_that_of_inspect() -> None:
    assert release.FITS == FITS


def test_the_rig_installs_what_the_writer_needs_and_no_more() -> None:
    environment, libraries, ours = release.commands_of_the_rig()
    assert environment == "python3 -m venv rig"
    asked = libraries.removeprefix("rig/bin/pip install ").split()
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert set(asked) <= {name.partition(">")[0] for name in project["dependencies"]}
    assert "--no-deps" in ours
    assert f"dealab-{project['version']}-" in ours
