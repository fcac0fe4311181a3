"""Answers to the questions of a draft: where each belongs in the mapping, and the mapping with them in it."""

from __future__ import annotations

import copy
import json
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from ingest.draft import Draft, Wanted, make_draft
from ingest.draft_files import is_workbook
from ingest.draft_text import toml_string
from ingest.formats import list_options
from ingest.mapping_keys import COLUMN, EACH, IGNORE, KINDS, LIFETIMES, RECORDING, TABLE_COLUMN, TABLE_COLUMNS, TIME
from ingest.meanings import NOTHING
from ingest.meanings import TIME as TIMES
from ingest.parts import name_parts
from ingest.questions import Question, unstretched
from ingest.select import same_cell
from schemas.alike import ask_meant
from schemas.errors import DealabError, UsageError
from schemas.metadata import RecordingMetadata, check_value, known_keys
from schemas.quantities import QUANTITIES

_INTEGER, _FLOAT = re.compile(r"[+-]?\d+"), re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_PART = re.compile(r'\s*("(?:[^"\\]|\\.)*"|\'[^\']*\'|[^,]*)\s*(?:,|$)')
"""One value of a list, in quotation marks where it holds a comma."""
_OUTCOMES = ("failed_values", "censored_values", "left_censored_values", "no_test_values")
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
    wanted = Wanted(_kind(answers, path), answers.get("sheet"))
    of_file = ("kind", "sheet")
    draft = make_draft(path, wanted=Wanted(sheet=wanted.sheet))
    columns = {str(c) for c in _columns_of(draft)}
    said = {key: value for key, value in answers.items() if key in columns}
    names = TABLE_COLUMNS[LIFETIMES] if wanted.kind in (None, LIFETIMES) else {}
    roles = {key: value for key, value in said.items() if value in names and value not in QUANTITIES}
    meant = {key: value for key, value in said.items() if key not in roles}
    wrong = [
        f'{key}={value}: no quantity{ask_meant(value, [*QUANTITIES, *names])}'
        for key, value in meant.items()
        if value not in (*QUANTITIES, NOTHING, TIMES)
    ]  # fmt: skip
    if not wrong:
        draft = make_draft(path, meant, replace(wanted, roles=roles))
    placed: dict[str, Any] = {}
    for key, value in answers.items():
        if key in said or key in of_file:
            continue
        if key == SIZES:
            sizes = _split_sizes(value)
            if len(sizes) > len(_SIZE_KEYS):
                wrong.append(f"{SIZES}={value}: {len(sizes)} numbers, where length, width and thickness are three")
            placed |= {f"recording.{k}": read_value(s) for k, s in zip(_SIZE_KEYS, sizes, strict=False)}
            continue
        full = _full_key(key, draft)
        if full is None:
            known = [*known_keys(RecordingMetadata), *columns, *(q.key for q in draft.questions), "zone", *of_file]
            wrong.append(f'"{key}" is no key{ask_meant(key, known)}')
        else:
            placed[full] = value if is_text(full) else read_value(value)
    if wrong:
        raise UsageError("; ".join(wrong), where=path.name, expected="columns of the file, or keys of the mapping")
    return draft, placed


def _split_sizes(value: str) -> list[str]:
    """The numbers of `50x20x0.5`, `50, 20, 0.5` or `50 20 0,5`: a comma is that of a decimal where something else stands between them."""
    for between in (r"\s*[x×;]\s*", r"\s*,\s+|\s+"):
        if re.search(between, value):
            return [part.replace(",", ".") for part in re.split(between, value)]
    return value.split(",")


def _kind(answers: Mapping[str, str], path: Path) -> str | None:
    """The kind of file that an answer gives. Raises `UsageError` for one that is none."""
    kind = answers.get("kind")
    kinds = [one for one in KINDS if one != IGNORE]
    if kind is not None and kind not in kinds:
        raise UsageError(f"kind={kind}: no kind{ask_meant(kind, kinds)}", where=path.name, expected=", ".join(kinds))
    return kind


def find_keys(path: Path, answers: Mapping[str, str]) -> set[str]:
    """The answers' keys that are meant for a file: its columns, keys of its mapping, scales of its channels in volts.

    None where it cannot be drafted.
    """
    try:
        draft = make_draft(path)
        columns = {str(c) for c in _columns_of(draft)}
        said = {
            key: value for key, value in answers.items() if key in columns and value in (*QUANTITIES, NOTHING, TIMES)
        }
        draft = make_draft(path, said) if said else draft
    except DealabError:
        return set()
    of_file = {"kind", "sheet"} if is_workbook(path) else {"kind"}
    return {key for key in answers if key in columns or key in of_file or _is_meant_for(key, draft)}


def _is_meant_for(key: str, draft: Draft) -> bool:
    full = _full_key(key, draft)
    if full is None or not full.startswith("columns."):
        return full is not None
    table, _, last = full.rpartition(".")
    if last in ("scale", "offset"):
        return any(q.key == f"{table}.scale" for q in draft.questions)
    return table.removeprefix("columns.") in draft.content.get("columns", {})


def answered(draft: Draft, answers: Mapping[str, Any]) -> Draft:
    """The draft with answers in their places, and what follows from them; what is answered is no question any more."""
    content: dict[str, Any] = copy.deepcopy(dict(draft.content))
    remarks = dict(draft.remarks)
    for key, value in answers.items():
        place, last = _find_place(content, key)
        place[last] = value
        remarks.pop(key, None)
    if "recording.protocol" in answers and name_parts(content):
        _join_parts(content)
    for name, column in content.get("columns", {}).items():
        own = {key.rsplit(".", 1)[-1] for key in answers if key.startswith(f"columns.{name}.")}
        if own & set(_OUTCOMES):
            column |= _deal_outcomes(draft.content["columns"].get(name, {}), column, own)
        if name == "stretch" and "unit" in own and "offset" in column and "offset" not in own:
            column["offset"] = unstretched(str(column["unit"]))
    questions = tuple(q for q in draft.questions if q.key not in answers)
    return replace(draft, content=content, remarks=remarks, questions=questions)


def _find_place(content: dict[str, Any], key: str) -> tuple[dict[str, Any], str]:
    """The table of a mapping that a key with dots belongs in, made where it is not there, and the key's last word."""
    *tables, last = key.split(".")
    place = content
    for table in tables:
        place = place.setdefault(table, {})
    return place, last


def _join_parts(content: dict[str, Any]) -> None:
    """Makes one recording of a file again: who says its protocol takes it for one test."""
    content["select"] = [entry for entry in content["select"] if "part" not in entry]
    if not content["select"]:
        del content["select"]
    about = content["recording"]
    about["recording_id"] = str(about["recording_id"]).removesuffix("-" + EACH)


def _deal_outcomes(
    before: Mapping[str, Any], column: Mapping[str, Any], answered_keys: set[str]
) -> dict[str, list[Any]]:
    """The lists of a column of outcomes that no answer gives, so that each value of the file stands in one list.

    Values that an answer names leave all other lists. Those that an answer leaves out go from failed to censored, or from
    censored to failed.
    """
    given = [v for key in _OUTCOMES if key in answered_keys for v in _as_list(column[key])]
    left = {key: [v for v in _as_list(before.get(key, [])) if not _is_among(v, given)] for key in _OUTCOMES}
    for here, there in (_OUTCOMES[:2], _OUTCOMES[1::-1]):
        if here in answered_keys and there not in answered_keys:
            left[there] += left[here]
    return {key: values for key, values in left.items() if key not in answered_keys and (values or key in before)}


def _as_list(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [value]


def _is_among(value: Any, others: list[Any]) -> bool:
    return any(same_cell(value, other) for other in others)


def as_suggested(draft: Draft) -> tuple[Draft, tuple[Question, ...]]:
    """The draft with the suggestion taken for each question that has one, and the questions that were answered so."""
    taken = tuple(q for q in draft.questions if q.suggestion is not None)
    content: dict[str, Any] = copy.deepcopy(dict(draft.content))
    remarks = dict(draft.remarks)
    for q in taken:
        # What is not taken unasked stands nowhere yet.
        place, last = _find_place(content, q.key)
        place.setdefault(last, q.suggestion)
        said = f"assumed: {q.text}"
        remarks[q.key] = f"{said}; {remarks[q.key]}" if q.key in remarks else said
    left = tuple(q for q in draft.questions if q.suggestion is None)
    return replace(draft, content=content, remarks=remarks, questions=left), taken


def read_value(text: str) -> Any:
    """A value as TOML has it: a number, true or false, a list of them between commas in brackets, else text.

    In a list what stands in quotation marks is text, commas included.
    """
    if _INTEGER.fullmatch(text):
        return int(text)
    if _FLOAT.fullmatch(text):
        return float(text)
    if text in ("true", "false"):
        return text == "true"
    if text.startswith("[") and text.endswith("]"):
        parts = [part.strip() for part in _PART.findall(text[1:-1])]
        return [_read_part(part) for part in parts if part]
    return text


def _read_part(part: str) -> Any:
    if len(part) > 1 and part[0] == part[-1] == '"':
        try:
            return json.loads(part)
        except ValueError:
            return part[1:-1]
    return part[1:-1] if len(part) > 1 and part[0] == part[-1] == "'" else read_value(part)


def answer_key(key: str, text: str) -> dict[str, Any]:
    """The answer for a key of `[recording]`, as `answered` takes it. Raises `RefusedError` for a value that it cannot have."""
    value = text if is_text(key) else read_value(text)
    check_value(key, value)
    return {f"{RECORDING}.{key}": value}


def is_text(key: str) -> bool:
    """Whether the value of a key is text, also where it looks like a number."""
    return key.rsplit(".", 1)[-1] in _TEXTS


def write_value(value: Any) -> str:
    """A value as it can be typed for `read_value` to read it; texts of a list in quotation marks only where they need them."""
    if not isinstance(value, list):
        return str(value)
    plain = [str(part) for part in value]
    typed = [t if read_value(f"[{t}]") == [part] else toml_string(t) for t, part in zip(plain, value, strict=True)]
    return "[" + ", ".join(typed) + "]"


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
