"""Stress relaxation on the pages: what is drawn is what the film does, clamp, load cell and ramp allowed for."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pyarrow.csv as pacsv
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from pipeline.cli import main
from reports.build import build_reports
from reports.pages.specimen import relaxing
from tests.helpers import synthetic_lab

K0, SPRING, DAMPER = synthetic_lab.SILICONE[0], 0.4, 0.8
TAU = DAMPER / SPRING


def lab_with_a_step(folder: Path, *, ramp: float, wrong: float = 1.0, sweeps: bool = True) -> Path:
    """A film (one arm, 2 s) that is pulled by 0.5 mm in `ramp` s and held; the stored model's arm is `wrong` times the true one."""
    story = synthetic_lab.Story()
    story.recording("R-1_step", "R-1", "step", "mechanical", duration_s=40.0)
    model = (K0, (SPRING * wrong,), (DAMPER * wrong,))
    if sweeps:
        story.responses("R-1", model, ["R-1_step"])
    story.fits("R-1", model)
    t = np.linspace(0, 40, 2000)
    moved = 0.5 * np.clip((t - 2) / ramp, 0, 1)
    since = np.clip(t - 2 - ramp, 0, None)
    height = SPRING * TAU / ramp * (1 - np.exp(-ramp / TAU))
    rising = K0 * moved + 0.5 * SPRING * TAU / ramp * (1 - np.exp(-np.clip(t - 2, 0, ramp) / TAU))
    film = np.where(t < 2 + ramp, rising, 0.5 * (K0 + height * np.exp(-since / TAU)))
    cell = 2000.0
    for row in story.rows["recordings"]:
        row["metadata"] = row["metadata"].replace(
            '"load_cell_stiffness_n_per_mm": "20.0"', f'"load_cell_stiffness_n_per_mm": "{cell}"'
        )
    for fit in story.rows["model_fits"]:
        fit["load_cell_stiffness_n_per_mm"] = cell
    for quantity, values in (("displacement", moved + 3.0), ("force", film * cell / (cell + K0) + 0.7)):
        for x, y in zip(t, values, strict=True):
            story.rows["previews"].append(
                {"recording_id": "R-1_step", "quantity": quantity, "time_s": x, "low": y - 1e-4, "high": y + 1e-4}
            )
    story.run()
    lab = story.write(folder / "lab")
    build_reports(lab)
    return lab


def drawn(lab: Path, kind: str) -> dict[str, np.ndarray]:
    (path,) = (lab / "reports" / "data" / kind).glob("*_relaxation*.csv")
    table = pacsv.read_csv(path)
    return {name: table.column(name).to_numpy() for name in table.column_names}


@pytest.mark.long_after(1)
@pytest.mark.parametrize("ramp", [0.1, 1.5])
def test_points_lie_on_the_true_relaxation_after_a_short_and_a_long_ramp(tmp_path: Path, ramp: float) -> None:
    lab = lab_with_a_step(tmp_path, ramp=ramp)
    data = drawn(lab, "specimens")
    x = ramp / (2 * TAU)
    truth = K0 + SPRING * np.exp(-data["time_s"] / TAU) * np.sinh(x) / x
    np.testing.assert_allclose(data["stiffness_n_per_mm"], truth, rtol=0.012)
    np.testing.assert_allclose(data["model_n_per_mm"], truth, rtol=0.012)
    page = (lab / "reports" / "specimens" / "R-1.html").read_text()
    assert "The film relaxes from" in page
    assert "the model follows to" in page


@settings(max_examples=30, deadline=None)
@given(
    st.lists(st.tuples(st.floats(0.1, 30.0), st.floats(1e-3, 3.0)), min_size=1, max_size=3, unique_by=lambda arm: round(math.log(arm[1]), 1)),
    st.floats(5.0, 500.0), st.floats(0.02, 1.0), st.sampled_from([0.0, 0.02]),
)  # fmt: skip
def test_the_model_in_series_with_the_load_cell_is_that_of_its_differential_equations(
    film: list[tuple[float, float]], cell: float, ramp: float, dashpot: float
) -> None:
    """Against the states of the arms, integrated: T = k0 u + Σ kᵢ(u − aᵢ) + c u', τᵢ aᵢ' = u − aᵢ, u = x − T/kL."""
    fit = {f"{n}{i}_{u}": None for i in range(1, 9) for n, u in (("k", "n_per_mm"), ("c", "n_s_per_mm"))}
    fit |= {"k0_n_per_mm": 1.0}
    for i, (k, tau) in enumerate(film, 1):
        fit |= {f"k{i}_n_per_mm": k, f"c{i}_n_s_per_mm": k * tau}
    if dashpot:
        fit[f"c{len(film) + 1}_n_s_per_mm"] = dashpot
    springs, times = np.array([k for k, _ in film]), np.array([tau for _, tau in film])

    def rates(t: float, state: np.ndarray) -> np.ndarray:
        x, relaxed = min(t / ramp, 1.0), state[1:]
        if dashpot:
            u = state[0]
            speed = (cell * (x - u) - u - springs @ (u - relaxed)) / dashpot
        else:
            u, speed = (cell * x + springs @ relaxed) / (cell + 1.0 + springs.sum()), 0.0
        return np.concatenate([[speed], (u - relaxed) / times])

    t = ramp + np.geomspace(0.01, 5.0, 12)
    found = solve_ivp(
        rates, (0, t[-1]), np.zeros(1 + len(film)), "LSODA", t_eval=t, rtol=1e-9, atol=1e-11, max_step=ramp / 4
    )
    u = found.y[0] if dashpot else (cell + springs @ found.y[1:]) / (cell + 1.0 + springs.sum())
    expected = relaxing.model(fit, t - ramp / 2, ramp, cell)
    np.testing.assert_allclose(expected, cell * (1.0 - u), rtol=2e-5)


def test_a_model_that_relaxes_otherwise_is_seen(tmp_path: Path) -> None:
    data = drawn(lab_with_a_step(tmp_path, ramp=0.1, wrong=1.5), "specimens")
    off = data["stiffness_n_per_mm"] / data["model_n_per_mm"] - 1
    assert np.sqrt(np.mean(off**2)) > 0.05


def test_a_specimen_of_relaxations_alone_has_its_figure(tmp_path: Path) -> None:
    """Its page showed parameters, and no picture of what they were fitted to."""
    lab = lab_with_a_step(tmp_path, ramp=0.1, sweeps=False)
    assert "model_n_per_mm" in drawn(lab, "specimens")
    assert "The film relaxes from" in (lab / "reports" / "specimens" / "R-1.html").read_text()


def test_the_recordings_own_page_draws_it_without_a_model(tmp_path: Path) -> None:
    lab = lab_with_a_step(tmp_path, ramp=0.1)
    data = drawn(lab, "recordings")
    assert "line: the model" in (lab / "reports" / "specimens" / "R-1.html").read_text()
    assert "line: the model" not in (lab / "reports" / "recordings" / "R-1_step.html").read_text()
    assert set(data) == {"time_s", "stiffness_n_per_mm"}
    assert np.all(np.diff(data["time_s"]) > 0)


@pytest.mark.long
@pytest.mark.slow
def test_the_points_of_a_fast_ramp_in_a_long_record_are_those_of_the_analysis(tmp_path: Path) -> None:
    """Of a ramp of 1.5 s in 45 minutes the preview has a single bin: its points lay a third below the model that fits them."""
    raw = tmp_path / "raw"
    raw.mkdir()
    t = np.concatenate([np.arange(0, 20, 0.1), np.arange(20, 2700, 1.0)])
    moved = 25 * np.clip((t - 3) / 1.5, 0, 1)
    since = np.maximum(t - 3, 0)
    force = 0.008 + moved * (0.031 + 0.038 * np.exp(-since / 6) + 0.021 * np.exp(-since / 75))
    rows = [f"{a:.2f},{x:.4f},{f:.5f}" for a, x, f in zip(t, moved, force, strict=True)]
    (raw / "strip.csv").write_text("\n".join(["time (s),way (mm),Force (N)", *rows, ""]))
    sizes = "film_sizes_mm=50x20x1"
    assert (
        main(["add", str(raw / "strip.csv"), "--yes", "specimen_id=S", "started_at=2026-03-01T10:00:00Z", sizes]) == 0
    )
    assert main(["nightly", str(raw), "--lab", str(tmp_path / "lab")]) == 0
    data = drawn(tmp_path / "lab", "specimens")
    assert data["stiffness_n_per_mm"] == pytest.approx(data["model_n_per_mm"], rel=0.02)
    page = (tmp_path / "lab" / "reports" / "specimens" / "S.html").read_text(encoding="utf-8")
    assert "the model follows to" in page
    assert "secant of a step of 50" in page
    assert "Parameters: modulus" in page
