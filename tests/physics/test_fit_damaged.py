"""Damaged recordings beside whole ones: used as far as the whole ones confirm them, and never without a word."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2

from pipeline.analyse.inputs import Measured
from pipeline.analyse.specimen import analyse_specimen
from pipeline.fit.relaxation.damaged import weighed
from pipeline.fit.relaxation.identify import fit_specimen
from pipeline.transform.response import FrequencyResponse
from schemas.metadata import RecordingMetadata
from tests.helpers.fit_truth import ACRYLATE, BAND, electrical, electrical_response, film, mechanical, response, rig

Complex = NDArray[np.complex128]
CUT = "the file ends within a chunk"


def chirps(spoil: Callable[[Complex], Complex], *, noisier: float = 1.0, seed: int = 0) -> list[FrequencyResponse]:
    """Three whole chirps and a damaged one, whose values are spoiled and whose noise is larger than it says."""
    rng = np.random.default_rng(seed)
    clean = mechanical(BAND, film(BAND, ACRYLATE))
    whole = [response(BAND, clean, rng, recording_id=f"r{i}") for i in range(3)]
    bad = response(BAND, spoil(clean), rng, relative=0.01 * noisier, recording_id="cut")
    return [*whole, replace(bad, variance=bad.variance / noisier**2)]


RIGS = [rig()] * 4
DAMAGE = ["", "", "", CUT]


def test_a_damaged_recording_that_agrees_is_used() -> None:
    given = chirps(lambda g: g)
    found, (remark,) = weighed(given, RIGS, DAMAGE)
    assert found[:3] == tuple(given[:3])
    assert 1.0 < (found[3].variance / given[3].variance).max() < 1.5  # it has to show that it is good
    assert found[3].usable.all()
    assert "cut is damaged; the whole recordings leave it" in remark


@pytest.mark.parametrize("noisier", [1.5, 1.8])
def test_one_that_is_noisier_than_it_says_weighs_as_much_as_it_is_worth(noisier: float) -> None:
    factors = []
    for seed in range(5):
        given = chirps(lambda g: g, noisier=noisier, seed=seed)
        found, _ = weighed(given, RIGS, DAMAGE)
        factors.append(float((found[3].variance / given[3].variance)[0]))
    upper = 200 / chi2.ppf(0.05, 200)
    assert np.mean(factors) == pytest.approx(upper * noisier**2, rel=0.15)


@pytest.mark.parametrize(
    "spoil",
    [lambda g: 1.1 * g, lambda g: g * np.exp(-2j * np.pi * BAND * 5e-4), lambda g: np.roll(g, 3)],
    ids=["gain", "delay", "frequency"],
)
def test_one_that_contradicts_the_others_is_left_out_with_the_reason(spoil: Callable[[Complex], Complex]) -> None:
    given = chirps(spoil)
    found, (remark,) = weighed(given, RIGS, DAMAGE)
    assert not found[3].usable.any()
    assert set(found[3].unusable_because) == {found[3].unusable_because[0]}
    assert "variances per value off the whole recordings" in found[3].unusable_because[0]
    assert remark.startswith("cut is left out: damaged")
    with_it, without = fit_specimen(found, RIGS), fit_specimen(given[:3], RIGS[:3])
    assert with_it.selected_order == without.selected_order == 3
    assert with_it.selected.theta == pytest.approx(without.selected.theta)
    assert any("cut: no usable line" in w for w in with_it.warnings)


def test_films_that_soften_with_amplitude_are_no_contradiction() -> None:
    """The whole recordings differ by 10 % among themselves: a damaged one within that is not thrown out."""
    rng = np.random.default_rng(seed=1)
    clean = mechanical(BAND, film(BAND, ACRYLATE))
    given = [
        response(BAND, gain * clean, rng, recording_id=f"r{gain}", amplitude=a)
        for gain, a in ((1.0, 0.1), (0.95, 0.2), (0.9, 0.3), (0.94, 0.25))
    ]
    found, _ = weighed(given, RIGS, DAMAGE)
    assert found[3].usable.all()


def test_without_a_whole_recording_it_is_used_and_said() -> None:
    given = chirps(lambda g: g)
    found, remarks = weighed(given, RIGS, [CUT] * 4)
    assert found == tuple(given)
    assert len(remarks) == 4
    assert all("no whole recording can judge it" in r for r in remarks)
    assert weighed(given, RIGS, [""] * 4) == (tuple(given), ())


def test_electrical_recordings_too() -> None:
    rng = np.random.default_rng(seed=2)
    clean = electrical(BAND, film(BAND, ACRYLATE), 0.002)
    given = [electrical_response(BAND, clean, rng, recording_id=f"r{i}") for i in range(2)]
    given.append(electrical_response(BAND, clean * np.exp(1e-3j * BAND * 5), rng, recording_id="cut"))
    found, (remark,) = weighed(given, RIGS[:3], ["", "", CUT])
    assert not found[2].usable.any()
    assert "cut is left out" in remark


def test_the_reason_reaches_the_models_and_the_corrected_rows() -> None:
    """The whole specimen: models as without the damaged recording, its corrected rows unusable, the reason in both."""

    def one(r: FrequencyResponse) -> Measured:
        about = RecordingMetadata(
            recording_id=r.recording_id or "", protocol="chirp", loading="mechanical", specimen_id="film-1",
            started_at=datetime(2024, 3, 4, tzinfo=UTC),
        )  # fmt: skip
        return Measured(about, rig(), (r,), CUT if r.recording_id == "cut" else "")

    given = chirps(lambda g: 1.2 * g)
    tables = analyse_specimen("film-1", [one(r) for r in given], [], orders=(1, 2, 3)).joined()
    clean = analyse_specimen("film-1", [one(r) for r in given[:3]], [], orders=(1, 2, 3)).joined()
    fits, expected = (
        [f for f in t["model_fits"].to_pylist() if f["selected"] and f["method"] == "forward"] for t in (tables, clean)
    )
    assert fits[0]["k0_n_per_mm"] == pytest.approx(expected[0]["k0_n_per_mm"], rel=1e-6)
    assert "cut is left out: damaged" in fits[0]["warnings"]
    assert not expected[0]["warnings"]
    rows = [r for r in tables["frequency_responses"].to_pylist() if r["recording_id"] == "cut"]
    assert rows
    assert not any(r["usable"] for r in rows)
    assert all("damaged" in r["unusable_because"] for r in rows)
