"""What an input does between its samples is no fault of a system: each way of it, discretised exactly by scipy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from pipeline.diagnose.single.oscillator import HELD, STRAIGHT, SystemRecord
from pipeline.diagnose.single.system_diagnosis import diagnose_system

INTERVAL_S, NOISE = 1e-3, 0.002


def record(poles: str, hold: str, shaped: bool) -> SystemRecord:
    """A resonance of 40 Hz or two poles, driven by noise that is held (`zoh`) or goes straight (`foh`) from sample to sample."""
    rng = np.random.default_rng(1)
    u = rng.normal(size=4096)
    if shaped:
        u = lfilter([0.2], [1, -0.8], u)
    w = 2 * np.pi * 40
    resonance = [[0.0, 1.0], [-w * w, -0.2 * w]], [[0.0], [w * w]], [[1.0, 0.0]], [[0.0]]
    apart = [[-60.0, 0.0], [0.0, -200.0]], [[60.0], [-60.0]], [[1.0, 1.0]], [[0.0]]
    system = resonance if poles == "resonance" else apart
    a, b, c, d, _ = cont2discrete(tuple(np.array(x) for x in system), INTERVAL_S, method=hold)
    x, y = np.zeros(2), np.zeros(u.size)
    for i in range(u.size):
        y[i] = (c @ x + d[:, 0] * u[i])[0]
        x = a @ x + b[:, 0] * u[i]
    return SystemRecord("r", u, y + NOISE * y.std() * rng.normal(size=u.size), INTERVAL_S)


@pytest.mark.long_after(1)
@pytest.mark.slow
@pytest.mark.parametrize("poles", ["resonance", "two poles"])
@pytest.mark.parametrize("shaped", [False, True])
@pytest.mark.parametrize(("hold", "words"), [("zoh", HELD), ("foh", STRAIGHT)])
def test_a_linear_system_has_nothing_wrong_however_its_input_is_held(
    poles: str, hold: str, words: str, shaped: bool
) -> None:
    """It was unknown, 35 times the noise, or refused for a resonance at half the sampling rate."""
    found, _ = diagnose_system("s", [record(poles, hold, shaped)], ["sphs"], "1")
    assert found.verdict == "none", found.unexplained
    assert any(f"the input {words}" in text for text in found.could_not_ask)
