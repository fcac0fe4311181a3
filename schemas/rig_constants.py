"""The constants of a rig that models fit and diagnoses question: their keys, words and units, for all pages."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class RigConstant:
    """A constant of a rig. `key` names it in the rig's file and in `model_fits`; `error` is the parameter of a severity of
    `rig_constants` by which its true value exceeds the file's, as a share; empty where that cause does not ask for it."""

    key: str
    part: str
    name: str
    unit: str
    error: str = ""


RIG_CONSTANTS = (
    RigConstant("clamp_mass_kg", "the clamp", "clamp mass", "kg", "mass_error"),
    RigConstant("load_cell_stiffness_n_per_mm", "the load cell", "load-cell stiffness", "N/mm", "stiffness_error"),
    RigConstant("load_cell_damping_n_s_per_mm", "the damping of the load cell", "load-cell damping", "N s/mm"),
)
