"""What marks in a table of lives mean, `A`, `DL`, `läuft noch`, `suspended`: failed, still alive, or no specimen of the test at all.

A guess for drafts alone, from the words of the marks themselves and from a legend beside the table (`A = ausgefallen`). A survivor that is
taken for a failure, or left out, makes lives too short in silence: what nothing tells is asked.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence

from schemas.lifetimes import OTHER, classify_failure_mode

FAILED, ALIVE, NO_TEST = "failed", "alive", "no test"

_NO_TEST = (
    r"ung[üu]ltig|invalid|z[äa]hlt nicht|nicht (gewertet|gez[äa]hlt|gepr[üu]ft|getestet|verwendet)|not (counted|tested|valid|used)"
    r"|does not count|do not count|excluded|ausgeschlossen|ausschluss|void|discard|verworfen|fehlversuch|non test|no test\b|kein (versuch|test)\b"
)
_NOT_FAILED = (
    r"(ohne|kein\w*|no|not|nicht|without|non|pas de|sans)\s+(\w+\s+)?(ausfall|ausgefallen|defekt|durchschlag|fail\w*|break\w*|broken|defect"
    r"|d[ée]faill\w*|claqu\w*|panne|romp\w*|cass[ée]\w*|rot[oa]s?|fall\w*|gerissen|gebrochen|bd)"
)
_NOT_ALIVE = r"\b(not|no|nicht|non|pas|n)\b\.?\s*(ok|okay|good|fine|in ordnung|i\.?\s?o\b|intakt|intact|alive)"
_FROM_OUTSIDE = (
    r"strom(ausfall|unterbrechung)|netz(ausfall|teil ?ausfall)|power (cut|fail\w*|out\w*|loss|went)|mains fail\w*|black ?out|brown ?out|coupure"
    r"|panne de (courant|secteur)|corte de (luz|corriente)|apag[óo]n|interlock|door contact|t[üu]rkontakt|not-?aus|emergency (stop|off)"
    r"|un(besch[äa]digt|versehrt|damaged|broken|harmed)|(not|nicht) (broken|damaged|besch[äa]digt|kaputt|defekt)|still (fine|good|ok|works|working)"
    r"|non endommag|sin da[ñn]o|(supply|netzger[äa]t|rechner|computer|pc|logger|generator|amplifier|verst[äa]rker)\W*(fail\w*|ausfall|ausgefallen|broke|defekt"
    r"|died|crash\w*|abgest[üu]rzt)"
)
"""What ended a test without the film: such words come before those of failures, which they may hold (`Stromausfall`)."""
_ALIVE = (
    r"[cz]ens|run[- ]?out|surv|alive|überleb|lebt|lebend|intakt|intact|l[äa]uft|running|durchl[äa]ufer|suspen|abgebroch|abbruch|aborted"
    r"|ausgebaut|entnommen|abgebaut|abgeschaltet|ausgeschaltet|switched off|turned off|[ée]teint|arr[êe]t[ée]|retir[ée]|apagado|removed|withdrawn|taken (out|off)|stopped|gestoppt|angehalten|beendet|ended|test end|versuchsende|interrupt"
    r"|in ordnung|\bok\b|\bokay\b|\bfine\b|\bgood\b|vivant|en vie|still on|ongoing|noch (am|dran)|ohne befund"
)
_FAILED = (
    r"ausgef|ausfall|fail|broke|break|burst|rupture|dead|death|tot\b|defekt|defect|kaputt|durchschl|durchgeschl|gerissen|riss\b|tear|torn|versag"
    r"|kurzschl|short|puncture|pinhole|d[ée]faill|claqu|panne|rompu|cass[ée]|\brot[oa]s?\b|fallo"
)
_PLACES = (
    r"edge|border|rim|corner|centre|center|middle|area|lead|tab|wire|contact|terminal|hole|rand|kante|ecke|mitte|fl[äa]che|zuleitung|anschluss"
    r"|kontakt|loch|bord|coin|centre|surface|connexion|borde|[áa]rea|contacto"
)
"""Where a film failed, in a column that says how: a place alone means that there was a failure."""
_NOWHERE = r"none|nowhere|nirgends|kein(e[rsnm]?)?|aucune?|ninguno|nichts|nothing"
_ALIVE_MARKS = r"dl|ab|io|i\.\s?o\.|ok|s|c|z|n|no|nein|non|false|falsch|0|l|ro|-|–|—|→|>"
_FAILED_MARKS = r"bd|f|j|ja|y|yes|oui|s[ií]|true|wahr|1|✓|✔"
_MARK = r"[^\s,;|=:\"'„“”]{1,12}"
_LEGEND = re.compile(
    rf"(?=(?:^|[,;|\n(:.]|\bund\b|\band\b)\s*[\"'„“]?(?P<mark>{_MARK}(?: {_MARK})?)[\"'“”]?\s*[=:–]\s*(?P<said>[^,;|\n=:]{{2,80}}))"
)
"""A mark and what is said of it, wherever one begins: `Legende: D: Durchschlag; X: ungültig`."""


def tell_outcome(mark: str, legend: Mapping[str, str], *, is_named: bool = False) -> str | None:
    """What a mark means, by its legend first; None where neither says it.

    `is_named`: its column is named as one of outcomes, so that a place alone says that there was a failure.
    """
    plain = mark.strip().lower()
    said = legend.get(plain)
    for text in (said, plain):
        if text is None:
            continue
        for pattern, outcome in (
            (_NO_TEST, NO_TEST),
            (_FROM_OUTSIDE, ALIVE),
            (_NOT_FAILED, ALIVE),
            (_NOT_ALIVE, FAILED),
            (_ALIVE, ALIVE),
            (_FAILED, FAILED),
        ):
            if re.search(pattern, text):
                return outcome
    for pattern, outcome in ((_ALIVE_MARKS, ALIVE), (_FAILED_MARKS, FAILED)):
        if re.fullmatch(pattern, plain):
            return outcome
    if is_named:
        is_place = re.search(rf"\b\w*({_PLACES})\b", plain) is not None or classify_failure_mode(plain) != OTHER
        return ALIVE if re.fullmatch(_NOWHERE, plain) else FAILED if is_place else None
    return None


def read_legend(words: Iterable[str], marks: Sequence[str]) -> dict[str, str]:
    """What the words beside a table say of its marks: `A = ausgefallen, DL = Durchläufer`; in small letters."""
    known = {mark.strip().lower() for mark in marks}
    found: dict[str, str] = {}
    for text in words:
        for match in _LEGEND.finditer(text):
            mark = match["mark"].strip().lower()
            if mark in known:
                found.setdefault(mark, match["said"].strip().lower())
    return found


def deal_marks(
    marks: Sequence[str], legend: Mapping[str, str], *, is_named: bool = False
) -> tuple[dict[str, str], list[str]]:
    """The outcome of each mark, and those that nothing tells.

    Where all others mean one of failed and alive, and a single mark is left, it has the other meaning: a table that marks survivors in words
    has a mark for failures as well.
    """
    told = {mark: tell_outcome(mark, legend, is_named=is_named) for mark in marks}
    unknown = [mark for mark, outcome in told.items() if outcome is None]
    known = {outcome for outcome in told.values() if outcome in (FAILED, ALIVE)}
    if len(unknown) == 1 and len(known) == 1:
        told[unknown.pop()] = ALIVE if FAILED in known else FAILED
    return {mark: outcome for mark, outcome in told.items() if outcome is not None}, unknown
