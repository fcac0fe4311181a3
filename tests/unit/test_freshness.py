"""The code version of a stage covers what it imports, and nothing else."""

from __future__ import annotations

import ast
import importlib

import pytest

from pipeline.lab.journal import Freshness
from pipeline.lab.settings import Settings
from pipeline.nightly.freshness import digest, digest_lists, find_sources, hash_code
from pipeline.nightly.stages import STAGES
from tests.conftest import ROOT


def names(stage: str) -> set[str]:
    """The last folder and the name of every file in the code version of a stage."""
    return {"/".join(path.parts[-2:]) for path in find_sources(STAGES[stage].modules)}


def imports_within_functions(path: str, function: str) -> set[str]:
    """Modules of ours that a function imports when it is called, which workers do."""
    tree = ast.parse((ROOT / path).read_text(encoding="utf-8"))
    found = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef) and node.name == function]
    assert found, f"{path} has no function {function}"
    imports = (node for part in found for node in ast.walk(part) if isinstance(node, ast.ImportFrom))
    return {node.module for node in imports if node.module is not None}


def test_a_stage_depends_on_what_it_imports_also_inside_functions() -> None:
    recording = names("recording")
    assert {"transform/chirp.py", "ingest/mcap_reader.py", "ingest/canonical.py", "schemas/units.py"} <= recording
    assert {"relaxation/identify.py", "transform/correction.py", "schemas/units.py"} <= names("specimen")
    assert "survival/kaplan_meier.py" in names("group")
    assert {"diagnose/diagnosis.py", "simulation/simulation.py"} <= names("diagnosis")
    assert not {name for name in recording if name.startswith("survival/")}, "lives are counted, not read again"


@pytest.mark.parametrize(
    ("stage", "path", "functions"),
    [
        ("recording", "pipeline/nightly/read.py", ("perform", "_read")),
        ("specimen", "pipeline/nightly/derive.py", ("_analyse_specimen",)),
        ("diagnosis", "pipeline/nightly/derive.py", ("_analyse_diagnosis",)),
        ("group", "pipeline/nightly/derive.py", ("_analyse_group",)),
    ],
)
def test_what_a_worker_computes_with_is_what_the_stage_depends_on(
    stage: str, path: str, functions: tuple[str, ...]
) -> None:
    used = set().union(*(imports_within_functions(path, function) for function in functions))
    assert used == set(STAGES[stage].modules) - {"pipeline.lab.inputs"}, "which the night itself imports"


def test_every_module_of_a_stage_is_there() -> None:
    for stage in STAGES.values():
        for module in stage.modules:
            importlib.import_module(module)


@pytest.mark.parametrize("stage", ["recording", "specimen", "group"])
def test_a_change_of_how_causes_are_found_repeats_the_diagnosis_alone(stage: str) -> None:
    assert not {"diagnose/diagnosis.py", "simulation/simulation.py", "search/plain.py"} & names(stage)


@pytest.mark.parametrize("stage", STAGES)
def test_no_stage_depends_on_the_night_on_publishing_queries_pages_or_the_command_line(stage: str) -> None:
    apart = {"lab/snapshot.py", "lab/query.py", "pipeline/cli.py", "reports/build.py"}
    assert not names(stage) & apart
    assert not any(name.startswith(("reports/", "nightly/", "commands/")) for name in names(stage))


def test_reading_a_recording_does_not_depend_on_what_a_lab_is_on_disk() -> None:
    assert not any(name.startswith("lab/") for name in names("recording"))


def test_versions_differ_between_stages() -> None:
    assert len({hash_code(stage.modules) for stage in STAGES.values()}) == len(STAGES)


def test_what_differs_is_named() -> None:
    old = Freshness("a", "b", "c")
    assert old.differences(Freshness("a", "b", "c")) == ()
    assert old.differences(Freshness("x", "b", "y")) == ("input", "settings")
    assert old.differences(Freshness("a", "y", "c")) == ("code",)


def test_settings_count_where_they_are_used() -> None:
    usual, other = Settings(), Settings(orders=(1,), deadline_s=1)
    for name, stage in STAGES.items():
        assert (stage.version(usual) != stage.version(other)) == (name == "specimen")
    assert digest({"a": 1, "b": 2}) == digest({"b": 2, "a": 1})


def test_a_digest_of_lists_is_that_of_the_whole() -> None:
    for whole in ([], [[]], [[["a", 'é"\n']], []], [[["a", "b"], ["c", "d"]], [["e", "f"]]]):
        assert digest_lists(iter([iter(part) for part in whole])) == digest(whole)
