"""An input that is held from sample to sample is simulated so, and makes no delayed sensor of half an interval."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from pipeline.analyse.diagnosis_tables import comparison_tables
from pipeline.diagnose.results import NONE
from pipeline.diagnose.single.oscillator import SystemRecord
from pipeline.diagnose.single.system_diagnosis import diagnose_system

INTERVAL_S = 0.01


def respond(held: np.ndarray, hertz: float, ratio: float) -> np.ndarray:
    """A resonance, exactly, under an input that is held from each sample to the next."""
    w = 2 * np.pi * hertz
    moves = expm(np.array([[0, 1, 0], [-w * w, -2 * ratio * w, w * w], [0, 0, 0]]) * INTERVAL_S)
    state, out = np.zeros(2), np.zeros(held.size)
    for i, u in enumerate(held):
        out[i] = state[0]
        state = moves[:2, :2] @ state + moves[:2, 2] * u
    return out


@pytest.mark.slow
def test_an_input_that_is_held_makes_no_delayed_sensor() -> None:
    random = np.random.default_rng(17)
    held = np.repeat(random.standard_normal(200), 4)
    output = respond(held, 3.0, 0.2) + 0.01 * random.standard_normal(held.size)
    found, comparison = diagnose_system("a", [SystemRecord("a1", held, output, INTERVAL_S)], ["noise"], "1")
    delay = next(tried for tried in comparison.ranked if tried.model.mechanism == "sensor_delay").model.severity[
        "delay_s"
    ]
    assert delay.lower <= 0 <= delay.upper
    assert any("the input is held" in line for line in found.could_not_ask)
    assert found.verdict == NONE
    (row,) = comparison_tables(found, comparison)["assumptions"].to_pylist()
    assert (row["recording_id"], row["specimen_id"], row["what"]) == ("a1", "a", "input between its samples")
    assert row["value"] == "is held"
    assert "simulated best" in row["because"]
    assert "delays" in row["touches"]
