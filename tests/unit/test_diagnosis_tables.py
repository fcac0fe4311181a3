"""What a diagnosis says arrives in its tables."""

from __future__ import annotations

import json
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest

from pipeline.analyse.diagnosis_tables import diagnosis_tables, undiagnosed_tables
from pipeline.diagnose.features.kinds import FeatureBlock, RecordingFeatures
from pipeline.diagnose.results import (
    Candidate,
    Diagnosis,
    Discrepancy,
    Estimate,
    Extension,
    HeldOut,
    NextRecording,
    Residuals,
)
from pipeline.physics.film import RelaxationModel
from schemas.metadata import RigConstants

PLAIN, FILM = RelaxationModel(1.0, (4.0,), (0.025,)), RelaxationModel(0.9, (4.2,), (0.03,), 0.002)
NAN = float("nan")


def block(kind: str, label: str, size: int, *, is_complex: bool) -> FeatureBlock:
    return FeatureBlock(
        kind, label, np.zeros(size), ("force/0",), np.ones((1, size)), is_complex,
        frequency_hz=np.tile(np.arange(1.0, size // 2 + 1), 2) if is_complex else np.full(size, np.nan),
        amplitude=np.full(size, 0.01), voltage_kv=np.full(size, np.nan), cycle=np.ones(size), time_s=np.arange(size) * 1.0,
    )  # fmt: skip


def recording(name: str, *blocks: FeatureBlock) -> RecordingFeatures:
    started = datetime(2026, 3, 2, tzinfo=UTC)
    return RecordingFeatures(
        name, "S-1", "chirp", "mechanical", started, 9.0, RigConstants(), blocks, (), np.ones(2)
    )  # fmt: skip


def residuals(features: RecordingFeatures, plain_off: float, extended_off: float) -> Residuals:
    blocks = features.blocks
    size = features.size
    return Residuals(
        features.recording_id,
        np.concatenate([np.full(b.size, b.kind) for b in blocks]),
        np.concatenate([np.full(b.size, b.label) for b in blocks]),
        np.concatenate([b.frequency_hz for b in blocks]),
        np.concatenate([b.time_s for b in blocks]),
        np.ones(size),
        np.ones(size) - 0.01 * plain_off,
        np.ones(size) - 0.01 * extended_off,
        np.full(size, 0.01),
    )


FIRST = recording(
    "r-1", block("chirp.response", "sweep 1", 8, is_complex=True), block("rest.hum", "rest", 2, is_complex=False)
)
SECOND = recording("r-2", block("relaxation.force", "windows", 5, is_complex=False))
NAMED = Diagnosis(
    specimen_id="S-1",
    verdict="named",
    mechanisms=("gain_error", "cyclic_softening"),
    also_possible=(),
    p_value=1e-9,
    supported_by=("chirp",),
    held_out=HeldOut(5.0, 1.2, 0.97, 0.94, 0.99, 200, {"chirp": (5.0, 1.2)}),
    extension=Extension(
        {"gain_error": {"gain": Estimate(0.1, 0.01, 0.08, 0.12)}, "cyclic_softening": {"loss": Estimate(0.2, NAN)}},
        {"gain_error": "force", "cyclic_softening": ""},
        FILM, (0.01, 0.1, 0.001, 1e-4), (0.005,), PLAIN, (0.02, 0.2, 0.002), 20.0, 900.0, 30,
    ),
    candidates=(Candidate("gain_error", 880.0, 870.0, 0.99, 0.1, 0.01, 0.98, NAN, "force", "one channel × (1 + g)"),),
    discrepancies=(Discrepancy("r-1", "sweep 1, 1 to 3 Hz", 800.0, 8, 1e-12, "The response is missed by 3 %."),),
    next_recording=NextRecording(({"protocol": "weight"},), "Hang 50 g on the cell", 40.0),
    smallest_detectable={"leakage": {"droop": 0.02}, "slack": {"overload": float("inf")}},
    invisible=("wrinkling",),
    could_not_ask=("no temperature",),
    unexplained=(),
    plain_film=PLAIN,
    residuals=(residuals(FIRST, 10.0, 1.0), residuals(SECOND, 2.0, 1.0)),
)  # fmt: skip


def test_rows_of_a_named_diagnosis() -> None:
    tables = diagnosis_tables(NAMED, (SECOND, FIRST))
    (row,) = tables["diagnoses"].to_pylist()
    assert (row["mechanism"], row["mechanisms"], row["verdict"]) == (
        "gain_error",
        ["gain_error", "cyclic_softening"],
        "named",
    )
    severity = json.loads(row["severity"])
    assert severity["gain_error"] == {
        "gain": {"value": 0.1, "sd": 0.01, "lower": 0.08, "upper": 0.12},
        "channel": "force",
    }
    assert severity["cyclic_softening"]["loss"] == {"value": 0.2, "sd": None, "lower": None, "upper": None}
    assert json.loads(row["smallest_detectable"]) == {"leakage": {"droop": 0.02}, "slack": {}}
    assert json.loads(row["held_out_parts"]) == {"chirp": {"before": 5.0, "after": 1.2}}
    assert json.loads(row["next_design"]) == [{"protocol": "weight"}]
    assert (row["gain"], row["gain_lower"], row["chi2"], row["chi2_extended"]) == (0.97, 0.94, 900.0, 20.0)
    assert row["could_not_ask"] == ["no temperature"]
    (candidate,) = tables["diagnosis_candidates"].to_pylist()
    assert candidate["gain"] is None
    assert candidate["form"] == "force"
    assert tables["discrepancies"].to_pylist()[0]["statement"] == "The response is missed by 3 %."


def test_the_extended_model_is_a_fit_of_its_own() -> None:
    (fit,) = diagnosis_tables(NAMED, (FIRST, SECOND))["model_fits"].to_pylist()
    assert fit["extension"] == "gain_error,cyclic_softening"
    assert (fit["loading"], fit["method"], fit["selected"], fit["model_order"]) == ("joint", "forward", False, 2)
    assert fit["k1_n_per_mm"] == 4.2
    assert fit["c1_n_s_per_mm"] == pytest.approx(4.2 * 0.03)
    assert fit["c1_n_s_per_mm_sd"] == 0.005
    assert fit["c2_n_s_per_mm_sd"] == 1e-4
    assert fit["c3_n_s_per_mm_sd"] is None
    assert fit["k2_n_per_mm"] is None, "a pure dashpot"
    assert fit["c2_n_s_per_mm"] == 0.002
    assert fit["reduced_chi2"] == pytest.approx(20.0 / (30 - 4 - 2))


def test_how_far_the_film_moved() -> None:
    moved = {r["parameter"]: r for r in diagnosis_tables(NAMED, (FIRST, SECOND))["diagnosis_parameters"].to_pylist()}
    assert moved["k0"]["moved_sd"] == pytest.approx(10.0)
    assert moved["tau1"]["unit"] == "s"
    assert (moved["c_inf"]["plain"], moved["c_inf"]["moved_sd"]) == (None, None)
    assert moved["c_inf"]["extended_sd"] == 1e-4


def test_blocks_and_curves() -> None:
    tables = diagnosis_tables(NAMED, (FIRST, SECOND))
    blocks = tables["diagnosis_blocks"].to_pylist()
    assert [(b["recording_id"], b["kind"], b["feature_count"]) for b in blocks] == [
        ("r-1", "chirp.response", 8), ("r-1", "rest.hum", 2), ("r-2", "relaxation.force", 5),
    ]  # fmt: skip
    assert blocks[0]["plain_rms"] == pytest.approx(10.0)
    assert blocks[0]["extended_rms"] == pytest.approx(1.0)
    curves = tables["diagnosis_curves"].to_pylist()
    sweep = [c for c in curves if c["kind"] == "chirp.response"]
    assert [c["component"] for c in sweep] == ["real"] * 4 + ["imaginary"] * 4
    assert [c["frequency_hz"] for c in sweep] == [1.0, 2.0, 3.0, 4.0] * 2
    assert {c["component"] for c in curves if c["kind"] != "chirp.response"} == {""}
    assert all(c["amplitude"] == 0.01 for c in curves)


def test_curves_are_kept_where_the_models_differ_and_not_without_end() -> None:
    many = [recording(f"r-{i:03d}", block("chirp.response", "sweep 1", 400, is_complex=True)) for i in range(40)]
    told = replace(NAMED, residuals=tuple(residuals(f, float(i), 1.0) for i, f in enumerate(many)))
    tables = diagnosis_tables(told, many)
    kept = {c["recording_id"] for c in tables["diagnosis_curves"].to_pylist()}
    assert tables["diagnosis_curves"].num_rows <= 3000
    assert "r-039" in kept
    assert "r-000" not in kept
    assert tables["diagnosis_blocks"].num_rows == 40


def test_the_block_in_which_the_cause_explains_most_is_kept_whatever_else_is_missed() -> None:
    """Other blocks miss more and fill all that is kept, but the cause takes nothing off them."""
    many = [recording(f"r-{i}", block("chirp.response", "sweep 1", 1400, is_complex=True)) for i in range(4)]
    left = [residuals(many[0], 3.0, 1.0), *(residuals(f, 90.0, 90.0) for f in many[1:])]
    curves = diagnosis_tables(replace(NAMED, residuals=tuple(left)), many)["diagnosis_curves"].to_pylist()
    assert "r-0" in {c["recording_id"] for c in curves}


def test_covariates_of_blocks_that_are_not_known_are_left_open() -> None:
    curves = diagnosis_tables(NAMED, ())["diagnosis_curves"].to_pylist()
    assert {c["amplitude"] for c in curves} == {None}
    assert {c["component"] for c in curves} == {""}


def test_a_simulation_that_is_right_has_no_extension() -> None:
    none = replace(
        NAMED, verdict="none", mechanisms=(), held_out=None, extension=None, next_recording=None, candidates=()
    )
    tables = diagnosis_tables(none, (FIRST, SECOND))
    assert "model_fits" not in tables
    (row,) = tables["diagnoses"].to_pylist()
    assert (row["mechanism"], row["gain"], row["severity"]) == (None, None, None)
    assert {b["extended_rms"] for b in tables["diagnosis_blocks"].to_pylist()} == {None}
    assert {c["extended"] for c in tables["diagnosis_curves"].to_pylist()} == {None}


def test_what_cannot_be_asked_has_a_row_with_the_reason() -> None:
    (row,) = undiagnosed_tables("S-1", ["one recording"])["diagnoses"].to_pylist()
    assert row["verdict"] is None
    assert row["could_not_ask"] == ["one recording"]
