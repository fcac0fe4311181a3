"""The plain model: which parameters it has for a session, what they mean, and what is known of them beforehand.

θ holds the material (logarithms), the rig's constants (independent standard normal directions of their prior), the
actuation constant, the amplifier's gain and the sensing constants, as far as the session's features depend on them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from pipeline.physics.film import RelaxationModel, Shape
from pipeline.physics.rig import RIGID, Rig, RigPrior, rig_of_constants
from schemas.arrays import Float, Int

CLAMP_MASS = "clamp mass"
ACTUATION = "log actuation"
"""Entry of the actuation force per squared voltage."""
_NEAR, _FARTHEST = 8.0, 60.0
"""Standard deviations within which a rig's constants are searched, and those for its clamp where nothing so near comes close
to the data: what a clamp carries changes, and nobody writes it down."""
_RIG_NAMES = (CLAMP_MASS, "load-cell stiffness", "load-cell damping", "force gain")


PER_FORCE, PER_DISPLACEMENT = SENSING = "capacitance per force", "capacitance per displacement"
"""Entries that the capacitances are proportional to."""
STRAIN, TENSION, STRESS = "strain", "tension", "stress"
"""What a sensing region may follow under a voltage: the film's strain, which creeps under a tension as the film does; the tension,
where stiff electrodes keep it from creeping; or the stress that the voltage makes, where the active region itself pushes it."""
_FAR = 60.0
"""Limit of logarithms that have none of their own."""


@dataclass(frozen=True)
class Entry:
    """One entry of θ: prior mean and standard deviation (infinite: flat), bounds of a search, by default those of a logarithm.

    also : another mean that is as likely
    """

    name: str
    mean: float = 0.0
    sd: float = np.inf
    low: float = -_FAR
    high: float = _FAR
    also: float | None = None


@dataclass(frozen=True)
class Physical:
    """θ in physical terms.

    film : relaxation model
    rigs : constants of each rig, numbers
    actuation : F_A/V², N/kV²
    amplifier : kV/V, per rig
    pf_per_n, pf_per_mm : what the sensing region makes of the tension (at rest) and of the displacement
    sensing : as in `BaseModel`
    """

    film: RelaxationModel
    rigs: tuple[Rig, ...]
    actuation: float
    amplifier: tuple[float, ...]
    pf_per_n: float
    pf_per_mm: float
    sensing: str = STRAIN

    @property
    def k0(self) -> float:
        """N/mm, main spring of the film."""
        return self.film.k0


@dataclass(frozen=True)
class Several:
    """Several θ of one model at once, in physical terms: `members` (B,); all else as in `Physical`, one by one along a first axis
    (B, 1, 1)."""

    members: tuple[Physical, ...]
    k0: Float
    rigs: tuple[Rig, ...]
    actuation: Float
    amplifier: tuple[Float, ...]
    pf_per_n: Float
    pf_per_mm: Float
    sensing: str

    @classmethod
    def of(cls, members: Sequence[Physical]) -> Several:
        def column(values: Iterable[float]) -> Float:
            return np.array(list(values))[:, None, None]

        def stacked(rigs: Sequence[Rig]) -> Rig:
            mass, stiffness, damping, gain = np.array([r.numbers for r in rigs]).T[:, :, None, None]
            return Rig(mass, stiffness, damping, gain, rigs[0].extra)

        return cls(
            tuple(members),
            column(m.k0 for m in members),
            tuple(stacked(rigs) for rigs in zip(*(m.rigs for m in members), strict=True)),
            column(m.actuation for m in members),
            tuple(column(gains) for gains in zip(*(m.amplifier for m in members), strict=True)),
            column(m.pf_per_n for m in members),
            column(m.pf_per_mm for m in members),
            members[0].sensing,
        )

    @cached_property
    def films(self) -> tuple[tuple[RelaxationModel, ...], Int]:
        """The films (F,) that differ, and which of them each member (B,) has."""
        place: dict[RelaxationModel, int] = {}
        number = [place.setdefault(m.film, len(place)) for m in self.members]
        return tuple(place), np.array(number)

    def some(self, places: Sequence[int], hidden: Mapping[str, Any]) -> Several:
        """Members at some places, with fields that take one value for all."""
        at = np.array(places)

        def rig(whole: Rig) -> Rig:
            mass, stiffness, damping, gain = np.array([whole.mass, whole.stiffness, whole.damping, whole.gain])[:, at]
            return Rig(mass, stiffness, damping, gain, whole.extra)

        fields = {name: getattr(self, name)[at] for name in ("k0", "actuation", "pf_per_n", "pf_per_mm")}
        given = {name: np.full_like(fields[name], value) if name in fields else value for name, value in hidden.items()}
        return Several(
            members=tuple(self.members[i] for i in places),
            rigs=tuple(rig(r) for r in self.rigs),
            amplifier=tuple(gain[at] for gain in self.amplifier),
            **{**fields, "sensing": self.sensing, **given},
        )


@dataclass(frozen=True)
class BaseModel:
    """The plain model of a session: a film with `arms` relaxation arms (and a pure dashpot), and the entries of θ.

    loaded : the rig that each rig is, itself or an earlier one, which has its entries, and the known mass on its clamp, N s²/mm
    sensing : what the sensing region follows under a voltage: `STRAIN`, `TENSION` or `STRESS`
    is_sized : whether sizes and permittivity are believed whatever θ says of the actuation
    """

    arms: int
    dashpot: bool
    entries: tuple[Entry, ...]
    rigs: tuple[RigPrior | None, ...]
    loaded: tuple[tuple[int, float], ...]
    sensing: str = STRAIN
    is_sized: bool = False

    @property
    def size(self) -> int:
        return len(self.entries)

    @cached_property
    def names(self) -> tuple[str, ...]:
        return tuple(e.name for e in self.entries)

    def index(self, name: str) -> int | None:
        return self.names.index(name) if name in self.names else None

    @property
    def film(self) -> slice:
        """Places of the material in θ."""
        return slice(0, self.shape.size)

    @cached_property
    def shape(self) -> Shape:
        """The material's entries."""
        return Shape(self.arms, dashpot=self.dashpot)

    def physical(self, theta: Float) -> Physical:
        """θ (P,) in physical terms."""
        at = self.film.stop
        rigs = []
        for prior in self.rigs:
            if prior is None:
                rigs.append(RIGID)
            else:
                rigs.append(rig_of_constants(prior.values(theta[at : at + prior.size])))
                at += prior.size
        rigs = [replace(rigs[of], extra=extra) if extra else rigs[of] for of, extra in self.loaded]
        named = dict(zip(self.names[at:], theta[at:].tolist(), strict=True))
        return Physical(
            film=self.shape.model(theta),
            rigs=tuple(rigs),
            actuation=float(np.exp(named.get(ACTUATION, 0.0))),
            amplifier=tuple(float(np.exp(named.get(f"log amplifier {i}", 0.0))) for i in range(len(self.rigs))),
            pf_per_n=float(named.get(PER_FORCE, 0.0)),
            pf_per_mm=float(named.get(PER_DISPLACEMENT, 0.0)),
            sensing=self.sensing,
        )

    def theta(self, film: RelaxationModel, **named: float) -> Float:
        """θ from a film of this order and entries by name (spaces as underscores); what is not given takes its prior mean.

        Raises ValueError for a film of another order.
        """
        if len(film.k) != self.arms or (film.c_inf > 0) != self.dashpot:
            raise ValueError(f"a film with {len(film.k)} arms, the model has {self.arms}")
        theta = np.array([e.mean for e in self.entries])
        theta[self.film] = self.shape.theta(film)
        for name, value in named.items():
            place = self.index(name.replace("_", " "))
            if place is None:
                raise ValueError(f"no entry {name!r}")
            theta[place] = value
        return theta

    def free_actuation(self, theta: Float, far: float) -> BaseModel:
        """The model that does not believe what sizes and permittivity say of the actuation, where θ contradicts it; itself where it
        `is_sized`.

        Where the sizes can be read in two ways, the other one is believed before none is.

        Parameters
        ----------
        theta : (P,) entries
        far : standard deviations from which it is contradicted
        """
        place = self.index(ACTUATION)
        if (
            self.is_sized
            or place is None
            or not abs(theta[place] - self.prior_mean[place]) > far * self.prior_sd[place]
        ):
            return self
        entries, entry = list(self.entries), self.entries[place]
        if entry.also is not None and abs(theta[place] - entry.also) <= far * entry.sd:
            entries[place] = replace(entry, mean=entry.also, also=None)
        else:
            entries[place] = replace(entry, sd=float("inf"))
        return replace(self, entries=tuple(entries))

    @property
    def widened(self) -> BaseModel:
        """The model with clamps as far from their files as these are wrong by a factor, whatever error they claim."""
        entries = (replace(e, low=-_FARTHEST, high=_FARTHEST) if CLAMP_MASS in e.name else e for e in self.entries)
        return replace(self, entries=tuple(entries))

    @property
    def is_widened(self) -> bool:
        return any(e.high == _FARTHEST for e in self.entries)

    def with_clamps(self, theta: Float, ratio: float) -> Float:
        """θ with every clamp's mass `ratio` times that of its file, as far as it is known with an error at all."""
        moved = theta.copy()
        for prior, places in self._of_rigs:
            for i in places:
                if CLAMP_MASS in self.names[i]:
                    moved[i] = np.log(ratio) * prior.nominal[0] / prior.factor[0, i - places.start]
        return moved

    def with_rigs_as_filed(self, theta: Float) -> Float:
        """θ with every clamp's mass and load cell's stiffness as their files say."""
        moved = theta.copy()
        for _, places in self._of_rigs:
            for i in places:
                if any(name in self.names[i] for name in _RIG_NAMES[:2]):
                    moved[i] = 0.0
        return moved

    @property
    def _of_rigs(self) -> Iterator[tuple[RigPrior, range]]:
        """Every rig that has constants, with their places in θ."""
        at = self.film.stop
        for prior in filter(None, self.rigs):
            yield prior, range(at, at + prior.size)
            at += prior.size

    def with_loads(self, loaded: tuple[tuple[int, float], ...]) -> BaseModel:
        """The same entries for further rigs as well, which are those known with other masses on their clamps."""
        return replace(self, rigs=(*self.rigs, *(None,) * (len(loaded) - len(self.rigs))), loaded=loaded)

    @cached_property
    def prior_mean(self) -> Float:
        return np.array([e.mean for e in self.entries])

    @cached_property
    def prior_sd(self) -> Float:
        return np.array([e.sd for e in self.entries])


def film_entries(arms: int, dashpot: bool, times_s: tuple[float, float]) -> list[Entry]:
    """Entries of the material; relaxation times are searched within `times_s`."""
    low, high = np.log(times_s[0]), np.log(times_s[1])
    entries = [Entry("log k0")] + [Entry(f"log k{i}") for i in range(1, arms + 1)]
    entries += [Entry(f"log tau{i}", low=low, high=high) for i in range(1, arms + 1)]
    return entries + ([Entry("log c_inf")] if dashpot else [])


def rig_entries(number: int, prior: RigPrior | None) -> list[Entry]:
    """One standard normal entry per direction of a rig's prior."""
    if prior is None:
        return []
    names = []
    for column in prior.factor.T:
        strongest = int(np.argmax(np.abs(column) / np.maximum(np.abs(prior.nominal), 1e-300)))
        names.append(f"rig {number} {_RIG_NAMES[strongest]}")
    unique = [n if names.count(n) == 1 else f"{n} ({i})" for i, n in enumerate(names)]
    return [Entry(n, 0.0, 1.0, -_NEAR, _NEAR) for n in unique]
