"""The forms for issues are valid, ask by commands that there are, and ask for nothing private."""

from __future__ import annotations

import re
import shlex
from typing import Any

import pytest
import yaml

from pipeline.cli import main
from tests.conftest import ROOT

FOLDER = ROOT / ".github" / "ISSUE_TEMPLATE"
FORMS = sorted(path for path in FOLDER.glob("*.yml") if path.name != "config.yml")
ATTRIBUTES = {
    "markdown": {"value"},
    "input": {"label", "description", "placeholder", "value"},
    "textarea": {"label", "description", "placeholder", "value", "render"},
    "dropdown": {"label", "description", "options", "multiple", "default"},
    "checkboxes": {"label", "description", "options"},
}
"""Kinds of fields that a form may have, with what each may say."""


def read(path: Any) -> dict[str, Any]:
    found: dict[str, Any] = yaml.safe_load(path.read_text(encoding="utf-8"))
    return found


def test_there_is_a_form_for_each_kind_of_issue() -> None:
    assert [path.stem for path in FORMS] == ["diagnosis", "file", "question"]
    assert set(read(FOLDER / "config.yml")) == {"blank_issues_enabled"}


@pytest.mark.parametrize("path", FORMS, ids=lambda path: path.stem)
def test_a_form_is_one_that_a_forge_shows(path: Any) -> None:
    form = read(path)
    assert {"name", "description", "body"} <= set(form) <= {"name", "description", "title", "labels", "body"}
    fields = [field for field in form["body"] if field["type"] != "markdown"]
    ids = [field["id"] for field in fields]
    assert len(set(ids)) == len(ids) > 0
    assert all(re.fullmatch(r"[\w-]+", name) for name in ids)
    for field in form["body"]:
        assert set(field) <= {"type", "id", "attributes", "validations"}
        assert set(field["attributes"]) <= ATTRIBUTES[field["type"]]
        assert set(field.get("validations", {})) <= {"required"}
        assert all(isinstance(text, str) and text for key, text in field["attributes"].items() if key != "options")
        for option in field["attributes"].get("options", []):
            assert isinstance(option, dict if field["type"] == "checkboxes" else str)
    assert all("label" in field["attributes"] for field in fields)
    assert any(field.get("validations", {}).get("required") for field in fields)
    assert form["body"][0]["type"] == "markdown"
    assert "names of people" in form["body"][0]["attributes"]["value"]


@pytest.mark.parametrize("path", FORMS, ids=lambda path: path.stem)
def test_what_is_asked_for_are_commands_of_dealab(path: Any, capsys: pytest.CaptureFixture[str]) -> None:
    asked = re.findall(r"`(dealab [^`]+)`", path.read_text(encoding="utf-8"))
    assert any(line.startswith("dealab doctor") for line in asked)
    for line in asked:
        words = shlex.split(line)[1:]
        with pytest.raises(SystemExit) as ended:
            main(words if words == ["--version"] else [words[0], "--help"])
        assert ended.value.code == 0
        shown = capsys.readouterr().out
        assert all(word in shown for word in words if word.startswith("--") and word != "--version")
