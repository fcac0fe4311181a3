"""Records that cannot carry a model: a clear reason for each, through the whole line, and never a fit that looks good and is not."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

from pipeline.analyse.analysis import Analysis
from pipeline.analyse.inputs import Measured
from pipeline.analyse.recording import analyse_recording
from pipeline.analyse.specimen import analyse_specimen
from pipeline.transform.quality import flat_tops
from schemas.metadata import RigConstants
from schemas.recording import Recording
from tests.physics.rig_truth import Sweep, Truth, filtered, recording, schroeder

RATE = 2000.0
BAND = {"frequency_start_hz": 1.0, "frequency_stop_hz": 100.0, "sweep": "log", "repeats": 1}
STIFF = Truth(load_cell=20.0)
SIZES = {"film_length_mm": 50, "film_width_mm": 50, "film_thickness_mm": 1, "stretch_1": 1.4}


def chirp(truth: Truth = STIFF, *, sweep: Sweep | None = None, seed: int = 0) -> dict[str, np.ndarray]:
    """Displacement and force of a sweep with rest before and after, and noise."""
    rng = np.random.default_rng(seed)
    sweep = sweep or Sweep(1.0, 100.0, 10.0, 0.3)
    fine = np.arange(round((sweep.duration_s + 2.0) * RATE * 4)) / (4 * RATE) - 0.5
    x = sweep(fine)
    force = filtered(x, 1 / (4 * RATE), truth.measured)
    return {
        "displacement": x[::4] + rng.normal(0, 2e-4, x[::4].size),
        "force": force[::4] + rng.normal(0, 1e-3, x[::4].size),
    }


def through(*made: Recording) -> tuple[list[Analysis], Analysis]:
    """What the analysis of each recording and that of the specimen say."""
    alone = [analyse_recording(one) for one in made]
    given = [
        Measured(one.metadata, one.rig, tuple(r for r in found.carried if type(r).__name__ != "SessionFeatures"))
        for one, found in zip(made, alone, strict=True)
    ]
    return alone, analyse_specimen("film-1", given, [], orders=(1, 2, 3))


def rows(analysis: Analysis, table: str) -> list[dict[str, Any]]:
    found = analysis.joined()
    return found[table].to_pylist() if table in found else []


def noise_only(channels: dict[str, np.ndarray], name: str) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed=9)
    return channels | {name: rng.normal(0, 1e-3, channels[name].size)}


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda c: {k: v[1000:1300] for k, v in c.items()}, "too short for a response from 1 to 100 Hz"),
        (lambda c: {k: v * 0 + v[0] for k, v in c.items()}, "does not move"),
        (lambda c: noise_only(c, "displacement"), "lines are usable"),
        (lambda c: noise_only(c, "force"), "lines are usable"),
        (lambda c: c | {"force": np.clip(c["force"], -0.3, 0.3)}, "the load cell is saturated"),
        (lambda c: c | {"force": np.full_like(c["force"], np.nan)}, "no instant at which both"),
    ],
    ids=["too short", "no motion", "no excitation", "no answer", "saturated", "no force"],
)
def test_a_chirp_that_carries_nothing_gives_a_reason_and_no_model(change: Any, reason: str) -> None:
    made = recording(change(chirp()), RATE, rig=STIFF.constants(), **BAND)
    (alone,), specimen = through(made)
    assert not alone.failures
    assert any(reason in note for note in alone.notes), alone.notes
    assert rows(alone, "frequency_responses") == []
    assert rows(specimen, "model_fits") == []
    assert not specimen.failures


def test_a_drive_outside_the_stated_band_is_no_excitation_of_it() -> None:
    """Stated 1 to 100 Hz, driven from 0.05 to 0.3 Hz with soft ends: noise in the band is no response."""
    slow = chirp(sweep=Sweep(0.05, 0.3, 40.0, 0.3, taper_s=10.0))
    (alone,), specimen = through(recording(slow, RATE, rig=STIFF.constants(), **BAND))
    assert any("the input is not 10 dB above its own noise" in note for note in alone.notes), alone.notes
    assert rows(specimen, "model_fits") == []


@pytest.mark.parametrize(
    "sweep", [Sweep(0.1, 0.6, 20.0, 0.3), Sweep(1.0, 20.0, 10.0, 0.3)], ids=["leaks", "ends early"]
)
def test_a_drive_of_a_part_of_the_band_is_used_where_it_is_one(sweep: Sweep) -> None:
    """Stated 1 to 100 Hz, but driven elsewhere or to 20 Hz: no usable line is wrong beyond its error, none is far off."""
    (alone,), specimen = through(recording(chirp(sweep=sweep), RATE, rig=STIFF.constants(), **BAND))
    lines = rows(alone, "frequency_responses")
    f = np.array([r["frequency_hz"] for r in lines])
    value = np.array([complex(r["real"], r["imag"]) for r in lines])
    error = np.array([r["standard_error"] for r in lines])
    good = np.array([r["usable"] for r in lines])
    off = np.abs(value - STIFF.measured(f))
    assert (off / error)[good].max() < 5
    assert (off / np.abs(value))[good].max() < 0.1
    assert not good[f > 40].any()
    fits = [r for r in rows(specimen, "model_fits") if r["selected"] and r["method"] == "forward"]
    assert fits
    assert all(fit["frequency_high_hz"] < 40 for fit in fits)


@pytest.mark.parametrize(
    ("voltage", "reason"),
    [
        (lambda t: np.full_like(t, 5.0), "does not move"),
        (
            lambda t: 5.0 + np.random.default_rng(seed=1).normal(0, 1e-3, t.size),
            "lines are usable|excites|lines of a multisine|no two periods",
        ),
    ],
    ids=["constant voltage", "noise"],
)
def test_a_voltage_without_lines(voltage: Any, reason: str) -> None:
    time = np.arange(20000) / RATE
    force = np.random.default_rng(seed=2).normal(0, 1e-3, time.size)
    made = recording(
        {"voltage": voltage(time), "force": force}, RATE, rig=STIFF.constants(), protocol="sphs", loading="electrical",
        period_s=1.0, frequency_stop_hz=100.0, lines="odd",
    )  # fmt: skip
    (alone,), specimen = through(made)
    assert any(re.search(reason, note) for note in alone.notes), alone.notes
    assert rows(specimen, "model_fits") == []


def test_a_saturated_multisine_is_refused() -> None:
    lines = np.arange(1, 100, 2)
    square = np.tile(1 + schroeder(lines, round(RATE)), 10) / 2
    force = -0.05 * square
    made = recording(
        {"voltage": 7 * np.sqrt(square), "force": np.clip(force, -0.03, 1)}, RATE, rig=STIFF.constants(), protocol="sphs",
        loading="electrical", period_s=1.0, lines="odd",
    )  # fmt: skip
    (alone,), specimen = through(made)
    assert any("saturated" in note for note in alone.notes), alone.notes
    assert rows(specimen, "model_fits") == []


def cyclic(frequency_hz: float, cycles: int = 10, *, name: str = "c", seed: int = 3, clip: float = np.inf) -> Recording:
    rng = np.random.default_rng(seed)
    rate = 200 * frequency_hz
    t = np.arange(round(cycles * 200)) / rate
    k = STIFF.measured(np.array([frequency_hz]))[0]
    x = 1 - np.cos(2 * np.pi * frequency_hz * t)
    force = abs(k) * (1 - np.cos(2 * np.pi * frequency_hz * t + np.angle(k)))
    return recording(
        {"displacement": x + rng.normal(0, 1e-4, t.size), "force": np.clip(force + rng.normal(0, 1e-4, t.size), -clip, clip)},
        rate, rig=STIFF.constants(), protocol="cyclic", frequency_hz=frequency_hz, recording_id=f"{name}-{frequency_hz}",
    )  # fmt: skip


def test_fewer_frequencies_than_parameters() -> None:
    """Two frequencies carry no model of any order, four one of the first; the orders left out are named."""
    alone, specimen = through(cyclic(1.0), cyclic(4.0))
    assert all(len(rows(one, "frequency_responses")) == 1 for one in alone)
    assert rows(specimen, "model_fits") == []
    assert any("2 distinct frequencies or times for 3 parameters of order 1" in note for note in specimen.notes)
    _, four = through(*(cyclic(f) for f in (0.5, 1.0, 2.0, 4.0)))
    fits = [f for f in rows(four, "model_fits") if f["method"] == "forward"]
    assert [f["model_order"] for f in fits] == [1]
    assert "order 2, 3 not fitted: only 4 distinct frequencies or times" in fits[0]["warnings"]


def test_too_few_cycles_and_a_saturated_cycle() -> None:
    (short,), _ = through(cyclic(1.0, cycles=1))
    assert any("response: " in note for note in short.notes), short.notes
    assert rows(short, "frequency_responses") == []
    (clipped,), specimen = through(cyclic(1.0, clip=1.5))
    assert any("saturated" in note for note in clipped.notes), clipped.notes
    assert rows(specimen, "model_fits") == []


@pytest.mark.slow
def test_missing_clamp_constants_are_said_of_each_recording_and_of_the_model() -> None:
    """A light clamp on a soft cell leaves no resonance in the band, and a fit of film and cell together that looks perfect."""
    soft = Truth(load_cell=5.34, clamp_alone_hz=2000.0)
    made = recording(chirp(soft), RATE, rig=RigConstants(rig_id="r"), **BAND, **SIZES)
    _, specimen = through(made)
    assert any(note.startswith("correction of run-1:") and "missing" in note for note in specimen.notes), specimen.notes
    fit = next(f for f in rows(specimen, "model_fits") if f["selected"])
    assert fit["reduced_chi2"] < 1.5
    assert fit["k0_n_per_mm"] == pytest.approx(1 / (1 + 1 / 5.34), rel=0.02)  # in series with the cell: not the film
    assert "load-cell stiffness" in fit["warnings"]
    assert "missing" in fit["warnings"]
    assert fit["modulus_mpa"] is None
    known = recording(chirp(soft), RATE, rig=soft.constants(), **BAND, **SIZES)
    _, right = through(known)
    fit = next(f for f in rows(right, "model_fits") if f["selected"] and f["method"] == "forward")
    assert fit["k0_n_per_mm"] == pytest.approx(1.0, rel=0.02)
    assert fit["modulus_mpa"] is not None


def test_missing_clamp_constants_with_a_resonance_raise_the_alarm() -> None:
    made = recording(chirp(Truth(load_cell=5.34)), RATE, rig=RigConstants(rig_id="r"), **BAND)
    _, specimen = through(made)
    fit = next(f for f in rows(specimen, "model_fits") if f["selected"])
    assert fit["positivity_chi2"] > 10
    assert "no relaxation of any order" in fit["warnings"]


def test_electrical_recordings_without_the_load_cell_give_no_model() -> None:
    lines = np.arange(1, 100, 2)
    square = np.tile(1 + schroeder(lines, round(RATE)), 12) / 2
    force = -0.002 * filtered(49 * square, 1 / RATE, STIFF.ratio) + np.random.default_rng(seed=4).normal(
        0, 1e-5, square.size
    )
    made = recording(
        {"voltage": 7 * np.sqrt(square), "force": force}, RATE, rig=RigConstants(rig_id="r"), protocol="sphs",
        loading="electrical", period_s=1.0, lines="odd",
    )  # fmt: skip
    _, specimen = through(made)
    assert rows(specimen, "model_fits") == []
    assert any("without the load cell's stiffness" in note for note in specimen.notes), specimen.notes


@pytest.mark.parametrize("counts", [3, 10, 40, 90, 1000])
@pytest.mark.parametrize("stated", [True, False])
def test_a_coarse_converter_is_not_at_its_end(counts: int, stated: bool) -> None:
    """Integer encoders and few counts: the last step of a sine is wide, but so is the one below it."""
    time = np.arange(20_000) / 1000.0
    sine = np.rint(counts * np.sin(2 * np.pi * 0.7 * time)) / counts
    assert not flat_tops(sine, 1 / counts if stated else None).any()
    clipped = np.minimum(np.rint(counts * np.sin(2 * np.pi * 0.7 * time)), round(0.6 * counts)) / counts
    if counts >= 10:
        assert flat_tops(clipped, 1 / counts if stated else None).any()
