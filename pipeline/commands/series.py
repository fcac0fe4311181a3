"""What a lab knows of a film as a Prony series: its master curve where there is one, else the fit to use."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pipeline.lab.lab import Lab
from schemas.alike import ask_meant
from schemas.errors import UsageError
from schemas.numbers import is_usable

if TYPE_CHECKING:
    from pipeline.transform.prony import PronySeries

_YOUNG, _SHEAR = "young", "shear"


def read_series(lab: Lab, specimen: str, modulus: str | None) -> PronySeries:
    """The film that the lab knows of a specimen: its master curve where there is one, else the fit to use.

    Parameters
    ----------
    modulus : `young` or `shear`, what the moduli of a file are; asked for where the series is in them

    Raises
    ------
    UsageError : there is no such specimen or no model of it, or something is missing that makes a modulus of it
    """
    from pipeline.lab.query import Query
    from pipeline.lab.reader import Reader

    with Reader(lab.require_database()) as reader:
        terms = reader.rows("prony_series", None, "specimen_id", [specimen], "enough AND modulus IS NOT NULL")
        if terms:
            laws = reader.rows("shift_laws", None, "specimen_id", [specimen], "selected AND law = 'WLF'")
            return _read_curve(specimen, terms, laws, modulus)
    with Query(lab) as query:
        models = query.run("SELECT * FROM best_models").to_pylist()
    fits = [row for row in models if row["specimen_id"] == specimen]
    if not fits:
        meant = ask_meant(specimen, [row["specimen_id"] for row in models])
        raise UsageError(
            f'there is no model of "{specimen[:80]}" in this lab{meant}',
            remedy=lab.spell_command('sql "SELECT specimen_id FROM best_models"') + " lists those with a model",
        )
    if modulus is not None:
        raise UsageError(
            "--modulus", expected=f"a series in the moduli of a file; the springs of {specimen} are in N/mm"
        )
    return _read_fit(specimen, fits[0])


def _read_fit(specimen: str, fit: dict[str, Any]) -> PronySeries:
    """Springs in N/mm as moduli: over the main spring's, which the database has as both."""
    from pipeline.transform.prony import PronySeries

    if fit["modulus_mpa"] is None:
        raise UsageError(
            f"the stiffness of {specimen} is known in N/mm alone",
            expected="the film's length, width, thickness and pre-stretch in the metadata of its recordings",
        )
    per = fit["modulus_mpa"] / fit["k0_n_per_mm"]
    arms = []
    for i in range(1, fit["model_order"] + 1):
        k, c = fit.get(f"k{i}_n_per_mm"), fit.get(f"c{i}_n_s_per_mm")
        if k is None or c is None:
            raise UsageError(
                f"an arm of {specimen} is a pure damper: it relaxes faster than the recordings can show",
                expected="a fit whose arms have a spring each",
            )
        arms.append((c / k, k * per))
    arms.sort(reverse=True)
    about: tuple[str, ...] = (
        f"Maxwell-Wiechert model of order {fit['model_order']}, {fit['loading']}, {fit['method']}; "
        f"fitted from {fit['frequency_low_hz']:.4g} to {fit['frequency_high_hz']:.4g} Hz",
        "Moduli are incremental ones about the pre-stretch: stiffness times stretched length over stretched section.",
    )
    if not is_usable(fit["k0_n_per_mm_sd"]):
        about += ("The recordings do not resolve the long-term modulus: no uncertainty is known of it.",)
    return PronySeries(specimen, fit["modulus_mpa"], tuple(e for _, e in arms), tuple(tau for tau, _ in arms), about)


def _read_curve(
    specimen: str, terms: list[dict[str, Any]], laws: list[dict[str, Any]], modulus: str | None
) -> PronySeries:
    """Terms of a master curve, in the unit of its file."""
    from pipeline.transform.prony import PronySeries, Wlf
    from schemas.units import conversion

    unit = terms[0]["unit"]
    if modulus is None:
        raise UsageError(
            f"the moduli of {specimen} are as its file has them, which may be Young's or shear moduli",
            expected=f"--modulus {_YOUNG} or --modulus {_SHEAR}",
        )
    per = conversion(unit, "MPa", where=specimen).scale * (3 if modulus == _SHEAR else 1)
    terms.sort(key=lambda t: t["term"])
    first, arms = terms[0], terms[1:]
    if first["term"] != 0 or any(t["tau_s"] is None for t in arms):
        raise UsageError(
            f"the series of {specimen} has no main spring, or a pure damper", expected="springs in all terms"
        )
    about: tuple[str, ...] = (
        f"Prony series of {len(arms)} terms of its master curve; moduli of the file are {modulus} moduli in {unit}",
    )
    shift = Wlf(laws[0]["reference_c"], laws[0]["c1"], laws[0]["c2_k"]) if laws else None
    moduli, times = tuple(t["modulus"] * per for t in arms), tuple(t["tau_s"] for t in arms)
    return PronySeries(specimen, first["modulus"] * per, moduli, times, about, shift)
