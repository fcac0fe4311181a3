"""Text of others for a terminal or a message: what could control it is made visible. Imports nothing of ours."""

from __future__ import annotations

import shlex

_SPACES = {0x00A0: " ", 0x2009: " ", 0x202F: " "}


def shown(value: object) -> str:
    """A path or text for messages: control and direction marks, and bytes that are no UTF-8, as escapes; spaces are spaces."""
    text = str(value).encode("utf-8", "backslashreplace").decode().translate(_SPACES)
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def make_safe(text: str) -> str:
    """Text of several lines for a terminal, without anything that could control it."""
    return "\n".join(shown(line) for line in text.split("\n"))


def quote_path(path: str) -> str:
    """A path as a shell takes it, and no command for an option: one that begins with a dash is `./-…`."""
    return shlex.quote(f"./{path}" if path.startswith("-") else path)
