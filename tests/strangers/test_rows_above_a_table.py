"""Loggers whose columns are numbered, with rows above the table that say what each one is; dates and times in two columns."""

from __future__ import annotations

import tomllib
from datetime import datetime, timedelta
from pathlib import Path

import duckdb
import numpy as np
import pytest

from ingest.draft import make_draft
from pipeline.cli import main
from tests.strangers.nights import run_night


def write_logger(path: Path) -> float:
    """A French logger, two samples a second, over midnight: 4 kV from a minute on until the film breaks; returns its life in s."""
    begin = datetime(2026, 6, 30, 23, 40, 0)
    on, broke, count = 60.0, 2460.0, 2 * 2700
    draw = np.random.default_rng(3)
    rows = []
    for i in range(count):
        t = i / 2
        live = on <= t < broke
        volts = (4.0 if live else 0.0) + draw.normal(0, 0.002)
        force = 1.2 - (0.15 if live else 0.0) + draw.normal(0, 0.001)
        leak = (0.4 if live else 0.0) + (60.0 if t == broke else 0.0) + draw.normal(0, 0.01)
        now = begin + timedelta(seconds=t)
        clock = f"{now:%H:%M:%S},{500 if i % 2 else 0:03d}"
        rows.append(f"{now:%d/%m/%y};{clock};{volts:.3f};{force:.4f};{leak:.3f}".replace(".", ","))
    head = [
        "Centrale de mesure A7;essai de durée",
        "Désignation:;;Tension HT;Capteur de force;Courant de fuite",
        "Unité:;;kV;N;uA",
        "Date;Heure;V01;V02;V03",
    ]
    path.write_text("\n".join([*head, *rows]) + "\n", encoding="cp1252")
    return broke - on


@pytest.mark.long
def test_names_and_units_above_numbered_columns(tmp_path: Path) -> None:
    """Columns M00, M01 were guessed from their numbers while the file said what they are two rows above."""
    folder = tmp_path / "files"
    folder.mkdir()
    life = write_logger(folder / "nuit.csv")
    draft = make_draft(folder / "nuit.csv")
    assert "columns.voltage.column" not in [q.key for q in draft.questions]
    assert main(["add", str(folder / "nuit.csv"), "--yes", "specimen_id=F-2", "zone=Europe/Paris"]) == 0
    content = tomllib.loads((folder / "nuit.csv.toml").read_text(encoding="utf-8"))
    assert content["columns"] == {
        "voltage": {"column": "V01", "unit": "kV"},
        "force": {"column": "V02", "unit": "N"},
        "leakage_current": {"column": "V03", "unit": "uA"},
    }
    assert content["time"] == {
        "column": "Heure",
        "date_column": "Date",
        "format": "%d/%m/%y %H:%M:%S,%f",
        "zone": "Europe/Paris",
    }
    assert content["recording"]["protocol"] == "lifetime"
    made = run_night(folder, tmp_path / "night")
    with duckdb.connect(str(made.lab / "results.duckdb"), read_only=True) as connection:
        ((lifetime, failed, voltage),) = connection.sql(
            "SELECT lifetime_s, failed, voltage_kv FROM lifetimes"
        ).fetchall()
    assert lifetime == pytest.approx(life, abs=1.0)
    assert (failed, round(voltage, 2)) == (True, 4.0)
    assert (made.lab / "reports" / "recordings" / "nuit.html").is_file()
