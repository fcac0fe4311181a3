"""A blind campaign tells nothing by its names, and is scored by what is hidden."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from pipeline.cli import main
from pipeline.simulate.blind import hide_names
from pipeline.simulate.plan import Campaign, load_campaign
from tests.tools.score_blind import read_answers, read_truth, score


@pytest.fixture(scope="module")
def campaign() -> Campaign:
    return load_campaign("thesis")


def test_names_notes_and_order_tell_nothing(campaign: Campaign) -> None:
    blind = hide_names(campaign, 5)
    assert len(blind.planned) == len(campaign.planned)
    told = json.dumps([[p.recording_id, p.folder, p.notes] for p in blind.planned]) + blind.name
    assert not [name for name in campaign.specimens if name in told]
    assert len({p.recording_id for p in blind.planned}) == len(blind.planned)
    assert {m.recording for m in blind.mishaps} <= {p.recording_id for p in blind.planned}
    films = sorted((s.material_name, sorted(s.effects)) for s in campaign.specimens.values())
    assert sorted((s.material_name, sorted(s.effects)) for s in blind.specimens.values()) == films
    for before, after in zip(campaign.planned, blind.planned, strict=True):
        assert (before.specimen is None) == (after.specimen is None)
        if before.specimen is not None and after.specimen is not None:
            assert before.specimen.effects == after.specimen.effects
            assert after.recording_id.startswith(after.specimen.name)


def test_seeds_draw_names_and_noise(campaign: Campaign) -> None:
    one, other = hide_names(campaign, 1), hide_names(campaign, 2)
    assert [p.recording_id for p in one.planned] != [p.recording_id for p in other.planned]
    assert one.seed != other.seed


def test_a_blind_campaign_needs_a_place_for_its_truth(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["simulate", "first", "--out", str(tmp_path / "raw"), "--blind"]) == 2
    assert "--blind without --truth" in capsys.readouterr().err
    assert not (tmp_path / "raw").exists()


def test_a_blind_campaign_is_written_and_scored(tmp_path: Path) -> None:
    truth = tmp_path / "truth.json"
    assert main(["simulate", "first", "--out", str(tmp_path / "raw"), "--truth", str(truth), "--blind"]) == 0
    names = [p.name for p in (tmp_path / "raw").rglob("*") if p.is_file()]
    assert names
    assert not [n for n in names if "P-07" in n]
    assert set(read_truth(truth)) == {"S-01"}


def test_answers_are_scored_by_what_is_hidden(tmp_path: Path) -> None:
    table = tmp_path / "answers.csv"
    table.write_text(
        "specimen_id,verdict,mechanisms,also_possible\n"
        "S-01,named,[drive_lag],[]\n"
        'S-02,ambiguous,[slack],"[wrinkling, drive_lag]"\n'
        "S-03,named,[leakage],[]\n"
        "S-04,none,[],[]\n",
        encoding="utf-8",
    )
    truth = {"S-01": ("drive_lag",), "S-02": ("wrinkling",), "S-03": (), "S-04": (), "S-05": ("slack",)}
    assert score(read_answers(table), truth) == {
        "found that something is wrong": (2, 3),
        "a right cause first": (1, 3),
        "all causes named or possible": (2, 3),
        "a wrong name without doubt": (1, 5),
        "false alarms": (1, 2),
    }
