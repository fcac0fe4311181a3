"""What is installed is pinned, with hashes, for every supported Python."""

from __future__ import annotations

import re
import tomllib

import pytest

from tests.conftest import ROOT

SUPPORTED = re.search(r"^SUPPORTED := (.*)$", (ROOT / "Makefile").read_text(encoding="utf-8"), re.M)[1].split()  # type: ignore[index]
INPUTS = {"runtime": ("requirements.txt",), "development": ("requirements.txt", "requirements-dev.txt")}


def pins(text: str) -> dict[str, str]:
    """Name to version."""
    found = re.findall(r"^([A-Za-z0-9._-]+)(?:\[[a-z0-9,]+\])?==([^\s;\\]+)", text, re.M)
    return {re.sub(r"[-_.]+", "-", name).lower(): version for name, version in found}


@pytest.mark.parametrize("version", SUPPORTED)
@pytest.mark.parametrize("kind", list(INPUTS))
def test_hashed_files_hold_the_pinned_versions(kind: str, version: str) -> None:
    text = (ROOT / "requirements" / f"{kind}-{version}.txt").read_text(encoding="utf-8")
    entries = re.split(r"\n(?=\S)", text.strip())
    assert all("--hash=sha256:" in entry for entry in entries)
    assert "://" not in text, "no address of an index, no package from elsewhere"
    hashed = pins(text)
    for name in INPUTS[kind]:
        wanted = pins((ROOT / name).read_text(encoding="utf-8"))
        assert wanted.items() <= hashed.items(), "`make pins` was forgotten"
    if kind == "runtime":
        assert hashed == pins((ROOT / "requirements.txt").read_text(encoding="utf-8")), (
            "all of it is in requirements.txt"
        )


def test_what_the_project_asks_for_is_pinned() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    asked = {re.split(r"[><=]", name)[0].replace("_", "-").lower() for name in project["dependencies"]}
    assert asked <= pins((ROOT / "requirements.txt").read_text(encoding="utf-8")).keys()


@pytest.mark.parametrize("name", ["release", "site"])
def test_tools_of_their_own_environments_are_pinned_beside_our_versions(name: str) -> None:
    """With what dealab itself is built by and runs with at the same versions, so that what is tried is what is given away."""
    text = (ROOT / "requirements" / f"{name}.txt").read_text(encoding="utf-8")
    assert all("--hash=sha256:" in entry for entry in re.split(r"\n(?=\S)", text.strip()))
    assert "://" not in text
    pinned, ours = pins(text), pins((ROOT / "requirements.txt").read_text(encoding="utf-8"))
    asked = (ROOT / "requirements" / f"{name}.in").read_text(encoding="utf-8")
    assert pins(asked).items() <= pinned.items(), "`make pins` was forgotten"
    assert {n: v for n, v in pinned.items() if n in ours}.items() <= ours.items()
    assert name == "release" or ours.items() <= pinned.items()
