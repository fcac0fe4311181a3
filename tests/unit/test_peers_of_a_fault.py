"""Which recordings say that a mechanism would show in them as well: those that agree, where they are not the few."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

from hypothesis import given
from hypothesis import strategies as st

from pipeline.diagnose.faults.peers import list_peers
from pipeline.diagnose.simulation.session import Session
from tests.unit.test_diagnosis_tables import recording


@given(st.lists(st.tuples(st.sampled_from(["electrical", "mechanical"]), st.booleans()), min_size=1, max_size=12))
def test_few_that_agree_are_what_the_film_was_fitted_to(made: list[tuple[str, bool]]) -> None:
    """Four tests under voltage missed a plain model that only the fifth agreed with, and one of the four was called another film's."""
    recordings = [replace(recording(f"r-{i}"), loading=loading) for i, (loading, _) in enumerate(made)]
    session = cast(Session, SimpleNamespace(recordings=recordings))
    asked = frozenset(r.recording_id for r, (_, outside) in zip(recordings, made, strict=True) if outside)
    for own in recordings:
        alike = [r for r in recordings if r.loading == own.loading]
        agreeing = [r for r in alike if r.recording_id not in asked]
        assert list_peers(own, session, asked) == (agreeing if len(agreeing) >= len(alike) - len(agreeing) else [])
