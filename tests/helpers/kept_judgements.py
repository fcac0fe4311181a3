"""Judgements kept while a study runs: one that was interrupted goes on where it stopped, on the same code alone.

A line of JSON per judgement, with the study's seed and digests of the code that made it. What other code judged is no part of
a study: its lines are ignored, and gone once a study with new code begins. What proposes recordings is asked of ambiguous
verdicts alone: with other code for that, all other judgements stand.
"""

from __future__ import annotations

import ast
import hashlib
import json
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from pipeline.diagnose.results import AMBIGUOUS
from tests.helpers.judging import Case, Judgement

_JUDGING = (
    "pipeline.diagnose", "pipeline.fit", "pipeline.simulate", "pipeline.transform", "schemas", "ingest",
    "tests.helpers.judging", "tests.helpers.truth_rig",
)  # fmt: skip
"""The science, and what it is made of; not the nightly, which `import pipeline` brings along."""
_PROPOSING = tuple(
    f"pipeline.diagnose.proposals.{name}" for name in ("designs", "imagined", "next_recording", "proving")
)
_DIGITS = 5


@dataclass(frozen=True)
class Code:
    """Digests of code: `judging` makes and judges sessions, `proposing` says which recording an ambiguous verdict asks for."""

    judging: str
    proposing: str


def digest() -> Code:
    """Of the code that is loaded, without comments and layout."""
    names = sorted(name for name in sys.modules if name.startswith(_JUDGING))
    return Code(_digest(n for n in names if n not in _PROPOSING), _digest(n for n in names if n in _PROPOSING))


def _digest(names: Iterable[str]) -> str:
    found = hashlib.sha256()
    for name in names:
        path = getattr(sys.modules[name], "__file__", None)
        if path is not None:
            found.update(name.encode())
            found.update(ast.dump(ast.parse(Path(path).read_text(encoding="utf-8"))).encode())
    return found.hexdigest()[:16]


@dataclass(frozen=True)
class Kept:
    """A file of judgements; None: nothing is kept. `code` is what its lines must have been made by."""

    path: Path | None
    code: Code

    def _lines(self) -> Iterator[dict[str, Any]]:
        if self.path is None or not self.path.exists():
            return
        for line in self.path.read_text(encoding="utf-8").splitlines():
            try:
                found = json.loads(line)
            except json.JSONDecodeError:  # the study was stopped as it wrote
                continue
            if self._stands(found):
                yield found

    def _stands(self, line: dict[str, Any]) -> bool:
        if line["code"] != self.code.judging:
            return False
        proposed = any(judgement["verdict"] == AMBIGUOUS for judgement in line["found"])
        return not proposed or line["proposing"] == self.code.proposing

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
        code = {"code": self.code.judging, "proposing": self.code.proposing}
        line = {**code, "seed": seed, "asked": asdict(asked), "found": judged, **more}
        with self.path.open("a", encoding="utf-8") as out:
            out.write(json.dumps(line) + "\n")


def sessions_of(path: Path) -> list[Judgement]:
    """All judgements of a log, whatever code made them: for what needs sessions in which it is known what is hidden."""
    lines = (json.loads(line) for line in path.read_text(encoding="utf-8").splitlines())
    return [_judgement(j) for line in lines for j in line["found"]]


def _short(value: Any) -> Any:
    return float(f"{value:.{_DIGITS}g}") if isinstance(value, float) else value


def _case(found: dict[str, Any]) -> Case:
    return Case(**{**found, "effects": tuple((str(id), float(multiple)) for id, multiple in found["effects"])})


def _judgement(found: dict[str, Any]) -> Judgement:
    lists = {name: tuple(value) for name, value in found.items() if isinstance(value, list)}
    return Judgement(**{**found, **lists, "case": _case(found["case"])})
