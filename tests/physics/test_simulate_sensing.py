"""Self-sensing on the virtual rig: one region for both, wrinkles, migrating electrodes, coats, force of rods."""

from __future__ import annotations

import copy
import tomllib
from typing import Any

import numpy as np
import pytest

from pipeline.fit.sensing.migration import migration
from pipeline.fit.sensing.wrinkling import wrinkling
from pipeline.simulate.campaign import load_campaign, read_campaign, simulate_one
from pipeline.simulate.plan import PACKAGED
from pipeline.transform.capacitance_cycles import capacitance_cycles
from pipeline.transform.coats import measure_coat
from pipeline.transform.force_map import measure_force_map
from pipeline.transform.loop import measure_loop
from pipeline.transform.step import measure_steps
from schemas.errors import UsageError
from schemas.recording import Recording

THESIS = load_campaign("thesis")


def made(recording_id: str) -> Recording:
    planned = next(p for p in THESIS.planned if p.recording_id == recording_id)
    return simulate_one(THESIS, planned).recording


@pytest.mark.long
@pytest.mark.slow
def test_one_region_for_both_rises_with_the_voltage_and_drifts_when_held() -> None:
    steps = measure_steps(made("SC-1-levels")).steps
    assert all((s.capacitance_step_pf or 0) > 0 for s in steps)
    held = measure_loop(made("SC-1-closed-loop-500s"))
    assert held.error_sign == -1
    assert held.relation_drift_percent is not None
    assert held.relation_drift_percent_sd is not None
    assert held.relation_drift_percent > 5 * held.relation_drift_percent_sd
    separate = measure_loop(made("SS-2-closed-loop-500s"))
    assert separate.relation_drift_percent is not None
    assert separate.relation_drift_percent_sd is not None
    assert abs(separate.relation_drift_percent) < 3 * separate.relation_drift_percent_sd


def test_wrinkles_begin_at_their_onset_and_let_go_late() -> None:
    marked, onset = wrinkling(measure_steps(made("WR-1-levels")).steps)
    assert onset is not None
    assert onset.lower < 5.0 < onset.upper
    assert [s.wrinkled for s in marked if s.voltage_kv > 5.5] == [True, True]
    recovery = [s.recovery_time_s or 9.0 for s in marked]
    assert recovery[-1] > 1.5 * recovery[3]


@pytest.mark.parametrize(("specimen", "onset"), [("EM-1", 100.0), ("EM-2", None)])
def test_a_thin_electrode_migrates_and_a_thick_one_does_not(specimen: str, onset: float | None) -> None:
    cycles = capacitance_cycles(made(f"{specimen}-cyclic"), 1.0)
    assert cycles is not None
    found = migration(cycles).onset_cycle
    assert found == (None if onset is None else pytest.approx(onset, rel=0.05))


def test_coats_approach_the_covered_region() -> None:
    first, last = (measure_coat(made(f"EC-1-coat-{n}")).capacitance_pf for n in (1, 25))
    assert first == pytest.approx(0.853 * 28.6, rel=0.02)
    assert last == pytest.approx(28.6, rel=0.02)


@pytest.mark.long
@pytest.mark.slow
def test_rods_add_to_the_force_and_a_divided_electrode_takes_from_it() -> None:
    def force(name: str) -> float:
        return float(
            np.mean([r.force_n for r in measure_force_map(made(f"{name}-force")).readings if r.direction == 1])
        )

    rods, plain = (np.mean([force(f"{p}-{i}") for i in n]) for p, n in (("RF", (1, 2, 3)), ("BX", (2, 3, 4))))
    assert rods == pytest.approx(0.45, abs=0.02)
    assert plain == pytest.approx(0.31, abs=0.02)
    divided, single = (np.mean([force(f"{p}-{i}") for i in range(1, 6)]) for p in ("FD", "FS"))
    assert divided / single == pytest.approx(0.94, abs=0.02)


def test_the_mechanical_film_of_a_constrained_specimen_is_what_is_free() -> None:
    specimen = THESIS.specimens["SS-1"]
    film = specimen.film(electrical=False)
    assert film.active is None
    soft = 1 / sum(1 / part.k0 for part in film.parts)
    assert soft == pytest.approx(specimen.model.k0 * 75 / 45)


def changed(**specimen: Any) -> dict[str, Any]:
    table = copy.deepcopy(tomllib.loads((PACKAGED / "controller.toml").read_text(encoding="utf-8")))
    table["specimens"]["silicone"] |= specimen
    table["recordings"] = [table["recordings"][0] | {"specimens": ["silicone"]}]
    return table


def test_regions_that_do_not_fit_into_the_film_are_refused() -> None:
    with pytest.raises(UsageError, match="longer than the film"):
        read_campaign(changed(constrained_length_mm=50.0))


def test_a_coat_needs_a_sensing_region() -> None:
    table = changed(geometry={"film_length_mm": 50.0, "film_thickness_mm": 1.0, "stretch_1": 1.5})
    table["recordings"] = [
        {"test": "coating", "specimens": ["silicone"], "coats": 1, "first_share": 0.8, "coats_scale": 5.0}
    ]
    with pytest.raises(UsageError, match="sensing_length_mm"):
        read_campaign(table)
