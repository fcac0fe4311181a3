"""Models of a film at each amplitude, beside that of their average."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.analyse.inputs import Measured
from pipeline.analyse.model_fits import amplitude_fits_table
from pipeline.analyse.specimen import of_known_strain
from pipeline.fit.relaxation.amplitudes import fit_amplitudes
from pipeline.physics.film import RelaxationModel
from pipeline.transform.response import STIFFNESS, FrequencyResponse
from schemas.metadata import RecordingMetadata, RigConstants

FILM = RelaxationModel(0.4, (0.4, 1.0), (2.5, 0.1))
FREQUENCIES = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)


def cycles(amplitudes: dict[float, float], frequencies=FREQUENCIES) -> list[FrequencyResponse]:
    """Single lines of a film whose stiffness at each amplitude is multiplied by a factor, with 0.1 % of noise."""
    rng = np.random.default_rng(seed=3)
    found = []
    for amplitude, factor in amplitudes.items():
        for f in frequencies:
            k = factor * FILM.stiffness(np.array([f]))
            error = 1e-3 * np.abs(k)
            found.append(
                FrequencyResponse(
                    frequency_hz=np.array([f]),
                    value=k + error * (rng.normal(size=1) + 1j * rng.normal(size=1)) / np.sqrt(2),
                    variance=error**2,
                    usable=np.array([True]),
                    quantity=STIFFNESS,
                    loading="mechanical",
                    amplitude=amplitude,
                    recording_id=f"{amplitude}-{f}",
                    specimen_id="s",
                )
            )
    return found


def test_each_amplitude_has_its_own_springs_and_the_same_times() -> None:
    found = fit_amplitudes(cycles({0.25: 0.8, 0.05: 1.1}), specimen_id="s")
    assert [one.amplitude for one in found] == [0.05, 0.25]
    assert [one.recordings for one in found] == [9, 9]
    soft, stiff = (one.fits.selected for one in reversed(found))
    assert (soft.order, stiff.order) == (2, 2)
    assert soft.model.k0 / stiff.model.k0 == pytest.approx(0.8 / 1.1, rel=0.01)
    assert soft.model.tau == pytest.approx(FILM.tau, rel=0.05)
    rows = amplitude_fits_table(found).to_pylist()
    assert len(rows) == 6
    chosen = [r for r in rows if r["selected"]]
    assert [r["amplitude"] for r in chosen] == [0.05, 0.25]
    assert chosen[1]["k1_n_per_mm"] == pytest.approx(0.8 * 0.4, rel=0.03)
    assert chosen[1]["k1_n_per_mm_sd"] > 0


def test_one_amplitude_or_too_few_frequencies_say_nothing_beside_the_average() -> None:
    assert fit_amplitudes(cycles({0.1: 1.0})) == ()
    assert fit_amplitudes(cycles({0.1: 1.0, 0.2: 0.9}, (0.1, 1.0))) == ()
    unknown = [r for r in cycles({0.1: 1.0}) if r.frequency_hz[0] > 1]
    assert fit_amplitudes(unknown) == ()


def test_only_the_amplitude_of_a_sinusoid_is_a_strain() -> None:
    """Of a sweep it is a displacement: 0.3 mm are not 30 %."""
    about = {"loading": "mechanical", "specimen_id": "s", "started_at": "2026-03-01T08:00:00Z"}
    kinds = {
        "a": {"protocol": "cyclic", "strain_pp": 0.1},
        "b": {"protocol": "chirp", "strain_pp": 0.01},
        "c": {"protocol": "cyclic"},
    }
    recordings = [
        Measured(RecordingMetadata.parse({**about, "recording_id": name, **keys}), RigConstants(), ())
        for name, keys in kinds.items()
    ]
    responses = [replace(cycles({0.05: 1.0})[0], recording_id=name) for name in ("a", "b", "c", "d")]
    assert [r.recording_id for r in of_known_strain(responses, recordings)] == ["a"]
