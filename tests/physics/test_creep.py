"""Creep and recovery against equations of motion integrated apart, and a rig that loads a film."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from ingest.draft import make_draft
from pipeline import Lab
from pipeline.analyse.creep import NOT_ASKED
from pipeline.cli import main
from pipeline.fit.retardation.creep import Creep, measure_creep
from pipeline.physics.compliance import Compliance
from pipeline.physics.film import RelaxationModel
from pipeline.transform.holds import find_holds
from schemas.arrays import Float
from schemas.errors import NotIdentifiableError
from schemas.metadata import RecordingMetadata, RigConstants
from schemas.recording import Channel, Recording

SOLID = RelaxationModel(0.4, (0.06, 0.05), (50.0, 2.0))
"""N/mm and s."""
RAMP_S, ON_S, OFF_S = 0.5, 10.0, 610.0


def load_of(time_s: Float) -> Float:
    """0.3 N from 10.5 s to 610 s, straight ramps of half a second."""
    return np.asarray(np.interp(time_s, [ON_S, ON_S + RAMP_S, OFF_S, OFF_S + RAMP_S], [0, 0.3, 0.3, 0]))


def extension_of(time_s: Float, solid: RelaxationModel = SOLID) -> Float:
    """Extension in mm by the equations of springs and dampers, not by retardation times: Σ forces = load, ḟ = kė − f/τ."""
    k, tau = np.array(solid.k), np.array(solid.tau)
    total = solid.k0 + k.sum()

    def rates(t: float, f: Float) -> Float:
        slope = 0.3 / RAMP_S * ((ON_S <= t < ON_S + RAMP_S) * 1.0 - (OFF_S <= t < OFF_S + RAMP_S) * 1.0)
        speed = (slope + (f / tau).sum()) / total
        return k * speed - f / tau

    corners = [0.0, ON_S, ON_S + RAMP_S, OFF_S, OFF_S + RAMP_S, float(time_s[-1]) + 1]
    state, found = np.zeros(k.size), np.zeros(time_s.size)
    for low, high in pairwise(corners):
        inside = (time_s >= low) & (time_s < high)
        end = np.nextafter(high, low)
        result = solve_ivp(rates, (low, end), state, t_eval=[*time_s[inside], end], rtol=1e-9, atol=1e-12)
        state = result.y[:, -1]
        found[inside] = (load_of(time_s[inside]) - result.y[:, :-1].sum(axis=0)) / solid.k0
    return found


def uneven_times() -> Float:
    """A machine's clock: slow while it rests, fast after each change of the load, then ever slower."""
    rest = np.arange(0, ON_S, 1.0)
    parts = [
        start + np.concatenate([np.arange(0.02, 2, 0.02), np.geomspace(2, length - 0.02, 150)])
        for start, length in ((ON_S, 600.0), (OFF_S, 650.0))
    ]
    return np.concatenate([rest, *parts])


TIMES = uneven_times()
EXTENSION = extension_of(TIMES)


def recorded(
    time_s: Float = TIMES,
    extension: Float = EXTENSION,
    *,
    noise: float = 2e-4,
    walk: float = 0.0,
    drift: float = 0.0,
    seed: int = 0,
    rig: RigConstants | None = None,
) -> Recording:
    """A creep test with noise in mm, a random walk in mm²/s and a drift in mm/s of the displacement, from a zero of its own."""
    rng = np.random.default_rng(seed)
    steps = rng.normal(0, 1, time_s.size - 1) * np.sqrt(walk * np.diff(time_s))
    wander = np.concatenate([[0.0], np.cumsum(steps)]) + drift * time_s
    moved = 0.7 + extension + wander + rng.normal(0, noise, time_s.size)
    force = load_of(time_s) + rng.normal(0, 3e-4, time_s.size)
    ns = np.round(time_s * 1e9).astype(np.int64) + 1_700_000_000_000_000_000
    metadata = RecordingMetadata.parse(
        {
            "recording_id": "creep",
            "protocol": "creep",
            "loading": "mechanical",
            "specimen_id": "C-1",
            "started_at": "2024-01-01T00:00:00+00:00",
            "film_length_mm": 20.0,
        }
    )
    channels = {
        name: Channel(quantity=name, unit=unit, time_ns=ns, values=values)
        for name, unit, values in (("displacement", "mm", moved), ("force", "N", force))
    }
    return Recording(metadata=metadata, rig=rig or RigConstants(), channels=channels)


def film(found: Creep) -> RelaxationModel:
    return found.solid(found.retardation.selected)


@pytest.mark.parametrize(
    "solid",
    [
        RelaxationModel(0.4, (0.1,), (3.0,)),
        SOLID,
        RelaxationModel(0.4, (0.1, 0.2, 0.05), (900.0, 0.7, 0.001)),
        RelaxationModel(0.0, (0.4, 0.2), (100.0, 1.0)),
    ],
)
def test_compliance_and_stiffness_are_each_others_inverse(solid: RelaxationModel) -> None:
    compliance = Compliance.of(solid)
    s = 2j * np.pi * np.geomspace(1e-5, 1e4, 40)
    retarded = sum(j / (1 + s * t) for j, t in zip(compliance.retarded, compliance.times_s, strict=True))
    np.testing.assert_allclose(
        (compliance.instant + retarded + compliance.flow / s) * solid.stiffness(s.imag / (2 * np.pi)), 1, rtol=1e-8
    )
    again = compliance.solid()
    np.testing.assert_allclose([again.k0, *again.k, *again.tau], [solid.k0, *solid.k, *solid.tau], rtol=1e-8)
    assert (compliance.flow > 0) == (solid.k0 == 0)


def test_a_film_under_load_moves_as_its_springs_and_dampers_say() -> None:
    fine = np.unique(np.concatenate([TIMES, [ON_S, ON_S + RAMP_S, OFF_S, OFF_S + RAMP_S]]))
    moved = Compliance.of(SOLID).response(fine, load_of(fine))[np.searchsorted(fine, TIMES)]
    np.testing.assert_allclose(moved, EXTENSION, atol=2e-7)


def test_the_solid_of_an_uneven_record_is_found_within_its_errors() -> None:
    found = measure_creep(recorded())
    assert found.retardation.selected_order == 2
    model = film(found)
    sds = found.solid_sd(found.retardation.selected)
    for value, sd, truth in zip(
        (model.k0, *model.k, *model.tau), (sds[0], *sds[1], *sds[2]), (SOLID.k0, *SOLID.k, *SOLID.tau), strict=True
    ):
        assert sd is not None
        assert sd < 0.1 * truth
        assert abs(value - truth) < 4 * sd
    assert found.load_n == pytest.approx(0.3, rel=1e-3)
    assert found.elastic_mm.value == pytest.approx(0.3 / 0.51, rel=2e-3)
    assert found.end_mm.value == pytest.approx(float(EXTENSION[np.searchsorted(TIMES, OFF_S) - 1]), rel=2e-3)
    assert found.length_mm == 20.0


def test_orders_are_tried_on_until_the_test_stops() -> None:
    """Four retardations far apart and next to no noise: the usual three are rejected, and so a fourth is tried."""
    solid = RelaxationModel(2.0, (2.0, 2.0, 2.0, 2.0), (0.05, 0.8, 12.0, 150.0))
    found = measure_creep(recorded(extension=extension_of(TIMES, solid), noise=2e-5)).retardation
    assert found.selected_order >= 4
    assert found.fits[-1].p_value > 0.01 or "would fit better still" in found.fits[-1].warnings[-1]
    # A model that is wrong by hundreds of its noise is rejected, whatever the noise of the next one.
    assert all(fit.p_value < 1e-3 for fit in found.fits[:3])


def test_a_load_cell_in_series_is_taken_off() -> None:
    behind = EXTENSION + load_of(TIMES) / 4.0
    found = measure_creep(recorded(extension=behind, rig=RigConstants(load_cell_stiffness_n_per_mm=4.0)))
    assert film(found).k0 == pytest.approx(SOLID.k0, rel=5e-3)
    assert measure_creep(recorded(extension=behind)).elastic_mm.value == pytest.approx(0.3 / 0.51 + 0.3 / 4, rel=5e-3)


def test_a_wandering_zero_is_no_further_retardation() -> None:
    """Residuals taken for independent found a third retardation in nearly all of these."""
    orders = [
        measure_creep(recorded(walk=3e-7, drift=2e-6, seed=seed)).retardation.selected_order for seed in range(12)
    ]
    assert orders.count(2) >= 11  # at the level of the test, 1 %, fewer happen in one of 150 such dozens


def test_noise_and_wander_are_told_apart() -> None:
    found = [measure_creep(recorded(walk=1e-7, seed=seed)).retardation.noise for seed in range(8)]
    assert np.mean([one.walk for one in found]) == pytest.approx(1e-7, rel=0.35)
    assert np.mean([one.sample_sd for one in found]) == pytest.approx(2e-4, rel=0.3)


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize(("walk", "drift"), [(1e-6, 0.0), (3e-7, 5e-6), (1e-7, -2e-5)])
def test_the_interval_of_the_recovered_share_holds_it(walk: float, drift: float) -> None:
    """With the noise of the samples alone, and no wander, it held it in less than half of them."""
    truth = 1 - EXTENSION[-1] / EXTENSION[np.searchsorted(TIMES, OFF_S) - 1]
    held = 0
    for seed in range(40):
        share = measure_creep(recorded(walk=walk, drift=drift, seed=100 + seed)).recovered_share
        assert share is not None
        held += share.lower <= truth <= share.upper
    assert held >= 35  # of an interval of 95 % fewer than 35 of 40 happen once in 30 thousand times


def test_what_does_not_come_back_is_not_called_recovered() -> None:
    lost = EXTENSION + 0.05 * np.clip((TIMES - ON_S) / (OFF_S - ON_S), 0, 1)
    share = measure_creep(recorded(extension=lost, walk=1e-8)).recovered_share
    assert share is not None
    end = float(lost[np.searchsorted(TIMES, OFF_S) - 1])
    assert share.lower < 1 - float(lost[-1]) / end < share.upper
    assert share.upper < 0.97


def test_creep_without_recovery_says_that_a_drift_counts_as_creep() -> None:
    part = TIMES < OFF_S
    found = measure_creep(recorded(TIMES[part], EXTENSION[part]))
    assert found.recovered_share is None
    assert found.recovery_s is None
    assert any("counts as creep" in w for w in found.warnings)
    assert found.end_mm.value == pytest.approx(float(EXTENSION[part][-1]), rel=3e-3)


def test_a_record_that_begins_with_the_load_is_taken_from_zero() -> None:
    part = TIMES > ON_S + RAMP_S
    found = measure_creep(recorded(TIMES[part], EXTENSION[part] - 0.7))
    assert any("begins with the load on" in w for w in found.warnings)
    assert film(found).k0 == pytest.approx(SOLID.k0, rel=0.02)


@pytest.mark.parametrize("load", [0.1, 0.5])
def test_the_way_of_a_film_under_one_load_all_the_time_is_not_left_to_rounding(load: float) -> None:
    """A load that never changes has no covariance with anything: the sign came from its last bits, and half of these crashed."""
    part = (TIMES > ON_S + RAMP_S) & (TIMES < OFF_S)
    force = load + np.random.default_rng(0 if load < 0.3 else 1).normal(0, 1e-3, part.sum())
    found = measure_creep(with_force(recorded(TIMES[part], EXTENSION[part] * load / 0.3 - 0.7), force))
    assert found.retardation.sign == 1
    assert film(found).k0 == pytest.approx(SOLID.k0, rel=0.05)


def with_force(record: Recording, force: Float) -> Recording:
    """The record with another force."""
    return replace(record, channels={**record.channels, "force": replace(record.channels["force"], values=force)})


@pytest.mark.parametrize("offset", [-0.5, 0.5])
def test_a_load_cell_that_is_not_tared_is_read_from_its_rest(offset: float) -> None:
    record = recorded()
    tared, untared = measure_creep(record), measure_creep(with_force(record, record.channels["force"].values + offset))
    assert untared.load_n == pytest.approx(tared.load_n, rel=1e-6)
    assert untared.end_mm.value == pytest.approx(tared.end_mm.value, rel=1e-6)
    assert untared.recovered_share.value == pytest.approx(tared.recovered_share.value, rel=1e-6)
    assert any("taken for its zero" in w for w in untared.warnings)


def test_a_second_level_of_load_is_no_creep_under_the_first() -> None:
    """0.3 N from 10 s, 0.6 N from 310 s on: by superposition."""
    second = 300.0
    time_s = np.sort(np.concatenate([TIMES[TIMES < OFF_S - 10], second + TIMES[(TIMES > ON_S) & (TIMES < 200)]]))
    later = np.where(time_s >= second, np.interp(time_s - second, TIMES, EXTENSION), 0.0)
    load = load_of(time_s) + np.where(time_s >= second, load_of(time_s - second), 0.0)
    found = measure_creep(with_force(recorded(time_s, extension_of(time_s) + later), load))
    assert found.load_n == pytest.approx(0.3, rel=0.01)
    assert found.end_mm.value == pytest.approx(float(np.interp(second + ON_S, TIMES, EXTENSION)), rel=0.01)
    assert found.recovered_share is None
    assert any("goes on from" in w for w in found.warnings)


def test_a_load_that_is_not_held_is_refused() -> None:
    time = np.arange(0, 60, 0.1)
    with pytest.raises(NotIdentifiableError, match="held nowhere"):
        find_holds(time, time / 60)
    early = time[time < ON_S]
    with pytest.raises(NotIdentifiableError, match="does not change"):
        measure_creep(recorded(early, 0 * early))


CAMPAIGN = """
name = "creep"
seed = 8
started_at = 2026-03-01T08:00:00+01:00
[rigs.stage]
clamp_mass_kg = 0.05
load_cell_stiffness_n_per_mm = 20.0
damping_ratio = 0.05
load_cell_range_n = 20.0
[rigs.stage.channels.displacement]
low = -20
high = 20
noise_sd = 2e-4
[rigs.stage.channels.force]
low = -2
high = 2
noise_sd = 2e-4
[materials.film]
k0_n_per_mm = 0.4
k_n_per_mm = [0.06, 0.05]
tau_s = [50.0, 2.0]
[specimens.C-1]
rig = "stage"
material = "film"
pretension_n = 0.0
[specimens.C-1.geometry]
film_length_mm = 20.0
film_width_mm = 10.0
film_thickness_mm = 1.0
stretch_1 = 1.0
[[recordings]]
test = "creep"
specimens = ["C-1"]
id = "creep"
format = "csv"
sample_rate_hz = 20
load_n = 0.3
hold_s = 400
recovery_s = 400
drift_mm_per_h = 0.01
"""


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Lab:
    """A night over one creep test on the virtual rig: a specimen that has nothing else."""
    folder = tmp_path_factory.mktemp("creep")
    (folder / "creep.toml").write_text(CAMPAIGN, encoding="utf-8")
    assert main(["simulate", str(folder / "creep.toml"), "--out", str(folder / "raw")]) == 0
    assert main(["nightly", str(folder / "raw"), "--lab", str(folder / "lab"), "--jobs", "0"]) == 0
    return Lab(folder / "lab")


@pytest.mark.slow
def test_a_night_measures_creep_on_the_virtual_rig(lab: Lab) -> None:
    (row,) = lab.sql("SELECT * FROM creep_tests").to_dict("records")
    assert row["model_order"] == 2
    assert row["load_cell_mm_per_n"] == pytest.approx(1 / 20)
    assert row["recovered_share_lower"] < 1 - 1e-4 < row["recovered_share_upper"]
    assert row["drift_mm_per_h_lower"] < 0.01 < row["drift_mm_per_h_upper"]
    (fit,) = lab.sql("SELECT * FROM creep_fits WHERE selected").to_dict("records")
    assert abs(fit["k0_n_per_mm"] - 0.4) < 4 * fit["k0_n_per_mm_sd"]
    assert fit["k0_n_per_mm"] == pytest.approx(0.4, rel=0.01)
    arms = json.loads(fit["arms"])
    assert [arm["tau_s"] for arm in arms] == pytest.approx([50, 2], rel=0.1)
    assert [arm["k_n_per_mm"] for arm in arms] == pytest.approx([0.06, 0.05], rel=0.1)
    assert lab.sql("SELECT * FROM without_result").empty
    (notes,) = lab.sql("SELECT notes FROM recordings")["notes"]
    assert NOT_ASKED in notes


@pytest.mark.slow
def test_the_page_shows_what_comes_back(lab: Lab) -> None:
    pages = list((lab.folder / "reports" / "specimens").glob("*.html"))
    (page,) = [p for p in pages if "Creep and recovery" in p.read_text(encoding="utf-8")]
    text = page.read_text(encoding="utf-8")
    assert "the film gives way by 0.7" in text
    assert "of it comes back" in text
    assert "Displacement of creep after each change of the load" in text


@pytest.mark.slow
def test_creep_without_a_mapping_is_recognised(lab: Lab) -> None:
    source = Path(lab.sql("SELECT source_path FROM recordings")["source_path"][0])
    bare = lab.folder / "bare.csv"
    bare.write_bytes(source.read_bytes())
    draft = make_draft(bare)
    assert (draft.content["recording"]["protocol"], draft.content["recording"]["loading"]) == ("creep", "mechanical")
