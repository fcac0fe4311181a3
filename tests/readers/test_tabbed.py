"""Texts with heads of their own: LabVIEW measurements and exports of TRIOS, written here as their descriptions have them."""

from __future__ import annotations

import tomllib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import pyuff

from ingest.draft import make_draft
from ingest.inspect import DAMAGED, FITS, inspect
from ingest.lvm_reader import read_lvm
from ingest.mapping import FileMapping
from ingest.mapping_keys import OPTIONS
from ingest.mapping_schema import SCHEMAS
from ingest.reader_kit import check_reader
from ingest.trios_reader import read_trios
from schemas.errors import RefusedError
from tests.helpers.json_schema import is_valid

ALL = FileMapping("recording", None, {}, None, {}, {}, {})
LVM = SimpleNamespace(suffixes=(".lvm",), options=OPTIONS["lvm"], read=read_lvm)
TRIOS = SimpleNamespace(suffixes=(".txt",), options=OPTIONS["trios"], read=read_trios)
END = "***End_of_Header***"
HEAD = (
    "LabVIEW Measurement\t\nWriter_Version\t2\t\nReader_Version\t2\t\nSeparator\tTab\t\nDecimal_Separator\t{decimal}\t\n"
    f"Multi_Headings\tYes\t\nX_Columns\t{{x}}\t\nTime_Pref\tAbsolute\t\nOperator\tMira\t\nDate\t2026/03/01\t\n"
    f"Time\t14:05:00.5\t\n{END}\t\n\t\n"
)


def segment(
    rows: list[str], names: str, *, clock: str = "14:05:00.5", dx: str = "0.01", samples: int | None = None
) -> str:
    """A segment of two channels, in N and mm."""
    count = len(rows) if samples is None else samples
    return (
        f"Channels\t2\t\t\t\nSamples\t{count}\t{count}\t\t\nDate\t2026/03/01\t2026/03/01\t\t\nTime\t{clock}\t{clock}\t\t\n"
        f"***Start_Special***\nnonsense\t7\n***End_Special***\n"
        f"Y_Unit_Label\tN\tmm\t\t\nX_Dimension\tTime\tTime\t\t\nX0\t0.0000000000000000E+0\t0.0000000000000000E+0\t\t\n"
        f"Delta_X\t{dx}\t{dx}\t\t\n{END}\t\t\t\t\n{names}\tComment\n" + "\n".join(rows) + "\n"
    )


def lvm(tmp_path: Path, text: str, name: str = "run.lvm") -> Path:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8", newline="\r\n")
    return path


def test_a_measurement_without_a_column_of_times_has_those_of_its_head(tmp_path: Path) -> None:
    rows = [f"\t{i / 10}\t{i}" for i in range(50)]
    rows[7] += "\tvalve opened"
    file = read_lvm(lvm(tmp_path, HEAD.format(decimal=".", x="No") + segment(rows, "X_Value\tLoad cell\tWeg")), ALL)
    assert file.names() == ("X_Value", "Load cell", "Weg")
    np.testing.assert_array_equal(file.numbers("Load cell").values, np.arange(50) / 10)
    assert (file.unit("Load cell"), file.unit("Weg")) == ("N", "mm")
    own = file.own_time("Weg")
    assert own is not None
    assert own.start_ns is None
    np.testing.assert_allclose(own.elapsed_s, np.arange(50) / 100, atol=1e-15)
    assert file.problems == ()
    assert file.notes == ('1 rows have comments, such as "valve opened"',)


@pytest.mark.parametrize("x", ["One", "Multi"])
def test_columns_of_times_are_used(tmp_path: Path, x: str) -> None:
    between = "{t}\t" if x == "Multi" else ""
    rows = [(f"{i * i / 100}\t{i / 10}\t" + between.format(t=i / 50) + f"{i}").replace(".", ",") for i in range(50)]
    names = "X_Value\tLoad cell\t" + ("X_Value\t" if x == "Multi" else "") + "Weg"
    file = read_lvm(lvm(tmp_path, HEAD.format(decimal=",", x=x) + segment(rows, names)), ALL)
    np.testing.assert_array_equal(file.numbers("Load cell").values, np.arange(50) / 10)
    first, second = file.own_time("Load cell"), file.own_time("Weg")
    assert first is not None
    assert second is not None
    np.testing.assert_allclose(first.elapsed_s, np.arange(50) ** 2 / 100)
    np.testing.assert_allclose(second.elapsed_s, np.arange(50) / 50 if x == "Multi" else np.arange(50) ** 2 / 100)


def test_segments_follow_by_their_clocks(tmp_path: Path) -> None:
    parts = [
        segment([f"\t{i}\t0" for i in range(4)], "X_Value\tF\tx"),
        segment([f"\t{i}\t0" for i in range(4, 7)], "X_Value\tF\tx", clock="14:06:00.25", dx="0.02"),
    ]
    file = read_lvm(lvm(tmp_path, HEAD.format(decimal=".", x="No") + "\n".join(parts)), ALL)
    np.testing.assert_array_equal(file.numbers("F").values, np.arange(7))
    own = file.own_time("F")
    assert own is not None
    np.testing.assert_allclose(own.elapsed_s, [0, 0.01, 0.02, 0.03, 59.75, 59.77, 59.79])
    assert "2 segments" in file.notes[0]
    parts[1] = parts[1].replace("X_Value\tF\tx", "X_Value\tF\ty")
    with pytest.raises(RefusedError, match="segment 1 has the columns"):
        read_lvm(lvm(tmp_path, HEAD.format(decimal=".", x="No") + "\n".join(parts)), ALL)


def test_a_spectrum_is_no_measurement_over_time(tmp_path: Path) -> None:
    text = HEAD.format(decimal=".", x="No") + segment(["\t1\t2"] * 5, "X_Value\tF\tx").replace(
        "Time\tTime", "Frequency\tFrequency"
    )
    with pytest.raises(RefusedError, match="X_Dimension"):
        read_lvm(lvm(tmp_path, text), ALL).own_time("F")


def test_a_cut_measurement_says_how_much_is_missing(tmp_path: Path) -> None:
    rows = [f"\t{i / 10}\t{i}" for i in range(50)]
    text = HEAD.format(decimal=".", x="No") + segment(rows, "X_Value\tF\tx", samples=80)
    path = lvm(tmp_path, text[:-4])
    file = read_lvm(path, ALL)
    assert "there are 50 of 80 samples: the file is cut" in file.problems


def test_a_measurement_is_drafted_and_fits(tmp_path: Path) -> None:
    rows = [f"\t{np.sin(i / 40):.5f}\t{np.cos(i / 40):.5f}" for i in range(4000)]
    path = lvm(tmp_path, HEAD.format(decimal=".", x="No") + segment(rows, "X_Value\tForce\tDisplacement"))
    draft = make_draft(path)
    assert draft.content["columns"] == {
        "force": {"column": "Force", "unit": "N"},
        "displacement": {"column": "Displacement", "unit": "mm"},
    }
    assert "time" not in draft.content or "column" not in draft.content["time"]
    assert draft.content["recording"]["started_at"].startswith("2026-03-01T14:05:00.5")
    assert draft.content["recording"]["operator"] == "Mira"
    path.with_name("run.lvm.toml").write_text(draft.as_toml(), encoding="utf-8")
    assert is_valid(tomllib.loads(draft.as_toml()), SCHEMAS["mapping"]())
    found = inspect(path)
    assert found.verdict == FITS, found.as_text()
    assert found.channels[0].rate_hz == pytest.approx(100)


@pytest.mark.parametrize("text", ["LabVIEW Measurement\n", "t\tF\n1\t2\n", f"LabVIEW Measurement\n{END}\n\n1\t2\n"])
def test_what_is_no_measurement_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(RefusedError):
        read_lvm(lvm(tmp_path, text), ALL)


def test_the_kit_passes_measurements(tmp_path: Path) -> None:
    rows = [f"\t{i / 10}\t{i}" for i in range(50)]
    path = lvm(tmp_path, HEAD.format(decimal=".", x="No") + segment(rows, "X_Value\tF\tx"))
    check_reader(LVM, path, {"F": list(np.arange(50) / 10)}, units={"F": "N"})


NAMES = ("Angular frequency", "Temperature", "Storage modulus", "Loss modulus")
UNITS = ("rad/s", "°C", "kPa", "kPa")


def table(temperature: float) -> list[tuple[float, ...]]:
    """Rows of one step."""
    omega = np.geomspace(0.1, 100, 7)
    return [(w, temperature + 0.01 * i, 100 + 10 * i, 5 + i) for i, w in enumerate(omega)]


def plain_step(
    name: str, rows: list[tuple[float, ...]], names: tuple[str, ...] = NAMES, units: tuple[str, ...] = UNITS
) -> str:
    """A step of the layout in which the lines say nothing of themselves."""
    body = "".join("\t".join(f"{v:.10g}" for v in row) + "\n" for row in rows)
    return f"[step]\n{name}\n" + "\t".join(names) + "\n" + "\t".join(units) + "\n" + body + "\n"


def labelled_step(name: str, rows: list[tuple[float, ...]], said: int | None = None) -> str:
    """A step of the layout in which each line begins with what it is."""
    body = "".join("Data point\t" + "\t".join(f"{v:.10g}" for v in row) + "\t\t\n" for row in rows)
    count = len(rows) if said is None else said
    names, units = "\t".join(NAMES), "\t".join(UNITS)
    return f"[Step]\nStep name\t{name}\nNumber of points\t{count}\nVariables\t{names}\t\t\nUnits\t{units}\t\n{body}"


def trios(tmp_path: Path, *steps: str) -> Path:
    path = tmp_path / "sweeps.txt"
    head = "Filename\tsweeps\nInstrument name\t5332\nOperator\tMira\nSample name\tVHB 7\n[File Parameters]\nName\tsweeps.tri\n"
    path.write_text(head + "".join(steps), encoding="utf-8", newline="\r\n")
    return path


@pytest.mark.parametrize("step", [plain_step, labelled_step])
def test_temperatures_of_one_export_are_drafted_as_recordings(tmp_path: Path, step: object) -> None:
    path = trios(tmp_path, *(step(f"Frequency sweep ({t} °C)", table(t)) for t in (0.0, 20.0, 40.0)))  # type: ignore[operator]
    draft = make_draft(path)
    assert draft.content["recording"]["specimen_id"] == "VHB 7"
    toml = draft.as_toml()
    path.with_name("sweeps.txt.toml").write_text(toml, encoding="utf-8")
    found = inspect(path)
    assert found.verdict == FITS, found.as_text()
    assert any("3 recordings in one file: 0, 20, 40" in note for note in found.notes)
    low, high = next((c.low, c.high) for c in found.channels if c.name == "frequency")
    assert (low, high) == pytest.approx((0.1 / 2 / np.pi, 100 / 2 / np.pi))


def test_rows_of_other_steps_are_left_out_and_named(tmp_path: Path) -> None:
    flow = plain_step("Flow ramp - 2", [(1.0, 2.0)], ("Shear rate", "Viscosity"), ("1/s", "Pa.s"))
    path = trios(tmp_path, plain_step("Frequency sweep - 1", table(20)), flow)
    mapping = FileMapping.parse(
        {"kind": "frequency_response", "format": "trios", "columns": {
            "frequency": {"column": "Angular frequency"}, "storage": {"column": "Storage modulus"},
            "loss": {"column": "Loss modulus"}}, "recording": {"recording_id": "a"}},
        stem="sweeps", suffix=".txt",
    )  # fmt: skip
    file = read_trios(path, mapping)
    assert set(file.cells("step")) == {"Frequency sweep - 1"}
    assert file.unit("Storage modulus") == "kPa"
    assert file.notes == ("steps without the mapped columns are left out: Flow ramp - 2",)


def test_an_amplitude_sweep_in_the_same_export_is_not_drafted(tmp_path: Path) -> None:
    amplitude = [(6.28, 20.0, 100 - i, 5.0) for i in range(9)]
    path = trios(tmp_path, plain_step("Amplitude sweep - 1", amplitude), plain_step("Frequency sweep - 2", table(20)))
    draft = make_draft(path)
    assert draft.content["select"] == [{"column": "step", "equals": "Frequency sweep - 2"}]
    path.with_name("sweeps.txt.toml").write_text(draft.as_toml(), encoding="utf-8")
    assert inspect(path).verdict == FITS, inspect(path).as_text()


def test_units_that_change_between_steps_are_refused(tmp_path: Path) -> None:
    other = plain_step("b", table(20), units=("rad/s", "°C", "MPa", "kPa"))
    path = trios(tmp_path, plain_step("a", table(20)), other)
    mapping = FileMapping.parse(
        {"kind": "frequency_response", "format": "trios", "columns": {
            "frequency": {"column": "Angular frequency"}, "storage": {"column": "Storage modulus"},
            "loss": {"column": "Loss modulus"}}, "recording": {"recording_id": "a"}},
        stem="sweeps", suffix=".txt",
    )  # fmt: skip
    with pytest.raises(RefusedError, match="in different steps"):
        read_trios(path, mapping)


def test_a_cut_export_says_so(tmp_path: Path) -> None:
    path = trios(tmp_path, labelled_step("Frequency sweep (20 °C)", table(20), said=9))
    path.with_name("sweeps.txt.toml").write_text(make_draft(path).as_toml(), encoding="utf-8")
    found = inspect(path)
    assert found.verdict == DAMAGED
    assert found.problems == ('step "Frequency sweep (20 °C)" has 7 of 9 rows: the file is cut',)


def test_a_creep_test_is_not_taken_for_a_relaxation(tmp_path: Path) -> None:
    rows = [(0.1 * i, 0.5, 2.0 + i, 0.2) for i in range(9)]
    names = ("Step time", "Stress", "Compliance", "Modulus")
    path = trios(tmp_path, plain_step("Creep - 1", rows, names, ("s", "MPa", "1/MPa", "MPa")))
    assert make_draft(path).content["kind"] == "recording"


def test_the_kit_passes_exports(tmp_path: Path) -> None:
    path = trios(tmp_path, labelled_step("Frequency sweep", table(20)))
    rows = np.array(table(20))
    check_reader(TRIOS, path, {"Storage modulus": list(rows[:, 2])}, units={"Storage modulus": "kPa"})


def test_a_response_of_a_universal_file_is_drafted(tmp_path: Path) -> None:
    path = tmp_path / "frf.uff"
    data = 1 / (1 + 1j * np.arange(1, 9))
    pyuff.UFF(str(path)).write_sets(
        {"type": 58, "func_type": 4, "rsp_node": 1, "rsp_dir": 1, "ref_dir": 1, "ref_node": 1, "binary": 0,
         "data": data, "x": np.arange(1.0, 9.0), "id1": "stiffness", "abscissa_axis_units_lab": "Hz",
         "ordinate_axis_units_lab": "N", "orddenom_axis_units_lab": "mm",
         "orddenom_spec_data_type": 8},
        "overwrite",
    )  # fmt: skip
    draft = make_draft(path)
    assert draft.content["kind"] == "frequency_response"
    assert draft.content["columns"] == {"response": {"column": "stiffness", "unit": "N/mm"}}
    path.with_name("frf.uff.toml").write_text(draft.as_toml(), encoding="utf-8")
    found = inspect(path)
    assert found.verdict == FITS, found.as_text()
    assert next(c.low for c in found.channels if c.name == "storage") == pytest.approx(data.real.min())


@pytest.mark.parametrize("layout", ["[step]\nHold\n{names}\n{units}\n", "[Step]\nVariables\t{names}\nUnits\t{units}\n"])
@pytest.mark.parametrize(("cut", "why"), [(4, "is not written like"), (12, "in the middle of a line"), (0, "")])
def test_an_export_cut_in_its_last_line_keeps_the_rows_before_it(
    tmp_path: Path, layout: str, cut: int, why: str
) -> None:
    rows = [(f"{i / 100:.2f}", f"{20 + i / 7:.5f}", f"{i / 3:.5f}") for i in range(400)]
    label = "Data point\t" if "Variables" in layout else ""
    body = "\n".join(label + "\t".join(row) for row in rows)
    path = tmp_path / "hold.txt"
    path.write_text((layout.format(names="Time\tForce\tGap", units="s\tN\tmm") + body)[: -cut or None])
    file = read_trios(path, ALL)
    assert list(file.cells("Gap")) == [gap for _, _, gap in rows[: -1 if why else None]]
    assert [why in problem for problem in file.problems] == ([True] if why else [])


def test_an_export_with_commas_is_a_table_behind_a_head(tmp_path: Path) -> None:
    """It was drafted as TRIOS, with all its columns as one, since it has a line `[step]`."""
    rows = "\n".join(f"{10 ** (i / 9):.4g},{1 + i / 20:.3f},{0.1 + i / 90:.4f}" for i in range(19))
    path = tmp_path / "sweep.csv"
    path.write_text(
        f"Instrument name,Q800\n\n[step]\nSweep\nFrequency,Storage modulus,Loss modulus\nHz,MPa,MPa\n{rows}\n"
    )
    content = make_draft(path).content
    assert content["kind"] == "frequency_response"
    assert set(content["columns"]) == {"frequency", "storage", "loss"}
    assert content.get("format", "csv") == "csv"
