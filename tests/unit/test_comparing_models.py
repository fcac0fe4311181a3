"""Which of the compared features a finding shows: those in which its cause explains most."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from reports.pages.specimen.comparing_models import blocks, foremost


def values(kind: str, block: str, size: int, plain: float, extended: float | None) -> list[dict[str, Any]]:
    """A block whose models are so many standard deviations off."""
    return [
        {
            "recording_id": "S-1-r", "kind": kind, "block": block, "position": i, "component": "", "frequency_hz": 1.0 + i,
            "amplitude": None, "voltage_kv": None, "cycle": None, "time_s": float(i), "measured": 2.0, "plain": 2.0 - 0.01 * plain,
            "extended": None if extended is None else 2.0 - 0.01 * extended, "sd": 0.01,
        }
        for i in range(size)
    ]  # fmt: skip


def shown(*some: list[dict[str, Any]]) -> str:
    """Caption of the figure that stands beside the finding."""
    rows = [r for block in some for r in block]
    site: Any = SimpleNamespace(
        results=SimpleNamespace(rows=lambda _query: rows), data_path=lambda *_: "data/curves.csv"
    )
    figure = foremost(site, "S-1")
    assert figure is not None
    return str(figure.caption)


def test_a_kind_that_is_within_the_noise_but_for_one_value_has_no_figure_of_its_own() -> None:
    rows = [*values("sphs.response", "lines", 40, 12.0, 1.0)]
    for i in range(8):
        rows += values("rest.hum", f"rest {i}", 1, 2.0 if i == 7 else 0.7, 2.0 if i == 7 else 0.7)
    draft: Any = SimpleNamespace(
        results=SimpleNamespace(rows=lambda _query: rows), item="S-1", data=lambda name, _: f"data/{name}.csv"
    )
    shown = blocks(draft, {"verdict": "named"})
    assert [type(one).__name__ for one in shown] == ["Heading", "Figure"]


LOUD = values("sphs.voltage", "lines", 60, 400.0, 400.0)
"""What is missed most by far, and left as it is."""


@pytest.mark.parametrize("first", [True, False])
def test_a_finding_shows_what_its_cause_explains_not_what_it_leaves(first: bool) -> None:
    cured = values("sphs.response", "lines", 40, 12.0, 1.0)
    text = shown(*((cured, LOUD) if first else (LOUD, cured)))
    assert "response to voltage" in text.lower()
    assert "explains nothing" not in text


def test_of_a_kind_the_block_in_which_the_cause_explains_most() -> None:
    text = shown(values("sphs.response", "loud", 40, 90.0, 90.0), values("sphs.response", "cured", 40, 9.0, 1.0))
    assert "cured" in text


def test_small_blocks_count_together_as_they_are_drawn() -> None:
    small = [values("step.force", f"edge {i}", 4, 30.0, 1.0) for i in range(30)]
    text = shown(values("sphs.response", "lines", 40, 20.0, 1.0), *small)
    assert "force after the edges" in text.lower()


def test_without_a_cause_what_is_missed_most() -> None:
    unexplained = [
        values(kind, "lines", 40, off, None) for kind, off in (("sphs.response", 5.0), ("sphs.voltage", 9.0))
    ]
    assert "voltage over command" in shown(*unexplained).lower()
