"""Families of blocks that are linear functionals of a record: one rig, one kind of test, one set of nodes.

The response of a family is computed at the nodes once, or once per state where an effect depends on the state, and passes
through all operators in one product. What the response is, and what is not linear, is in `mechanical` and
`predict_electrical`.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property, lru_cache, partial
from typing import Any, ClassVar, Self

import numpy as np

from pipeline.diagnose.features.blocks import operator_of
from pipeline.diagnose.features.functionals import Operator
from pipeline.diagnose.features.kinds import CHIRP_RESPONSE
from pipeline.diagnose.simulation.effects import NONE, Effect, Factor, Film, View
from pipeline.diagnose.simulation.node_weights import NodeWeights, WeightsByState
from pipeline.diagnose.simulation.nodes import POINTS, carried, fewer_nodes, interpolation
from pipeline.diagnose.simulation.parameters import Physical, Several
from pipeline.diagnose.simulation.session import Place, Session, follow_sweep
from pipeline.physics.film import RelaxationModel, stiffnesses
from pipeline.physics.rig import Rig
from schemas.arrays import Complex, Float, Int

_WORTH = 0.7
"""Share of the nodes of a family at most with which it is worth while to have few of them."""


class Family:
    """Blocks of one rig and one test kind that share nodes.

    `frequency` (J,) Hz the nodes that any of them uses; `states` (S,) numbers of the session's states in use.
    """

    _of_nodes: ClassVar[tuple[str, ...]] = ("_weights", "_weights_by_state")
    """What is made when it is first needed, for the nodes at hand."""

    def __init__(self, session: Session, places: Sequence[Place], nodes: Float, test: str) -> None:
        self.session, self.places, self.test = session, tuple(places), test
        operators = [operator_of(p.block, nodes.size) for p in self.places]
        columns = np.unique(np.concatenate([part.indices for o in operators for part in (o.re, o.im)]))
        self.frequency, self._nodes = nodes[columns], nodes
        self.states, number = np.unique([p.state for p in self.places], return_inverse=True)
        self.state_of = dict(zip((id(p) for p in self.places), number.tolist(), strict=True))
        self.rows = np.concatenate([np.arange(p.first, p.stop) for p in self.places])
        self._operators = [Operator(o.re[:, columns], o.im[:, columns]) for o in operators]
        self.rig = int(session.states.rig[self.states[0]])
        self.view = self._view()

    def _view(self) -> View:
        view = state_view(self.session, self.states, self.frequency[None, :], self.test)
        profiles = self._profiles()
        return view if profiles is None else replace(view, strain=profiles[0], elapsed=profiles[1])

    def with_few_nodes(self, physical: Physical) -> Self | None:
        """The same features from few nodes about the resonance of a film and rig; None where these are hardly fewer.

        Its predictions raise `Elsewhere` where a resonance is not carried by them.
        """
        # A resonance beyond what a family sees is near to its end: all nodes are asked where it is.
        rig, whole = rig_of(physical, self.rig, NONE), replace(self.view, frequency_hz=self._nodes[None, :])
        k = film_at(physical, NONE, whole).k
        ends = float(self.frequency[0]), float(self.frequency[-1])
        found = fewer_nodes(self._nodes, rig.loaded(k, dynamic(rig, whole, NONE, k))[0], ends)
        if found.size > _WORTH * self.frequency.size or found.size <= POINTS:
            return None
        weights = interpolation(found, self.frequency, POINTS)
        other = copy.copy(self)
        for made in self._of_nodes:
            other.__dict__.pop(made, None)
        other.frequency = found
        other._operators = [Operator(o.re @ weights, o.im @ weights) for o in self._operators]
        known, wanted = (np.log(np.maximum(f, 1e-9)) for f in (self.frequency, found))

        def at_them(profile: Float) -> Float:
            if profile.shape[1] == 1:
                return profile
            return np.array([np.interp(wanted, known, row) for row in profile])

        other.view = replace(
            self.view,
            frequency_hz=found[None, :],
            strain=at_them(self.view.strain),
            elapsed=at_them(self.view.elapsed),
            few=True,
        )
        return other

    def _profiles(self) -> tuple[Float, Float] | None:
        """Strain amplitude and mechanical cycles so far at the nodes, for sweeps; None for other tests."""
        found: dict[int, tuple[Float, Float]] = {}
        before: dict[int, float] = {}
        for p in self.places:
            if p.block.kind != CHIRP_RESPONSE:
                continue
            f, mm = p.block.support["profile_hz"], p.block.support["profile_mm"]
            elapsed = before.get(p.recording, 0.0) + follow_sweep(p.block)
            before[p.recording] = float(elapsed.max())
            rising = np.argsort(f)
            x = np.log(np.maximum(self.frequency, 1e-9))
            found[self.state_of[id(p)]] = (
                np.interp(x, np.log(f[rising]), mm[rising]) / self.session.scale.length_mm,
                np.interp(x, np.log(f[rising]), elapsed[rising]),
            )
        if not found:
            return None
        shape = self.states.size, self.frequency.size
        strain: Float = np.zeros(shape)
        elapsed_all: Float = np.zeros(shape)
        for state in range(shape[0]):
            # The level of a recording has no sweep of its own: that of any sweep of its recording will do.
            number = state if state in found else self._any_sweep(state, found)
            strain[state], elapsed_all[state] = found[number]
        return strain, elapsed_all

    def _any_sweep(self, state: int, found: dict[int, tuple[Float, Float]]) -> int:
        recording = self.session.states.recording[self.states[state]]
        same = [n for n in found if self.session.states.recording[self.states[n]] == recording]
        return same[-1] if same else next(iter(found))

    @cached_property
    def _weights(self) -> NodeWeights:
        """Of all blocks."""
        return NodeWeights(self._operators)

    @cached_property
    def _weights_by_state(self) -> WeightsByState:
        """Of the blocks of each state."""
        ends = np.cumsum([0, *(p.block.size for p in self.places)])
        found = []
        for state in range(self.states.size):
            own = [i for i, p in enumerate(self.places) if self.state_of[id(p)] == state]
            rows = np.concatenate([np.arange(ends[i], ends[i + 1]) for i in own])
            found.append((rows, [self._operators[i] for i in own]))
        return WeightsByState(found)

    def apply(self, response: Complex) -> Float:
        """Features (rows,) of a response (1 or S, J) at the nodes; of several (B, 1 or S, J) at once (B, rows)."""
        if response.shape[-2] == 1:
            return self._weights.apply(response[..., 0, :])
        return self._weights_by_state.apply(response)


def state_view(session: Session, number: Int, frequency: Float, test: str, *, strain: Float | None = None) -> View:
    """View of the session's states `number` (S,) at frequencies (1 or S, J)."""
    states = session.states

    def column(values: Float) -> Float:
        return np.asarray(values[number][:, None])

    return View(
        frequency_hz=frequency,
        strain=column(states.strain) if strain is None else strain,
        largest_strain=column(states.largest_strain),
        strain_before=column(states.strain_before),
        cycle=column(states.cycle),
        elapsed=np.maximum(column(states.cycle) - 0.5, 0.0),
        recording_s=column(states.recording_s),
        session_s=column(states.session_s),
        voltage_kv=column(states.voltage_kv),
        exposure_kv2_s=column(states.exposure_kv2_s),
        exposure_start_kv2_s=column(states.exposure_start_kv2_s),
        temperature_k=column(states.temperature_k),
        first_temperature_s=column(states.first_temperature_s),
        rest_force_n=column(states.rest_force_n),
        scale=session.scale,
        test=test,
        cycles_before=column(states.cycles_before),
        path_before=column(states.path_before),
    )


def rig_of(physical: Physical | Several, number: int, effect: Effect) -> Rig:
    """Constants of a rig with the effects on them, and with what is on its clamp."""
    rig = physical.rigs[number]
    for change in effect.rig:
        rig = change(rig)
    return replace(rig, mass=rig.mass + rig.extra, extra=0.0) if rig.extra else rig


def dynamic(rig: Rig, view: View, effect: Effect, k: Complex) -> Complex:
    """1 + (−Mω² + jωcL)/kL at the view's frequencies, with a film of stiffness k (..., 1 or S, J) N/mm on the clamp.

    Raises `Elsewhere` where the view has few nodes that do not carry the resonance of both.
    """
    own = rig.clamp(2 * np.pi * view.frequency_hz)
    for change in effect.clamp:
        own = change(own, rig, view, k)
    if view.few:
        carried(rig.loaded(k, own))
    return own


def channel(functions: Sequence[Factor], view: View) -> Complex | Float | float:
    """Product of what effects do to a channel."""
    total: Any = 1.0
    for function in functions:
        total = total * function(view)
    product: Complex | Float | float = total
    return product


def film_at(physical: Physical | Several, effect: Effect, view: View) -> Film:
    """The film at the frequencies of a view, (1 or S, J); several (B, 1 or S, J)."""
    if isinstance(physical, Several):
        films, number = physical.films
        film = Film(stiffnesses(films, view.frequency_hz)[number])
    else:
        film = Film(_stiffness(physical.film, view))
    if effect.film:
        view = replace(view, k0=physical.k0, shifted=partial(_shift, physical, view, film.k))
    for change in effect.film:
        film = change(film, view)
    return film


def _shift(physical: Physical | Several, view: View, plain: Complex, log_times: Float) -> Complex:
    """Stiffness of the linear film with its relaxation times multiplied by e^`log_times`, as at as many times the frequency, over that of the
    film as it is; shape of `film_at`.

    Parameters
    ----------
    plain : N/mm, stiffness of the film as it is, as `film_at` has it
    log_times : (1 or S, 1 or J), or of each of several films (B, 1 or S, 1 or J)
    """
    frequency = view.frequency_hz * np.exp(log_times)
    if not isinstance(physical, Several):
        return np.asarray(physical.film.stiffness(frequency) / plain)
    films, number = physical.films
    if frequency.ndim > 2:
        shifted = np.array([films[n].stiffness(own) for n, own in zip(number, frequency, strict=True)])
    else:
        shifted = stiffnesses(films, frequency)[number]
    return np.asarray(shifted / plain)


@lru_cache(maxsize=128)
def _stiffness(film: RelaxationModel, view: View) -> Complex:
    """Stiffness N/mm of the linear film at the frequencies of a view, (1 or S, J), not to be changed.

    Kept for some films and views: whatever else than the film is moved, it is the same.
    """
    found = film.stiffness(view.frequency_hz)
    found.flags.writeable = False
    return found
