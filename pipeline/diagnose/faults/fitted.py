"""A session with its simulation and its plain fit, as the search for faults passes them on."""

from __future__ import annotations

from collections.abc import Sequence

from pipeline.diagnose.features.kinds import RecordingFeatures
from pipeline.diagnose.search.plain_fit import PlainFit, fit_plain
from pipeline.diagnose.simulation.hum import with_hum
from pipeline.diagnose.simulation.session import Session, make_session
from pipeline.diagnose.simulation.simulation import Simulation

Fitted = tuple[Session, Simulation, PlainFit]


def assemble_session(recordings: Sequence[RecordingFeatures]) -> Session:
    """A session with the mains that its rests show."""
    return with_hum(make_session(recordings))


def fit_session(recordings: Sequence[RecordingFeatures]) -> Fitted:
    """A session, its simulation and its plain fit."""
    session = assemble_session(recordings)
    simulation = Simulation(session)
    return session, simulation, fit_plain(session, simulation)
