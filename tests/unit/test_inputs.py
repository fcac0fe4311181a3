"""What later stages take of a recording's results."""

from __future__ import annotations

import pytest

from pipeline.store.inputs import _rows
from schemas.tables import TABLES


@pytest.mark.parametrize(
    ("kinds", "only", "but", "expected"),
    [
        (["Features", "Lifetime"], "Features", "", ["Features"]),
        (["Features", "Lifetime"], "", "Features", ["Lifetime"]),
        (["Features"], "", "Features", []),
        ([], "Features", "", []),
    ],
)
def test_results_by_kind_even_where_none_is_left(kinds: list[str], only: str, but: str, expected: list[str]) -> None:
    carried = TABLES["carried"].rows([{"recording_id": "r", "kind": kind, "position": i, "payload": "{}"} for i, kind in enumerate(kinds)])  # fmt: skip
    assert [row["kind"] for row in _rows(carried, only, but)] == expected
    assert _rows(None, only, but) == []
