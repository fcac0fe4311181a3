"""The table of common units held against pint; dimensions; text that is no unit."""

from __future__ import annotations

import math
import pickle

import numpy as np
import pint
import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.errors import RefusedError
from schemas.quantities import QUANTITIES
from schemas.units import _COMMON, ANY, Conversion, conversion

REGISTRY = pint.UnitRegistry(autoconvert_offset_to_baseunit=True)
_OWN_MEANING = {("Hz", "rad/s"), ("Hz", "krad/s"), ("degC", "C"), ("degC", "°C"), ("degC", "℃")}
_SPELLING = {
    "%": "percent",
    "-": "dimensionless",
    "": "dimensionless",
    "1": "dimensionless",
    "°": "deg",
    "sec": "second",
}


@pytest.mark.parametrize(
    ("canonical", "unit"), [(c, u) for c, units in _COMMON.items() for u in units if (c, u) not in _OWN_MEANING]
)
def test_table_agrees_with_pint(canonical: str, unit: str) -> None:
    source, target = (_SPELLING.get(u, u) for u in (unit, canonical))
    expected = REGISTRY.Quantity(1.0, source).to(target).magnitude
    assert conversion(unit, canonical).scale == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(
    ("unit", "canonical", "value", "expected"),
    [
        ("lbf", "N", 1.0, 4.4482216152605),
        ("kN", "N", 2.0, 2000.0),
        ("ft", "mm", 1.0, 304.8),
        ("degF", "degC", 212.0, 100.0),
        ("K", "degC", 273.15, 0.0),
        ("C", "degC", 21.5, 21.5),
        ("psi", "kPa", 1.0, 6.894757293168361),
        ("N/mm**2", "MPa", 3.0, 3.0),
        ("week", "s", 1.0, 604800.0),
        ("rad/s", "Hz", 2 * math.pi, 1.0),
        ("μA", "µA", 3.0, 3.0),
        ("μm", "mm", 1000.0, 1.0),
        ("lbf/in", "N/mm", 1.0, 4.4482216152605 / 25.4),
    ],
)
def test_other_units(unit: str, canonical: str, value: float, expected: float) -> None:
    assert conversion(unit, canonical).apply(np.array([value]))[0] == pytest.approx(expected, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("quantity", [q for q in QUANTITIES.values() if q.unit != ANY], ids=lambda q: q.name)
def test_wrong_dimension_is_refused(quantity: object) -> None:
    canonical = QUANTITIES[quantity.name].unit  # type: ignore[attr-defined]
    for unit in ("kg", "candela"):
        with pytest.raises(RefusedError) as refused:
            conversion(unit, canonical, where="here")
        assert refused.value.where == "here"
        assert unit in refused.value.problem


@pytest.mark.parametrize(
    "text",
    ["", " ", "N m;", "9**9**9**9", "m" * 100, "import os", "1e999 N", "N\x00", "µ", "0 N", "__class__", "(" * 50],
)
def test_text_that_is_no_unit_is_refused(text: str) -> None:
    with pytest.raises(RefusedError):
        conversion(text, "N")


@pytest.mark.parametrize("text", ["1/s", "rpm", "rad/min", "s"])
def test_frequencies_that_may_be_angular_are_refused(text: str) -> None:
    with pytest.raises(RefusedError, match="cycles or radians"):
        conversion(text, "Hz")


@given(st.text(max_size=80))
def test_any_text_is_converted_or_refused(text: str) -> None:
    try:
        found = conversion(text, "kPa")
    except RefusedError:
        return
    assert math.isfinite(found.scale)
    assert found.scale != 0


def test_any_keeps_everything() -> None:
    assert conversion("furlongs per fortnight", ANY).is_identity


def test_identity_does_not_copy() -> None:
    values = np.arange(3.0)
    assert Conversion(1.0).apply(values) is values


def test_difference_has_no_offset() -> None:
    assert conversion("degF", "degC").apply_difference(9.0) == pytest.approx(5.0)


def test_errors_survive_a_process_border() -> None:
    with pytest.raises(RefusedError) as refused:
        conversion("kg", "N", where="a.csv: force")
    again = pickle.loads(pickle.dumps(refused.value))
    assert str(again) == str(refused.value)
    assert again.expected == refused.value.expected


@pytest.mark.parametrize(
    ("written", "canonical", "scale"),
    [
        ("Newtons", "N", 1.0),
        ("Millimeters", "mm", 1.0),
        ("Volt", "kV", 1e-3),
        ("N/mm2", "MPa", 1.0),
        ("N/mm²", "MPa", 1.0),
        ("kp", "N", 9.80665),
        ("Sekunden", "s", 1.0),
        ("Grad", "rad", math.pi / 180),
        ("Amps", "µA", 1e6),
    ],
)
def test_units_as_drivers_and_people_write_them(written: str, canonical: str, scale: float) -> None:
    assert conversion(written, canonical).scale == pytest.approx(scale, rel=1e-12)


@pytest.mark.parametrize(("written", "canonical"), [("dB", "1"), ("cycles", "s"), ("H2O", "N"), ("m2", "mm")])
def test_what_is_no_unit_of_it_is_refused(written: str, canonical: str) -> None:
    with pytest.raises(RefusedError):
        conversion(written, canonical)
