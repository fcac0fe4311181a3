"""Oscillator of one mode with weak nonlinearities, driven by a measured input: many parameter sets in one run.

In units of a reference amplitude of the output A and a reference angular frequency w (time in 1/w):

    y″ + δ y′ + κ y + β₂ y² + β₃ y³ + c |y′| y′ + a q = γ u(t)/A,      q′ = y′ − (r + s |y′|) q
    z_j″ + δ_j z_j′ + κ_j z_j = γ_j u(t)/A,      x = y + z₁ + z₂
    reading = x/√(1 + l x²), late by Δ

with δ, κ, γ the linear system of one mode, and z_j further modes that stay linear: they are read off their responses. β₃ > 0 is the hardening spring of Duffing (Nayfeh and Mook, Nonlinear
Oscillations, chapter 4), β₂ one that is stiffer on one side, c quadratic damping; q with s = 0 is a Maxwell arm of rate
r, with r = 0 a slider in series with a spring in the smooth form of Dahl (1968), which yields at a/s. Between samples
the input is band-limited (a step between two of them is taken as midway), goes straight, or is held: see `HOLDS`.

What a damped oscillator did long ago it has forgotten: a record is cut into stretches that run side by side, each with
a run-in that is not used. Does not belong here: which terms are free, and how they are fitted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter, resample

from schemas.arrays import Bool, Complex, Float

STIFFNESS, DAMPING, GAIN, QUADRATIC, CUBIC, DRAG, ARM, RATE, SLIP, CEILING, DELAY = range(11)
"""Rows of the parameters: κ, δ, γ, β₂, β₃, c, a, ln r, ln s, l, Δ. A rate or slip of −∞ is none."""
FURTHER = ((11, 12, 13), (14, 15, 16))
"""Rows of κ, δ, γ of each further mode; without a gain γ it is none."""
PARAMETERS = 17
"""Number of parameters."""
BAND_LIMITED, STRAIGHT, HELD = "is band-limited", "goes straight", "is held"
HOLDS = (BAND_LIMITED, STRAIGHT, HELD)
"""What an input may do from sample to sample: one that was measured behind a filter is band-limited, one that a converter puts out is held,
and one that was computed may go straight. A held one is half an interval later than the others."""
_IMAGES = 4
"""Images of the sampled spectrum on each side that a held or a straight input passes on."""

_FORGOTTEN = 1e-4
"""Share of a start that a run-in may leave."""
_SHORTEST = 64
"""Samples of the shortest stretches that run side by side."""
_TURN = 0.4
"""Most radians of the reference frequency that one step of Runge and Kutta takes."""


@dataclass(frozen=True)
class SystemRecord:
    """One record of a system.

    Parameters
    ----------
    input, output : (n,) in any unit, one value every `interval_s`
    periodic : whether it is one steady period
    from_rest : whether the system rests before it, at an input and output of zero. Of other records the means are not
        compared, and of those that are not periodic neither is the beginning
    """

    name: str
    input: Float
    output: Float
    interval_s: float
    periodic: bool = False
    from_rest: bool = False


@dataclass(frozen=True)
class Mode:
    """A linear resonance y″ + 2ζω y′ + ω² y = g u: ω in rad/s, ζ, and g."""

    angular_frequency: float
    ratio: float
    gain: float


def make_linear(damping: float, gain: float, further: Sequence[tuple[float, float, float]] = ()) -> Float:
    """(PARAMETERS,) of the linear system of κ = 1 with that δ and γ, and of further modes with κ, δ, γ each."""
    start = np.zeros(PARAMETERS)
    start[[STIFFNESS, DAMPING, GAIN]] = 1.0, damping, gain
    start[[RATE, SLIP]] = -np.inf
    for rows in FURTHER:
        start[list(rows)] = 1.0, 1.0, 0.0
    for rows, mode in zip(FURTHER, further, strict=False):
        start[list(rows)] = mode
    return start


def memory_s(angular_frequency: float, damping: float) -> float:
    """Seconds after which an oscillator of that w and δ has forgotten where it started: by the slower of its two poles."""
    ratio = damping / 2
    return float(-np.log(_FORGOTTEN) / angular_frequency / (ratio - np.sqrt(max(ratio**2 - 1, 0.0))))


def count_steps(records: Sequence[SystemRecord], angular_frequency: float, damping: float) -> float:
    """Steps of Runge and Kutta that a simulation of the records takes, run-in included."""
    interval = records[0].interval_s
    run_in = memory_s(angular_frequency, damping) / interval
    length = min(max(r.input.size for r in records), max(run_in, _SHORTEST))
    return (run_in + length) * max(1.0, angular_frequency * interval / _TURN)


def pass_hold(w: Float, interval: float, hold: str) -> list[tuple[Float, Complex]]:
    """Frequencies at which an input acts that is known at samples, and what of its spectrum does there.

    Parameters
    ----------
    w : (n,) below half the sampling rate, radians per unit of time
    interval : of the samples, in that unit
    hold : what the input does between samples

    Returns
    -------
    (n,) each image of the frequencies, and (n,) the response of the hold there
    """
    images = [0] if hold == BAND_LIMITED else range(-_IMAGES, _IMAGES + 1)
    frequencies = [w + 2 * np.pi * image / interval for image in images]
    return [(v, respond_of_hold(v, interval, hold)) for v in frequencies]


def respond_of_hold(w: Float, interval: float, hold: str) -> Complex:
    """(n,) response of a hold at frequencies (n,), radians per unit of time: one if band-limited, sinc e^(−jwT/2) if held, sinc² if straight."""
    if hold == BAND_LIMITED:
        return np.ones(w.size, dtype=complex)
    half = w * interval / 2
    size = np.sinc(half / np.pi)
    return np.asarray(size * np.exp(-1j * half) if hold == HELD else size.astype(complex) ** 2)


class Oscillator:
    """Simulation of records of one system.

    amplitude : A, unit of the output; angular_frequency : w, rad/s; damping : least δ that is expected, for the run-in;
    memory : s, of further modes where they remember longer; finer : steps for one that would do; hold : what the input does between samples
    """

    def __init__(
        self,
        records: Sequence[SystemRecord],
        amplitude: float,
        angular_frequency: float,
        damping: float,
        *,
        memory: float = 0.0,
        finer: int = 1,
        hold: str = BAND_LIMITED,
    ) -> None:
        interval = records[0].interval_s
        self.hold = hold
        self.records = tuple(records)
        self.amplitude, self.angular_frequency = amplitude, angular_frequency
        self._given = damping, memory, finer
        self.run_in = int(np.ceil(max(memory_s(angular_frequency, damping), memory) / interval))
        self._steps = finer * max(1, int(np.ceil(angular_frequency * interval / _TURN)))
        self._h = angular_frequency * interval / self._steps
        longest = max(r.input.size for r in records)
        self._length = min(longest, max(self.run_in, _SHORTEST))
        stretches = [self._stretches(r) for r in records]
        self._count = [s.shape[1] for s in stretches]
        self._input: Float = np.concatenate(stretches, axis=1)

    def refine(self) -> Oscillator:
        """The same in steps half as long."""
        damping, memory, finer = self._given
        return Oscillator(
            self.records,
            self.amplitude,
            self.angular_frequency,
            damping,
            memory=memory,
            finer=2 * finer,
            hold=self.hold,
        )

    def _stretches(self, record: SystemRecord) -> Float:
        """(T, K) input over A of the K stretches of a record, at the T ends and middles of all steps."""
        n, fine = record.input.size, 2 * self._steps
        u = self._drive(record)
        if self.hold == HELD:
            between = np.repeat(u, fine)
        elif self.hold == STRAIGHT:
            around = np.append(u, u[0] if record.periodic else u[-1])
            between = np.interp(np.arange(n * fine) / fine, np.arange(n + 1), around)
        elif record.periodic:
            between = resample(u, n * fine)
        else:
            between = resample(np.concatenate([u, u[::-1]]), 2 * n * fine)[: n * fine]
        starts = np.arange(0, n, self._length)
        place = (starts - self.run_in) * fine + np.arange((self.run_in + self._length) * fine)[:, None]
        if record.periodic:
            return np.asarray(between[place % (n * fine)])
        return np.where((place >= 0) & (place < n * fine), between[np.clip(place, 0, n * fine - 1)], 0.0)

    def compared(self, record: SystemRecord) -> Bool:
        """(n,) samples that the start of the record does not reach."""
        known = record.periodic or record.from_rest
        return np.arange(record.input.size) >= (0 if known else min(self.run_in, record.input.size // 2))

    def __call__(self, parameters: Float) -> list[Float]:
        """(C, n) readings of every record, in the unit of its output, of C sets of parameters (PARAMETERS, C)."""
        with np.errstate(over="ignore", invalid="ignore"):
            x = self._integrate(parameters)
            for rows in FURTHER:
                chosen = np.flatnonzero(parameters[rows[2]] != 0)
                if chosen.size:
                    stiffness, damping, gain = parameters[list(rows)][:, chosen]
                    courses, which = np.unique(np.array([stiffness, damping]), axis=1, return_inverse=True)
                    x[chosen] += gain[:, None, None] * self._respond(*courses)[which]
            bent = np.flatnonzero(parameters[CEILING] != 0)
            x[bent] /= np.sqrt(1 + parameters[CEILING, bent, None, None] * x[bent] ** 2)
            return self._read(x, parameters[DELAY] / self.angular_frequency)

    def _respond(self, stiffness: Float, damping: Float) -> Float:
        """(C, K, L) of a linear mode of gain 1 at the samples of all stretches, from its frequency response; (C,) each."""
        found = []
        for record in self.records:
            n = record.input.size
            size = n if record.periodic else 2 * n
            w = 2 * np.pi * np.fft.rfftfreq(size, record.interval_s) / self.angular_frequency
            spectrum = np.fft.rfft(self._drive(record), size)
            response: Complex = np.zeros((stiffness.size, w.size), dtype=complex)
            interval = float(self.angular_frequency * record.interval_s)
            for v, passed in pass_hold(np.asarray(w), interval, self.hold):
                response += passed / (stiffness[:, None] - v**2 + 1j * damping[:, None] * v)
            values = np.fft.irfft(response * spectrum, size)[:, :n]
            count = -(-n // self._length)
            padded = np.zeros((stiffness.size, count * self._length))
            padded[:, :n] = values
            found.append(padded.reshape(stiffness.size, count, self._length))
        return np.concatenate(found, axis=1)

    def _drive(self, record: SystemRecord) -> Float:
        """(n,) input over A."""
        return np.asarray((record.input if record.from_rest else record.input - record.input.mean()) / self.amplitude)

    def _read(self, y: Float, delay_s: Float) -> list[Float]:
        """(C, n) of every record from the stretches (C, K, L), late by (C,)."""
        found, first = [], 0
        for record, count in zip(self.records, self._count, strict=True):
            mine = y[:, first : first + count]
            first += count
            out = self.amplitude * mine.reshape(len(y), -1)[:, : record.input.size]
            out = self._late(out, delay_s / record.interval_s, record.periodic)
            found.append(out if record.from_rest else out - out[:, self.compared(record)].mean(axis=1, keepdims=True))
        return found

    @staticmethod
    def _late(values: Float, by: Float, periodic: bool) -> Float:
        """(C, n) the same, late by (C,) samples."""
        moved = np.flatnonzero((by != 0) & np.isfinite(values).all(axis=1))
        if not moved.size:
            return values
        chosen = values[moved] if periodic else np.concatenate([values[moved], values[moved, ::-1]], axis=1)
        turn = -2j * np.pi * np.fft.rfftfreq(chosen.shape[1])
        shifted = np.fft.irfft(np.fft.rfft(chosen) * np.exp(turn * by[moved, None]), chosen.shape[1])
        result: Float = values.copy()
        result[moved] = shifted[:, : values.shape[1]]
        return result

    def _integrate(self, parameters: Float) -> Float:
        """(C, K, L) positions y at the samples of all stretches."""
        bends = (parameters[[QUADRATIC, CUBIC, DRAG]] != 0).any(axis=0)
        slips = (parameters[ARM] != 0) & ~np.isneginf(parameters[SLIP])
        linear = ~(bends | slips)
        out = np.empty((parameters.shape[1], self._input.shape[1], self._length))
        for chosen, simulate in ((linear, self._filter), (~linear, self._march)):
            # Fits that differ in what they are fitted to begin alike.
            sets, which = np.unique(parameters[: SLIP + 1, chosen], axis=1, return_inverse=True)
            out[chosen] = simulate(sets)[which]
        return out

    def _filter(self, parameters: Float) -> Float:
        """(C, K, L) of linear systems: the same steps, each of them the same linear map, as a recursive filter.

        With M and B of a step s ← M s + B u, the positions are the first entry of (z − M)⁻¹ B u, and by Faddeev and LeVerrier
        det(z − M) = z³ + p₁ z² + …, adj(z − M) = z² + N₁ z + N₂.
        """
        gain = parameters[GAIN]
        alike = parameters[[STIFFNESS, DAMPING, ARM, RATE]]
        alike[3, alike[2] == 0] = -np.inf
        courses, which = np.unique(alike, axis=1, return_inverse=True)
        sets = make_linear(1.0, 1.0)[: SLIP + 1, None].repeat(courses.shape[1], axis=1)
        sets[[STIFFNESS, DAMPING, ARM, RATE]] = courses
        first, middle = (np.ascontiguousarray(self._input[place::2].T) for place in (0, 1))
        last = middle if self.hold == HELD else np.append(first[:, 1:], first[:, -1:], axis=1)
        found = np.empty((courses.shape[1], len(first), self._length))
        for number, (move, push) in enumerate(zip(*_map_steps(sets, self._h), strict=True)):
            size = 3 if courses[2, number] else 2
            adjugate, poly, taps = np.eye(size), [1.0], [np.zeros(3)]
            for order in range(1, size + 1):
                taps.append(adjugate[0] @ push[:size])
                adjugate = adjugate @ move[:size, :size]
                poly.append(-float(np.trace(adjugate)) / order)
                adjugate += poly[-1] * np.eye(size)
            y = sum(lfilter(b, poly, u) for b, u in zip(np.transpose(taps), (first, middle, last), strict=True))
            found[number] = y[:, self.run_in * self._steps :: self._steps]
        return np.asarray(found[which] * gain[:, None, None])

    def _march(self, parameters: Float) -> Float:
        """(C, K, L) of systems whose steps are not all alike, one step of all after the other."""
        # Terms that few have are those of neighbours then.
        order = np.lexsort(parameters[[ARM, DRAG, CUBIC, QUADRATIC]] != 0)
        steps = _Steps(parameters[:, order], self._input.shape[1], self._h)
        out = np.empty((self._length, *steps.y.shape))
        u, fine, held = self._input, 2 * self._steps, self.hold == HELD
        last = len(u) - 1
        for sample in range(self.run_in + self._length if order.size else 0):
            if sample >= self.run_in:
                out[sample - self.run_in] = steps.y
            for i in range(sample * fine, (sample + 1) * fine, 2):
                # A held input changes after the end of the step.
                steps.go(u[i], u[i + 1], u[i + 1 if held else min(i + 2, last)])
        found = np.empty((order.size, out.shape[2], self._length))
        found[order] = out.transpose(1, 2, 0)
        return found


class _Steps:
    """Steps of oscillators of C sets of parameters (SLIP + 1, C) on K courses, all at once and in place.

    The classical method of Runge and Kutta, for a second derivative (Nyström's form); q half a step aside, exact for the
    speed between (Strang 1968), so that no slider is too stiff.
    """

    def __init__(self, parameters: Float, courses: int, h: float) -> None:
        sets = parameters.shape[1]
        # Expanded, so that every operation below is one loop over contiguous memory.
        full = np.ascontiguousarray(np.broadcast_to(parameters[:, :, None], (len(parameters), sets, courses)))
        self.y, self.v, self.q = np.zeros((3, sets, courses))
        # Arrays, for numbers are made into some at every operation.
        self._h, self._half, self._sixth, self._half_square, self._quarter_square, self._sixth_square, self._two = (
            np.array(x) for x in (h, h / 2, h / 6, h * h / 2, h * h / 4, h * h / 6, 2.0)
        )
        self._gain = full[GAIN]
        self._bent, self._dragged, self._armed = (
            _span((parameters[rows] != 0).any(axis=0)) for rows in ([QUADRATIC, CUBIC], [DRAG], [ARM])
        )
        self._k, self._k2, self._k3 = (full[row][self._bent] for row in (STIFFNESS, QUADRATIC, CUBIC))
        self._d, self._c = (full[row][self._dragged] for row in (DAMPING, DRAG))
        self._a = full[ARM][self._armed]
        # So much passes in a step; nothing is divided by nothing.
        self._rest = h * np.exp(full[RATE][self._armed]) + 1e-12
        self._slip = h * np.exp(full[SLIP][self._armed])
        self._stiffness, self._damping = full[STIFFNESS].copy(), full[DAMPING].copy()
        self._f = np.empty((4, sets, courses))
        self._free = np.empty((5, sets, courses))

    def go(self, first: Float, middle: Float, last: Float) -> None:
        """One step, with the input (K,) at its ends and its middle."""
        y, v, (f1, f2, f3, f4) = self.y, self.v, self._f
        stage_y, stage_v, ahead, push, some = self._free
        pull = self._yield() if self._a.size else self._a
        self._accelerate(np.multiply(self._gain, first, out=push), y, v, pull, f1)
        np.multiply(self._gain, middle, out=push)
        np.multiply(v, self._half, out=ahead)
        np.add(y, ahead, out=stage_y)
        np.add(v, np.multiply(f1, self._half, out=some), out=stage_v)
        self._accelerate(push, stage_y, stage_v, pull, f2)
        stage_y += np.multiply(f1, self._quarter_square, out=some)
        np.add(v, np.multiply(f2, self._half, out=some), out=stage_v)
        self._accelerate(push, stage_y, stage_v, pull, f3)
        ahead *= self._two
        y += ahead
        np.add(y, np.multiply(f2, self._half_square, out=some), out=stage_y)
        np.add(v, np.multiply(f3, self._h, out=some), out=stage_v)
        self._accelerate(np.multiply(self._gain, last, out=push), stage_y, stage_v, pull, f4)
        f2 += f3
        f1 += f2
        y += np.multiply(f1, self._sixth_square, out=some)
        f1 += f2
        f1 += f4
        f1 *= self._sixth
        v += f1

    def _yield(self) -> Float:
        """Forces of the arms half a step on."""
        q, v = self.q[self._armed], self.v[self._armed]
        passed = np.abs(v)
        passed *= self._slip
        passed += self._rest
        left = np.exp(-passed)
        q *= left
        np.subtract(1, left, out=left)
        left /= passed
        left *= v
        left *= self._h
        q += left
        return np.asarray(self._a * q)

    def _accelerate(self, push: Float, y: Float, v: Float, pull: Float, out: Float) -> None:
        """g u − y (κ + y (β₂ + β₃ y)) − v (δ + c |v|) − a q."""
        if self._k.size:
            own, bent = self._stiffness[self._bent], y[self._bent]
            np.multiply(self._k3, bent, out=own)
            own += self._k2
            own *= bent
            own += self._k
        if self._c.size:
            own = self._damping[self._dragged]
            np.abs(v[self._dragged], out=own)
            own *= self._c
            own += self._d
        np.multiply(self._stiffness, y, out=out)
        np.subtract(push, out, out=out)
        out -= self._damping * v
        if pull.size:
            out[self._armed] -= pull


def _span(chosen: Bool) -> slice:
    """The shortest slice that holds all chosen places."""
    places = np.flatnonzero(chosen)
    return slice(int(places[0]), int(places[-1]) + 1) if places.size else slice(0, 0)


def _map_steps(parameters: Float, h: float) -> tuple[Float, Float]:
    """(C, 3, 3) each: M and B of a step (y, v, q) ← M (y, v, q) + B (u at its beginning, middle, end) of linear systems."""
    steps, inputs = _Steps(parameters, 6, h), np.eye(6)[3:]
    steps.y[:], steps.v[:], steps.q[:] = np.eye(6)[:3]
    steps.go(*inputs)
    both = np.stack([steps.y, steps.v, steps.q], axis=1)
    return both[..., :3], both[..., 3:]
