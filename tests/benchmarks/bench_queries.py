"""Questions to the published database against the same in pandas over the same rows, as Parquet files per table.

Both start from files on disk and end with the answer in Python, so opening and reading count, as they do for somebody
with a question. The rows are those of the demonstration campaign, copied until there are many.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import duckdb
import numpy as np
import pandas as pd

TITLE = "Queries: DuckDB against pandas"
LIVES = int(os.environ.get("DEALAB_BENCH_ROWS", "1000000"))
RUNS = 5


def make(folder: Path, lives: int) -> tuple[Path, Path]:
    """Lifetimes and responses of many specimens, once as a database and once as Parquet."""
    rng = np.random.default_rng(20260301)
    database = folder / "results.duckdb"
    with duckdb.connect(str(database)) as connection:
        connection.register(
            "life",
            pd.DataFrame(
                {
                    "specimen_id": [f"S-{i:07d}" for i in range(lives)],
                    "configuration": rng.choice(["A", "B", "C", "D"], lives),
                    "voltage_kv": rng.choice([6.5, 7.0, 7.5], lives),
                    "lifetime_s": rng.exponential(40.0, lives),
                    "failed": rng.random(lives) < 0.8,
                }
            ),
        )
        connection.register(
            "answer",
            pd.DataFrame(
                {
                    "specimen_id": np.repeat([f"S-{i:07d}" for i in range(lives // 100)], 100),
                    "frequency_hz": np.tile(np.geomspace(1, 100, 100), lives // 100),
                    "amplitude": rng.normal(1.0, 0.1, lives // 100 * 100),
                }
            ),
        )
        connection.execute("CREATE TABLE lifetimes AS SELECT * FROM life ORDER BY specimen_id")
        connection.execute(
            "CREATE TABLE frequency_responses AS SELECT * FROM answer ORDER BY specimen_id, frequency_hz"
        )
        for table in ("lifetimes", "frequency_responses"):
            connection.execute(f"COPY {table} TO '{folder / table}.parquet'")
    return database, folder


def questions(database: Path, tables: Path) -> dict[str, tuple[Callable[[], Any], Callable[[], Any]]]:
    """Question to its answer from the database and from pandas, as plain sorted rows."""

    def ask(query: str) -> list[tuple[Any, ...]]:
        with duckdb.connect(str(database), read_only=True) as connection:
            return connection.execute(query).fetchall()

    def share_alive() -> list[tuple[Any, ...]]:
        frame = pd.read_parquet(tables / "lifetimes.parquet")
        alive = (frame["lifetime_s"] > 60).groupby([frame["configuration"], frame["voltage_kv"]]).mean()
        return [(*key, value) for key, value in alive.items()]  # type: ignore[misc]

    def one_specimen() -> list[tuple[Any, ...]]:
        frame = pd.read_parquet(tables / "frequency_responses.parquet")
        rows = frame[frame["specimen_id"] == "S-0000007"].sort_values("frequency_hz")
        return list(rows[["frequency_hz", "amplitude"]].itertuples(index=False, name=None))

    def joined() -> list[tuple[Any, ...]]:
        lives = pd.read_parquet(tables / "lifetimes.parquet")
        answers = pd.read_parquet(tables / "frequency_responses.parquet")
        means = answers.groupby("specimen_id")["amplitude"].mean().reset_index()
        both = lives[lives["failed"]].merge(means, on="specimen_id").groupby("configuration")["amplitude"].mean()
        return list(both.items())

    return {
        "share alive after 60 s by configuration and voltage": (
            lambda: ask(
                "SELECT configuration, voltage_kv, avg((lifetime_s > 60)::INT) FROM lifetimes GROUP BY ALL ORDER BY ALL"
            ),
            share_alive,
        ),
        "response of one specimen": (
            lambda: ask(
                "SELECT frequency_hz, amplitude FROM frequency_responses WHERE specimen_id = 'S-0000007' ORDER BY 1"
            ),
            one_specimen,
        ),
        "mean response of what failed, by configuration": (
            lambda: ask(
                "SELECT configuration, avg(mean) FROM lifetimes JOIN (SELECT specimen_id, avg(amplitude) AS mean "
                "FROM frequency_responses GROUP BY ALL) USING (specimen_id) WHERE failed GROUP BY ALL ORDER BY ALL"
            ),
            joined,
        ),
    }


def run(lives: int = LIVES, runs: int = RUNS) -> list[dict[str, Any]]:
    """Median seconds of each question both ways, interleaved; the answers are compared."""
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as name:
        for question, ways in questions(*make(Path(name), lives)).items():
            answers = [way() for way in ways]
            for ours, theirs in zip(*answers, strict=True):
                if not all(a == b or abs(a - b) < 1e-9 for a, b in zip(ours, theirs, strict=True)):
                    raise RuntimeError(f"{question}: {ours} and {theirs}")
            seconds: tuple[list[float], list[float]] = ([], [])
            for _ in range(runs):
                for way, taken in zip(ways, seconds, strict=True):
                    begin = time.perf_counter()
                    way()
                    taken.append(time.perf_counter() - begin)
            own, other = (float(np.median(taken)) for taken in seconds)
            rows += [
                {"name": question, "seconds": own, "note": f"{lives:.0e} lives and as many points, opening included"},
                {"name": "the same in pandas", "seconds": other, "ratio": other / own, "note": "ratio: slower by"},
            ]
    return rows
