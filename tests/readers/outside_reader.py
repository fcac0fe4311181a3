"""A reader as another package would bring it: the logger files `.ldat`, a JSON head in the first line and doubles after it.

Uses of dealab only what `ingest/README.md` names for readers.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ingest.columns import Numbers, OwnTime, named_column
from ingest.mapping import FileMapping
from ingest.mapping_keys import Key
from schemas.errors import RefusedError


@dataclass(frozen=True)
class LoggerFile:
    """Channels of a logger file."""

    where: str
    heads: tuple[Mapping[str, Any], ...]
    values: np.ndarray
    problems: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def names(self) -> tuple[str, ...]:
        return tuple(str(head["name"]) for head in self.heads)

    def numbers(self, column: str | int, index: int | None = None) -> Numbers:
        values = self.values[:, named_column(self.names(), column, self.where)]
        return Numbers(values, np.zeros(values.size, dtype=bool))

    def cells(self, column: str | int, index: int | None = None) -> Sequence[Any]:
        return list(self.numbers(column, index).values)

    def unit(self, column: str | int) -> str | None:
        return self.heads[named_column(self.names(), column, self.where)].get("unit")

    def own_time(self, column: str | int) -> OwnTime | None:
        return None

    def own_frequency(self, column: str | int) -> None:
        return None


class LoggerReader:
    """What stands under the entry point."""

    suffixes = (".ldat",)
    options: Mapping[str, Key] = {"skip_samples": Key((int,), "samples at the beginning that are left out")}

    def read(self, path: Path, mapping: FileMapping) -> LoggerFile:
        head, _, data = path.read_bytes().partition(b"\n")
        try:
            heads = tuple(json.loads(head)["channels"])
            values = np.frombuffer(data, "<f8").reshape(-1, len(heads))[int(mapping.options.get("skip_samples", 0)) :]
            names = [str(one["name"]) for one in heads]
        except (ValueError, KeyError, TypeError) as error:
            raise RefusedError(
                f"no logger file: {error}", where=path.name, expected="a head and whole samples"
            ) from None
        if not names:
            raise RefusedError("there are no channels", where=path.name, expected="channels")
        return LoggerFile(path.name, heads, values)


READER = LoggerReader()


def write(path: Path, columns: Mapping[str, tuple[str, Sequence[float]]]) -> Path:
    """A file with these channels: name → unit and values."""
    heads = [{"name": name, "unit": unit} for name, (unit, _) in columns.items()]
    values = np.column_stack([values for _, values in columns.values()])
    path.write_bytes(json.dumps({"channels": heads}).encode() + b"\n" + values.astype("<f8").tobytes())
    return path
