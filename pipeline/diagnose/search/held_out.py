"""Held-out gain: a part of the session is left out of the fits of the plain and of the extended model, and predicted.

Parts are protocols where several show the mechanisms and the others know the material well enough to predict them; else
recordings within a protocol (levels, repeats), or blocks of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.diagnose.features.kinds import AMPLIFIER
from pipeline.diagnose.results import HeldOut, Predicted
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.search.extended_model import ExtendedFit
from pipeline.diagnose.search.form_functions import WIDTHS, compute_columns
from pipeline.diagnose.search.likelihood import Groups, Linearised, find_absorbed, find_peak
from pipeline.diagnose.search.posterior import RegionFit
from pipeline.diagnose.simulation.session import Place, Session, name_test
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


@dataclass(frozen=True)
class _Asked:
    """The model that parts are left out of.

    Parameters
    ----------
    session : what it was fitted to
    jacobian : (M, P) of its whitened residuals and of what priors add
    touched : (B,) share that each block has of all that it explains
    """

    session: Session
    jacobian: Float
    touched: Float


@dataclass(frozen=True)
class _Left:
    """Errors in a block that was left out: its number, χ² before and after, and features."""

    block: int
    before: float
    after: float
    size: int


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
    trace = _measure_told(extended)
    asked = _Asked(session, extended.solution.jacobian, trace / max(float(trace.sum()), 1e-300))
    parts = _choose_parts(asked)
    if len(parts) < 2:
        return None
    found: dict[str, list[_Left]] = {}
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
        found[part.name] = _measure_part(asked, part, errors[0], errors[1])
        predicted += [
            _record_prediction(session, session.places[left.block], values[0], values[1]) for left in found[part.name]
        ]
    return _pool_parts(found, predicted, entries)


def _measure_told(extended: ExtendedFit) -> Float:
    """(B,) what shows of the causes in each block: beside the lag of the amplifier, of what film and rig make of the voltage that was
    measured. What the amplifier makes of its command shows the lag, and nearly all of that its simulation removes."""
    if extended.of.leaves_film:
        return extended.trace
    of_film = [p.block.kind not in AMPLIFIER for p in extended.of.session.places]
    return np.where(of_film, extended.trace, 0.0)


def predict_by_function(region: RegionFit) -> HeldOut | None:
    """The same of a region without a name: its function and the widths of its weights are found anew without each part.

    Parameters
    ----------
    region : the region with the plain model that it was computed about; both are followed to first order

    Returns
    -------
    Errors of the plain model and of that with the function; None where nothing can be left out
    """
    plain = region.plain
    session, about = plain.of.session, Linearised.of(plain)
    columns = compute_columns(plain, region.region)
    change, absorbed = columns @ region.weights, find_absorbed(plain)
    change = change - absorbed @ (absorbed.T @ change)
    trace = np.array([float(np.sum(change[p.first : p.stop] ** 2)) for p in session.places])
    # Its widths are known from the whole to choose parts by; they are found anew without each.
    spread = np.sqrt(np.maximum(np.diag(region.covariance) + region.weights**2, 0.0))
    whole = about.extend(columns * spread)
    jacobian = np.concatenate([whole.jacobian, whole.beside_jacobian])
    asked = _Asked(session, jacobian, trace / max(float(trace.sum()), 1e-300))
    parts = _choose_parts(asked)
    if len(parts) < 2:
        return None
    functions = [about, *(about.extend(columns * width * region.region.width) for width in WIDTHS)]
    found = {part.name: _measure_part(asked, part, *_predict_part(asked, part, functions)) for part in parts}
    return _pool_parts(found, [], [])


def _predict_part(asked: _Asked, part: _Part, models: Sequence[Linearised]) -> tuple[Float, Float]:
    """(N,) whitened errors of the first model, and of the likeliest of the others, fitted without a part."""
    kept = np.ones(asked.session.size)
    for i in part.blocks:
        kept[asked.session.places[i].first : asked.session.places[i].stop] = 0.0
    groups, size = Groups.of(asked.session), models[0].jacobian.shape[1]
    nothing = np.zeros(groups.size.size)
    found = []
    for model in models:
        seen = Linearised(
            model.residual * kept, model.jacobian * kept[:, None], model.beside, model.beside_jacobian
        )  # fmt: skip
        peak = find_peak(groups, seen, nothing, size, noise_alone=False)
        own = peak.covariance[size:, size:]
        evidence = peak.log_likelihood + (0.5 * float(np.linalg.slogdet(own)[1]) if own.size else 0.0)
        found.append((evidence, model.residual + model.jacobian @ peak.step))
    return found[0][1], max(found[1:], key=lambda pair: pair[0])[1]


def _measure_part(asked: _Asked, part: _Part, before: Float, after: Float) -> list[_Left]:
    """The blocks of a part that the causes touch, with the errors (N,) of both models there."""
    found = []
    for i in part.blocks:
        place = asked.session.places[i]
        if asked.touched[i] >= RULES.gain.touched:
            own = slice(place.first, place.stop)
            found.append(_Left(i, float(np.sum(before[own] ** 2)), float(np.sum(after[own] ** 2)), place.block.size))
    return found


def _pool_parts(
    by_part: dict[str, list[_Left]], predicted: Sequence[Predicted], entries: Sequence[Float]
) -> HeldOut | None:
    """Errors over all parts with the gain and its interval; None where no cause touches any."""
    found = [left for own in by_part.values() for left in own]
    if not found:
        return None
    named = {
        name: (_compute_rms([r.before for r in own], size), _compute_rms([r.after for r in own], size))
        for name, own in by_part.items()
        if (size := sum(r.size for r in own))
    }
    table = np.array([(r.before, r.after, r.size) for r in found], dtype=float)
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
        lower=min(lower, gain),
        upper=max(upper, gain),
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
        name = name_test(session.recordings[p.recording])
        own = slice(p.first, p.stop)
        fall[name] = fall.get(name, 0.0) + float(np.sum(before[own] ** 2) - np.sum(after[own] ** 2))
    return tuple(name for name in session.protocols if fall.get(name, 0.0) > RULES.gain.supports)


def _compute_rms(squares: Sequence[float], size: int) -> float:
    """Root mean square from sums of squares."""
    return float(np.sqrt(sum(squares) / size))


def _compute_gain(before: Float | float, after: Float | float, size: Float | float) -> Float:
    """Share of the squared error beyond the noise that is removed, from −1 to 1."""
    removable = np.maximum(np.asarray(before) - size, 1e-9)
    return np.asarray(np.clip((np.asarray(before) - after) / removable, -1.0, 1.0))


def _choose_parts(asked: _Asked) -> list[_Part]:
    """Protocols that show the causes; in smaller parts where the rest would not know what it is to predict them with."""
    session, touched = asked.session, asked.touched
    by_protocol: dict[str, list[int]] = {}
    for i, p in enumerate(session.places):
        by_protocol.setdefault(name_test(session.recordings[p.recording]), []).append(i)
    shows = [name for name, blocks in by_protocol.items() if touched[blocks].sum() > RULES.gain.shows]
    parts: list[_Part] = []
    for name in shows:
        whole = _Part(name, tuple(by_protocol[name]))
        parts += [whole] if len(shows) > 1 and _is_predictable(asked, whole) else _split_protocol(asked, whole)
    return parts


def _split_protocol(asked: _Asked, part: _Part) -> list[_Part]:
    """A protocol's recordings dealt into parts, and these into blocks where needed; what cannot be predicted is not
    left out."""
    session = asked.session
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
        if len(dealt) > 1 and _is_predictable(asked, smaller):
            found.append(smaller)
            continue
        units = _group_blocks(asked.session, blocks)
        for side in (0, 1):
            half = _Part(f"{smaller.name}, {('odd', 'even')[side]} blocks", tuple(i for u in units[side::2] for i in u))
            if half.blocks and len(half.blocks) < len(blocks) and _is_predictable(asked, half):
                found.append(half)
    return found


def _group_blocks(session: Session, blocks: Sequence[int]) -> list[list[int]]:
    """Blocks by sweep or group of cycles, whose features need each other; one by one where all are of one such group."""
    by_state: dict[int, list[int]] = {}
    for i in blocks:
        by_state.setdefault(session.places[i].state, []).append(i)
    return list(by_state.values()) if len(by_state) > 1 else [[i] for i in blocks]


def _is_predictable(asked: _Asked, part: _Part) -> bool:
    """Whether the rest of the session determines the prediction of a part: its mean variance is below that of the
    noise."""
    places, jacobian = asked.session.places, asked.jacobian

    def features(blocks: Sequence[int]) -> Int:
        return np.concatenate([np.arange(places[i].first, places[i].stop) for i in blocks])

    keep = np.ones(jacobian.shape[0], dtype=bool)
    keep[features(part.blocks)] = False
    counted = [i for i in part.blocks if asked.touched[i] >= RULES.gain.touched]
    if not counted:
        return True
    scale = np.sqrt(np.maximum(np.sum(jacobian**2, axis=0), 1e-300))
    normal = (jacobian[keep] / scale).T @ (jacobian[keep] / scale)
    spread = np.linalg.pinv(normal + _RIDGE * np.eye(scale.size), hermitian=True)
    rows = jacobian[features(counted)] / scale
    return float(np.mean(np.sum((rows @ spread) * rows, axis=1))) < RULES.gain.most_variance
