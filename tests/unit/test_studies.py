"""The results file of the studies: a run over some renews their parts and leaves the others."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest

from tests.helpers.foreign_rigs import Answer
from tests.studies import __main__ as studies
from tests.studies.study_foreign import is_correction_right, is_fault_named, is_place_right

FIT, SURVIVAL = (studies.about(studies.HERE / f"study_{name}.py") for name in ("fit", "survival"))


def test_parts_keep_their_own_headings() -> None:
    text = f"# Studies\n\nMade.\n\n## {FIT}\n\n- one\n\n## inside\n\nmore\n\n## {SURVIVAL}\n\n- two\n"
    found = studies.parts(text)
    assert list(found) == [FIT, SURVIVAL]
    assert found[FIT].endswith("## inside\n\nmore\n")
    assert found[SURVIVAL] == f"## {SURVIVAL}\n\n- two\n"


def test_a_run_over_one_leaves_the_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    results = tmp_path / "results.md"
    results.write_text(f"{studies.HEAD}\n## {FIT}\n\n- old\n\n## {SURVIVAL}\n\n- kept\n", encoding="utf-8")
    monkeypatch.setattr(studies, "RESULTS", results)
    monkeypatch.setattr(
        studies, "run", lambda path, options: (f"## {studies.about(path)}\n\n- new\n", path.stem != "x")
    )
    monkeypatch.setattr("sys.argv", ["studies", "fit"])
    assert studies.main() == 0
    written = results.read_text(encoding="utf-8")
    assert written == f"{studies.HEAD}\n## {FIT}\n\n- new\n\n## {SURVIVAL}\n\n- kept\n"
    monkeypatch.setattr("sys.argv", ["studies", "nothing"])
    assert studies.main() == 2
    assert results.read_text(encoding="utf-8") == written


def test_a_missed_target_is_seen_in_the_status(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from tests.studies import study_fit

    monkeypatch.setattr(study_fit, "PARTS", {"a": lambda count, seed: [], "b": lambda count, seed: [f"{count} {seed}"]})
    monkeypatch.setattr("sys.argv", ["study_fit", "a"])
    assert study_fit.main() == 0
    monkeypatch.setattr("sys.argv", ["study_fit", "--truths", "8", "--seed", "3"])
    assert study_fit.main() == 1
    assert "- **missed**: 2 3" in capsys.readouterr().out


def test_results_name_no_folder_of_the_machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Warnings and tracebacks do; what a study printed, and the error that ended it, stand in the results."""
    for name, code in (
        ("warned", "import sys, warnings; print('- missed'); warnings.warn('careful'); sys.exit(1)"),
        ("died", "print('- begun'); raise ValueError('no film')"),
    ):
        (tmp_path / f"study_{name}.py").write_text(f'"""About {name}."""\n{code}\n', encoding="utf-8")
    called = studies.subprocess.run

    def here(command: list[str], **options: object) -> object:
        return called([command[0], str(tmp_path / f"{command[2].rpartition('.')[2]}.py")], **options)

    monkeypatch.setattr(studies, "subprocess", SimpleNamespace(run=here))
    for name, ends in (("warned", "(status 1)."), ("died", "(status 1).\nValueError: no film")):
        text, good = studies.run(tmp_path / f"study_{name}.py", [])
        assert not good
        assert f"**Failed** {ends}\n\n" in text
        assert "careful" not in text
        assert str(tmp_path) not in text


@pytest.mark.parametrize(
    ("told", "right", "proposed", "is_right"),
    [
        ("displacement or voltage clock ppm", 41.6, ("columns.force.time_scale", "0.9999584"), True),
        ("displacement or voltage clock ppm", -41.6, ("columns.force.time_scale", "1.0000416"), True),
        ("displacement or voltage clock ppm", 41.6, ("columns.force.time_scale", "1.0002"), False),
        ("displacement or voltage clock ppm", 41.6, ("time.scale", "0.9999584"), False),
        ("displacement or voltage clock ppm", 0, ("columns.force.time_scale", "0.9999584"), None),
        ("strain_pp", {"a": "0.02", "b": "0.04"}, ("strain_pp", "0.04"), True),
        ("strain_pp", {"a": "0.02", "b": "0.04"}, ("strain_pp", "0.02"), False),
        ("strain_pp", {"a": "0.02"}, ("strain_pp", "0.02"), False),
    ],
)
def test_a_proposal_is_scored_by_the_key_and_value_that_a_rig_declares(
    told: str, right: object, proposed: tuple[str, str], is_right: bool | None
) -> None:
    """Whichever clock is called the wrong one; a value by recording is that of the recording that the proposal is for."""
    fault = {"id": "clock_drift", "recordings": ["b"], "key": told, "right_value": right}
    named = {"id": "clock_drift", "recordings": ["b"], "corrections": [[proposed[0], "1", proposed[1], 1.0]]}
    assert is_correction_right(Answer("rig", 1, "fault", {"fault": fault}, faults=(named,))) is is_right


@pytest.mark.parametrize(
    ("id", "key", "found", "refused", "is_right"),
    [
        ("dead_channel", "displacement of the recording", (), ("r2.mcap: r2: displacement is 0 mm in all samples",), True),
        ("dead_channel", "displacement of the recording", (), ("r2.mcap: r2: force is 0 N in all samples",), False),
        ("channels_swapped", "force<->displacement", ("r1",), ("r2: Force and displacement are in each other's place",), True),
        ("channels_swapped", "force<->displacement", ("r1",), ("r2: the end is missing",), False),
        ("channels_swapped", "force<->displacement", ("r1", "r2", "r3"), (), False),
    ],
)  # fmt: skip
def test_a_recording_that_is_refused_for_its_fault_counts_as_named(
    id: str, key: str, found: tuple[str, ...], refused: tuple[str, ...], is_right: bool
) -> None:
    recordings = ["r2"] if id == "dead_channel" else ["r1", "r2"]
    fault = {"id": id, "key": key, "right_value": None, "recordings": recordings}
    named = ({"id": id, "recordings": list(found), "corrections": []},) if found else ()
    answer = Answer("rig", 1, "fault", {"fault": fault}, faults=named, refused=refused)
    assert is_fault_named(answer) is is_right


@pytest.mark.parametrize(
    ("stage", "said", "depends_on", "is_right"),
    [
        ("film", "film", ("cycle", "amplitude"), True),
        (["film", "rig"], "rig", ("amplitude",), True),
        (["film"], "rig", ("amplitude",), False),
        (["film"], "film", ("frequency",), False),
    ],
)
def test_a_place_is_right_by_one_of_its_stages_and_covariates(
    stage: str | list[str], said: str, depends_on: tuple[str, ...], is_right: bool
) -> None:
    """Rigs state one stage or a list of them."""
    truth = {"stage": stage, "depends_on": ["amplitude", "largest_strain"]}
    assert is_place_right(Answer("rig", 1, "unlisted", truth, stage=said, depends_on=depends_on)) is is_right
