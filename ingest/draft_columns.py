"""Which columns of a table without a mapping are its frequencies, moduli, lives and failures, by the words of their headers.

Does not belong here: columns of samples (`ingest.meanings`).
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

from ingest.draft_files import Opened, map_each_column
from ingest.draft_times import find_date_format
from ingest.mapping import FileMapping
from ingest.mapping_keys import RECORDING, TAN_DELTA
from ingest.meanings import TIME, GuessedColumn
from ingest.notations import read_cell
from ingest.outcomes import ALIVE, FAILED, NO_TEST, deal_marks, read_legend
from ingest.questions import label_column
from ingest.read import open_columns
from schemas.errors import DealabError

_STORAGE = r"stor|speicher|elasti\w* (comp|anteil)|^[eg]['1]|[eg]'$|^k'|^[ab]t?_?g'|re\b"
_LOSS = r"loss|verlust|visk?c?os\w* (comp|anteil)|^[eg](''|\"|2)|^k''|im\b"
_MAGNITUDE = r"^\|.*\|$|magnitude|betrag|(complex|dynamic) (\w+ )?modulus|(komplex|dynamisch)\w* (\w+)?modul|\|?[egk]\*\|?|^k$|dyn.*stiff|amplitude ratio"
_TAN_DELTA = r"\btan|loss factor|verlustfaktor"
_PHASE = r"phase|phi|φ|delta|δ|winkel"
_FREQUENCY = r"freq|omega|ω|^f$"
_RELAXED = r"relax|^[eg]\s?\(t\)|modul"
_COMPLIANCE = r"complian|nachgiebigkeit"
_FAILED = (
    r"[cz]ens|fail|event|status|state|death|broke|^breakdown$|^bd$|runout|durchschlag|ausfall|ausgefallen|defekt|versag"
    r"|surviv|alive|überleb|lebt|outcome|ergebnis|[ée]tat\b|estado|\bstato\b|zustand|^results?$|r[ée]sultat|resultado|^end$|^ended|d[ée]faill|claqu|panne"
)
_LIFE = (
    r"life|lebensdauer|time to (break|fail)|(breakdown|failure) time|寿命|standzeit|laufzeit|ausfallzeit|haltbarkeit"
    r"|dur[ée]e de vie"
)
_STARTED = (
    r"^(start|begin|begun|begonn|d[ée]but|inicio|inizio|eingeschaltet|eingebaut|switched on|von$|from$|on$|ein$|开始)"
)
_ENDED = r"^(end|stop|finish|fin\b|fine\b|ausgeschaltet|ausgebaut|switched off|broke|fail|ausfall|ausgefallen|durchschlag|bis$|to$|until|off$|aus$|结束)"
_COUNTED = r"zykl|cycles?\b|lastwechsel|lastspiele|schaltspiele|h[üu]be|actuations|bet[äa]tigungen"
"""Names of lives that count cycles; of a machine's record as well, so that outcomes have to stand beside them."""
_MILLIONS = r"mio\b|million|10\^?6|1e6|10⁶|mcycles|1[., ]?000[., ]?000"
_THOUSANDS = (
    r"tausend|tsd|thousand|milliers?|miles\b|kcycles|\bk\b|[×x*/]\s*1[., ]?000\b|\bin 1[., ]?000\b|10\^?3|1e3|10³"
)
_CONFIGURATION = r"config|group|grupo|electrode|[ée]lectrode|electrodo|elektrode|design|layout|bauart|gruppe|^type?$|^typ\b|variante|variant"
_ALSO_CONFIGURATION = r"^film$|^folie$|^foil$|^membrane?$|mat[ée]ria[lu]|werkstoff|^kind$|^art$|^sorte$"
"""Names of groups where the cells repeat, of specimens where they do not."""
_SPECIMEN = r"specimen|sample|[ée]chantillon|[ée]prouvette|rep[èe]re|muestra|probeta|campione|样品|试样|样本|試料|サンプル|probe|pr[üu]fling|muster|^id$|serial|aktor|actuator|device"
_MOST_SPECIMENS = 100
"""Specimens of one file of samples."""
_FEWEST_SAMPLES = 5
"""Rows of a specimen that are samples of a test: fewer are a list."""
_NUMBERED = r"^(lfd\.?\s*)?(nr|no|nummer|number|#)\.?$"
"""Names of specimens where no other column has their names."""
_COUNT = r"^n$|^count$|^anzahl$"
_PLANNED = r"^test\b|test duration|planned|^on rig"
_YES = (
    r"1|y|j$|ja|oui|s[ií]$|true|wahr|x$|[✓✔]|bd|fail|broke|break|dead|death|ausgef|ausfall|defekt|durchschl|durchgeschl|kaputt"
    r"|gerissen|tot$|versagt"
)
_OUTCOMES = (
    r"[01]|y|yes|n|no|j|ja|nein|oui|non|s[ií]|true|false|wahr|falsch|x|[✓✔]|-|failed|survived|suspended|censored|alive|dead"
    r"|ausgefallen|zensiert|lebt|läuft|f|c|s"
)
"""What a column of outcomes holds, and no other column of words: by it one is found that no name tells."""
_ALIVE = r"[cz]ens|runout|surv|alive|überleb|lebt|intakt|läuft|running|läufer"
"""Names of columns whose yes means that a film has not failed."""
_MODULI = ("Pa", "kPa", "MPa", "GPa", "N/mm", "N/m", "kN/m")


def find_response_columns(columns: Sequence[GuessedColumn]) -> dict[str, GuessedColumn]:
    """The columns of a table of a modulus or stiffness over frequency; empty where it is none."""
    stiff = [c for c in columns if c.unit in _MODULI]
    storage, loss, magnitude = (_first(stiff, pattern) for pattern in (_STORAGE, _LOSS, _MAGNITUDE))
    ratio = _first([c for c in columns if c.unit in ("1", "", None)], _TAN_DELTA)
    phase = _first([c for c in columns if c.unit in ("deg", "°", "rad", None) and c is not ratio], _PHASE)
    if storage is not None and loss is not None and storage is not loss:
        pair = {"storage": storage, "loss": loss}
    elif magnitude is not None and phase is not None:
        pair = {"magnitude": magnitude, "phase": phase}
    elif storage is not None and ratio is not None:
        pair = {"storage": storage, TAN_DELTA: ratio}
    elif magnitude is not None and ratio is not None:
        pair = {"magnitude": magnitude, TAN_DELTA: ratio}
    else:
        return {}
    others = [c for c in columns if c not in pair.values()]
    frequency = next((c for c in others if c.unit in ("Hz", "rad/s", "kHz")), None) or _first(others, _FREQUENCY)
    if frequency is None:
        return {}
    warm = next((c for c in others if c.meaning == "temperature"), None)
    return {"frequency": frequency, **pair} | ({} if warm is None else {"temperature": warm})


def find_own_response(opened: Opened) -> dict[str, GuessedColumn]:
    """The first column to which the file itself gives frequencies (UFF); empty where there is none."""
    if opened.format != "uff":
        return {}
    file = open_columns(opened.path, opened.format, FileMapping(RECORDING, opened.format, {}, None, {}, {}, {}))
    for number, column in enumerate(opened.columns):
        try:
            file.own_frequency(number)
        except DealabError:
            continue
        return {"response": column}
    return {}


def find_relaxation_columns(columns: Sequence[GuessedColumn]) -> dict[str, GuessedColumn]:
    """The columns of a table of a relaxing modulus over time; empty where it is none."""
    if any(re.search(_COMPLIANCE, label_column(c)) for c in columns):
        return {}  # of a creep test, whose stress over strain is another function of time
    if _first(columns, _FREQUENCY) is not None:
        return {}  # of oscillations, whose moduli only have times because they were measured one after the other
    time = next((c for c in columns if c.meaning == TIME), None)
    modulus = _first([c for c in columns if c.unit in _MODULI and c.meaning is None], _RELAXED)
    if time is None or modulus is None:
        return {}
    warm = next((c for c in columns if c.meaning == "temperature"), None)
    return {"time": time, "relaxation": modulus} | ({} if warm is None else {"temperature": warm})


def is_counted(life: GuessedColumn) -> str | None:
    """The unit of a life that counts cycles, `kcycles` where its name or unit says thousands; None for one that is a time."""
    text = f"{life.column} {life.written_unit}".lower()
    if life.unit is not None or re.search(_COUNTED, text) is None:
        return None
    return "Mcycles" if re.search(_MILLIONS, text) else "kcycles" if re.search(_THOUSANDS, text) else "cycles"


def find_frequency(opened: Opened) -> tuple[float, str] | None:
    """The frequency that the words beside a table state, and the words; None where they state none, or several."""
    found = {}
    for text in opened.words:
        for match in re.finditer(r"(\d+(?:[.,]\d+)?)[\s;\"]*(k?)Hz\b", text):
            found[float(match[1].replace(",", ".")) * (1000.0 if match[2] else 1.0)] = text
    return next(iter(found.items())) if len(found) == 1 else None


def find_lifetime_columns(opened: Opened, roles: Mapping[str, str] = MappingProxyType({})) -> dict[str, GuessedColumn]:
    """The columns of a table of lives by what they are; empty where nothing says that it is one. `roles`: what a person says columns are.

    It is one where a column is named a life, where outcomes stand beside times, or specimens beside times that do not
    run.
    """
    spans = _find_spans(opened)
    columns = [c for c in opened.columns if c not in spans.values()]
    named = next((c for c in columns if c.unit != "kV" and re.search(_LIFE, label_column(c))), None)
    runs = {c.meaning for c in columns} & {"force", "displacement"}
    counted = None if runs else _first([c for c in columns if c is not named], _COUNTED)
    others = [c for c in columns if c is not named]
    outcome = _choose_outcome([c for c in others if re.search(_FAILED, label_column(c))], opened)
    if outcome is None and (named is not None or counted is not None or spans):
        outcome = next((c for c in others if c.meaning is None and _holds_outcomes(c, opened)), None)
    if outcome is None and named is not None and runs and _runs(opened.cells(named), opened.options):
        return {}  # a machine calls the time since its start by the word for a life (`Laufzeit`)
    if named is None and outcome is not None and counted is not outcome:
        named = counted
    life = named or next((c for c in columns if outcome is not None and c.meaning == TIME and c is not outcome), None)
    channels = {c.meaning for c in columns} & {"force", "displacement", "leakage_current"}
    if life is None and not channels and (_first(columns, _SPECIMEN) or _first(columns, _CONFIGURATION)):
        life = next((c for c in columns if c.meaning == TIME and not _runs(opened.cells(c), opened.options)), None)
    if life is None and spans and outcome is not None:
        return _with_conditions({"failed": outcome, **spans}, columns, opened)
    given = {role: c for c in columns for name, role in roles.items() if str(c.column) == name}
    if ("lifetime" not in given) and (life is None or (named is None and channels)):
        return {}
    found = {"lifetime": life} if life is not None else {}
    found |= {} if outcome is None or outcome in given.values() else {"failed": outcome}
    found |= spans | given
    return _with_conditions(found, columns, opened)


def _repeats(column: GuessedColumn, opened: Opened) -> bool:
    """Whether a column has few different words for its rows."""
    cells = opened.cells(column)
    return 2 * len({_plain(cell) for cell in cells} - {""}) <= len(cells)


def find_specimens(opened: Opened) -> GuessedColumn | None:
    """The column of a file of samples that says of which specimen each is, where there are several, block by block; None else."""
    for column in opened.columns:
        if column.meaning is not None or re.search(_SPECIMEN, label_column(column)) is None:
            continue
        cells = [str(cell).strip() for cell in _all_cells(column, opened)]
        names = {cell for cell in cells if cell}
        runs = 1 + sum(a != b for a, b in itertools.pairwise(cells))
        words = any(re.search(r"[^\W\d]", name) for name in names)
        if (
            words
            and 1 < len(names) <= _MOST_SPECIMENS
            and runs == len(names)
            and len(cells) >= _FEWEST_SAMPLES * len(names)
        ):
            return column
    return None


def _all_cells(column: GuessedColumn, opened: Opened) -> Sequence[Any]:
    """All cells of a column that hold something; none where the file cannot be read so."""
    mapping = FileMapping(RECORDING, opened.format, dict(opened.options), None, {}, {}, {})
    try:
        file = open_columns(opened.path, opened.format, map_each_column(mapping, [column]))
        return [cell for cell in file.cells(column.column, column.index) if cell is not None and str(cell).strip()]
    except DealabError:
        return []


def _find_spans(opened: Opened) -> dict[str, GuessedColumn]:
    """The two columns of dates between which each test ran; empty where there are not both."""
    dated = [c for c in opened.columns if find_date_format(opened.cells(c)) is not None]
    started, ended = _first(dated, _STARTED), _first(dated, _ENDED)
    return {} if started is None or ended is None or started is ended else {"started": started, "ended": ended}


def _with_conditions(
    found: dict[str, GuessedColumn], columns: Sequence[GuessedColumn], opened: Opened
) -> dict[str, GuessedColumn]:
    """The columns of lives with those of what each test was beside it."""
    for name, pattern in (
        ("voltage", None),
        ("configuration", _CONFIGURATION),
        ("configuration", _ALSO_CONFIGURATION),
        ("specimen_id", _SPECIMEN),
        ("specimen_id", _NUMBERED),
        ("count", _COUNT),
        ("test_duration", _PLANNED),
    ):
        if name in found:
            continue
        if pattern == _ALSO_CONFIGURATION and not any(_repeats(c, opened) for c in columns if _first([c], pattern)):
            continue
        rest = [c for c in columns if c not in found.values()]
        column = next((c for c in rest if c.meaning == name), None) if pattern is None else _first(rest, pattern)
        found |= {} if column is None else {name: column}
    return found


def _choose_outcome(named: Sequence[GuessedColumn], opened: Opened) -> GuessedColumn | None:
    """Of the columns named as outcomes the one that holds them; `Failure mode` and `Failed` may stand side by side."""
    words = [c for c in named if find_date_format(opened.cells(c)) is None]
    return next((c for c in words if _holds_outcomes(c, opened, is_named=True)), words[0] if words else None)


def _holds_outcomes(column: GuessedColumn, opened: Opened, *, is_named: bool = False) -> bool:
    """Whether all cells that are filled say yes or no, failed or alive, at least one of them in a word."""
    texts = {_plain(cell) for cell in opened.cells(column)} - {""}
    if 0 < len(texts) <= _MOST_WORDS and any(re.search(r"[^\W\d]", text) for text in texts):
        told, unknown = deal_marks(sorted(texts), read_legend(opened.words, sorted(texts)), is_named=is_named)
        if not unknown and FAILED in told.values():
            return True
    return 0 < len(texts) <= _MOST_NUMBERS and all(re.fullmatch(_OUTCOMES, t) for t in texts) and texts != {"1"}


def _plain(cell: Any) -> str:
    return str(int(cell) if isinstance(cell, float) and cell.is_integer() else cell).strip().lower()


def _runs(cells: Sequence[Any], options: Mapping[str, Any]) -> bool:
    """Whether times go up from row to row, as samples do."""
    found = [read_cell(str(c).strip(), options.get("decimal", ".")) for c in cells]
    values = [f.value for f in found if f is not None]
    return len(values) > 2 and all(b >= a for a, b in itertools.pairwise(values))


def _first(columns: Sequence[GuessedColumn], pattern: str) -> GuessedColumn | None:
    return next((c for c in columns if re.search(pattern, label_column(c))), None)


NOWHERE = r"[-–—/]+|none|no|nein|kein[er]*|aucune?|n/?a"
"""Places of a failure that there was not."""
_LONGEST_CODE = 3
"""Letters of a mark that is a code: it means nothing without its legend."""
_MOST_NUMBERS = 8
"""Different numbers of a column of failures that are proposed; words are proposed all."""
_MOST_WORDS = 40
"""Different texts of a column that is taken for one of outcomes: remarks of a whole list may all begin with one of a few words."""


def find_meanings(failed: GuessedColumn, opened: Opened, lives: Sequence[GuessedColumn] = ()) -> dict[str, list[Any]]:
    """The values of a column of failures, as they seem to be meant: which ones depends on the table.

    An empty cell beside a life has the meaning that no other value has: people mark the one kind alone. A mark of failures that never
    stands beside a life is of what was never tested.

    Parameters
    ----------
    failed, opened : the column, and the file
    lives : the columns that say how long a specimen lived: of lives, of ends
    """
    found = _set_aside_untested(_meanings(failed, opened), failed, opened, lives)
    if not lives or "unknown" in found or bool(found["failed_values"]) == bool(found["censored_values"]):
        return found
    pairs = zip(opened.cells(failed), opened.cells(lives[0]), strict=False)
    if any(not _plain(cell) and _plain(lived) for cell, lived in pairs):
        lacking = "censored_values" if found["failed_values"] else "failed_values"
        return {**found, lacking: [""]}
    return found


def _set_aside_untested(
    found: dict[str, list[Any]], failed: GuessedColumn, opened: Opened, lives: Sequence[GuessedColumn]
) -> dict[str, list[Any]]:
    """The same meanings, with marks of failures and unknown ones that stand beside no life at all among those of no test."""
    marks = [_plain(cell) for cell in opened.cells(failed)]
    lived: set[str] = set()
    for column in lives:
        cells = [_plain(cell) for cell in opened.cells(column)]
        lived |= {mark for mark, cell in zip(marks, cells, strict=False) if cell and not re.fullmatch(NOWHERE, cell)}
    untested = {mark for mark in marks if mark} - lived
    if not lives or not lived or not untested:
        return found
    told = dict(found)
    for key in ("failed_values", "unknown"):
        void = [value for value in told.get(key, []) if _plain(value) in untested]
        if void:
            told[key] = [value for value in told[key] if value not in void]
            told["no_test_values"] = [*told.get("no_test_values", []), *void]
    return {key: values for key, values in told.items() if values or key != "unknown"}


_LISTS: Mapping[str, str] = {FAILED: "failed_values", ALIVE: "censored_values", NO_TEST: "no_test_values"}


def _meanings(failed: GuessedColumn, opened: Opened) -> dict[str, list[Any]]:
    cells = opened.cells(failed)
    filled = [c for c in cells if str(c).strip()]
    values = list(dict.fromkeys(int(c) if isinstance(c, float) and c.is_integer() else c for c in filled)) or [1, 0]
    plain = [v if isinstance(v, int) and not isinstance(v, bool) else str(v) for v in values]
    if not any(isinstance(v, str) for v in values):
        plain = plain[:_MOST_NUMBERS]
    turned = re.search(_ALIVE, str(failed.column).lower()) is not None
    marks = [str(v) for v in plain]
    legend = read_legend(opened.words, marks)
    told, unknown = deal_marks(marks, legend, is_named=True)
    codes = [mark for mark in unknown if len(mark) <= _LONGEST_CODE and not mark.isdigit()]
    told_enough = bool(legend) or len(set(told.values())) > 1
    if not turned and any(isinstance(v, str) for v in plain) and (told_enough or len(codes) > 1):
        lists: dict[str, list[Any]] = {"failed_values": [], "censored_values": []}
        for value in plain:
            key = _LISTS.get(told.get(str(value), ""))
            if key is not None:
                lists.setdefault(key, []).append(value)
        return lists | ({"unknown": unknown} if unknown else {})
    if not any(re.match(_YES, str(v).strip().lower()) or isinstance(v, int) for v in plain):
        alive = [v for v in plain if re.fullmatch(NOWHERE, str(v).strip().lower())]
        if alive and len(alive) < len(plain):  # places of failure, and a dash where there was none
            return {"failed_values": [v for v in plain if v not in alive], "censored_values": alive}
    yes = [v for v in plain if (re.match(_YES, str(v).strip().lower()) is not None) != turned]
    return {"failed_values": yes, "censored_values": [v for v in plain if v not in yes]}
