"""What each figure and table of the thesis states, where the report answers it, and the query or function of that answer.

A query gives one row: value, lower and upper limit (95 %), NULL where there is none. A function gives the same. `thesis` is the printed
number and `accuracy` how well it is known: as stated, else as it can be read from the figure or the text (0: to its last digit). `why` says why ours may differ, or what
the entry is where nothing is to be computed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pipeline.physics.film import RelaxationModel
from pipeline.physics.hyperelastic import principal_tangent
from pipeline.physics.regions import apart, beside, circular
from pipeline.physics.thickness.film import RodFilm
from pipeline.physics.thickness.layout import separate_regions, single_region

Value = tuple[float | None, float | None, float | None]


@dataclass(frozen=True)
class Statement:
    """One number of the thesis, or a picture without one (`thesis` None)."""

    where: str
    what: str
    page: str
    answer: str | Callable[[], Value] | None
    thesis: float | None = None
    accuracy: float = 0.0
    unit: str = ""
    why: str = ""


CAMPAIGN = "campaigns/thesis.html"
FAILURES = "failures/thesis.html"
FORCES = "forces/thesis.html"
CHECKS = "checks/thesis.html"
_CASES = {
    1: "case 1: single electrode",
    2: "case 2: divided electrode",
    3: "case 3: divided electrode, contact outside",
}


def _picture(where: str, what: str, page: str, why: str) -> Statement:
    return Statement(where, what, page, None, why=why)


def _summary(case: int, column: str) -> str:
    return (
        f"SELECT {column}, {column}_lower, {column}_upper FROM survival_summaries"
        f" WHERE configuration = '{_CASES[case]}' AND voltage_kv = 7.5"
    )


def _survival(case: int, at: float) -> str:
    return f"SELECT survival, lower_95, upper_95 FROM survival_at({at:g}) WHERE configuration = '{_CASES[case]}'"


def _life(case: int, value: str) -> str:
    return f"SELECT {value}, NULL, NULL FROM lifetimes WHERE configuration = '{_CASES[case]}'"


def _share(case: int, condition: str) -> str:
    return (
        f"SELECT avg(({condition})::INT), NULL, NULL FROM lifetimes WHERE configuration = '{_CASES[case]}' AND failed"
    )


def _force(specimen: str, direction: int, stretch: float = 3.0) -> str:
    return (
        "SELECT force_n, force_n - 2.776 * force_sd_n / sqrt(repeats), force_n + 2.776 * force_sd_n / sqrt(repeats) FROM force_maps"
        f" WHERE specimen_id = '{specimen}' AND direction = {direction} AND stretch_2 = {stretch:g}"
    )


def _forces(configuration: str) -> str:
    return (
        "SELECT avg(force_n), avg(force_n) - 1.96 * stddev(force_n) / sqrt(count(*)), avg(force_n) + 1.96 * stddev(force_n) / sqrt(count(*))"
        f" FROM force_maps WHERE configuration = '{configuration}' AND direction = 1 AND stretch_2 = 3"
    )


def _ratio(other: str) -> str:
    return f"SELECT ratio, ratio_lower, ratio_upper FROM force_comparisons WHERE configuration_b = '{other}' AND direction = 1"


def _region(region: str, what: str) -> str:
    return f"SELECT {what}, {what}_lower, {what}_upper FROM weak_regions WHERE configuration = '{_CASES[1]}' AND region = '{region}'"


def _layout(case: int, what: str) -> str:
    return f"SELECT {what}, NULL, NULL FROM electrode_layouts WHERE configuration = '{_CASES[case]}' AND scheme = 'continuous'"


def _fit(specimen: str, order: int, column: str, weighting: str = "relative") -> str:
    """A parameter or an error of a corrected fit; weights as in the tables of the thesis: every line in equal shares."""
    limits = f"{column} - 1.96 * {column}_sd, {column} + 1.96 * {column}_sd"
    if "error" in column:
        limits = "NULL, NULL"
    return (
        f"SELECT {column}, {limits} FROM model_fits WHERE specimen_id = '{specimen}' AND loading = 'mechanical' AND method = 'corrected'"
        f" AND weighting = '{weighting}' AND model_order = {order} AND coalesce(extension, '') = ''"
    )


def _order(specimen: str) -> str:
    return f"SELECT model_order, NULL, NULL FROM best_models WHERE specimen_id = '{specimen}'"


def _strain(amplitude: float, what: str) -> str:
    return (
        f"SELECT {what}, {what} - 1.96 * standard_error, {what} + 1.96 * standard_error FROM frequency_responses WHERE specimen_id = 'ST-1'"
        f" AND stage = 'corrected' AND abs(amplitude - {amplitude:g}) < 0.01 AND abs(frequency_hz - 5) < 0.1"
    )


def _at(specimen: str, hz: float, what: str) -> str:
    half = "1.96 * standard_error" if what == "magnitude" else "degrees(1.96 * standard_error / magnitude)"
    return (
        f"SELECT {what}, {what} - {half}, {what} + {half} FROM frequency_responses WHERE specimen_id = '{specimen}' AND stage = 'averaged'"
        f" AND loading = 'mechanical' ORDER BY abs(frequency_hz - {hz:g}) LIMIT 1"
    )


def _peak(specimen: str, loading: str) -> str:
    return (
        f"SELECT frequency_hz, NULL, NULL FROM frequency_responses WHERE specimen_id = '{specimen}' AND stage = 'measured' AND loading ="
        f" '{loading}' ORDER BY magnitude DESC LIMIT 1"
    )


def _under(specimen: str, order: int, what: str) -> str:
    return (
        f"SELECT avg({what}), min({what}), max({what}) FROM voltage_orders WHERE specimen_id = '{specimen}' AND model_order = {order} AND"
        " form = 'without_resonance'"
    )


def _step(specimen: str, column: str, volts: float, recording: str = "%") -> str:
    return (
        f"SELECT avg({column}), avg({column}) - 1.96 * stddev({column}) / sqrt(count(*)), avg({column}) + 1.96 * stddev({column}) / sqrt(count(*))"
        f" FROM step_responses WHERE specimen_id = '{specimen}' AND recording_id LIKE '{recording}' AND abs(voltage_kv - {volts:g}) < 0.3"
    )


def _sensing(specimen: str, column: str) -> str:
    return f"SELECT {column}, {column}_lower, {column}_upper FROM sensing_fits WHERE specimen_id = '{specimen}'"


def _loop(column: str, recording: str) -> str:
    return f"SELECT {column}, NULL, NULL FROM loop_responses WHERE recording_id = '{recording}'"


def _sheet(specimen: str, quantity: str) -> str:
    return f"SELECT value, value_lower, value_upper FROM specifications WHERE specimen_id = '{specimen}' AND quantity = '{quantity}'"


def _gain(what: str) -> str:
    return (
        f"SELECT avg({what}_gain), avg({what}_gain) - 1.96 * stddev({what}_gain) / sqrt(count(*)), avg({what}_gain) + 1.96 *"
        f" stddev({what}_gain) / sqrt(count(*)) FROM constraint_gains WHERE constrained_specimen = 'SS-1'"
    )


def _slope(region: Callable[[float], object]) -> Callable[[], Value]:
    def slope() -> Value:
        h = 1e-6
        return (float(np.asarray(region(1 + h)) - np.asarray(region(1 - h))) / (2 * h), None, None)

    return slope


def _end(k0: float, k: tuple[float, ...], c: tuple[float, ...], hz: float) -> Callable[[], Value]:
    """Magnitude of an example's stiffness at a frequency, N/mm, from springs and dampers."""
    model = RelaxationModel(k0, k, tuple(damper / spring for damper, spring in zip(c, k, strict=True)))
    return lambda: (float(np.abs(model.stiffness(np.array([hz]))[0])), None, None)


def _lost_area() -> Value:
    """Share of a single electrode that a divided one lacks, on the film with three rods."""
    film = RodFilm()
    whole, parts = (
        sum((r.x_high - r.x_low) * (r.y_high - r.y_low) for r in e)
        for e in (single_region(film), separate_regions(film))
    )
    return 1 - parts / whole, None, None


def _modulus(stretch: float, direction: int) -> Callable[[], Value]:
    def tangent() -> Value:
        return float(np.asarray(principal_tangent(stretch, 1.0)[direction])), None, None

    return tangent


_ITS_SPECIMENS = "the virtual specimens have lives drawn after the printed shares, not the thesis' own lives"
_UNSTATED = "the thesis does not state the frequencies that its means are over, nor how it weighted them"
_QUIET = "the virtual rig is quieter than the thesis' (its noise is not modelled above 70 Hz)"
_NEEDS = "no number is printed"

STATEMENTS: tuple[Statement, ...] = (
    Statement("section 1.3", "force that a tremor asks for, one layer at 7 kV", "specimens/PA-1.html#requirement", _sheet("PA-1", "force"), 0.4, unit="N", why="a requirement, not a result: one layer gives a part of it, the page says how many would do"),
    Statement("section 1.3", "stroke at 10 Hz", "specimens/PA-1.html#requirement", _sheet("PA-1", "stroke"), 1.0, unit="mm", why="a requirement: strips behind each other add their strokes, the page says how many would do"),
    Statement("section 1.3", "bandwidth of the polyacrylate film", "specimens/PA-1.html#requirement", _sheet("PA-1", "bandwidth"), 10.0, unit="Hz", why="a requirement; the film's own stiffening bounds its stroke earlier"),
    _picture("figure 3-1", "samples", CAMPAIGN + "#recordings", "a photograph; the specimens BX, RF, FS and FD stand for them"),
    Statement("figure 3-2", "area that the divided electrode loses", FAILURES + "#where", _lost_area, 0.20, 1e-6, why="2 × 8 mm of 20 mm: rods 10 mm apart, gap of 1 mm from their axes"),
    _picture("figure 3-3", "fabrication", CAMPAIGN + "#recordings", "a drawing"),
    Statement("figure 3-4", "breakdowns found in the voltage monitor, cases 1 and 2", CAMPAIGN + "#survival", f"SELECT count(*) FILTER (WHERE failed), NULL, NULL FROM lifetimes WHERE configuration IN ('{_CASES[1]}', '{_CASES[2]}') AND voltage_kv = 7.5", 36, why=_ITS_SPECIMENS),
    Statement("figure 3-5", "failures at the lead contact, case 1", FAILURES + "#where", f"SELECT count(*), NULL, NULL FROM lifetimes WHERE configuration = '{_CASES[1]}' AND failure_site = 'lead'", 1),
    Statement("figure 3-6", "force in direction 1 at (1.2, 3), 7 kV", "specimens/BX-1.html#force", _force("BX-1", 1), 0.35, 0.01, "N"),
    Statement("figure 3-6", "force in direction 2 at (1.2, 3), 7 kV", "specimens/BX-1.html#force", _force("BX-1", 2), 0.17, 0.01, "N", "eq 3.7 gives a ratio of 2.5 between the directions, the thesis measured 2.06; no permittivity meets both"),
    Statement("figure 3-6", "ratio of the directions", "specimens/BX-1.html#force", "SELECT max(force_n) FILTER (WHERE direction = 1) / max(force_n) FILTER (WHERE direction = 2), NULL, NULL FROM force_maps WHERE specimen_id = 'BX-1' AND stretch_2 = 3", 2.06, 0.13, why="eq 3.7 for an electrode drawn on the undeformed film: λ2/λ1 = 2.5"),
    Statement("figure 3-6", "points of the map", "specimens/BX-1.html#force", "SELECT count(DISTINCT stretch_2), NULL, NULL FROM force_maps WHERE specimen_id = 'BX-1'", 31, why="the demonstration takes steps of 0.25 in place of 0.05; a map of any number of points is read alike"),
    Statement("figure 3-6", "permittivity that the map needs", "specimens/BX-1.html#force", "SELECT relative_permittivity, relative_permittivity_lower, relative_permittivity_upper FROM force_map_fits WHERE specimen_id = 'BX-1'", 4.7, why="4.7 predicts 1.9 times the printed force; a permittivity that falls with stretch is known for this film"),
    Statement("section 3.4.1", "conventional films at (1.2, 3), mean", FORCES + "#forces", _forces("conventional"), 0.32, 0.01, "N"),
    Statement("section 3.4.1", "seven rods, direction 1", FORCES + "#forces", _forces("rod-constrained"), 0.45, 0.01, "N"),
    Statement("section 3.4.1", "rods over none", FORCES + "#forces", _ratio("rod-constrained"), 0.45 / 0.32, 0.05, why="chapter 6 says over ten times: that is against an unstretched film"),
    Statement("figure 3-7", "divided over single electrode, force", FORCES + "#forces", _ratio(_CASES[3]), 0.94, 0.0),
    Statement("figure 3-8a", "mean life, case 1", CAMPAIGN + "#survival", _summary(1, "restricted_mean_s"), 39, unit="s"),
    Statement("figure 3-8a", "mean life to 240 s, case 2", CAMPAIGN + "#survival", _summary(2, "restricted_mean_s"), 202, unit="s", why="restricted to 240 s, as the printed mean is: four of twenty were still alive"),
    Statement("figure 3-8a", "mean life to 240 s, case 3", CAMPAIGN + "#survival", _summary(3, "restricted_mean_s"), 240, unit="s", why="all survived: a bound, no mean"),
    Statement("figure 3-8a", "shortest life, case 1", CAMPAIGN + "#survival", _life(1, "min(lifetime_s)"), 5, 1.0, "s"),
    Statement("figure 3-8a", "longest life, case 1", CAMPAIGN + "#survival", _life(1, "max(lifetime_s)"), 120, 15.0, "s", _ITS_SPECIMENS),
    Statement("figure 3-8a", "shortest life, case 2", CAMPAIGN + "#survival", _life(2, "min(lifetime_s)"), 103, 25.0, "s", _ITS_SPECIMENS),
    Statement("figure 3-8b", "surviving 60 s, case 1", CAMPAIGN + "#survival", _survival(1, 60), 0.20),
    Statement("figure 3-8b", "surviving 240 s, case 2", CAMPAIGN + "#survival", _survival(2, 239.9), 0.20),
    Statement("figure 3-8b", "surviving 240 s, case 3", CAMPAIGN + "#survival", _survival(3, 239.9), 1.0),
    Statement("section 3.4.2", "voltage at which case 3 fails when it is raised", CAMPAIGN + "#survival", f"SELECT avg(breakdown_voltage_kv), avg(breakdown_voltage_kv) - 1.96 * stddev(breakdown_voltage_kv) / sqrt(count(*)), avg(breakdown_voltage_kv) + 1.96 * stddev(breakdown_voltage_kv) / sqrt(count(*)) FROM lifetimes WHERE configuration = '{_CASES[3]}'", 9.5, 0.25, "kV"),
    Statement("figure 3-9a", "failures at rods, case 1", FAILURES + "#where", _share(1, "failure_site = 'rod'"), 0.95, 0.0),
    Statement("figure 3-9b", "failures at the lead, case 2", FAILURES + "#where", _share(2, "failure_site = 'lead'"), 1.0),
    Statement("figure 3-9b", "failures within 240 s, case 2", FAILURES + "#where", _life(2, "count(*) FILTER (WHERE failed)"), 16, why=_ITS_SPECIMENS),
    Statement("figure 3-9c", "failures within 240 s at 7.5 kV, case 3", FAILURES + "#where", _life(3, "count(*) FILTER (WHERE failed AND lifetime_s < 240)"), 0),
    Statement("figure 3-10", "E₁ at λ = 1 over Young's modulus", FAILURES + "#where", _modulus(1.0, 0), 12 / 9, 0.01, why="4 Y/3: the tangent at held width; the printed 0.1 GPa is 0.1 MPa"),
    Statement("figure 3-10", "E₁ at λ = 3 over Young's modulus", FAILURES + "#where", _modulus(3.0, 0), 2 / 9 * 3**-0.5 + 10 / 9 * 3**-3.5, 1e-6),
    _picture("figure 3-11", "boundary conditions", FAILURES + "#where", "a drawing; single nodes pulled there, rods bonded over their width here"),
    Statement("figure 3-12", "thinnest place under a single electrode, over the median", FAILURES + "#where", _layout(1, "thinnest"), 0.83, why="−17 % is mostly the thesis' point load (a film of 3 × 1.2 is thinner by 72 %); the places agree, at the rods"),
    Statement("figure 3-12", "thinnest place under a divided electrode, over the median", FAILURES + "#where", _layout(3, "thinnest"), 0.85, why="as above: the levels follow from the boundary condition"),
    Statement("figure 3-13", "failures expected at rods", FAILURES + "#where", _layout(1, "predicted_rod_share"), 0.95, 0.05, why="by finite elements; 0.96 to 1.00 over the plausible powers of the field"),
    *(Statement("figure 3-13", f"failures found, {region} third", FAILURES + "#where", _region(region, "observed_share"), share) for region, share in (("left", 0.35), ("centre", 0.50), ("right", 0.15))),
    *(Statement("figure 3-13", f"failures expected from the thickness, {region} third", FAILURES + "#where", _region(region, "predicted_share"), share, why="a film that is symmetric cannot expect 35 and 15 % left and right; 20 failures tell 50 from 38 % no better") for region, share in (("left", 0.35), ("centre", 0.50), ("right", 0.15))),
    _picture("figure 4-1", "model of n arms", "specimens/PA-1.html#parameters", "a drawing"),
    Statement("figure 4-2", "first-order example, stiffness at rest", CHECKS + "#springs", _end(0.5, (2.0,), (0.6,), 0.0), 0.5, unit="N/mm", why="as printed eq 4.11 gives 2.0"),
    Statement("figure 4-2", "first-order example, stiffness at high frequency", CHECKS + "#springs", _end(0.5, (2.0,), (0.6,), 1e9), 2.5, unit="N/mm"),
    Statement("figure 4-3", "second-order example, stiffness at high frequency", CHECKS + "#springs", _end(0.5, (1.0, 1.0), (1.0, 0.1), 1e9), 2.5, unit="N/mm"),
    Statement("figure 4-4", "order that the procedure ends with, stack", "specimens/ST-1.html#order", _order("ST-1"), 3, why="orders are chosen by test here, not by tolerances"),
    Statement("figure 4-4", "order that the procedure ends with, polyacrylate layer", "specimens/PA-1.html#order", _order("PA-1"), 3),
    Statement("figure 4-4", "order that the procedure ends with, silicone", "specimens/SI-1.html#order", _order("SI-1"), 1),
    _picture("figure 4-5", "samples", "specimens/PA-1.html#recordings", "a drawing"),
    Statement("figure 4-6", "clamp alone on its load cell", "control.html", "SELECT value, value - 1.96 * sd, value + 1.96 * sd FROM calibrations WHERE quantity = 'clamp_frequency_hz'", 50, 10.0, "Hz", "the thesis gives neither mass nor stiffness: a proposal within its 40 to 60 Hz"),
    _picture("figure 4-7", "signals and controller of the rigs", "specimens/PA-1.html#recordings", "a drawing"),
    Statement("figure 4-8", "stiffness at 5 Hz, 10 % strain", "specimens/ST-1.html#strains", _strain(0.05, "magnitude"), 3.0, 0.05, "N/mm"),
    Statement("figure 4-8", "stiffness at 5 Hz, 50 % strain", "specimens/ST-1.html#strains", _strain(0.25, "magnitude"), 2.3, 0.05, "N/mm"),
    Statement("figure 4-8", "phase at 5 Hz between 10 and 50 % strain, range", "specimens/ST-1.html#strains", "SELECT max(phase_deg) - min(phase_deg), NULL, NULL FROM frequency_responses WHERE specimen_id = 'ST-1' AND stage = 'corrected' AND abs(frequency_hz - 5) < 0.1", None, unit="°", why="printed as weak, without a number"),
    Statement("figure 4-9", "average at 5 Hz", "specimens/ST-1.html#response", _at("ST-1", 5, "magnitude"), 2.561, 0.1, "N/mm", "table 4.2, third order"),
    Statement("figure 4-9", "phase of the average at 5 Hz", "specimens/ST-1.html#response", _at("ST-1", 5, "phase_deg"), 46.7, 2.0, "°", "table 4.2, third order"),
    _picture("table 4.1", "names of the parameters", "specimens/PA-1.html#parameters", "a list; k_n and c_n are printed as those of the main spring"),
    *(Statement("table 4.2", f"order {n}, k₀", "specimens/ST-1.html#weightings", _fit("ST-1", n, "k0_n_per_mm"), 0.40, 0.01, "N/mm", _UNSTATED) for n in (1, 2, 3)),
    *(Statement("table 4.2", f"order 3, {name}", "specimens/ST-1.html#weightings", _fit("ST-1", 3, column), value, 0.05 * value, unit, _UNSTATED) for name, column, value, unit in (("k₁", "k1_n_per_mm", 0.40, "N/mm"), ("k₂", "k2_n_per_mm", 1.00, "N/mm"), ("c₁", "c1_n_s_per_mm", 1.00, "N s/mm"), ("c₂", "c2_n_s_per_mm", 0.10, "N s/mm"))),
    *(Statement("table 4.2", f"order {n}, magnitude error", "specimens/ST-1.html#weightings", _fit("ST-1", n, "magnitude_error_n_per_mm"), value, 0.0, "N/mm", f"{_UNSTATED}; {_QUIET}") for n, value in ((1, 0.64), (2, 0.26), (3, 0.06))),
    *(Statement("table 4.2", f"order {n}, phase error", "specimens/ST-1.html#weightings", _fit("ST-1", n, "phase_error_deg"), value, 0.0, "°", f"{_UNSTATED}; {_QUIET}") for n, value in ((1, 18.58), (2, 10.05), (3, 3.96))),
    Statement("section 4.4.1", "modulus of the stack", "specimens/ST-1.html#parameters", "SELECT modulus_mpa, modulus_mpa * (1 - 1.96 * k0_n_per_mm_sd / k0_n_per_mm), modulus_mpa * (1 + 1.96 * k0_n_per_mm_sd / k0_n_per_mm) FROM best_models WHERE specimen_id = 'ST-1'", 0.16, 0.005, "MPa", "k0 l/A with the stretched area"),
    Statement("figure 4-10", "resonance of the silicone record", "specimens/SI-1.html#correction", _peak("SI-1", "mechanical"), 50, 5.0, "Hz"),
    Statement("figure 4-11", "resonance of the polyacrylate record", "specimens/PA-1.html#correction", _peak("PA-1", "mechanical"), 50, 10.0, "Hz", "the film stiffens: its peak lies above the clamp's own frequency"),
    Statement("figure 4-11", "corrected stiffness at 10 Hz", "specimens/PA-1.html#response", _at("PA-1", 10, "magnitude"), 3.945, 0.1, "N/mm", "table 4.3, third order"),
    Statement("figure 4-12", "silicone, corrected stiffness at 10 Hz", "specimens/SI-1.html#response", _at("SI-1", 10, "magnitude"), 0.290, 0.005, "N/mm", "table 4.3, first order"),
    Statement("figure 4-13", "polyacrylate, corrected phase at 10 Hz", "specimens/PA-1.html#response", _at("PA-1", 10, "phase_deg"), 44.0, 1.0, "°", "table 4.3, third order"),
    Statement("table 4.3", "silicone, k₀", "specimens/SI-1.html#weightings", _fit("SI-1", 1, "k0_n_per_mm"), 0.29, 0.005, "N/mm"),
    *(Statement("table 4.3", f"polyacrylate order 3, {name}", "specimens/PA-1.html#weightings", _fit("PA-1", 3, column), value, 0.03 * value, unit, "the film is given to the virtual rig by these numbers; the arms trade among each other within their limits") for name, column, value, unit in (("k₀", "k0_n_per_mm", 1.00, "N/mm"), ("k₁", "k1_n_per_mm", 1.50, "N/mm"), ("k₂", "k2_n_per_mm", 2.00, "N/mm"), ("k₃", "k3_n_per_mm", 30.0, "N/mm"), ("c₁", "c1_n_s_per_mm", 0.05, "N s/mm"), ("c₂", "c2_n_s_per_mm", 0.02, "N s/mm"), ("c₃", "c3_n_s_per_mm", 0.02, "N s/mm"))),
    *(Statement("table 4.4", f"{film} order {n}, {what} error", f"specimens/{specimen}.html#weightings", _fit(specimen, n, column), value, 0.0, unit, f"{_UNSTATED}; {_QUIET}") for film, specimen, n, magnitude, phase in (("silicone", "SI-1", 1, 1.11, 8.66), ("polyacrylate", "PA-1", 1, 1.73, 37.52), ("polyacrylate", "PA-1", 2, 1.29, 28.58), ("polyacrylate", "PA-1", 3, 1.05, 2.64)) for what, column, value, unit in (("magnitude", "magnitude_error_n_per_mm", magnitude, "N/mm"), ("phase", "phase_error_deg", phase, "°"))),
    Statement("figure 4-14", "resonance of the silicone record under voltage", "specimens/SI-1.html#electrical", _peak("SI-1", "electrical"), 52.5, 2.5, "Hz"),
    Statement("figure 4-15", "resonance of the polyacrylate record under voltage", "specimens/PA-1.html#electrical", _peak("PA-1", "electrical"), 52.5, 2.5, "Hz", "a film that damps as strongly as table 4.3 has it hardly shows a peak"),
    Statement("figure 4-16", "silicone under voltage, phase error of order 1", "specimens/SI-1.html#voltage-orders", _under("SI-1", 1, "phase_error_deg"), None, unit="°", why=_NEEDS),
    *(Statement("figure 4-17", f"polyacrylate under voltage, relative error of order {n}", "specimens/PA-1.html#voltage-orders", _under("PA-1", n, "relative_error"), None, why="no number is printed; the curve depends on the load cell's stiffness, the blocked force does not") for n in (1, 2, 3)),
    Statement("eq 4.7, 4.8", "permittivity from the sequences, polyacrylate", "specimens/PA-1.html#permittivity", "SELECT relative_permittivity, relative_permittivity_lower, relative_permittivity_upper FROM permittivities WHERE specimen_id = 'PA-1' AND method = 'sphs' AND voltage_kv IS NULL", 4.7),
    Statement("eq 4.7, 4.8", "permittivity from steps, polyacrylate", "specimens/PA-1.html#permittivity", "SELECT relative_permittivity, relative_permittivity_lower, relative_permittivity_upper FROM permittivities WHERE specimen_id = 'PA-1' AND method = 'static'", 4.7),
    Statement("figure 5-1", "slope of the capacitance over the active stretch", FORCES + "#constraint", _slope(lambda x: apart(x, 75, 20)), -0.364, 0.001),
    Statement("figure 5-2", "the same for an adjacent region", FORCES + "#constraint", _slope(lambda x: beside(x, 75, 20)), None, why="printed as a smaller variation; its own eq 5.11 gives the other sign and a larger one"),
    Statement("section 5.2", "slope for a circular actuator (λ⁴)", FORCES + "#constraint", _slope(circular), 4.0, 0.001),
    _picture("figure 5-3", "configurations", "specimens/SS-1.html#recordings", "a drawing"),
    _picture("figure 5-4", "rig and bridge", "specimens/SS-1.html#recordings", "a drawing"),
    Statement("figure 5-5a", "drop of tension at 8 kV", "specimens/SS-1.html#steps", _step("SS-1", "force_step_n", 8, "%8kV"), 0.044, 0.001, "N", "the virtual film has the permittivity 4.7 of the metadata"),
    Statement("figure 5-5a", "change of capacitance at 8 kV", "specimens/SS-1.html#steps", _step("SS-1", "abs(capacitance_step_pf)", 8, "%8kV"), 0.25, 0.01, "pF", "as above"),
    Statement("figure 5-5a", "share of the force within 0.1 s", "specimens/SS-1.html#steps", _step("SS-1", "force_instant_fraction", 8, "%8kV"), 0.90, 0.05),
    Statement("figure 5-5a", "share of the capacitance within 0.1 s", "specimens/SS-1.html#steps", _step("SS-1", "capacitance_instant_fraction", 8, "%8kV"), 0.50, 0.05),
    Statement("figure 5-5b", "drop of tension at 11 kV", "specimens/SS-1.html#steps", _step("SS-1", "force_step_n", 11), 0.115, 0.003, "N", "8 and 11 kV of the thesis make a force that grows with V³; Maxwell stress grows with V²"),
    Statement("figure 5-5b", "capacitive strain at 11 kV", "specimens/SS-1.html#steps", _step("SS-1", "capacitive_strain", 11), 0.024, 0.001, why="as above"),
    Statement("figure 5-5b", "force over capacitive strain", "specimens/SS-1.html#sensing", _sensing("SS-1", "force_per_capacitive_strain_n"), 4.91, 0.15, "N", "from the printed steps at 8 and 11 kV"),
    Statement("section 5.4.1", "modulus from force and capacitance", "specimens/SS-1.html#sensing", _sensing("SS-1", "modulus_mpa"), 0.148, 0.004, "MPa", "eq 5.16 without its factor; with it the printed data give 0.055"),
    Statement("section 5.4.1", "exponent of the force in the voltage", "specimens/SS-1.html#sensing", _sensing("SS-1", "force_exponent"), 3.0, 0.1, why="two values of two figures; Maxwell stress has 2"),
    Statement("figure 5-6a", "largest voltage, closed loop", "specimens/SS-2.html#loop", _loop("peak_kv", "SS-2-closed-loop"), 8.5, 0.1, "kV", "the printed gains cannot give it; those proposed here are other ones"),
    Statement("figure 5-6b", "rise of the capacitance, closed loop", "specimens/SS-2.html#loop", _loop("rise_time_s", "SS-2-closed-loop"), 0.5, 0.1, "s"),
    Statement("figure 5-6c", "overshoot of the force, closed loop", "specimens/SS-2.html#loop", _loop("force_overshoot_percent", "SS-2-closed-loop"), 100, 10.0, "%", "smaller with the gains that are proposed here"),
    Statement("figure 5-7", "drift of the relation over 480 s", "specimens/SS-2.html#loop", "SELECT relation_drift_percent, relation_drift_percent - 1.96 * relation_drift_percent_sd, relation_drift_percent + 1.96 * relation_drift_percent_sd FROM loop_responses WHERE recording_id = 'SS-2-closed-loop-500s'", 0.0, unit="%"),
    Statement("figure 5-8", "capacitance after the first coat", "specimens/EC-1.html#coats", "SELECT capacitance_pf, capacitance_pf - 1.96 * capacitance_pf_sd, capacitance_pf + 1.96 * capacitance_pf_sd FROM electrode_coats WHERE coats = 1", 24.4, 0.15, "pF"),
    Statement("figure 5-8", "coats that were measured up to", "specimens/EC-1.html#coats", "SELECT max(coats), NULL, NULL FROM electrode_coats", 25),
    Statement("figure 5-9", "cycle from which the wave distorts", "specimens/EM-1.html#migration", "SELECT onset_cycle, onset_cycle_lower, onset_cycle_upper FROM electrode_migrations WHERE specimen_id = 'EM-1'", 100, 5.0),
    Statement("figure 5-9", "cycles with a thick electrode, no distortion", "specimens/EM-2.html#migration", "SELECT cycles, NULL, NULL FROM electrode_migrations WHERE specimen_id = 'EM-2' AND onset_cycle IS NULL", 800, why="250 cycles in the demonstration; the distortion of the thin one is long there by then"),
    _picture("figure 5-10", "films with and without constraint", FORCES + "#constraint", "a photograph"),
    Statement("figure 5-11a", "force, held over free", FORCES + "#constraint", _gain("force"), 3.0, why="a film in series gives l_tot/(l_tot − l_held) = 1.67; 3 would need two thirds of the length to be held"),
    Statement("figure 5-11b", "capacitance, held over free", FORCES + "#constraint", _gain("capacitance"), 3.0, why="as above"),
    Statement("figure 5-12", "voltage from which the film wrinkles", "specimens/WR-1.html#sensing", _sensing("WR-1", "wrinkling_onset_kv"), 5.0, 0.5, "kV"),
    Statement("figure 5-12", "recovery from 7 kV", "specimens/WR-1.html#steps", _step("WR-1", "recovery_time_s", 7), 2.0, 0.5, "s", "printed as over 2 s; here the time until 90 % are gone"),
    Statement("figure 5-12", "capacitance at 7 over that at 6 kV", "specimens/WR-1.html#steps", "SELECT max(capacitance_step_pf) FILTER (WHERE voltage_kv > 6.5) / max(capacitance_step_pf) FILTER (WHERE voltage_kv BETWEEN 5.5 AND 6.5), NULL, NULL FROM step_responses WHERE specimen_id = 'WR-1'", 1.0, 0.02),
    _picture("figure 5-13", "direction of the wrinkles", "specimens/WR-1.html#sensing", "a drawing; the direction is in no channel, and no key of the metadata holds it yet"),
)  # fmt: skip
