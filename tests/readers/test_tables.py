"""Tables of lifetimes, frequency responses and relaxation: meanings, units, geometry, rows that cannot be used."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ingest.mapping import FileMapping
from ingest.read import Content, read_raw
from ingest.tables import LifetimeTable, RelaxationTable, ResponseTable
from pipeline.fit.survival.groups import survival_group
from schemas.errors import RefusedError

LIFE = {
    "kind": "lifetimes",
    "columns": {
        "lifetime": {"column": "t", "unit": "min"},
        "failed": {"column": "f", "failed_values": ["yes", 1], "censored_values": ["no", 0]},
    },
    "recording": {"recording_id": "{stem}"},
}
RESPONSE = {
    "kind": "frequency_response",
    "columns": {
        "frequency": {"column": "f", "unit": "Hz"},
        "storage": {"column": "s", "unit": "MPa"},
        "loss": {"column": "l", "unit": "MPa"},
    },
    "recording": {"recording_id": "{stem}"},
}


def read(tmp_path: Path, text: str, base: dict[str, Any], **changes: Any) -> Content:
    content = dict(base)
    for key, value in changes.items():
        content[key] = {**content.get(key, {}), **value} if isinstance(value, dict) else value
    path = tmp_path / "table.csv"
    path.write_text(text)
    return read_raw(path, FileMapping.parse(content, stem="table", suffix=".csv", source="table.csv.toml"))


def lives(tmp_path: Path, text: str, **changes: Any) -> LifetimeTable:
    found = read(tmp_path, text, LIFE, **changes)
    assert isinstance(found, LifetimeTable)
    return found


def response(tmp_path: Path, text: str, **changes: Any) -> ResponseTable:
    found = read(tmp_path, text, RESPONSE, **changes)
    assert isinstance(found, ResponseTable)
    return found


def test_lives(tmp_path: Path) -> None:
    table = lives(
        tmp_path,
        "t,f,U,kind\n1,yes,5000,a\n2.5,0,5000,b\n4,1.0,7000,b\n",
        columns={"voltage": {"column": "U", "unit": "V"}, "configuration": {"column": "kind"}},
    )
    assert [(r.lifetime_s, r.failed, r.voltage_kv, r.configuration) for r in table.rows] == [
        (60.0, True, 5.0, "a"),
        (150.0, False, 5.0, "b"),
        (240.0, True, 7.0, "b"),
    ]
    assert [r.specimen_id for r in table.rows] == ["table-1", "table-2", "table-3"]
    assert [r.censored_because for r in table.rows] == [None, "censored in the table", None]
    assert {r.recording_id for r in table.rows} == {"table"}


def test_constants_from_metadata_and_value(tmp_path: Path) -> None:
    table = lives(
        tmp_path,
        "t\n1\n2\n",
        columns={"failed": {"value": True, "failed_values": [True], "censored_values": [False]}},
        recording={"configuration": "rods", "voltage_setpoint_kv": 3.5, "failure_site": "rod"},
    )
    row = table.rows[0]
    assert (row.failed, row.configuration, row.voltage_kv, row.failure_site) == (True, "rods", 3.5, "rod")
    constant = lives(tmp_path, "t,f\n1,1\n2,1\n", columns={"voltage": {"value": 4000, "unit": "V"}})
    assert constant.rows[0].voltage_kv == 4.0


def test_rows_without_a_life_are_left_out(tmp_path: Path) -> None:
    table = lives(tmp_path, "t,f\n1,1\n0,1\n,1\n7,0\n0,0\n")
    assert [(r.specimen_id, r.lifetime_s) for r in table.rows] == [
        ("table-1", 60.0),
        ("table-2", 0.0),
        ("table-4", 420.0),
    ]
    assert any("2 of 5 rows have no life, or survived 0 s (row 3)" in p for p in table.problems)


def test_failures_at_once_count(tmp_path: Path) -> None:
    """Two of twelve fail at 0: the curve begins with 10/12, and the median is 40 s, where 50 s would be without them."""
    rows = [(0, 1), (0, 1), *((10 * i, 1) for i in range(1, 9)), (90, 0), (100, 0)]
    text = "t,f\n" + "".join(f"{life},{flag}\n" for life, flag in rows)
    table = lives(tmp_path, text, columns={"lifetime": {"column": "t", "unit": "s"}})
    assert len(table.rows) == 12
    assert table.problems == ()
    (group,) = survival_group(table.rows).groups
    assert (group.curve.time[0], group.curve.survival[0]) == (0.0, pytest.approx(10 / 12))
    assert group.summary.median_s.value == 40.0
    assert group.summary.restricted_mean_s.value == pytest.approx((10 * sum(10 - i for i in range(9)) + 10 * 2) / 12)
    assert np.isfinite(group.summary.weibull_shape.value)


SURVIVORS = "t\n1\n> 60\n>60 min\n60+\n≥ 60\n> 1 h\n2.5\n"


def test_survivors_as_people_write_them(tmp_path: Path) -> None:
    """Whether a column says it or the life alone: five survived 60 min, two failed."""
    base = {k: v for k, v in LIFE["columns"].items() if k == "lifetime"}
    alone = read(tmp_path, SURVIVORS, {**LIFE, "columns": base})
    cells = SURVIVORS.splitlines()
    flagged = lives(tmp_path, "\n".join(f"{t},{f}" for t, f in zip(cells, "f1000001", strict=True)) + "\n")
    assert isinstance(alone, LifetimeTable)
    for table in (alone, flagged):
        assert [r.lifetime_s for r in table.rows] == [60.0, *[3600.0] * 5, 150.0]
        assert [r.failed for r in table.rows] == [True, *[False] * 5, True]
    assert any("5 lives are written as survived, the others count as failures" in note for note in alone.notes)


def test_a_survivor_without_a_life_has_that_of_its_test(tmp_path: Path) -> None:
    text = "t,f,planned\n5,1,60\nNA,0,60\nrunning,0,20\n,0,30\n"
    table = lives(tmp_path, text, columns={"test_duration": {"column": "planned", "unit": "min"}})
    assert [(r.lifetime_s, r.failed) for r in table.rows] == [(300, True), (3600, False), (1200, False), (1800, False)]
    same = lives(tmp_path, "t,f\n5,1\nNA,0\n", recording={"test_duration_s": 3600})
    assert [r.lifetime_s for r in same.rows] == [300, 3600]


def test_rows_that_stand_for_several_specimens(tmp_path: Path) -> None:
    table = lives(tmp_path, "t,f,n\n1,1,2\n9,0,3\n", columns={"count": {"column": "n"}})
    assert [(r.lifetime_s, r.failed) for r in table.rows] == [(60, True)] * 2 + [(540, False)] * 3
    assert len({r.specimen_id for r in table.rows}) == 5
    with pytest.raises(RefusedError, match='row 2 of the data: the count is "x"'):
        lives(tmp_path, "t,f,n\n1,1,2\n9,0,x\n", columns={"count": {"column": "n"}})


def test_the_flag_may_be_that_of_the_censored(tmp_path: Path) -> None:
    columns = {"lifetime": LIFE["columns"]["lifetime"]}
    columns["censored"] = {"column": "c", "censored_values": [1], "failed_values": [0]}
    table = read(tmp_path, "t,c\n1,0\n2,1\n", {**LIFE, "columns": columns})
    assert isinstance(table, LifetimeTable)
    assert [r.failed for r in table.rows] == [True, False]


def test_lives_with_units_of_their_own(tmp_path: Path) -> None:
    columns = {"lifetime": {"column": "t", "unit": "h"}}
    table = read(tmp_path, "t\n45 s\n2.5 min\n1.5 h\n2\n26:15:00\n", {**LIFE, "columns": columns})
    assert isinstance(table, LifetimeTable)
    assert [r.lifetime_s for r in table.rows] == pytest.approx([45, 150, 5400, 7200, 94500])
    with pytest.raises(RefusedError, match='holds "5 m" in row 2'):
        read(tmp_path, "t\n1\n5 m\n", {**LIFE, "columns": columns})


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"rig": {"clamp_mass_kg": 0.05}}, 'rig is not used for kind "lifetimes"'),
        ({"time": {"column": "t", "unit": "s"}}, 'time.column is not used for kind "lifetimes"'),
        ({"recording": {"film_lenght_mm": 5}}, '"recording.film_lenght_mm" is unknown: did you mean film_length_mm?'),
    ],
)
def test_keys_without_an_effect_are_errors(tmp_path: Path, changes: dict[str, Any], problem: str) -> None:
    with pytest.raises(RefusedError) as refused:
        lives(tmp_path, "t,f\n1,1\n", **changes)
    assert problem in refused.value.problem


@pytest.mark.parametrize(
    ("text", "changes", "problem"),
    [
        ("t,f\n1,1\n2,maybe\n", {}, '"maybe" in row 2 of the data means neither'),
        ("t,f\n1,1\n2,\n", {}, '"" in row 2 of the data means neither'),
        (
            "t,f\n1,1\n2,0\n",
            {"columns": {"failed": {"column": "f", "failed_values": [1, 0], "censored_values": [0]}}},
            "failed and censored",
        ),
        ("t,f\n1,1\n", {"columns": {"failed": {"column": "f"}}}, "does not say which values"),
        ("t,f,n\n1,1,a\n2,1,a\n", {"columns": {"specimen_id": {"column": "n"}}}, '"a" stands in two rows'),
        ("t,f\n,1\n0,0\n", {}, "no row has a life that says anything"),
        ("t,f\n1,1\n-3,1\n7,0\n", {}, 'row 2 of the data: the life is "-3"'),
        ("t,f\n1,1\nx,0\n7,0\n", {}, 'row 2 of the data: the life is "x", which is no number'),
        ("t,f\n1,1\n,0\n7,0\n", {}, "row 2 of the data: a survivor without a life"),
        ("t,f\n1,1\n> 3,1\n7,0\n", {}, 'row 2 of the data: the life is "> 3", and the specimen has failed'),
        ("t,f\n1,1\n< 3,0\n7,0\n", {}, 'row 2 of the data: the life is "< 3", and the specimen has survived'),
        (
            "t,f,a\n1,1,\n3,1,4\n",
            {"columns": {"alive_at": {"column": "a", "unit": "min"}}},
            "seen alive at 240 s, after that",
        ),
        ("t,f,a\n1,1,\n3,1,3\n", {"columns": {"entered": {"column": "a", "unit": "min"}}}, "came under watch at 180 s"),
        (
            "t,f,a\n1,1,\n< 3,1,2\n",
            {"columns": {"alive_at": {"column": "a", "unit": "min"}}},
            "it is left-censored, and",
        ),
        ("t,f,h\n1,1,45\n", {"columns": {"humidity": {"column": "h", "unit": "1"}}}, "the humidity is 45"),
        ("t,f\n1,1\n", {"columns": {"lifetime": {"column": "t", "unit": "kV"}}}, "kV"),
        ("t,f\n1,1\n", {"recording": {"recording_id": "a b"}}, "recording_id"),
        ("t,f,w\n1,1,top\n", {"columns": {"failure_site": {"column": "w"}}}, 'failure_site is "top"'),
    ],
)
def test_lives_that_cannot_be_read(tmp_path: Path, text: str, changes: dict[str, Any], problem: str) -> None:
    with pytest.raises(RefusedError) as refused:
        lives(tmp_path, text, **changes)
    assert problem in refused.value.problem


def test_lives_of_every_kind_of_censoring(tmp_path: Path) -> None:
    """Exact, right, left in both notations, between inspections, seen once and never again, watched late."""
    text = "t,f,a,e\n5,1,,\n9,0,,\n< 4,1,,\n3,left,,\n8,1,6,\n7,1,7,2\n9,1,0,\n"
    table = lives(
        tmp_path,
        text,
        columns={
            "failed": {"column": "f", "failed_values": [1], "censored_values": [0], "left_censored_values": ["left"]},
            "alive_at": {"column": "a", "unit": "min"},
            "entered": {"column": "e", "unit": "min"},
        },
    )
    assert [(r.lower_s, r.upper_s, r.entered_s) for r in table.rows] == [
        (300, 300, None),
        (540, math.inf, None),
        (0, 240, None),
        (0, 180, None),
        (360, 480, None),
        (420, 420, 120),
        (0, 540, None),
    ]
    assert "4 failures are only known to lie between inspections, 3 of them before the first" in table.notes
    assert any("1 specimens came under watch late" in note for note in table.notes)


def test_limits_in_two_columns_without_flags(tmp_path: Path) -> None:
    columns = {
        "lifetime": {"column": "right", "unit": "h"},
        "alive_at": {"column": "left", "unit": "h"},
    }
    content = {"kind": "lifetimes", "columns": columns, "recording": {"recording_id": "two"}}
    table = read(tmp_path, "left,right\n0,7\n6,10\n46,\n", content)
    assert isinstance(table, LifetimeTable)
    assert [(r.lower_s / 3600, r.upper_s / 3600) for r in table.rows] == [(0, 7), (6, 10), (46, math.inf)]


def test_a_range_of_lives_is_no_power_of_ten(tmp_path: Path) -> None:
    content = {
        "kind": "lifetimes",
        "columns": {"lifetime": {"column": "life", "unit": "s"}},
        "recording": {"recording_id": "r"},
    }
    with pytest.raises(RefusedError, match='row 2 of the data: the life is "120-180"'):
        read(tmp_path, "life\n90\n120-180\n300\n", content)


def test_failure_modes_in_any_words(tmp_path: Path) -> None:
    text = (
        "t,f,why\n1,1,Pinhole in film\n2,1,contact burnt\n3,1,Überschlag\n4,1,carbon gone\n5,1,weird\n6,0,weird\n7,1,\n"
    )
    table = lives(tmp_path, text, columns={"failure_mode": {"column": "why", "edge_values": ["Überschlag"]}})
    assert [r.mode for r in table.rows] == ["film", "lead", "edge", "electrode", "other", None, None]
    assert [r.written_mode for r in table.rows][2] == "Überschlag"
    assert any('count as other: "weird"' in note for note in table.notes)


def test_conditions_of_the_test(tmp_path: Path) -> None:
    columns = {
        "temperature": {"value": 313.15, "unit": "K"},
        "humidity": {"column": "h", "unit": "%"},
        "frequency": {"value": 50, "unit": "Hz"},
        "electrode": {"value": "carbon"},
        "batch": {"column": "b"},
    }
    row = lives(tmp_path, "t,f,h,b\n1,1,45,7\n", columns=columns).rows[0]
    assert (row.temperature_c, row.humidity) == (pytest.approx(40.0), pytest.approx(0.45))
    assert (row.frequency_hz, row.electrode, row.batch) == (50.0, "carbon", "7")


def test_hostile_specimen_names_stay_text(tmp_path: Path) -> None:
    names = ["../../x", "'; DROP TABLE lifetimes; --", "<script>", "\u202eabc"]
    text = "t,f,n\n" + "".join(f"1,1,{n}\n" for n in names)
    table = lives(tmp_path, text, columns={"specimen_id": {"column": "n"}})
    assert [r.specimen_id for r in table.rows] == names


def test_frequency_response_in_hertz_and_radians(tmp_path: Path) -> None:
    text = "f,s,l\n1,2,0.5\n10,3,0.75\n"
    hertz = response(tmp_path, text)
    radians = response(tmp_path, text, columns={"frequency": {"column": "f", "unit": "rad/s"}})
    assert hertz.frequency_hz.tolist() == [1, 10]
    assert radians.frequency_hz == pytest.approx([1 / (2 * math.pi), 10 / (2 * math.pi)])
    assert hertz.value.tolist() == [2 + 0.5j, 3 + 0.75j]
    assert (hertz.measured_as, hertz.scale) == ("modulus", 1.0)
    with pytest.raises(RefusedError, match="cycles or radians"):
        response(tmp_path, text, columns={"frequency": {"column": "f", "unit": "1/s"}})


def test_magnitude_and_phase(tmp_path: Path) -> None:
    base: dict[str, Any] = {
        **RESPONSE,
        "columns": {
            "frequency": {"column": "f", "unit": "Hz"},
            "magnitude": {"column": "m", "unit": "N/m"},
            "phase": {"column": "p", "unit": "deg"},
            "standard_error": {"column": "e", "unit": "N/m"},
        },
    }
    table = read(tmp_path, "f,m,p,e\n1,2000,30,10\n2,2000,90,20\n", base)
    assert isinstance(table, ResponseTable)
    assert table.measured_as == "stiffness"
    assert table.value == pytest.approx([2 * complex(math.sqrt(3) / 2, 0.5), 2j])
    assert table.standard_error == pytest.approx([0.01, 0.02])


def test_modulus_with_geometry(tmp_path: Path) -> None:
    sides = {"film_length_mm": 20, "film_width_mm": 10, "film_thickness_mm": 0.5}
    table = response(tmp_path, "f,s,l\n1,2,1\n", recording=sides)
    assert table.value == pytest.approx([0.25 * (2 + 1j)])  # E·w·t/L = 2 MPa × 10 mm × 0.5 mm / 20 mm = 0.5 N/mm
    stiffness = {"storage": {"column": "s", "unit": "N/mm"}, "loss": {"column": "l", "unit": "N/mm"}}
    assert response(tmp_path, "f,s,l\n1,2,1\n", recording=sides, columns=stiffness).value == pytest.approx([2 + 1j])
    del sides["film_width_mm"]
    with pytest.raises(RefusedError, match="geometry is incomplete"):
        response(tmp_path, "f,s,l\n1,2,1\n", recording=sides)


def test_order_lost_rows_and_repeats(tmp_path: Path) -> None:
    table = response(tmp_path, "f,s,l\n10,3,1\n1,2,1\n5,,1\n0,1,1\n")
    assert table.frequency_hz.tolist() == [1, 10]
    assert table.value.real.tolist() == [2, 3]
    assert "2 of 4 rows lack a number" in table.problems[0]
    assert any("order of frequency" in n for n in table.notes)
    with pytest.raises(RefusedError, match="frequency 1 Hz stands in two rows"):
        response(tmp_path, "f,s,l\n1,2,1\n1,3,1\n")


def test_selection(tmp_path: Path) -> None:
    text = "f,s,l,set\n1,2,1,0\n2,3,1,0\n1,4,1,1\n2,5,1,1\n"
    table = response(tmp_path, text, select=[{"column": "set", "equals": 1}])
    assert table.value.real.tolist() == [4, 5]
    with pytest.raises(RefusedError, match="no row has"):
        response(tmp_path, text, select=[{"column": "set", "equals": [7]}])


OWN = {
    "displacement": {"column": "x", "unit": "mrad"},
    "transducer_displacement": {"column": "y", "unit": "rad"},
}


def test_share_of_the_machine_itself(tmp_path: Path) -> None:
    table = response(tmp_path, "f,s,l,x,y\n2,2,1,4,0.002\n1,2,1,1,-0.003\n3,2,1,0,0.001\n", columns=OWN)
    assert table.own_deformation is not None
    assert table.own_deformation[:2] == pytest.approx([3.0, 0.5])
    assert math.isnan(table.own_deformation[2])
    assert response(tmp_path, "f,s,l\n1,2,1\n").own_deformation is None
    length = {**OWN, "displacement": {"column": "x", "unit": "mm"}}
    with pytest.raises(RefusedError, match="transducer_displacement is in rad, displacement in mm"):
        response(tmp_path, "f,s,l,x,y\n1,2,1,1,1\n", columns=length)
    with pytest.raises(RefusedError, match=r"columns\.displacement is missing"):
        response(tmp_path, "f,s,l,y\n1,2,1,1\n", columns={"transducer_displacement": OWN["transducer_displacement"]})
    with pytest.raises(RefusedError, match='displacement has the unit "N"'):
        response(tmp_path, "f,s,l,x,y\n1,2,1,1,1\n", columns={**OWN, "displacement": {"column": "x", "unit": "N"}})


def test_negative_loss_is_kept_and_noted(tmp_path: Path) -> None:
    table = response(tmp_path, "f,s,l\n1,2,1\n2,2,-1\n")
    assert table.value.imag.tolist() == [1, -1]
    assert "negative loss" in table.notes[0]


@pytest.mark.parametrize(
    ("columns", "problem"),
    [
        ({"storage": {"column": "s", "unit": "V"}}, 'storage has the unit "V"'),
        ({"loss": {"column": "l", "unit": "N/mm"}}, "storage is a modulus, loss a stiffness"),
        ({"standard_error": {"column": "l", "unit": "N/mm"}}, "standard_error is a stiffness"),
        ({"phase": {"column": "l", "unit": "deg"}, "magnitude": {"column": "s", "unit": "MPa"}}, "2 complete pairs"),
    ],
)
def test_responses_that_cannot_be_read(tmp_path: Path, columns: dict[str, Any], problem: str) -> None:
    with pytest.raises(RefusedError) as refused:
        response(tmp_path, "f,s,l\n1,2,1\n", columns=columns)
    assert problem in refused.value.problem


def test_relaxation(tmp_path: Path) -> None:
    base: dict[str, Any] = {
        "kind": "relaxation",
        "columns": {"time": {"column": "t", "unit": "ms"}, "relaxation": {"column": "E", "unit": "kPa"}},
        "recording": {"recording_id": "{stem}"},
    }
    table = read(tmp_path, "t,E\n1,2000\n10,1500\n0,9\n", base)
    assert isinstance(table, RelaxationTable)
    assert table.time_s == pytest.approx([0.001, 0.01])
    assert table.value == pytest.approx([2.0, 1.5])
    assert np.isnan(table.standard_error).all()
    assert table.problems


def test_values_that_there_cannot_be_are_left_out_of_a_table_and_told(tmp_path: Path) -> None:
    text = "f,s,l\n1,2,1\n2,9.9e37,1\n3,2.1,-9999\n4,2,1\n5,2,1\n"
    table = response(tmp_path, text)
    assert table.frequency_hz.tolist() == [1, 4, 5]
    assert any("overload" in problem for problem in table.problems)
    assert any("dummy value -9999" in problem for problem in table.problems)
    with pytest.raises(RefusedError, match="beyond 1e"):
        response(tmp_path, "f,s,l\n1,2,1\n2,2,1\n", columns={"storage": {"column": "s", "unit": "YPa"}})


def test_a_life_that_there_cannot_be_refuses_the_table_with_its_row(tmp_path: Path) -> None:
    with pytest.raises(RefusedError, match=r"row 2 of the data: the life.* overload"):
        lives(tmp_path, "t,f\n1,1\n9.9e37,1\n4,0\n")
    assert [r.lifetime_s for r in lives(tmp_path, "t,f\n0.05,1\n999,1\n").rows] == [3.0, 999 * 60.0]


def test_keys_of_recordings_that_no_table_uses_are_named(tmp_path: Path) -> None:
    """The rods of a table of lives were accepted, and its weak regions never looked at, without a word."""
    made = read(tmp_path, "t,f\n1,yes\n2,no\n", LIFE, recording={"rods": 3, "rod_spacing_mm": 10, "x_shelf": "B"})
    assert isinstance(made, LifetimeTable)
    assert [note for note in made.notes if "no table uses" in note and "rods, rod_spacing_mm, x_shelf" in note]
