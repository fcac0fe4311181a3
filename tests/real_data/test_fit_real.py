"""Fits of measured data against their published results."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from pipeline.fit.relaxation.identify import fit_specimen
from pipeline.fit.relaxation.time_domain import fit_cycle
from pipeline.transform.relaxation import RelaxationCurve
from pipeline.transform.response import STIFFNESS, FrequencyResponse

Float = NDArray[np.float64]
ANSYS = {  # case: terms, R² of E′, R² of E″, E0 in MPa (PROVENANCE.md)
    "freq_master": (27, 0.99990, 0.95683, 9648.2),
    "freq_raw": (34, 0.99994, 0.65861, 5588.6),
}


@pytest.fixture(scope="module")
def dmta(real_data: Path) -> Path:
    folder = real_data / "pyvisco_dmta" / "verification"
    if not folder.is_dir():
        pytest.skip(f"no folder {folder}")
    return folder


def published(folder: Path) -> tuple[Float, Float]:
    """Moduli over E0 and relaxation times of an ANSYS table (pairs spread over TBDATA lines)."""
    text = (folder / "prony_terms.MPL").read_text()
    terms = int(re.search(r"TB,PRON,_MATL\s*,\s*1,\s*(\d+)", text)[1])  # type: ignore[index]
    numbers = [
        float(x) for line in text.splitlines() if line.startswith("TBDATA") for x in line.split(",")[2:] if x.strip()
    ]
    pairs = np.array(numbers[: 2 * terms]).reshape(-1, 2)
    return pairs[:, 0], pairs[:, 1]


def table(folder: Path) -> Float:
    rows = np.loadtxt(folder / "input_master.csv", delimiter=",", skiprows=1)
    return rows[np.argsort(rows[:, 0])]


def explained(measured: Float, model: Float) -> float:
    return float(1 - ((measured - model) ** 2).sum() / ((measured - measured.mean()) ** 2).sum())


def as_response(frequency: Float, value: NDArray[np.complex128], variance: Float) -> FrequencyResponse:
    usable = np.ones(frequency.size, dtype=bool)
    return FrequencyResponse(frequency, value, variance, usable, STIFFNESS, "mechanical", recording_id="dmta")


@pytest.mark.parametrize("case", list(ANSYS))
def test_published_prony_tables_are_reproduced_and_hertz_are_not_radians(dmta: Path, case: str) -> None:
    terms, storage, loss, modulus = ANSYS[case]
    f, real, imag = table(dmta / case).T
    share, tau = published(dmta / case)
    assert share.size == terms
    found = {}
    for unit, omega in (("rad/s", 2 * np.pi * f), ("Hz", f)):
        z = 1j * np.multiply.outer(omega, tau)
        shape = 1 - share.sum() + (z / (1 + z)) @ share
        both, data = np.concatenate([shape.real, shape.imag]), np.concatenate([real, imag])
        e0 = (both @ data) / (both @ both)
        found[unit] = explained(real, e0 * shape.real), explained(imag, e0 * shape.imag), e0
    assert found["rad/s"] == (
        pytest.approx(storage, abs=6e-6),
        pytest.approx(loss, abs=6e-6),
        pytest.approx(modulus, abs=0.1),
    )
    assert found["Hz"][0] < {"freq_master": 0.9918, "freq_raw": 0.9971}[case]


@pytest.mark.long_after(1)
@pytest.mark.parametrize(("case", "enough"), [("freq_master", 16), ("freq_raw", 27)])
def test_fewer_arms_reach_what_is_published(dmta: Path, case: str, enough: int) -> None:
    """With the weights of the metric itself (constant noise): 16 arms for 27 terms, 27 for 34."""
    terms, storage, loss, _ = ANSYS[case]
    f, real, imag = table(dmta / case).T
    fits = fit_specimen([as_response(f, real + 1j * imag, np.full(f.size, 1.0))], orders=(enough,))
    k = fits.selected.model.stiffness(f)
    assert fits.selected.resolved_arms <= enough < terms
    assert explained(real, k.real) >= storage
    assert explained(imag, k.imag) >= loss


def test_trade_off_with_relative_weights(dmta: Path) -> None:
    """Without variance: relative noise from the data. More arms never fit worse, three are far from enough and say so."""
    f, real, imag = table(dmta / "freq_master").T
    value = real + 1j * imag
    fits = fit_specimen([as_response(f, value, np.full(f.size, np.nan))], orders=(1, 2, 3, 6, 12, 20, 25))
    error = [float(np.sqrt(np.mean(np.abs(x.model.stiffness(f) / value - 1) ** 2))) for x in fits.fits]
    assert np.all(np.diff(error) < 0)
    assert error[2] > 0.2
    assert error[-1] < 0.08
    assert explained(imag, fits.of_order(25).model.stiffness(f).imag) > 0.957
    assert any("no variance given" in w for w in fits.warnings)
    few = fit_specimen([as_response(f, value, np.full(f.size, np.nan))])
    assert any("order 4 would fit better still" in w for w in few.warnings)


def test_time_master_curve(dmta: Path) -> None:
    """Relaxation modulus over 30 decades of time: published 31 terms, R² .9999957, median error 7.7e-4, largest 2.2e-2."""
    rows = np.loadtxt(dmta / "time_master" / "input_master.csv", delimiter=",", skiprows=1)
    rows = rows[np.argsort(rows[:, 0])]
    t, modulus = rows.T
    share, tau = published(dmta / "time_master")
    assert share.size == 31
    curve = 1739.03 * (1 - share.sum() + np.exp(-t[:, None] / tau) @ share)
    relative = np.abs(curve / modulus - 1)
    assert explained(modulus, curve) == pytest.approx(0.9999957, abs=2e-7)
    assert np.median(relative) == pytest.approx(7.7e-4, rel=0.02)
    assert relative.max() == pytest.approx(2.2e-2, rel=0.03)
    ours = RelaxationCurve(
        time_s=t,
        window_s=np.stack([t, t], axis=1),
        stiffness=modulus,
        variance=(1e-3 * modulus) ** 2,
        usable=np.ones(t.size, dtype=bool),
        ramp_s=0.0,
        step=1.0,
        rest_variance=0.0,
        step_sd=0.0,
        unusable_because=("",) * t.size,
        quantity=STIFFNESS,
    )
    fits = fit_specimen([], relaxations=[ours], orders=(26,))
    model = fits.selected.model
    fitted = model.k0 + np.exp(-t[:, None] / np.array(model.tau)) @ np.array(model.k)
    assert fits.selected.resolved_arms <= 26
    assert explained(modulus, fitted) >= 0.9999957
    assert np.sqrt(np.mean((fitted / modulus - 1) ** 2)) <= np.sqrt(np.mean(relative**2))


def test_vhb_triangle_cycle(real_data: Path) -> None:
    """One branch on the published equilibrium law: η 735.949, γ 33.3567, SSE 118866 kPa², RMSE 9.655 kPa."""
    from scipy.io import loadmat

    path = real_data / "vhb4910_miles_mcmc" / "vhb4910_data.mat"
    if not path.exists():
        pytest.skip(f"no file {path}")
    data = loadmat(path, squeeze_me=True, struct_as_record=False)["data"]
    t, stretch = data.xdata.T
    law = {"crosslink_modulus": 7.5541, "entanglement_modulus": 17.69, "largest_stretch": 4.8333}
    fits = fit_cycle(t, stretch, data.ydata, equilibrium=law)
    one, two, three = fits.fits
    assert one.samples == 1275
    assert one.eta[0] == pytest.approx(735.949, abs=0.002)
    assert one.gamma[0] == pytest.approx(33.3567, abs=1e-4)
    assert one.sse == pytest.approx(118866, abs=1)
    assert one.rmse == pytest.approx(9.655, abs=1e-3)
    assert one.correlation == pytest.approx(0.993, abs=1e-3)
    assert one.relative_rmse == pytest.approx(0.045, abs=2e-4)
    # the published posterior (737.2 ± 12.2, 33.35 ± 0.17) takes the residuals as independent
    assert one.eta_sd[0] is not None
    assert one.eta_sd[0] > 5 * 12.2
    # a second branch halves the error, also on the part of the cycle that was left out; a third brings nothing
    assert two.rmse < 0.56 * one.rmse
    assert two.held_out_rmse < 0.3 * one.held_out_rmse
    assert three.rmse > 0.98 * two.rmse
    assert fits.selected_order == 2
    assert any("starts at 2.46" in w for w in fits.warnings)
    assert any("one\N{NO-BREAK SPACE}gap" in w for w in fits.warnings)
