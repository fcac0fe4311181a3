"""Judgements of an interrupted study: taken where the code is the same, made again where it is not."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest

from tests.helpers.judging import Case, Judgement
from tests.helpers.kept_judgements import Code, Kept, digest
from tests.studies import study_diagnosis

NAN = float("nan")
ASKED = Case(7, "compact", (("slack", 1.5),))
JUDGEMENT = Judgement(
    ASKED, (0.03,), "named", ("slack",), (), True, NAN, NAN, 0, NAN, 1 / 3, 0.2, 0.9, 1e-7, split=None, proposed=True
)
NOTHING = Judgement(Case(7), (), "none", (), (), None, NAN, NAN, 0, NAN, 0.1, 0.1, NAN, 0.4)


def test_a_judgement_comes_back_as_it_was_kept(tmp_path: Path) -> None:
    kept = Kept(tmp_path / "log.jsonl", Code("a", "b"))
    kept.add(5, ASKED, (NOTHING, JUDGEMENT))
    kept.add(6, Case(8), (NOTHING,))
    (found,) = kept.judgements(5).items()
    assert found[0] == ASKED
    first, second = found[1]
    assert first.case == NOTHING.case
    assert math.isnan(first.before)
    assert (second.case, second.severities, second.named, second.covered) == (ASKED, (0.03,), ("slack",), True)
    assert second.curve_before == pytest.approx(1 / 3, rel=1e-4)
    assert kept.seed() == 5


def test_lines_of_other_code_and_half_a_line_count_for_nothing(tmp_path: Path) -> None:
    path = tmp_path / "log.jsonl"
    Kept(path, Code("old", "b")).add(5, ASKED, (JUDGEMENT,))
    kept = Kept(path, Code("new", "b"))
    assert kept.seed() is None
    kept.begin()
    assert path.read_text(encoding="utf-8") == ""
    kept.add(9, ASKED, (JUDGEMENT,))
    with path.open("a", encoding="utf-8") as out:
        out.write('{"code": "new", "see')
    assert list(kept.judgements(9)) == [ASKED]
    kept.begin()
    assert path.read_text(encoding="utf-8").count("\n") == 1


def test_other_code_for_proposals_makes_ambiguous_verdicts_again_alone(tmp_path: Path) -> None:
    path = tmp_path / "log.jsonl"
    doubted = replace(JUDGEMENT, verdict="ambiguous", case=Case(8))
    before = Kept(path, Code("a", "old"))
    before.add(5, ASKED, (NOTHING, JUDGEMENT))
    before.add(5, doubted.case, (NOTHING, doubted))
    assert set(before.judgements(5)) == {ASKED, doubted.case}
    assert set(Kept(path, Code("a", "new")).judgements(5)) == {ASKED}


@pytest.mark.long
@pytest.mark.slow
def test_a_study_goes_on_where_it_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kept = Kept(tmp_path / "log.jsonl", digest())
    chosen = study_diagnosis.cases(3, "compact", 2, 0, 0, 0)
    kept.add(3, chosen[0], (NOTHING,))
    begun = list(study_diagnosis.run(chosen, 1, lambda: False, kept, 3))
    assert [j.case for j in begun] == [NOTHING.case]
    monkeypatch.setattr(study_diagnosis, "HERE", tmp_path)
    assert study_diagnosis.main(["--minutes", "0", "--log", str(kept.path), "--clean", "2", "--jobs", "1"]) == 1
    assert (tmp_path / "diagnosis.svg").exists()


def test_further_severities_count_for_their_share_alone() -> None:
    asked = study_diagnosis.cases(3, "compact", 2, 1, 1, 1, 9)
    assert set(study_diagnosis.cases(3, "compact", 2, 1, 1, 1)) < set(asked)
    found = [
        replace(JUDGEMENT, case=case, covered=case.seed % 2 == 0, verdict="none" if case.seed % 3 else "named")
        for case in asked
        if case.effects
    ]
    with_more = study_diagnosis.rates(study_diagnosis.Sorts.of(found))
    without = study_diagnosis.rates(study_diagnosis.Sorts.of([j for j in found if j.case.seed % 10_000 < 8000]))
    differ = [one.name for one, other in zip(with_more, without, strict=True) if list(one.hits) != list(other.hits)]
    assert differ == ["severity within its 90 % interval (forms that define it)"]
