"""Controllers for a self-sensing specimen, from its mechanical model and its steps under voltage."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from pipeline.analyse.analysis import Analysis
from pipeline.fit.control.design import design_controllers
from pipeline.fit.control.identify import Plant, SensedStep, identify_plant
from pipeline.fit.control.loops import Electronics
from pipeline.fit.relaxation.results import RelaxationFit
from pipeline.transform.step import StepResponse
from schemas.metadata import RigConstants
from schemas.tables import TABLES

INTERVAL_S = 0.02
"""From one decision to the next, where nothing says otherwise."""


def analyse_controllers(
    analysis: Analysis,
    specimen_id: str,
    steps: Sequence[Sequence[StepResponse]],
    fit: RelaxationFit,
    rig: RigConstants,
) -> None:
    """Rows of `controller_designs` and `controller_courses`.

    Parameters
    ----------
    analysis : takes the rows
    specimen_id : the specimen
    steps : with open loop, of each recording
    fit : its mechanical model
    rig : that the loop is closed on
    """
    kept = [known for own in steps if (known := [s for s in map(sense_step, own) if s is not None])]
    plant = analysis.attempt("controllers", identify_plant, fit.model, fit.shape, fit.covariance, kept)
    if plant is None:
        return
    electronics, note = assume_electronics(plant, rig)
    found = analysis.attempt("controllers", design_controllers, plant, electronics=electronics)
    if found is None:
        return
    designs, table = TABLES["controller_designs"], TABLES["controller_courses"]
    courses = table.stack(
        table.arrays(
            one.time_s.size,
            specimen_id=specimen_id,
            goal=one.goal,
            controller=one.controller,
            time_s=one.time_s,
            voltage_kv=one.voltage_kv,
            capacitance_change_pf=one.capacitance_pf,
            capacitance_change_pf_lower=one.capacitance_limits_pf[0],
            capacitance_change_pf_upper=one.capacitance_limits_pf[1],
            force_drop_n=one.force_n,
            force_drop_n_lower=one.force_limits_n[0],
            force_drop_n_upper=one.force_limits_n[1],
        )
        for one in found[1]
    )
    analysis.add(
        {
            "controller_designs": designs.from_objects(found[0], specimen_id=specimen_id, note=note),
            "controller_courses": courses,
        }
    )


def sense_step(step: StepResponse) -> SensedStep | None:
    """What a controller's plant needs of a step; None where the film wrinkled or has no capacitance."""
    if step.wrinkled or step.capacitance_step_pf is None or step.capacitance_step_sd_pf is None:
        return None
    return SensedStep(
        step.start_s, step.end_s, step.voltage_kv, step.force_step_n, step.force_step_sd_n,
        step.capacitance_step_pf, step.capacitance_step_sd_pf,
    )  # fmt: skip


def assume_electronics(plant: Plant, rig: RigConstants) -> tuple[Electronics, str]:
    """The rest of the loop, and in words what of it is assumed.

    Parameters
    ----------
    plant : gives the largest voltage
    rig : gives gain and time constant of the amplifier, where its file states them
    """
    filed = {"gain_kv_per_v": rig.amplifier_gain_kv_per_v, "time_constant_s": rig.amplifier_rise_time_constant_s}
    stated = {name: value for name, value in filed.items() if value is not None}
    own = replace(Electronics(plant.largest_kv, interval_s=INTERVAL_S), **stated)
    told = {name: "of the rig file" if name in stated else "assumed" for name in filed}
    note = (
        f"voltage up to {own.largest_kv:.3g} kV, as the film was driven; amplifier {own.gain_kv_per_v:g} kV/V ({told['gain_kv_per_v']}),"
        f" its lag {1e3 * own.time_constant_s:g} ms ({told['time_constant_s']}); assumed: filter {own.filter_hz:g} Hz, a decision every"
        f" {1e3 * own.interval_s:g} ms; gains of {plant.steps} steps, relaxation of the mechanical model,"
        " the same in all parts of the film"
    )
    return own, note
