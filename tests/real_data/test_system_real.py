"""Measured Duffing circuit: a linear simulation is wrong, and an odd stiffening nonlinearity predicts what it misses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pipeline.diagnose.judge import judge_predictions
from pipeline.diagnose.results import NAMED
from pipeline.diagnose.single.comparison import compare_predictions
from pipeline.diagnose.single.oscillator import SystemRecord
from pipeline.diagnose.single.system_diagnosis import list_system_discrepancies
from pipeline.diagnose.single.system_mechanisms import SystemQuestion, ask_system

INTERVAL_S = 2**14 / 1e7
LOUD_END, LENGTH = 40400, 8192
"""Samples, from 0: the end of the part whose amplitude grows, and how much of it is taken."""
FIRST, LAST = 10584, 11608
"""One period of the multisine, as its authors say."""


@pytest.fixture(scope="module")
def question(real_data: Path) -> SystemQuestion:
    folder = real_data / "silverbox"
    if not folder.is_dir():
        pytest.skip("DEALAB_REAL_DATA: no folder silverbox")
    arrow = np.loadtxt(folder / "SNLS80mV.csv", delimiter=",", skiprows=1, usecols=(0, 1))
    arrow = (arrow - arrow.mean(axis=0))[LOUD_END - LENGTH : LOUD_END]
    period = np.genfromtxt(folder / "Schroeder80mV.csv", delimiter=",", skip_header=1, usecols=(2, 3))
    period = (period - period.mean(axis=0))[FIRST:LAST]
    return ask_system(
        [
            SystemRecord("one period", period[:, 0], period[:, 1], INTERVAL_S, periodic=True),
            SystemRecord("growing", arrow[:, 0], arrow[:, 1], INTERVAL_S),
        ]
    )


@pytest.mark.long
def test_an_odd_stiffening_nonlinearity_predicts_what_a_linear_model_misses(question: SystemQuestion) -> None:
    found = compare_predictions(question.plain, question.models, question.measured, question.left_out, question.sd)
    best = found.ranked[0]
    assert (judge_predictions(found), best.model.mechanism, best.model.variant) == (
        NAMED,
        "strain_stiffening",
        "cubic stiffness",
    )
    assert best.lower > 0.8
    assert best.explained > 0.99
    assert question.parts[0].name == "growing, the loudest"
    loud = question.parts[0].values
    before = 1e3 * float(np.std((question.plain.unseen - question.left_out)[loud]))
    after = 1e3 * float(np.std((best.model.unseen - question.left_out)[loud]))
    assert 30 < before < 50, f"linear, fitted to the quieter record: {before:.2f} mV"
    assert after < 1.2, f"cubic, fitted to the quieter record: {after:.2f} mV"
    assert 1e3 * np.std(question.plain.whole - question.measured) == pytest.approx(20, abs=5)
    assert 1e3 * np.std(best.model.whole - question.measured) < 0.9


def test_the_linear_model_is_wrong_about_the_resonance_of_the_circuit(question: SystemQuestion) -> None:
    assert 65 < question.angular_frequency / 2 / np.pi < 76
    found = {d.recording_id + ", " + d.statement.partition(" (")[0]: d for d in list_system_discrepancies(question)}
    assert found["growing, where it is largest"].chi2 > 1.5 * found["growing, where the output is smallest"].chi2
    assert found["growing, about its resonance"].chi2 > 10 * found["growing, above that"].chi2
