"""The code version of a stage covers what it imports, and nothing else."""

from __future__ import annotations

import pytest

from pipeline.lab.journal import Freshness
from pipeline.lab.settings import Settings
from pipeline.nightly.freshness import _closure, code_version, digest, digest_of_lists
from pipeline.nightly.stages import MODULES


def names(module: str) -> set[str]:
    return {"/".join(path.parts[-2:]) for path in _closure(module)}


def test_a_stage_depends_on_what_it_imports_also_inside_functions() -> None:
    recording = names(MODULES["recording"])
    assert {"transform/chirp.py", "ingest/mcap_reader.py", "ingest/canonical.py", "schemas/units.py"} <= recording
    assert {"relaxation/identify.py", "transform/correction.py", "schemas/units.py"} <= names(MODULES["specimen"])
    assert "survival/kaplan_meier.py" in names(MODULES["group"])
    assert {"diagnose/diagnosis.py", "simulation/simulation.py"} <= names(MODULES["diagnosis"])
    assert not {name for name in recording if name.startswith("survival/")}, "lives are counted, not read again"


@pytest.mark.parametrize("stage", ["recording", "specimen", "group"])
def test_a_change_of_how_causes_are_found_repeats_the_diagnosis_alone(stage: str) -> None:
    assert not {"diagnose/diagnosis.py", "simulation/simulation.py", "search/plain.py"} & names(MODULES[stage])


def test_no_stage_depends_on_publishing_queries_pages_or_the_command_line() -> None:
    for module in MODULES.values():
        apart = {"lab/snapshot.py", "lab/query.py", "pipeline/cli.py", "nightly/night.py", "reports/build.py"}
        assert not names(module) & apart
        assert not any(name.startswith("reports/") for name in names(module))


def test_versions_differ_between_stages() -> None:
    assert len({code_version(module) for module in MODULES.values()}) == len(MODULES)


def test_what_differs_is_named() -> None:
    old = Freshness("a", "b", "c")
    assert old.differences(Freshness("a", "b", "c")) == ()
    assert old.differences(Freshness("x", "b", "y")) == ("input", "settings")
    assert old.differences(Freshness("a", "y", "c")) == ("code",)


def test_settings_count_where_they_are_used() -> None:
    usual, other = Settings(), Settings(orders=(1,), deadline_s=1)
    assert usual.of_stage("recording") == other.of_stage("recording") == {}
    assert digest(usual.of_stage("specimen")) != digest(other.of_stage("specimen"))
    assert digest({"a": 1, "b": 2}) == digest({"b": 2, "a": 1})


def test_a_digest_of_lists_is_that_of_the_whole() -> None:
    for whole in ([], [[]], [[["a", 'é"\n']], []], [[["a", "b"], ["c", "d"]], [["e", "f"]]]):
        assert digest_of_lists(iter([iter(part) for part in whole])) == digest(whole)
