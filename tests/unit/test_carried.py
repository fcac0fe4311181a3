"""The kinds that stages pass on are the kinds that the night plans with."""

from __future__ import annotations

from pipeline.analyse.carried import KINDS
from pipeline.analyse.groups import ANALYSES
from pipeline.nightly.stages import CALIBRATION_KINDS, DIAGNOSIS_KIND, GROUPS, SPECIMEN_KINDS


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
