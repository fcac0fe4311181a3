"""Of the draft of a table: which of its rows are the sweep or temperature that is meant, and what is asked of lives.

Does not belong here: which columns a table has (`ingest.draft_columns`), what marks mean (`ingest.outcomes`).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Any

from ingest.draft_columns import NOWHERE, find_frequency
from ingest.draft_files import Opened, map_each_column, read_numbers
from ingest.harvest import Fact, read_moment
from ingest.isotherms import find_isotherms, has_repeats, has_returns
from ingest.mapping import FileMapping
from ingest.mapping_keys import LIFETIMES, RECORDING
from ingest.meanings import GuessedColumn
from ingest.questions import Question, label_column
from ingest.read import open_columns
from ingest.trios_reader import STEP
from schemas.errors import DealabError
from schemas.lifetimes import FAILURE_MODES, OTHER, classify_failure_mode
from schemas.units import conversion

_FEWEST_FREQUENCIES = 3
"""Different frequencies of a step that goes over them."""


def ask_outcomes(key: str, entry: dict[str, Any]) -> Question:
    """The question which marks mean failed; it has to be answered where a mark is not understood."""
    unknown = entry.pop("unknown", [])
    void = f", {entry['no_test_values']} are left out" if entry.get("no_test_values") else ""
    text = f"which values mean failed (as it stands {entry['censored_values']} mean censored{void})"
    if not unknown:
        return Question(key, text, entry["failed_values"])
    return Question(
        key, f"{text}; nothing tells what {unknown} mean: censored_values and no_test_values can be said as well"
    )


CLOCKS_OF: Mapping[str, str] = {
    "hh:mm:ss": "hours:minutes:seconds",
    "hh:mm": "hours:minutes",
    "mm:ss": "minutes:seconds",
}
"""Notations of durations, as a comment says them."""


_CLOCKS: Mapping[str, str] = {
    "hh:mm": r"\bh{1,2}\s?:\s?m|\bh:min|\bstd\.?\s?:\s?min|\bj:m|(hours?|stunden|heures|horas)\s?:\s?min",
    "mm:ss": r"\bm{1,2}:s|\bmin\s?:\s?s|min\w*\s?:\s?(sec|sek|seg)",
}
"""What a header or the words beside a table call durations of two parts."""


def find_clock(life: GuessedColumn, opened: Opened) -> dict[str, Any] | None:
    """The keys of a column of lives that are written with colons, `format` None where nothing tells what two parts are; None where they
    are numbers.

    `64:33:47` says itself what its parts are; of `64:33` the header does (`[hh:mm]`, `min:s`), the words beside the table, or durations of
    a workbook beside it that are whole minutes.
    """
    texts = [str(cell).strip().lstrip("<>≤≥= ") for cell in opened.cells(life) if ":" in str(cell)]
    filled = [cell for cell in opened.cells(life) if str(cell).strip()]
    if not texts or 2 * len(texts) < len(filled):
        return None
    whole = [text for text in texts if text.count(":") == 2]
    if len(whole) == len(texts):
        return {"unit": life.unit or "s"}  # each cell has seconds of its own, whatever the header counts in
    for said in (f"{life.column} {life.name} {life.written_unit}", *opened.words):
        for clock, pattern in _CLOCKS.items():
            if re.search(pattern, said.lower()):
                return {"format": clock}
    return {"format": "hh:mm" if len(whole) > 1 and all(text.endswith(":00") for text in whole) else None}


def is_written_once(column: GuessedColumn, opened: Opened, kind: str) -> bool:
    """Whether a column of a list of lives has a value in the first row of each block alone, as under cells that are merged."""
    if kind != LIFETIMES:
        return False
    rows = [i for i, row in enumerate(opened.rows) if sum(bool(str(cell).strip()) for cell in row) > 1]
    cells = opened.cells(column)
    texts = [str(cells[i]).strip() for i in rows if i < len(cells)]
    filled = [text for text in texts if text]
    return bool(texts) and bool(texts[0]) and 2 * len(filled) <= len(texts)


_SAYS_HOW = r"bemerk|anmerk|kommentar|beobacht|remark|comment|note|observ|cause|ursache|grund|reason|mode|modus|\bart\b|\bort\b|where|place|site|stelle|lieu"
"""Names of columns that say how or where a specimen failed, among other things."""
_STATE = r"\b(stand|as of|state of|état du|estado|situation au)\b[\s:]*(am|vom|au|du|del)?\s*"
"""What stands before the date of a list."""
_NOT_COUNTED = r"z[äa]hl\w* (\w+ )?nicht|nicht als|not count|no failure|not a failure|ne compte|zensier|censor|bis dahin|until then|jusque"
"""What a legend says of failures that end the watch alone."""


_MOST_TEXTS = 8
"""Texts of failure modes that a question lists."""


def find_state(opened: Opened) -> Fact | None:
    """The date and time of the state of a list, as the words beside it say: `Stand 04.11.2024 09:00`; None where they say none."""
    for text in opened.words:
        match = re.search(_STATE, text.lower())
        fact = None if match is None else read_moment(text[match.end() :])
        if fact is not None:
            return Fact("open_until", fact, " ".join(text.split())[:100])
    return None


def find_modes(opened: Opened, chosen: Mapping[str, GuessedColumn], failed: Mapping[str, Any]) -> GuessedColumn | None:
    """The column that says how specimens failed, in several ways: that of the marks of failures, or one of remarks; None where there is none.

    Most of what remarks say beside failures has to be a way of failing.
    """
    marks = chosen.get("failed")
    if marks is None:
        return None
    meaning = [str(value) for value in failed.get("failed_values", [])]
    if len(_classify(meaning)) > 1:
        return marks
    is_failed = [str(cell).strip() in meaning for cell in opened.cells(marks)]
    for column in opened.columns:
        if column in chosen.values() or re.search(_SAYS_HOW, label_column(column)) is None:
            continue
        cells = [str(cell).strip() for cell in opened.cells(column)]
        said = [cell for cell, own in zip(cells, is_failed, strict=False) if own and cell]
        told = [cell for cell in said if classify_failure_mode(cell) != OTHER]
        if len(_classify(told)) > 1 and 2 * len(told) > len(said):
            return column
    return None


def ask_censored_modes(opened: Opened, of_modes: GuessedColumn) -> Question | None:
    """The question which ways of failing are none of the film; None where a column says one way only. What the words beside the table say
    of them is the suggestion."""
    cells = {text for cell in opened.cells(of_modes) if (text := str(cell).strip())}
    modes = _classify(cells)
    if len(modes) < 2:
        return None
    texts = sorted(cell for cell in cells if not re.fullmatch(NOWHERE, cell.lower()))
    beside = [word.lower() for word in opened.words if word.strip() not in cells]
    said = [word[: match.start()] for word in beside if (match := re.search(_NOT_COUNTED, word)) is not None]
    suggested = [mode for mode in modes if any(mode in _classify(re.findall(r"[^\W\d_]+", word)) for word in said)]
    return Question(
        "columns.failure_mode.censored_modes",
        f"which of {', '.join(modes)} are no failures, but end the watch"
        f" ({'so the words beside the table' if suggested else 'none: every one counts'})"
        + (f"; texts can be named as well: {', '.join(texts)}" if len(modes) < len(texts) <= _MOST_TEXTS else ""),
        suggested,
    )


def _classify(words: Iterable[str]) -> list[str]:
    """The known failure modes that some words name."""
    found = {classify_failure_mode(word) for word in words}
    return [mode for mode in FAILURE_MODES if mode in found and mode != OTHER]


def say_frequency(opened: Opened, remarks: dict[str, str], questions: list[Question]) -> dict[str, Any]:
    """How many cycles of a life pass in a second, which alone makes a time of them."""
    said = find_frequency(opened)
    if said is None:
        questions.append(Question("columns.frequency.value", "cycles in a second: the lives are counted in cycles"))
        return {"value": None, "unit": "Hz"}
    remarks["columns.frequency.value"] = f"the file: {said[1]}"
    return {"value": said[0], "unit": "Hz"}


def select_isotherms(opened: Opened, chosen: Mapping[str, GuessedColumn]) -> tuple[dict[str, Any] | None, bool, str]:
    """The selection of each temperature where a table holds several, whether points are repeated, and what belongs to none."""
    names = [name for name in ("temperature", "frequency", "time") if name in chosen]
    mapping = FileMapping(RECORDING, opened.format, dict(opened.options), None, {}, {}, {})
    try:
        file = open_columns(opened.path, opened.format, map_each_column(mapping, [chosen[name] for name in names]))
        found = {name: read_numbers(file, chosen[name]) for name in names}
    except DealabError:
        return None, False, ""
    warm, points = found.get("temperature"), found.get("frequency", found.get("time"))
    if points is None:
        return None, False, ""
    isotherms = None if warm is None or warm.size != points.size else find_isotherms(warm, points)
    repeated = has_repeats(warm, points, isotherms)
    if isotherms is None:
        return None, repeated, ""
    assert warm is not None  # else there are no isotherms
    by: dict[str, Any] = {"column": chosen["temperature"].column}
    by |= {"runs": "apart"} if has_returns(warm, isotherms) else {}
    if not isotherms.loose:
        return by | {"each": True, "tolerance": isotherms.tolerance}, repeated, ""
    selection = by | {"each_of": list(isotherms.values), "tolerance": isotherms.tolerance}
    remark = f"{isotherms.loose} rows from {isotherms.loose_from:.4g} to {isotherms.loose_to:.4g} are at no isotherm: left out"
    return selection, repeated, remark


_DEGREES = re.compile(r"(?P<number>[-−]?\d+(?:[.,]\d+)?)\s*(?:°\s*[CF]|K|deg\s*C)?(?![\w.,])")
"""A temperature as a text above a group of columns has it."""
_WARM = r"temp|°\s*[cf]\b|\bdeg|kelvin"
"""What a line of temperatures says beside its numbers."""


def find_warm_groups(opened: Opened, chosen: Mapping[str, GuessedColumn]) -> list[dict[str, Any]]:
    """The sweeps of several temperatures whose columns stand side by side under the same names, as entries of `[[select]]` with columns and
    a temperature of their own; empty where there is one, or no line above them has a temperature for each."""
    if "temperature" in chosen:
        return []
    groups = {name: [c for c in opened.columns if c.name and c.name == column.name] for name, column in chosen.items()}
    counts = {len(own) for own in groups.values()}
    if len(counts) != 1 or counts == {0} or counts == {1}:
        return []
    warm = _read_temperatures(opened, counts.pop())
    entries: list[dict[str, Any]] = []
    for i, (label, celsius) in enumerate(warm):
        columns = {name: own[i] for name, own in groups.items()}
        filled = [row for c in columns.values() for row, cell in enumerate(opened.cells(c)) if str(cell).strip()]
        rows = {"first_row": 0} | ({"last_row": max(filled)} if filled and max(filled) < len(opened.rows) - 1 else {})
        entry = {**rows, "part": label, "recording": {"temperature_c": celsius}}
        entries.append(entry | ({"columns": {n: {"column": c.column} for n, c in columns.items()}} if i else {}))
    return entries if len({entry["part"] for entry in entries}) == len(entries) else []


def _read_temperatures(opened: Opened, count: int) -> list[tuple[str, float]]:
    """As written and in °C, of the last line above the table that has `count` of them; empty where none has."""
    for line in reversed(opened.words):
        cells = [cell.strip() for cell in line.split(str(opened.options.get("delimiter", "\t"))) if cell.strip()]
        if re.search(_WARM, line.lower()) is None:
            continue
        found = [m for cell in cells if (m := _DEGREES.search(cell)) is not None]
        if len(found) != count:
            continue
        said = re.search(r"°\s*(F)|\b(K)\b|kelvin", line)
        unit = "degC" if said is None else "degF" if said[1] else "K"
        into = conversion(unit, "degC")
        numbers = [m["number"].replace("−", "-").replace(",", ".") for m in found]
        return [(number, round(float(number) * into.scale + into.offset, 6)) for number in numbers]
    return []


def select_sweeps(opened: Opened, chosen: Mapping[str, GuessedColumn]) -> dict[str, Any] | None:
    """The selection of the steps of an export that go over frequencies, where others, of amplitudes, stand beside them."""
    step = next((c for c in opened.columns if c.column == STEP), None)
    if step is None:
        return None
    found: dict[str, set[Any]] = {}
    for name, cell in zip(opened.cells(step), opened.cells(chosen["frequency"]), strict=True):
        found.setdefault(str(name), set()).add(cell)
    sweeps = [name for name, cells in found.items() if len(cells) >= _FEWEST_FREQUENCIES]
    if not sweeps or len(sweeps) == len(found):
        return None
    return {"column": STEP, "equals": sweeps[0] if len(sweeps) == 1 else sweeps}
