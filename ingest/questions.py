"""What a file without a mapping does not say and somebody has to answer; how a column is told in a mapping and in a question."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ingest.mapping_keys import RECORDING
from ingest.meanings import GuessedColumn
from ingest.parts import content_of_part, name_parts
from schemas.errors import RefusedError
from schemas.protocols import Lack, find_lacking
from schemas.quantities import QUANTITIES
from schemas.units import ANY, conversion


@dataclass(frozen=True)
class Question:
    """Something that the file does not say.

    Parameters
    ----------
    key : where the answer belongs in the mapping, `recording.specimen_id`
    text : what is asked
    suggestion : the answer that is taken when none is given; None where one has to be given
    choices : the only answers there are; empty for any
    """

    key: str
    text: str
    suggestion: Any = None
    choices: tuple[str, ...] = ()


_STRAIN = r"strain|dehnung|déformation|deformacion|应变"
"""Names of columns that count from 0 where a stretch is 1."""


def label_column(column: GuessedColumn) -> str:
    """A column's name in small letters without what stands in brackets."""
    return re.sub(r"\s*[\[(/].*$", "", column.name or str(column.column)).strip().lower()


def make_place(column: GuessedColumn) -> dict[str, Any]:
    place: dict[str, Any] = {"column": column.column}
    return place if column.index is None else place | {"index": column.index}


def make_unit_keys(column: GuessedColumn, questions: list[Question]) -> dict[str, Any]:
    """The unit of a channel, and the scale of a sensor that is recorded in volts."""
    name, label = str(column.meaning), f"columns.{column.meaning}"
    usual = "V" if QUANTITIES[name].unit == ANY else QUANTITIES[name].unit
    if column.is_asked:
        questions.append(Question(f"{label}.column", f"which column is the {name}", column.column))
    if column.is_raw:
        unit = column.unit or "V"
        text = f"how many {usual} are 1 {unit} of {column.column} (value in {usual} = scale × value in {unit} + offset)"
        questions.append(Question(f"{label}.scale", text))
        of_monitor = {"overrule_unit": True} if column.unit and is_unit_of(column.unit, usual) else {}
        return {"unit": usual, "scale": None} | of_monitor
    if column.unit is None:
        questions.append(ask_unit(label, column, usual))
        usual = str(questions[-1].suggestion)
    if name == "stretch" and re.search(_STRAIN, label_column(column)):
        return {"unit": column.unit or usual, "offset": unstretched(column.unit or usual)}
    return {"unit": column.unit or usual}


def is_unit_of(unit: str, canonical: str) -> bool:
    """Whether a unit converts to another: volts of a monitor are none of the kilovolts that they stand for."""
    try:
        conversion(unit, canonical)
    except RefusedError:
        return False
    return True


def unstretched(unit: str) -> float:
    """A stretch of 1 in a unit, which strains count from: 100 in %, 1e6 in µε; 1 where the unit is none."""
    try:
        return float(f"{1 / conversion(unit, QUANTITIES['stretch'].unit).scale:.12g}")
    except RefusedError:
        return 1.0


def list_lacks(content: Mapping[str, Any]) -> list[tuple[Lack, ...]]:
    """What a mapping does not say that would give more results: of its recording, or of each part that it names; of no table."""
    if content["kind"] != RECORDING:
        return []
    parts: list[Mapping[str, Any]] = [content_of_part(content, name) for name in name_parts(content)]
    rig = {"rig_id"} if content.get("rig") else set()
    return [
        find_lacking(
            {*part["recording"], *rig}, part["columns"], part["recording"]["protocol"], part["recording"]["loading"]
        )
        for part in parts or [content]
    ]


_WEIGHTS: Mapping[str, str] = {"g": "gf", "kg": "kgf"}
"""Masses that machines show for the force of their weight."""


def ask_unit(label: str, column: GuessedColumn, usual: str) -> Question:
    """What unit a column has: the usual one where the file says none, the weight of a mass where it says that of a force."""
    weight = _WEIGHTS.get(column.written_unit) if usual == QUANTITIES["force"].unit else None
    if weight is not None:
        text = (
            f'unit of {name_column(column)}: the file says "{column.written_unit}", as of a mass; its weight is meant?'
        )
        return Question(f"{label}.unit", text, weight)
    return Question(f"{label}.unit", f"unit of {name_column(column)}: the file does not say", usual)


def name_column(column: GuessedColumn) -> str:
    """A column as a person finds it: by the name that the file has for it, beside its number where a mapping knows it by that."""
    if isinstance(column.column, str):
        return f'"{column.column}"'
    return f'{column.column} ("{column.name}")' if column.name else str(column.column)
