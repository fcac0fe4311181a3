"""Mechanism of the drift: the rest level that goes on creeping."""

from __future__ import annotations

import numpy as np

from pipeline.diagnose.features import kinds
from pipeline.diagnose.mechanisms.mechanism import SHAPE, Mechanism, Parameter, Values
from pipeline.diagnose.simulation.effects import Effect
from schemas.arrays import Float


def _drift(values: Values, variant: str) -> Effect:
    share, onset = values["per_decade"], values["onset_s"]

    def fall(recording_s: Float, session_s: Float, rest_force_n: float) -> Float:
        time = session_s if variant == "session" else recording_s
        return np.asarray(-share * abs(rest_force_n) * np.log10(1 + time / onset))

    return Effect(drift=(fall,))


BASELINE_DRIFT = Mechanism(
    id="baseline_drift",
    stage="drift",
    depends_on=("record_time", "session_time"),
    equation="F − b F_rest log10(1 + t/t0), from the start of each recording or of the session",
    source="logarithmic creep of stretched films (thesis, section 5.4.1)",
    parameters=(
        Parameter("per_decade", "1", "fall per decade of time over the rest force", 0.01, 0.1, signed=True, least=-1.0),
        Parameter("onset_s", "s", "t0", 0.3, 30.0, SHAPE, least=1e-3),
    ),
    shows=kinds.DRIFTING,
    confusable={
        "thermal_softening": "temperature, and it is reversible",
        "electrode_degradation": "there the capacitance falls as well",
        "missing_relaxation": "a drift goes on at rest and does not scale with the step",
    },
    effect=_drift,
    variants=("recording", "session"),
)
MECHANISMS = (BASELINE_DRIFT,)
