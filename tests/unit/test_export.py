"""Films in the terms of finite-element programs: every deck, read by its own rules, is the film that went in."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.cli import main
from pipeline.commands.export import _PROGRAMS
from pipeline.transform.prony import PROGRAMS, PronySeries, Wlf, write_deck
from schemas.arrays import Float
from schemas.errors import RefusedError
from tests.helpers.synthetic_lab import Story

TIMES = np.geomspace(1e-4, 1e3, 40)
Read = tuple[float, list[float], list[float], tuple[float, ...] | None]
"""Equilibrium Young's modulus, moduli of the terms, their times, law of the shifts."""


def numbers(text: str) -> list[float]:
    return [float(x) for x in text.split(",") if x.strip()]


def read_abaqus(deck: str) -> Read:
    lines = [line for line in deck.splitlines() if not line.startswith("**")]
    at = {line.split(",")[0]: i for i, line in enumerate(lines) if line.startswith("*")}
    c10, compressibility = numbers(lines[at["*HYPERELASTIC"] + 1])
    assert "MODULI=INSTANTANEOUS" in lines[at["*HYPERELASTIC"]]
    assert compressibility == 0.0
    end = at.get("*TRS", len(lines))
    terms = [numbers(line) for line in lines[at["*VISCOELASTIC"] + 1 : end]]
    assert all(bulk == 0.0 for _, bulk, _ in terms)
    whole = 6 * c10  # E = 3 G, G = 2 C10
    law = tuple(numbers(lines[at["*TRS"] + 1])) if "*TRS" in at else None
    moduli = [whole * share for share, _, _ in terms]
    return whole - sum(moduli), moduli, [t for *_, t in terms], law


def read_ansys(deck: str) -> Read:
    tables: dict[str, list[float]] = {}
    heads: dict[str, list[str]] = {}
    for line in deck.splitlines():
        words = line.split(",")
        if words[0] == "TB":
            tables[words[1]], heads[words[1]] = [], words
        elif words[0] == "TBDATA":
            own = tables[list(tables)[-1]]
            assert int(words[1]) == len(own) + 1
            assert len(words) <= 8
            own += [float(x) for x in words[2:]]
    whole = 3 * tables["HYPER"][0]
    pairs = np.reshape(tables["PRONY"], (-1, 2))
    assert int(heads["PRONY"][4]) == len(pairs)
    moduli = list(whole * pairs[:, 0])
    law = tuple(tables["SHIFT"]) if "SHIFT" in tables else None
    return whole - sum(moduli), moduli, list(pairs[:, 1]), law


def read_comsol(deck: str) -> Read:
    known = {m[1]: float(m[2]) for m in re.finditer(r"^(\w+) (\S+?)(?:\[\w+\])? \"", deck, re.M)}
    count = sum(name.startswith("tau_") for name in known)
    law = (known["T_WLF"], known["C1_WLF"], known["C2_WLF"]) if "T_WLF" in known else None
    moduli = [3 * known[f"G_{i}"] for i in range(1, count + 1)]
    return 3 * known["G_inf"], moduli, [known[f"tau_{i}"] for i in range(1, count + 1)], law


def read_ls_dyna(deck: str) -> Read:
    lines = [line for line in deck.splitlines() if not line.startswith("$")]
    assert lines[0] == "*MAT_GENERAL_VISCOELASTIC_TITLE"
    card = lines[2].split(",")
    terms = [numbers(line) for line in lines[4:]]
    assert terms[0][1] == 0.0
    law = tuple(float(x) for x in card[5:8]) if len(card) > 3 else None
    return 3 * terms[0][0], [3 * g for g, _ in terms[1:]], [1 / beta for _, beta in terms[1:]], law


def read_json(deck: str) -> Read:
    found = json.loads(deck)
    law = None if found["wlf"] is None else tuple(found["wlf"][k] for k in ("reference", "c1", "c2"))
    terms = found["terms"]
    return (
        found["equilibrium_youngs_modulus"],
        [t["youngs_modulus"] for t in terms],
        [t["relaxation_time"] for t in terms],
        law,
    )


READERS: dict[str, Callable[[str], Read]] = {
    "abaqus": read_abaqus,
    "ansys": read_ansys,
    "comsol": read_comsol,
    "ls-dyna": read_ls_dyna,
    "json": read_json,
}


def relax(equilibrium: float, moduli: list[float], times: list[float]) -> Float:
    return np.asarray(equilibrium + sum(e * np.exp(-TIMES / t) for e, t in zip(moduli, times, strict=True)))


positive = st.floats(1e-4, 1e4)
terms_of = st.lists(st.tuples(positive, positive), min_size=1, max_size=30)
laws = st.none() | st.builds(Wlf, st.floats(-100, 200), st.floats(1, 30), st.floats(20, 200))


@pytest.mark.long_after(2)
@pytest.mark.parametrize("program", READERS)
@given(equilibrium=positive, terms=terms_of, law=laws)
def test_a_deck_is_the_film_that_went_in(
    program: str, equilibrium: float, terms: list[tuple[float, float]], law: Wlf | None
) -> None:
    moduli_in, times_in = tuple(e for e, _ in terms), tuple(t for _, t in terms)
    series = PronySeries("PA-1 µ", equilibrium, moduli_in, times_in, ("fitted",), law)
    deck = write_deck(series, program)
    e, moduli, times, shift = READERS[program](deck)
    given_in = relax(equilibrium, list(moduli_in), list(times_in))
    assert relax(e, moduli, times) == pytest.approx(given_in, rel=1e-6, abs=1e-6 * series.instantaneous_mpa)
    assert shift == (None if law is None else pytest.approx((law.reference_c, law.c1, law.c2_k), rel=1e-9))
    if program != "json":
        assert deck.isascii()


def test_a_film_without_a_spring_is_no_series() -> None:
    with pytest.raises(RefusedError, match="missing, zero or infinite"):
        PronySeries("x", 0.0, (1.0,), (1.0,))


def make_lab(folder: Path, **more: object) -> Path:
    """A lab with one film: k0 1 N/mm is 2 MPa; an arm of 1.5 N/mm that relaxes in 0.1 s."""
    story = Story()
    story.rows["model_fits"].append(
        {
            "specimen_id": "PA.1", "loading": "mechanical", "method": "forward", "weighting": "noise", "model_order": 1, "extension": "",
            "k0_n_per_mm": 1.0, "k1_n_per_mm": 1.5, "c1_n_s_per_mm": 0.15, "selected": True, "modulus_mpa": 2.0,
            "frequency_low_hz": 1.0, "frequency_high_hz": 100.0,
        } | more
    )  # fmt: skip
    return story.write(folder)


def test_the_fit_to_use_is_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lab = make_lab(tmp_path / "lab")
    assert main(["export", "PA.1", "--as", "csv", "--lab", str(lab)]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "term,youngs_modulus_mpa,shear_modulus_mpa,relaxation_time_s",
        "0,2,0.666666666667,",
        "1,3,1,0.1",
    ]
    deck = tmp_path / "film.inp"
    assert main(["export", "PA.1", "--as", "abaqus", "--out", str(deck), "--lab", str(lab)]) == 0
    assert "*MATERIAL, NAME=PA_1" in deck.read_text()


@pytest.mark.parametrize(("sd", "said"), [(0.01, False), (None, True)])
def test_a_long_term_modulus_that_is_not_resolved_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], sd: float | None, said: bool
) -> None:
    lab = make_lab(tmp_path / "lab", k0_n_per_mm_sd=sd)
    assert main(["export", "PA.1", "--as", "abaqus", "--lab", str(lab)]) == 0
    assert ("do not resolve the long-term modulus" in capsys.readouterr().out) == said


def test_a_master_curve_is_written_in_the_moduli_of_its_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    story = Story()
    for term, tau, modulus in ((0, None, 2.0), (1, 5.0, 3.0), (2, 0.5, 4.0)):
        story.rows["prony_series"].append(
            {
                "specimen_id": "R", "model_order": 2, "term": term, "tau_s": tau, "modulus": modulus, "unit": "kPa",
                "enough": True,
            }
        )  # fmt: skip
    lab = story.write(tmp_path / "lab")
    assert main(["export", "R", "--as", "csv", "--lab", str(lab)]) == 2
    assert "--modulus young or --modulus shear" in capsys.readouterr().err
    assert main(["export", "R", "--as", "csv", "--modulus", "shear", "--lab", str(lab)]) == 0
    assert capsys.readouterr().out.splitlines()[1:] == [
        "0,0.006,0.002,",
        "1,0.009,0.003,5",
        "2,0.012,0.004,0.5",
    ]


@pytest.mark.parametrize(
    ("more", "arguments", "said"),
    [
        ({}, ["PA-2"], 'there is no model of "PA-2"'),
        ({"modulus_mpa": None}, ["PA.1"], "known in N/mm alone"),
        ({"k1_n_per_mm": None}, ["PA.1"], "pure damper"),
        ({}, ["PA.1", "--modulus", "shear"], "the springs of PA.1 are in N/mm"),
    ],
)
def test_what_is_missing_is_said(
    more: dict[str, object], arguments: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lab = make_lab(tmp_path / "lab", **more)
    assert main(["export", *arguments, "--as", "ansys", "--lab", str(lab)]) == 2
    assert said in capsys.readouterr().err


def test_programs_that_are_offered_are_those_that_are_written() -> None:
    """The command names them without importing what writes them."""
    assert tuple(PROGRAMS) == _PROGRAMS
