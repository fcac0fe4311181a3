"""The name that a mistyped one was probably meant to be, for messages.

Where a name is refused the message asks; where a key is only asked about, `schemas.metadata.near_miss` is stricter.
"""

from __future__ import annotations

from collections.abc import Iterable

_LIKENESS = 0.72
"""Likeness (`difflib`) from which a name is asked about: two letters swapped in four, one wrong in five."""
_SHORT = 2
"""Letters of names that are asked about where only capitals differ: of so few letters many names are alike."""


def find_alike(given: str, known: Iterable[str]) -> str | None:
    """The one of the known names that is most like the given one, capitals or not; None where none is."""
    import difflib

    by_letters: dict[str, str] = {}
    for name in known:
        by_letters.setdefault(name.casefold(), name)
    letters = given.strip()[:80].casefold()
    if letters in by_letters:
        return by_letters[letters]
    if len(letters) <= _SHORT:
        return None
    found = difflib.get_close_matches(letters, list(by_letters), n=1, cutoff=_LIKENESS)
    return by_letters[found[0]] if found else None


def ask_meant(given: str, known: Iterable[str]) -> str:
    """`: did you mean …?` to put behind what is wrong, or nothing."""
    alike = find_alike(given, known)
    return "" if alike is None else f": did you mean {alike}?"
