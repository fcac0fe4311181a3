"""Covariates under the laboratory's own names: from a table, or a recording's metadata, to the regression of the lives."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ingest.mapping import FileMapping
from ingest.read import read_raw
from ingest.tables import LifetimeTable
from pipeline.analyse.recording import lifetimes_table
from pipeline.analyse.survival import analyse_survival
from schemas.errors import RefusedError
from schemas.life_covariates import OwnCovariate, from_metadata
from schemas.metadata import RecordingMetadata

COLUMNS: dict[str, Any] = {
    "lifetime": {"column": "life", "unit": "h"},
    "failed": {"column": "failed", "failed_values": ["yes"], "censored_values": ["no"]},
}
COVARIATES: dict[str, Any] = {"curing time": {"column": "cure", "unit": "h"}, "operator": {"column": "who"}}


def read(tmp_path: Path, rows: list[str], covariates: dict[str, Any] = COVARIATES, **recording: Any) -> LifetimeTable:
    path = tmp_path / "ageing.csv"
    path.write_text("\n".join(["life,failed,cure,who", *rows]) + "\n")
    content = {
        "kind": "lifetimes",
        "columns": COLUMNS,
        "covariates": covariates,
        "recording": {"recording_id": "ageing", "campaign": "ageing", **recording},
    }
    found = read_raw(path, FileMapping.parse(content, stem="ageing", suffix=".csv", source="ageing.csv.toml"))
    assert isinstance(found, LifetimeTable)
    return found


def lives(effect: float) -> list[str]:
    rng = np.random.default_rng(2)
    found = []
    for k in range(40):
        cure, who = (1, 2, 4, 8)[k % 4], ("Anna", "Ben")[k // 4 % 2]
        found.append(f"{np.exp(2 + effect * cure + 0.3 * np.log(rng.exponential())):.6g},yes,{cure},{who}")
    return found


def test_a_covariate_of_any_name_is_in_rows_and_in_the_regression(tmp_path: Path) -> None:
    table = read(tmp_path, lives(0.2), batch="B7", covariate_room="lab 2")
    assert table.rows[1].covariates == (
        OwnCovariate("curing time", 2.0, "exponential", "h"),
        OwnCovariate("operator", "Anna", "category"),
        OwnCovariate("room", "lab 2", "category"),
    )
    assert table.rows[1].batch == "B7"
    (written, *_) = lifetimes_table(table.rows[:1]).to_pylist()
    assert json.loads(written["covariates"]) == {"curing time": 1.0, "operator": "Anna", "room": "lab 2"}
    tables = analyse_survival(table.rows).joined()
    chosen = next(row["family"] for row in tables["life_regressions"].to_pylist() if row["chosen"])
    effects = {r["coefficient"]: r for r in tables["life_coefficients"].to_pylist() if r["family"] == chosen}
    cure = effects["curing time"]
    assert (cure["law"], cure["unit"], cure["contrast"]) == ("exponential", "h", "8\u00a0h over 1\u00a0h")
    assert 0.1 < cure["value_lower"] < 0.2 < cure["value_upper"] < 0.3
    assert effects["operator: Ben"]["value_lower"] < 0 < effects["operator: Ben"]["value_upper"]
    lines = tables["life_lines"].to_pylist()
    assert {(row["stress"], row["stress_law"], row["stress_unit"]) for row in lines} == {
        ("curing time", "exponential", "h")
    }
    assert min(row["stress_value"] for row in lines) >= 0  # a time is never negative, tested or not
    groups = [row["conditions"] for row in tables["life_group_fits"].to_pylist()]
    assert "curing time 8 h, Ben, lab 2" in groups


def test_laws_as_stated_and_numbers_that_are_names(tmp_path: Path) -> None:
    covariates = {
        "cure": {"column": "cure", "unit": "h", "law": "inverse power"},
        "press": {"column": "cure", "law": "category"},
        "room": {"value": "lab 2"},
    }
    (row, *_) = read(tmp_path, ["5,yes,2,Anna"], covariates).rows
    assert [(one.value, one.law) for one in row.covariates] == [
        (2.0, "inverse power"), ("2", "category"), ("lab 2", "category"),
    ]  # fmt: skip


def test_metadata_of_a_recording_have_covariates() -> None:
    stated = {
        "recording_id": "r", "protocol": "lifetime", "loading": "electrical", "specimen_id": "s", "started_at": "2026-01-01T00:00:00Z",
        "covariate_cure": "3 h", "covariate_cure_law": "inverse power", "covariate_operator": "Anna", "humidity": "45", "electrode": "carbon",
    }  # fmt: skip
    metadata = RecordingMetadata.parse(stated)
    assert from_metadata(metadata.extra) == (
        OwnCovariate("cure", 3.0, "inverse power", "h"),
        OwnCovariate("operator", "Anna", "category"),
    )
    assert (metadata.humidity, metadata.electrode) == (0.45, "carbon")


def test_units_that_differ_within_a_campaign_are_told_and_not_mixed(tmp_path: Path) -> None:
    hours = read(tmp_path, lives(0.2)).rows
    other = read(tmp_path, lives(0.2), COVARIATES | {"curing time": {"column": "cure", "unit": "min"}}).rows
    told = analyse_survival([*hours, *other]).joined()["life_regressions"].to_pylist()
    words = "; ".join(row["warnings"] for row in told if row["warnings"])
    assert "curing time is not in the regression: it is given in different ways" in words


@pytest.mark.parametrize(
    ("covariates", "said"),
    [
        ({"humidity": {"column": "cure"}}, "humidity is no name of your own"),
        ({"a, b": {"column": "cure"}}, "cannot be a covariate's name"),
        ({"cure": {"column": "cure", "law": "linear"}}, 'covariates.cure.law is "linear"'),
        ({"cure": {"column": "who", "law": "arrhenius"}}, 'cure is "Anna"'),
        ({"cure": {"unit": "h"}}, "covariates.cure has no column"),
    ],
)
def test_covariates_that_cannot_be_are_refused(tmp_path: Path, covariates: dict[str, Any], said: str) -> None:
    with pytest.raises(RefusedError, match=said.replace(".", r"\.")):
        read(tmp_path, ["5,yes,2,Anna", "6,yes,3,Ben"], covariates)


def test_a_recording_has_no_columns_of_covariates() -> None:
    content = {
        "kind": "recording",
        "columns": {"force": {"column": "F", "unit": "N"}},
        "covariates": {"cure": {"value": 3}},
    }
    with pytest.raises(RefusedError, match='covariates is not used for kind "recording"'):
        FileMapping.parse(content, stem="x", suffix=".csv")
