"""File names from names that anybody may have typed into a rig, and text from them that is safe to show.

Specimens and campaigns are free text: path separators, quotes, markup, 10 000 characters. A file name keeps what is
harmless and gets a hash where anything was lost, so that two names never share a file. HTML is escaped by the templates;
what is done here is only what escaping cannot do.
"""

from __future__ import annotations

import hashlib
import re
import unicodedata
from collections import Counter
from collections.abc import Iterable

_HARMLESS = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]*(\.[A-Za-z0-9_-]+)*")
_RESERVED = {"con", "prn", "aux", "nul", *(f"{d}{i}" for d in ("com", "lpt") for i in range(10))}
_LONGEST = 60


class FileNames:
    """File names (without ending) for a set of names, none of them equal on a file system that ignores case.

    A harmless name is its own file name. Any other is what is left of it and eight digits of its SHA-256.
    """

    def __init__(self, names: Iterable[str]) -> None:
        self.crowded = {name for name, n in Counter(n.casefold() for n in set(names)).items() if n > 1}

    def __call__(self, name: str) -> str:
        if self._harmless(name):
            return name
        kept = re.sub(r"[^A-Za-z0-9]+", "-", unicodedata.normalize("NFKD", name)).strip("-")[:40].strip("-")
        digest = hashlib.sha256(name.encode("utf-8", "surrogatepass")).hexdigest()[:8]
        return f"{kept or 'name'}-{digest}"

    def _harmless(self, name: str) -> bool:
        return (
            len(name) <= _LONGEST
            and _HARMLESS.fullmatch(name) is not None
            and name.split(".")[0].casefold() not in _RESERVED
            and name.casefold() not in self.crowded
        )


class Verbatim(str):
    """Text that is shown as it was typed: SQL and settings."""

    __slots__ = ()


def visible(text: str) -> str:
    """The text with control and direction-changing characters spelt out (`\\u202e`): they would act on the page around."""
    return "".join(c if seen(c) else f"\\u{ord(c):04x}" for c in text)


def seen(character: str) -> bool:
    """The character shows itself and nothing else: no control, no change of direction, no half of a pair."""
    return character in "\n\t" or unicodedata.category(character) not in ("Cc", "Cf", "Cs", "Zl", "Zp")


def short(text: str, limit: int = 48) -> str:
    """The text on one line, visible, and cut with an ellipsis beyond `limit` characters."""
    line = " ".join(visible(text).split())
    return line if len(line) <= limit else line[: limit - 1].rstrip() + "…"
