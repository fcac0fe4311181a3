"""One definition of each table: arrow schema, DDL that DuckDB takes, comments, NULLs, the reference, and who makes it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import duckdb
import numpy as np
import pyarrow as pa
import pytest

from pipeline.nightly.stages import GROUPS, STAGES
from schemas.assumptions import BETWEEN_SAMPLES
from schemas.tables import OWNERS, TABLES, find_references, reference
from schemas.tables.table import MadeBy, Table, real, text, texts, truth, whole, with_bounds, with_uncertainty


@pytest.mark.long_after(25)
@pytest.mark.parametrize("name", list(TABLES))
def test_ddl_makes_the_table_with_its_comments(name: str) -> None:
    table = TABLES[name]
    with duckdb.connect() as connection:
        for statement in table.ddl().split(";\n"):
            connection.execute(statement)
        found = connection.execute(
            "SELECT column_name, comment FROM duckdb_columns() WHERE table_name = ? ORDER BY column_index", [name]
        ).fetchall()
        empty = table.empty()
        connection.register("rows_to_add", empty)
        connection.execute(f"INSERT INTO {name} SELECT * FROM rows_to_add")
    assert tuple(column for column, _ in found) == table.names
    assert all(comment and comment.strip() for _, comment in found)
    assert set(table.key) <= set(table.names)
    assert len(set(table.names)) == len(table.names)


def test_rows_take_what_python_and_numpy_give() -> None:
    table = TABLES["lifetimes"]
    rows = table.rows(
        [{"specimen_id": "a", "lifetime_s": np.float64(2.5), "failed": np.bool_(True), "voltage_kv": np.nan}]
    )
    (row,) = rows.to_pylist()
    assert (row["lifetime_s"], row["failed"], row["voltage_kv"], row["campaign"]) == (2.5, True, None, None)
    with pytest.raises(KeyError, match="lifetime"):
        table.rows([{"lifetime": 1}])


def test_arrays_take_scalars_arrays_and_nothing() -> None:
    table = TABLES["survival_curves"]
    found = table.arrays(3, configuration="a'b", time_s=np.array([1.0, np.nan, 3.0]), at_risk=np.array([3, 2, 1]))
    assert found.schema == table.arrow_schema
    assert found["configuration"].to_pylist() == ["a'b"] * 3
    assert found["time_s"].to_pylist() == [1.0, None, 3.0]
    assert found["lower_95"].null_count == 3
    with pytest.raises(KeyError):
        table.arrays(1, nonsense=1)
    with pytest.raises(pa.ArrowInvalid):
        table.arrays(2, time_s=np.array([1.0]))


def test_lists_and_hostile_text_survive() -> None:
    table = TABLES["diagnoses"]
    text = "'; DROP TABLE diagnoses; --</script>"
    (row,) = table.rows([{"specimen_id": text, "mechanisms": ("slack", "mains_hum")}]).to_pylist()
    assert row["specimen_id"] == text
    assert row["mechanisms"] == ["slack", "mains_hum"]


def test_reference_names_every_column() -> None:
    text = reference()
    for table in TABLES.values():
        assert f"### `{table.name}`" in text
        assert all(f"`{column.name}`" in text for column in table.columns)
    assert (
        "Key: `specimen_id`, `recording_id`, `quantity`, `stage`, `frequency_hz`."
        " Made by: recording (`stage = 'measured'`), specimen (`stage <> 'measured'`)."
        " Pages: index, campaign, specimen, recording."
    ) in text


def test_no_name_is_taken_twice() -> None:
    from schemas.tables import _SUBJECTS

    assert len(TABLES) == sum(len(subject.TABLES) for subject in _SUBJECTS)


def test_every_table_is_made_by_stages_that_there_are() -> None:
    makers = [(table.name, maker) for table in TABLES.values() for maker in table.made_by]
    assert {name for name, _ in makers} == set(TABLES)
    assert {maker.stage for _, maker in makers} == {*STAGES, "night"}
    assert {maker.group for _, maker in makers if maker.stage == "group"} == set(GROUPS)
    assert not {maker.group for _, maker in makers if maker.stage != "group"} - {""}


def test_the_rows_of_a_stage_can_be_found_again() -> None:
    for table in TABLES.values():
        for maker in table.made_by:
            assert OWNERS.get(maker.stage, table.names[0]) in table.names


def test_a_table_of_several_stages_says_which_rows_are_whose() -> None:
    shared = [table for table in TABLES.values() if len(table.made_by) > 1]
    assert {table.name for table in shared} == {"frequency_responses", "model_fits", "discrepancies", "assumptions"}
    with duckdb.connect() as connection:
        for table in shared:
            connection.execute(table.ddl())
            column, values = {
                "frequency_responses": ("stage", ["measured", "corrected", "averaged"]),
                "model_fits": ("extension", [None, "", "slack"]),
                "discrepancies": ("where_found", [None, "cycle 1", "sign"]),
                "assumptions": ("what", ["layers", "rest length", BETWEEN_SAMPLES]),
            }[table.name]
            names = [column, *(c.name for c in table.columns if c.required and c.name != column)]
            command = f"INSERT INTO {table.name} ({', '.join(names)}) VALUES (?{', ?' * (len(names) - 1)})"
            connection.executemany(command, [[value, *["x"] * (len(names) - 1)] for value in values])
            counts = [
                connection.execute(f"SELECT count(*) FROM {table.name} WHERE {maker.where}").fetchone()
                for maker in table.made_by
            ]
            assert sum(count for (count,) in counts if count) == len(values), "every row is one stage's"
            assert all(count for (count,) in counts if count)


def test_what_refers_to_recordings() -> None:
    found = set(find_references())
    assert {key for _, _, key in found} == {"recording_id", "specimen_id"}
    assert all(key in TABLES["recordings"].names and column in TABLES[table].names for table, column, key in found)
    silent = {t.name for t in TABLES.values() if "recording_id" in t.names} - {table for table, _, _ in found}
    expected = {"recordings", "annotations", "without_result"}
    assert silent == expected, "annotations outlive their recording, and refused files have ids that no recording has"


@dataclass(frozen=True)
class Estimated:
    value: float
    sd: float
    lower: float
    upper: float


@dataclass(frozen=True)
class Result:
    name: str
    size: Estimated | None
    limits: Estimated
    count: np.int64
    found: bool
    warnings: Sequence[str]
    parts: Sequence[str] = ()


TOY = Table(
    "toy",
    "a table for tests",
    (
        text("name", "name"),
        *with_uncertainty("size", "mm", "size"),
        *with_bounds("limits", "", "limits"),
        whole("count", "count"),
        truth("found", "found"),
        text("warnings", "warnings"),
        texts("parts", "parts"),
        real("double", "mm", "twice the size"),
    ),
    key=("name",),
    made_by=(MadeBy("night"),),
    pages=(),
)


def test_objects_become_rows_by_the_names_of_their_members() -> None:
    size = Estimated(2.0, 0.1, 1.8, float("inf"))
    results = (
        Result("a", size, size, np.int64(3), True, ("one", "two"), ("p", "q")),
        Result("b", None, size, np.int64(0), False, ()),
    )
    table = TOY.from_objects(results, double=lambda one: None if one.size is None else 2 * one.size.value)
    assert table.schema == TOY.arrow_schema
    first, second = table.to_pylist()
    assert first == {
        "name": "a", "size": 2.0, "size_sd": 0.1, "size_lower": 1.8, "size_upper": None, "limits": 2.0,
        "limits_lower": 1.8, "limits_upper": None, "count": 3, "found": True, "warnings": "one; two",
        "parts": ["p", "q"], "double": 4.0,
    }  # fmt: skip
    assert [second[n] for n in ("size", "size_sd", "size_upper", "warnings", "parts", "double")] == [None] * 4 + [
        [],
        None,
    ]
    assert TOY.from_objects((), double=1.0).num_rows == 0


def test_no_column_is_left_empty_by_mistake() -> None:
    size = Estimated(2.0, 0.1, 1.8, 2.2)
    result = Result("a", size, size, np.int64(3), True, ())
    with pytest.raises(KeyError, match="Result has nothing for the column double of toy"):
        TOY.from_objects([result])
    with pytest.raises(KeyError, match="toy has no column"):
        TOY.from_objects([result], double=1.0, triple=2.0)
    assert TOY.from_objects([result], double=None)["double"].to_pylist() == [None]


def test_infinity_is_null_in_rows_objects_and_arrays_alike() -> None:
    values = [1.0, np.inf, -np.inf, np.nan]
    wanted = [1.0, None, None, None]
    table = TABLES["survival_curves"]
    assert table.arrays(4, upper_95=np.array(values))["upper_95"].to_pylist() == wanted
    assert table.rows([{"upper_95": value} for value in values])["upper_95"].to_pylist() == wanted


def test_parts_are_stacked() -> None:
    part = TABLES["calibrations"].rows([{"value": 1.0}])
    assert TABLES["calibrations"].stack([part, part])["value"].to_pylist() == [1.0, 1.0]
    assert TABLES["calibrations"].stack([]) == TABLES["calibrations"].empty()
