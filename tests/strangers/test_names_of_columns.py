"""What machines call their columns: commands beside what was measured, clocks called lives, units behind `in`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ingest.cell_units import unit_behind
from ingest.draft import make_draft
from ingest.meanings import guess_columns


@pytest.mark.parametrize(
    ("names", "chosen"),
    [
        (("Ch 1 Weg Sollwert", "Ch 1 Weg"), "Ch 1 Weg"),
        (("Displacement Setpoint", "Displacement"), "Displacement"),
        (("Position command", "Position"), "Position"),
        (("Absolute Position", "Extension"), "Extension"),
        (("Sollweg", "Istweg"), "Istweg"),
        (("Weg Sollwert",), "Weg Sollwert"),
    ],
)
def test_what_was_measured_comes_before_what_was_commanded(names: tuple[str, ...], chosen: str) -> None:
    found = guess_columns(("Zeit", *names, "Kraft"), ("s", *["mm"] * len(names), "N"), len(names) + 2)
    assert [c.column for c in found if c.meaning == "displacement"] == [chosen]


def test_a_force_that_was_commanded_is_not_the_force() -> None:
    found = guess_columns(("Time", "Force demand", "Force", "Position"), ("s", "N", "N", "mm"), 4)
    assert [c.column for c in found if c.meaning == "force"] == ["Force"]


@pytest.mark.parametrize(
    ("name", "expected"),
    [("T in °C", ("T", "°C")), ("f in Hz", ("f", "Hz")), ("ω in rad/s", ("ω", "rad/s")), ("x in", ("x", "in"))],
)
def test_a_unit_stands_behind_in(name: str, expected: tuple[str, str]) -> None:
    assert unit_behind(name) == expected


@pytest.mark.parametrize(
    ("name", "unit"), [("Time_S", "s"), ("TIME_SEC", "s"), ("Elapsed_S", "s"), ("G_S", ""), ("Force_S", "")]
)
def test_seconds_of_a_clock_may_stand_in_capitals(name: str, unit: str) -> None:
    assert unit_behind(name)[1] == unit


def test_a_single_letter_is_what_its_unit_says() -> None:
    """T is a time in s and a temperature in °C."""
    assert [c.meaning for c in guess_columns(("T in °C", "t in s"), (), 2)] == ["temperature", "time"]
    assert [c.meaning for c in guess_columns(("T", "F"), ("s", "N"), 2)] == ["time", "force"]


@pytest.mark.parametrize("clock", ["Laufzeit", "Life time"])
def test_a_clock_that_is_called_a_life_is_a_clock_beside_force_and_displacement(tmp_path: Path, clock: str) -> None:
    time = np.arange(2000) * 0.05
    moved = 6.0 * np.clip((time - 5) / 0.4, 0, 1)
    force = 0.2 * moved * (1 + np.exp(-np.maximum(time - 5, 0) / 20))
    rows = [f"{a:.2f}\t{b:.4f}\t{c:.4f}" for a, b, c in zip(time, moved, force, strict=True)]
    path = tmp_path / "strip.dat"
    path.write_text("\n".join([f"{clock}\tWeg\tKraft", "s\tmm\tN", *rows, ""]), encoding="utf-8")
    draft = make_draft(path)
    assert draft.content["kind"] == "recording"
    assert draft.content["time"]["column"] == clock
    assert draft.content["recording"]["protocol"] == "step"


def test_lives_in_order_beside_a_load_stay_lives(tmp_path: Path) -> None:
    """A list may be sorted; it says which of its specimens failed."""
    path = tmp_path / "lives.csv"
    rows = [f"S{i},{10 + 3 * i},0.{i},{'yes' if i % 3 else 'no'}" for i in range(1, 9)]
    path.write_text("\n".join(["Specimen,Life [h],Load [N],Failed", *rows, ""]), encoding="utf-8")
    assert make_draft(path).content["kind"] == "lifetimes"
