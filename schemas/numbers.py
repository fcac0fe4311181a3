"""Numbers as a physicist writes them: rounded by their uncertainty, with units, never broken over two lines.

What a number means, and which sentence it stands in, does not belong here.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from decimal import Decimal
from typing import TypeGuard

NBSP = "\u00a0"
THIN = "\u202f"
MINUS = "−"
ABSENT = "–"
UNRESOLVED = "unresolved"

_SUPERSCRIPT = str.maketrans("0123456789-.", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻·")
_WORDS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve")
_ORDINALS = ("zeroth", "first", "second", "third", "fourth", "fifth", "sixth", "seventh", "eighth")


def fixed(value: float, places: int) -> str:
    """`value` with that many decimals (negative: rounded to tens, hundreds, …), true minus, groups from 10 000 on."""
    rounded = round(value, places)
    text = f"{abs(rounded):.{max(0, places)}f}"
    whole, _, fraction = text.partition(".")
    if len(whole) > 4:
        whole = f"{int(whole):,}".replace(",", THIN)
    sign = MINUS if rounded < 0 else ""
    return sign + whole + (f".{fraction}" if fraction else "")


def whole(count: int | None) -> str:
    """A count, grouped in threes from 10 000 on."""
    return ABSENT if count is None else fixed(count, 0)


def _power(exponent: int) -> str:
    return f"10{power(exponent)}"


def power(exponent: float) -> str:
    """An exponent as superscript: `⁻⁶·⁸⁸` after the V of an inverse power law; whole numbers without a point."""
    text = str(exponent) if isinstance(exponent, int) else f"{exponent:.2f}"
    return text.translate(_SUPERSCRIPT)


def _over_power(value: float, exponent: int) -> float:
    """`value` / 10^`exponent`; the power of ten by itself may be too small or too large for a number."""
    return float(Decimal(value).scaleb(-exponent))


def significant(value: float | None, digits: int = 3) -> str:
    """`value` to so many significant digits; very small and very large ones as a power of ten; `–` when absent."""
    if value is None or not math.isfinite(value):
        return ABSENT
    if value == 0:
        return "0"
    exponent = int(f"{value:.{digits - 1}e}".partition("e")[2])
    if -4 <= exponent < 6:
        return fixed(value, digits - 1 - exponent)
    return f"{fixed(_over_power(value, exponent), digits - 1)}{NBSP}×{NBSP}{_power(exponent)}"


def span(low: float, high: float) -> str:
    """`−0.02 to 5.34`: both ends to the place that a hundredth of the range between them has."""
    if not (math.isfinite(low) and math.isfinite(high)):
        return f"{significant(low)} to {significant(high)}"
    if low == high:
        return significant(low)
    width = max(high - low, 1e-3 * max(abs(low), abs(high)))
    place = 2 - math.floor(math.log10(width))
    if not -3 <= place <= 6:
        return f"{significant(low)} to {significant(high)}"
    return f"{fixed(low, place)} to {fixed(high, place)}"


def compact(value: float | None, digits: int = 3) -> str:
    """As `significant`, without trailing zeros: for settings and limits, which are exact (`7.5`, `100`)."""
    text = significant(value, digits)
    mantissa, cross, power = text.partition(f"{NBSP}×")
    if "." in mantissa:
        mantissa = mantissa.rstrip("0").rstrip(".")
    return mantissa + cross + power


def with_unit(text: str, unit: str) -> str:
    """Number and unit joined by a no-break space; degrees stand close."""
    if not unit or text in (ABSENT, UNRESOLVED):
        return text
    return text + unit if unit == "°" else f"{text}{NBSP}{unit}"


def _place(sd: float) -> int:
    """Decimals to which an SD is given: one digit, two if they begin with 1 or 2."""
    exponent = math.floor(math.log10(sd))
    lead = round(_over_power(sd, exponent), 6)
    return -exponent + (1 if lead < 2.95 else 0)


def finite_or_none(value: float) -> float | None:
    """A number as a table holds it: NULL for what is not finite."""
    return float(value) if math.isfinite(value) else None


def is_usable(sd: float | None) -> TypeGuard[float]:
    """Whether a standard deviation says how well a value is known."""
    return sd is not None and math.isfinite(sd) and sd > 0


def pm(value: float | None, sd: float | None, unit: str = "") -> str:
    """Value ± SD: the SD to one digit, to two if they begin with 1 or 2; the value to the same place.

    Without a usable SD there is no ±: the value is given to three digits and said to be unresolved.
    """
    if value is None or not math.isfinite(value):
        return ABSENT
    if not is_usable(sd):
        return f"{with_unit(significant(value), unit)}, ±{NBSP}{UNRESOLVED}"
    exponent = math.floor(math.log10(max(abs(value), sd)))
    if -4 < exponent < 6:
        place = _place(sd)
        return with_unit(f"{fixed(value, place)}{NBSP}±{NBSP}{fixed(sd, place)}", unit)
    place = _place(sd) + exponent
    value, sd = _over_power(value, exponent), _over_power(sd, exponent)
    pair = f"({fixed(value, place)}{NBSP}±{NBSP}{fixed(sd, place)}){NBSP}×{NBSP}{_power(exponent)}"
    return with_unit(pair, unit)


def never_negative(value: float | None, sd: float | None, unit: str = "") -> str:
    """As `pm`, of what cannot be negative: where ± would reach down to 0 the upper 95 % limit alone, `< 0.06`."""
    if value is None or sd is None or not math.isfinite(value) or not math.isfinite(sd) or sd < abs(value):
        return pm(value, sd, unit)
    return with_unit(f"<{NBSP}{significant(abs(value) + 1.96 * sd, 2)}", unit)


def headline(value: float | None, sd: float | None, unit: str = "") -> str:
    """As `pm`, for a heading: a statistical SD below 10⁻⁴ of the value is left to the table, where its meaning is said."""
    if value is not None and sd is not None and 0 < sd < 1e-4 * abs(value):
        return with_unit(significant(value, 4), unit)
    return pm(value, sd, unit)


_SAME_POWER = 0.03
"""A lower limit below this share of the upper one is rounded away beside it."""


def bounds(value: float | None, lower: float | None, upper: float | None, scale: float = 1.0) -> str:
    """`40 (28–52)`: value with its 95 % limits, rounded as an SD of a quarter of the interval would be.

    One limit alone is given as `(≥ 13)`; without limits the value stands alone to three digits. Very small and very
    large ones share a power of ten: `1.0 (0.2–5.6) × 10⁷`, unless their limits are so far apart that one would be nothing.
    """
    if value is None or not math.isfinite(value):
        return ABSENT
    value, known = scale * value, [scale * e for e in (lower, upper) if e is not None and math.isfinite(e)]
    width = max(value, *known) - min(value, *known) if known else 0.0
    if width <= 0:
        return significant(value)
    exponent = math.floor(math.log10(max(abs(value), *(abs(e) for e in known))))
    if not -4 <= exponent < 6:
        if len(known) == 2 and max(known) > 0 and 0 < min(known) < _SAME_POWER * max(known):
            each = [significant(v, 2) for v in (value, *sorted(known))]
            return f"{each[0]}{NBSP}({each[1]}{ABSENT}{each[2]})"
        low, high = (None if e is None else _over_power(e * scale, exponent) for e in (lower, upper))
        reduced = bounds(_over_power(value, exponent), low, high)
        return f"{reduced}{NBSP}×{NBSP}{_power(exponent)}"
    place = _place(width / (4 if len(known) == 2 else 2))
    if len(known) == 1:
        limit = f"{'≥' if upper is None else '≤'}{NBSP}{fixed(known[0], place)}"
    else:
        low, high = sorted(known)
        join = f"{NBSP}to{NBSP}" if low < 0 else ABSENT
        limit = f"{fixed(low, place)}{join}{fixed(high, place)}"
    return f"{fixed(value, place)}{NBSP}({limit})"


def counted_bounds(value: float | None, lower: float | None, upper: float | None) -> str:
    """As `bounds`, of what is counted, such as cycles: whole numbers, limits outwards: `100 (99–101)`."""
    if value is None or not math.isfinite(value):
        return ABSENT
    if lower is None or upper is None or not (math.isfinite(lower) and math.isfinite(upper)):
        return whole(round(value))
    return f"{whole(round(value))}{NBSP}({whole(math.floor(lower))}{ABSENT}{whole(math.ceil(upper))})"


_SUREST = 1e-16
"""Below it a p-value says nothing about the world any more, only about the tail of a formula."""


def p_value(p: float | None) -> str:
    """Two digits; a power of ten below 0.001; nothing is surer than 10⁻¹⁶, whatever a formula gives."""
    if p is None or not math.isfinite(p):
        return ABSENT
    if p >= 0.995:
        return "1.0"
    if p >= 0.001:
        return significant(p, 2)
    if p < _SUREST:
        return f"<{NBSP}{_power(-16)}"
    exponent = math.floor(math.log10(float(f"{p:.1e}")))
    return f"{fixed(p / 10.0**exponent, 1)}{NBSP}×{NBSP}{_power(exponent)}"


def p_equals(p: float | None) -> str:
    """`p = 0.012`, or `p < …` where the number is a bound."""
    text = p_value(p)
    return f"p{NBSP}{text}" if text.startswith("<") else f"p{NBSP}={NBSP}{text}"


_SMALLER = {"N": ((1e3, "mN"), (1e6, "µN")), "mm": ((1e3, "µm"), (1e6, "nm")), "kV": ((1e3, "V"), (1e6, "mV"))}


def time_unit(longest_s: float) -> tuple[float, str]:
    """Factor from seconds and unit in which times up to `longest_s` are read: s, h or d."""
    if longest_s < 2e4:
        return 1.0, "s"
    return (1 / 3600, "h") if longest_s < 1e8 else (1 / 86400, "d")


def scaled(unit: str, largest: float) -> tuple[float, str]:
    """Factor and unit in which `largest` reads as 1 or more, where the unit has smaller ones."""
    chosen = (1.0, unit)
    for factor, smaller in _SMALLER.get(unit, ()):
        if largest * chosen[0] < 1:
            chosen = (factor, smaller)
    return chosen


def percent(share: float | None, digits: int = 2) -> str:
    """A share as percent to so many digits, whole percents from 10 on; what is not all of it is never 100 %."""
    if share is None or not math.isfinite(share):
        return ABSENT
    value = 100 * share
    if 99.995 <= value < 100:
        text = f">{NBSP}99.99"
    elif 99.5 <= value < 99.995:
        text = fixed(value, 1) if value < 99.95 else fixed(value, 2)
    else:
        text = fixed(value, 0) if abs(value) >= 10 else significant(value, digits)
    return f"{text}{NBSP}%"


_NEARLY_ALL = 0.995
"""A share from which on a bound says more than its digits."""


_NINES = (0.9999, 0.999, 0.99)
"""What a share of nearly all is told to exceed: nobody acts on more digits."""


def removed(share: float | None, lower: float | None = None, upper: float | None = None) -> str:
    """`97 % (95 % interval 96 % to 98 %)`; of what is nearly all, what it surely exceeds: `more than 99.9 %`.

    Shares end at 1, where nothing but noise is left: there the lower limit alone says how much it is.
    """
    if share is None or not math.isfinite(share):
        return ABSENT
    known = sorted(e for e in (lower, upper) if e is not None and math.isfinite(e))
    least = share if lower is None or not math.isfinite(lower) else min(share, lower)
    exceeded = next((n for n in _NINES if least > n), None)
    if share >= 1 and not known:
        return "all but noise"
    if share >= _NEARLY_ALL and exceeded is not None:
        return f"more than {100 * exceeded:g}{NBSP}%"
    if share >= 1:
        return f"at least {percent(least)}"
    text = percent(share)
    if len(known) < 2:
        return text
    first, second = percent(known[0]), percent(known[1])
    if first == second:
        return f"{text} (95{NBSP}% interval within rounding)"
    return f"{text} (95{NBSP}% interval {first} to {second})"


def gained(share: float | None, lower: float | None = None) -> str:
    """As `removed`, without its interval, for a column of a table: `> 99.9 %`, `≥ 97 %`."""
    return removed(share, lower).replace("more than ", f">{NBSP}").replace("at least ", f"≥{NBSP}")


_SURELY = 1e-4
"""Probabilities nearer to 0 or 1 than this are a bound: they rest on approximations that hold no further."""


def probability(p: float | None) -> str:
    """A probability as percent: nothing is certain or impossible, `> 99.99 %` and `< 0.01 %` are as far as it goes."""
    if p is None or not math.isfinite(p):
        return ABSENT
    if p < _SURELY:
        return f"<{NBSP}{100 * _SURELY:g}{NBSP}%"
    return f">{NBSP}{100 * (1 - _SURELY):g}{NBSP}%" if p > 1 - _SURELY else percent(p)


def seconds(value: float | None) -> str:
    """A duration: seconds below two minutes, then minutes, then hours."""
    if value is None or not math.isfinite(value):
        return ABSENT
    if value < 120:
        return with_unit(significant(value, 3 if value >= 1 else 2), "s")
    if value < 7200:
        minutes, rest = divmod(round(value), 60)
        return f"{minutes}{NBSP}min" + (f"{NBSP}{rest:02d}{NBSP}s" if rest else "")
    return with_unit(significant(value / 3600), "h")


def word(count: int) -> str:
    """A count as a word up to twelve."""
    return _WORDS[count] if 0 <= count < len(_WORDS) else whole(count)


def counted(count: int, singular: str, plural: str | None = None) -> str:
    """`one recording`, `12 recordings`: digits above twelve, words below."""
    return f"{word(count)}{NBSP}{singular if count == 1 else plural or singular + 's'}"


def digits(count: int, singular: str, plural: str | None = None) -> str:
    """`1 recording`, `12 recordings`."""
    return f"{whole(count)}{NBSP}{singular if count == 1 else plural or singular + 's'}"


def among(count: int, total: int, singular: str, plural: str | None = None) -> str:
    """`3 of 12 recordings`, `all 12 recordings`, `the one recording`: so many of what there is."""
    if total == 1 and count:
        return f"the one {singular}"
    return (
        f"all {digits(total, singular, plural)}"
        if count == total
        else f"{whole(count)} of {digits(total, singular, plural)}"
    )


def every(count: int, singular: str, plural: str | None = None) -> str:
    """`All 12 recordings`, `The one recording`: as a heading."""
    return capital(among(count, count, singular, plural))


def ordinal(number: int) -> str:
    """`third`."""
    return _ORDINALS[number] if 0 <= number < len(_ORDINALS) else f"{number}th"


def joined(parts: Sequence[str]) -> str:
    """`a, b and c`."""
    if len(parts) < 2:
        return "".join(parts)
    return ", ".join(parts[:-1]) + " and " + parts[-1]


_NOT_A_WORD = re.compile(r"[^\W\d_]+(?:[\d_₀-₉]|(?<=[a-zµ])[A-Z])")
"""How symbols, units and ids begin: `k3`, `drive_lag`, `kV`."""


def capital(text: str) -> str:
    """The text with its first letter large; a symbol, a unit or an id keeps its own."""
    return text if _NOT_A_WORD.match(text) else text[:1].upper() + text[1:]


def symbols(text: str) -> str:
    """`k₃` for `k3`, `τ₁` for `tau1`, in sentences that were stored without typography, and true minus signs."""
    text = re.sub(r"\btau(\d)\b", r"τ\1", text)
    text = re.sub(r"\b([kcτ])(\d)\b", lambda m: m[1] + chr(ord("₀") + int(m[2])), text)
    return true_minus(text)


def true_minus(text: str) -> str:
    """The text with a true minus sign before numbers; hyphens of names and dates stay."""
    return re.sub(r"(?<![\w.)\]-])-(?=\d)", MINUS, text)
