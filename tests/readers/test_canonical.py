"""From raw to canonical: units once, required channels, time, lost samples, ranges, dead sensors."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from ingest.canonical import canonical
from ingest.timing import uneven
from pipeline.transform.channels import drive
from schemas.errors import RefusedError
from schemas.metadata import RecordingMetadata, known_keys
from schemas.protocols import KEYS_OF_TESTS, PROTOCOLS
from schemas.recording import RawChannel, RawRecording, Recording

START = 1_772_373_600_000_000_000
METADATA: dict[str, Any] = {
    "recording_id": "r1",
    "protocol": "cyclic",
    "loading": "mechanical",
    "specimen_id": "s1",
    "started_at": "2026-03-01T14:00:00+00:00",
}
N = 100


def channel(
    quantity: str,
    unit: str,
    values: Any = None,
    *,
    start: int = START,
    step: int = 1_000_000,
    times: Any = None,
    **metadata: str,
) -> RawChannel:
    values = np.sin(np.arange(N) / 5) if values is None else np.asarray(values, dtype=float)
    times = (
        start + step * np.arange(values.size, dtype=np.int64) if times is None else np.asarray(times, dtype=np.int64)
    )
    return RawChannel(quantity, unit, times, values, metadata)


def check(*channels: RawChannel, rig: dict[str, Any] | None = None, **metadata: Any) -> Recording:
    return canonical(RawRecording(METADATA | metadata, rig or {}, channels), where="r1.csv")


GOOD = (channel("displacement", "mm"), channel("force", "N"))


@pytest.mark.parametrize(
    ("quantity", "unit", "value", "expected"),
    [
        ("force", "mN", 1500.0, 1.5),
        ("force", "lbf", 1.0, 4.4482216152605),
        ("force", "gf", 100.0, 0.980665),
        ("force", "kgf", 1.0, 9.80665),
        ("displacement", "m", 0.002, 2.0),
        ("displacement", "µm", 1500.0, 1.5),
        ("displacement", "in", 1.0, 25.4),
    ],
)
def test_units_are_converted(quantity: str, unit: str, value: float, expected: float) -> None:
    values = np.zeros(N)
    values[3] = value
    other = GOOD[0] if quantity == "force" else GOOD[1]
    found = check(channel(quantity, unit, values), other)
    assert found.channels[quantity].values[3] == pytest.approx(expected, rel=1e-12)
    assert found.status == "ok"


@pytest.mark.parametrize("unit", ["mm", "V", "furlongs", "", "N;DROP TABLE", "9**9**9", "µ", "N" * 500])
def test_wrong_units_are_refused(unit: str) -> None:
    with pytest.raises(RefusedError) as refused:
        check(GOOD[0], channel("force", unit))
    assert "force" in str(refused.value)
    assert "converts to N" in refused.value.expected


def test_channel_keys_are_converted() -> None:
    force = channel("force", "mN", resolution="0.5", filter_hz="200", delay_s="0.002", sensor="cell 3")
    found = check(GOOD[0], force).channels["force"]
    assert found.resolution == pytest.approx(0.0005)
    assert (found.filter_hz, found.delay_s, found.sensor) == (200.0, 0.002, "cell 3")


@pytest.mark.parametrize(
    ("key", "text"), [("delay_s", "soon"), ("filter_hz", "0"), ("filter_hz", "inf"), ("resolution", "-1")]
)
def test_malformed_channel_keys_are_named(key: str, text: str) -> None:
    with pytest.raises(RefusedError) as refused:
        check(GOOD[0], channel("force", "N", **{key: text}))
    assert f'force: {key} is "{text}"' in refused.value.problem


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"protocol": "dance"}, 'protocol "dance"'),
        ({"loading": "electrical"}, "loading"),
        ({"recording_id": "../../etc/passwd"}, "recording_id"),
        ({"recording_id": "a" * 81}, "recording_id"),
        ({"recording_id": ""}, "recording_id"),
        ({"started_at": "2026-03-01T14:00:00"}, "started_at"),
        ({"specimen_id": "  "}, "specimen_id"),
        ({"stretch_1": "two"}, "stretch_1"),
        ({"film_length_mm": -1}, "film_length_mm"),
        ({"cycles": 2.5}, "cycles"),
    ],
)
def test_metadata_is_checked(changes: dict[str, Any], field: str) -> None:
    with pytest.raises(RefusedError) as refused:
        check(*GOOD, **changes)
    assert field in refused.value.problem
    assert refused.value.where == "r1.csv"


def test_missing_channels_are_named() -> None:
    with pytest.raises(RefusedError, match="required channel force is missing; found: displacement") as refused:
        check(GOOD[0])
    assert "displacement, force or stretch, stress" in refused.value.expected


def test_unknown_channel_is_left_out_with_a_note() -> None:
    found = check(*GOOD, channel("humidity", "%"))
    assert set(found.channels) == {"displacement", "force"}
    assert any("humidity" in note for note in found.notes)


def test_two_channels_of_one_quantity_are_refused() -> None:
    with pytest.raises(RefusedError, match="two channels hold force"):
        check(*GOOD, channel("force", "mN"))


def test_lost_samples_become_nan_and_a_problem() -> None:
    values = np.sin(np.arange(N))
    values[[5, 6, 50]] = [np.nan, np.inf, -np.inf]
    found = check(GOOD[0], channel("force", "mN", values))
    assert np.flatnonzero(np.isnan(found.channels["force"].values)).tolist() == [5, 6, 50]
    assert found.status == "damaged"
    assert "3 of 100 samples" in found.problems[0]


def test_required_channel_without_a_sample_is_refused_optional_left_out() -> None:
    lost = np.full(N, np.nan)
    with pytest.raises(RefusedError, match="force: none of its 100 samples"):
        check(GOOD[0], channel("force", "N", lost))
    with pytest.raises(RefusedError, match="force: the channel is empty"):
        check(GOOD[0], channel("force", "N", []))
    found = check(*GOOD, channel("capacitance", "pF", lost))
    assert "capacitance" not in found.channels
    assert found.status == "damaged"


def test_time_running_backwards_is_refused_with_place() -> None:
    times = START + 1_000_000 * np.arange(N)
    times[40:] -= 3_600_000_000_000
    with pytest.raises(RefusedError, match=r"sample 41 is 3600 s before sample 40"):
        check(GOOD[0], channel("force", "N", times=times))


def test_samples_told_twice() -> None:
    values = np.sin(np.arange(N))
    twice = np.insert(values, 10, values[10])
    times = np.insert(START + 1_000_000 * np.arange(N), 10, START + 10_000_000)
    found = check(GOOD[0], channel("force", "N", twice, times=times))
    assert found.channels["force"].values.tolist() == values.tolist()
    assert found.status == "ok"
    twice[11] += 1
    contradicted = check(GOOD[0], channel("force", "N", twice, times=times))
    assert contradicted.channels["force"].values[10] == values[10]
    assert contradicted.status == "damaged"


def test_clock_coarser_than_the_sampling_is_refused() -> None:
    times = START + 1_000_000 * (np.arange(N) // 4)
    with pytest.raises(RefusedError, match="75 of 100 samples stand at the same instant"):
        check(GOOD[0], channel("force", "N", times=times))


def test_dead_sensor_is_refused_in_dynamic_tests() -> None:
    with pytest.raises(RefusedError, match=r"force is 0.25 N in all 100 samples \(load cell not connected\?\)"):
        check(GOOD[0], channel("force", "N", np.full(N, 0.25)))


def test_constant_voltage_is_no_fault_in_a_lifetime_test() -> None:
    found = check(channel("voltage", "V", np.full(N, 5000.0)), protocol="lifetime", loading="electrical")
    assert found.channels["voltage"].values[0] == 5.0


def test_load_cell_range() -> None:
    values = np.sin(np.arange(N) / 5)
    values[7] = 2.5
    found = check(GOOD[0], channel("force", "N", values), rig={"load_cell_range_n": "2"})
    assert found.status == "damaged"
    assert "1 of 100 samples" in found.problems[0]
    assert "2.5 N" in found.problems[0]
    with pytest.raises(RefusedError, match="load cell's range") as refused:
        check(GOOD[0], channel("force", "N", 1000 * values), rig={"load_cell_range_n": "2"})
    assert "2 N" in refused.value.expected
    assert "in each other's place" in refused.value.remedy
    assert "of mN" not in refused.value.remedy, "that would be beyond the range as well"
    with pytest.raises(RefusedError, match="load cell's range") as refused:
        check(GOOD[0], channel("force", "N", 600 * values), rig={"load_cell_range_n": "2"})
    assert "(of mN it would be at most 1.5 N)" in refused.value.remedy
    with pytest.raises(RefusedError, match="load cell's range") as refused:
        check(
            channel("displacement", "mm", 5 * values), channel("force", "N", 9 * values), rig={"load_cell_range_n": "2"}
        )
    assert "in each other's place" not in refused.value.remedy, "that would be beyond the range as well"


def test_force_and_voltage_in_each_others_place_are_refused_by_name() -> None:
    pulses = np.where(np.arange(N) // 10 % 2, 5.7, 0.0)
    tension = 8.4 - 0.03 * pulses / 5.7
    stated = {"protocol": "step", "loading": "electrical", "drive_kv": "5.8"}
    check(channel("voltage", "kV", pulses), channel("force", "N", tension), **stated)
    with pytest.raises(RefusedError, match=r"voltage never falls below 8\.37 kV") as refused:
        check(channel("voltage", "kV", tension), channel("force", "N", pulses), **stated)
    assert "Force and voltage are in each other's place" in refused.value.remedy
    biased = 5.0 + 0.05 * np.sin(np.arange(N) / 5)
    check(channel("voltage", "kV", biased), channel("force", "N", pulses), **stated | {"drive_kv": "5"})


def test_forces_beyond_the_range_that_move_as_the_strain_says_are_displacements() -> None:
    swing = np.sin(np.arange(N) / 5)
    stated = {"total_length_mm": "40", "strain_pp": "0.5"}
    with pytest.raises(RefusedError, match="load cell's range") as refused:
        check(
            channel("displacement", "mm", swing),
            channel("force", "N", 30 + 10 * swing),
            rig={"load_cell_range_n": "5"},
            **stated,
        )
    assert refused.value.remedy.startswith("Force and displacement are in each other's place")
    with pytest.raises(RefusedError, match="load cell's range") as refused:
        check(
            channel("displacement", "mm", 10 * swing),
            channel("force", "N", 30 + swing),
            rig={"load_cell_range_n": "15"},
            **stated,
        )
    assert "in each other's place" not in refused.value.remedy
    assert "Check the unit" in refused.value.remedy


def test_rig_file_wins_key_by_key() -> None:
    raw = RawRecording(METADATA, {"clamp_mass_kg": "0.05", "load_cell_range_n": "2"}, GOOD)
    found = canonical(raw, where="r1", rig_file={"clamp_mass_kg": 0.06})
    assert found.rig.clamp_mass_kg == 0.06
    assert found.rig.load_cell_range_n == 2.0


def test_channels_that_share_no_time_are_refused() -> None:
    with pytest.raises(RefusedError, match=r"force begins 0\.901 s after displacement has ended"):
        check(GOOD[0], channel("force", "N", start=START + 1_000_000_000))


def test_different_rates_are_fine() -> None:
    found = check(GOOD[0], channel("force", "N", step=10_000_000))
    assert found.sample_count == 2 * N
    assert not found.notes


def test_clock_far_from_the_start_is_noted() -> None:
    found = check(*GOOD, started_at="2026-03-02T14:00:00+00:00")
    assert any("24 h before started_at" in note for note in found.notes)


def test_other_systems_keep_their_unit() -> None:
    found = check(channel("input", "mV"), channel("output", "furlongs"), protocol="chirp", loading="other")
    assert [c.unit for c in found.channels.values()] == ["mV", "furlongs"]
    assert found.channels["input"].values[1] == np.sin(0.2)


def test_reader_problems_come_first() -> None:
    raw = RawRecording(METADATA, {}, GOOD, ("cut",), ("slow",))
    found = canonical(raw, where="r1")
    assert found.problems == ("cut",)
    assert found.notes == ("slow",)
    assert found.status == "damaged"


@pytest.mark.parametrize(
    "text",
    ["../../x", "'; DROP TABLE recordings; --", "</script><script>alert(1)</script>", "\u202egpj.exe", "x" * 10_000],
)
def test_hostile_text_is_kept_as_text(text: str) -> None:
    found = check(*GOOD, operator=text, notes=text, specimen_id=text, weather=text)
    assert found.metadata.operator == text
    assert found.metadata.extra["weather"] == text
    with pytest.raises(RefusedError):
        check(*GOOD, recording_id=text)


@pytest.mark.parametrize("text", ["a\x00b", "x" * 10_001])
def test_text_that_no_table_can_hold_is_refused(text: str) -> None:
    for key in ("operator", "weather"):
        with pytest.raises(RefusedError) as refused:
            check(*GOOD, **{key: text})
        assert len(str(refused.value)) < 400


@given(arrays(np.float64, st.integers(2, 40), elements=st.floats(allow_nan=True, allow_infinity=True)))
def test_whatever_is_measured_ends_finite_or_nan_or_refused(values: np.ndarray) -> None:
    try:
        found = check(channel("displacement", "m", values), channel("force", "mN", np.arange(values.size)))
    except RefusedError:
        return
    checked = found.channels["displacement"].values
    assert not np.isinf(checked).any()
    impossible = ~np.isfinite(values) | (np.abs(values) > 100)  # nothing here is moved by more than 100 m
    assert np.isnan(checked).tolist() == impossible.tolist()


# --- stretch and stress -------------------------------------------------------------------------------------------


def test_stretch_and_stress_with_geometry() -> None:
    stretch, stress = channel("stretch", "1", 1 + np.arange(N) / N), channel("stress", "MPa", np.arange(N) / N)
    found = check(stretch, stress, film_length_mm=50, film_width_mm=10, film_thickness_mm=0.5, protocol="cycle")
    driven = drive(found)
    assert driven.input.values == pytest.approx(50 * np.arange(N) / N)
    assert driven.output.values == pytest.approx(5 * np.arange(N) / N)  # 1 MPa × 5 mm² = 5 N
    assert set(found.channels) == {"stretch", "stress"}


@pytest.mark.parametrize(
    ("values", "unit"),
    [
        (np.arange(N) / 50, "1"),
        (np.arange(N) * 5.0, "%"),
        (np.arange(N) / N, "%"),
        (np.full(N, 0.2) + np.arange(N) / 1e4, "mm/mm"),
    ],
)
def test_a_strain_is_no_stretch(values: np.ndarray, unit: str) -> None:
    """Of a strain from 0 to 100 % the zeros were lost and the rest taken for a film that is pressed to a thousandth."""
    with pytest.raises(RefusedError, match="a strain") as refused:
        check(channel("stretch", unit, values), channel("stress", "kPa", np.arange(N)), protocol="cycle")
    assert "offset = 1" in refused.value.remedy


def test_stretch_and_stress_as_a_cube() -> None:
    found = check(channel("stretch", "%", 100 + np.arange(N)), channel("stress", "kPa", np.arange(N), resolution="2"))
    driven = drive(found)
    assert driven.input.values == pytest.approx(np.arange(N) / 100)
    assert driven.output.values == pytest.approx(np.arange(N) / 1000)
    assert driven.output.resolution == pytest.approx(0.002)


# --- words about timing -------------------------------------------------------------------------------------------


def test_uneven_sampling_in_words() -> None:
    even = np.arange(1000, dtype=np.int64) * 10_000_000
    assert uneven(even) == ""
    assert uneven(np.rint(np.arange(1000) * 333333.333).astype(np.int64)) == ""
    gap = even.copy()
    gap[500:] += 289_000_000
    assert "median interval 0.01 s" in uneven(gap)
    assert "1 gaps longer than 3 intervals, the largest 0.299 s at 4.99 s" in uneven(gap)
    jitter = even + np.random.default_rng(1).integers(-2_000_000, 2_000_000, even.size)
    assert "gaps" not in uneven(jitter)
    assert "uneven" in uneven(jitter)


# --- keys that nobody knows ----------------------------------------------------------------------------------------


def test_a_key_that_is_nearly_one_of_the_contract_is_asked_about() -> None:
    found = check(*GOOD, film_lenght_mm=50, frequency_start=1, weather="rain", x_film_length="my own")
    assert found.status == "damaged"
    assert [p for p in found.problems if "did you mean film_length_mm?" in p and "film_lenght_mm" in p]
    assert [p for p in found.problems if "did you mean frequency_start_hz?" in p]
    assert [n for n in found.notes if "weather, x_film_length" in n]


def test_a_misspelt_twin_of_a_key_that_is_given_is_named() -> None:
    """It was no problem, since the key itself is there, and no note either."""
    found = check(*GOOD, film_length_mm=50, film_lenght_mm=40)
    assert not [p for p in found.problems if "film_lenght_mm" in p]
    assert [n for n in found.notes if "film_lenght_mm" in n]


def test_a_key_beside_the_one_it_is_like_is_no_question() -> None:
    assert check(*GOOD, film_width_mm=10, film_width_um=10_000).status == "ok"


def test_keys_of_another_test_are_named() -> None:
    """A frequency in a test of another kind, a set point outside of a life: kept, without effect, and never said."""
    found = check(*GOOD, masses_kg="0.1,0.2", load_n=3, strain_pp=0.1, film_length_mm=50)
    (note,) = [n for n in found.notes if "does not use" in n]
    assert note == f"keys of recording that a mechanical {found.metadata.protocol} does not use: masses_kg, load_n"


def test_every_key_is_one_of_film_laboratory_or_test() -> None:
    known = set(known_keys(RecordingMetadata))
    assert set(KEYS_OF_TESTS) <= known
    for tests in KEYS_OF_TESTS.values():
        assert set(tests) <= set(PROTOCOLS)


def _swinging(noise: float = 0.01) -> np.ndarray:
    rng = np.random.default_rng(4)
    return np.sin(np.arange(2000) / 8) + noise * rng.standard_normal(2000)


@pytest.mark.parametrize(("what", "limit"), [("lowest", 0.0), ("lowest", -0.9), ("smallest", 0.2)])
def test_samples_that_are_lost_by_their_value_refuse_the_channel(what: str, limit: float) -> None:
    values = _swinging()
    values[(np.abs(values) if what == "smallest" else values) < limit] = np.nan
    with pytest.raises(RefusedError, match=f"of its samples the {what} are lost"):
        check(channel("displacement", "mm", _swinging()), channel("force", "N", values))


def test_samples_that_are_lost_by_chance_or_by_overload_are_kept_as_damage() -> None:
    rng = np.random.default_rng(6)
    for lost in range(30):
        values = _swinging()
        values[rng.random(2000) < 0.02 * (1 + lost)] = np.nan
        assert check(channel("displacement", "mm", _swinging()), channel("force", "N", values)).status == "damaged"
    values = _swinging()
    values[values > 0.9] = np.nan
    assert check(channel("displacement", "mm", _swinging()), channel("force", "N", values)).status == "damaged"
    values = np.where(np.arange(2000) % 400 < 200, 0.0, 5.0)
    values[20:180:10] = np.nan  # a plug that was loose while nothing happened
    assert check(channel("displacement", "mm", _swinging()), channel("force", "N", values)).status == "damaged"


@pytest.mark.parametrize(
    ("sizes", "said"),
    [
        ({"film_length_mm": 50.0, "film_width_mm": 50.0, "film_thickness_mm": 500.0}, "written in µm"),
        ({"film_length_mm": 0.5, "film_thickness_mm": 50.0}, "exchanged"),
        ({"stretch_1": 20.0}, "stretch_1 is 20"),
        ({"film_length_mm": 50.0, "film_thickness_mm": 0.5, "stretch_1": 1.2, "stretch_2": 0.91}, ""),
        ({"film_width_mm": 1.0, "film_thickness_mm": 10.0, "layers": 100}, ""),
    ],
)
def test_sizes_that_no_film_has_are_questioned(sizes: dict[str, float], said: str) -> None:
    notes = " ".join(check(*GOOD, **sizes).notes)
    assert (said in notes) if said else "film_" not in notes and "stretch" not in notes


def test_a_recorded_life_without_a_campaign_is_one_of_those_that_name_none() -> None:
    """It stood on no page."""
    volts = np.concatenate([np.full(500, 7.0), np.zeros(500)]) + np.random.default_rng(1).normal(0, 1e-3, 1000)
    found = check(channel("voltage", "kV", volts), protocol="lifetime", loading="electrical")
    assert found.metadata.campaign == "no campaign"
    assert [one for one in found.assumptions if one.what == "campaign"]
    named = check(channel("voltage", "kV", volts), protocol="lifetime", loading="electrical", campaign="north")
    assert named.metadata.campaign == "north"
    assert not named.assumptions
