"""Strokes at constant load against the equations of springs and dampers, and a rig that lifts a load."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lsim

from ingest.draft import make_draft
from pipeline import Lab
from pipeline.cli import main
from pipeline.fit.retardation.isotonic import Isotonic, measure_isotonic
from schemas.arrays import Float
from schemas.errors import NotIdentifiableError
from schemas.metadata import RecordingMetadata, RigConstants
from schemas.recording import Channel, Recording

K0, K, TAU = 0.4, np.array([0.08, 0.05]), np.array([12.0, 0.8])
"""N/mm and s."""
PER_SQUARE = 0.02
"""Actuation force over V², N/kV²."""
LEVELS = (1.0, 1.5, 2.0, 2.5)
ON_S, OFF_S, REST_S = 30.0, 60.0, 5.0
TIME = np.arange(0, REST_S + len(LEVELS) * (ON_S + OFF_S), 0.05)


def voltage_of(time_s: Float, levels: tuple[float, ...] = LEVELS) -> Float:
    since = time_s - REST_S
    number = np.floor(since / (ON_S + OFF_S)).astype(int)
    on = (since >= 0) & (since - number * (ON_S + OFF_S) < ON_S)
    return np.where(on, np.array(levels)[number.clip(0, len(levels) - 1)], 0.0)


def moved_by(load: Float, time_s: Float = TIME) -> Float:
    """Displacement by the internal points of the arms, ẋᵢ = (x − xᵢ)/τᵢ, not by retardation times."""
    total = K0 + K.sum()
    a = np.outer(1 / TAU, K / total) - np.diag(1 / TAU)
    b = (1 / TAU / total)[:, None]
    system = (a, b, (K / total)[None, :], np.array([[1 / total]]))
    return np.asarray(lsim(system, load, time_s, interp=True)[1])


def recorded(
    *,
    voltage: Float | None = None,
    stroke: Float | None = None,
    force: float | None = 1.0,
    force_change: float = 0.0,
    walk: float = 0.0,
    seed: int = 0,
    **metadata: object,
) -> Recording:
    rng = np.random.default_rng(seed)
    voltage = voltage_of(TIME) if voltage is None else voltage
    stroke = moved_by(PER_SQUARE * voltage**2) if stroke is None else stroke
    wander = np.cumsum(rng.normal(0, np.sqrt(walk * 0.05), TIME.size))
    values = {
        "voltage": voltage + rng.normal(0, 1e-3, TIME.size),
        "displacement": 3.0 + stroke + wander + rng.normal(0, 5e-4, TIME.size),
    }
    if force is not None:
        values["force"] = force + force_change * (voltage > 0.1) + rng.normal(0, 1e-3, TIME.size)
    units = {"voltage": "kV", "displacement": "mm", "force": "N"}
    ns = np.round(TIME * 1e9).astype(np.int64) + 1_700_000_000_000_000_000
    about = {
        "recording_id": "lift",
        "protocol": "isotonic",
        "loading": "electrical",
        "specimen_id": "D-1",
        "started_at": "2024-01-01T00:00:00+00:00",
        "film_length_mm": 20.0,
        "film_width_mm": 10.0,
        "film_thickness_mm": 0.5,
        "stretch_1": 1.2,
        **metadata,
    }
    channels = {q: Channel(quantity=q, unit=units[q], time_ns=ns, values=v) for q, v in values.items()}
    return Recording(metadata=RecordingMetadata.parse(about), rig=RigConstants(), channels=channels)


def truth(level: float) -> tuple[float, float]:
    """Stroke after `ON_S` from rest and its part at once, mm."""
    time = np.arange(0, ON_S, 0.005)
    whole = moved_by(np.full(time.size, PER_SQUARE * level**2), time)
    return float(whole[-1]), PER_SQUARE * level**2 / (K0 + K.sum())


def test_strokes_are_those_of_a_film_that_starts_from_rest() -> None:
    found = measure_isotonic(recorded(walk=1e-8))
    assert [s.voltage_kv for s in found.strokes] == pytest.approx(LEVELS, rel=1e-3)
    for one in found.strokes:
        whole, instant = truth(one.voltage_kv)
        assert one.stroke_mm.lower < whole < one.stroke_mm.upper
        assert one.instant_mm.value == pytest.approx(instant, rel=0.02, abs=2e-4)
        assert one.slow_mm.value == pytest.approx(whole - instant, rel=0.15, abs=5e-4)
        assert one.stroke_mm.value == pytest.approx(one.instant_mm.value + one.slow_mm.value)
    assert found.mm_per_kv2.value == pytest.approx(truth(1.0)[0], rel=0.01)
    assert found.exponent is not None
    assert found.exponent.lower < 2 < found.exponent.upper
    assert found.p_value is not None
    assert found.p_value > 0.001
    assert found.load_n == pytest.approx(1.0, abs=1e-3)
    assert found.warnings == ()


def test_free_strain_and_coefficient_are_those_of_the_film_under_load() -> None:
    found = measure_isotonic(recorded())
    stroke = truth(LEVELS[-1])[0]
    assert found.free_strain is not None
    assert found.free_strain.value == pytest.approx(stroke / 24.0, rel=0.01)
    thickness = 0.5 / np.sqrt(1.2)  # stretched 1.2 along, free across
    field = LEVELS[-1] / thickness
    assert found.strain_per_field_squared is not None
    assert found.strain_per_field_squared.value == pytest.approx(stroke / 24.0 / field**2, rel=0.01)


@pytest.mark.long
def test_intervals_hold_the_strokes_while_the_sensor_wanders() -> None:
    held: list[bool] = []
    for seed in range(12):
        for one in measure_isotonic(recorded(walk=1e-6, seed=seed)).strokes:
            whole, _ = truth(one.voltage_kv)
            held.append(one.stroke_mm.lower <= whole <= one.stroke_mm.upper)
    assert np.mean(held) >= 0.85  # 95 % of 48, which hang together in fours


def test_an_actuator_that_contracts_has_negative_strokes() -> None:
    stroke = -moved_by(PER_SQUARE * voltage_of(TIME) ** 2)
    found = measure_isotonic(recorded(stroke=stroke))
    for one in found.strokes:
        assert one.stroke_mm.value == pytest.approx(-truth(one.voltage_kv)[0], rel=0.02, abs=5e-4)
    assert found.mm_per_kv2.upper < 0


def test_strokes_that_do_not_go_with_the_square_are_told() -> None:
    voltage = voltage_of(TIME)
    found = measure_isotonic(recorded(stroke=moved_by(PER_SQUARE * voltage**3)))
    assert found.p_value is not None
    assert found.p_value < 0.01
    assert found.exponent is not None
    assert found.exponent.value == pytest.approx(3, abs=0.1)
    assert any("do not go with V²" in w for w in found.warnings)


def ringing(load: Float) -> Float:
    """The same film with 1 kg hanging on it: rings at 3.5 Hz after each edge, for about two seconds."""
    mass, damping, total = 1e-3, 5e-3, K0 + K.sum()
    a = np.zeros((4, 4))
    a[0, 1] = 1.0
    a[1] = [-total / mass, -damping / mass, *(K / mass)]
    a[2:, 0] = 1 / TAU
    a[2:, 2:] = -np.diag(1 / TAU)
    system = (a, np.array([[0.0], [1 / mass], [0.0], [0.0]]), np.array([[1.0, 0, 0, 0]]), np.zeros((1, 1)))
    return np.asarray(lsim(system, load, TIME, interp=False)[1])


def test_a_load_that_rings_and_a_law_that_saturates_leave_the_strokes_right() -> None:
    """As of a pouch that zips: with one law in V² for all levels the intervals were as wide as the strokes."""
    drive = 0.1 * -np.expm1(-((voltage_of(TIME) / 1.5) ** 3))
    found = measure_isotonic(recorded(stroke=ringing(drive)))
    for one in found.strokes:
        reached = 0.1 * -np.expm1(-((one.voltage_kv / 1.5) ** 3))
        whole = truth(1.0)[0] * reached / PER_SQUARE
        assert one.stroke_mm.lower < whole < one.stroke_mm.upper
        assert one.stroke_mm.upper - one.stroke_mm.lower < 0.02 * whole + 0.004
    assert found.p_value is not None
    assert found.p_value < 0.01
    assert any("rings with its load" in w for w in found.warnings)
    assert 0.5 < found.instant_within_s < 6


def test_the_load_is_that_of_the_channel_or_of_the_metadata() -> None:
    assert measure_isotonic(recorded(force=None, load_n=0.49)).load_n == 0.49
    without = measure_isotonic(recorded(force=None))
    assert without.load_n is None
    assert any("which load" in w for w in without.warnings)
    changing = measure_isotonic(recorded(force_change=-0.2))
    assert any("not constant" in w for w in changing.warnings)
    assert changing.load_change_n == pytest.approx(-0.2, abs=1e-3)


def test_a_load_that_moves_by_itself_is_told() -> None:
    """It went from 1 to 1.45 N in steps, and the page spoke of strokes at a constant load."""
    still = recorded()
    force = still.channels["force"]
    stairs = force.values + 0.15 * np.floor(4 * TIME / TIME[-1])
    moving = replace(still, channels={**still.channels, "force": replace(force, values=stairs)})
    assert any("goes from 1 to 1.45 N without voltage" in w for w in measure_isotonic(moving).warnings)
    assert not any("not constant" in w for w in measure_isotonic(still).warnings)


def test_steps_up_without_a_return_are_a_staircase() -> None:
    number = np.clip(((TIME - REST_S) // (ON_S + OFF_S)).astype(int), 0, len(LEVELS) - 1)
    voltage = np.where(TIME < REST_S, 0.0, np.array(LEVELS)[number])
    found: Isotonic = measure_isotonic(recorded(voltage=voltage))
    assert [s.voltage_kv for s in found.strokes] == pytest.approx(LEVELS, rel=1e-3)
    assert found.mm_per_kv2.value == pytest.approx(PER_SQUARE / K0, rel=0.03)
    assert any("counts as creep" in w for w in found.warnings)


def test_a_voltage_that_is_not_held_is_refused() -> None:
    with pytest.raises(NotIdentifiableError, match="voltage is held nowhere"):
        measure_isotonic(recorded(voltage=np.abs(np.sin(TIME / 9)) * 2))


CAMPAIGN = """
name = "isotonic"
seed = 8
started_at = 2026-03-01T08:00:00+01:00
[rigs.hoist]
clamp_mass_kg = 0.05
load_cell_stiffness_n_per_mm = 200.0
damping_ratio = 0.05
load_cell_range_n = 20.0
[rigs.hoist.channels.displacement]
low = -20
high = 20
noise_sd = 2e-4
[rigs.hoist.channels.force]
low = -2
high = 2
noise_sd = 2e-4
[materials.film]
k0_n_per_mm = 0.2
k_n_per_mm = [0.05, 0.04]
tau_s = [8.0, 0.6]
relative_permittivity = 4.7
[specimens.D-1]
rig = "hoist"
material = "film"
pretension_n = 0.8
[specimens.D-1.geometry]
film_length_mm = 20.0
film_width_mm = 30.0
film_thickness_mm = 0.5
stretch_1 = 1.2
active_width_mm = 30.0
active_length_mm = 24.0
active_drawn = "stretched"
[[recordings]]
test = "isotonic"
specimens = ["D-1"]
id = "lift"
format = "csv"
sample_rate_hz = 50
levels_kv = [2.0, 4.0, 6.0]
on_s = 15
off_s = 30
"""


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Lab:
    """A night over one test at constant load on the virtual rig: a specimen that has nothing else."""
    folder = tmp_path_factory.mktemp("isotonic")
    (folder / "lift.toml").write_text(CAMPAIGN, encoding="utf-8")
    assert main(["simulate", str(folder / "lift.toml"), "--out", str(folder / "raw")]) == 0
    assert main(["nightly", str(folder / "raw"), "--lab", str(folder / "lab"), "--jobs", "0"]) == 0
    return Lab(folder / "lab")


@pytest.mark.long
@pytest.mark.slow
def test_a_night_measures_strokes_on_the_virtual_rig(lab: Lab) -> None:
    (row,) = lab.sql("SELECT * FROM isotonic_tests").to_dict("records")
    assert row["load_n"] == pytest.approx(0.8, abs=1e-3)
    assert row["exponent_lower"] < 2 < row["exponent_upper"]
    strokes = lab.sql("SELECT * FROM isotonic_strokes ORDER BY voltage_kv").to_dict("records")
    assert [s["voltage_kv"] for s in strokes] == pytest.approx([2, 4, 6], rel=1e-2)
    # ε0 εr w/z V² on a spring of 0.2 + 0.05 + 0.04 N/mm at once
    force = 8.8541878e-6 * 4.7 * 30.0 / (0.5 / np.sqrt(1.2)) * 6.0**2
    assert strokes[-1]["instant_mm"] == pytest.approx(force / 0.29, rel=0.03)
    assert force / 0.29 < strokes[-1]["stroke_mm"] < force / 0.2
    assert lab.sql("SELECT * FROM without_result").empty


@pytest.mark.slow
def test_the_page_shows_the_strokes(lab: Lab) -> None:
    pages = list((lab.folder / "reports" / "specimens").glob("*.html"))
    (page,) = [p for p in pages if "Strokes at constant load" in p.read_text(encoding="utf-8")]
    text = page.read_text(encoding="utf-8")
    assert "the film moves 0.8" in text
    assert "Strokes of lift over the squared voltage" in text


@pytest.mark.slow
def test_strokes_without_a_mapping_are_recognised(lab: Lab) -> None:
    source = Path(lab.sql("SELECT source_path FROM recordings")["source_path"][0])
    bare = lab.folder / "bare.csv"
    bare.write_bytes(source.read_bytes())
    draft = make_draft(bare)
    assert (draft.content["recording"]["protocol"], draft.content["recording"]["loading"]) == ("isotonic", "electrical")
