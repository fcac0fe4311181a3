"""What binary files mean beyond plain arrays: packings, tables, structures, objects, waveforms, responses, order of messages.

Values are computed here apart from the readers, from what the formats' own documents say.
"""

from __future__ import annotations

import json
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
import scipy.sparse

from ingest.canonical import canonical
from ingest.mapping import FileMapping
from ingest.mcap_reader import read_mcap
from ingest.read import read_raw
from ingest.tables import ResponseTable
from schemas.errors import RefusedError
from schemas.recording import RawRecording, Recording
from tests.helpers.mcap_files import METADATA, START
from tests.readers.test_arrays import FORCE, START_NS, TIME, mapping, read
from tests.readers.test_mcap_messages import MS, write

h5py = pytest.importorskip("h5py")
nptdms = pytest.importorskip("nptdms")
with warnings.catch_warnings():
    pytest.importorskip("pyuff")

STEP_NS = 10_000_000
IN_S = {"column": "t", "unit": "s"}


def force(raw: RawRecording) -> list[float]:
    (channel,) = raw.channels
    return [float(v) for v in channel.values]


def hdf5(path: Path, *, attributes: dict[str, Any] | None = None, **arrays: Any) -> Path:
    """An HDF5 file of arrays; the attributes are those of `f`."""
    with h5py.File(path, "w") as file:
        for name, values in arrays.items():
            file[name] = values
        for key, value in (attributes or {}).items():
            file["f"].attrs[key] = value
    return path


def read_hdf5_force(path: Path, column: str = "f", time: str = "t", **more: Any) -> RawRecording:
    columns = {"force": {"column": column, **more}}
    return read(path, mapping(".h5", columns, {"column": time, "unit": "s"}))


def test_hdf5_packed_integers_are_unpacked(tmp_path: Path) -> None:
    raw = np.array([-32768, -5850, 0, 9150, 1], dtype=np.int16)
    packed = {"scale_factor": 2e-5, "add_offset": 0.1, "_FillValue": np.int16(-32768), "units": "N"}
    found = read_hdf5_force(hdf5(tmp_path / "run.h5", attributes=packed, t=TIME, f=raw))
    assert force(found) == pytest.approx([np.nan, -0.017, 0.1, 0.283, 0.10002], nan_ok=True)
    assert found.channels[0].unit == "N"
    assert any("scale_factor" in note for note in found.notes)
    with pytest.raises(RefusedError, match="applied already"):
        read_hdf5_force(tmp_path / "run.h5", scale=2e-5, offset=0.1)
    assert force(read_hdf5_force(tmp_path / "run.h5", scale=1000, unit="mN"))[1] == pytest.approx(-17.0)


@pytest.mark.parametrize(
    ("attributes", "expected"),
    [
        ({"missing_value": [1.0, 16.0]}, [np.nan, 2, 4, 8, np.nan]),
        ({"valid_range": [2.0, 8.0]}, [np.nan, 2, 4, 8, np.nan]),
        ({"valid_max": 8.0}, [1, 2, 4, 8, np.nan]),
        ({"conversion": 1e-3, "unit": "N"}, [0.001, 0.002, 0.004, 0.008, 0.016]),
    ],
)
def test_hdf5_marks_and_scales_of_other_conventions(
    tmp_path: Path, attributes: dict[str, Any], expected: list[float]
) -> None:
    path = hdf5(tmp_path / "run.h5", attributes=attributes, t=TIME, f=FORCE)
    assert force(read_hdf5_force(path, unit="N")) == pytest.approx(expected, nan_ok=True)


@pytest.mark.parametrize("flag", ["true", b"true"])
def test_hdf5_numbers_without_a_sign_in_a_type_that_has_one(tmp_path: Path, flag: Any) -> None:
    """Classic netCDF has no unsigned bytes: −56 stands for 200, and its mark of no value is turned as well."""
    raw = np.array([100, 127, -128, -56, -1], dtype=np.int8)
    packed = {"_Unsigned": flag, "scale_factor": 0.001, "_FillValue": np.int8(-1), "units": "N"}
    found = read_hdf5_force(hdf5(tmp_path / "run.h5", attributes=packed, t=TIME, f=raw))
    assert force(found) == pytest.approx([0.1, 0.127, 0.128, 0.2, np.nan], nan_ok=True)
    assert any("_Unsigned" in note for note in found.notes)
    signed = {**packed, "_Unsigned": "false"}
    found = read_hdf5_force(hdf5(tmp_path / "run.h5", attributes=signed, t=TIME, f=raw))
    assert force(found) == pytest.approx([0.1, 0.127, -0.128, -0.056, np.nan], nan_ok=True)


def test_hdf5_the_valid_range_of_numbers_without_a_sign(tmp_path: Path) -> None:
    raw = np.array([10, 100, -56, -1, 0], dtype=np.int16)
    packed = {"_Unsigned": "true", "valid_range": np.array([5, -50], dtype=np.int16), "units": "mN"}
    found = read_hdf5_force(hdf5(tmp_path / "run.h5", attributes=packed, t=TIME, f=raw))
    assert force(found) == pytest.approx([10, 100, 65480, np.nan, np.nan], nan_ok=True)


def test_hdf5_whole_numbers_beside_an_unknown_scale_are_refused(tmp_path: Path) -> None:
    path = hdf5(tmp_path / "run.h5", attributes={"gain": 0.01}, t=TIME, f=FORCE.astype(np.int16))
    with pytest.raises(RefusedError, match=r"gain = 0\.01"):
        read_hdf5_force(path, unit="N")
    assert force(read_hdf5_force(path, unit="N", scale=0.01)) == pytest.approx((FORCE / 100).tolist())
    assert force(read_hdf5_force(path, unit="N", scale=1)) == FORCE.tolist()


def test_hdf5_tables_are_read_by_field(tmp_path: Path) -> None:
    rows = np.zeros(5, dtype=[("t", "f8"), ("cell", [("f", "f4"), ("xyz", "f8", (3,))]), ("who", "S4")])
    rows["t"], rows["cell"]["f"], rows["cell"]["xyz"][:, 1], rows["who"] = TIME, FORCE, 2 * FORCE, b"A"
    path = hdf5(tmp_path / "run.h5", run=rows)
    assert force(read_hdf5_force(path, "run/cell/f", "run/t", unit="N")) == FORCE.tolist()
    assert force(read_hdf5_force(path, "run/cell/xyz", "run/t", unit="N", index=1)) == (2 * FORCE).tolist()
    with pytest.raises(RefusedError, match="a table with the fields t, cell, who"):
        read_hdf5_force(path, "run", "run/t", unit="N")


@pytest.mark.parametrize(
    ("unit", "expected"),
    [(np.bytes_("µN".encode("cp1252")), "µN"), (np.array(["mN"], dtype="S"), "mN"), ("\u03bcN", "\u03bcN")],
)
def test_hdf5_units_in_every_spelling(tmp_path: Path, unit: Any, expected: str) -> None:
    path = hdf5(tmp_path / "run.h5", attributes={"Units": unit}, t=TIME, f=FORCE)
    assert read_hdf5_force(path).channels[0].unit == expected


def test_hdf5_linked_arrays_are_found_and_foreign_ones_named(tmp_path: Path) -> None:
    path = hdf5(tmp_path / "run.h5", t=TIME, f=FORCE)
    with h5py.File(path, "r+") as file:
        file["entry/data"] = file["f"]
        file["soft"] = h5py.SoftLink("/f")
        file["round"] = h5py.SoftLink("/")
        file["away"] = h5py.ExternalLink("other.h5", "/f")
        layout = h5py.VirtualLayout((5,), "f8")
        layout[:] = h5py.VirtualSource("other.h5", "f", (5,))
        file.create_virtual_dataset("virtual", layout)
        file.create_dataset("outside", (5,), "f8", external=[("raw.bin", 0, 40)])
    for name in ("entry/data", "soft"):
        assert force(read_hdf5_force(path, name, unit="N")) == FORCE.tolist()
    for name, what in (("away", "another file"), ("virtual", "other files"), ("outside", "other files")):
        with pytest.raises(RefusedError, match=what):
            read_hdf5_force(path, name, unit="N")


def test_hdf5_what_is_no_number_is_named(tmp_path: Path) -> None:
    path = hdf5(tmp_path / "run.h5", t=TIME, f=FORCE, z=FORCE * 1j)
    with h5py.File(path, "r+") as file:
        file.create_dataset("ref", data=np.array([file["f"].ref] * 5), dtype=h5py.ref_dtype)
        file.create_dataset("ragged", (5,), dtype=h5py.vlen_dtype(np.float64))
    for name, what in (("z", "complex numbers"), ("ref", "references"), ("ragged", "lists of different lengths")):
        with pytest.raises(RefusedError, match=what):
            read_hdf5_force(path, name, unit="N")


def test_hdf5_numbers_as_text_are_read_or_refused_whole(tmp_path: Path) -> None:
    path = hdf5(tmp_path / "run.h5", t=TIME, f=["-1.5", "\u22122.5", "3", "OVLD", "5e-1"])
    assert force(read_hdf5_force(path, unit="N")) == pytest.approx([-1.5, -2.5, 3, np.nan, 0.5], nan_ok=True)
    time = np.arange(8) / 100
    odd = ["~1", "~2", "~3", "~4", "5", "6", "7", "8"]  # only the small ones
    with pytest.raises(RefusedError, match="drop values by how large"):
        read_hdf5_force(hdf5(tmp_path / "odd.h5", t=time, f=odd), unit="N")


def test_matlab_structure_arrays_and_cells_by_element(tmp_path: Path) -> None:
    path = tmp_path / "run.mat"
    channels = np.zeros(3, dtype=[("data", "O"), ("name", "O")])
    channels["data"] = [TIME, 3 * FORCE, FORCE]
    channels["name"] = ["t", "x", "f"]
    cells = np.empty(2, dtype=object)
    cells[:] = [TIME, 2 * FORCE]
    scipy.io.savemat(path, {"ch": channels, "c": cells, "deep": {"ch": channels}})
    for column, time, expected in (
        ("ch.2.data", "ch.0.data", FORCE),
        ("ch(3).data", "ch(1).data", FORCE),
        ("c.1", "c{1}", 2 * FORCE),
        ("deep.ch.1.data", "ch.0.data", 3 * FORCE),
    ):
        found = mapping(".mat", {"force": {"column": column, "unit": "N"}}, {"column": time, "unit": "s"})
        assert force(read(path, found)) == expected.tolist()
    for column, what in (("ch", "a structure array, 1 × 3"), ("c", "a cell array, 1 × 2")):
        with pytest.raises(RefusedError, match=what):
            read(path, mapping(".mat", {"force": {"column": column, "unit": "N"}}, {"sample_rate_hz": 1.0}))


def test_matlab_sparse_and_complex_are_refused_by_name(tmp_path: Path) -> None:
    path = tmp_path / "run.mat"
    scipy.io.savemat(path, {"s": scipy.sparse.csc_array(np.diag(FORCE)), "z": FORCE * 1j, "e": np.zeros((0, 0))})
    for column, what in (("s", "a sparse matrix, 5 × 5"), ("z", "complex numbers"), ("e", "empty")):
        with pytest.raises(RefusedError, match=what):
            read(path, mapping(".mat", {"force": {"column": column, "unit": "N"}}, {"sample_rate_hz": 1.0}))


def test_matlab_cells_of_numbers_and_texts_are_a_column(tmp_path: Path) -> None:
    path = tmp_path / "run.mat"
    cells = np.empty(4, dtype=object)
    cells[:] = [1.5, "-2.5", "overload", 4.0]
    scipy.io.savemat(path, {"f": cells, "t": TIME[:4]})
    found = read(path, mapping(".mat", {"force": {"column": "f", "unit": "N"}}, IN_S))
    assert force(found) == pytest.approx([1.5, -2.5, np.nan, 4], nan_ok=True)


def matlab_73(path: Path) -> Path:
    """A v7.3 file as MATLAB writes it: classes as attributes, structure arrays and cells as references, matrices turned."""
    with h5py.File(path, "w", userblock_size=512) as file:

        def put(place: str, values: Any, matlab_class: str, **attributes: Any) -> Any:
            file[place] = values
            for key, value in {"MATLAB_class": np.bytes_(matlab_class), **attributes}.items():
                file[place].attrs[key] = value
            return file[place]

        parts = [put(f"#refs#/{i}", v[None, :], "double") for i, v in enumerate((TIME, FORCE))]
        refs = np.array([[p.ref for p in parts]], dtype=h5py.ref_dtype)
        put("c", refs, "cell")
        file.create_group("ch").attrs["MATLAB_class"] = np.bytes_("struct")
        file["ch"].create_dataset("data", data=refs, dtype=h5py.ref_dtype)
        put("word", np.array([[70], [111]], dtype=np.uint16), "char", MATLAB_int_decode=np.int32(2))
        put(
            "wait",
            np.array([[3707764736, 2, 1, 1, 1, 1]], dtype=np.uint32),
            "duration",
            MATLAB_object_decode=np.int32(3),
        )
        put("z", np.array([(1.0, 2.0)] * 5, dtype=[("real", "f8"), ("imag", "f8")])[None, :], "double")
        sparse = file.create_group("s")
        sparse.attrs["MATLAB_class"], sparse.attrs["MATLAB_sparse"] = np.bytes_("double"), np.uint64(5)
        sparse["data"], sparse["ir"], sparse["jc"] = FORCE, np.arange(5), np.arange(6)
        put("nothing", np.zeros(2, dtype=np.uint64), "double", MATLAB_empty=np.uint8(1))
    with path.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file")
    return path


def test_matlab_73_elements_and_what_is_no_array(tmp_path: Path) -> None:
    path = matlab_73(tmp_path / "run.mat")
    for column, time in (("ch.1.data", "ch.0.data"), ("ch(2).data", "ch(1).data"), ("c{2}", "c{1}")):
        found = mapping(".mat", {"force": {"column": column, "unit": "N"}}, {"column": time, "unit": "s"})
        assert force(read(path, found)) == FORCE.tolist()
    for column, what in (
        ("wait", "a MATLAB object of class duration"),
        ("s", "a sparse matrix"),
        ("c", "a cell array"),
        ("z", "complex numbers"),
        ("word", 'not numbers, such as "Fo"'),
        ("nothing", "empty"),
    ):
        with pytest.raises(RefusedError, match=what):
            read(path, mapping(".mat", {"force": {"column": column, "unit": "N"}}, {"sample_rate_hz": 1.0}))


def tdms(path: Path, values: Any, properties: dict[str, Any], times: Any = None) -> Path:
    channels = [nptdms.ChannelObject("g", "f", np.asarray(values), properties=properties)]
    channels += [] if times is None else [nptdms.ChannelObject("g", "t", np.asarray(times))]
    with nptdms.TdmsWriter(path) as writer:
        writer.write_segment(channels)
    return path


def read_tdms_force(path: Path, time: dict[str, Any] | None = None, **more: Any) -> RawRecording:
    return read(path, mapping(".tdms", {"force": {"column": "f", "unit": "N", **more}}, time, tdms={"group": "g"}))


def test_tdms_never_believes_the_index_of_an_earlier_copy(tmp_path: Path) -> None:
    path = tmp_path / "run.tdms"
    with nptdms.TdmsWriter(str(path), index_file=True) as writer:
        writer.write_segment([nptdms.ChannelObject("g", "f", FORCE)])
    stale = (tmp_path / "run.tdms_index").read_bytes()
    with nptdms.TdmsWriter(str(path), index_file=True) as writer:
        writer.write_segment([nptdms.ChannelObject("g", "f", FORCE)])
        writer.write_segment([nptdms.ChannelObject("g", "f", 2 * FORCE)])
    (tmp_path / "run.tdms_index").write_bytes(stale)
    assert force(read_tdms_force(path, {"sample_rate_hz": 100.0})) == [*FORCE, *(2 * FORCE)]


def test_tdms_scales_are_applied_or_refused(tmp_path: Path) -> None:
    scale = {
        "NI_Number_Of_Scales": 1,
        "NI_Scaling_Status": "unscaled",
        "NI_Scale[0]_Scale_Type": "Linear",
        "NI_Scale[0]_Linear_Slope": 0.5,
        "NI_Scale[0]_Linear_Y_Intercept": 1.0,
        "NI_Scale[0]_Linear_Input_Source": np.uint32(0xFFFFFFFF),
    }
    raw, rate = FORCE.astype(np.int16), {"sample_rate_hz": 100.0}
    path = tdms(tmp_path / "run.tdms", raw, scale)
    assert force(read_tdms_force(path, rate)) == (0.5 * FORCE + 1).tolist()
    other = tdms(tmp_path / "other.tdms", raw, scale | {"NI_Scale[0]_Scale_Type": "Bridge"})
    with pytest.raises(RefusedError, match='a scale of type "Bridge"'):
        read_tdms_force(other, rate)
    unknown = tdms(tmp_path / "gain.tdms", raw, {"gain": 0.01})
    with pytest.raises(RefusedError, match=r"gain = 0\.01"):
        read_tdms_force(unknown, rate)


def test_tdms_waveforms_in_other_units_and_of_other_days(tmp_path: Path) -> None:
    start = np.datetime64("2026-03-01T14:00:00")
    wave = {"wf_increment": 10.0, "wf_start_offset": 5.0, "wf_start_time": start, "wf_xunit_string": "ms"}
    raw = read_tdms_force(tdms(tmp_path / "run.tdms", FORCE, wave))
    assert raw.channels[0].time_ns.tolist() == [START_NS + 5_000_000 + i * STEP_NS for i in range(5)]
    assert not raw.problems
    with pytest.raises(RefusedError, match='is in "Hz"'):
        read_tdms_force(tdms(tmp_path / "spectrum.tdms", FORCE, wave | {"wf_xunit_string": "Hz"}))
    late = tdms(tmp_path / "late.tdms", FORCE, wave | {"wf_start_time": np.datetime64("2026-03-21T14:00:00")})
    assert any("20 d after started_at" in problem for problem in read_tdms_force(late).problems)
    assert read_tdms_force(late, {"origin": "started_at"}).channels[0].time_ns[0] == START_NS + 5_000_000
    with pytest.raises(RefusedError, match="not in the future"):
        read_tdms_force(
            tdms(tmp_path / "x.tdms", FORCE, wave | {"wf_start_time": np.datetime64("2096-03-01T14:00:00")})
        )


def test_tdms_stamps_are_utc_and_units_have_several_names(tmp_path: Path) -> None:
    stamps = np.datetime64("2026-03-01T14:00:00", "us") + 10_000 * np.arange(5)
    path = tdms(tmp_path / "run.tdms", FORCE, {"NI_UnitDescription": "Newtons"}, stamps)
    raw = read_tdms_force(path, {"column": "t"})
    assert raw.channels[0].time_ns.tolist() == [START_NS + i * STEP_NS for i in range(5)]
    with pytest.raises(RefusedError, match='"Newtons"'):
        read_tdms_force(path, {"column": "t"}, unit="mN")


def uff_set(values: Any, x: Any, **more: Any) -> dict[str, Any]:
    complex_values = np.iscomplexobj(values)
    return {
        "type": 58, "binary": 0, "id1": "H", "id2": "NONE", "id3": "NONE", "id4": "NONE", "id5": "NONE",
        "func_type": 4 if complex_values else 1, "ver_num": 0, "load_case_id": 0, "rsp_ent_name": "NONE",
        "rsp_node": 1, "rsp_dir": 1, "ref_ent_name": "NONE", "ref_node": 1, "ref_dir": 1,
        "ord_data_type": 6 if complex_values else 4, "num_pts": len(values), "abscissa_spacing": 1,
        "abscissa_min": float(x[0]), "abscissa_inc": float(x[1] - x[0]), "z_axis_value": 0,
        "abscissa_spec_data_type": 18 if complex_values else 17, "abscissa_axis_units_lab": "Hz" if complex_values else "s",
        "ordinate_spec_data_type": 12, "ordinate_axis_units_lab": "m/s^2", "orddenom_spec_data_type": 13,
        "orddenom_axis_units_lab": "N", "z_axis_spec_data_type": 0, "data": np.asarray(values), "x": np.asarray(x), **more,
    }  # fmt: skip


def write_uff(path: Path, *sets: dict[str, Any]) -> Path:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import pyuff

        pyuff.UFF(str(path)).write_sets(list(sets), "add")
    return path


def read_response(path: Path, column: int = 0, **more: Any) -> ResponseTable:
    content = {"kind": "frequency_response", "columns": {"response": {"column": column, **more}}}
    table = read_raw(path, FileMapping.parse({**content, "recording": {"recording_id": "h"}}, stem="h", suffix=".uff"))
    assert isinstance(table, ResponseTable)
    return table


@pytest.mark.parametrize(("above", "kind", "power"), [("m/s^2", 12, 2), ("m/s", 11, 1), ("mm", 8, 0), ("g", 12, 2)])
def test_uff_responses_become_stiffness(tmp_path: Path, above: str, kind: int, power: int) -> None:
    hz = np.arange(6) * 5.0
    jw = 2j * np.pi * hz
    stiffness = 0.3 + 0.12 * jw * 0.05 / (1 + jw * 0.05)  # N/mm
    in_mm = {"m/s^2": 1e3, "m/s": 1e3, "mm": 1.0, "g": 9806.65}[above]
    response = jw**power / stiffness / in_mm
    labels = {"ordinate_axis_units_lab": above, "ordinate_spec_data_type": kind}
    table = read_response(write_uff(tmp_path / "h.uff", uff_set(response, hz, **labels)))
    assert table.frequency_hz.tolist() == hz[1:].tolist()
    assert table.value == pytest.approx(stiffness[1:], rel=1e-9)
    assert table.measured_as == "stiffness"
    assert not table.problems
    assert "the line at 0 Hz is left out" in table.notes


def test_uff_units_of_a_response_are_held_against_the_mapping(tmp_path: Path) -> None:
    path = write_uff(tmp_path / "h.uff", uff_set(np.ones(4) * (1 + 1j), np.arange(1.0, 5)))
    with pytest.raises(RefusedError, match="the mapping says"):
        read_response(path, unit="mm/s^2/N")
    with pytest.raises(RefusedError, match="an accelerance"):
        read_response(path, unit="kN", overrule_unit=True)
    dynamic = read_response(path, unit="N/mm", overrule_unit=True)
    assert dynamic.value == pytest.approx(np.ones(4) * (1 + 1j))


def test_uff_sets_of_the_wrong_kind_and_cut_ones_are_named(tmp_path: Path) -> None:
    path = write_uff(
        tmp_path / "h.uff", uff_set(FORCE, TIME, abscissa_axis_units_lab="ms"), uff_set(FORCE * 1j, 1 + TIME)
    )
    raw = read(path, mapping(".uff", {"force": {"column": 0, "unit": "N", "overrule_unit": True}}))
    assert raw.channels[0].time_ns.tolist() == [START_NS + i * 10_000 for i in range(5)]
    with pytest.raises(RefusedError, match="function type 4, a frequency response") as refused:
        read(path, mapping(".uff", {"force": {"column": 1, "unit": "N", "overrule_unit": True}}))
    assert "[columns.response]" in refused.value.remedy
    with pytest.raises(RefusedError, match="function type 1, a time response"):
        read_response(path)
    lines = path.read_text().splitlines(keepends=True)
    count = next(i for i, line in enumerate(lines) if line.startswith("         4         5"))
    lines[count] = lines[count].replace("         4         5", "         4         9", 1)
    path.write_text("".join(lines))
    cut = read(path, mapping(".uff", {"force": {"column": 0, "unit": "N", "overrule_unit": True}}))
    assert "set 0 has 5 of 9 values: it is cut" in cut.problems


@pytest.mark.parametrize(
    ("lines", "left", "told"),
    [
        (1, 40, "the last data set has no end"),
        (4, 28, "set 1 has 28 of 40 values: it is cut"),
        (12, 0, "the file ends in the head of a data set, which is lost"),
    ],
)
def test_uff_is_read_as_far_as_it_goes(tmp_path: Path, lines: int, left: int, told: str) -> None:
    values, times = np.arange(40.0), np.arange(40.0)
    path = write_uff(tmp_path / "h.uff", uff_set(values, times), uff_set(values, times))
    text = path.read_text()
    path.write_text("".join(text.splitlines(keepends=True)[:-lines]) + text[-200:-190])
    for column, expected in ((0, 40), (1, left)):
        found = mapping(".uff", {"force": {"column": column, "unit": "N", "overrule_unit": True}})
        if expected:
            raw = read(path, found)
            assert raw.channels[0].values.tolist() == list(range(expected))
            assert told in raw.problems
        else:
            with pytest.raises(RefusedError, match="is not in the file"):
                read(path, found)


def messages(path: Path, rows: list[tuple[int, Any]], **more: Any) -> RawRecording:
    """Rows of (log time from the start in ns, value) through an MCAP file."""
    written = [("/rig", START + at, json.dumps({"f": value}).encode()) for at, value in rows]
    columns = {"force": {"column": "/rig", "field": "f", "unit": "N"}}
    found = FileMapping.parse({"format": "mcap", "columns": columns, "recording": METADATA, **more}, stem="run")
    return read_mcap(write(path, written), found)


def orders() -> dict[str, np.ndarray]:
    swapped = np.arange(400)
    swapped[[100, 101, 250, 251]] = swapped[[101, 100, 251, 250]]
    chunks = np.concatenate([np.arange(200, 400), np.arange(200)])
    return {"neighbours": swapped, "chunks": chunks, "any": np.random.default_rng(1).permutation(400)}


@pytest.mark.parametrize("kind", ["neighbours", "chunks", "any"])
def test_mcap_messages_in_any_order_come_in_that_of_their_times(tmp_path: Path, kind: str) -> None:
    raw = messages(tmp_path / "run.mcap", [(int(i) * MS, float(i)) for i in orders()[kind]])
    assert force(raw) == list(range(400))
    assert raw.channels[0].time_ns.tolist() == [START + i * MS for i in range(400)]
    assert any("not in the order" in note for note in raw.notes)


@pytest.mark.parametrize("back", [100, 199, 390])
def test_mcap_a_clock_that_was_set_back_is_still_refused(tmp_path: Path, back: int) -> None:
    times = [i * MS for i in range(400)] + [(400 + i - back) * MS + MS // 3 for i in range(400)]
    raw = messages(tmp_path / "run.mcap", [(at, float(i)) for i, at in enumerate(times)])
    with pytest.raises(RefusedError, match="time runs backwards"):
        taken(raw)


def taken(raw: RawRecording) -> Recording:
    metadata = {"recording_id": "r", "protocol": "tap", "loading": "calibration", "specimen_id": "s"}
    return canonical(replace(raw, metadata={**raw.metadata, **metadata}), where="run.mcap")


def test_mcap_messages_that_cannot_be_read_count_as_time(tmp_path: Path) -> None:
    written = [("/rig", START + i * MS, json.dumps({"f": float(i)}).encode()) for i in range(6)]
    written[2] = ("/rig", START + 2 * MS, b"{not json")
    columns = {"force": {"column": "/rig", "field": "f", "unit": "N"}}
    content = {"format": "mcap", "columns": columns, "recording": METADATA, "time": {"sample_rate_hz": 1000.0}}
    raw = read_mcap(write(tmp_path / "run.mcap", written), FileMapping.parse(content, stem="run"))
    assert force(raw) == pytest.approx([0, 1, np.nan, 3, 4, 5], nan_ok=True)
    assert raw.channels[0].time_ns[-1] - raw.channels[0].time_ns[0] == 5 * MS


def test_mcap_numbers_as_text_are_read(tmp_path: Path) -> None:
    rows = [(i * MS, value) for i, value in enumerate([1.0, "\u22122.5", "OVLD", 4])]
    assert force(messages(tmp_path / "run.mcap", rows)) == pytest.approx([1, -2.5, np.nan, 4], nan_ok=True)


@pytest.mark.parametrize(
    ("content", "key"),
    [
        ({"time": {"sample_rate_hz": 10.0, "unit": "ms"}}, "time.unit"),
        ({"time": {"sample_rate_hz": 10.0, "origin": "unix"}}, "time.origin"),
        ({"time": {"origin": "unix"}}, "time.origin"),
        (
            {"columns": {"force": {"column": "f", "overrule_unit": True}}},
            "columns.force has overrule_unit without unit",
        ),
        (
            {"kind": "lifetimes", "columns": {"configuration": {"column": "c", "unit": "s"}}},
            "columns.configuration.unit",
        ),
        ({"kind": "lifetimes", "columns": {"voltage": {"column": "v", "failed_values": [1]}}}, "voltage.failed_values"),
        ({"kind": "relaxation", "columns": {"time": {"value": 1, "unit": "s", "index": 1}}}, "columns.time.index"),
    ],
)
def test_keys_without_an_effect_are_mistakes(content: dict[str, Any], key: str) -> None:
    columns = {"force": {"column": "f", "unit": "N"}}
    with pytest.raises(RefusedError, match=key):
        FileMapping.parse({"columns": columns, "recording": {}, **content}, stem="run", suffix=".mat")


def test_an_index_of_a_vector_is_refused(tmp_path: Path) -> None:
    path = hdf5(tmp_path / "run.h5", t=TIME, f=FORCE)
    with pytest.raises(RefusedError, match="there is one column"):
        read_hdf5_force(path, unit="N", index=1)


def test_hdf5_times_since_a_date(tmp_path: Path) -> None:
    path = hdf5(tmp_path / "run.nc.h5", t=1000 * TIME, f=FORCE)
    for since, begins in (("2026-03-01 13:59:00", START_NS - 60_000_000_000), ("2026-03-01T14:00:00Z", START_NS)):
        with h5py.File(path, "r+") as file:
            file["t"].attrs["units"] = f"milliseconds since {since}"
        columns = {"force": {"column": "f", "unit": "N"}}
        raw = read(path, mapping(".h5", columns, {"column": "t"}))
        assert raw.channels[0].time_ns.tolist() == [begins + i * STEP_NS for i in range(5)]
        from_start = read(path, mapping(".h5", columns, {"column": "t", "unit": "ms"}))
        assert from_start.channels[0].time_ns[0] == START_NS
        assert any("as the mapping gives its unit, it counts from started_at" in note for note in from_start.notes)
        with pytest.raises(RefusedError, match='the mapping says "s" for time'):
            read(path, mapping(".h5", columns, {"column": "t", "unit": "s"}))


@pytest.mark.long_after(5)
@pytest.mark.parametrize(
    "units",
    [
        "seconds since 2026-3-1 14:0:0.0",
        "seconds Since 2026-03-01 15:00:00 +1:00",
        "Seconds after 2026-03-01T14:00",
        "seconds @ 2026-03-01 09:00:00 -0500",
        "seconds since 2026-03-01 14:00:00 UTC",
    ],
)
@pytest.mark.parametrize("calendar", [None, "standard", "gregorian", "proleptic_gregorian", "Gregorian"])
def test_times_since_a_date_as_programs_write_them(tmp_path: Path, units: str, calendar: str | None) -> None:
    path = hdf5(tmp_path / "run.h5", t=TIME, f=FORCE)
    with h5py.File(path, "r+") as file:
        file["t"].attrs.update({"units": units} | ({"calendar": calendar} if calendar else {}))
    raw = read(path, mapping(".h5", {"force": {"column": "f", "unit": "N"}}, {"column": "t"}))
    assert raw.channels[0].time_ns.tolist() == [START_NS + i * STEP_NS for i in range(5)]
    with h5py.File(path, "r+") as file:
        file["t"].attrs["units"] = "s since 2026-03-01 14:00:00.25"
    raw = read(path, mapping(".h5", {"force": {"column": "f", "unit": "N"}}, {"column": "t"}))
    assert raw.channels[0].time_ns[0] == START_NS + 250_000_000


@pytest.mark.long_after(4)
@pytest.mark.parametrize(
    ("units", "calendar", "why"),
    [
        ("days since 2020-01-01", "noleap", 'a date of the calendar "noleap"'),
        ("days since 2020-01-01", "360_day", 'a date of the calendar "360_day"'),
        ("seconds since 2026-03-01", "julian", 'a date of the calendar "julian"'),
        ("days since 0001-01-01", "standard", "before the calendar was reformed"),
        ("days since 0001-01-01", None, "before the calendar was reformed"),
        ("months since 2026-01-01", None, "not all of one length"),
        ("common_years since 2026-01-01", None, "not all of one length"),
        ("seconds since 2026-13-01", None, 'count from "2026-13-01"'),
    ],
)
def test_times_of_another_calendar_are_refused(tmp_path: Path, units: str, calendar: str | None, why: str) -> None:
    """Two days in February 2020 and 2024 that `noleap` does not have were two days of error, without a word."""
    path = hdf5(tmp_path / "run.h5", t=TIME, f=FORCE)
    with h5py.File(path, "r+") as file:
        file["t"].attrs.update({"units": units} | ({"calendar": calendar} if calendar else {}))
    columns = {"force": {"column": "f", "unit": "N"}}
    with pytest.raises(RefusedError, match=why):
        read(path, mapping(".h5", columns, {"column": "t"}))
    raw = read(
        path, mapping(".h5", columns, {"column": "t", "unit": "s", "origin": "started_at", "overrule_unit": True})
    )
    assert raw.channels[0].time_ns[0] == START_NS


def write_hdf5(path: Path, *, chunked: bool) -> np.ndarray:
    """Three arrays of 20 000 numbers, the last of which stands last; the head of each stands before all numbers."""
    values = np.arange(20_000) / 1000
    with h5py.File(path, "w") as file:
        layout: dict[str, Any] = {"chunks": (1000,), "compression": "gzip"} if chunked else {}
        for name in ("t", "F", "x"):
            file.create_dataset(name, values.shape, "f8", **layout)
        file.flush()
        for name in ("t", "F", "x"):
            file[name][:] = values + np.random.default_rng(1).random(values.size) * 1e-4
    return values


_T = {"column": "t", "unit": "s"}


@pytest.mark.long_after(2)
@pytest.mark.parametrize("chunked", [False, True])
@pytest.mark.parametrize("left", [0.97, 0.8])
def test_hdf5_that_is_cut_gives_what_is_there(tmp_path: Path, left: float, chunked: bool) -> None:
    path = tmp_path / "run.h5"
    write_hdf5(path, chunked=chunked)
    found = mapping(".h5", {"force": {"column": "F", "unit": "N"}, "displacement": {"column": "x", "unit": "mm"}}, _T)
    whole = read(path, found)
    with path.open("r+b") as file:
        file.truncate(int(left * path.stat().st_size))
    raw = read(path, found)
    assert any("the file is cut" in problem for problem in raw.problems)
    force, travel = (np.asarray(channel.values) for channel in raw.channels)
    assert np.array_equal(force, whole.channels[0].values)
    lost = np.isnan(travel)
    assert 500 < lost.sum() < 19_000
    assert np.array_equal(travel[~lost], whole.channels[1].values[~lost])
    assert lost[-1]
    assert not lost[0]


def test_hdf5_that_is_cut_in_its_structure_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    write_hdf5(path, chunked=False)
    with path.open("r+b") as file:
        file.truncate(700)
    with pytest.raises(RefusedError, match="cannot be read as HDF5"):
        read(path, mapping(".h5", {"force": {"column": "F", "unit": "N"}}, _T))


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("values", [np.arange(4000) + 0.25, np.arange(4000), np.arange(4000, dtype=np.int16)])
def test_matlab_that_is_cut_keeps_what_is_there(tmp_path: Path, values: np.ndarray, packed: bool) -> None:
    """Also where MATLAB has packed whole numbers into fewer bytes, and where an element is so short that it has no tag."""
    path = tmp_path / "run.mat"
    noise = np.random.default_rng(2).integers(0, 20, values.size).astype(values.dtype)  # so that it cannot shrink away
    scipy.io.savemat(
        path, {"t": np.arange(4000) / 1000, "F": values + noise, "x": values * 2 + noise}, do_compression=packed
    )
    columns = {"force": {"column": "F", "unit": "N"}, "displacement": {"column": "x", "unit": "mm"}}
    found = mapping(".mat", columns, _T)
    whole = read(path, found)
    with path.open("r+b") as file:
        file.truncate(path.stat().st_size - path.stat().st_size // 10)
    raw = read(path, found)
    force, travel = (np.asarray(channel.values, dtype=np.float64) for channel in raw.channels)
    assert np.array_equal(force, whole.channels[0].values)
    lost = int(np.isnan(travel).sum())
    assert 100 < lost < 3000
    assert np.array_equal(travel[:-lost], whole.channels[1].values[:-lost])
    assert f"the file is cut: x has {4000 - lost} of 4000 values" in raw.problems


def test_matlab_that_is_cut_in_a_structure_leaves_that_out(tmp_path: Path) -> None:
    path = tmp_path / "run.mat"
    scipy.io.savemat(path, {"t": np.arange(400) / 1000, "F": np.arange(400.0), "run": {"x": np.arange(400.0)}})
    with path.open("r+b") as file:
        file.truncate(path.stat().st_size - 100)
    raw = read(path, mapping(".mat", {"force": {"column": "F", "unit": "N"}}, _T))
    assert raw.channels[0].values.tolist() == list(range(400))
    assert "the file is cut: the variable run is left out" in raw.problems
    with pytest.raises(RefusedError, match="is not in the file"):
        read(path, mapping(".mat", {"force": {"column": "run.x", "unit": "N"}}, _T))
