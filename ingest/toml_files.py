"""TOML files beside the data: reading them safely, and a hash of what they say.

Does not belong here: what their keys mean (`ingest.mapping`, `ingest.rigs`).
"""

from __future__ import annotations

import hashlib
import json
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ingest.plain_files import read_plain
from schemas.errors import AccidentError, RefusedError

_SIZE_LIMIT = 1 << 20
"""Largest mapping file that is read, bytes."""
_DEPTH = 16
_LARGEST = 10**300


def content_hash(content: Mapping[str, Any]) -> str:
    """SHA-256 of TOML content, independent of the order of its keys."""
    text = json.dumps(content, sort_keys=True, default=lambda v: f"{type(v).__name__}:{v}")
    return hashlib.sha256(text.encode()).hexdigest()


def load_toml(path: Path) -> dict[str, Any]:
    """Content of a TOML file (UTF-8, with or without a byte-order mark).

    Raises
    ------
    RefusedError : it is not TOML
    AccidentError : it cannot be read now
    """
    try:
        text = read_plain(path, _SIZE_LIMIT)
        if len(text) > _SIZE_LIMIT:
            raise _refused(path.name, f"the file has more than {_SIZE_LIMIT} bytes", f"at most {_SIZE_LIMIT}")
        content = tomllib.loads(text.decode("utf-8-sig"))
        _check_sizes(content, path.name)
        return content
    except UnicodeDecodeError as error:
        raise _refused(path.name, f"byte {error.start} is not UTF-8", "a TOML file in UTF-8") from None
    except (ValueError, RecursionError) as error:  # of ValueErrors, one is that of a whole number with too many digits
        raise _refused(path.name, f"not valid TOML: {error}", "a TOML file") from None
    except OSError as error:
        raise AccidentError(
            f"cannot be read: {error.strerror or error}", where=path.name, remedy="Give this user the right to read it"
        ) from None


def _check_sizes(content: Any, name: str) -> None:
    """Refuses tables in tables without end, and whole numbers that no double holds."""
    waiting = [(content, 0)]
    while waiting:
        value, depth = waiting.pop()
        if depth > _DEPTH:
            raise _refused(name, f"tables are nested more than {_DEPTH} deep", "the tables of a mapping")
        if isinstance(value, dict | list):
            waiting += [(v, depth + 1) for v in (value.values() if isinstance(value, dict) else value)]
        elif isinstance(value, int) and abs(value) > _LARGEST:
            raise _refused(name, f"a number has {value.bit_length()} bits", "numbers below 1e300")


def _refused(source: str, problem: str, expected: str) -> RefusedError:
    return RefusedError(problem, where=source, expected=expected, remedy="Correct the TOML file")
