"""Control charts and what a night moved: the SQL against the same rules in NumPy and SciPy."""

from __future__ import annotations

import re
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from typing import Any

import duckdb
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import norm, t

from schemas.control import FEWEST, REMEMBER, ROW, STUDENT, quantile
from schemas.tables import TABLES
from schemas.views import VIEWS

START = datetime(2026, 3, 1, tzinfo=UTC)


@pytest.fixture(scope="module")
def empty() -> Iterator[Any]:
    """A database without rows."""
    with duckdb.connect() as connection:
        for definition in (*TABLES.values(), *VIEWS):
            connection.execute(definition.ddl())
        yield connection


@pytest.fixture
def database(empty: Any) -> Iterator[Any]:
    """The same, to which a test may add rows."""
    empty.execute("BEGIN")
    yield empty
    empty.execute("ROLLBACK")


def insert(connection: Any, table: str, *rows: dict[str, Any]) -> None:
    given_rows = TABLES[table].rows(rows)  # noqa: F841 - DuckDB finds it by name
    connection.execute(f"INSERT INTO {table} SELECT * FROM given_rows")


def asked(connection: Any, query: str) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = connection.sql(query).to_arrow_table().to_pylist()
    return rows


def specimen(connection: Any, i: int, *, stiffness: float = 20.0, sd: float = 0.01, modulus: float = 0.4, **more: Any) -> None:  # fmt: skip
    name = f"S-{i:03d}"
    row = {
        "recording_id": f"{name}-1",
        "specimen_id": name,
        "status": "ok",
        "loading": "mechanical",
        "protocol": "chirp",
    }
    row |= {"rig_id": "shaker", "operator": "A", "material": "film", "started_at": START + timedelta(hours=i)} | more
    insert(connection, "recordings", row)
    insert(
        connection,
        "model_fits",
        {
            "specimen_id": name, "loading": "mechanical", "method": "forward", "model_order": 3, "selected": True,
            "extension": "", "k0_n_per_mm": 2.5 * modulus, "k0_n_per_mm_sd": 0.01 * modulus, "modulus_mpa": modulus,
            "load_cell_stiffness_n_per_mm": stiffness, "load_cell_stiffness_n_per_mm_sd": sd,
        },
    )  # fmt: skip


def test_student_is_that_of_scipy() -> None:
    sure = norm.cdf(3)
    assert pytest.approx([t.ppf(sure, n) for n in range(1, len(STUDENT) + 1)], abs=1e-4) == STUDENT
    with duckdb.connect() as connection:
        for freedom in (31, 40, 100, 1000):
            ((value,),) = connection.execute(f"SELECT {quantile(str(freedom))}").fetchall()
            assert value == pytest.approx(t.ppf(sure, freedom), rel=5e-4)


def limits(values: np.ndarray, sds: np.ndarray, i: int) -> tuple[float, float]:
    """Prediction of point i from the others."""
    others = np.delete(values, i)
    spread = max(others.std(ddof=1), sds[i])
    half = t.ppf(norm.cdf(3), others.size - 1) * spread * np.sqrt(1 + 1 / others.size)
    return others.mean() - half, others.mean() + half


@pytest.mark.slow
@settings(max_examples=25, deadline=None)
@given(st.lists(st.floats(19.0, 21.0), min_size=FEWEST, max_size=14), st.floats(0.001, 0.5))
def test_limits_are_the_prediction_from_the_other_points(empty: Any, stiffness: list[float], sd: float) -> None:
    empty.execute("BEGIN")
    for i, value in enumerate(stiffness):
        specimen(empty, i, stiffness=value, sd=sd)
    found = asked(empty, "FROM control_points WHERE quantity = 'load_cell_stiffness_n_per_mm' ORDER BY point")
    empty.execute("ROLLBACK")
    values, sds = np.array(stiffness), np.full(len(stiffness), sd)
    for i, row in enumerate(found):
        low, high = limits(values, sds, i)
        assert (row["lower"], row["upper"]) == pytest.approx((low, high), rel=1e-4, abs=1e-4)
        if min(abs(values[i] - low), abs(values[i] - high)) > 1e-3:
            outside = not low <= values[i] <= high
            assert (row["alarm"] == "beyond its limits") == outside


def test_the_load_cell_that_changed_is_named(database: Any) -> None:
    for i, value in enumerate((20.0, 20.02, 19.98, 20.01, 21.2)):
        specimen(database, i, stiffness=value)
    found = asked(database, "FROM out_of_control")
    assert [(r["grouped_by"], r["name"], r["quantity"], r["point"]) for r in found] == [
        ("rig", "shaker", "load_cell_stiffness_n_per_mm", "S-004")
    ]


def test_three_points_have_no_limits_and_the_points_own_uncertainty_counts(database: Any) -> None:
    for i in range(3):
        specimen(database, i, stiffness=20.0 + 1e-6 * i)
    assert {r["upper"] for r in asked(database, "FROM control_points")} == {None}
    specimen(database, 3, stiffness=22.0, sd=1.0)
    assert asked(database, "FROM out_of_control") == []


def test_an_operator_who_is_always_high_is_named_in_the_eighth_specimen(database: Any) -> None:
    random = np.random.default_rng(seed=3)
    for i in range(30):
        operator = "B" if i >= 22 else "A"
        shift = 0.012 if operator == "B" else 0.0
        specimen(database, i, modulus=0.4 * (1 + shift + 0.004 * random.normal()), operator=operator)
    found = asked(database, "FROM out_of_control WHERE grouped_by = 'operator'")
    assert {(r["name"], r["point"]) for r in found if "in a row" in r["alarm"]} == {("B", "S-029")}
    assert f"{ROW} in a row" in found[0]["alarm"]


def test_refused_files_are_judged_as_a_share_of_all(database: Any) -> None:
    for i, refused in enumerate((2, 3, 1, 2, 3, 2, 30)):
        insert(database, "runs", {"run_id": f"{i:06d}", "started_at": START + timedelta(days=i), "found": 100, "quarantined": refused})  # fmt: skip
    rows = asked(database, "FROM control_points WHERE grouped_by = 'night'")
    assert [r["alarm"] for r in rows] == [None] * 6 + ["beyond its limits"]
    assert all(0 <= r["lower"] <= r["upper"] <= 1 for r in rows)


def test_a_night_with_nothing_new_is_no_point(database: Any) -> None:
    """It says again what the one before it said, and a figure would be drawn for it each night."""
    for i, (found, reused) in enumerate(((4, 0), (6, 4), (6, 6), (6, 6), (7, 6))):
        insert(database, "runs", {"run_id": f"{i:06d}", "started_at": START + timedelta(days=i), "found": found, "reused": reused, "quarantined": 1})  # fmt: skip
    rows = asked(database, "FROM control_points WHERE grouped_by = 'night'")
    assert [r["point"] for r in rows] == ["000000", "000001", "000004"]


def test_calibrations_stand_in_the_chart_of_their_rig(database: Any) -> None:
    for i in range(5):
        insert(database, "recordings", {"recording_id": f"tap-{i}", "status": "ok", "loading": "calibration", "rig_id": "shaker", "started_at": START + timedelta(days=i)})  # fmt: skip
        insert(database, "calibrations", {"recording_id": f"tap-{i}", "quantity": "clamp_frequency_hz", "unit": "Hz", "value": 52 + 0.01 * i + 3 * (i == 4), "sd": 0.01})  # fmt: skip
    (alarm,) = asked(database, "FROM out_of_control")
    assert (alarm["name"], alarm["point"], alarm["unit"]) == ("shaker", "tap-4", "Hz")


def night(connection: Any, number: int, **more: Any) -> None:
    insert(connection, "runs", {"run_id": f"{number:06d}", "started_at": START + timedelta(days=number)} | more)
    connection.execute(REMEMBER)


def test_only_what_changed_is_remembered_and_what_moved_is_told(database: Any) -> None:
    specimen(database, 1)
    specimen(database, 2)
    night(database, 1)
    first = asked(database, "FROM history")
    assert {r["item"] for r in first} == {"S-001", "S-002"}
    assert asked(database, "FROM moved") == []
    night(database, 2)
    assert asked(database, "FROM history") == first
    database.execute("UPDATE model_fits SET load_cell_stiffness_n_per_mm = 21 WHERE specimen_id = 'S-002'")
    database.execute("UPDATE model_fits SET load_cell_stiffness_n_per_mm = 20.01 WHERE specimen_id = 'S-001'")
    insert(database, "recordings", {"recording_id": "S-002-2", "specimen_id": "S-002", "status": "ok", "protocol": "sphs", "run_id": "000003"})  # fmt: skip
    night(database, 3)
    (moved,) = asked(database, "FROM moved")
    assert (moved["item"], moved["before"], moved["after"], moved["because"]) == ("S-002", 20.0, 21.0, "1 sphs")
    assert moved["moved_sd"] == pytest.approx(1 / np.hypot(0.01, 0.01))
    assert len(asked(database, "FROM history WHERE run_id = '000003'")) == 2


def test_a_result_that_became_uncertain_is_told(database: Any) -> None:
    specimen(database, 1)
    night(database, 1)
    database.execute(
        "UPDATE model_fits SET load_cell_stiffness_n_per_mm = 20.03, load_cell_stiffness_n_per_mm_sd = 0.05"
    )
    night(database, 2)
    (moved,) = asked(database, "FROM moved")
    assert (moved["quantity"], moved["after_sd"]) == ("load_cell_stiffness_n_per_mm", 0.05)
    assert moved["moved_sd"] < 2


def test_a_verdict_that_changed_and_a_result_that_went_are_told(database: Any) -> None:
    specimen(database, 1)
    insert(database, "diagnoses", {"specimen_id": "S-001", "verdict": "none", "mechanisms": []})
    night(database, 1, code_version="a")
    database.execute("UPDATE diagnoses SET verdict = 'named', mechanisms = ['slack']")
    database.execute("UPDATE model_fits SET modulus_mpa = NULL")
    night(database, 2, code_version="b")
    moved = asked(database, "FROM moved")
    assert [(m["quantity"], m["before_words"], m["after_words"]) for m in moved] == [
        ("verdict", "none", "named: slack"),
        ("modulus_mpa", None, None),
    ]
    assert moved[1]["after"] is None
    assert {m["because"] for m in moved} == {"another version of the code"}
    night(database, 3, code_version="b")
    assert asked(database, "FROM moved") == [], "what has gone is told once"
    database.execute("UPDATE diagnoses SET verdict = NULL, mechanisms = NULL")
    night(database, 4, code_version="b")
    assert [m["after_words"] for m in asked(database, "FROM moved")] == ["could not be asked"]


def test_every_view_names_its_units_in_the_reference() -> None:
    assert not [v.name for v in VIEWS if not v.meaning or not re.match(r"[a-z0-9]", v.meaning)]
