"""Families of form for the listed mechanisms, and the effects that no id names.

A form is a function (s, ctx, q) -> Hooks: s the severity (one number), ctx the session,
q six uniform numbers of the form.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.optimize import nnls
from scipy.signal import bilinear, lfilter

from .core import Hooks

Form = Callable[[float, Any, np.ndarray], Hooks]


@dataclass
class Mechanism:
    """A listed mechanism or an effect without a name."""

    stage: str
    depends: list[str]
    need: str
    cap: float
    start: float
    key: str
    forms: dict[str, Form]


def lag(x: np.ndarray, dt: float, tau: float) -> np.ndarray:
    """One pole, bilinear."""
    q = dt / (dt + 2 * tau)
    return lfilter([q, q], [1, 2 * q - 1], x)


def delayed(x: np.ndarray, n: float) -> np.ndarray:
    """Shift by n samples (cubic)."""
    return map_coordinates(x, [np.arange(x.size) - n], order=3, mode="nearest")


def spectrum(kernel: Callable[[np.ndarray], np.ndarray], k: float) -> list[tuple[float, float, float, float, float]]:
    """Arms whose sum follows a relaxation kernel with kernel scale k (non-negative least squares)."""
    t = np.logspace(-3.3, 2.3, 120)
    tau = np.logspace(-2.7, 2.0, 10)
    a = np.hstack([np.exp(-t[:, None] / tau[None, :]), np.ones((t.size, 1))])
    y = kernel(t)
    w, _ = nnls(a / np.maximum(y, 1e-3)[:, None], y / np.maximum(y, 1e-3))
    return [(k * c, float(q), 1.0, 0.0, 0.0) for c, q in zip(w, tau, strict=False) if c > 1e-6]


def kinf(c: Any) -> float:
    """Instantaneous stiffness of the film."""
    return c.film.k0 + sum(c.film.k)


# ---- drive
def _asym(rec: Any, t: np.ndarray, v: np.ndarray, up: float, dn: float, mode: int, q: float) -> np.ndarray:
    dt = t[1] - t[0]
    return _lagloop(np.ascontiguousarray(v), dt, up, dn, mode, q)


def _make_lag() -> Any:
    from numba import njit

    @njit(cache=True)
    def run(v, dt, up, dn, mode, q):
        y = np.zeros(v.size)
        for i in range(1, v.size):
            d = 0.5 * (v[i] + v[i - 1]) - y[i - 1]
            tau = up if d > 0 else dn
            g = dt / tau
            if mode == 1:
                g = g / (1.0 + abs(d) / q)
            elif mode == 2 and abs(d) > 1e-12:
                g = g * q * np.log(1.0 + abs(d) / q) / abs(d)
            elif mode == 3:
                g = g / (1.0 + q * y[i - 1] * y[i - 1] / (1.0 + y[i - 1] * y[i - 1]))
            y[i] = y[i - 1] + d * g / (1.0 + 0.5 * g)
        return y

    return run


_lagloop = _make_lag()


def drv(f: Any) -> Hooks:
    """Hooks of a drive effect."""
    return Hooks(drive=[f])


def drive_lag(mode: int) -> Form:
    def form(s: float, c: Any, q: np.ndarray) -> Hooks:
        r = 1.5 + 2 * q[0] if mode else 1.0
        return drv(
            lambda rec, t, v: _asym(rec, t, v, s, s * r, mode, (0.15 + 0.5 * q[1]) * c.vmax if mode != 3 else 1 + q[1])
        )

    return form


def drive_lag_two(s: float, c: Any, q: np.ndarray) -> Hooks:
    return drv(lambda rec, t, v: (1 - 0.4 * q[0]) * lag(v, t[1] - t[0], s) + 0.4 * q[0] * lag(v, t[1] - t[0], 6 * s))


def offset_form(kind: int) -> Form:
    def form(s: float, c: Any, q: np.ndarray) -> Hooks:
        sg = 1.0 if q[0] > 0.5 else -1.0

        def f(rec: Any, t: np.ndarray, v: np.ndarray) -> np.ndarray:
            if kind == 0:
                return v + sg * s
            if kind == 1:
                return v + sg * s * np.log1p((rec.session_time + t) / 60) / np.log1p(30)
            if kind == 2:
                return v + sg * s * v / (0.15 * c.vmax + np.abs(v))
            if kind == 3:
                return np.sign(v + 1e-12) * np.maximum(np.abs(v) - s, 0) if sg < 0 else np.sqrt(v * v + s * s)
            return v + sg * s * (0.5 + (rec.index % 3) / 2 * q[1])

        return drv(f)

    return form


def leak_form(kind: int) -> Form:
    def form(s: float, c: Any, q: np.ndarray) -> Hooks:
        def f(rec: Any, t: np.ndarray, v: np.ndarray) -> np.ndarray:
            y = np.abs(v) / c.vmax
            dt = t[1] - t[0]
            if kind == 0:
                return v * (1 - s * (0.3 + 0.7 * y * y * y))
            if kind == 1:
                return v / (1 + s * 2 * y * y / (1 + y * y))
            if kind == 2:
                return v * (1 - s * np.log1p(4 * y) / np.log(5))
            if kind == 3:
                return v - s * lag(v * y / (0.5 + y) * 1.5, dt, 0.05 + 0.3 * q[0])
            y4 = y * y
            return v / (1 + s * y4 * y4 / (0.4 + y4) * 1.4)

        return drv(f)

    return form


# ---- actuation
def act(f: Any, cap: Any = None) -> Hooks:
    """Hooks of an actuation effect."""
    return Hooks(act=[f], capacity=[cap] if cap else [])


def field_eps(kind: int) -> Form:
    def form(s: float, c: Any, q: np.ndarray) -> Hooks:
        def g(v: np.ndarray) -> np.ndarray:
            y = np.abs(v) / c.vmax
            if kind == 0:
                return 1 - s * y * y
            if kind == 1:
                return 1 - s * (1 + 0.3) * y * y / (0.3 + y * y)
            if kind == 2:
                return 1 - s * np.log1p(3 * y * y) / np.log(4)
            if kind == 3:
                b = 0.3 + 0.3 * q[0]
                return 1 - s * np.maximum(y - b, 0) / (0.2 + np.maximum(y - b, 0)) * (1.2 - b) / (1 - b)
            return 1 / (1 + s * y)

        return act(lambda rec, t, v, fa: fa * g(v))

    return form


def freq_eps(kind: int) -> Form:
    def form(s: float, c: Any, q: np.ndarray) -> Hooks:
        def f(rec: Any, t: np.ndarray, v: np.ndarray, fa: np.ndarray) -> np.ndarray:
            dt = t[1] - t[0]
            if kind == 0:
                taus, ws = np.logspace(-3.2, 1, 9), np.ones(9) * 0.52
            elif kind == 1:
                taus, ws = np.array([0.003 + 0.02 * q[0]]), np.array([2.0])
            elif kind == 2:
                taus = np.logspace(-3, 1, 9)
                x = np.log(taus / (0.01 + 0.1 * q[0]))
                ws = 1.2 / (1 + x * x)
            elif kind == 3:
                taus, ws = np.array([0.002, 0.05 + 0.3 * q[0]]), np.array([1.0, 1.5])
            else:
                taus = np.logspace(-3, 1, 9)
                ws = 0.9 / (1 + np.abs(np.log(taus / 0.3)))
            out = fa * (1 - s * ws.sum() * 0.5)
            for tau, w in zip(taus, ws, strict=True):
                out = out + s * w * lag(fa, dt, tau)
            return out

        return act(f)

    return form


def degrade(kind: int) -> Form:
    def form(s: float, c: Any, q: np.ndarray) -> Hooks:
        total = sum(1 for _ in c.recs) and max(c.recs[-1].exposure, 1.0)

        def loss(e: np.ndarray) -> np.ndarray:
            x = e / total
            if kind == 0:
                return s * (1 - np.exp(-x / 0.5))
            if kind == 1:
                return s * x / (0.4 + x)
            if kind == 2:
                return s * np.log1p(8 * x) / np.log(9)
            if kind == 3:
                y = np.maximum(x - 0.3, 0)
                return s * 1.5 * y / (0.4 + y)
            return s * x * x / (0.3 + x * x)

        def expo(rec: Any, t: np.ndarray, v: np.ndarray) -> np.ndarray:
            return rec.exposure + np.cumsum(v * v) * (t[1] - t[0])

        return act(
            lambda rec, t, v, fa: fa * (1 - loss(expo(rec, t, v))),
            lambda rec, t, v, cc: cc * (1 - loss(expo(rec, t, v))),
        )

    return form


def wrinkle(kind: int) -> Form:
    def form(s: float, c: Any, q: np.ndarray) -> Hooks:
        von = c.vmax / (1 + s)

        def f(rec: Any, t: np.ndarray, v: np.ndarray, fa: np.ndarray) -> np.ndarray:
            dt = t[1] - t[0]
            a = np.abs(v)
            f0 = c.film.gain * von * von
            x = np.maximum(fa / f0 - 1, 0)
            if kind == 0:
                y = np.minimum(fa, f0)
                held = lag(np.maximum(fa - f0, 0), dt, 0.3)
                return y + 0.1 * held
            if kind == 1:
                return np.minimum(fa, f0) + f0 * x / (1 + x * (2 + 3 * q[0]))
            if kind == 2:
                return np.minimum(fa, f0) + f0 * 0.4 * np.log1p(x)
            if kind == 3:
                w = lag(np.maximum(a - von, 0) / von, dt, 0.2 + 0.8 * q[0])
                return fa * (1 - w / (0.3 + w))
            w = x / (0.5 + x)
            return fa * (1 - 0.7 * w) - 0.25 * f0 * lag(w, dt, 0.5 + q[0])

        return act(f, lambda rec, t, v, cc: cc)

    return form


# ---- film
def soften(code: int) -> Form:
    def form(s: float, c: Any, q: np.ndarray) -> Hooks:
        a = c.emax
        if code == 1:
            p = (a / np.sqrt(s / (1 - s)),)
        elif code == 2:
            p = (a * (0.1 + 0.5 * q[0]), s / np.log1p(1 / (0.1 + 0.5 * q[0])))
        elif code == 5:
            b = 0.1 + 0.2 * q[0]
            p = (0.3 * a, s * (1.3 - b) / (1 - b), b * a)
        else:
            b = 0.2 + 0.6 * q[0]
            p = (b * a, s * (1 + b))
        return Hooks(film=(code, p))

    return form


def cyc(code: int) -> Form:
    def form(s: float, c: Any, q: np.ndarray) -> Hooks:
        a = c.emax
        if code == 15:
            w = (0.5 + 2 * q[0]) * kinf(c) * a * a
            return Hooks(film=(15, (w, s * 1.2)))
        return Hooks(film=(code, (0.5 * a, 1.5 * s, 3 + 12 * q[0])))

    return form


def stiffen(code: int) -> Form:
    def form(s: float, c: Any, q: np.ndarray) -> Hooks:
        a = c.emax
        if code == 21:
            return Hooks(film=(21, (a / np.sqrt(s / (1 + s)),)))
        if code == 24:
            y2 = min(3 * s / (2 + 3 * s), 0.8)
            return Hooks(film=(24, (a / np.sqrt(y2),)))
        if code == 23:
            return Hooks(film=(23, (a / min(1.6 * s / (1 + s), 0.9),)))
        b = 0.4 + 0.8 * q[0]
        return Hooks(film=(code, (b * a, s * (1 + b) if code == 22 else s * (1 + b * b))))

    return form


def slack(code: int) -> Form:
    def form(s: float, c: Any, q: np.ndarray) -> Hooks:
        on = c.tneg / (1 + s)
        pre = on / (0.55 + 0.45 * q[0])
        p1 = 0.0 if code != 32 else 0.05 + 0.25 * q[1]
        return Hooks(
            film=(code, (on, p1, on * (0.1 + 0.3 * q[1]) * (s / (0.15 + s) if code == 33 else 1.0))), preload=pre
        )

    return form


def miss(kind: int) -> Form:
    def form(s: float, c: Any, q: np.ndarray) -> Hooks:
        k = s * c.film.k0
        base = np.sort(np.array(c.film.tau))
        cand = np.logspace(np.log10(0.003), np.log10(12.0), 25)
        gap = np.abs(np.log(cand[:, None] / base[None, :])).min(axis=1)
        pick = cand[gap > np.log(3.0)]
        tau = float(pick[int(q[0] * 0.999 * pick.size)])
        if kind == 0:
            arms = [(k, tau, 1.0, 0.0, 0.0)]
        elif kind == 1:
            arms = [(k / 3, tau * r, 1.0, 0.0, 0.0) for r in (0.33, 1.0, 3.0)]
        elif kind == 2:
            arms = [(k, tau, 1.0, 1 / (k * c.emax * (0.05 + 0.3 * q[1])), 0.0)]
        elif kind == 3:
            arms = [(k, tau, 0.02, 1 / (k * c.emax * (0.05 + 0.3 * q[1])), 0.0)]
        else:
            arms = [(k * 0.65, tau, 1.0, 0.0, 0.0), (k * 0.35, tau * (5 + 5 * q[1]), 1.0, 0.0, 0.0)]
        return Hooks(arms=arms)

    return form


def power(kind: int) -> Form:
    def form(s: float, c: Any, q: np.ndarray) -> Hooks:
        al = 0.12 + 0.25 * q[0]
        fs: list[Callable[[np.ndarray], np.ndarray]] = [
            lambda t: t**-al,
            lambda t: 1 / (1 + np.log1p(t / 0.003) * (0.15 + 0.4 * q[0])) * 2,
            lambda t: np.log1p((3 + 20 * q[0]) / t) / np.log1p(3 + 20 * q[0]),
            lambda t: 2 / (1 + t / 0.02) + 1 / (1 + t / 0.5) + 0.7 / (1 + t / 12),
            lambda t: 3 / (1 + np.log1p(t / 0.001) * (0.4 + 0.6 * q[0])) - 0.1 * np.log1p(t) / np.log(200),
        ]
        return Hooks(arms=spectrum(fs[kind], s * c.film.k0))

    return form


def thermal(kind: int) -> Form:
    def form(s: float, c: Any, q: np.ndarray) -> Hooks:
        last = c.recs[-1].session_time + 60
        hot = max(c.recs[-1].heat, 1e-6)

        def temp(rec: Any, t: np.ndarray) -> np.ndarray:
            x = (rec.session_time + t) / last
            if kind == 0:
                return 1 - np.exp(-x / (0.2 + 0.5 * q[0]))
            if kind == 1:
                return x / (0.2 + 0.6 * q[0] + x)
            if kind == 2:
                return np.log1p(6 * x) / np.log(7)
            if kind == 3:
                return x * x / (0.2 + x * x)
            return rec.heat / hot * (1 / (1 + t / 60))

        def f(rec: Any, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            y = s * temp(rec, t)
            if kind == 2:
                return 1 / (1 + y), 1 + 3 * y
            if kind == 3:
                return 1 - y, 1 + 4 * y / (1 + y)
            return 1 - y, np.ones_like(y)

        return Hooks(scale=f, warm=temp)

    return form


def strip(kind: int) -> Form:
    def form(s: float, c: Any, q: np.ndarray) -> Hooks:
        kp = c.film.k0 * (1 - s) / s
        tau = 0.05 + 1.5 * q[0]
        if kind == 0:
            el = [(2 * kp, 2 * kp * 0.002), (2 * kp, 2 * kp * tau)]
            return Hooks(strips=el)
        if kind == 1:
            return Hooks(strips=[(4 * kp, 4 * kp * x) for x in (0.003, 0.03, 0.3, 3.0)])
        if kind == 2:
            return Hooks(
                strips=[(1.5 * kp, 1.5 * kp * 0.003), (3 * kp, 3 * kp * tau)], strip_nl=1.5 / max(c.tmax, 0.01)
            )
        if kind == 3:
            return Hooks(strips=[(kp, kp * (0.01 + 0.1 * q[0]))])
        return Hooks(strips=[(3 * kp, 3 * kp * 0.002), (3 * kp, 3 * kp * tau * 0.2), (3 * kp, 3 * kp * tau * 4)])

    return form


def slip(code: int) -> Form:
    def form(s: float, c: Any, q: np.ndarray) -> Hooks:
        fs = c.tmax / (1 + s)
        k = kinf(c)
        visc = {1: 0.004, 2: 0.1 + q[0], 3: 0.05 + 0.5 * q[0], 4: 0.05 + 0.3 * q[0], 5: 0.01}[code] * k
        return Hooks(slip=(code, (fs, visc, k * (0.3 + q[1]) if code in (1, 5) else 0.3 * k if code == 4 else 0.1 * k)))

    return form


# ---- rig
def rigc(kind: int) -> Form:
    def form(s: float, c: Any, q: np.ndarray) -> Hooks:
        sg = 1.0 if q[0] > 0.5 else -1.0
        if kind == 0:
            return Hooks(mass=lambda st: 1 + sg * s)
        if kind == 1:
            return Hooks(kl=1 + sg * s)
        if kind == 2:
            return Hooks(mass=lambda st: 1 + sg * s, kl=1 - 0.6 * sg * s)
        if kind == 3:
            last = c.recs[-1].session_time + 1
            return Hooks(mass=lambda st: 1 + sg * s * (0.3 + np.log1p(9 * st / last) / np.log(10)))
        x = c.tmax / c.film.kl
        return (
            Hooks(cell=(1, (sg * 1.5 * s, x * (0.1 + 0.5 * q[1])))) if kind == 4 else Hooks(cell=(2, (sg * s, 0.3 * x)))
        )

    return form


def damp(code: int) -> Form:
    def form(s: float, c: Any, q: np.ndarray) -> Hooks:
        m, kl = c.film.mass, c.film.kl
        w = np.sqrt(kl / m)
        cc = 2 * s * np.sqrt(kl * m)
        vs = 0.3 * c.tmax / kl * w
        p = {
            1: (cc,),
            2: (2 * cc, vs),
            3: (2 * cc, vs),
            4: (1.5 * cc, (0.3 + q[0]) / w),
            5: (m * min(4 * s, 0.3), w * (0.7 + 0.6 * q[0]), 0.05 * w),
            6: (2 * cc, vs),
        }[code]
        return Hooks(damp=(code, p))

    return form


# ---- sensor
def post(f: Any) -> Hooks:
    """A change of the force channel."""
    return Hooks(sensor=[f])


def rate_of(res: dict[str, Any]) -> float:
    """Samples per second of the trace."""
    return 1.0 / float(res["t"][1] - res["t"][0])


def sdelay(kind: int) -> Form:
    def form(s: float, c: Any, q: np.ndarray) -> Hooks:
        def f(rec: Any, res: Any, y: np.ndarray) -> np.ndarray:
            r = rate_of(res)
            z = y - y[0]
            if kind in (0, 4):
                return y[0] + delayed(z, s * r)
            if kind == 1:
                return y[0] + lag(z, 1 / r, s)
            if kind == 2:
                w = 2 / s
                b, a = bilinear([w * w], [1, 1.6 * w * 0.9, w * w], r)
                return y[0] + lfilter(b, a, z)
            a, b = np.array([1.0]), s * r * (0.6 + 0.8 * q[0])
            d = b * (1 + 0.5 * np.log1p(rec.session_time / 300))
            return y[0] + a * delayed(z, d)

        if kind == 4:
            return Hooks(x_sensor=[lambda rec, res, x: delayed(x, s * rate_of(res))], x_delay=s)
        return post(f)

    return form


def gain(kind: int) -> Form:
    def form(s: float, c: Any, q: np.ndarray) -> Hooks:
        sg = 1.0 if q[0] > 0.5 else -1.0
        top = max(c.tmax + c.offset, 0.1)

        def f(rec: Any, res: Any, y: np.ndarray) -> np.ndarray:
            a = np.abs(y)
            if kind == 0:
                return y * (1 + sg * s)
            if kind == 1:
                return y * (1 + sg * s / (1 + a / (3 * top)))
            if kind == 2:
                return y * (1 + sg * s * (1 + 0.25 * np.log1p(rec.session_time / 200)) / 1.5)
            if kind == 3:
                return y * (1 + sg * s) if q[1] > 0.5 else y * (1 + sg * s * (0.6 + 0.4 * a / (top + a)))
            return y * (1 + sg * s * (1 - 0.3 * np.log1p(a / top)))

        return post(f)

    return form


def hum(kind: int) -> Form:
    def form(s: float, c: Any, q: np.ndarray) -> Hooks:
        def f(rec: Any, res: Any, y: np.ndarray) -> np.ndarray:
            t = res["t"] + rec.session_time
            ph = 2 * np.pi * 50.0 * t * (1 + 2e-4 * (q[0] - 0.5)) + 6.28 * q[1]
            sn = np.sin(ph)
            if kind == 0:
                z = sn
            elif kind == 1:
                z = sn + 0.5 * q[2] * np.sin(2 * ph + 1) + 0.3 * np.sin(3 * ph)
            elif kind == 2:
                z = 1.6 * sn / (0.6 + np.abs(sn))
            elif kind == 3:
                z = sn * (0.4 + 1.2 / (1 + (res["t"] / 10) ** 2))
            else:
                z = np.sign(sn) * np.log1p(3 * np.abs(sn)) / np.log(4) + 0.3 * np.cos(2 * ph)
            return y + s * z

        return post(f)

    return form


def satur(kind: int) -> Form:
    def form(s: float, c: Any, q: np.ndarray) -> Hooks:
        top = max(c.ftop, 1e-3)
        lim = top / (1 + s)

        def f(rec: Any, res: Any, y: np.ndarray) -> np.ndarray:
            a = np.abs(y)
            b = lim * (1 - (0.1 + 0.3 * q[0]) * s / (0.15 + s))
            x = np.maximum(a - b, 0)
            if kind == 0:
                z = np.minimum(a, lim)
            elif kind == 1:
                z = np.minimum(a, b) + x / (1 + x / (lim - b))
            elif kind == 2:
                z = np.minimum(a, b) + (lim - b) * np.log1p(x / (lim - b))
            elif kind == 3:
                z = np.where(y > 0, np.minimum(a, lim), np.minimum(a, 1.3 * lim))
            else:
                z = np.minimum(np.minimum(a, lim) + 0.15 * np.maximum(a - lim, 0), 1.2 * lim)
            return np.sign(y) * z

        return post(f)

    return form


def drift(kind: int) -> Form:
    def form(s: float, c: Any, q: np.ndarray) -> Hooks:
        sg = -1.0 if q[0] > 0.25 else 1.0
        a = sg * s * c.offset
        t0 = 0.5 + 5 * q[1]

        def f(rec: Any, res: Any, y: np.ndarray) -> np.ndarray:
            t = res["t"]
            if rec.loading == "calibration":
                return y
            if kind == 0:
                return y + a * np.log10(1 + t / t0)
            if kind == 1:
                return y + a * np.log10(1 + (rec.session_time + t) / 20)
            if kind == 2:
                return y + 1.5 * a * t / (5 * t0 + t)
            if kind == 3:
                return y + a * t / 20
            return y + a * np.log10(1 + np.log1p(t / t0) * 3)

        return Hooks(drift=[f])

    return form


def _m(
    stage: str, dep: str, need: str, cap: float, start: float, key: str, names: list[str], maker: Any, codes: list[Any]
) -> Mechanism:
    forms = {n: (maker(k) if not callable(k) else k) for n, k in zip(names, codes, strict=True)}
    return Mechanism(stage, dep.split(), need, cap, start, key, forms)


R5 = [0, 1, 2, 3, 4]
MECHANISMS: dict[str, Mechanism] = {
    "rig_constants": _m(
        "rig",
        "frequency",
        "m",
        0.4,
        0.05,
        "relative_error",
        ["mass", "stiffness", "both", "mass_grows_log", "stiffness_rational", "stiffness_log"],
        rigc,
        [0, 1, 2, 3, 4, 5],
    ),
    "load_cell_damping": _m(
        "rig",
        "frequency",
        "m",
        0.06,
        0.01,
        "damping_ratio",
        ["viscous", "saturating", "quadratic_rational", "maxwell", "second_resonance", "log"],
        damp,
        [1, 2, 3, 4, 5, 6],
    ),
    "drive_lag": _m(
        "drive",
        "frequency voltage",
        "e",
        0.02,
        1e-4,
        "rise_time_constant_s",
        ["one_pole", "rational_slew", "log_rate", "level_dependent", "two_pole_mix"],
        drive_lag,
        [0, 1, 2, 3, drive_lag_two],
    ),
    "drive_offset": _m(
        "drive",
        "voltage",
        "e",
        1.0,
        0.1,
        "offset_kv",
        ["constant", "log_session", "rational_level", "dead_zone_or_root", "per_recording"],
        offset_form,
        R5,
    ),
    "leakage": _m(
        "drive",
        "voltage",
        "e",
        0.4,
        0.05,
        "droop",
        ["resistance_and_power", "rational_conductance", "log_conductance", "polarising", "steep_rational"],
        leak_form,
        [0, 1, 2, 3, 4],
    ),
    "field_dependent_permittivity": _m(
        "actuation",
        "voltage",
        "e",
        0.3,
        0.05,
        "fraction",
        ["quadratic", "saturating", "log", "threshold_rational", "reciprocal"],
        field_eps,
        R5,
    ),
    "frequency_dependent_permittivity": _m(
        "actuation",
        "frequency",
        "e",
        0.12,
        0.02,
        "per_decade",
        ["log_frequency", "debye", "lorentz_spectrum", "two_debye", "log_spectrum"],
        freq_eps,
        R5,
    ),
    "electrode_degradation": _m(
        "actuation",
        "exposure",
        "e",
        0.8,
        0.1,
        "loss",
        ["exponential", "rational", "log", "incubation", "sigmoid_rational"],
        degrade,
        R5,
    ),
    "wrinkling": _m(
        "actuation",
        "voltage record_time",
        "e",
        1.5,
        0.2,
        "over_onset",
        ["plateau", "rational_plateau", "log_plateau", "slow_fold", "fold_with_recovery"],
        wrinkle,
        R5,
    ),
    "amplitude_softening": _m(
        "film",
        "amplitude",
        "m",
        0.6,
        0.1,
        "drop",
        ["running_quadratic", "running_log", "instant_rational", "arms_only", "threshold"],
        soften,
        [1, 2, 3, 4, 5],
    ),
    "cyclic_softening": _m(
        "film",
        "cycle largest_strain",
        "m",
        0.5,
        0.08,
        "loss",
        ["exponential", "rational", "log_cycles", "mullins_below_peak", "work"],
        cyc,
        [11, 12, 13, 14, 15],
    ),
    "missing_relaxation": _m(
        "film",
        "frequency record_time",
        "m",
        1.2,
        0.2,
        "stiffness_ratio",
        ["one_arm", "log_band", "rational_dashpot", "second_order_kinetics", "pair_of_arms"],
        miss,
        R5,
    ),
    "power_law_relaxation": _m(
        "film",
        "frequency record_time",
        "m",
        1.2,
        0.15,
        "stiffness_ratio",
        ["power", "reciprocal_log", "log_tail", "rational_sum", "log_ratio"],
        power,
        R5,
    ),
    "thermal_softening": _m(
        "film",
        "session_time temperature",
        "m",
        0.48,
        0.05,
        "per_kelvin",
        ["first_order", "rational_rise", "log_shift", "sigmoid_shift", "self_heating"],
        thermal,
        R5,
    ),
    "slack": _m(
        "film",
        "amplitude",
        "m",
        1.0,
        0.1,
        "over_onset",
        ["hard", "bilinear", "hyperbola", "rational", "log"],
        slack,
        [31, 32, 33, 34, 35],
    ),
    "strain_stiffening": _m(
        "film",
        "amplitude",
        "m",
        0.6,
        0.1,
        "stiffening",
        ["gent", "one_sided_rational", "log_limit", "langevin_pade", "whole_film_rational"],
        stiffen,
        [21, 22, 23, 24, 25],
    ),
    "passive_strip": _m(
        "film",
        "frequency",
        "e",
        0.8,
        0.02,
        "ratio",
        ["zener_strip", "log_creep_strip", "thinning_strip", "kelvin_strip", "two_time_strip"],
        strip,
        R5,
    ),
    "clamp_slip": _m(
        "contact",
        "amplitude",
        "m",
        8.0,
        0.5,
        "over_onset",
        ["coulomb_spring", "bingham", "log_creep", "one_sided_rational", "hardening"],
        slip,
        [1, 2, 3, 4, 5],
    ),
    "sensor_delay": _m(
        "sensor",
        "frequency",
        "m",
        0.004,
        3e-4,
        "delay_s",
        ["shift", "one_pole", "two_pole", "growing_shift", "displacement_shift"],
        sdelay,
        R5,
    ),
    "gain_error": _m(
        "sensor",
        "amplitude",
        "w",
        0.4,
        0.03,
        "gain",
        ["constant", "rational_load", "log_session", "mixed", "log_load"],
        gain,
        R5,
    ),
    "mains_hum": _m(
        "sensor",
        "record_time",
        "",
        0.04,
        0.002,
        "amplitude_n",
        ["sine", "harmonics", "rational_clipped", "fading", "log_shaped"],
        hum,
        R5,
    ),
    "sensor_saturation": _m(
        "sensor",
        "amplitude",
        "m",
        1.0,
        0.15,
        "over_onset",
        ["clip", "rational_knee", "log_knee", "asymmetric", "two_stage"],
        satur,
        R5,
    ),
    "baseline_drift": _m(
        "drift",
        "record_time",
        "",
        0.2,
        0.02,
        "per_decade",
        ["log10", "log_session", "rational", "linear", "log_log"],
        drift,
        R5,
    ),
}


# ---- effects without a name
def _res2(x: np.ndarray, r: float, f: float, z: float) -> np.ndarray:
    w = 2 * np.pi * min(f, 0.2 * r)
    b, a = bilinear([w * w], [1, 2 * z * w, w * w], r)
    return lfilter(b, a, x)


def _accel(res: Any) -> np.ndarray:
    return np.gradient(res["v"], 1 / rate_of(res))


def _plain_post(g: Callable[[float, Any, np.ndarray, Any, Any, np.ndarray], np.ndarray]) -> Form:
    def form(s: float, c: Any, q: np.ndarray) -> Hooks:
        def f(rec: Any, res: Any, y: np.ndarray) -> np.ndarray:
            return y if rec.loading == "calibration" else g(s, c, q, rec, res, y)

        return post(f)

    return form


def _iwan(s: float, c: Any, q: np.ndarray) -> Hooks:
    k = s * c.film.k0
    return Hooks(arms=[(k / 3, 1e6, 0.0, 0.0, k / 3 * c.emax * b * (0.5 + q[0])) for b in (0.05, 0.2, 0.6)])


def _trap(s: float, c: Any, q: np.ndarray) -> Hooks:
    taus = (0.5, 4.0, 30.0)

    def f(rec: Any, t: np.ndarray, v: np.ndarray) -> np.ndarray:
        dt = t[1] - t[0]
        y = np.abs(v) / c.vmax
        sh = (
            sum(lag(v * y / (0.3 + y), dt, tau) for tau in taus) / 3
            + 0.3 * np.log1p(rec.exposure / (50 * c.vmax)) * 0.1
        )
        return v - s * sh

    return drv(f)


def _ripple(s: float, c: Any, q: np.ndarray) -> Hooks:
    fr = 17 + 20 * q[0] if q[1] > 0.5 else 61 + 20 * q[0]
    return drv(lambda rec, t, v: v * (1 + s * np.sin(2 * np.pi * fr * (t + rec.session_time))))


def _partial(s: float, c: Any, q: np.ndarray) -> Hooks:
    def f(rec: Any, t: np.ndarray, v: np.ndarray) -> np.ndarray:
        g = np.random.default_rng(int(1e6 * q[0]) + rec.index)
        n = max(int(rec.duration * 6), 1)
        dips = np.zeros_like(t)
        for a in g.uniform(0, rec.duration, n):
            i, j = np.searchsorted(t, [a, a + 0.25])
            dips[i:j] += 1 / (1 + (t[i:j] - a) / 0.02)
        y = np.maximum(np.abs(v) / c.vmax - 0.4, 0)
        return v * (1 - s * np.minimum(dips, 2) * y / (0.2 + y))

    return drv(f)


def _heating(s: float, c: Any, q: np.ndarray) -> Hooks:
    def f(rec: Any, t: np.ndarray, x: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        dt = t[1] - t[0]
        p = lag(v * v, dt, 4.0 + 10 * q[0])
        ref = max(c.vrms2, 1e-9)
        g = s * c.emax * p / (ref + p)
        return x - g, v - np.gradient(g, dt)

    return Hooks(move=[f])


def _play(s: float, c: Any, q: np.ndarray) -> Hooks:
    def f(rec: Any, res: Any, y: np.ndarray) -> np.ndarray:
        return y + s * _dahl(np.ascontiguousarray(y), c.ftop * (0.02 + 0.1 * q[0]))

    return post(f)


def _make_dahl() -> Any:
    from numba import njit

    @njit(cache=True)
    def run(y, w):
        out = np.zeros(y.size)
        z = 0.0
        for i in range(1, y.size):
            d = y[i] - y[i - 1]
            z = (z + d) / (1.0 + abs(d) / w)
            out[i] = z
        return out

    return run


_dahl = _make_dahl()


def _slam(s: float, c: Any, q: np.ndarray, rec: Any, res: Any, y: np.ndarray) -> np.ndarray:
    g = np.random.default_rng(int(1e6 * q[0]) + 7 * rec.index)
    out = y.copy()
    t = res["t"]
    for a in g.uniform(0, rec.duration, int(g.integers(0, 4))):
        u = np.maximum(t - a, 0)
        out += s * np.sin(2 * np.pi * (4 + 6 * q[1]) * u) / (1 + (u / 0.3) ** 2) * (t > a)
    return out


def _floor(s: float, c: Any, q: np.ndarray, rec: Any, res: Any, y: np.ndarray) -> np.ndarray:
    t = np.arange(int(rec.duration * 200) + 400) / 200.0
    g = np.random.default_rng(int(1e6 * q[0]) + 3 * rec.index)
    z = _res2(g.standard_normal(t.size), 200.0, 7 + 12 * q[1], 0.03)
    z = z / z.std()
    return y + s * np.interp(res["t"], t, z)


UNLISTED: dict[str, Mechanism] = {}


def _u(name: str, stage: str, dep: str, need: str, start: float, form: Form) -> None:
    UNLISTED[name] = Mechanism(stage, dep.split(), need, 1e9, start, "size", {name: form})


_u(
    "frame_resonance",
    "rig",
    "frequency",
    "m",
    0.05,
    _plain_post(
        lambda s, c, q, rec, res, y: y + s * c.film.mass * _res2(_accel(res), rate_of(res), 70 + 90 * q[0], 0.02)
    ),
)
_u(
    "capacitive_crosstalk",
    "sensor",
    "voltage frequency",
    "e",
    1e-5,
    _plain_post(lambda s, c, q, rec, res, y: y + s * np.gradient(res["voltage"], 1 / rate_of(res))),
)
_u("charge_trapping", "drive", "voltage record_time exposure", "e", 0.03, _trap)
_u(
    "eccentric_drive",
    "rig",
    "amplitude frequency",
    "m",
    1e-7,
    _plain_post(lambda s, c, q, rec, res, y: y + s * lag(res["v"] ** 2, 1 / rate_of(res), 1e-3)),
)
_u(
    "air_drag",
    "rig",
    "rate amplitude",
    "m",
    1e-6,
    _plain_post(lambda s, c, q, rec, res, y: y + s * res["v"] * np.abs(res["v"]) / (1 + np.abs(res["v"]) / 2000)),
)
_u("rod_heating", "rig", "amplitude record_time", "m", 0.02, _heating)
_u("iwan_filler_network", "film", "amplitude", "m", 0.1, _iwan)
_u("eddy_pickup", "sensor", "frequency rate", "m", 1e-5, _plain_post(lambda s, c, q, rec, res, y: y + s * res["v"]))
_u(
    "side_load_misalignment",
    "sensor",
    "amplitude",
    "m",
    1e-3,
    _plain_post(
        lambda s, c, q, rec, res, y: y + s * c.tmax * (res["x"] / c.emax) ** 2 / (1 + 0.3 * (res["x"] / c.emax) ** 2)
    ),
)
_u("switching_ripple", "drive", "voltage record_time", "e", 0.01, _ripple)
_u("floor_vibration", "rig", "record_time", "", 5e-4, _plain_post(_floor))
_u("load_cell_hysteresis", "sensor", "amplitude largest_strain", "m", 0.02, _play)
_u("door_slams", "rig", "record_time", "", 5e-3, _plain_post(_slam))
_u("partial_discharges", "drive", "voltage record_time", "e", 0.05, _partial)
_u(
    "membrane_mode",
    "film",
    "frequency",
    "m",
    0.02,
    _plain_post(
        lambda s, c, q, rec, res, y: (
            y
            + s
            * (
                _res2(y - y[0], rate_of(res), 25 + 50 * q[0], 0.015)
                - lag(y - y[0], rate_of(res) ** -1, 1 / (6.28 * (25 + 50 * q[0])))
            )
        )
    ),
)
