"""One definition of each table: arrow schema, DDL that DuckDB takes, comments, NULLs, the reference."""

from __future__ import annotations

import duckdb
import numpy as np
import pyarrow as pa
import pytest

from schemas.tables import TABLES, reference


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
    assert set(table.order) <= set(table.names)
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
