"""What is said of a session whose recordings have faults: one set of probabilities, with each cause once in a name."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.diagnose.faults.fault import FOREIGN_RECORDING, Correction, Fault
from pipeline.diagnose.faults.state import state_faults
from tests.unit.test_diagnosis_tables import NAMED

NAMES = ["plain", "drive_lag", "thermal_softening", "drive_lag+thermal_softening", "drive_lag+film/exposure"]


@given(
    st.lists(st.floats(0.01, 1.0), min_size=len(NAMES), max_size=len(NAMES)),
    st.floats(0.5, 1.0),
    st.sampled_from(["drive_lag", "thermal_softening", "wrinkling"]),
)
def test_probabilities_beside_a_fault_sum_to_one(shares: list[float], sure: float, alike: str) -> None:
    """A cause that may stand for a foreign recording was put before names that held it, and some of them fell together."""
    found = replace(NAMED, probabilities={n: s / sum(shares) for n, s in zip(NAMES, shares, strict=True)})
    correction = Correction("r-1", FOREIGN_RECORDING, "specimen_id", "S-1", "", sure)
    fault = Fault(FOREIGN_RECORDING, ("r-1",), sure, "", (correction,), alike=(alike,))
    said = state_faults(found, [fault]).probabilities
    assert sum(said.values()) == pytest.approx(1.0)
    for name in said:
        causes = name.split("+")
        assert len(set(causes)) == len(causes)
    assert sum(p for name, p in said.items() if FOREIGN_RECORDING in name) == pytest.approx(sure)
