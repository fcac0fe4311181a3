"""What a diagnosis compared, as figures: axes, magnitudes, residuals in SD."""

from __future__ import annotations

import base64
import re
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from pipeline.diagnose.features import kinds
from pipeline.diagnose.search.discrepancies import _WORDS
from reports.features import COLUMNS, KINDS, compared, kind_of
from reports.figures.comparison import broken, comparison, comparison_reach


def row(**more: Any) -> dict[str, Any]:
    base = {
        "recording_id": "r-1", "kind": "chirp.response", "block": "sweep 1", "position": 0, "component": "", "frequency_hz": 1.0,
        "amplitude": 0.01, "voltage_kv": None, "cycle": 1.0, "time_s": 1.0, "measured": 1.0, "plain": 1.0, "extended": None, "sd": 0.1,
    }  # fmt: skip
    return base | more


def sweep(measured: np.ndarray, plain: np.ndarray, extended: np.ndarray | None) -> list[dict[str, Any]]:
    """Rows of a complex block over 1, 2, … Hz."""
    rows = []
    for component, part in (("real", np.real), ("imaginary", np.imag)):
        for i in range(measured.size):
            rows.append(
                row(
                    component=component, frequency_hz=i + 1.0, measured=float(part(measured)[i]), plain=float(part(plain)[i]),
                    extended=None if extended is None else float(part(extended)[i]),
                )
            )  # fmt: skip
    return rows


def svg(image: str) -> str:
    found = re.search(r"base64,([^\"]+)", image)
    assert found
    return base64.b64decode(found[1]).decode()


numbers = st.complex_numbers(max_magnitude=100, allow_nan=False, allow_infinity=False)


@pytest.mark.long
@given(st.lists(st.tuples(numbers, numbers), min_size=2, max_size=8))
@example([(0j, 0j), (5e-324 + 0j, 0j)])
def test_residuals_are_those_of_both_components_in_sd(pairs: list[tuple[complex, complex]]) -> None:
    measured, plain = (np.array(v) for v in zip(*pairs, strict=True))
    data = compared("chirp.response", sweep(measured, plain, measured), together=False)
    assert data is not None
    off = (measured - plain) / 0.1
    assert data.rms(data.plain) == pytest.approx(np.sqrt(np.mean(np.concatenate([off.real, off.imag]) ** 2)))
    assert data.extended is not None
    assert data.rms(data.extended) == 0
    assert data.residual_x.size == data.residual(data.plain).size
    assert "extended: 0.0" in svg(comparison(data, alt="a"))


def test_a_response_lies_over_frequency_and_a_course_over_time() -> None:
    data = compared("chirp.response", sweep(np.ones(3) + 1j, np.ones(3) + 0j, None), together=False)
    assert data is not None
    assert (data.x_title, data.x_log, data.lines, data.extended) == ("Frequency, Hz", True, True, None)
    steps = [row(kind="step.force", time_s=float(t), frequency_hz=9.0 - t, measured=0.1) for t in range(4)]
    course = compared("step.force", steps, together=False)
    assert course is not None
    assert course.x.tolist() == [0, 1, 2, 3]
    assert course.measured.tolist() == pytest.approx([100.0] * 4)
    assert course.title.endswith("mN")


def test_small_blocks_stand_in_their_order_named_by_what_tells_recordings_apart() -> None:
    rows = [
        row(kind="cyclic.level", recording_id=f"r-{i}", amplitude=0.01 * (1 + i // 2), cycle=1.0 + i % 2)
        for i in range(4)
    ]
    rows = [r | {"recording_id": f"r-{i // 2}"} for i, r in enumerate(rows)]
    data = compared("cyclic.level", rows, together=True)
    assert data is not None
    assert data.groups == ((0.5, "1"), (2.5, "2"))
    assert "strain amplitude" in data.x_title
    assert not data.lines
    text = svg(comparison(data, alt="a"))
    assert "extended" not in text
    same = compared("cyclic.level", [row(kind="cyclic.level")] * 3, together=True)
    assert same is not None
    assert same.groups == ()
    assert comparison(same, alt="a")


def test_a_course_is_broken_at_an_edge_only() -> None:
    after = np.geomspace(0.1, 5.0, 8)
    x, y = broken(np.concatenate([after, 6.0 + after]), np.ones(16))
    assert np.flatnonzero(np.isnan(x)).tolist() == [8]
    assert np.isnan(y[8])
    assert x.size == 17
    assert not np.isnan(broken(np.linspace(1, 100, 30), np.ones(30))[0]).any()
    assert broken(np.array([1.0, 2.0]), np.array([5.0, 4.0]))[1].tolist() == [5.0, 4.0]


def test_values_without_a_place_give_no_figure() -> None:
    assert compared("relaxation.force", [row(kind="relaxation.force", time_s=None)] * 2, together=False) is None
    halves = sweep(np.ones(2) + 0j, np.ones(2) + 0j, None)[:3]
    assert compared("chirp.response", halves, together=False) is None


def test_an_unknown_kind_is_called_what_it_is() -> None:
    assert kind_of("loop.phase").words == "loop phase"
    assert all(kind.title and kind.column for kind in KINDS.values())


@pytest.mark.parametrize("off", [1.0, 1e3, 1e6, 1e9])
def test_words_above_the_residuals_do_not_run_into_each_other(off: float) -> None:
    """A bold letter is up to two thirds of its size wide; "plain: 357" and "extended: 1.3" touched."""
    measured = np.arange(1.0, 9.0) + 0j
    data = compared("chirp.response", sweep(measured, measured + off, measured + 0.1), together=False)
    assert data is not None
    texts = re.findall(
        r'<text x="([\d.]+)"[^>]*>([^<]*(?:Residual|plain:|extended:)[^<]*)<', svg(comparison(data, alt="a"))
    )
    (_, title), *ends = sorted((float(x), text) for x, text in texts)
    assert title.startswith("Residual")
    left = 52 + 6.6 * len(title)
    for x, text in ends:
        assert x - 7.9 * len(text) > left
        left = x


def test_what_is_missed_in_phase_is_drawn_as_phase() -> None:
    """A lag of 0.3 ms turns 11° at 99 Hz and takes 2 % of the magnitude: the figure shows what the text speaks of."""
    f = np.arange(1, 100)
    measured = 1.5 * np.exp(-2j * np.pi * f * 0.3e-3)
    data = compared("sphs.voltage", sweep(measured, np.full(99, 1.5 + 0j), measured), together=False)
    assert data is not None
    assert data.turned
    assert data.shown_title == "Phase of voltage over command, degrees"
    assert data.shown(data.measured) == pytest.approx(-360 * f * 0.3e-3)
    assert "Phase of voltage" in svg(comparison(data, alt="a"))


def test_phases_beyond_half_a_turn_do_not_jump() -> None:
    measured = np.exp(1j * np.radians([170.0, 178.0, 186.0, 194.0]))
    data = compared("chirp.response", sweep(measured, np.full(4, -1.0 + 0j), None), together=False)
    assert data is not None
    assert np.diff(data.shown(data.measured)) == pytest.approx(8.0)


def test_what_is_missed_in_magnitude_is_drawn_as_magnitude() -> None:
    data = compared("chirp.response", sweep(np.full(5, 2.0 + 0j), np.full(5, 1.0 + 0.01j), None), together=False)
    assert data is not None
    assert not data.turned
    assert data.shown_title.startswith("Response |F/x|")


def test_models_are_not_followed_through_lines_that_are_badly_seen() -> None:
    rows = sweep(np.ones(9) + 0j, np.ones(9) + 0j, None)
    for r in rows:
        if r["frequency_hz"] == 4.0:
            r["sd"] = 0.9
    data = compared("chirp.response", rows, together=False)
    assert data is not None
    assert data.sharp.tolist() == [f != 4 for f in range(1, 10)]


def test_residuals_that_dwarf_the_noise_are_all_inside_the_figure() -> None:
    plain = np.ones(40) + 0j
    plain[7] = 400.0
    data = compared("chirp.response", sweep(np.ones(40) + 0j, plain + 30, plain), together=False)
    assert data is not None
    assert comparison_reach(data) > max(
        np.abs(data.residual(data.plain)).max(), np.abs(data.residual(data.plain)).max()
    )


@pytest.mark.parametrize("kind", kinds.KINDS)
def test_every_kind_of_features_has_words_and_a_column_of_the_map(kind: str) -> None:
    """A kind without them is called by its name in the database, on a column of its own."""
    assert KINDS[kind].column in COLUMNS
    assert kind in _WORDS
