"""A pull to failure as rows: what was measured, hyperelastic laws up to the break, and curves for the pages."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pipeline.analyse.cycle import MOST_POINTS, MOST_SAMPLES, stretch_and_stress
from pipeline.fit.laws import LawFit, fit_laws
from pipeline.transform.pull import Pull, measure_pull
from schemas.arrays import Float
from schemas.recording import Recording
from schemas.tables import TABLES

if TYPE_CHECKING:
    import pyarrow as pa

NOT_ASKED = "a film that breaks is another one before than after: the diagnosis does not ask this recording"


@dataclass(frozen=True)
class MeasuredPull:
    """One pull with its laws: (m,) stretch and stress in kPa of all samples, and the laws' stress up to the break."""

    pull: Pull
    stretch: Float
    stress: Float
    laws: tuple[LawFit, ...]
    fitted_stretch: Float
    fitted_stress: Float
    modelled: Mapping[str, Float]


def analyse_pull(recording: Recording) -> MeasuredPull:
    """Measures a pull and fits the laws. Raises `NotIdentifiableError` where it cannot carry them."""
    about = recording.metadata
    time, stretch, stress = stretch_and_stress(recording)
    good = np.isfinite(time) & np.isfinite(stretch) & np.isfinite(stress)
    time, stretch, stress = time[good], stretch[good], stress[good]
    pull = measure_pull(time, stretch, stress, where=about.recording_id)
    every = max(1, (pull.last + 1) // MOST_SAMPLES)
    lam, p = stretch[: pull.last + 1 : every], stress[: pull.last + 1 : every]
    laws, modelled = fit_laws(lam, p, where=about.recording_id)
    return MeasuredPull(pull, stretch, stress, laws, lam, p, modelled)


def pull_tables(recording_id: str, specimen_id: str, found: MeasuredPull) -> dict[str, pa.Table]:
    """Tables `pull_tests`, `pull_laws` and `pull_curves` of one recording."""
    about = {"recording_id": recording_id, "specimen_id": specimen_id}
    tests, laws, curves = TABLES["pull_tests"], TABLES["pull_laws"], TABLES["pull_curves"]
    shown = np.unique(np.linspace(0, found.stretch.size - 1, min(found.stretch.size, MOST_POINTS)).astype(int))
    part = np.unique(
        np.linspace(0, found.fitted_stretch.size - 1, min(found.fitted_stretch.size, MOST_POINTS)).astype(int)
    )
    measured = curves.arrays(
        shown.size,
        recording_id=recording_id,
        curve="measured",
        sample=shown,
        stretch=found.stretch[shown],
        stress_kpa=found.stress[shown],
    )
    return {
        "pull_tests": tests.from_objects([found.pull], **about, warnings=lambda pull: "; ".join(pull.warnings) or None),
        "pull_laws": laws.from_objects(
            found.laws,
            **about,
            rmse_kpa=lambda fit: fit.rmse,
            held_out_rmse_kpa=lambda fit: fit.held_out_rmse,
            young_kpa=lambda fit: fit.young,
            parameters=_write_parameters,
        ),
        "pull_curves": curves.stack(
            [
                measured,
                *(
                    curves.arrays(
                        part.size,
                        recording_id=recording_id,
                        curve=name,
                        sample=part,
                        stretch=found.fitted_stretch[part],
                        stress_kpa=stress[part],
                    )
                    for name, stress in found.modelled.items()
                ),
            ]
        ),
    }


def _write_parameters(fit: LawFit) -> str:
    sds = {f"{name}_sd": sd if math.isfinite(sd) else None for name, sd in fit.sds.items()}
    return json.dumps({**fit.parameters, **sds})
