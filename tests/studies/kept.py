"""Judgements kept while a study runs: one that was interrupted goes on where it stopped, on the same code alone.

A line of JSON per judgement, with the study's seed and a digest of the code that made it. What other code judged is no part of
a study: its lines are ignored, and gone once a study with new code begins.
"""

from __future__ import annotations

import ast
import hashlib
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from tests.hidden_effects.judging import Case, Judgement

_JUDGING = ("pipeline", "schemas", "ingest", "tests.hidden_effects")
_DIGITS = 5


def digest() -> str:
    """Of the code that makes and judges sessions, without comments and layout."""
    names = sorted(name for name in sys.modules if name.startswith(_JUDGING))
    found = hashlib.sha256()
    for name in names:
        path = getattr(sys.modules[name], "__file__", None)
        if path is not None:
            found.update(name.encode())
            found.update(ast.dump(ast.parse(Path(path).read_text(encoding="utf-8"))).encode())
    return found.hexdigest()[:16]


@dataclass(frozen=True)
class Kept:
    """A file of judgements; None: nothing is kept. `code` is the digest that its lines must have."""

    path: Path | None
    code: str

    def _lines(self) -> Iterator[dict[str, Any]]:
        if self.path is None or not self.path.exists():
            return
        for line in self.path.read_text(encoding="utf-8").splitlines():
            try:
                found = json.loads(line)
            except json.JSONDecodeError:  # the study was stopped as it wrote
                continue
            if found["code"] == self.code:
                yield found

    def seed(self) -> int | None:
        """Of the study that was begun."""
        return next((int(line["seed"]) for line in self._lines()), None)

    def judgements(self, seed: int) -> dict[Case, tuple[Judgement, ...]]:
        """What was judged in the study of this seed, by the case that was asked for."""
        found: dict[Case, tuple[Judgement, ...]] = {}
        for line in self._lines():
            if line["seed"] == seed:
                found[_case(line["asked"])] = tuple(_judgement(j) for j in line["found"])
        return found

    def refused(self, seed: int) -> list[str]:
        """Why sessions of the study could not be judged."""
        return [line["refused"] for line in self._lines() if line["seed"] == seed and "refused" in line]

    def begin(self) -> None:
        """Leaves lines of this code alone."""
        if self.path is not None:
            lines = [json.dumps(line) + "\n" for line in self._lines()]
            self.path.write_text("".join(lines), encoding="utf-8")

    def add(self, seed: int, asked: Case, found: Sequence[Judgement]) -> None:
        self._append(seed, asked, found, {})

    def refuse(self, seed: int, asked: Case, why: str) -> None:
        """Of a case whose session could not be read."""
        self._append(seed, asked, (), {"refused": why})

    def _append(self, seed: int, asked: Case, found: Sequence[Judgement], more: dict[str, str]) -> None:
        if self.path is None:
            return
        judged = [{name: _short(value) for name, value in asdict(j).items()} for j in found]
        line = {"code": self.code, "seed": seed, "asked": asdict(asked), "found": judged, **more}
        with self.path.open("a", encoding="utf-8") as out:
            out.write(json.dumps(line) + "\n")


def _short(value: Any) -> Any:
    return float(f"{value:.{_DIGITS}g}") if isinstance(value, float) else value


def _case(found: dict[str, Any]) -> Case:
    return Case(**{**found, "effects": tuple((str(id), float(multiple)) for id, multiple in found["effects"])})


def _judgement(found: dict[str, Any]) -> Judgement:
    lists = {name: tuple(value) for name, value in found.items() if isinstance(value, list)}
    return Judgement(**{**found, **lists, "case": _case(found["case"])})
