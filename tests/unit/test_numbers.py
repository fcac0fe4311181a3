"""Numbers in the pages: rounding by uncertainty, true minus, no-break spaces."""

from __future__ import annotations

import math
import re

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from schemas import numbers

GAP = numbers.NBSP


def plain(text: str) -> str:
    """The text with ordinary spaces and minus signs."""
    return text.replace(GAP, " ").replace(numbers.THIN, " ").replace("−", "-")


@pytest.mark.parametrize(
    ("value", "sd", "expected"),
    [
        (21.268, 0.062, "21.27 ± 0.06"),
        (1.573, 0.281, "1.57 ± 0.28"),
        (0.99991, 0.00088, "0.9999 ± 0.0009"),
        (-3.14159, 0.5, "-3.1 ± 0.5"),
        (12.4, 3.0, "12 ± 3"),
        (1234.0, 170.0, "1230 ± 170"),
        (0.0, 0.0021, "0.0000 ± 0.0021"),
        (87e-6, 5e-6, "(8.7 ± 0.5) × 10⁻⁵"),
        (9.96, 0.0996, "9.96 ± 0.10"),
        (25_000.0, 300.0, "25 000 ± 300"),
        (3.0e7, 2.0e6, "(3.00 ± 0.20) × 10⁷"),
    ],
)
def test_value_and_sd(value: float, sd: float, expected: str) -> None:
    assert plain(numbers.pm(value, sd)) == expected


@pytest.mark.parametrize("sd", [None, 0.0, -1.0, math.nan, math.inf])
def test_no_false_uncertainty(sd: float | None) -> None:
    assert plain(numbers.pm(1.5, sd, "N")) == "1.50 N, ± unresolved"


@pytest.mark.parametrize(
    ("share", "expected"),
    [
        (1.0, "100 %"),
        (0.9993, "99.9 %"),
        (0.9997, "99.97 %"),
        (0.999999, "> 99.99 %"),
        (0.997, "99.7 %"),
        (0.994, "99 %"),
        (0.0512, "5.1 %"),
    ],
)
def test_what_is_not_all_is_not_a_hundred_percent(share: float, expected: str) -> None:
    assert plain(numbers.percent(share)) == expected


def test_absent() -> None:
    assert numbers.pm(None, 0.1) == numbers.significant(math.nan) == numbers.percent(None) == "–"


@settings(deadline=None)
@given(
    st.floats(-1e5, 1e5).filter(lambda v: v == 0 or abs(v) > 1e-3),
    st.floats(1e-4, 1e4),
)
def test_rounding_loses_less_than_a_third_of_the_sd(value: float, sd: float) -> None:
    text = plain(numbers.pm(value, sd)).replace(" ", "")
    scale = 1.0
    if "×" in text:
        text, _, power = text.partition("×10")
        scale = 10.0 ** int(power.translate(str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-")))
        text = text.strip("()")
    shown, shown_sd = (float(x) * scale for x in text.split("±"))
    assert abs(shown - value) <= sd / 3
    assert abs(shown_sd - sd) <= 0.17 * sd
    assert len(re.sub(r"[^1-9]", "", text.split("±")[1].lstrip("0."))) <= 2


@settings(deadline=None)
@given(st.floats(1.01e-16, 1.0))
def test_p_keeps_two_digits(p: float) -> None:
    text = plain(numbers.p_value(p))
    mantissa, _, power = text.partition(" × 10")
    shown = float(mantissa) * 10.0 ** int(power.translate(str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-")) or 0)
    assert shown == pytest.approx(p, rel=0.051)
    assert ("×" in text) == (p < 0.001)


def test_a_heading_leaves_tiny_standard_deviations_to_the_table() -> None:
    assert plain(numbers.headline(0.4000021, 1.8e-6, "N/mm")) == "0.4000 N/mm"
    assert plain(numbers.headline(1.0001, 0.0009, "N/mm")) == "1.0001 ± 0.0009 N/mm"
    assert plain(numbers.headline(1.0, None)) == "1.00, ± unresolved"


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [
        (-0.00214, 5.34, "0.00 to 5.34"),
        (0.44, 0.502, "0.4400 to 0.5020"),
        (-0.0916, 450.0, "0 to 450"),
        (7.0, 7.0, "7.00"),
    ],
)
def test_a_span_is_given_to_a_hundredth_of_its_width(low: float, high: float, expected: str) -> None:
    assert plain(numbers.span(low, high)) == expected


@pytest.mark.parametrize("p", [0.0, 1e-300, 9e-17])
def test_no_p_is_surer_than_the_formula_it_comes_from(p: float) -> None:
    assert plain(numbers.p_equals(p)) == "p < 10⁻¹⁶"


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ((40.2, 28.1, 51.9), "40 (28–52)"),
        ((1.57, 1.1, 2.2), "1.57 (1.10–2.20)"),
        ((1.0, 0.692, 1.0, 100.0), "100 (69–100)"),
        ((23.0, 13.0, None), "23 (≥ 13)"),
        ((-6.88, -7.6, -6.1), "-6.9 (-7.6 to -6.1)"),
        ((5.0, None, None), "5.00"),
        ((None, 1.0, 2.0), "–"),
        ((4_883_219.0, 4_712_332.0, 5_035_325.0), "4.88 (4.71–5.04) × 10⁶"),
        ((1.1e6, 2.7e4, 5.6e7), "1.1 × 10⁶ (27 000–5.6 × 10⁷)"),
    ],
)
def test_bounds(arguments: tuple[float | None, ...], expected: str) -> None:
    assert plain(numbers.bounds(*arguments)) == expected


def test_quantities_do_not_break_over_lines() -> None:
    for text in (numbers.pm(1.5, 0.1, "N/mm"), numbers.percent(0.5), numbers.seconds(30.0), numbers.p_equals(1e-9)):
        assert " " not in text


@pytest.mark.parametrize(
    ("value", "expected"), [(30.0, "30.0 s"), (150.0, "2 min 30 s"), (9000.0, "2.50 h"), (0.05, "0.050 s")]
)
def test_seconds(value: float, expected: str) -> None:
    assert plain(numbers.seconds(value)) == expected


def test_settings_lose_trailing_zeros_only() -> None:
    assert [plain(numbers.compact(v)) for v in (7.5, 100.0, 1.0, 1e-7, 20.25)] == [
        "7.5",
        "100",
        "1",
        "1 × 10⁻⁷",
        "20.2",
    ]


@pytest.mark.parametrize(("longest", "unit"), [(240.0, "s"), (32_776_000.0, "h"), (3.3e8, "d")])
def test_lives_are_read_in_a_fitting_unit(longest: float, unit: str) -> None:
    factor, found = numbers.time_unit(longest)
    assert found == unit
    assert 1 <= longest * factor < 1e5


@pytest.mark.parametrize(("largest", "expected"), [(2.0, (1.0, "N")), (0.012, (1e3, "mN")), (1.6e-5, (1e6, "µN"))])
def test_small_levels_get_a_small_unit(largest: float, expected: tuple[float, str]) -> None:
    assert numbers.scaled("N", largest) == expected
    assert numbers.scaled("V", largest) == (1.0, "V")


def test_words() -> None:
    assert numbers.joined(["a", "b", "c"]) == "a, b and c"
    assert plain(numbers.counted(1, "recording")) == "one recording"
    assert plain(numbers.counted(13, "recording")) == "13 recordings"
    assert numbers.ordinal(3) == "third"
    assert numbers.ordinal(12) == "12th"


EVERY = st.floats(-1e12, 1e12).filter(lambda v: v == 0 or abs(v) > 1e-12)
SHARES = st.floats(0.0, 1.0)


def read(text: str) -> float:
    """The number that a text shows, by the rules of typography alone."""
    mantissa, _, power = plain(text).replace(" ", "").replace("%", "").partition("×10")
    return float(mantissa.lstrip("<>")) * 10.0 ** int(power.translate(_POWERS) or 0)


_POWERS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-")


@settings(deadline=None)
@given(EVERY, st.floats(0, 1e12), st.floats(0, 1e12))
def test_whatever_is_shown_is_typeset(value: float, down: float, up: float) -> None:
    """No hyphen for a minus, no e-notation, no infinity, no space at which a line could break."""
    texts = [
        numbers.bounds(value, value - down, value + up), numbers.pm(value, down), numbers.never_negative(value, down, "N"),
        numbers.significant(value), numbers.compact(value), numbers.percent(value),
    ]  # fmt: skip
    for text in texts:
        assert not re.search(r"-|\de[+-]?\d|inf|nan|\n", text), text
    assert all(" " not in text for text in texts[1:] if "unresolved" not in text)


@pytest.mark.parametrize(
    ("shown", "expected"),
    [
        (numbers.significant(5e-324), "4.94 × 10⁻³²⁴"),
        (numbers.significant(-1.797e308), "-1.80 × 10³⁰⁸"),
        (numbers.pm(5e-324, 2e-320), "(0.0 ± 2.0) × 10⁻³²⁰"),
        (numbers.bounds(2e-312, 1e-312, 3e-312), "2.0 (1.0–3.0) × 10⁻³¹²"),
    ],
)
def test_the_smallest_and_largest_numbers_are_written(shown: str, expected: str) -> None:
    assert plain(shown) == expected


@settings(deadline=None)
@given(st.floats(), st.floats(), st.floats())
def test_no_number_stops_a_page(value: float, sd: float, limit: float) -> None:
    for text in (
        numbers.significant(value), numbers.compact(value), numbers.pm(value, sd), numbers.headline(value, sd), numbers.p_value(value),
        numbers.never_negative(value, sd), numbers.bounds(value, sd, limit), numbers.span(value, sd), numbers.percent(value),
    ):  # fmt: skip
        assert text


@settings(deadline=None)
@given(EVERY, st.floats(1e-6, 1e6), st.floats(1e-6, 1e6))
def test_an_interval_is_never_shown_as_a_point(value: float, down: float, up: float) -> None:
    """Limits that differ by more than a millionth of the value are told apart, and hold what is shown between them."""
    low, high = value - down * max(abs(value), 1e-3), value + up * max(abs(value), 1e-3)
    text = numbers.bounds(value, low, high)
    shown, _, rest = text.partition("(")
    inside, _, power = rest.partition(")")
    first, second = re.split(f"{GAP}to{GAP}|–", inside)
    assert first != second
    parts = [read(one + power) for one in (shown, first, second)]
    assert parts[1] <= parts[0] <= parts[2]
    assert parts[0] == pytest.approx(value, abs=(high - low) / 8)


@settings(deadline=None)
@given(SHARES)
def test_a_share_is_all_or_nothing_only_where_it_is(share: float) -> None:
    text = plain(numbers.percent(share))
    assert (text == "100 %") == (share == 1)
    if not text.startswith(">"):
        assert read(text) / 100 == pytest.approx(share, rel=0.051, abs=1e-300)


@settings(deadline=None)
@given(st.floats(0.5, 1 - 1e-9), st.floats(1e-3, 0.9), st.floats(1e-3, 0.9))
def test_what_is_nearly_all_is_told_by_what_it_surely_exceeds(share: float, down: float, up: float) -> None:
    """`99.99 % (99.99 to 99.99)` is no interval, and `all but 0.00096 %` no text: of nearly all a bound is given, never too high."""
    left = 1 - share
    lower = 1 - left * (1 + down)
    text = plain(numbers.removed(share, lower, 1 - left * (1 - up)))
    assert text.startswith("more than") == (share >= 0.995 and lower > 0.99)
    found = re.search(r"interval (.*) to (.*)\)", text)
    assert found is None or found[1] != found[2]
    if text.startswith("more than"):
        bound = read(text.removeprefix("more than ")) / 100
        assert bound < lower
        assert 1 - bound <= max(10 * (1 - lower) * (1 + 1e-9), 1.0001e-4), "no nine is kept back, up to four of them"
    else:
        assert read(text.split(" %")[0] + " %") / 100 == pytest.approx(share, rel=0.06)


def test_a_gain_of_nearly_all_is_told_in_a_few_digits() -> None:
    assert plain(numbers.removed(0.9999904, 0.99999, 0.9999907)) == "more than 99.99 %"
    assert plain(numbers.removed(0.9996, 0.9991, 0.9998)) == "more than 99.9 %"
    assert plain(numbers.removed(0.996, 0.98, 0.998)) == "99.6 % (95 % interval 98 % to 99.8 %)"
    assert plain(numbers.removed(0.9999904)) == "more than 99.99 %"
    assert plain(numbers.removed(0.97, 0.95, 0.98)) == "97 % (95 % interval 95 % to 98 %)"
    assert plain(numbers.removed(0.97, 0.9701, 0.9702)) == "97 % (95 % interval within rounding)"
    assert numbers.removed(None) == "–"


@pytest.mark.parametrize(
    ("share", "lower", "told", "in_a_cell"),
    [
        (1.0, 0.97, "at least 97 %", "≥ 97 %"),
        (1.0, 0.99991, "more than 99.99 %", "> 99.99 %"),
        (1.0, None, "all but noise", "all but noise"),
        (0.9997, None, "more than 99.9 %", "> 99.9 %"),
        (0.97, 0.93, "97 %", "97 %"),
    ],
)
def test_no_gain_is_a_hundred_percent(share: float, lower: float | None, told: str, in_a_cell: str) -> None:
    """A gain ends at 1, where nothing but noise is left: the limit says what it is."""
    assert plain(numbers.removed(share, lower)) == told
    assert plain(numbers.removed(share, lower, None if lower is None else 1.0)).startswith(told)
    assert plain(numbers.gained(share, lower)) == in_a_cell


def test_what_is_counted_has_whole_limits() -> None:
    assert plain(numbers.counted_bounds(100.5, 99.0, 100.6)) == "100 (99–101)"
    assert numbers.counted_bounds(7.0, None, None) == "7"
    assert numbers.counted_bounds(None, 1.0, 2.0) == "–"


@settings(deadline=None)
@given(SHARES)
def test_no_probability_is_certain_or_impossible(share: float) -> None:
    text = plain(numbers.probability(share))
    assert text not in ("0 %", "100 %")
    assert "10⁻" not in text
    if text[0] not in "<>":
        assert read(text) / 100 == pytest.approx(share, rel=0.051)


@pytest.mark.parametrize(
    ("value", "sd", "expected"),
    [
        (0.001, 0.03, "< 0.060 N"),
        (0.31, 0.02, "0.310 ± 0.020 N"),
        (0.5, None, "0.500 N, ± unresolved"),
        (None, 0.1, "–"),
    ],
)
def test_what_cannot_be_negative_gets_a_limit(value: float | None, sd: float | None, expected: str) -> None:
    assert plain(numbers.never_negative(value, sd, "N")) == expected


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("three films", "Three films"), ("k3 at least 0.02", "k3 at least 0.02"), ("drive_lag is there", "drive_lag is there"),
        ("kV is the unit", "kV is the unit"), ("c₃ is not resolved", "c₃ is not resolved"), ("", ""), ("Already", "Already"),
    ],
)  # fmt: skip
def test_symbols_and_ids_keep_their_case(text: str, expected: str) -> None:
    assert numbers.capital(text) == expected


def test_stored_sentences_get_their_typography() -> None:
    assert numbers.symbols("k3 between -0.1 and 2; tau1, c2 of run k33 on 2026-03-01") == (
        "k₃ between −0.1 and 2; τ₁, c₂ of run k33 on 2026-03-01"
    )


@pytest.mark.parametrize(
    ("count", "total", "expected"),
    [
        (1, 1, "the one step"),
        (1, 3, "1 of 3 steps"),
        (3, 3, "all 3 steps"),
        (0, 1, "0 of 1 step"),
        (0, 3, "0 of 3 steps"),
    ],
)
def test_shares_of_one_are_no_plural(count: int, total: int, expected: str) -> None:
    assert plain(numbers.among(count, total, "step")) == expected


def test_headings_of_everything_know_when_it_is_one() -> None:
    assert [plain(numbers.every(n, "recording")) for n in (1, 2)] == ["The one recording", "All 2 recordings"]
