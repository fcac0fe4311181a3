"""The door for notebooks: frames with units, and a fitted model that can be evaluated, plotted and simulated."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import duckdb
import matplotlib as mpl
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from pipeline import Lab
from pipeline.lab.fitted import FittedModel
from pipeline.simulate.campaign import simulate_one
from pipeline.simulate.plan import read_campaign
from schemas.errors import DealabError, UsageError
from tests.helpers import synthetic_lab

mpl.use("Agg")
SWEEP = {
    "test": "chirp",
    "amplitude_mm": 0.2,
    "frequency_stop_hz": 50.0,
    "sweep_s": 5.0,
    "sample_rate_hz": 500,
    "id": "what-if",
}


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Lab:
    folder = synthetic_lab.whole_story().write(tmp_path_factory.mktemp("notebook") / "lab")
    with duckdb.connect(str(folder / "results.duckdb")) as connection:
        connection.execute(
            "UPDATE recordings SET metadata = json_merge_patch(metadata, '"
            '{"recording": {"active_length_mm": "40", "active_width_mm": "40", "active_drawn": "stretched", '
            '"relative_permittivity": "4.7"}, "rig": {"load_cell_range_n": "2.0"}}'
            "') WHERE specimen_id = 'P-07'"
        )
        connection.execute(
            "INSERT INTO model_fits BY NAME SELECT * REPLACE ('electrical' AS loading), 0.0011 AS force_per_voltage_squared_n_per_kv2 "
            "FROM (SELECT * EXCLUDE (force_per_voltage_squared_n_per_kv2) FROM model_fits "
            "WHERE specimen_id = 'P-07' AND selected AND coalesce(extension, '') = '')"
        )
        (path,) = connection.sql("SELECT samples_path FROM recordings WHERE recording_id = 'P-05_chirp-1' AND status = 'ok'").fetchall()[0]  # fmt: skip
    target = folder / path
    target.parent.mkdir(parents=True)
    fields = [
        pa.field("time_ns", pa.int64(), metadata={"unit": "ns"}),
        pa.field("force", pa.float64(), metadata={"unit": "N"}),
    ]
    times = 1_700_000_000_000_000_000 + np.arange(5) * 500_000
    pq.write_table(pa.table([times, np.arange(5) / 2], schema=pa.schema(fields)), target)
    return Lab(folder)


def test_samples_over_time_with_units(lab: Lab) -> None:
    frame = lab.samples("P-05_chirp-1")
    assert frame.attrs["units"] == {"force": "N"}
    assert frame.index.name == "time_s"
    np.testing.assert_allclose(frame.index, np.arange(5) * 5e-4, atol=1e-12)
    assert frame.attrs["start_ns"] == 1_700_000_000_000_000_000


@pytest.mark.parametrize("name", ["nobody", "P-05_chirp-2", "' OR true --"])
def test_samples_that_are_not_there(lab: Lab, name: str) -> None:
    with pytest.raises(UsageError, match="no samples of recording"):
        lab.samples(name)


def test_responses_of_a_specimen_and_of_a_recording(lab: Lab) -> None:
    of_specimen = lab.responses("P-07", stage="averaged")
    assert set(of_specimen["stage"]) == {"averaged"}
    assert of_specimen.attrs["units"]["value"] == "N/mm"
    np.testing.assert_allclose(of_specimen["magnitude"], np.abs(of_specimen["value"]))
    of_recording = lab.responses("P-07_sphs-1")
    assert set(of_recording["recording_id"]) == {"P-07_sphs-1"}
    assert of_recording.attrs["units"]["value"] == "N/kV²"
    with pytest.raises(UsageError, match="no frequency response"):
        lab.responses("nobody")


def test_a_table_by_its_columns(lab: Lab) -> None:
    steps = lab.table("step_responses", recording_id="P-07_step")
    assert len(steps) == 6
    assert steps.attrs["units"]["force_step_n"] == "N"
    with pytest.raises(UsageError, match="is no name"):
        lab.table("recordings; DROP TABLE recordings")
    with pytest.raises(DealabError):
        lab.table("recordings", colour="red")


def test_the_fit_evaluates_as_its_parameters_say(lab: Lab) -> None:
    fit = lab.fit("P-07")
    f = np.array([1.0, 10.0, 90.0])
    np.testing.assert_allclose(fit.stiffness(f), synthetic_lab.film(synthetic_lab.POLYACRYLATE, f), rtol=1e-12)
    frame = fit.frame(f)
    assert frame.attrs["units"]["magnitude_sd"] == "N/mm"
    assert (frame["magnitude_sd"] > 0).all()
    moved = 1e-4
    # The band's first-order share of k0 alone: |∂|k|/∂ln k0| · sd(ln k0), here sd = 1e-3.
    k = fit.stiffness(f)
    share = np.abs(np.abs(k + fit.model.k0 * moved) - np.abs(k)) / moved * 1e-3
    assert (frame["magnitude_sd"] >= share * 0.99).all()


def test_relaxation_falls_to_the_main_spring(lab: Lab) -> None:
    values = lab.fit("S-02").relaxation([0.0, 1e-4, 10.0])
    assert values[0] == pytest.approx(0.59)
    assert np.all(np.diff(values) < 0)
    assert values[-1] == pytest.approx(0.29)


def test_plot_draws_points_band_and_model(lab: Lab) -> None:
    axes = lab.fit("P-07").plot()
    assert axes.get_xscale() == "log"
    assert len(axes.lines) >= 2
    assert "P-07" in axes.get_title(loc="left")


def test_the_specimen_can_be_put_on_the_virtual_rig(lab: Lab) -> None:
    text = lab.fit("P-07").campaign(
        [{"test": "sphs", "drive_kv": 6.0, "lines": "odd", "period_s": 1.0, "periods": 8, "id": "what-if"}]
    )
    campaign = read_campaign(tomllib.loads(text))
    (planned,) = campaign.planned
    assert planned.specimen is not None
    film = planned.specimen.film(electrical=True)
    assert film.force_per_voltage_squared == pytest.approx(0.0011, rel=1e-6), (
        "the fitted force, not the stated permittivity"
    )
    simulated = simulate_one(campaign, planned)
    assert {"voltage", "force"} <= set(simulated.recording.channels)


def test_the_extended_model_takes_its_effects_along(lab: Lab) -> None:
    fit = lab.fit("P-07", extended=True)
    table = tomllib.loads(fit.campaign([{"test": "chirp", "start_hz": 1.0, "stop_hz": 50.0, "id": "x"}]))
    assert table["specimens"]["P-07"]["effects"] == {"rig_constants": {"stiffness_error": 0.063}}
    assert table["rigs"]["rig"]["load_cell_stiffness_n_per_mm"] == 20.0, "the filed one, from which the effect departs"


def with_effects(lab: Lab, **severities: Any) -> FittedModel:
    return replace(lab.fit("P-07"), effects=severities)


@pytest.mark.parametrize(
    ("mechanism", "severity", "effect"),
    [
        (
            "drive_lag",
            {"rise_time_constant_s": {"value": 0.01}, "slew_kv_per_s": {"value": None}, "form": "monitored"},
            {"rise_time_constant_s": 0.01, "monitored": True},
        ),
        (
            "drive_lag",
            {"rise_time_constant_s": {"value": 0.01}, "form": "hidden from the monitor"},
            {"rise_time_constant_s": 0.01, "monitored": False},
        ),
        ("gain_error", {"gain": {"value": 0.05}, "channel": "voltage"}, {"gain": 0.05, "channel": "voltage"}),
        ("sensor_delay", {"delay_s": {"value": 1e-3}, "channel": "force"}, {"delay_s": 1e-3, "channel": "force"}),
        (
            "mains_hum",
            {
                "amplitude_n": {"value": 0.004},
                "second": {"value": 0.5},
                "frequency_hz": {"value": 60.0},
                "channel": "60 Hz",
            },
            {"amplitude_n": 0.004, "second_n": 0.002, "frequency_hz": 60.0},
        ),
        (
            "baseline_drift",
            {"per_decade": {"value": 0.02}, "onset_s": {"value": 3.0}, "form": "recording"},
            {"per_decade": 0.02, "t0_s": 3.0},
        ),
    ],
)
def test_what_a_diagnosis_finds_becomes_an_effect_that_the_rig_has(
    lab: Lab, mechanism: str, severity: dict[str, Any], effect: dict[str, Any]
) -> None:
    table = tomllib.loads(with_effects(lab, **{mechanism: severity}).campaign([SWEEP]))
    assert table["specimens"]["P-07"]["effects"] == {mechanism: effect}
    (planned,) = read_campaign(table).planned
    assert simulate_one(read_campaign(table), planned).truth["effects"][mechanism] == effect


@pytest.mark.parametrize(
    ("mechanism", "severity"),
    [
        ("cyclic_softening", {"loss": {"value": 0.1}}),
        ("amplitude_softening", {"drop": {"value": 0.1}, "form": "running"}),
        ("drive_lag", {"rise_time_constant_s": {"value": 0.01}, "form": "monitored, and further behind the monitor"}),
        ("baseline_drift", {"per_decade": {"value": 0.1}, "onset_s": {"value": 1.0}, "form": "session"}),
    ],
)
def test_what_the_rig_does_not_have_is_refused(lab: Lab, mechanism: str, severity: dict[str, Any]) -> None:
    with pytest.raises(UsageError, match=f"{mechanism}.* cannot be put on the virtual rig"):
        with_effects(lab, **{mechanism: severity}).simulate(SWEEP)


def test_a_simulated_recording_is_a_frame_as_a_recorded_one(lab: Lab) -> None:
    frame = lab.fit("P-07").simulate(SWEEP)
    assert frame.index.name == "time_s"
    assert frame.index[0] == 0
    assert frame.attrs["units"] == {"displacement": "mm", "force": "N"}
    assert frame.attrs["recording_id"] == "what-if"
    assert np.ptp(frame["displacement"]) == pytest.approx(0.4, rel=0.02), "twice the amplitude"
    assert frame.equals(lab.fit("P-07").simulate(SWEEP))
    assert not frame.equals(lab.fit("P-07").simulate(SWEEP, seed=2))
    with pytest.raises(UsageError, match="2 recordings at once"):
        lab.fit("P-07").simulate({k: v for k, v in SWEEP.items() if k != "id"} | {"vary": {"sweep_s": [4.0, 5.0]}})


def test_parameters_with_their_limits(lab: Lab) -> None:
    fit = lab.fit("P-07")
    frame = fit.parameters()
    assert frame.index[0] == "k0"
    assert set(frame["unit"]) <= {"N/mm", "N s/mm", "s", "kg", "N/kV²"}
    stated = replace(fit, row={**fit.row, "intervals": '{"k0": {"lower": 0.9, "upper": null, "method": "profile"}}'})
    k0 = stated.parameters().loc["k0"]
    assert (k0["value"], k0["lower_95"]) == (fit.model.k0, 0.9)
    assert np.isnan(k0["upper_95"]), "no limit on that side"
    by_sd = replace(fit, row={**fit.row, "intervals": None}).parameters().loc["k0"]
    assert by_sd["upper_95"] - by_sd["value"] == pytest.approx(1.96 * fit.row["k0_n_per_mm_sd"], rel=1e-3)
    np.testing.assert_allclose(frame.loc["tau1", "value"], fit.model.tau[0])


def test_a_fit_of_another_order(lab: Lab) -> None:
    orders = lab.table("model_fits", specimen_id="P-07")["model_order"]
    other = next(int(o) for o in orders if o != lab.fit("P-07").row["model_order"])
    assert lab.fit("P-07", order=other).row["model_order"] == other
    with pytest.raises(UsageError, match="no model of order 9"):
        lab.fit("P-07", order=9)
    with pytest.raises(UsageError, match="extended model of another order"):
        lab.fit("P-07", order=1, extended=True)


def test_without_a_fit_the_remedy_is_named(lab: Lab) -> None:
    with pytest.raises(UsageError, match="no extended model"):
        lab.fit("P-05", extended=True)
    with pytest.raises(UsageError, match="no fitted model"):
        lab.fit("nobody")


def test_import_is_light() -> None:
    import subprocess
    import sys

    heavy = "import sys, pipeline; print([m for m in ('numpy', 'pandas', 'duckdb', 'pyarrow', 'scipy') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", heavy], capture_output=True, text=True, cwd=Path(__file__).parents[2])
    assert done.stdout.strip() == "[]"
