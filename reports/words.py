"""Everyday words for names of the tables: quantities, protocols, tests. An unknown name is shown with spaces for underscores."""

from __future__ import annotations

from reports.names import short, visible
from reports.results import Row
from schemas.numbers import true_minus
from schemas.rig_constants import RIG_CONSTANTS

FOLLOWED = {
    "k0_n_per_mm": "main spring k₀",
    "modulus_mpa": "modulus",
    "model_order": "order of the model",
    **{constant.key: constant.name for constant in RIG_CONSTANTS},
    "force_per_voltage_squared_n_per_kv2": "force over V²",
    "force_per_capacitive_strain_n": "force over capacitive strain",
    "verdict": "verdict",
    "restricted_mean_s": "restricted mean life",
    "median_s": "median life",
    "clamp_frequency_hz": "frequency of the clamp alone",
    "damping_ratio": "damping ratio of the clamp alone",
    "loaded_clamp_frequency_hz": "frequency of the clamp with a further mass",
    "loaded_damping_ratio": "damping ratio of the clamp with a further mass",
    "force_gain": "gain of the force channel",
    "force_offset_n": "offset of the force channel",
    "modulus_over_batch": "modulus over the median of its batch",
    "refused_share": "share of the files refused",
}
"""Quantities that are followed from night to night or stand in a control chart."""

_PROTOCOLS = {
    ("chirp", "mechanical"): "frequency sweep",
    ("chirp", "electrical"): "frequency sweep of the voltage",
    ("sphs", "electrical"): "harmonic sequence of the voltage",
    ("sphs", "mechanical"): "harmonic sequence",
    ("noise", "mechanical"): "random movement",
    ("cyclic", "mechanical"): "cyclic test",
    ("step", "electrical"): "voltage steps",
    ("step", "mechanical"): "stress relaxation",
    ("lifetime", "electrical"): "life under voltage",
    ("isotonic", "electrical"): "strokes at constant load",
    ("force_map", "electrical"): "static force",
    ("cycle", "electrical"): "slow cycles of the voltage",
    ("cycle", "mechanical"): "large load–unload cycle",
    ("creep", "mechanical"): "creep and recovery",
    ("pull", "mechanical"): "pull to failure",
    ("tap", "calibration"): "tap of the clamp",
    ("weight", "calibration"): "known weights on the load cell",
}
_TESTS = {
    "fisher exact": "Fisher’s exact test",
    "hazard ratio (cox)": "Hazard ratio (Cox)",
    "gehan": "Gehan–Wilcoxon",
    "peto": "Peto–Peto",
    "tarone-ware": "Tarone–Ware",
}


def followed(quantity: str) -> str:
    """`load-cell stiffness`."""
    return FOLLOWED.get(quantity, plain(quantity))


def protocol(name: str | None, loading: str | None) -> str:
    """What kind of test it is: `stress relaxation`."""
    return _PROTOCOLS.get((name or "", loading or ""), f"{plain(name or 'unknown')}, {loading or 'unknown'} loading")


def test(name: str | None) -> str:
    """A statistical test by its proper name."""
    text = visible(name or "test")
    return _TESTS.get(text, text[:1].upper() + text[1:])


def against(row: Row) -> str:
    """`B against A`, of a row that compares configurations: its differences are B less A, its ratios B over A."""
    return " against ".join(short(row[f"configuration_{x}"] or "", 44) for x in "ba")


def remark(text: str | None) -> str:
    """A remark of an analysis, stored as plain text, as it is shown: with true minus signs; empty without one."""
    return true_minus(visible(text or ""))


def plain(name: str) -> str:
    """`leakage current` for `leakage_current`."""
    return visible(name).replace("_", " ")
