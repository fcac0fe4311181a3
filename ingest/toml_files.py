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

from schemas.errors import RefusedError

_SIZE_LIMIT = 1 << 20
"""Largest mapping file that is read, bytes."""


def content_hash(content: Mapping[str, Any]) -> str:
    """SHA-256 of TOML content, independent of the order of its keys."""
    text = json.dumps(content, sort_keys=True, default=lambda v: f"{type(v).__name__}:{v}")
    return hashlib.sha256(text.encode()).hexdigest()


def load_toml(path: Path) -> dict[str, Any]:
    """Content of a TOML file (UTF-8, with or without a byte-order mark). `RefusedError` when it is not TOML."""
    try:
        if path.stat().st_size > _SIZE_LIMIT:
            raise _refused(path.name, f"the file has {path.stat().st_size} bytes", f"at most {_SIZE_LIMIT}")
        return tomllib.loads(path.read_bytes().decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        raise _refused(path.name, f"byte {error.start} is not UTF-8", "a TOML file in UTF-8") from None
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise _refused(path.name, f"not valid TOML: {error}", "a TOML file") from None
    except OSError as error:
        raise _refused(path.name, f"cannot be read: {error.strerror}", "a TOML file") from None


def _refused(source: str, problem: str, expected: str) -> RefusedError:
    return RefusedError(problem, where=source, expected=expected, remedy="Correct the TOML file")
