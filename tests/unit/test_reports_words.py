"""Findings in words: verdicts, causes, severities, survival."""

from __future__ import annotations

import itertools
import json
from dataclasses import asdict, replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from markupsafe import Markup

from pipeline.commands.show import diagnoses as show
from pipeline.diagnose.search import held_out
from pipeline.fit.survival import comparisons
from reports import findings
from reports.blocks import Figure, Finding, Findings, Fold, Head, Row, Table
from reports.evidence import Standing, plain_beyond_noise
from reports.figures import palette
from reports.pages import specimens
from reports.pages.campaign import causes, lives
from reports.pages.campaign import page as campaign
from reports.pages.campaign.lives import decisive
from reports.pages.index import page as index
from reports.pages.index.page import end_in_words, tally
from reports.pages.index.trouble import reason
from reports.pages.specimen import diagnosis as diagnosis_page
from reports.pages.specimen import models, permittivity, relaxing, shifts
from reports.results import Query
from schemas import explanations, mechanisms
from schemas.tables import TABLES
from tests.helpers.mechanism_ids import CONTRACT


def plain(text: object) -> str:
    return str(text).replace("\u00a0", " ")


def diagnosis(verdict: str, **more: object) -> dict[str, object]:
    return {**dict.fromkeys(TABLES["diagnoses"].names), "specimen_id": "P-07", "verdict": verdict, **more}


def test_every_mechanism_has_words_for_its_parameters() -> None:
    assert set(mechanisms.MECHANISMS) == set(CONTRACT)
    assert len(CONTRACT) == findings.LISTED_CAUSES
    for mechanism in CONTRACT:
        known = mechanisms.MECHANISMS[mechanism]
        first = next(iter(known.parameters))
        text = plain(mechanisms.finding(mechanism, {first: {"value": 0.1, "sd": 0.01}}))
        assert "±" in text
        assert "{}" not in text + mechanisms.finding(mechanism, {})


@pytest.mark.parametrize("mechanism", CONTRACT)
def test_signs_are_words(mechanism: str) -> None:
    """A severity of the other sign is said in words, never as a minus."""
    known = mechanisms.MECHANISMS[mechanism]
    first = next(iter(known.parameters))
    if known.reverse or mechanism == "rig_constants":
        up, down = (mechanisms.finding(mechanism, {first: {"value": v, "sd": 0.01}}) for v in (0.1, -0.1))
        assert up != down
        assert "−" not in up + down


@pytest.mark.parametrize(
    ("mechanism", "value", "expected"),
    [
        ("missing_relaxation", 7.78, "the model lacks a relaxation"),
        ("gain_error", -0.3, "a channel reads too little"),
    ],
)
def test_a_size_that_is_not_resolved_stands_in_no_heading(mechanism: str, value: float, expected: str) -> None:
    first = next(iter(mechanisms.MECHANISMS[mechanism].parameters))
    assert mechanisms.finding(mechanism, {first: {"value": value, "sd": None}}) == expected


def test_a_stiffness_that_is_not_resolved_stands_in_no_heading() -> None:
    fit = dict.fromkeys(TABLES["model_fits"].names) | {"model_order": 3, "k0_n_per_mm": 3.08e-4, "reduced_chi2": 1.0}
    for d in (None, diagnosis("none", mechanisms=[])):
        standing = Standing("P-07", None, None, fit, d)
        for text in (findings.headline(standing), findings.lede(standing)):
            assert "0.000308" not in plain(text)
    assert "not resolved" in findings.headline(Standing("P-07", None, None, fit, None))


@pytest.mark.parametrize(
    ("severity", "expected"),
    [
        (
            {"stiffness_error": {"value": 0.063, "sd": 0.003}},
            "the load cell is stiffer than its file says, by 6.3 ± 0.3 %",
        ),
        (
            {"mass_error": {"value": 0.08, "sd": 0.011}, "stiffness_error": {"value": 0.079, "sd": 0.016}},
            "the clamp is heavier than its file says, by 8.0 ± 1.1 %, and the load cell is stiffer than its file says, by 7.9 ± 1.6 %",
        ),
        ({"mass_error": {"value": -0.02, "sd": 0.004}}, "the clamp is lighter than its file says, by 2.0 ± 0.4 %"),
        (
            {"mass_error": {"value": 0.001, "sd": 0.004}, "stiffness_error": {"value": -0.05, "sd": 0.01}},
            "the load cell is softer than its file says, by 5.0 ± 1.0 %",
        ),
    ],
)
def test_rig_constants_say_which_and_in_which_direction(severity: dict[str, object], expected: str) -> None:
    assert plain(mechanisms.finding("rig_constants", severity)) == expected


def of_rig(stated: dict[str, str], *, taps: bool) -> Standing:
    """A specimen whose diagnosis finds the clamp 8 % heavier; of the load cell it is not sure."""
    severity = {"mass_error": {"value": 0.08, "sd": 0.011}, "stiffness_error": {"value": 0.001, "sd": 0.01}}
    d = diagnosis("named", mechanisms=["rig_constants"], severity=json.dumps({"rig_constants": severity}))
    return Standing("P-07", None, None, None, d, stated, taps=taps)


def to_do(standing: Standing) -> str:
    following = findings.what_next(standing)
    assert following is not None
    return plain(following.body)


def test_constants_that_are_off_are_told_as_the_file_would_say_them() -> None:
    stated = {"clamp_mass_kg": "0.188", "load_cell_stiffness_n_per_mm": "20.2"}
    said = to_do(of_rig(stated, taps=False))
    assert said.startswith(mechanisms.ACTIONS["rig_constants"])
    assert said.endswith("By these recordings: clamp mass 0.2030 ± 0.0021 kg in place of 0.188.")
    assert to_do(of_rig({}, taps=False)) == mechanisms.ACTIONS["rig_constants"]


def test_with_taps_recorded_what_to_write_into_the_file_is_said() -> None:
    stated = {"clamp_mass_kg": "0.188", "load_cell_stiffness_n_per_mm": "20.2", "rig_id": "shaker-2"}
    said = to_do(of_rig(stated, taps=True))
    assert said.startswith(
        "Write clamp_mass_kg = 0.2030 ± 0.0021 (now 0.188) into rigs/shaker-2.toml, the ± as clamp_mass_kg_sd"
    )
    assert "load_cell_stiffness" not in said
    assert mechanisms.ACTIONS["rig_constants"] not in said
    # taps alone write nothing: what the file says has to be known
    assert to_do(of_rig({"rig_id": "shaker-2"}, taps=True)) == mechanisms.ACTIONS["rig_constants"]


@pytest.mark.parametrize(
    ("value", "sd", "expected"),
    [(-0.00105, 0.00021, "5.0 SD below 0: no rig has that"), (-0.003, 0.002, "1.5 SD below 0: as good as none"), (-0.001, 0.002, ""), (0.001, 1e-4, "")],
)  # fmt: skip
def test_a_constant_that_cannot_be_negative_is_not_shown_so_without_a_word(
    value: float, sd: float, expected: str
) -> None:
    fit = dict.fromkeys(TABLES["model_fits"].names) | {
        "model_order": 3, "load_cell_damping_n_s_per_mm": value, "load_cell_damping_n_s_per_mm_sd": sd,
    }  # fmt: skip
    said = plain(" ".join(findings.tell_negative(fit)))
    assert (expected in said) if expected else not said
    assert said in plain(" ".join(findings.remarks(Standing("P-07", None, None, fit, None))))


def test_fitted_constants_say_what_the_diagnosis_made_of_them() -> None:
    fit = dict.fromkeys(TABLES["model_fits"].names) | {
        "load_cell_damping_n_s_per_mm": -0.00105, "load_cell_damping_n_s_per_mm_sd": 0.00021,
    }  # fmt: skip
    standing = of_rig({"clamp_mass_kg": "0.188", "rig_id": "shaker-2"}, taps=True)
    found, negative = models._rig_notes(standing, fit, findings.find_constants(standing))
    assert "the diagnosis finds them elsewhere. Write clamp_mass_kg = 0.2030 ± 0.0021 (now 0.188)" in plain(found)
    assert "5.0 SD below 0" in plain(negative)
    assert models._rig_notes(of_rig({}, taps=True), dict.fromkeys(fit), []) == []


@pytest.mark.parametrize(
    ("fitted", "plain_model", "expected"),
    [
        (1.0, 0.1, "the film stays where it was"),
        (1.0, 3.0, "ignoring the cause biases the film"),
        (6.3, 3.0, "ignoring the cause biases the film"),
        (
            6.3,
            0.1,
            "the model fitted to the responses alone is up to 6.3 SD off (k0); the plain model of the diagnosis",
        ),
        (6.3, None, "ignoring the cause biases the film: the model fitted to the responses alone is up to 6.3 SD off"),
    ],
)
def test_the_film_does_not_stay_where_one_of_the_models_is_off(
    fitted: float, plain_model: float | None, expected: str
) -> None:
    found = shifts.Shifts(fitted, "k0", plain_model)
    assert shifts.tell(found).startswith(expected)
    assert found.any == ("stays where" not in expected)


def test_what_is_not_all_of_it_is_not_a_hundred_percent_of_a_severity() -> None:
    assert plain(mechanisms.amount("passive_strip", main_of("passive_strip"), 0.9998)) == "99.98 %"


def main_of(mechanism: str) -> str:
    return next(iter(mechanisms._WORDS[mechanism].parameters))


def test_the_next_recording_is_a_sentence() -> None:
    d = diagnosis("ambiguous", next_recording="three voltage steps: tell drive_lag and slack apart")
    following = findings.what_next(Standing("P-07", None, None, None, d))
    assert following is not None
    assert plain(str(following.body)) == "Three voltage steps: tell “lag of the drive” and slack apart."


@pytest.mark.parametrize(
    ("proposed", "heading"), [(None, "What would tell them apart"), ("weights", "Next recording to make")]
)
def test_what_would_tell_causes_apart_is_said_where_no_recording_does(proposed: str | None, heading: str) -> None:
    d = diagnosis(
        "ambiguous", next_recording=proposed, would_tell=["drive_lag from slack: the phase at high frequencies"]
    )
    following = findings.what_next(Standing("P-07", None, None, None, d))
    assert following is not None
    assert following.title == heading
    assert plain(str(following.body)).endswith("“lag of the drive” from slack: the phase at high frequencies.")


@pytest.mark.parametrize(
    ("verdict", "more", "expected"),
    [
        (
            "ambiguous",
            {"mechanisms": ["cyclic_softening"], "also_possible": ["unlisted"]},
            "No recording is known that would tell. Begin with the likeliest: Cycle such films until they no longer change",
        ),
        ("unknown", {"stage": "contact", "depends_on": ["session_time"]}, "Look at the clamping of the film, at what depends on the"),
        ("unknown", {}, "Look at the recordings that the simulation misses most"),
    ],
)  # fmt: skip
def test_no_alarm_is_without_what_to_do(verdict: str, more: dict[str, object], expected: str) -> None:
    """A film that softened within one sweep was ambiguous with what is in no list, and nothing said where to begin."""
    d = diagnosis(verdict, **more)
    following = findings.what_next(Standing("P-07", None, None, None, d))
    assert following is not None
    assert following.title == "What to do"
    assert plain(str(following.body)).startswith(expected)
    assert explanations.tell_where_to_begin(d)[0] in plain(str(following.body))


def test_findings_without_a_neighbour_take_the_width() -> None:
    wide = Finding("w", (), "named", figure=Figure(Markup(""), ""))
    narrow = Finding("n", (), "named")
    assert Findings((narrow, wide, narrow, narrow, wide, narrow, narrow, narrow)).lone == {0, 7}


def test_remarks_on_groups_are_said_once_and_keep_the_names_of_groups() -> None:
    """`k1 (patch)` is the name of a group: it begins no sentence of its own, and no remark stands twice."""
    rows = [
        {"configuration": name, "voltage_kv": None, "warnings": warnings}
        for name, warnings in (
            ("case 1", "short; -3 s is left out"),
            ("case 2", "short; few"),
            ("case 3", "short; few"),
        )
    ]
    of = lives.Lives(3, 3, 10.0, [], [], rows, [], [], [], {})
    assert lives._remarks(of) == ["Short.", "case 1: −3 s is left out.", "case 2 and case 3: few."]


def test_lives_of_one_design_are_told_by_their_law_and_medians() -> None:
    """It was "29 of 36 specimens failed" where an exponent and medians are what a laboratory asks for."""
    rows = [
        {
            "configuration": "B",
            "voltage_kv": volts,
            "median_s": median,
            "median_s_lower": median / 2,
            "median_s_upper": upper,
        }
        for volts, median, upper in ((4.0, 432000.0, None), (5.0, 57600.0, 97200.0))
    ]
    law = {"configuration": "B", "exponent": -9.393, "exponent_lower": -12.03, "exponent_upper": -7.162}
    of = lives.Lives(36, 29, 576000.0, [], [], rows, [], [], [], {}, [law])
    told = "29 of 36 specimens failed; life goes with the voltage to the power −9.4 (−12.0 to −7.2)"
    assert lives.headline(of).replace("\u00a0", " ") == told
    assert lives.support(of).replace("\u00a0", " ") == (
        "Median life, 95 % interval: 4 kV 120 (≥ 60) h; 5 kV 16 (8–27) h."
    )
    assert index.headline([], [("B", of)], {("ok", True): 2}) == lives.headline(of)
    assert lives.support(replace(of, summaries=[])) == ""


def test_the_cause_of_a_doubtful_specimen_is_not_the_only_one() -> None:
    assert specimens._causes(["slack", "drive_lag"], "ambiguous") == "Slack film + lag of the drive, or others"
    assert specimens._causes(["slack"], "named") == "Slack film"
    assert specimens._known(1.8e-17, None, "none") == "unresolved"
    assert plain(specimens._known(0.42, 0.028, "named")) == "0.420 ± 0.028 †"
    assert plain(specimens._known(0.42, 0.028, None)) == "0.420 ± 0.028"


def test_smallest_effects_stand_open_only_where_they_are_the_evidence() -> None:
    table = Table("Smallest effects", (Head("Cause"),), tuple(Row((str(i),)) for i in range(20)))
    assert diagnosis_page._told_by(table, "none") is table
    folded = diagnosis_page._told_by(table, "named")
    assert isinstance(folded, Fold)
    assert folded.summary == "Smallest effects: 20 causes"
    short = Table("Smallest effects", table.heads, table.rows[:3])
    assert diagnosis_page._told_by(short, "named") is short


def test_named() -> None:
    d = diagnosis(
        "named", mechanism="sensor_delay", mechanisms=["sensor_delay"], gain=0.97,
        severity=json.dumps({"sensor_delay": {"delay_s": {"value": 87e-6, "sd": 5e-6}, "channel": "force"}}),
    )  # fmt: skip
    text = plain(findings.headline(Standing("P-07", None, None, None, d)).striptags())
    assert (
        text
        == "Specimen P-07: the force channel is late, by 87 ± 5 µs. Correcting it removes 97 % of the squared held-out error"
        " beyond the noise."
    )


def test_a_gain_says_of_what_it_is_a_share() -> None:
    """From 2200 to 530 times the noise is 76 % of the error, and 94 % of its square, which is what the gain is of."""
    before, after, size = 2200.0, 530.0, 156
    share = held_out._compute_gain(size * before**2, size * after**2, size)
    assert float(share) == pytest.approx(0.942, abs=5e-4)
    d = diagnosis(
        "named", mechanism="slack", mechanisms=["slack"], gain=float(share), gain_lower=0.82, gain_upper=0.97,
        held_out_error_before=before, held_out_error_after=after,
    )  # fmt: skip
    said = plain(findings.evidence(Standing("P-07", None, None, None, d))[-1])
    assert said.endswith("Gain: 94 % (95 % interval 82 % to 97 %) of the squared error beyond the noise.")
    terminal = " ".join(plain(line) for line in show._describe_gain(d))
    assert "removes 94 % (95 % interval 82 % to 97 %) of the squared error beyond the noise" in terminal
    d |= {"gain_lower": -0.1}
    assert "of the squared error beyond the noise." in plain(
        findings.evidence(Standing("P-07", None, None, None, d))[-1]
    )
    assert "of the squared error beyond the noise." in " ".join(plain(line) for line in show._describe_gain(d))


def test_specimens_that_have_a_diagnosis_and_no_model_are_not_counted_with_one() -> None:
    fit = {"model_order": 1}
    fitted, other = Standing("A", None, None, fit, None), Standing("B", None, None, None, diagnosis("named"))
    assert campaign.count_models([fitted, fitted]) == "Two specimens with a model"
    assert campaign.count_models([fitted, fitted, other]) == "Three specimens, two with a model"
    assert campaign.count_models([other]) == "One specimen, none with a model"
    [left] = campaign._tell_undrawn([fitted, other], {"A"})
    assert plain(left.body).endswith("a frequency response: B.")
    assert campaign._tell_undrawn([fitted], {"A"}) == []


@pytest.mark.parametrize(("groups", "sites"), [(2, 2), (5, 4), (8, 4)])
def test_causes_have_no_colours_of_the_groups_beside_them(
    groups: int, sites: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beyond six of both together the colours came again, and a cause looked like a group."""
    rows = [
        {"configuration": f"g{group}", "voltage_kv": 7.5, "failure_site": f"s{site}", "time_s": t, "failures": 1,
         "probability": 0.1 * t, "lower_95": None, "upper_95": None}
        for group in range(groups) for site in range(sites) for t in (1.0, 2.0)
    ]  # fmt: skip
    drawn: list[Any] = []
    monkeypatch.setattr(causes, "draw_incidence", lambda panels, *_, **__: drawn.extend(panels) or Markup(""))
    draft = SimpleNamespace(item="c", results=SimpleNamespace(rows=lambda _: rows), data=lambda *_: "")
    labels = {(f"g{group}", 7.5): f"g{group}" for group in range(groups)}
    assert causes.incidence(cast(Any, draft), 1.0, labels, "Time") is not None
    used = {one.drawn for _, panel in drawn for one in panel}
    assert len(used) == sites
    beside = {palette.group(i) for i in range(groups)}
    for look in (lambda g: (g.colour, g.dash), lambda g: g.marker, lambda g: g.sign):
        assert len({look(g) for g in used | beside}) == groups + sites


def test_what_is_beside_causes_that_are_certain_is_no_alternative_to_them() -> None:
    d = diagnosis(
        "ambiguous", mechanism="slack", mechanisms=["slack"], also_possible=["unlisted"],
        probabilities='{"slack": 0.01, "slack+film/frequency": 0.99}',
    )  # fmt: skip
    assert explanations.has_unnamed_beside(d)
    assert explanations.cause(d).endswith(", and something that is in no list acts beside that")
    assert " or " not in explanations.cause(d)
    instead = {**d, "probabilities": '{"slack": 0.4, "film/frequency": 0.6}'}
    assert not explanations.has_unnamed_beside(instead)
    assert not explanations.has_unnamed_beside({**d, "probabilities": None})


def test_ambiguous_names_all_and_unknown_names_none() -> None:
    d = diagnosis("ambiguous", mechanism="slack", mechanisms=["slack"], also_possible=["strain_stiffening"])
    text = plain(findings.headline(Standing("P-11", None, None, None, d)))
    assert "slack" in text
    assert "stiffens" in text
    doubtful = diagnosis("ambiguous", mechanism="slack", mechanisms=["slack"], also_possible=["unlisted"])
    assert "or the cause is in no list" in plain(findings.headline(Standing("P-12", None, None, None, doubtful)))
    unknown = plain(findings.headline(Standing("G-03", None, None, None, diagnosis("unknown"))))
    assert "none of the 23 listed causes" in unknown


def test_what_is_fitted_to_wrong_recordings_is_no_film() -> None:
    fit = {"model_order": 1, "k0_n_per_mm": 0.4, "k0_n_per_mm_sd": 0.01, "reduced_chi2": 1.0}
    wrong = diagnosis("named", mechanism="unit_slip", mechanisms=["unit_slip"], stage="record")
    right = diagnosis("named", mechanism="slack", mechanisms=["slack"], stage="contact")
    said = [str(findings.lede(Standing("P-07", None, None, fit, d))) for d in (wrong, right)]
    assert "Put that right first" in said[0]
    assert "The film itself" not in said[0]
    assert "The film itself" in said[1]


@pytest.mark.parametrize("text", [None, "", "not json", "[1]", '{"a": 1}', '{"a": null}'])
def test_broken_severity_is_no_error(text: str | None) -> None:
    d = diagnosis("named", mechanism="slack", mechanisms=["slack"], severity=text)
    assert "slack" in plain(findings.headline(Standing("P-07", None, None, None, d)))


def test_survival_title_says_who_lives_longer() -> None:
    comparison = {"configuration_a": "single", "configuration_b": "divided", "voltage_kv": 7.5}
    summary = {"voltage_kv": 7.5, "specimens": 20}
    groups = [
        {**summary, "configuration": "single", "failures": 20, "restricted_mean_s": 40.0},
        {**summary, "configuration": "divided", "failures": 16, "restricted_mean_s": 200.0},
    ]
    assert findings.survival_title(comparison, groups) == "“divided”: 5.0 times the mean life of “single”"
    # up to when both were watched most of the longer lives have not ended: the medians say more
    groups[0] |= {"median_s": 40.0, "restricted_to_s": 120.0}
    groups[1] |= {"median_s": None, "restricted_to_s": 120.0}
    said = findings.survival_title(comparison, groups).replace("\u00a0", " ")
    assert said == "“divided”: 5.0 times the mean life, up to 2 min, of “single”"
    groups[1] |= {"median_s": 300.0}
    assert findings.survival_title(comparison, groups) == "“divided”: 7.5 times the median life of “single”"
    groups[1] |= {"failures": 0, "restricted_mean_s": 240.0}
    assert findings.survival_title(comparison, groups) == "“divided”: none of 20 failed; “single”: 20 of 20"


def test_constants_that_left_their_file_are_said() -> None:
    fit = {
        **dict.fromkeys(TABLES["model_fits"].names), "model_order": 3, "load_cell_stiffness_n_per_mm": 21.16,
        "load_cell_stiffness_n_per_mm_sd": 0.02, "clamp_mass_kg": 0.1873, "clamp_mass_kg_sd": 1e-4,
    }  # fmt: skip
    stated = {
        "load_cell_stiffness_n_per_mm": "20.2", "load_cell_stiffness_n_per_mm_sd": "0.3", "clamp_mass_kg": "0.188",
        "clamp_mass_kg_sd": "0.002",
    }  # fmt: skip
    said = findings.remarks(Standing("PA-3", None, None, fit, None, stated))
    assert [plain(s) for s in said] == [
        "The fit finds the load cell at 21.160 ± 0.020 N/mm where its file says 20.2 ± 0.3 N/mm: 3.2 SD apart."
    ]
    assert findings.remarks(Standing("PA-3", None, None, fit, None)) == ()


def test_a_pair_is_named_in_the_order_of_its_difference() -> None:
    """`B against A` beside a difference B less A: who lives shorter stands before a minus."""
    long_lives, short_lives = ((np.array(t), np.ones(3, dtype=bool)) for t in ([95.0, 99.0, 90.0], [9.0, 12.0, 20.0]))
    for (first, a), (second, b) in itertools.permutations((("divided", long_lives), ("single", short_lives))):
        compared = comparisons.compare(first, a, second, b, 7.5, 100.0)
        rows = [asdict(c) | {"statistic_lower": c.lower, "statistic_upper": c.upper, "p_value_holm": None, "warnings": ""} for c in compared]  # fmt: skip
        of = lives.Lives(6, 6, 99.0, [], [], [], rows, [], [], {"comparisons": Query("SELECT 1\nORDER BY test")})
        main = next(b for b in lives._comparisons(of) if isinstance(b, Table))
        difference = {str(r.cells[0]): str(r.cells[2]) for r in main.rows if "mean" in str(r.cells[1])}
        assert list(difference) == [f"{second} against {first}"]
        assert difference[f"{second} against {first}"].startswith("−") == (second == "single")
        assert "the first less the second" in str(main.below)


def test_exact_tests_are_believed_before_asymptotic_ones() -> None:
    rows = [
        {"test": "log-rank", "p_value": 1e-6, "configuration_a": "a", "configuration_b": "b"},
        {"test": "log-rank, exact permutation", "p_value": 1e-5, "configuration_a": "a", "configuration_b": "b"},
        {"test": "hazard ratio", "p_value": None, "configuration_a": "a", "configuration_b": "b"},
    ]
    assert decisive(rows) is rows[1]
    assert decisive([]) is None


@pytest.mark.parametrize(
    ("stored", "why", "remedy"),
    [
        (
            "force: unit is mA; expected a force. Correct the unit",
            "force: unit is mA; expected a force.",
            "Correct the unit.",
        ),
        ("value 0.5 is too large", "value 0.5 is too large", ""),
        (None, "no reason is recorded", ""),
    ],
)
def test_reason_and_remedy(stored: str | None, why: str, remedy: str) -> None:
    assert reason(stored) == (why, remedy)


def test_a_night_that_makes_what_is_known_again_says_so() -> None:
    """After an update nothing is new and nothing is reused: the files found must be somewhere in the tally all the same."""
    run = {"ingested": 230, "quarantined": 2, "duplicates": 1, "reused": 0, "pending": 0, "unmapped": 0, "failed": 0}
    known = {("ok", False): 229, ("damaged", False): 1, ("quarantined", False): 2, ("duplicate", False): 1}
    found = {c.text: c.number for c in tally(run, known)}
    assert (found["known, made again"], found["✕ refused"]) == ("230", "2")
    new = {(status, True): count for (status, _), count in known.items()}
    assert "known, made again" not in {c.text for c in tally(run, new)}


@pytest.mark.parametrize(
    ("chosen", "p", "heading"),
    [
        (3, 0.009, "Third order is chosen, the highest that was fitted; a fourth would fit better still (p = 0.0090)"),
        (3, 0.3, "A fourth relaxation is not shown (p = 0.30, level 0.01)"),
        (3, None, "Third order is chosen, the highest that was tried; a fourth was not tested"),
        (2, 0.3, "A third relaxation is not shown (p = 0.30, level 0.01)"),
    ],
)
def test_no_order_is_the_last_only_because_nobody_tried_on(chosen: int, p: float | None, heading: str) -> None:
    """ "The highest that was tried" stood beside p = 0.009 for the next."""
    fits = [
        {
            "model_order": n,
            "loading": "mechanical",
            "method": "forward",
            "weighting": "noise",
            "extension": "",
            "order_p_value": p,
            "choices": None,
        }
        for n in (1, 2, 3)
    ]
    assert plain(models._order_heading(fits, fits[chosen - 1])) == heading
    told = models._tell_next(fits, fits[chosen - 1])
    assert told.startswith("The fourth order has no row") if p else not told


def test_the_title_of_an_order_tells_the_rules_that_would_choose_another() -> None:
    """ "Would gain nothing" stood over a table in which BIC chose the next order, and χ² fell by it."""
    fit = {
        "model_order": 2,
        "loading": "mechanical",
        "method": "forward",
        "weighting": "noise",
        "extension": "",
        "order_p_value": 0.022,
    }
    one = fit | {"choices": '{"test": 2, "bic": 3, "held_out": 2}'}
    both = fit | {"choices": '{"test": 2, "bic": 3, "held_out": 3}'}
    fits = [fit, fit | {"model_order": 3}]
    title = "A third relaxation is not shown (p = 0.022, level 0.01); {} would choose order 3"
    assert plain(models._order_heading(fits, one)) == title.format("BIC")
    assert plain(models._order_heading(fits, both)) == title.format("BIC and held-out error")
    assert models._rules(one).endswith("held-out error: 2. The test decides, at the level 0.01.")
    assert "decides" not in models._rules(one | {"order_p_value": None})


def test_what_is_not_determined_is_said_to_be_so() -> None:
    """A delay of (0.0 ± 1.2) × 10¹⁰ µs is no delay that was found: hours are longer than any sensor takes."""
    assert mechanisms.candidate("sensor_delay", 1e-7, 11853.0) == "unresolved"
    assert plain(mechanisms.candidate("sensor_delay", 1e-7, 5e-6)) == "0 ± 5 µs"
    assert mechanisms.candidate("slack", 0.4, 400.0) == "unresolved"


def test_places_that_are_not_listed_are_counted() -> None:
    """52 places were wrong, 6 and 34 were shown, and nothing said where the other 12 are."""
    rows = [
        {
            "recording_id": "r",
            "where_found": "w",
            "chi2": 1e6,
            "degrees_of_freedom": 1.0,
            "p_value": 0.0,
            "statement": f"{i}",
        }
        for i in range(52)
    ]
    site = SimpleNamespace(recording=str)
    for count, title in ((52, "The next 34 places; 12 more in the table discrepancies"), (7, "The next 1 place")):
        results = SimpleNamespace(rows=lambda q, n=count: rows[:n] if "discrepancies" in q.sql else [], columns=lambda _: {"frequency_hz": np.array([])})  # fmt: skip
        draft = SimpleNamespace(item="s", results=results, site=site)
        found = diagnosis_page._wrong(cast(Any, draft), cast(Any, diagnosis("named")))
        [fold] = [b for b in found if isinstance(b, Fold)]
        assert plain(fold.summary) == title


def test_a_kind_of_test_is_told_with_the_name_of_its_protocol() -> None:
    row = {"protocol": "step", "loading": "mechanical", "kind": "recording"}
    assert Markup(campaign._protocol(row)).striptags() == "Stress relaxation step"


def test_a_film_that_keeps_its_force_does_not_relax() -> None:
    time = np.array([0.03, 1.0, 4.6])
    kept = relaxing.Course("r", time, np.array([0.2512, 0.2470, 0.2462]), None)
    falls = relaxing.Course("r", time, np.array([1.5, 0.8, 0.41]), None)
    assert plain(relaxing._heading([kept])) == "The film keeps 0.25 N/mm from 0.03 to 4.6 s after the step"
    assert plain(relaxing._heading([falls])) == "The film relaxes from 1.5 to 0.41 N/mm in 0.03 to 4.6 s"


def test_a_night_with_nothing_new_still_tells_of_what_stands_refused() -> None:
    """The exit status is 3 for a file that was refused the night before; the index said "all done" beside it."""
    run = dict.fromkeys(TABLES["runs"].names) | {
        "found": 3, "ingested": 0, "quarantined": 1, "damaged": 0, "duplicates": 0, "reused": 3, "pending": 0, "unmapped": 0,
        "failed": 0, "without_result": 0,
    }  # fmt: skip
    found = {c.text: c.number for c in tally(run, {("ok", False): 2, ("quarantined", False): 1})}
    assert (found["✕ refused"], found["unchanged, reused"]) == ("1", "3")
    assert "known, made again" not in found
    assert plain(end_in_words(run)) == "done, 1 refused"
    assert plain(end_in_words(run | {"damaged": 2, "failed": 1})) == "done, 1 refused, 2 damaged and 1 analysis failed"
    assert plain(end_in_words(run | {"quarantined": 0})) == "all done"


def with_stiffness(verdict: str, extension: dict[str, object] | None) -> str:
    fit = dict.fromkeys(TABLES["model_fits"].names) | {
        "model_order": 3, "k0_n_per_mm": 0.42, "k0_n_per_mm_sd": 0.028, "reduced_chi2": 1.0,
    }  # fmt: skip
    d = diagnosis(verdict, mechanisms=["amplitude_softening"] if verdict == "named" else [])
    return plain(cast(Markup, findings.lede(Standing("P-07", None, None, fit, d, extension=extension))).striptags())


def test_a_stiffness_of_a_model_that_is_not_right_does_not_stand_alone() -> None:
    with_cause: dict[str, object] = {"k0_n_per_mm": 0.46, "k0_n_per_mm_sd": 0.003}
    assert "0.420 ± 0.028 N/mm without the cause and 0.460 ± 0.003 N/mm with it;" in with_stiffness("named", with_cause)
    same: dict[str, object] = {"k0_n_per_mm": 0.4201, "k0_n_per_mm_sd": 0.0281}
    assert "0.420 ± 0.028 N/mm with the cause and without it;" in with_stiffness("named", same)
    assert "0.420 ± 0.028 N/mm as far as the plain model goes;" in with_stiffness("unknown", None)
    assert "0.420 ± 0.028 N/mm; reduced" in with_stiffness("none", None)


@pytest.mark.parametrize(("chi2", "expected"), [(150.0, False), (260.0, True), (None, False)])
def test_only_a_plain_model_beyond_the_noise_has_no_uncertainty(chi2: float | None, expected: bool) -> None:
    assert plain_beyond_noise(diagnosis("named", chi2=chi2, feature_count=156)) == expected


def permittivities(*rows: tuple[float | None, float, float]) -> list[dict[str, object]]:
    return [
        {"method": "sphs", "voltage_kv": at, "relative_permittivity_lower": low, "relative_permittivity_upper": high}
        for at, low, high in rows
    ]


def test_a_permittivity_of_all_sequences_that_is_not_that_of_one_voltage_is_said() -> None:
    said = plain(permittivity._tell_apart(permittivities((None, 4.71, 4.73), (5.0, 4.75, 4.78), (7.0, 4.72, 4.74))))
    assert said.startswith(" At 5 kV the permittivity is not that of the one fit")
    assert permittivity._tell_apart(permittivities((None, 4.71, 4.73), (7.0, 4.72, 4.74))) == ""
    assert permittivity._tell_apart(permittivities((5.0, 4.75, 4.78), (7.0, 4.72, 4.74))) == ""
