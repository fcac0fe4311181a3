"""Held-out gain: a part of the session is left out of the fits of the plain and of the extended model, and predicted.

Parts are protocols where several show the mechanisms and the others know the material well enough to predict them; else
recordings within a protocol (levels, repeats), or blocks of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.diagnose.results import HeldOut, Predicted
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.search.extended_model import ExtendedFit
from pipeline.diagnose.simulation.session import Place, Session
from pipeline.diagnose.simulation.simulation import Simulation
from schemas.arrays import Float, Int
from schemas.errors import NotIdentifiableError

_DRAWS = 1000
"""Bootstrap draws of the gain."""
_SEED = 7
"""Of these draws."""
_RIDGE = 1e-12
"""Share of a normal matrix's diagonal that is added before it is inverted."""
_MOST = 12
"""Steps of a fit without a part at most."""


@dataclass(frozen=True)
class _Part:
    """What is left out at once: numbers of blocks."""

    name: str
    blocks: tuple[int, ...]


def predict_left_out(plain: ExtendedFit, extended: ExtendedFit) -> HeldOut | None:
    """Errors of both models on parts that they were not fitted to, pooled; None where nothing can be left out.

    Parameters
    ----------
    plain, extended : the plain model, and the one with the causes

    Notes
    -----
    gain = (χ²_plain − χ²_extended)/(χ²_plain − n) over the n features that the causes touch.
    Its interval is a bootstrap over blocks.
    """
    session = extended.of.session
    touched = extended.trace / max(float(extended.trace.sum()), 1e-300)
    parts = _choose_parts(extended, touched)
    if len(parts) < 2:
        return None
    found: list[tuple[int, float, float, int]] = []
    named: dict[str, tuple[float, float]] = {}
    predicted: list[Predicted] = []
    entries: list[Float] = []
    for part in parts:
        left = set(part.blocks)
        keep = [i not in left for i in range(len(session.places))]
        try:
            rest = session.part(keep)
        except NotIdentifiableError:
            continue
        simulation = Simulation(rest, extended.of.simulation)
        chosen = np.concatenate([np.arange(p.first, p.stop) for i, p in enumerate(session.places) if keep[i]])
        errors, values = [], []
        for fit in (plain, extended):
            of = fit.of.move_to(rest, simulation, fit.of.weight[chosen])
            rows = np.concatenate([chosen, np.arange(session.size, fit.solution.residual.size)])
            again = of.fit(fit.x, most=_MOST, jacobian=fit.solution.jacobian[rows], thorough=False)
            values.append(fit.of.predict(again.x))
            errors.append(session.whiten(session.value - values[-1]))
        entries.append(again.x[again.of.model.size :])  # of the extended model, the last
        own = []
        for i in part.blocks:
            place = session.places[i]
            if touched[i] < RULES.gain.touched:
                continue
            before, after = (float(np.sum(e[place.first : place.stop] ** 2)) for e in errors)
            own.append((i, before, after, place.stop - place.first))
            predicted.append(_record_prediction(session, place, values[0], values[1]))
        found += own
        size = sum(n for *_, n in own)
        if size:
            named[part.name] = _compute_rms([r[1] for r in own], size), _compute_rms([r[2] for r in own], size)
    if not found:
        return None
    table = np.array([r[1:] for r in found], dtype=float)
    pooled = table.sum(axis=0)
    draws = np.random.default_rng(_SEED).integers(0, len(found), (_DRAWS, len(found)))
    drawn = table[draws].sum(axis=1)
    gain = lower = upper = float("nan")
    if pooled[0] - pooled[2] > RULES.gain.removable * np.sqrt(2 * pooled[2]):
        gain = float(_compute_gain(pooled[0], pooled[1], pooled[2]))
        lower, upper = (
            float(v) for v in np.quantile(_compute_gain(drawn[:, 0], drawn[:, 1], drawn[:, 2]), [0.025, 0.975])
        )
    return HeldOut(
        before=float(np.sqrt(pooled[0] / pooled[2])),
        after=float(np.sqrt(pooled[1] / pooled[2])),
        gain=gain,
        lower=lower,
        upper=upper,
        size=int(pooled[2]),
        parts=named,
        predicted=tuple(predicted),
        entries=np.array(entries),
    )


def _record_prediction(session: Session, place: Place, plain: Float, extended: Float) -> Predicted:
    """What both models predict of a block."""
    own = slice(place.first, place.stop)
    recording = session.recordings[place.recording].recording_id
    return Predicted(recording, place.block.kind, place.block.label, plain[own], extended[own], session.sd[own])


def list_supporting_protocols(plain: ExtendedFit, extended: ExtendedFit) -> tuple[str, ...]:
    """Protocols in whose features the causes lower χ² clearly.

    Parameters
    ----------
    plain, extended : the plain model, and the one with the causes
    """
    session = extended.of.session
    before, after = plain.misfit, extended.misfit
    fall: dict[str, float] = {}
    for p in session.places:
        name = name_protocol(session, p.recording)
        own = slice(p.first, p.stop)
        fall[name] = fall.get(name, 0.0) + float(np.sum(before[own] ** 2) - np.sum(after[own] ** 2))
    return tuple(name for name in session.protocols if fall.get(name, 0.0) > RULES.gain.supports)


def name_protocol(session: Session, recording: int) -> str:
    """The protocol of a recording, by its number; a mechanical step is `relaxation`."""
    r = session.recordings[recording]
    return "relaxation" if (r.protocol, r.loading) == ("step", "mechanical") else r.protocol


def _compute_rms(squares: Sequence[float], size: int) -> float:
    """Root mean square from sums of squares."""
    return float(np.sqrt(sum(squares) / size))


def _compute_gain(before: Float | float, after: Float | float, size: Float | float) -> Float:
    """Share of the removable error that is removed, from −1 to 1."""
    removable = np.maximum(np.asarray(before) - size, 1e-9)
    return np.asarray(np.clip((np.asarray(before) - after) / removable, -1.0, 1.0))


def _choose_parts(extended: ExtendedFit, touched: Float) -> list[_Part]:
    """Protocols that show the causes; in smaller parts where the rest would not know what it is to predict them with."""
    session = extended.of.session
    by_protocol: dict[str, list[int]] = {}
    for i, p in enumerate(session.places):
        by_protocol.setdefault(name_protocol(session, p.recording), []).append(i)
    shows = [name for name, blocks in by_protocol.items() if touched[blocks].sum() > RULES.gain.shows]
    parts: list[_Part] = []
    for name in shows:
        whole = _Part(name, tuple(by_protocol[name]))
        parts += (
            [whole]
            if len(shows) > 1 and _is_predictable(extended, whole, touched)
            else _split_protocol(extended, whole, touched)
        )
    return parts


def _split_protocol(extended: ExtendedFit, part: _Part, touched: Float) -> list[_Part]:
    """A protocol's recordings dealt into parts, and these into blocks where needed; what cannot be predicted is not
    left out."""
    session = extended.of.session
    recordings: dict[int, list[int]] = {}
    for i in part.blocks:
        recordings.setdefault(session.places[i].recording, []).append(i)
    dealt: list[tuple[list[str], list[int]]] = [([], []) for _ in range(min(len(recordings), RULES.gain.most_parts))]
    for number, (recording, own) in enumerate(recordings.items()):
        names, blocks = dealt[number % len(dealt)]
        names.append(session.recordings[recording].recording_id)
        blocks.extend(own)
    found = []
    for names, blocks in dealt:
        smaller = _Part(", ".join(names), tuple(blocks))
        if len(dealt) > 1 and _is_predictable(extended, smaller, touched):
            found.append(smaller)
            continue
        units = _group_blocks(extended, blocks)
        for side in (0, 1):
            half = _Part(f"{smaller.name}, {('odd', 'even')[side]} blocks", tuple(i for u in units[side::2] for i in u))
            if half.blocks and len(half.blocks) < len(blocks) and _is_predictable(extended, half, touched):
                found.append(half)
    return found


def _group_blocks(extended: ExtendedFit, blocks: Sequence[int]) -> list[list[int]]:
    """Blocks by sweep or group of cycles, whose features need each other; one by one where all are of one such group."""
    by_state: dict[int, list[int]] = {}
    for i in blocks:
        by_state.setdefault(extended.of.session.places[i].state, []).append(i)
    return list(by_state.values()) if len(by_state) > 1 else [[i] for i in blocks]


def _is_predictable(extended: ExtendedFit, part: _Part, touched: Float) -> bool:
    """Whether the rest of the session determines the prediction of a part: its mean variance is below that of the
    noise."""
    places = extended.of.session.places
    jacobian = extended.solution.jacobian

    def features(blocks: Sequence[int]) -> Int:
        return np.concatenate([np.arange(places[i].first, places[i].stop) for i in blocks])

    keep = np.ones(jacobian.shape[0], dtype=bool)
    keep[features(part.blocks)] = False
    counted = [i for i in part.blocks if touched[i] >= RULES.gain.touched]
    if not counted:
        return True
    scale = np.sqrt(np.maximum(np.sum(jacobian**2, axis=0), 1e-300))
    normal = (jacobian[keep] / scale).T @ (jacobian[keep] / scale)
    spread = np.linalg.pinv(normal + _RIDGE * np.eye(scale.size), hermitian=True)
    rows = jacobian[features(counted)] / scale
    return float(np.mean(np.sum((rows @ spread) * rows, axis=1))) < RULES.gain.most_variance
