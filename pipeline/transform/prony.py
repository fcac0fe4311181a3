"""A film as a Prony series, written in the terms of finite-element programs.

    E(t) = E∞ + Σ E_i e^{−t/τ_i}

Every program wants the same numbers in other words: shear moduli or shares of the instantaneous one, relaxation times or their inverses.
All decks are in N, mm, s and MPa; the film is incompressible, as elastomers nearly are: G = E/3.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from schemas.errors import RefusedError

_BULK_OVER_SHEAR = 2000.0
"""Bulk over shear modulus where a program cannot do without: a Poisson ratio of 0.49975."""
_DENSITY = 1e-9
"""Density in t/mm³ where a program cannot do without."""
_PER_LINE = 6
"""Constants on a TBDATA line."""


@dataclass(frozen=True)
class Wlf:
    """Law of the shifts over temperature: log10 a = −C1 (T − T0)/(C2 + T − T0), T0 in °C."""

    reference_c: float
    c1: float
    c2_k: float


@dataclass(frozen=True)
class PronySeries:
    """A film's relaxation modulus.

    Parameters
    ----------
    name : of the specimen
    equilibrium_mpa : Young's modulus after all relaxation, MPa
    moduli_mpa, times_s : Young's modulus MPa and relaxation time s of each term, longest first
    about : lines that say where it comes from
    shift : law over temperature; None where none was found
    """

    name: str
    equilibrium_mpa: float
    moduli_mpa: tuple[float, ...]
    times_s: tuple[float, ...]
    about: tuple[str, ...] = ()
    shift: Wlf | None = None

    def __post_init__(self) -> None:
        numbers = (self.equilibrium_mpa, *self.moduli_mpa, *self.times_s)
        if len(self.moduli_mpa) != len(self.times_s) or not all(np.isfinite(x) and x > 0 for x in numbers):
            raise RefusedError(
                "no Prony series: a modulus or a relaxation time is missing, zero or infinite",
                where=self.name,
                expected="a main spring, and arms with a spring and a damper each",
            )

    @property
    def instantaneous_mpa(self) -> float:
        """Young's modulus before all relaxation, MPa."""
        return self.equilibrium_mpa + sum(self.moduli_mpa)

    @property
    def shares(self) -> tuple[float, ...]:
        """Modulus of each term over the instantaneous one."""
        return tuple(e / self.instantaneous_mpa for e in self.moduli_mpa)


def write_deck(series: PronySeries, program: str) -> str:
    """The material in the terms of a program.

    Parameters
    ----------
    series : the film
    program : one of `PROGRAMS`

    Returns
    -------
    Text of an input file, ready to be included

    Notes
    -----
    abaqus: *HYPERELASTIC, NEO HOOKE with instantaneous moduli and *VISCOELASTIC, TIME=PRONY; ansys: TB,HYPER,,,,NEO and TB,PRONY with shares
    of the instantaneous modulus; comsol: parameters of a generalised Maxwell model; ls-dyna: *MAT_GENERAL_VISCOELASTIC (076).
    """
    return "\n".join(PROGRAMS[program](series)) + "\n"


def _abaqus(series: PronySeries) -> list[str]:
    terms = zip(series.shares, series.times_s, strict=True)
    lines = [
        *_comment("** ", series),
        f"*MATERIAL, NAME={_spell(series.name)}",
        "*HYPERELASTIC, NEO HOOKE, MODULI=INSTANTANEOUS",
        f"{series.instantaneous_mpa / 6:.12g}, 0.",
        "*VISCOELASTIC, TIME=PRONY",
        *(f"{share:.12g}, 0., {tau:.12g}" for share, tau in terms),
    ]
    if series.shift is not None:
        s = series.shift
        lines += ["*TRS, DEFINITION=WLF", f"{s.reference_c:.12g}, {s.c1:.12g}, {s.c2_k:.12g}"]
    return lines


def _ansys(series: PronySeries) -> list[str]:
    pairs = [x for pair in zip(series.shares, series.times_s, strict=True) for x in pair]
    lines = [
        *_comment("! ", series),
        "TB,HYPER,1,1,2,NEO",
        f"TBDATA,1,{series.instantaneous_mpa / 3:.12g},0",
        f"TB,PRONY,1,1,{len(series.times_s)},SHEAR",
        *(
            f"TBDATA,{first + 1}," + ",".join(f"{x:.12g}" for x in pairs[first : first + _PER_LINE])
            for first in range(0, len(pairs), _PER_LINE)
        ),
    ]
    if series.shift is not None:
        s = series.shift
        lines += ["TB,SHIFT,1,1,3,WLF", f"TBDATA,1,{s.reference_c:.12g},{s.c1:.12g},{s.c2_k:.12g}"]
    return lines


def _comsol(series: PronySeries) -> list[str]:
    lines = [*_comment("% ", series), f'G_inf {series.equilibrium_mpa / 3:.12g}[MPa] "Long-term shear modulus"']
    for number, e, tau in _number(series):
        lines.append(f'G_{number} {e / 3:.12g}[MPa] "Shear modulus of branch {number}"')
        lines.append(f'tau_{number} {tau:.12g}[s] "Relaxation time of branch {number}"')
    if series.shift is not None:
        s = series.shift
        lines.append(f'T_WLF {s.reference_c:.12g}[degC] "Reference temperature"')
        lines.append(f'C1_WLF {s.c1:.12g} "WLF constant C1"')
        lines.append(f'C2_WLF {s.c2_k:.12g}[K] "WLF constant C2"')
    return lines


def _ls_dyna(series: PronySeries) -> list[str]:
    bulk = _BULK_OVER_SHEAR * series.instantaneous_mpa / 3
    terms = [(e / 3, 1 / tau) for e, tau in zip(series.moduli_mpa, series.times_s, strict=True)]
    lines = [
        *_comment("$ ", series),
        f"$ Assumed, for it is not measured: density {_DENSITY:g} t/mm3; bulk modulus {_BULK_OVER_SHEAR:g} times the shear modulus.",
    ]
    shift = ""
    if series.shift is not None:
        lines.append("$ TREF, A, B: the law of Williams, Landel and Ferry.")
        s = series.shift
        shift = f",,,{s.reference_c:.12g},{s.c1:.12g},{s.c2_k:.12g}"
    return [
        *lines,
        "*MAT_GENERAL_VISCOELASTIC_TITLE",
        _spell(series.name),
        f"1,{_DENSITY:g},{bulk:.12g}{shift}",
        "",
        f"{series.equilibrium_mpa / 3:.12g},0.",
        *(f"{shear:.12g},{beta:.12g}" for shear, beta in terms),
    ]


def _csv(series: PronySeries) -> list[str]:
    rows = [(0, series.equilibrium_mpa, ""), *((i, e, f"{tau:.12g}") for i, e, tau in _number(series))]
    return [
        "term,youngs_modulus_mpa,shear_modulus_mpa,relaxation_time_s",
        *(f"{i},{e:.12g},{e / 3:.12g},{tau}" for i, e, tau in rows),
    ]


def _json(series: PronySeries) -> list[str]:
    shift = series.shift
    found = {
        "name": series.name,
        "about": list(series.about),
        "units": {"modulus": "MPa", "time": "s", "temperature": "degC"},
        "equilibrium_youngs_modulus": series.equilibrium_mpa,
        "instantaneous_youngs_modulus": series.instantaneous_mpa,
        "terms": [{"youngs_modulus": e, "share": e / series.instantaneous_mpa, "relaxation_time": tau}
                  for _, e, tau in _number(series)],
        "wlf": None if shift is None else {"reference": shift.reference_c, "c1": shift.c1, "c2": shift.c2_k},
    }  # fmt: skip
    return [json.dumps(found, indent=2, ensure_ascii=False)]


def _number(series: PronySeries) -> list[tuple[int, float, float]]:
    return [(i, e, tau) for i, (e, tau) in enumerate(zip(series.moduli_mpa, series.times_s, strict=True), 1)]


def _comment(sign: str, series: PronySeries) -> list[str]:
    """Comment lines, of signs that every program can read."""
    said = [f"{series.name}: Prony series; N, mm, s, MPa, t", *series.about]
    if series.shift is None:
        said.append("No law of the shifts over temperature is known.")
    return [sign + line.encode("ascii", "replace").decode() for line in said]


def _spell(name: str) -> str:
    """A name of letters, digits and underscores that begins with a letter."""
    kept = "".join(c if c.isascii() and c.isalnum() else "_" for c in name)
    return kept if kept[:1].isalpha() else f"M_{kept}"


PROGRAMS: Mapping[str, Callable[[PronySeries], Sequence[str]]] = {
    "abaqus": _abaqus,
    "ansys": _ansys,
    "comsol": _comsol,
    "ls-dyna": _ls_dyna,
    "csv": _csv,
    "json": _json,
}
"""What writes a film for each program, and as a table."""
