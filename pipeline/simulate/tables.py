"""Strict reading of campaign tables: which keys there are, what they may hold, and errors that say so.

A class of a campaign declares its keys as dataclass fields made by `number`, `whole`, `text`, … of this module; `parse`
fills it from a TOML table. A key that is unknown, missing or out of range raises `UsageError` with the place, the value
and what was expected. What the keys mean belongs to the classes.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from dataclasses import field
from typing import Any, TypeVar

from schemas.alike import find_alike
from schemas.errors import UsageError

T = TypeVar("T")
REQUIRED: Any = object()
"""Default of a key that has none."""


def number(
    default: Any = REQUIRED, *, above: float | None = None, at_least: float | None = None, at_most: float | None = None
) -> Any:
    """A finite number within limits."""
    return _field(lambda value: _number(value, above, at_least, at_most), default)


def whole(default: Any = REQUIRED, *, at_least: int = 1) -> Any:
    """A whole number of at least `at_least`."""

    def check(value: Any) -> int:
        if isinstance(value, bool) or not isinstance(value, int) or value < at_least:
            raise ValueError(f"a whole number of at least {at_least}")
        return value

    return _field(check, default)


def text(default: Any = REQUIRED) -> Any:
    """Text that is not empty."""

    def check(value: Any) -> str:
        if not isinstance(value, str) or not value.strip():
            raise ValueError("text that is not empty")
        return value

    return _field(check, default)


def choice(*allowed: str, default: Any = REQUIRED) -> Any:
    """One of a few words."""

    def check(value: Any) -> str:
        if value not in allowed:
            raise ValueError("one of " + ", ".join(allowed))
        return str(value)

    return _field(check, default)


def flag(default: Any = REQUIRED) -> Any:
    """true or false."""

    def check(value: Any) -> bool:
        if not isinstance(value, bool):
            raise ValueError("true or false")
        return value

    return _field(check, default)


def numbers(default: Any = REQUIRED, *, above: float | None = None, at_least: float | None = None) -> Any:
    """A list of finite numbers, not empty."""

    def check(value: Any) -> tuple[float, ...]:
        if not isinstance(value, list | tuple) or not value:
            raise ValueError("a list of numbers")
        return tuple(_number(v, above, at_least, None) for v in value)

    return _field(check, default)


def counts(*allowed: str, default: Any = REQUIRED) -> Any:
    """A table of whole numbers under some of the allowed words."""

    def check(value: Any) -> dict[str, int]:
        good = isinstance(value, Mapping) and all(
            k in allowed and isinstance(v, int) and not isinstance(v, bool) and v >= 0 for k, v in value.items()
        )
        if not good:
            raise ValueError("a table of counts, with the keys " + ", ".join(allowed))
        return dict(value)

    return _field(check, default)


def _field(check: Callable[[Any], Any], default: Any) -> Any:
    if default is REQUIRED:
        return field(metadata={"check": check})
    return field(default=default, metadata={"check": check})


def _number(value: Any, above: float | None, at_least: float | None, at_most: float | None) -> float:
    limits = [
        f"{word} {limit:g}"
        for word, limit in (("above", above), ("of at least", at_least), ("of at most", at_most))
        if limit is not None
    ]
    good = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    good = good and (above is None or value > above)
    good = good and (at_least is None or value >= at_least) and (at_most is None or value <= at_most)
    if not good:
        raise ValueError(" ".join(["a number", " and ".join(limits)]).strip())
    return float(value)


def parse(kind: type[T], table: Mapping[str, Any], where: str) -> T:
    """An instance of the dataclass `kind` from a TOML table.

    Raises `UsageError` for keys that are unknown or missing and for values that do not fit; a `ValueError` of the class'
    own `__post_init__` becomes one too.
    """
    checks = {f.name: f for f in dataclasses.fields(kind) if "check" in f.metadata}  # type: ignore[arg-type]
    known_only(table, checks, where)
    values: dict[str, Any] = {}
    for name, entry in checks.items():
        if name in table:
            try:
                values[name] = entry.metadata["check"](table[name])
            except ValueError as error:
                raise UsageError(f"{name} is {shown(table[name])}", where=where, expected=str(error)) from None
        elif entry.default is dataclasses.MISSING:
            raise UsageError(f"{name} is missing", where=where, expected="keys " + ", ".join(checks))
    try:
        return kind(**values)
    except ValueError as error:
        raise UsageError(str(error), where=where) from None


def known_only(table: Mapping[str, Any], known: Mapping[str, Any] | tuple[str, ...], where: str) -> None:
    """Raises `UsageError` for the first key that is not among the known ones, with the nearest that is."""
    for key in table:
        if key not in known:
            near = find_alike(key, known)
            raise UsageError(
                f'"{key}" is not a key here',
                where=where,
                expected=f'"{near}"?' if near else "one of " + ", ".join(known),
            )


def subtable(table: Mapping[str, Any], key: str, where: str) -> Mapping[str, Any]:
    """The table under a key; an empty one where the key is absent."""
    value = table.get(key, {})
    if not isinstance(value, Mapping):
        raise UsageError(f"{key} is {shown(value)}", where=where, expected=f"a table, [{key}]")
    return value


def subtables(table: Mapping[str, Any], key: str, where: str) -> list[Mapping[str, Any]]:
    """The array of tables under a key; an empty one where the key is absent."""
    value = table.get(key, [])
    if not isinstance(value, list) or not all(isinstance(v, Mapping) for v in value):
        raise UsageError(f"{key} is {shown(value)}", where=where, expected=f"tables, [[{key}]]")
    return value


def shown(value: Any) -> str:
    """A value as an error message quotes it: short."""
    written = repr(value)
    return written if len(written) <= 60 else written[:57] + "..."
