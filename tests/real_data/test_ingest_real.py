"""Recordings and tables that nobody here made, through the door: counts and values of each data set's PROVENANCE.md."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from ingest.canonical import canonical
from ingest.discover import MAPPED
from ingest.excel_reader import sheet_rows
from ingest.inspect import inspect
from ingest.mapping import find_mapping
from ingest.read import read_raw
from ingest.tables import LifetimeTable, RelaxationTable, ResponseTable
from pipeline.transform.channels import drive
from schemas.recording import RawRecording, Recording
from tests.helpers.found_files import discover

Layout = Callable[[str], Path]


def recording(path: Path) -> Recording:
    raw = read_raw(path, find_mapping(path))
    assert isinstance(raw, RawRecording)
    return canonical(raw, where=path.name)


def lifetimes(path: Path) -> LifetimeTable:
    table = read_raw(path, find_mapping(path))
    assert isinstance(table, LifetimeTable)
    return table


def response(path: Path) -> ResponseTable:
    table = read_raw(path, find_mapping(path))
    assert isinstance(table, ResponseTable)
    return table


def test_vhb_cycle(real_folder: Layout) -> None:
    found = recording(real_folder("vhb4910_miles_mcmc") / "vhb4910_data.mat")
    stretch, stress = found.channels["stretch"], found.channels["stress"]
    time_s = (stretch.time_ns - stretch.time_ns[0]) * 1e-9
    assert stretch.values.size == stress.values.size == 1275
    peak = int(np.argmax(stretch.values))
    assert stretch.values[[0, peak, -1]] == pytest.approx([1.0, 5.41198, 1.31496], abs=5e-6)
    assert time_s[peak] == pytest.approx(6.61)
    assert stress.values[0] == pytest.approx(2.455, abs=5e-4)
    assert stress.values.max() == pytest.approx(214.5, abs=0.05)
    assert np.diff(stretch.values)[:600].mean() / 0.01 == pytest.approx(0.67, abs=0.01)
    assert found.status == "ok"
    assert any("stretch, stress" in note and "0.02 s" in note for note in found.notes)


def test_vhb_as_a_cube(real_folder: Layout) -> None:
    found = drive(recording(real_folder("vhb4910_miles_mcmc") / "vhb4910_data.mat"))
    assert found.input.values.max() == pytest.approx(4.41198, abs=5e-6)
    assert found.output.values.max() == pytest.approx(0.2145, abs=5e-5)


def test_pet_film_lives(real_folder: Layout) -> None:
    table = lifetimes(real_folder("hirose_pet_film") / "hirose.csv")
    assert len(table.rows) == 44
    censored = [row for row in table.rows if not row.failed]
    assert [(row.lifetime_s, row.voltage_kv) for row in censored] == [(9104.25 * 3600, 5.0)] * 3
    assert {row.voltage_kv for row in table.rows} == {5.0, 7.0, 10.0, 15.0}
    at_15 = sorted(row.lifetime_s / 3600 for row in table.rows if row.voltage_kv == 15)
    assert np.median(at_15) == pytest.approx(4.65)
    assert len({row.specimen_id for row in table.rows}) == 44
    assert not table.problems


@pytest.mark.parametrize(
    ("name", "count", "low", "high"),
    [
        ("freq_master.csv", 206, 1e-12, 1e14),
        ("freq_raw.csv", 210, 1e-20, 1e13),
        ("freq_user_master.csv", 206, 1e-12, 1e14),
    ],
)
def test_dmta_master_curves(real_folder: Layout, name: str, count: int, low: float, high: float) -> None:
    table = response(real_folder("pyvisco_dmta") / name)
    assert table.frequency_hz.size == count
    assert (table.frequency_hz[0], table.frequency_hz[-1]) == (low, high)
    assert (np.diff(table.frequency_hz) > 0).all()
    assert table.measured_as == "modulus"
    assert (table.value.imag > 0).all()
    assert not table.problems


def test_dmta_plateau_is_kept(real_folder: Layout) -> None:
    table = response(real_folder("pyvisco_dmta") / "freq_master.csv")
    assert table.value[0] == pytest.approx(88.79651575665739 + 10.502460140936773j)
    assert table.value.real.max() == pytest.approx(9580, abs=1)


def test_dmta_user_and_verification_files_agree(real_folder: Layout) -> None:
    folder = real_folder("pyvisco_dmta")
    named, plain = response(folder / "freq_user_master.csv"), response(folder / "freq_master.csv")
    assert np.array_equal(named.value, plain.value)


def test_dmta_relaxation(real_folder: Layout) -> None:
    path = real_folder("pyvisco_dmta") / "time_master.csv"
    table = read_raw(path, find_mapping(path))
    assert isinstance(table, RelaxationTable)
    assert table.time_s.size == 481
    assert table.value[0] == pytest.approx(1714.266)
    assert (table.time_s[0], table.time_s[-1]) == (0.00281764, 1.39e28)


def test_dmta_raw_sweep_at_one_temperature(real_folder: Layout) -> None:
    table = response(real_folder("pyvisco_dmta") / "freq_user_raw.csv")
    assert table.temperature_c is not None
    assert table.frequency_hz.size == 10
    assert table.temperature_c.mean() == pytest.approx(25.0, abs=0.5)


def test_dmta_excel_exports(real_folder: Layout) -> None:
    folder = real_folder("pyvisco_dmta")
    tension, shear = (response(folder / f"freq_Eplexor_master{s}.xls") for s in ("", "_shear"))
    assert tension.frequency_hz.size == 210
    assert shear.frequency_hz.size == 183
    rows = sheet_rows(folder / "freq_Eplexor_master.xls", "Exported Data")
    magnitude = {row[rows[0].index("f")]: row[rows[0].index("|E*|")] for row in rows[2:]}
    expected = [magnitude[f] for f in tension.frequency_hz]
    assert np.abs(tension.value) == pytest.approx(expected, rel=1e-4)  # the export rounds


def test_pneumatic_actuator(real_folder: Layout) -> None:
    folder = real_folder("pneumatic_actuator_loadcell")
    four, one, six = (recording(folder / f"Circle_{p}bar.csv") for p in (4, 1, 6))
    assert four.channels["force"].values.size == 4183
    assert one.channels["force"].values.size == 7139
    limits = [f(r.channels["force"].values) for r in (one, six) for f in (np.min, np.max)]
    assert limits == pytest.approx([42.5, 56.6, 277, 314], abs=0.5)
    assert any("largest 0.299 s" in n or "gaps" in n for r in (four, one, six) for n in r.notes)
    largest = max(np.diff(recording(p).channels["force"].time_ns).max() for p in sorted(folder.glob("*.csv")))
    assert largest * 1e-9 == pytest.approx(0.299)
    assert np.median(np.diff(one.channels["force"].time_ns)) == 10_000_000
    assert four.channels["displacement"].sensor == "laser"


def test_adhesive_column_order(real_folder: Layout) -> None:
    folder = real_folder("oca_shear_zhao")
    rates = {}
    for name, rows in (("0d01", 199), ("0d05", 149), ("0d1", 100), ("1", 61)):
        found = recording(folder / f"monotonic_shear_{name}.xlsx")
        stretch = found.channels["stretch"]
        assert stretch.values.size == rows
        assert found.channels["stress"].values.max() > 5  # kPa; the strain of a swapped column stays below
        elapsed = (stretch.time_ns[5] - stretch.time_ns[0]) * 1e-9
        rates[name] = (stretch.values[5] - stretch.values[0]) / elapsed
    assert rates == pytest.approx({"0d01": 0.01, "0d05": 0.05, "0d1": 0.1, "1": 1.0}, rel=0.1)


def test_adhesive_relaxation(real_folder: Layout) -> None:
    folder = real_folder("oca_shear_zhao")
    for name, rows in (("_0d1", 432), ("_1", 370), ("_2", 370), ("_5", 370)):
        found = recording(folder / f"shear_relaxation{name}.xlsx")
        assert found.channels["stress"].values.size == rows
        assert found.channels["stretch"].values.min() >= 1.0


def test_silverbox(real_folder: Layout) -> None:
    found = recording(real_folder("silverbox") / "SNLS80mV.csv")
    drive = found.channels["input"]
    assert drive.values.size == 131072
    assert drive.unit == "V"
    assert (drive.time_ns[-1] - drive.time_ns[0]) * 1e-9 == pytest.approx(131071 * 2**14 / 1e7, abs=1e-8)
    assert found.status == "ok"


def test_silverbox_period(real_folder: Layout) -> None:
    found = recording(real_folder("silverbox") / "Schroeder80mV-period.csv")
    drive, answer = (found.channels[q].values for q in ("input", "output"))
    assert drive.size == 1024
    assert np.std(drive) == pytest.approx(26.93e-3, abs=5e-6)
    assert np.std(answer) == pytest.approx(55.56e-3, abs=5e-6)


def test_leukaemia_table(real_folder: Layout) -> None:
    table = lifetimes(real_folder("lifelines_km") / "anderson.csv")
    assert len(table.rows) == 42
    treated = [row for row in table.rows if row.configuration == "0"]
    assert len(treated) == 21
    assert sum(row.failed for row in treated) == 9
    assert sorted(r.lifetime_s / 604800 for r in treated if r.failed) == pytest.approx([6, 6, 6, 7, 10, 13, 16, 22, 23])


def test_walton_table(real_folder: Layout) -> None:
    table = lifetimes(real_folder("lifelines_km") / "waltons_dataset.csv")
    assert len(table.rows) == 163
    assert sum(row.failed for row in table.rows) == 156
    assert {row.configuration for row in table.rows} == {"miR-137", "control"}


def test_left_censored_lives_failed_before_they_were_first_looked_at(real_folder: Layout) -> None:
    path = real_folder("lifelines_km") / "CuZn-LeftCensoredDataset.csv"
    left = [line.startswith("0,") for line in path.read_text(encoding="utf-8").splitlines()[1:]]
    rows = lifetimes(path).rows
    assert [row.alive_at_s == 0.0 for row in rows] == left
    assert all(row.failed for row in rows)


@pytest.mark.parametrize(
    "dataset",
    ["vhb4910_miles_mcmc", "hirose_pet_film", "pyvisco_dmta", "oca_shear_zhao", "pneumatic_actuator_loadcell"],
)
def test_every_file_is_found_and_fits(real_folder: Layout, dataset: str) -> None:
    found = discover([real_folder(dataset)])
    assert found.files
    assert all(f.state == MAPPED and f.error is None for f in found.files)
    for file in found.files:
        inspection = inspect(file.path)
        assert inspection.fits, inspection.as_text()


def test_unmapped_real_files_get_drafts(real_data: Path) -> None:
    for path in sorted(real_data.glob("silverbox/*.csv")) + sorted(real_data.glob("pneumatic*/friction/*.csv")):
        inspection = inspect(path)
        assert inspection.verdict == "unmapped"
        assert inspection.draft is not None
