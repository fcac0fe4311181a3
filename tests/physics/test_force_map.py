"""Force maps: the thesis' numbers, records written by hand, and what the statistics can and cannot say."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import chi2
from scipy.stats import t as student

from pipeline.analyse.groups import force_map_tables
from pipeline.fit.force.comparisons import compare_forces
from pipeline.fit.force.force_map import fit_force_map, fit_force_maps
from pipeline.fit.force.points import force_per_permittivity, force_points
from pipeline.transform.force_map import ForceMapReadings, ForceReading, measure_force_map
from pipeline.transform.static_force import fit_static_force
from reports.pages.specimen.force import finding
from schemas.errors import NotIdentifiableError
from schemas.metadata import RecordingMetadata, RigConstants
from schemas.recording import Channel, Recording
from schemas.tables import TABLES
from tests.studies.study_static_force import DRIFTS, try_once

ACTIVE = {"thickness_mm": 1.0, "active_length_mm": 30.0, "active_width_mm": 30.0}
E0 = 8.8541878e-6


@pytest.mark.parametrize(
    ("drawn", "direction", "force", "measured", "needed"),
    [
        ("undeformed", 1, 0.661, 0.35, 2.49),
        ("undeformed", 2, 0.264, 0.17, 3.02),
        ("stretched", 1, 0.220, 0.35, 7.47),
        ("stretched", 2, 0.220, 0.17, 3.63),
    ],
)
def test_thesis_numbers(drawn: str, direction: int, force: float, measured: float, needed: float) -> None:
    """7 kV, 30 × 30 mm, 1 mm, stretches (1.2, 3): force at εr = 4.7, and the εr that the measured force needs."""
    unit = force_per_permittivity(direction, 7.0, 1.2, 3.0, drawn=drawn, **ACTIVE)
    assert f"{4.7 * unit:.3f}" == f"{force:.3f}"
    assert f"{measured / unit:.2f}" == f"{needed:.2f}"


def test_ratio_of_the_directions() -> None:
    for stretch_2 in (1.5, 2.0, 3.0):
        f1, f2 = (force_per_permittivity(d, 7.0, 1.2, stretch_2, drawn="undeformed", **ACTIVE) for d in (1, 2))
        assert f1 / f2 == pytest.approx(stretch_2 / 1.2)
    with pytest.raises(ValueError, match="neither"):
        force_per_permittivity(1, 7.0, 1.2, 3.0, drawn="somewhere", **ACTIVE)


def recording(
    *,
    cycles: int = 5,
    forces: tuple[float, float] = (0.35, 0.17),
    scatter: float = 0.0,
    drift: float = 0.0,
    noise: float = 1e-3,
    seed: int = 0,
    **keys: Any,
) -> Recording:
    """Voltage on for 3 s, off for 3 s; each cycle with a force of its own; the tension relaxes by `drift` N/s."""
    rng = np.random.default_rng(seed)
    t = np.arange(0, 2 + 6.0 * cycles, 0.005)
    phase = (t - 2) % 6.0
    cycle = np.clip(((t - 2) // 6).astype(int), 0, cycles - 1)
    on = (t >= 2) & (phase < 3.0)
    tau = 0.02
    share = np.where(on, 1 - np.exp(-phase / tau), np.where(t > 2, np.exp(-(phase - 3) / tau), 0.0))
    share = np.where(t < 2, 0.0, share)
    voltage = 7.0 * np.sqrt(share)
    channels = {"voltage": voltage + rng.normal(0, 5e-3, t.size)}
    for direction, force in enumerate(forces, start=1):
        levels = force * (1 + scatter * rng.standard_normal(cycles))
        channels[f"force_{direction}"] = 2.0 - drift * t - levels[cycle] * share + rng.normal(0, noise, t.size)
    given = {
        "recording_id": "map-1",
        "specimen_id": "BX-1",
        "configuration": "conventional",
        "stretch_1": 1.2,
        "stretch_2": 3.0,
        "film_thickness_mm": 1.0,
        "active_length_mm": 30.0,
        "active_width_mm": 30.0,
        "active_drawn": "undeformed",
        "relative_permittivity": 4.7,
    } | keys
    metadata = RecordingMetadata(
        protocol="force_map", loading="electrical", started_at=datetime(2026, 3, 1, tzinfo=UTC), **given
    )
    stamps = np.round(t * 1e9).astype(np.int64)
    return Recording(
        metadata, RigConstants(), {name: Channel(name, stamps, values) for name, values in channels.items()}
    )


def test_a_cycle_that_begins_with_the_record_is_left_out_aloud() -> None:
    """Its force stood in the level before the next cycle, and nothing told that it gave no reading."""
    whole = recording(cycles=3, noise=1e-3)
    channels = {
        name: replace(channel, time_ns=channel.time_ns[500:], values=channel.values[500:])
        for name, channel in whole.channels.items()
    }
    found = measure_force_map(replace(whole, channels=channels))
    assert [(r.direction, r.cycle) for r in found.readings] == [(1, 2), (1, 3), (2, 2), (2, 3)]
    for direction, force in ((1, 0.35), (2, 0.17)):
        readings = [r for r in found.readings if r.direction == direction]
        np.testing.assert_allclose([r.force_n for r in readings], force, atol=1e-3)
        assert all(r.force_sd_n < 1e-3 for r in readings)
        assert any(f"force_{direction}: cycle 1 begins with the record" in w for w in found.warnings)


def test_readings_of_a_record() -> None:
    found = measure_force_map(recording())
    for direction, force in ((1, 0.35), (2, 0.17)):
        readings = [r for r in found.readings if r.direction == direction]
        assert [r.cycle for r in readings] == [1, 2, 3, 4, 5]
        np.testing.assert_allclose([r.force_n for r in readings], force, atol=1e-3)
        np.testing.assert_allclose([r.voltage_kv for r in readings], 7.0, atol=0.01)
    assert (found.stretch_1, found.stretch_2, found.stated_permittivity) == (1.2, 3.0, 4.7)


@pytest.mark.long
@pytest.mark.slow
def test_relaxation_of_the_film_is_no_force() -> None:
    found = measure_force_map(recording(drift=0.004))  # 12 mN in each on-phase
    np.testing.assert_allclose([r.force_n for r in found.readings if r.direction == 1], 0.35, atol=2e-3)


def test_one_direction_and_none() -> None:
    complete = recording()
    only = {name: c for name, c in complete.channels.items() if name != "force_2"}
    found = measure_force_map(replace(complete, channels=only))
    assert {r.direction for r in found.readings} == {1}
    assert found.warnings == ("no channel force_2",)
    with pytest.raises(NotIdentifiableError, match="either direction"):
        measure_force_map(replace(complete, channels={"voltage": complete.channels["voltage"]}))
    flat = replace(complete.channels["voltage"], values=np.zeros(complete.channels["voltage"].values.size))
    with pytest.raises(NotIdentifiableError, match="no step"):
        measure_force_map(replace(complete, channels=complete.channels | {"voltage": flat}))


def readings(
    forces_1: list[float], forces_2: list[float] | None = None, *, volts: float = 7.0, **keys: Any
) -> ForceMapReadings:
    given: dict[str, Any] = {
        "recording_id": "r",
        "specimen_id": "BX-1",
        "configuration": "conventional",
        "campaign": None,
        "stretch_1": 1.2,
        "stretch_2": 3.0,
        "layers": 1,
        "film_thickness_mm": 1.0,
        "active_length_mm": 30.0,
        "active_width_mm": 30.0,
        "active_drawn": "undeformed",
        "stated_permittivity": 4.7,
    } | keys
    found = [ForceReading(1, i + 1, f, 1e-3, volts) for i, f in enumerate(forces_1)]
    found += [ForceReading(2, i + 1, f, 1e-3, volts) for i, f in enumerate(forces_2 or [])]
    return ForceMapReadings(readings=tuple(found), **given)


def test_thesis_point_needs_less_than_the_stated_permittivity() -> None:
    spread = 0.01 * np.array([-1.2, -0.5, 0.1, 0.4, 1.2])
    found = readings(list(0.35 + spread), list(0.17 - spread[[2, 0, 4, 1, 3]]))
    points, (fit,) = fit_force_maps([found])
    first, second = points
    assert first.force_n == pytest.approx(0.35)
    assert first.force_sd_n == pytest.approx(np.std(spread, ddof=1))
    assert first.predicted_n == pytest.approx(0.661, abs=5e-4)
    assert first.relative_permittivity.value == pytest.approx(2.49, abs=5e-3)
    assert second.relative_permittivity.value == pytest.approx(3.02, abs=5e-3)
    assert first.relative_permittivity.upper < 3 < 4.7
    half = 2.7764 * np.std(spread, ddof=1) / np.sqrt(5) / (0.661 / 4.7)
    assert first.relative_permittivity.upper - first.relative_permittivity.value == pytest.approx(half, rel=2e-3)
    assert "the 4.7 that the metadata state predicts" in fit.statement
    assert fit.constancy is not None
    assert fit.constancy.direction_p_value < 0.01
    assert np.isnan(fit.constancy.p_value)
    assert "no one value serves the map" in fit.statement


def campaign(
    rng: np.random.Generator,
    *,
    falling: float = 0.0,
    absolute: float = 0.0,
    relative: float = 0.0,
    painted: float = 0.0,
) -> list[ForceMapReadings]:
    """Map over λ2 from 1.5 to 3 by the thesis' equation written out, εr = 2.8 at λ1λ2 = 2.7 and `falling` with it."""
    found = []
    for stretch_2 in np.arange(1.5, 3.01, 0.25):
        permittivity = 2.8 - falling * (1.2 * stretch_2 - 2.7)
        f1 = E0 * permittivity * 49 * 30 * 1.2 * stretch_2**2
        f2 = E0 * permittivity * 49 * 30 * 1.2**2 * stretch_2
        electrode = 1 + painted * rng.standard_normal(5)  # both directions read the same electrode
        draws = [
            electrode * f * (1 + relative * rng.standard_normal(5)) + absolute * rng.standard_normal(5)
            for f in (f1, f2)
        ]
        found.append(readings(*(list(d) for d in draws), stretch_2=float(stretch_2), recording_id=f"map-{stretch_2}"))
    return found


@pytest.mark.study
@pytest.mark.parametrize("scatter", [{"absolute": 0.008}, {"relative": 0.04}, {"painted": 0.04, "relative": 0.002}])
def test_constancy_keeps_its_level_and_the_interval_its_coverage(scatter: dict[str, float]) -> None:
    rng = np.random.default_rng(seed=1)
    rejected, held, runs = np.zeros(2), 0, 200
    for _ in range(runs):
        fit = fit_force_map(force_points(campaign(rng, **scatter)))
        assert fit.constancy is not None
        rejected += np.array([fit.constancy.p_value < 0.05, fit.constancy.direction_p_value < 0.05])
        held += fit.relative_permittivity.lower <= 2.8 <= fit.relative_permittivity.upper
    assert np.all(rejected / runs <= 0.09)
    assert held / runs >= 0.91


def test_falling_permittivity_is_found_with_its_slope() -> None:
    fit = fit_force_map(force_points(campaign(np.random.default_rng(seed=2), falling=0.4, relative=0.02)))
    assert fit.constancy is not None
    assert fit.constancy.p_value < 1e-3
    assert fit.constancy.slope.lower <= -0.4 <= fit.constancy.slope.upper < 0
    assert "per unit of area stretch" in fit.statement


def test_two_directions_far_apart_have_no_one_permittivity() -> None:
    """Two points that differ by far more than their repeats leave an interval that holds 0: nothing to be stated, or headlined."""
    spread = 1e-3 * np.array([-1.2, -0.5, 0.1, 0.4, 1.2])
    points, (fit,) = fit_force_maps([readings(list(0.25 + spread), list(0.20 + spread))])
    assert fit.relative_permittivity.lower <= 0
    assert fit.statement.replace("\xa0", " ").startswith(
        "2 points, too far apart for one relative permittivity; no one value serves the map"
    )
    record = {
        "relative_permittivity": fit.relative_permittivity.value,
        "relative_permittivity_lower": fit.relative_permittivity.lower,
        "relative_permittivity_upper": fit.relative_permittivity.upper,
        "stated_permittivity": 4.7,
    }
    forces = [{"force_n": p.force_n, "force_sd_n": p.force_sd_n} for p in points]
    assert finding(forces, [record]).endswith("; no one permittivity explains it")
    assert "permittivity of 2.4" in finding(
        forces, [record | {"relative_permittivity": 2.4, "relative_permittivity_lower": 2.3}]
    )


def test_noise_free_map_is_exact() -> None:
    points = force_points(campaign(np.random.default_rng(seed=0)))
    values = [p.relative_permittivity.value for p in points]
    np.testing.assert_allclose(values, 2.8, rtol=1e-12)
    assert fit_force_map(points).relative_permittivity.value == pytest.approx(2.8, rel=1e-12)


def test_repeats_in_several_recordings_are_one_point() -> None:
    parts = [readings([0.34]), readings([0.36]), readings([0.35])]
    (point,) = force_points(parts)
    assert (point.repeats, point.force_n) == (3, pytest.approx(0.35))
    other = force_points([*parts, readings([0.25], volts=6.0)])
    assert [p.voltage_kv for p in other] == [6.0, 7.0]


def test_single_reading_has_only_its_noise() -> None:
    (point,) = force_points([readings([0.35])])
    assert np.isnan(point.force_sd_n)
    assert point.relative_permittivity.lower < point.relative_permittivity.value
    assert any("one reading" in text for text in point.warnings)
    fit = fit_force_map([point])
    assert fit.constancy is None
    assert any("constancy cannot be tested" in text for text in fit.warnings)


def test_missing_geometry_gives_force_without_permittivity() -> None:
    points, fits = fit_force_maps([readings([0.35, 0.36], film_thickness_mm=None)])
    assert fits == ()
    assert points[0].force_n == pytest.approx(0.355)
    assert np.isnan(points[0].predicted_n)
    assert points[0].warnings == ("no permittivity: film_thickness_mm missing",)
    (unsaid,) = force_points([readings([0.35, 0.36], active_drawn=None)])
    assert any("active_drawn missing" in text for text in unsaid.warnings)
    assert force_points([readings([0.35], stretch_1=None)]) == ()
    (stack,) = force_points([readings([0.35, 0.36], film_thickness_mm=10.0, layers=10)])
    assert stack.relative_permittivity.value == pytest.approx(points[0].force_n / 10 / (0.661 / 4.7), rel=1e-3)


def test_rods_against_conventional() -> None:
    spread = 0.01 * np.array([-1.2, -0.5, 0.1, 0.4, 1.2])
    maps = [
        readings(list(0.32 + spread), configuration="conventional"),
        readings(list(0.45 + spread), configuration="rods", specimen_id="RP-1"),
    ]
    (found,) = compare_forces(force_points(maps))
    assert (found.configuration_a, found.configuration_b) == ("conventional", "rods")
    assert found.difference_n.value == pytest.approx(0.13)
    assert 0.11 < found.difference_n.lower < 0.13 < found.difference_n.upper < 0.15
    assert found.ratio.value == pytest.approx(0.45 / 0.32, rel=1e-3)
    assert found.ratio.lower > 1.3
    assert found.p_value < 1e-4
    assert "the interval is that of repeats" in found.warnings[0]


def test_divided_against_single_over_specimens() -> None:
    rng = np.random.default_rng(seed=5)
    maps = []
    for configuration, mean in (("single", 0.20), ("divided", 0.188)):
        for i in range(5):
            level = mean + rng.normal(0, 0.002)
            maps.append(
                readings(
                    list(level + rng.normal(0, 0.01, 5)),
                    configuration=configuration,
                    specimen_id=f"{configuration}-{i}",
                )
            )
    (found,) = compare_forces(force_points(maps))
    assert (found.specimens_a, found.specimens_b) == (5, 5)
    assert found.warnings == ()
    assert found.ratio.lower < 1 / 0.94 < found.ratio.upper
    means = [[p.force_n for p in force_points(maps) if p.configuration == name] for name in ("divided", "single")]
    from scipy import stats

    welch = stats.ttest_ind(means[1], means[0], equal_var=False)
    assert found.p_value == pytest.approx(welch.pvalue)
    assert found.difference_n.lower == pytest.approx(welch.confidence_interval().low)


def test_other_stretch_or_voltage_is_not_compared() -> None:
    a = readings([0.3, 0.31])
    assert compare_forces(force_points([a, readings([0.4, 0.41], configuration="rods", stretch_2=2.5)])) == ()
    assert compare_forces(force_points([a, readings([0.4, 0.41], configuration="rods", volts=6.0)])) == ()
    single = compare_forces(force_points([readings([0.3]), readings([0.4], configuration="rods")]))
    assert np.isnan(single[0].difference_n.lower)
    assert "single readings: no interval" in single[0].warnings


def test_tables() -> None:
    maps = [*campaign(np.random.default_rng(seed=3), relative=0.03), readings([0.45, 0.46], configuration="rods")]
    points, fits = fit_force_maps(maps)
    tables = force_map_tables(points, fits, compare_forces(points))
    for name, table in tables.items():
        assert table.schema == TABLES[name].arrow_schema
    assert tables["force_maps"].num_rows == 15
    assert tables["force_map_fits"].num_rows == 2
    assert tables["force_comparisons"].num_rows == 1
    assert force_map_tables((), (), ())["force_maps"].num_rows == 0


@pytest.mark.long
@pytest.mark.slow
def test_drift_of_the_pre_stretch_is_no_force_and_intervals_cover() -> None:
    """One time of voltage in a film that relaxes by up to a tenth of the force meanwhile, some of which comes slowly."""
    covered, errors = [], []
    for seed in range(24):
        rng = np.random.default_rng(seed)
        on_s, lasts_s, rest_s = rng.uniform(2, 8), rng.uniform(3, 12), rng.uniform(3, 12)
        time = np.arange(0, on_s + lasts_s + rest_s, 0.02)
        force, lag_s, slow = rng.uniform(0.05, 0.5), 10 ** rng.uniform(-0.5, 1.5), rng.choice([0.0, 0.15])
        slow_s, off_s = lasts_s * 10 ** rng.uniform(-1.5, -0.5), on_s + lasts_s
        drift = rng.uniform(0, 0.1) * force / np.log((off_s + lag_s) / (on_s + lag_s))
        while_on = np.where(time >= on_s, 1 - slow * np.exp(-(time - on_s) / slow_s), 0.0)
        after = slow * -np.expm1(-lasts_s / slow_s) * np.exp(-np.maximum(time - off_s, 0) / slow_s)
        tension = 1 - drift * np.log(time + lag_s) - force * np.where(time >= off_s, after, while_on)
        noise = force * rng.uniform(0.002, 0.01)
        found = fit_static_force(time, tension + rng.normal(0, noise, time.size), [(on_s, off_s)], 0.05)
        error = float(found.force_n[0]) - force
        errors.append(error / force)
        covered.append(abs(error) < student.ppf(0.975, found.degrees_of_freedom) * found.force_sd_n[0])
    assert abs(np.mean(errors)) < 2e-3
    assert np.mean(covered) >= 0.9


@pytest.mark.long
@pytest.mark.slow
def test_intervals_of_the_force_hold_where_the_drift_is_no_logarithm() -> None:
    """The root of time and two exponentials, which a logarithm does not follow (`tests/studies/study_static_force.py`)."""
    tried = [try_once(law, np.random.default_rng([36, number])) for number, law in enumerate(DRIFTS[1::2] * 6)]
    assert abs(np.mean([error for error, _ in tried])) < 5e-3
    assert np.mean([holds for _, holds in tried]) > 0.8


@pytest.mark.slow
def test_wanders_that_no_record_needs_hardly_widen_the_interval() -> None:
    """Of a drift that is a logarithm of time they made it a third wider than that of who knows that it is one."""
    wider = []
    for seed in range(8):
        rng, time = np.random.default_rng(seed), np.arange(0, 30, 0.02)
        on = (time >= 10) & (time < 20)
        tension = 1 - 0.02 * np.log(time + 1) - 0.3 * on + rng.normal(0, 1e-3, time.size)
        found = fit_static_force(time, tension, [(10, 20)], 0.05)
        seen = time[(time > 0.05) & ~((np.abs(time - 10.025) < 0.025) | (np.abs(time - 20.025) < 0.025))]
        since = seen + 1.0
        design = np.column_stack([np.ones(seen.size), np.log(since), 1 / since, (seen >= 10) & (seen < 20)])
        known = 1e-3 * np.sqrt(np.linalg.inv(design.T @ design)[3, 3])
        wider.append(found.force_sd_n[0] / known)
    assert 1.0 < np.mean(wider) < 1.25


@pytest.mark.long
@pytest.mark.slow
def test_noise_that_remembers_makes_no_interval_too_narrow() -> None:
    """Neighbouring samples go together over 0.2 s, as long as a window: their means are not independent."""
    square = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        time = np.arange(0, 15, 0.02)
        noise = lfilter([np.sqrt(1 - 0.9**2)], [1, -0.9], rng.normal(0, 1, time.size + 200))[200:]
        tension = 1 - 0.3 * ((time >= 5) & (time < 10)) + 0.003 * noise
        found = fit_static_force(time, tension, [(5.0, 10.0)], 0.05)
        square.append(((found.force_n[0] - 0.3) / found.force_sd_n[0]) ** 2)
    assert sum(square) < chi2.ppf(0.95, 12)  # 29 where windows were taken as independent
