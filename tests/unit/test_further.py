"""Which causes others are looked for beside."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from pipeline.diagnose.search import several_causes


@pytest.mark.parametrize(
    ("left", "shows", "built_on"),
    [
        (0.5, False, []),  # the best leaves noise alone: a worse one with a cause more has nothing else to explain
        (9.0, False, ["second"]),  # it leaves more, of which no cause is like it
        (0.5, True, ["best", "second"]),
        (9.0, True, ["best", "second"]),
    ],
)
def test_causes_are_added_to_a_second_one_where_the_best_leaves_something(
    monkeypatch: pytest.MonkeyPatch, left: float, shows: bool, built_on: list[str]
) -> None:
    best, second = (
        SimpleNamespace(name=n, chi2=c, log_evidence=-c / 2) for n, c in (("best", 900.0), ("second", 950.0))
    )
    reached = {"best": shows, "second": True}
    asked: list[str] = []

    def tried(base: Any, *_: object, goal: float) -> list[Any]:
        asked.append(base.name)
        assert goal < best.chi2
        return []

    monkeypatch.setattr(
        several_causes, "compute_signatures", lambda _, base: SimpleNamespace(reaches=lambda *_: reached[base.name])
    )
    monkeypatch.setattr(several_causes, "find_best_scores", lambda _: (SimpleNamespace(statistic=50.0),))
    monkeypatch.setattr(several_causes, "_is_promising", lambda *_: True)
    monkeypatch.setattr(several_causes, "measure_excess", lambda *_: left)
    monkeypatch.setattr(several_causes, "fit_each_mechanism", tried)
    plain: Any = SimpleNamespace(chi2=2000.0)
    changes: Any = None
    found, shown = several_causes._add_causes(plain, [best, second], changes)  # type: ignore[list-item]
    assert (found, shown) == (best, False)
    assert asked == built_on
