"""Answers to the questions of a draft: where each belongs in the mapping, and the mapping with them in it."""

from __future__ import annotations

import copy
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from ingest.draft import Draft, make_draft
from ingest.formats import list_options
from ingest.mapping_keys import COLUMN, TABLE_COLUMN, TABLE_COLUMNS, TIME
from ingest.meanings import NOTHING
from ingest.meanings import TIME as TIMES
from ingest.questions import Question
from schemas.alike import ask_meant
from schemas.errors import UsageError
from schemas.metadata import RecordingMetadata, known_keys
from schemas.quantities import QUANTITIES

_INTEGER, _FLOAT = re.compile(r"[+-]?\d+"), re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_TEXTS = ("specimen_id", "recording_id", "operator", "configuration", "campaign", "material", "notes", "rig_id", "unit")
SIZES = "film_sizes_mm"
_SIZE_KEYS = ("film_length_mm", "film_width_mm", "film_thickness_mm")


def split_answers(given: list[str]) -> dict[str, str]:
    """`KEY=VALUE` texts as a mapping. Raises `UsageError` naming all that are none."""
    wrong = [text for text in given if "=" not in text.lstrip("=")]
    if wrong:
        raise UsageError(f"{', '.join(wrong)}: no answer", expected="KEY=VALUE, such as specimen_id=P-07")
    return {key.strip(): value.strip() for key, _, value in (text.partition("=") for text in given)}


def draft_with(path: Path, answers: Mapping[str, str]) -> tuple[Draft, dict[str, Any]]:
    """The draft with the meanings of columns that answers give, and the other answers by their full key.

    Parameters
    ----------
    path : the data file
    answers : values by column (`CH1`: a quantity, `time` or `nothing`), key (`specimen_id`, `force.unit`) or full key

    Raises
    ------
    UsageError : with all keys that do not exist, each with the one that may be meant
    """
    draft = make_draft(path)
    columns = {str(c) for c in _columns_of(draft)}
    said = {key: value for key, value in answers.items() if key in columns}
    wrong = [
        f'{key}={value}: no quantity{ask_meant(value, list(QUANTITIES))}'
        for key, value in said.items()
        if value not in (*QUANTITIES, NOTHING, TIMES)
    ]  # fmt: skip
    if said and not wrong:
        draft = make_draft(path, said)
    placed: dict[str, Any] = {}
    for key, value in answers.items():
        if key in said:
            continue
        if key == SIZES:
            sizes = re.split(r"\s*[x×,; ]\s*", value)
            placed |= {f"recording.{k}": read_value(s) for k, s in zip(_SIZE_KEYS, sizes, strict=False)}
            continue
        full = _full_key(key, draft)
        if full is None:
            known = [*known_keys(RecordingMetadata), *columns, *(q.key for q in draft.questions), "zone"]
            wrong.append(f'"{key}" is no key{ask_meant(key, known)}')
        else:
            placed[full] = value if full.rsplit(".", 1)[-1] in _TEXTS else read_value(value)
    if wrong:
        raise UsageError("; ".join(wrong), where=path.name, expected="columns of the file, or keys of the mapping")
    return draft, placed


def answered(draft: Draft, answers: Mapping[str, Any]) -> Draft:
    """The draft with answers in their places; what is answered is no question any more."""
    content: dict[str, Any] = copy.deepcopy(dict(draft.content))
    remarks = dict(draft.remarks)
    for key, value in answers.items():
        *tables, last = key.split(".")
        place = content
        for table in tables:
            place = place.setdefault(table, {})
        place[last] = value
        remarks.pop(key, None)
    questions = tuple(q for q in draft.questions if q.key not in answers)
    return replace(draft, content=content, remarks=remarks, questions=questions)


def as_suggested(draft: Draft) -> tuple[Draft, tuple[Question, ...]]:
    """The draft with the suggestion taken for each question that has one, and the questions that were answered so."""
    taken = tuple(q for q in draft.questions if q.suggestion is not None)
    remarks = dict(draft.remarks)
    for q in taken:
        said = f"assumed: {q.text}"
        remarks[q.key] = f"{said}; {remarks[q.key]}" if q.key in remarks else said
    left = tuple(q for q in draft.questions if q.suggestion is None)
    return replace(draft, remarks=remarks, questions=left), taken


def read_value(text: str) -> Any:
    """A value as TOML has it: a number, true or false, a list of them between commas in brackets, else text."""
    if _INTEGER.fullmatch(text):
        return int(text)
    if _FLOAT.fullmatch(text):
        return float(text)
    if text in ("true", "false"):
        return text == "true"
    if text.startswith("[") and text.endswith("]"):
        return [read_value(part.strip().strip("\"'")) for part in text[1:-1].split(",") if part.strip()]
    return text


def _columns_of(draft: Draft) -> list[str | int]:
    columns = [c["column"] for c in draft.content.get("columns", {}).values() if "column" in c]
    time = draft.content.get("time", {}).get("column")
    return [*columns, *([] if time is None else [time]), *(c.column for c in draft.unmapped)]


def _full_key(key: str, draft: Draft) -> str | None:
    """Where an answer belongs: `specimen_id`, `force.unit`, `zone` or a full key; None where nothing has that name."""
    table, _, last = key.rpartition(".")
    kind = str(draft.content.get("kind"))
    names = TABLE_COLUMNS.get(kind, QUANTITIES)
    formats = list_options()
    if not table:
        if last in known_keys(RecordingMetadata):
            return f"recording.{last}"
        return f"time.{last}" if last in TIME and last not in COLUMN else None
    if table in ("recording", "rig"):
        return key
    if table == "time":
        return key if last in TIME else None
    if table in formats:
        return key if last in formats[table] else None
    name = table.removeprefix("columns.")
    return f"columns.{name}.{last}" if name in names and last in {**COLUMN, **TABLE_COLUMN} else None
