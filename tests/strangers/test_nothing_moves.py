"""Recordings in which nothing moves, or of a film whose length nobody gave: no cause is named from their noise."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.strangers.nights import NightOfOne, run_night


def night(place: Path, protocol: str, columns: dict[str, np.ndarray], keys: str) -> NightOfOne:
    """A night over one file of displacement in mm and force in N."""
    folder = place / "files"
    folder.mkdir()
    rows = [",".join(f"{value:.6f}" for value in row) for row in zip(*columns.values(), strict=True)]
    (folder / "run.csv").write_text("\n".join([",".join(columns), *rows, ""]))
    (folder / "run.csv.toml").write_text(
        f"""[csv]
delimiter = ","
[time]
column = "t"
unit = "s"
[columns.displacement]
column = "x"
unit = "mm"
[columns.force]
column = "f"
unit = "N"
[recording]
recording_id = "run"
protocol = "{protocol}"
loading = "mechanical"
specimen_id = "S-1"
started_at = "2026-03-01T14:05:00+01:00"
{keys}
"""
    )
    return run_night(folder, place / "night")


def test_noise_is_no_cyclic_test_and_has_no_clock(tmp_path: Path) -> None:
    """Its page said that the clock claims 0.2970 times the time that passed, and the recording counted as a result."""
    rng, t = np.random.default_rng(4), np.arange(0, 300, 0.1)
    columns = {"t": t, "x": rng.normal(0, 1e-3, t.size), "f": 1 + rng.normal(0, 2e-3, t.size)}
    made = night(tmp_path, "cyclic", columns, "frequency_hz = 0.5")
    assert made.exit_status == 4
    assert "does not move" in made.value("SELECT what_was_missing FROM without_result")
    assert made.value("SELECT verdict FROM diagnoses") is None


def test_a_sinusoid_that_is_a_sweep_is_neither_answered_nor_diagnosed(tmp_path: Path) -> None:
    """It has no response for want of one amplitude and one frequency, and its page said that its clock is wrong."""
    rng, t = np.random.default_rng(6), np.arange(0, 20, 0.005)
    x = np.sin(2 * np.pi * (2 * t + 0.02 * t**2))
    columns = {"t": t, "x": x, "f": 0.4 * x + rng.normal(0, 1e-3, t.size)}
    made = night(tmp_path, "cyclic", columns, "frequency_hz = 2")
    assert made.exit_status == 4
    assert "from cycle to cycle" in made.value("SELECT what_was_missing FROM without_result")
    assert made.value("SELECT verdict FROM diagnoses") is None


@pytest.mark.long
@pytest.mark.slow
def test_a_large_cycle_of_unknown_length_is_not_diagnosed_as_a_cube(tmp_path: Path) -> None:
    """A neo-Hookean film of 50 mm, read as 1 mm and stretched to 51, was said to soften by 40.1 ± 1.5 %."""
    rng, t = np.random.default_rng(5), np.arange(0, 80, 0.1)
    x = np.interp(t, [0, 40, 80], [0, 50, 0])
    force = 0.25 * (1 + x / 50 - (1 + x / 50) ** -2) * 5
    columns = {"t": t, "x": x, "f": force + rng.normal(0, 2e-3, t.size)}
    made = night(tmp_path, "cycle", columns, "film_width_mm = 10\nfilm_thickness_mm = 0.5")
    assert made.value("SELECT verdict FROM diagnoses") is None
    page = (made.lab / "reports" / "specimens" / "S-1.html").read_text(encoding="utf-8")
    assert "film_length_mm is missing" in page
    assert "length 1 mm" in page.replace("\N{NO-BREAK SPACE}", " ")
