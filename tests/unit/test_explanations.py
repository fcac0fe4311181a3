"""Sentences of what may be behind recordings: for every set of explanations one that reads well and says that set and no other."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.commands.show.diagnoses import describe_verdict
from reports import findings
from reports.evidence import Standing
from reports.pages.specimen import diagnosis
from schemas.explanations import CREDIBLE, call_cause, cause, list_explanations, tell_doubt
from schemas.mechanisms import FAULTS, MECHANISMS, UNLISTED, finding

CAUSES = [*MECHANISMS, *FAULTS]
REGIONS = ["film/frequency", "anything", "drive/voltage"]


def row(mechanisms: Sequence[str], possible: Sequence[str], shares: Mapping[str, float] | None) -> dict[str, Any]:
    """A row of `diagnoses` that cannot tell, with the size of every cause that is named."""
    severity = {
        m: {next(iter(MECHANISMS[m].parameters)): {"value": 0.2, "sd": 0.01}} for m in mechanisms if m in MECHANISMS
    }
    return {
        "verdict": "ambiguous",
        "mechanism": mechanisms[0],
        "mechanisms": list(mechanisms),
        "also_possible": list(possible),
        "severity": json.dumps(severity),
        "probabilities": None if shares is None else json.dumps(shares),
        "stage": "film",
    }


@st.composite
def doubtful(draw: st.DrawFn) -> dict[str, Any]:
    """Two to five explanations of one to three causes, one of which may be in no list, or be nothing."""
    some = draw(st.lists(st.sampled_from(CAUSES), min_size=2, max_size=5, unique=True))
    sets = st.lists(st.sampled_from([*some, REGIONS[0]]), min_size=1, max_size=3, unique=True).map(frozenset)
    found = draw(st.lists(st.one_of(sets, st.just(frozenset({"plain"}))), min_size=2, max_size=4, unique=True))
    named = next((one for one in found if one <= {*some}), None)
    if named is None:
        named = frozenset({some[0]})
        found = [named, *found[:3]]
    share = 0.99 / len(found)
    shares = {"+".join(sorted(one, key=lambda m: ("/" in m, m))): share - 1e-6 * i for i, one in enumerate(found)}
    first = max(shares, key=lambda name: shares[name])
    if "/" in first and {*first.split("+")[:-1]} == named:
        shares[first] = 0.0  # a case of its own: what is beside causes that are certain
    causes = {m for one in found for m in one if m in some} - named
    unlisted = [UNLISTED] if any("/" in m or m == "plain" for one in found for m in one) else []
    return row(sorted(named), [*sorted(causes), *unlisted], shares)


def parse(text: str, found: Mapping[str, Any]) -> list[frozenset[str]]:
    """The explanations that a sentence tells, by its grammar alone: clauses are single words to it."""
    severity = json.loads(found["severity"])
    names = {m: f"<{m}>" for m in (*CAUSES, UNLISTED)}
    clauses = [(finding(m, severity.get(m, {})), m) for m in names] + [(finding(m, {}), m) for m in names]
    clauses += [(finding(m, severity.get(m, {}), sized=False), m) for m in names]
    clauses.append((finding(UNLISTED, {}, beside=True), UNLISTED))
    for clause, m in sorted(clauses, key=lambda c: -len(c[0])):
        text = text.replace(clause, names[m])
    text = text.replace("nothing is wrong beyond the noise", "<>")
    sure, perhaps, rest = text.partition(", and perhaps ")
    if not perhaps:
        sure, addition, rest = text.partition(", and in addition ")
        if not addition:
            sure, rest = "", text
    common = frozenset(re.findall(r"<(\w+)>", sure))
    if sure:
        assert re.fullmatch(r"<\w+>(, and <\w+>|(; <\w+>)+; and <\w+>)?", sure), text
    if re.fullmatch(r"either <\w+> or <\w+>", rest):
        rest = rest.replace(" or ", ", or ")
    options = rest.removeprefix("either ").split(", or ") if rest.startswith("either ") else [rest]
    assert rest.startswith("either ") == (len(options) > 1), text
    for option in options:
        assert re.fullmatch(r"(only )?<\w*>((, <\w+>)* and <\w+>)?", option), text
    sets = [common | frozenset(re.findall(r"<(\w+)>", option)) for option in options]
    return [common, *sets] if perhaps else sets


@given(doubtful())
def test_a_sentence_says_the_explanations_that_are_possible_and_no_other(found: dict[str, Any]) -> None:
    expected = {frozenset(one) for one in list_explanations(found)}
    told = parse(cause(found), found)
    assert len(told) == len(set(told))
    assert {*told} == expected


@given(doubtful())
def test_what_cannot_be_told_is_said_alike_by_terminal_and_pages(found: dict[str, Any]) -> None:
    doubt = tell_doubt(found)
    assert doubt in ("cannot tell", "cannot tell which")
    assert (doubt == "cannot tell which") == ("either" in cause(found).partition(", and ")[0])
    assert describe_verdict(found).endswith(f"; these recordings {doubt} (ambiguous).")
    heading = str(findings.headline(Standing("S-1", None, None, None, found)).striptags())
    assert heading.endswith(f". The recordings {doubt}.")


@pytest.mark.parametrize(
    ("shares", "expected"),
    [
        ({"drive_lag": 0.9, "drive_lag+sensor_saturation": 0.09}, "and perhaps the force sensor saturates"),
        ({"drive_lag": 0.5, "sensor_saturation": 0.49}, "more than one explanation fits"),
    ],
)
def test_a_cause_that_is_sure_is_in_the_heading_of_the_diagnosis(shares: dict[str, float], expected: str) -> None:
    d = row(["drive_lag"], ["sensor_saturation"], shares)
    assert diagnosis._heading(d, Standing("S-1", None, None, None, d)).endswith(expected)


def test_every_cause_has_a_clause_of_its_own_with_one_verb_and_no_comma() -> None:
    clauses = [finding(m, {}) for m in (*CAUSES, UNLISTED)]
    assert len({*clauses}) == len(clauses)
    for clause in clauses:
        assert not re.search(r"[,;.]| and ", clause), clause


ELECTRODE, PERMITTIVITY = "electrode_degradation", "frequency_dependent_permittivity"


@pytest.mark.parametrize(
    ("mechanisms", "possible", "shares", "expected"),
    [
        (
            [ELECTRODE, PERMITTIVITY], [UNLISTED], {f"{ELECTRODE}+{PERMITTIVITY}": 0.93, PERMITTIVITY: 0.046, "plain": 0.0},
            "either the electrode degrades and the permittivity falls with frequency, or only the permittivity falls with frequency,"
            " or the cause is in no list",
        ),
        (
            ["drive_lag"], ["sensor_saturation"], {"drive_lag": 0.918, "drive_lag+sensor_saturation": 0.08},
            "the voltage lags its command, by 200 ± 10 ms, and perhaps the force sensor saturates",
        ),
        (
            ["slack"], ["strain_stiffening"], None,
            "either the film goes slack, or the film stiffens or softens with strain",
        ),
        (
            ["slack"], ["clamp_slip", UNLISTED], {"slack": 0.5, "clamp_slip": 0.3, "film/cycle": 0.19},
            "either the film goes slack, or the clamp slips, or the cause is in no list",
        ),
        (
            ["gain_error", "slack"], ["clamp_slip"], {"gain_error+slack": 0.6, "clamp_slip+gain_error": 0.39},
            "a channel reads too much, by 20.0 ± 1.0 %, and in addition either the film goes slack or the clamp slips",
        ),
        (
            ["slack"], [UNLISTED], {"slack": 0.6, "slack+film/cycle": 0.39},
            "the film goes slack, when 20.0 ± 1.0 % of its preload are gone, and perhaps something that is in no list acts beside that",
        ),
    ],
)  # fmt: skip
def test_examples(mechanisms: list[str], possible: list[str], shares: dict[str, float] | None, expected: str) -> None:
    told = cause(row(mechanisms, possible, shares))
    assert re.sub("[\N{NO-BREAK SPACE}\N{NARROW NO-BREAK SPACE}]", " ", told) == expected


def test_many_explanations_are_counted_not_left_out_in_silence() -> None:
    singles = list(MECHANISMS)[:7]
    text = cause(row(singles[:1], singles[1:], dict.fromkeys(singles, 1 / 7)))
    assert text.endswith(", or one of three others")
    assert text.count(", or ") == 4


def test_what_is_less_than_credible_together_is_left_out() -> None:
    found = list_explanations(
        row(["slack"], ["clamp_slip"], {"slack": CREDIBLE - 0.01, "clamp_slip": 0.05, "leakage": 0.01})
    )
    assert found == [("slack",), ("clamp_slip",)]


def test_what_may_be_is_said_with_its_direction_and_channel_where_they_are_known() -> None:
    """A displacement that read 6 % too little was told as a channel that reads too much."""
    found = row(["gain_error"], ["rig_constants"], {"gain_error": 0.51, "rig_constants": 0.48})
    severity = {"gain_error": {"gain": {"value": -0.064, "sd": 0.009}, "channel": "displacement"}}
    told = cause({**found, "severity": json.dumps(severity)})
    assert told == "either displacement reads too little or the rig differs from its file"
    other = row(["rig_constants"], ["gain_error"], {"rig_constants": 0.51, "gain_error": 0.48})
    assert cause(other) == "either the rig differs from its file, or a channel reads too much or too little"


def test_an_ambiguous_cause_is_the_likeliest_and_one_that_is_sure_is_the_cause() -> None:
    assert call_cause(row(["slack"], ["leakage"], {"slack": 0.51, "leakage": 0.48})) == "the likeliest cause"
    assert call_cause(row(["slack"], ["leakage"], {"slack": 0.5, "leakage+slack": 0.49})) == "the cause"
    assert call_cause({"verdict": "named"}) == "the cause"
