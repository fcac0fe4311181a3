"""One specimen: corrected and averaged responses, models, predictions, self-sensing, from its recordings' results."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pipeline.analyse.analysis import Analysis
from pipeline.analyse.inputs import Measured
from pipeline.analyse.model_fits import amplitude_fits_table, model_fits_table
from pipeline.analyse.responses import AVERAGED, CORRECTED, response_table
from pipeline.analyse.self_sensing import analyse_self_sensing
from pipeline.analyse.temperatures import Unit, join_temperatures, prony_table
from pipeline.analyse.voltage import analyse_orders, analyse_permittivity, analyse_specification
from pipeline.fit.relaxation.amplitudes import fit_amplitudes
from pipeline.fit.relaxation.damaged import weighed
from pipeline.fit.relaxation.electrical import fit_electrical, fit_joint
from pipeline.fit.relaxation.identify import fit_corrected, fit_specimen
from pipeline.fit.relaxation.ladder import ladder, wants_ladder
from pipeline.fit.relaxation.metrics import Geometry
from pipeline.fit.relaxation.predict import Prediction, predict
from pipeline.fit.relaxation.results import ELECTRICAL, MECHANICAL, RELATIVE, UNIFORM, RelaxationFit, SpecimenFits
from pipeline.fit.relaxation.time_domain import CycleFits
from pipeline.fit.relaxation.weightings import fit_weighted
from pipeline.transform.averaging import average
from pipeline.transform.calibration import TapCalibration, WeightCalibration, sharpen
from pipeline.transform.correction import blocked_force, correct_mechanical
from pipeline.transform.relaxation import RelaxationCurve
from pipeline.transform.response import FORCE_PER_VOLTAGE_SQUARED, STIFFNESS, FrequencyResponse
from schemas.arrays import Complex, Float
from schemas.metadata import RecordingMetadata, RigConstants
from schemas.tables import TABLES


@dataclass(frozen=True)
class _Responses:
    """Responses of one quantity, each with its rig (None: the response is the film's own) and its protocol.

    `remarks`: what was done about damaged recordings among them.
    """

    responses: tuple[FrequencyResponse, ...]
    rigs: tuple[RigConstants | None, ...]
    protocols: tuple[str, ...]
    remarks: tuple[str, ...] = ()

    def of(self, protocol: str) -> _Responses:
        chosen = [i for i, name in enumerate(self.protocols) if name == protocol]
        return _Responses(
            tuple(self.responses[i] for i in chosen),
            tuple(self.rigs[i] for i in chosen),
            tuple(self.protocols[i] for i in chosen),
        )


def analyse_specimen(
    specimen_id: str,
    recordings: Sequence[Measured],
    calibrations: Sequence[Measured],
    *,
    orders: tuple[int, ...],
) -> Analysis:
    """Everything that is computed from the recordings of one specimen together."""
    analysis = Analysis()
    recordings, unit = join_temperatures(analysis, specimen_id, recordings)
    mechanical = _responses(analysis, recordings, calibrations, STIFFNESS)
    electrical = _responses(analysis, recordings, calibrations, FORCE_PER_VOLTAGE_SQUARED)
    corrected, mean = _corrected(analysis, mechanical)
    by_amplitude = analysis.attempt(
        "models of each amplitude",
        fit_amplitudes,
        of_known_strain(corrected, recordings),
        orders=orders,
        geometry=_geometry(recordings),
        specimen_id=specimen_id,
    )
    analysis.add({"amplitude_fits": amplitude_fits_table(by_amplitude or ())})
    fits = _mechanical_fits(analysis, specimen_id, recordings, calibrations, mechanical, mean, orders, unit)
    forward = next((fit for fit in fits if fit.method == "forward"), None)
    predictions: list[Prediction | None] = []
    own, blocked = None, []
    if electrical.responses:
        blocked = _blocked(analysis, electrical, forward)
        under = _electrical_fits(analysis, specimen_id, mechanical, electrical, forward, recordings, orders)
        own = next((fit for fit in under if fit.loading == ELECTRICAL), None)
        if own is not None:
            analyse_orders(analysis, specimen_id, own, electrical.responses, electrical.rigs, recordings)
        fits += under
        predictions += _across_loadings(analysis, fits, mechanical, electrical)
    values = analyse_permittivity(
        analysis, specimen_id, own, blocked, None if forward is None else forward.selected, recordings
    )
    analyse_specification(analysis, specimen_id, values, forward, recordings)
    predictions += _across_protocols(analysis, specimen_id, mechanical, orders)
    made = [one for one in predictions if one is not None]
    remarks = {MECHANICAL: mechanical.remarks, ELECTRICAL: electrical.remarks}
    both = (*mechanical.remarks, *electrical.remarks)
    fits = [replace(fit, warnings=(*fit.warnings, *remarks.get(fit.loading, both))) for fit in fits]
    analysis.add({"model_fits": model_fits_table(fits, _best_cycle(analysis, recordings))})
    analysis.add({"predictions": TABLES["predictions"].from_objects(made)})
    analyse_self_sensing(analysis, specimen_id, recordings, forward)
    return analysis


def of_known_strain(responses: Sequence[FrequencyResponse], recordings: Sequence[Measured]) -> list[FrequencyResponse]:
    """Responses to sinusoids whose amplitude is a strain; that of a sweep is a displacement, and falls with the frequency."""
    abouts = {one.recording_id: one.metadata for one in recordings}
    known = {
        name
        for name, about in abouts.items()
        if isinstance(about, RecordingMetadata)
        and about.protocol == "cyclic"
        and (about.strain_pp is not None or about.film_length_mm is not None)
    }
    return [one for one in responses if one.recording_id in known]


def rig_of(recording: Measured, calibrations: Sequence[Measured]) -> RigConstants | None:
    """The rig's constants for a recording, with what was on the clamp, sharpened by the calibrations made before.

    None for a table.
    """
    about = recording.metadata
    if not isinstance(about, RecordingMetadata):
        return None
    rig = recording.rig
    for calibration in sorted(calibrations, key=_when):
        if _rig_id(calibration) == _rig_id(recording) and _when(calibration) <= _when(recording):
            for result in calibration.results:
                if isinstance(result, TapCalibration | WeightCalibration):
                    rig = sharpen(rig, result)
    return rig.loaded(about.extra_clamp_mass_kg)


def _rig_id(recording: Measured) -> str | None:
    return recording.metadata.rig_id or recording.rig.rig_id


def _when(recording: Measured) -> float:
    started = recording.metadata.started_at
    return 0.0 if started is None else started.timestamp()


def _responses(
    analysis: Analysis, recordings: Sequence[Measured], calibrations: Sequence[Measured], quantity: str
) -> _Responses:
    found = [
        (response, rig_of(recording, calibrations), recording.metadata.protocol or "table", recording.damage)
        for recording in recordings
        for response in recording.of(FrequencyResponse)
        if response.quantity == quantity
    ]
    responses, rigs = tuple(f[0] for f in found), tuple(f[1] for f in found)
    judged = analysis.attempt("damaged recordings", weighed, responses, rigs, [f[3] for f in found])
    responses, remarks = (responses, ()) if judged is None else judged
    analysis.note(remarks)
    return _Responses(responses, rigs, tuple(f[2] for f in found), remarks)


def _corrected(analysis: Analysis, mechanical: _Responses) -> tuple[list[FrequencyResponse], FrequencyResponse | None]:
    """Each response with clamp and load cell taken out, and their average; adds rows of both."""
    found = []
    for response, rig in zip(mechanical.responses, mechanical.rigs, strict=True):
        what = f"correction of {response.recording_id}"
        one = response if rig is None else analysis.attempt(what, correct_mechanical, response, rig)
        if one is not None:
            found.append(one)
    return found, _add_corrected(analysis, found)


def _add_corrected(analysis: Analysis, corrected: Sequence[FrequencyResponse]) -> FrequencyResponse | None:
    """Rows of corrected responses and of their average, which is returned."""
    if not corrected:
        return None
    own = [one for one in corrected if one.recording_id is not None]  # a master curve is no recording's
    analysis.add({"frequency_responses": response_table(own, CORRECTED)})
    mean = analysis.attempt("average", average, corrected)
    if mean is not None:
        analysis.add({"frequency_responses": response_table([mean], AVERAGED)})
    return mean


def _mechanical_fits(
    analysis: Analysis,
    specimen_id: str,
    recordings: Sequence[Measured],
    calibrations: Sequence[Measured],
    mechanical: _Responses,
    mean: FrequencyResponse | None,
    orders: tuple[int, ...],
    unit: Unit | None,
) -> list[SpecimenFits]:
    """The forward fit of everything mechanical, and fits of the corrected average with all weightings for comparison."""
    stepped = [(curve, rig_of(one, calibrations)) for one in recordings for curve in one.of(RelaxationCurve)]
    curves = [(curve, rig) for curve, rig in stepped if curve.quantity == STIFFNESS]
    geometry = _geometry(recordings)
    fits = []
    if mechanical.responses or curves:
        forward = _forward(analysis, "models", specimen_id, mechanical, curves, orders, geometry)
        if forward is None and curves and mechanical.responses:
            curves = []
            forward = _forward(analysis, "models without relaxation", specimen_id, mechanical, curves, orders, geometry)
        fits.append(forward)
        if forward is not None and wants_ladder(forward):
            _ladder(analysis, specimen_id, mechanical, curves, unit)
    if mean is not None:
        fits.append(
            analysis.attempt(
                "models of the corrected response",
                fit_corrected,
                mean,
                orders=orders,
                geometry=geometry,
                specimen_id=specimen_id,
            )
        )
        for weighting in (UNIFORM, RELATIVE):
            what = f"models with {weighting} weights"
            fits.append(
                analysis.attempt(
                    what, fit_weighted, mean, weighting, orders=orders, geometry=geometry, specimen_id=specimen_id
                )
            )
    return [fit for fit in fits if fit is not None]


def _forward(
    analysis: Analysis,
    what: str,
    specimen_id: str,
    mechanical: _Responses,
    curves: Sequence[tuple[RelaxationCurve, RigConstants | None]],
    orders: tuple[int, ...],
    geometry: Geometry | None,
) -> SpecimenFits | None:
    return analysis.attempt(
        what,
        fit_specimen,
        mechanical.responses,
        mechanical.rigs,
        relaxations=[curve for curve, _ in curves],
        relaxation_rig=[rig for _, rig in curves],
        orders=orders,
        geometry=geometry,
        specimen_id=specimen_id,
    )


def _ladder(
    analysis: Analysis,
    specimen_id: str,
    mechanical: _Responses,
    curves: Sequence[tuple[RelaxationCurve, RigConstants | None]],
    unit: Unit | None,
) -> None:
    """What each number of arms reaches, where the data span decades that a few arms cannot."""
    rungs = analysis.attempt(
        "ladder of orders",
        ladder,
        mechanical.responses,
        mechanical.rigs,
        relaxations=[curve for curve, _ in curves],
        relaxation_rig=[rig for _, rig in curves],
    )
    if rungs is not None:
        rows = TABLES["order_ladders"].from_objects(rungs, specimen_id=specimen_id)
        analysis.add({"order_ladders": rows, "prony_series": prony_table(specimen_id, rungs, unit)})


def _blocked(analysis: Analysis, electrical: _Responses, forward: SpecimenFits | None) -> list[FrequencyResponse]:
    """Blocked force of each electrical response where a mechanical model says what the film does."""
    if forward is None:
        return []
    chosen = forward.selected
    found = []
    for response, rig in zip(electrical.responses, electrical.rigs, strict=True):
        if rig is None:
            continue
        k, factor = chosen.model.stiffness(response.frequency_hz), _factor(chosen, response.frequency_hz)
        one = analysis.attempt(
            f"correction of {response.recording_id}", blocked_force, response, k, rig, stiffness_systematic=factor
        )
        if one is not None:
            found.append(one)
    _add_corrected(analysis, found)
    return found


def _factor(fit: RelaxationFit, frequency_hz: Float) -> Complex:
    """(n, p) factor S of the covariance of the fitted k(jω) at (n,) Hz: k = k̂ + S z with z standard normal."""
    values, vectors = np.linalg.eigh(fit.covariance)
    return np.asarray(fit.slopes(frequency_hz) @ (vectors * np.sqrt(np.maximum(values, 0.0))))


def _electrical_fits(
    analysis: Analysis,
    specimen_id: str,
    mechanical: _Responses,
    electrical: _Responses,
    forward: SpecimenFits | None,
    recordings: Sequence[Measured],
    orders: tuple[int, ...],
) -> list[SpecimenFits]:
    """Models of the electrical recordings, and of both loadings together."""
    fits = [
        analysis.attempt(
            "electrical models",
            fit_electrical,
            electrical.responses,
            electrical.rigs,
            forward,
            orders=orders,
            specimen_id=specimen_id,
        )
    ]
    if mechanical.responses:
        fits.append(
            analysis.attempt(
                "joint models",
                fit_joint,
                mechanical.responses,
                electrical.responses,
                (*mechanical.rigs, *electrical.rigs),
                orders=orders,
                geometry=_geometry(recordings),
                specimen_id=specimen_id,
            )
        )
    return [fit for fit in fits if fit is not None]


def _across_loadings(
    analysis: Analysis, fits: Sequence[SpecimenFits], mechanical: _Responses, electrical: _Responses
) -> list[Prediction | None]:
    """The models of each loading against the recordings of the other."""
    made = []
    for fit in fits:
        if fit.method != "forward" or fit.loading == "joint":
            continue
        other, name = (electrical, "electrical") if fit.loading == "mechanical" else (mechanical, "mechanical")
        if other.responses:
            made.append(
                analysis.attempt(
                    f"prediction of {name} recordings", predict, fit, other.responses, other.rigs, predicted=name
                )
            )
    return made


def _across_protocols(
    analysis: Analysis, specimen_id: str, mechanical: _Responses, orders: tuple[int, ...]
) -> list[Prediction | None]:
    """The model of each mechanical protocol alone against the recordings of the others."""
    names = sorted(set(mechanical.protocols))
    made: list[Prediction | None] = []
    for name in names if len(names) > 1 else ():
        own = mechanical.of(name)
        fit = analysis.attempt(
            f"models of {name} alone",
            fit_specimen,
            own.responses,
            own.rigs,
            orders=orders,
            specimen_id=specimen_id,
        )
        for other in names:
            if fit is not None and other != name:
                rest = mechanical.of(other)
                made.append(
                    analysis.attempt(
                        f"prediction of {other} from {name}",
                        predict,
                        fit,
                        rest.responses,
                        rest.rigs,
                        predicted=other,
                        fitted_on=name,
                    )
                )
    return made


def _best_cycle(analysis: Analysis, recordings: Sequence[Measured]) -> list[CycleFits]:
    """The cycle whose model errs least on the part left out: `model_fits` has room for one per specimen."""
    found = sorted(
        (fits for one in recordings for fits in one.of(CycleFits)),
        key=lambda fits: (
            fits.selected.held_out_rmse / max(abs(fits.slope_at_rest(fits.selected)), float(np.finfo(float).tiny))
        ),
    )
    for other in found[1:]:
        analysis.note(
            [f"cycle {other.recording_id} was fitted too: root mean square error {other.selected.rmse:.4g} kPa"]
        )
    return found[:1]


def _geometry(recordings: Sequence[Measured]) -> Geometry | None:
    """Sizes of the film from the first recording that has them all."""
    for one in recordings:
        if isinstance(one.metadata, RecordingMetadata) and one.metadata.loading != "calibration":
            found = Geometry.of(one.metadata)
            if found is not None:
                return found
    return None
