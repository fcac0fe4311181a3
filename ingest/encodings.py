"""In which encoding a text file seems to be written. A guess for drafts alone: readers take what the mapping says."""

from __future__ import annotations

import codecs
import re

from ingest.meanings import guess_meaning

_LOOKED_AT = 1 << 18
"""Bytes of a file that are looked at."""
_LINES = 200
WESTERN = "cp1252"
_OF_PAIRS = ("gb18030", "cp932", "cp949", "big5")
"""Encodings in which a letter takes two bytes: Chinese, Japanese, Korean, Chinese of Taiwan."""
_NAMED_ALIKE = {"gb18030": "gbk"}
_RUN = re.compile(rb"[\x80-\xff]+")
_WORD = re.compile(r"[^\W\d_]+")


def guess_encoding(content: bytes) -> str:
    """By the byte-order mark, else UTF-8 where it decodes, else as the letters beyond ASCII stand.

    Western text has them one by one between others (`Prüfzeit`, `µm`). Where they come in pairs, charset-normalizer
    says in which of the encodings of pairs the text makes sense. A header of a few letters makes sense in several: the
    one in which words that we know occur is taken.
    """
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    if content.startswith(codecs.BOM_UTF8):
        return "utf-8-sig"
    start = content[:_LOOKED_AT]
    try:
        codecs.getincrementaldecoder("utf-8")().decode(start)
        return "utf-8"
    except UnicodeDecodeError:
        pass
    lines = [line for line in start.splitlines() if not line.isascii()][:_LINES]
    runs = [len(run) for line in lines for run in _RUN.findall(line)]
    if not runs or sum(length > 1 for length in runs) <= len(runs) / 2:
        return WESTERN
    return _of_pairs(b"\n".join(lines))


def _of_pairs(words: bytes) -> str:
    from charset_normalizer import from_bytes

    matches = list(from_bytes(words, cp_isolation=[*_OF_PAIRS, WESTERN]))
    if not matches:
        return WESTERN
    best = max(matches, key=lambda match: (_known_words(str(match)), -match.chaos, match.encoding in _OF_PAIRS))
    return _NAMED_ALIKE.get(best.encoding, best.encoding)


def _known_words(text: str) -> int:
    return sum(guess_meaning(word, "") is not None for word in _WORD.findall(text) if not word.isascii())
