"""What later stages take of a recording's results."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from pipeline.analyse.carried import carried_table, results_of
from pipeline.analyse.session_features import SessionFeatures
from pipeline.lab.inputs import Included, _choose_rows, fetch_inputs, fetch_results
from pipeline.lab.journal import Freshness, Outcome, entry_path, write_entry
from pipeline.lab.lab import Lab
from pipeline.lab.reader import NIGHT_MEMORY, Reader
from pipeline.lab.snapshot import Changes, publish
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
    assert [row["kind"] for row in _choose_rows(carried, only, but)] == expected
    assert _choose_rows(None, only, but) == []


def _kept(folder: Path, name: str, kinds: Sequence[str], **metadata: str) -> dict[str, pa.Table]:
    """The tables of a recording with results of some kinds, which stand in its journal as well."""
    about = json.dumps({"recording": {"recording_id": name, **metadata}, "rig": {}})
    row = {"recording_id": name, "kind": "recording", "metadata": about, "status": "ok", "source_path": name}
    rows = [{"recording_id": name, "kind": kind, "position": i, "payload": "{}"} for i, kind in enumerate(kinds)]
    tables = {"recordings": TABLES["recordings"].rows([row]), "carried": TABLES["carried"].rows(rows)}
    write_entry(folder, Outcome(name, "recording", Freshness("", "", ""), "ok"), tables)
    return tables


@pytest.mark.long_after(1)
@pytest.mark.parametrize("published", [(), ("a", "c"), ("a", "b", "c", "d")])
def test_results_of_a_group_from_journal_and_snapshot(tmp_path: Path, published: Sequence[str]) -> None:
    lab = Lab(tmp_path)
    every = {
        "a": _kept(tmp_path, "a", ["Lifetime", "SessionFeatures"], rods="5"),
        "b": _kept(tmp_path, "b", ["SessionFeatures", "Lifetime"]),
        "c": _kept(tmp_path, "c", ["FrequencyResponse"], rods="5"),
        "d": _kept(tmp_path, "d", ["Lifetime"], notes="rods of steel"),
    }
    publish(lab, Changes(insertions=[every[name] for name in published]))
    stored = [(name, None if name in published else entry_path(tmp_path, name)) for name in every]
    with Reader(lab.database) as reader:
        plain = fetch_results(stored, reader, {"Lifetime"})
        with_rods = fetch_results(stored, reader, {"Lifetime"}, mention="rods")
    assert [(one.recording_id, [row["kind"] for row in one.carried]) for one in plain] == [
        ("a", ["Lifetime"]), ("b", ["Lifetime"]), ("d", ["Lifetime"]),
    ]  # fmt: skip
    assert [one.recording_id for one in with_rods] == ["a"]
    assert json.loads(with_rods[0].about)["recording"]["rods"] == "5"


def test_a_night_reads_more_features_than_it_may_hold_at_once(tmp_path: Path) -> None:
    """DuckDB holds some thousand rows of a text at once: the second night of a lab of 230 recordings came to no end."""
    lab, rng = Lab(tmp_path / "lab"), np.random.default_rng(4)
    lab.create()
    texts = {f"r{i:02d}": rng.bytes(1_000_000).hex() for i in range(60)}
    about = [{"recording_id": name, "status": "ok", "source_path": name, "metadata": "{}"} for name in texts]
    features = {name: SessionFeatures(text) for name, text in texts.items()}
    insertions = [
        {"recordings": TABLES["recordings"].rows([row]), "carried": carried_table(name, [features[name]])}
        for row in about
        for name in [row["recording_id"]]
    ]
    publish(lab, Changes(insertions=insertions))
    made_from = Freshness("", "", "")
    asked = [Included(name, None, None, frozenset({"SessionFeatures"}), made_from) for name in texts]
    with Reader(lab.database, memory=NIGHT_MEMORY) as reader:
        for one in asked[:2]:
            (given,) = fetch_inputs([one], reader, only="SessionFeatures")
            assert results_of(given.carried) == (features[one.recording_id],)
        found = fetch_inputs(asked, reader, only="SessionFeatures")
    assert {one.recording_id: results_of(one.carried) for one in found} == {n: (f,) for n, f in features.items()}
