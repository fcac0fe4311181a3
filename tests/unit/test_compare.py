"""Films and batches side by side: differences against published methods, the page, the command."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from pipeline.cli import main
from pipeline.fit.comparing import MEASURING, PREDICTION, WELCH, Sample, compare_parameters, compare_samples
from schemas.arrays import Float
from tests.helpers import synthetic_lab


def sample(*values: float, sds: float = np.nan) -> Sample:
    return Sample(np.array(values), np.full(len(values), sds))


def test_two_batches_differ_by_welchs_interval() -> None:
    a, b = [1.1, 1.3, 0.9, 1.2], [1.9, 1.4, 2.2]
    found = compare_samples(sample(*a), sample(*b))
    wanted = stats.ttest_ind(b, a, equal_var=False)  # scipy's own
    interval = wanted.confidence_interval(0.95)
    assert found is not None
    assert (found.value, found.lower, found.upper) == pytest.approx(
        (np.mean(b) - np.mean(a), interval.low, interval.high)
    )
    assert found.p_value == pytest.approx(wanted.pvalue)
    assert found.rests_on == WELCH


def test_a_specimen_is_held_against_the_scatter_of_its_batch() -> None:
    found = compare_samples(sample(10.0, 12.0, 11.0), sample(14.0, sds=0.001))
    # mean 11, s = 1, √(1 + 1/3) = 1.1547; t of 97.5 % with two degrees of freedom is 4.3027 (Student's table)
    assert found is not None
    assert (found.lower, found.upper) == pytest.approx((3 - 4.3027 * 1.1547, 3 + 4.3027 * 1.1547), rel=1e-4)
    assert found.rests_on == PREDICTION


def test_two_specimens_differ_by_their_measuring_errors() -> None:
    found = compare_samples(sample(1.0, sds=0.03), sample(1.1, sds=0.04))
    assert found is not None
    assert (found.lower, found.upper) == pytest.approx((0.1 - 1.959964 * 0.05, 0.1 + 1.959964 * 0.05))
    assert found.p_value == pytest.approx(0.0455003, rel=1e-5)  # two standard deviations
    assert found.rests_on == MEASURING


def test_without_a_spread_there_is_no_difference() -> None:
    assert compare_samples(sample(1.0), sample(1.1, sds=0.1)) is None
    assert compare_samples(sample(1.0, 1.0), sample(2.0, 2.0)) is None


@given(
    st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=5),
    st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=5),
    st.floats(0.01, 10),
)
def test_the_difference_turns_its_sign_with_the_order(first: list[float], second: list[float], sd: float) -> None:
    there = compare_samples(sample(*first, sds=sd), sample(*second, sds=sd))
    back = compare_samples(sample(*second, sds=sd), sample(*first, sds=sd))
    if there is None or back is None:
        assert there is back
        return
    assert (there.value, there.lower, there.upper) == pytest.approx((-back.value, -back.upper, -back.lower))
    assert there.p_value == pytest.approx(back.p_value)
    assert there.lower <= there.value <= there.upper


def test_equal_films_are_told_apart_in_one_of_twenty_draws() -> None:
    random = np.random.default_rng(20261127)
    root = np.linalg.cholesky(np.array([[1.0, 0.8, 0.0], [0.8, 1.0, 0.3], [0.0, 0.3, 2.0]]))
    hits = 0
    for _ in range(2000):
        a, b = (root @ random.standard_normal(3) for _ in range(2))
        hits += compare_parameters(a, b, 2 * root @ root.T).p_value < 0.05
    assert 70 <= hits <= 132  # 100 expected; limits of 99.9 %


def test_a_direction_without_variance_is_left_out() -> None:
    covariance: Float = np.diag([1.0, 0.0])
    whole = compare_parameters(np.array([0.0, 0.0]), np.array([2.0, 0.0]), covariance)
    assert (whole.chi2, whole.freedom) == (pytest.approx(4.0), 1)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return synthetic_lab.whole_story().write(tmp_path_factory.mktemp("compare") / "lab")


@pytest.mark.long
@pytest.mark.slow
def test_the_command_says_and_writes_what_differs(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = tmp_path / "films.html"
    assert main(["compare", "P-05", "P-06", "S-02", "--out", str(page), "--lab", str(folder)]) == 0
    said = capsys.readouterr().out
    assert said.startswith("P-05, P-06 and S-02 differ in ")
    assert "Differences from P-05" in said
    text = page.read_text(encoding="utf-8")
    assert "<script" not in text
    assert set(re.findall(r'(?:href|src)="([^#d][^"]*)', text)) == set()  # nothing outside the file
    assert re.search(r'<img src="data:image/svg\+xml;base64,[^"]+" width="980" height="\d+" alt="P-05, P-06', text)
    figure = tmp_path / "films.pdf"
    assert main(["compare", "P-05", "P-06", "--out", str(figure), "--lab", str(folder)]) == 0
    assert figure.read_bytes().startswith(b"%PDF")
    assert "not how far two films of one batch are apart" in capsys.readouterr().out


def test_lives_of_two_configurations_are_compared(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["compare", "single AR", "separate ARs", "--lab", str(folder)]) == 0
    said = capsys.readouterr().out
    assert "Lives of" in said
    assert "only their lives can be compared" in said


def test_survival_curves_lie_over_each_other(folder: Path, tmp_path: Path) -> None:
    """The numbers that failed are those of the page of the campaign; one figure holds both curves."""
    page, figure = tmp_path / "lives.html", tmp_path / "lives.svg"
    for out in (page, figure):
        assert main(["compare", "single AR", "separate ARs", "--out", str(out), "--lab", str(folder)]) == 0
    text = page.read_text(encoding="utf-8").replace("\u00a0", " ")
    found = re.search(r'alt="Survival: ([^"]*)"', text)
    assert found
    parts = re.findall(r"(single AR|separate ARs)[^:;]*: (\d+) of (\d+) failed", found[1])
    assert {name for name, *_ in parts} == {"single AR", "separate ARs"}
    assert all(int(failed) <= int(total) for _, failed, total in parts)
    drawn = figure.read_text(encoding="utf-8")
    assert "Surviving, %" in drawn
    assert "At risk" in drawn


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["P-05"], "two or more different"),
        (["P-05", "nobody"], 'called "nobody"'),
        (["P-05", "F-01"], "nothing in common"),
        (["P-05", "P-06", "--out", "a.docx"], "ends in .html"),
    ],
)
def test_what_cannot_be_compared_is_said(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], words: list[str], said: str
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    assert main(["compare", *words, "--lab", str(folder)]) == 2
    assert said in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
