"""How a text file is written: delimiter, marks, encoding, and its content as UTF-8 under it."""

from __future__ import annotations

import codecs
import csv
import functools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from schemas.errors import RefusedError

WHITESPACE = "whitespace"
UNREADABLE = "\ufffd"
"""Stands for bytes that are not of the encoding."""
_WRONG_BYTES = 0.01
"""Largest share of unreadable places that may be damage; beyond it the encoding is another one."""

# A field may be as long as its file: Python raises an error of its own from 131 072 characters on.
csv.field_size_limit(2**31 - 1)


@dataclass(frozen=True)
class Dialect:
    """How a text file is written. `delimiter` one character or "whitespace" (runs of blanks and tabs)."""

    delimiter: str = ","
    decimal: str = "."
    thousands: str = ""
    encoding: str = "utf-8"
    skip_rows: int = 0
    header: bool = True
    unit_row: bool = False
    quote: str = '"'
    comment: str = ""
    missing: tuple[str, ...] = ()
    final_newline: bool = True

    @classmethod
    def parse(cls, options: Mapping[str, Any], *, suffix: str = "", where: str = "") -> Dialect:
        """The dialect from the `[csv]` table of a mapping. Raises `RefusedError` for values that cannot be."""
        keys: dict[str, Any] = {"delimiter": "\t"} if suffix == ".tsv" else {}
        keys |= {k: tuple(map(str, v)) if k == "missing" else v for k, v in options.items()}
        dialect = cls(**keys)
        one = "one character" + (f', or "{WHITESPACE}"' if dialect.delimiter != WHITESPACE else "")
        checks = (
            ("delimiter", dialect.delimiter == WHITESPACE or _is_ascii_character(dialect.delimiter), one),
            ("decimal", dialect.decimal in (".", ","), '"." or ","'),
            ("decimal", dialect.decimal != dialect.delimiter, "another character than the delimiter"),
            ("thousands", len(dialect.thousands) <= 1, "one character, or empty for none"),
            ("thousands", dialect.thousands not in (dialect.decimal, "-", "+"), "another character than decimal"),
            ("encoding", _is_encoding(dialect.encoding), "an encoding such as utf-8, cp1252, gbk or utf-16"),
            ("skip_rows", dialect.skip_rows >= 0, "a number from 0"),
            ("quote", dialect.quote == "" or _is_ascii_character(dialect.quote), "one character, or empty for none"),
        )
        for key, right, expected in checks:
            if not right:
                value = str(getattr(dialect, key))[:40]
                raise RefusedError(
                    f'csv.{key} is "{value}"', where=where, expected=expected, remedy="Correct the mapping TOML"
                )
        return dialect

    @property
    def separator(self) -> str:
        """The delimiter after runs of blanks have become one tab."""
        return "\t" if self.delimiter == WHITESPACE else self.delimiter

    def fields(self, line: str) -> list[str]:
        """The fields of one line."""
        if not self.quote:
            return line.split(self.separator)
        rows = csv.reader(
            [line], delimiter=self.separator, quotechar=self.quote, skipinitialspace=self.separator != " "
        )
        return next(rows, [])


def as_utf8(content: bytes, dialect: Dialect, where: str) -> tuple[bytes, list[str]]:
    """The content as UTF-8 without byte-order mark, and a note where some of it is unreadable.

    A few unreadable bytes are damage that the cells around them show; many mean that the encoding is another one.
    """
    if not content.strip(b"\x00 \t\r\n"):
        raise RefusedError("the file is empty", where=where, expected="rows of data")
    codec = codecs.lookup(dialect.encoding).name
    content = content.replace(b"\r\r\n", b"\r\n")  # written in text mode twice: each line ends once
    wide = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    if wide and not codec.startswith(("utf-16", "utf-32")):
        raise RefusedError(
            "the file begins with the byte-order mark of UTF-16",
            where=where,
            expected=f"text in {dialect.encoding}, as the mapping says",
            remedy='Set encoding = "utf-16" in the mapping TOML',
        )
    try:
        text = content.decode(codec)
    except UnicodeDecodeError:
        text = content.decode(codec, "replace")
        wrong = text.count(UNREADABLE)
        if wrong > max(1, _WRONG_BYTES * len(text)):
            raise wrong_encoding(f"{wrong} places in the text are", dialect, where) from None
        note = f'{wrong} places in the text are not {dialect.encoding}: read as "{UNREADABLE}"'
        return text.removeprefix("\ufeff").encode(), [note]
    if codec in ("utf-8", "utf-8-sig", "ascii"):
        return content.removeprefix(codecs.BOM_UTF8), []
    return text.removeprefix("\ufeff").encode("utf-8", "replace"), []


def wrong_encoding(place: str, dialect: Dialect, where: str) -> RefusedError:
    return RefusedError(
        f"{place} not {dialect.encoding}",
        where=where,
        expected=f"text in {dialect.encoding}, as the mapping says",
        remedy="Set encoding in the mapping TOML: cp1252 for western Windows, gbk for Chinese, utf-16",
    )


def _is_ascii_character(text: str) -> bool:
    return len(text) == 1 and text.isascii() and text not in "\r\n"


@functools.cache
def _is_encoding(name: str) -> bool:
    try:
        return bool(codecs.lookup(name)._is_text_encoding)
    except LookupError:
        return False
