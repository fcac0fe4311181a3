"""How the specimens of a night stand, in its headline and in its counts: each once, and nothing is said that was not asked."""

from __future__ import annotations

import itertools
from typing import Any

import pytest

from reports import findings
from reports.evidence import Standing, beyond_noise, less_than_noise
from reports.pages.index.headlines import standing_in_words
from reports.pages.index.page import headline
from reports.standings import Brief
from schemas.tables import TABLES
from tests.unit.test_reports_words import plain


def brief(name: str, *, verdict: str = "", alarm: bool | None = None, asked: bool = True) -> Brief:
    look = verdict not in ("", "none") if alarm is None else alarm
    return Brief(name, look, verdict, (), not asked, 2, 1.0, False, "")


LOOK, QUIET, FITTED = brief("A", verdict="named"), brief("B", verdict="none"), brief("C", asked=False)


@pytest.mark.parametrize(
    ("standings", "expected"),
    [
        ([QUIET], "one specimen behaves as simulated"),
        ([QUIET, QUIET], "all two specimens behave as simulated"),
        ([FITTED], "one specimen is fitted, not diagnosed"),
        ([FITTED, FITTED], "two specimens are fitted, not diagnosed"),
        ([LOOK, FITTED], "one specimen needs a look; the other one is fitted, not diagnosed"),
        ([QUIET, FITTED, FITTED], "one specimen behaves as simulated; the other two are fitted, not diagnosed"),
        (
            [LOOK, LOOK, QUIET, FITTED],
            "two specimens need a look; one behaves as simulated; the other one is fitted, not diagnosed",
        ),
        ([brief("D", verdict="none", alarm=True)], "one specimen needs a look"),
    ],
)
def test_only_what_was_diagnosed_behaves_as_simulated(standings: list[Brief], expected: str) -> None:
    assert plain(standing_in_words(standings)) == expected
    assert plain(headline(standings, [], {("ok", True): 1})).casefold() == expected.casefold()


def test_the_headline_counts_every_specimen_once() -> None:
    numbers = {"one": 1, "two": 2, "three": 3, "four": 4, "five": 5, "six": 6}
    for a, b, c in itertools.product(range(3), repeat=3):
        if a + b + c:
            words = plain(standing_in_words([LOOK] * a + [QUIET] * b + [FITTED] * c)).replace("all ", "")
            assert sum(numbers[part.removeprefix("the other ").split()[0]] for part in words.split("; ")) == a + b + c
            assert ("as simulated" in words) == bool(b)


def fit(chi2: float) -> dict[str, Any]:
    known = {"model_order": 2, "reduced_chi2": chi2, "frequency_lines": 36, "k0_n_per_mm": 0.2, "k0_n_per_mm_sd": 1e-4}
    return {**dict.fromkeys(TABLES["model_fits"].names), **known}


def test_less_than_noise_is_not_called_noise() -> None:
    """A relaxation whose errors have a floor left a hundredth of them, and the page called that noise."""
    assert not any(less_than_noise(fit(chi2)) or beyond_noise(fit(chi2)) for chi2 in (0.7, 1.0, 1.3))
    small = fit(0.0128)
    assert less_than_noise(small)
    text = plain(findings.headline(Standing("R-1", None, None, small, None)).striptags())
    assert text.endswith("the model leaves less than the errors that the fit reckons with")
    assert plain(findings.headline(Standing("R-1", None, None, fit(1.0), None))).endswith(
        "what the model leaves is noise"
    )
