"""A sweep of voltage that was stopped early, from the file of its bench to the page of its film: nothing is named from it.

Its frequency response is refused, and no diagnosis may name a cause from what is left: not of an electrical test, and not where
the bench calls its film a system of another kind.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import duckdb
import numpy as np
import pytest

from pipeline import Lab
from pipeline.nightly.night import nightly
from schemas.mechanisms import MECHANISMS

LOW, HIGH, SECONDS, RATE = 1.0, 100.0, 40.0, 1000.0
STATIC, TAU = 0.004, 0.01
"""Drop of tension in N/kV², half of it at once and half with 10 ms."""
KINDS = {
    "electrical": {"voltage": ("HV", "kV"), "force": ("Load", "N")},
    "other": {"input": ("HV", "kV"), "output": ("Load", "N")},
}


def write_sweep(folder: Path, name: str, loading: str, seconds: float) -> None:
    """The export of a bench with its mapping: a logarithmic sweep of the voltage on a film, recorded for `seconds`."""
    t = np.arange(0.0, seconds, 1 / RATE)
    rate = np.log(HIGH / LOW) / SECONDS
    voltage = 2.5 + 2.0 * np.sin(2 * np.pi * LOW * np.expm1(rate * t) / rate)
    late = np.empty(t.size)
    late[0] = voltage[0] ** 2
    kept = np.exp(-1 / (RATE * TAU))
    for i, square in enumerate(voltage[:-1] ** 2):
        late[i + 1] = kept * late[i] + (1 - kept) * square
    force = 1.0 - STATIC * 0.5 * (voltage**2 + late) + np.random.default_rng(7).normal(0, 2e-4, t.size)
    rows = [f"{a:.4f},{b:.6f},{c:.6f}" for a, b, c in zip(t, voltage, force, strict=True)]
    (folder / f"{name}.csv").write_text("\n".join(["t,HV,Load", *rows, ""]))
    columns = "".join(
        f'[columns.{quantity}]\ncolumn = "{column}"\nunit = "{unit}"\n'
        for quantity, (column, unit) in KINDS[loading].items()
    )
    (folder / f"{name}.csv.toml").write_text(
        f'[time]\ncolumn = "t"\nunit = "s"\n{columns}[recording]\nrecording_id = "{name}"\nspecimen_id = "film-{name}"\n'
        f'protocol = "chirp"\nloading = "{loading}"\nstarted_at = "2026-03-01T14:05:00+01:00"\n'
        f'frequency_start_hz = {LOW}\nfrequency_stop_hz = {HIGH}\nsweep = "log"\n'
    )


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Lab:
    folder = tmp_path_factory.mktemp("sweeps")
    (folder / "raw").mkdir()
    for loading in KINDS:
        write_sweep(folder / "raw", f"{loading}-whole", loading, SECONDS)
        write_sweep(folder / "raw", f"{loading}-cut", loading, 1.2)
    nightly([folder / "raw"], Lab(folder / "lab"), jobs=0)
    return Lab(folder / "lab")


def select(lab: Lab, query: str) -> list[Any]:
    with duckdb.connect(str(lab.database), read_only=True) as connection:
        return connection.sql(query).fetchall()


def read_page(lab: Lab, name: str) -> str:
    page = (lab.reports / f"{name}.html").read_text(encoding="utf-8")
    return re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", page))


@pytest.mark.parametrize("loading", KINDS)
def test_a_whole_sweep_has_its_response(lab: Lab, loading: str) -> None:
    usable = (
        f"SELECT count(*), max(frequency_hz) FROM frequency_responses WHERE usable AND recording_id = '{loading}-whole'"
    )
    ((lines, highest),) = select(lab, usable)
    assert lines > 20
    assert highest > 50


def test_the_hold_that_a_diagnosis_rests_on_is_an_assumption_on_the_page(lab: Lab) -> None:
    """Made by the diagnosis, beside what the recording's own analyses assume."""
    asked = "SELECT value, because FROM assumptions WHERE what = 'input between its samples' AND recording_id"
    ((value, because),) = select(lab, f"{asked} = 'other-whole'")
    assert because.startswith("no key says it")
    assert select(lab, f"{asked} LIKE 'electrical%'") == []
    assert f"Input between its samples: {value}" in read_page(lab, "specimens/film-other-whole")


@pytest.mark.parametrize("loading", KINDS)
def test_a_sweep_whose_response_is_refused_names_no_cause(lab: Lab, loading: str) -> None:
    name = f"{loading}-cut"
    ((usable,),) = select(lab, f"SELECT count(*) FROM frequency_responses WHERE usable AND recording_id = '{name}'")
    assert usable == 0
    rows = select(
        lab, f"SELECT verdict, mechanism, mechanisms, could_not_ask FROM diagnoses WHERE specimen_id = 'film-{name}'"
    )
    assert all((row[0], row[1], row[2] or []) in ((None, None, []), ("unknown", None, [])) for row in rows)
    assert all(row[3] for row in rows), "why nothing is named"
    ((why,),) = select(lab, f"SELECT what_was_missing FROM without_result WHERE recording_id = '{name}'")
    assert "the record begins or ends while the sweep passes here" in why
    page = read_page(lab, f"specimens/film-{name}") + read_page(lab, f"recordings/{name}")
    assert "the record begins or ends while the sweep passes here" in page
    found = [cause.finding.partition(",")[0].partition("{")[0].strip() for cause in MECHANISMS.values()]
    assert [words for words in found if words in page] == []
