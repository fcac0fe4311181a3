"""The kinds that stages pass on are the kinds that the night plans with."""

from __future__ import annotations

from pipeline.analyse.carried import KINDS
from pipeline.analyse.groups import ANALYSES
from pipeline.nightly.stages import (
    CALIBRATION_KINDS,
    DIAGNOSIS_KIND,
    DIAGNOSIS_TABLES,
    GROUPS,
    RECORDING_TABLES,
    SPECIMEN_KINDS,
    SPECIMEN_TABLES,
)
from schemas.tables import TABLES


def test_names_of_kinds_are_kinds_that_are_carried() -> None:
    named = (
        SPECIMEN_KINDS
        | CALIBRATION_KINDS
        | {DIAGNOSIS_KIND}
        | {kind for group in GROUPS.values() for kind in group.kinds}
    )
    assert named <= {kind.__name__ for kind in KINDS}


def test_every_group_has_its_analysis() -> None:
    assert ANALYSES.keys() == GROUPS.keys()


def test_owned_rows_can_be_found_again() -> None:
    for table in RECORDING_TABLES:
        assert "recording_id" in TABLES[table].names
    for table in (*SPECIMEN_TABLES, *DIAGNOSIS_TABLES):
        assert "specimen_id" in TABLES[table].names
    for group in GROUPS.values():
        assert set(group.tables) <= TABLES.keys()
