"""Fixed-step Runge-Kutta of film, clamp and load cell on branch forces (units N, mm, s, kV, tonne)."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numba import njit

NKV = 4


@njit(cache=True, fastmath=True, error_model="numpy")
def _film(e, base, arms, k0, cf, pf, a, m, n, w):
    """Film tension without actuation. base: stiffness scale; arms: sum of branch forces."""
    if cf == 0 or cf > 30:
        return base * (k0 * e + arms)
    ae = abs(e)
    if cf == 1:
        g = 1.0 / (1.0 + (a / pf[0]) ** 2)
        return g * (k0 * e + arms)
    if cf == 2:
        return (1.0 - pf[1] * np.log(1.0 + a / pf[0])) * (k0 * e + arms)
    if cf == 3:
        return (1.0 - pf[1] * ae / (pf[0] + ae)) * (k0 * e + arms)
    if cf == 4:
        return k0 * e + arms * (1.0 - pf[1] * a / (pf[0] + a))
    if cf == 5:
        x = max(a - pf[2], 0.0)
        return (1.0 - pf[1] * x / (pf[0] + x)) * (k0 * e + arms)
    if cf == 11:
        return (1.0 - pf[1] * (1.0 - np.exp(-m / pf[0])) * (1.0 - np.exp(-n / pf[2]))) * (k0 * e + arms)
    if cf == 12:
        return (1.0 - pf[1] * m / (pf[0] + m) * n / (pf[2] + n)) * (k0 * e + arms)
    if cf == 13:
        q = np.log(1.0 + n / pf[2])
        return (1.0 - pf[1] * m / (pf[0] + m) * q / (2.0 + q)) * (k0 * e + arms)
    if cf == 14:
        r = 1.0 - ae / m if m > ae else 0.0
        return (1.0 - pf[1] * m / (pf[0] + m) * (0.4 + 0.6 * r) * n / (pf[2] + n)) * (k0 * e + arms)
    if cf == 15:
        return (1.0 - pf[1] * w / (pf[0] + w)) * (k0 * e + arms)
    if cf == 21:
        y = min(ae / pf[0], 0.92)
        return k0 * e / (1.0 - y * y) + arms
    if cf == 22:
        x = max(e, 0.0)
        return k0 * e * (1.0 + pf[1] * x / (pf[0] + x)) + arms
    if cf == 23:
        y = min(ae / pf[0], 0.95)
        return -np.sign(e) * k0 * pf[0] * np.log(1.0 - y) + arms
    if cf == 24:
        y = min(ae / pf[0], 0.92)
        return k0 * e * (3.0 - y * y) / (3.0 * (1.0 - y * y)) + arms
    if cf == 25:
        y = (e / pf[0]) ** 2
        return (k0 * e + arms) * (1.0 + pf[1] * y / (1.0 + y))
    return k0 * e + arms


@njit(cache=True, fastmath=True, error_model="numpy")
def _slack(t, cf, pf):
    """Slack of the tension change t (actuation included); pf[0] is the onset force."""
    z = t + pf[0]
    if cf == 33:
        c = 0.5 * (pf[0] + np.sqrt(pf[0] ** 2 + pf[2] ** 2))
        return 0.5 * (z + np.sqrt(z * z + pf[2] ** 2)) - c
    if z >= 0.0:
        return t
    if cf == 31 or cf == 32:
        return pf[1] * z - pf[0]
    if cf == 34:
        return z / (1.0 - z / pf[2]) - pf[0]
    return -pf[2] * np.log(1.0 - z / pf[2]) - pf[0]


@njit(cache=True, fastmath=True, error_model="numpy")
def _slip(t, us, cs, ps):
    """Rate of slip in the clamp."""
    if cs == 0:
        return 0.0
    f = t - ps[2] * us
    x = abs(f) - ps[0]
    if x <= 0.0 or (cs == 4 and f < 0.0 and us <= 0.0):
        return 0.0
    sg = 1.0 if f > 0 else -1.0
    if cs == 3:
        return sg * ps[0] / ps[1] * np.log(1.0 + x / ps[0])
    if cs == 4:
        return sg * x / (1.0 + x / ps[0]) / ps[1]
    return sg * x / ps[1]


@njit(cache=True, fastmath=True, error_model="numpy")
def _rhs(
    y,
    dy,
    x0,
    v0,
    fa,
    sc,
    sh,
    na,
    ka,
    ta,
    c0,
    c1,
    dahl,
    nk,
    kk,
    ek,
    cn,
    k0,
    mass,
    kl,
    cl,
    cf,
    pf,
    cs,
    ps,
    cd,
    pd,
    cr,
    pr,
    a,
    m,
    n,
    w,
):
    """Right side. y: x', v', NKV strips, slip, aux1, aux2, branch forces. Returns tension, cell force."""
    xp = y[0]
    vp = y[1]
    u = y[2 + NKV]
    for j in range(nk):
        u += y[2 + j]
    e = x0 - xp - u
    arms = 0.0
    o = 5 + NKV
    for i in range(na):
        arms += y[o + i]
    t = _film(e, sc, arms, k0, cf, pf, a, m, n, w) - fa
    if cf > 30:
        t = _slack(t, cf, pf)
    ud = _slip(t, y[2 + NKV], cs, ps)
    dy[2 + NKV] = ud
    for j in range(nk):
        r = (t - kk[j] * y[2 + j]) / ek[j]
        r = r * (1.0 + cn * abs(t))
        dy[2 + j] = r
        ud += r
    ed = v0 - vp - ud
    for i in range(na):
        f = y[o + i]
        if dahl[i] > 0.0:
            dy[o + i] = ka[i] * (ed - abs(ed) * f / dahl[i])
        else:
            dy[o + i] = ka[i] * ed - f * sh * (c0[i] + c1[i] * abs(f)) / ta[i]
    fs = kl * xp
    if cr == 1:
        fs = kl * xp * (1.0 + pr[0] * abs(xp) / (pr[1] + abs(xp)))
    elif cr == 2:
        fs = kl * xp * (1.0 + pr[0] * np.log(1.0 + abs(xp) / pr[1]))
    fd = cl * vp
    dy[3 + NKV] = 0.0
    dy[4 + NKV] = 0.0
    if cd == 1:
        fd += pd[0] * vp
    elif cd == 2:
        fd += pd[0] * vp / (1.0 + abs(vp) / pd[1])
    elif cd == 3:
        fd += pd[0] * vp * abs(vp) / (pd[1] + abs(vp))
    elif cd == 4:
        fd += y[3 + NKV]
        dy[3 + NKV] = pd[0] / pd[1] * vp - y[3 + NKV] / pd[1]
    elif cd == 5:
        rr = pd[0] * (pd[1] * pd[1] * (xp - y[3 + NKV]) + 2 * pd[2] * pd[1] * (vp - y[4 + NKV]))
        fd += rr
        dy[3 + NKV] = y[4 + NKV]
        dy[4 + NKV] = rr / pd[0]
    elif cd == 6:
        fd += np.sign(vp) * pd[0] * pd[1] * np.log(1.0 + abs(vp) / pd[1])
    dy[0] = vp
    dy[1] = (t - fs - fd) / mass
    return t, fs


@njit(cache=True, fastmath=True, error_model="numpy")
def _run(
    h,
    x0,
    v0,
    fa,
    sc,
    sh,
    ka,
    ta,
    c0,
    c1,
    dahl,
    kk,
    ek,
    cn,
    k0,
    mass,
    kl,
    cl,
    cf,
    pf,
    cs,
    ps,
    cd,
    pd,
    cr,
    pr,
    carry,
    tenv,
):
    """Runge-Kutta of fourth order; inputs on the half-step grid (2 n + 1). Returns cell force and tension."""
    na = ka.size
    nk = kk.size
    ns = 5 + NKV + na
    y = np.zeros(ns)
    y[2 + NKV] = carry[0]
    a = 0.0
    m = carry[1]
    path = carry[2]
    w = carry[3]
    eold = 0.0
    k1 = np.zeros(ns)
    k2 = np.zeros(ns)
    k3 = np.zeros(ns)
    k4 = np.zeros(ns)
    z = np.zeros(ns)
    steps = (x0.size - 1) // 2
    out = np.zeros(steps + 1)
    ten = np.zeros(steps + 1)
    n = path / (4.0 * m) if m > 1e-9 else 0.0
    for s in range(steps + 1):
        b = 2 * s
        t, f = _rhs(
            y,
            k1,
            x0[b],
            v0[b],
            fa[b],
            sc[s],
            sh[s],
            na,
            ka,
            ta,
            c0,
            c1,
            dahl,
            nk,
            kk,
            ek,
            cn,
            k0,
            mass,
            kl,
            cl,
            cf,
            pf,
            cs,
            ps,
            cd,
            pd,
            cr,
            pr,
            a,
            m,
            n,
            w,
        )
        out[s] = f
        ten[s] = t
        if s == steps:
            break
        for i in range(ns):
            z[i] = y[i] + 0.5 * h * k1[i]
        _rhs(
            z,
            k2,
            x0[b + 1],
            v0[b + 1],
            fa[b + 1],
            sc[s],
            sh[s],
            na,
            ka,
            ta,
            c0,
            c1,
            dahl,
            nk,
            kk,
            ek,
            cn,
            k0,
            mass,
            kl,
            cl,
            cf,
            pf,
            cs,
            ps,
            cd,
            pd,
            cr,
            pr,
            a,
            m,
            n,
            w,
        )
        for i in range(ns):
            z[i] = y[i] + 0.5 * h * k2[i]
        _rhs(
            z,
            k3,
            x0[b + 1],
            v0[b + 1],
            fa[b + 1],
            sc[s],
            sh[s],
            na,
            ka,
            ta,
            c0,
            c1,
            dahl,
            nk,
            kk,
            ek,
            cn,
            k0,
            mass,
            kl,
            cl,
            cf,
            pf,
            cs,
            ps,
            cd,
            pd,
            cr,
            pr,
            a,
            m,
            n,
            w,
        )
        for i in range(ns):
            z[i] = y[i] + h * k3[i]
        _rhs(
            z,
            k4,
            x0[b + 2],
            v0[b + 2],
            fa[b + 2],
            sc[s],
            sh[s],
            na,
            ka,
            ta,
            c0,
            c1,
            dahl,
            nk,
            kk,
            ek,
            cn,
            k0,
            mass,
            kl,
            cl,
            cf,
            pf,
            cs,
            ps,
            cd,
            pd,
            cr,
            pr,
            a,
            m,
            n,
            w,
        )
        for i in range(ns):
            y[i] += h / 6.0 * (k1[i] + 2 * k2[i] + 2 * k3[i] + k4[i])
        e = x0[b + 2] - y[0]
        ae = abs(e)
        a = ae if ae > a else a / (1.0 + h / tenv)
        m = max(m, ae)
        path += abs(e - eold)
        w += abs(t * (e - eold))
        eold = e
        n = path / (4.0 * m) if m > 1e-9 else 0.0
    carry[0] = y[2 + NKV]
    carry[1] = m
    carry[2] = path
    carry[3] = w
    return out, ten


@dataclass
class Film:
    """Film and rig of the plain model, truth."""

    k0: float
    k: list[float]
    tau: list[float]
    mass: float
    kl: float
    zeta: float
    gain: float  # force per voltage squared, N/kV^2, as seen by the load cell

    def vector(self) -> np.ndarray:
        """Parameters that the plain model is free to change."""
        return np.array([self.k0, *self.k, *self.tau, self.mass, self.kl, self.zeta, self.gain])

    def with_vector(self, p: np.ndarray) -> "Film":
        """The same film with other parameters."""
        n = len(self.k)
        return Film(p[0], list(p[1 : 1 + n]), list(p[1 + n : 1 + 2 * n]), *(float(q) for q in p[1 + 2 * n :]))


@dataclass
class Hooks:
    """What the effects add to the plain model; empty means plain."""

    arms: list[tuple[float, float, float, float, float]] = field(default_factory=list)  # k, tau, c0, c1, dahl
    strips: list[tuple[float, float]] = field(default_factory=list)  # stiffness, viscosity
    strip_nl: float = 0.0
    film: tuple[int, tuple[float, ...]] = (0, ())
    slip: tuple[int, tuple[float, ...]] = (0, ())
    damp: tuple[int, tuple[float, ...]] = (0, ())
    cell: tuple[int, tuple[float, ...]] = (0, ())
    mass: Any = None  # f(session time) -> factor
    kl: float = 1.0
    scale: Any = None  # f(rec, t) -> (stiffness factor, rate factor)
    drive: list[Any] = field(default_factory=list)  # f(rec, t, v) -> v on the film
    act: list[Any] = field(default_factory=list)  # f(rec, t, v, force) -> force
    move: list[Any] = field(default_factory=list)  # f(rec, t, x, v) -> x, v actually at the film
    sensor: list[Any] = field(default_factory=list)  # f(rec, t, force) -> force (direct additions, gains)
    capacity: list[Any] = field(default_factory=list)  # f(rec, t, c) -> c
    x_delay: float = 0.0
    x_sensor: list[Any] = field(default_factory=list)
    drift: list[Any] = field(default_factory=list)
    warm: Any = None  # f(rec, t) -> course of the temperature, 0 to 1
    seen: bool = False  # the monitor shows the drive effect
    preload: float | None = None


def pad(p: tuple[float, ...]) -> np.ndarray:
    """Fixed-length parameters for the kernel."""
    out = np.ones(6)
    out[: len(p)] = p
    return out


def simulate(film: Film, rec: Any, hooks: Hooks, rate: float, carry: np.ndarray, offset: float) -> dict[str, Any]:
    """One recording on a grid of `rate` (samples per second), without noise."""
    h = 1.0 / rate
    steps = round(rec.duration * rate)
    th = np.arange(2 * steps + 1) * (h / 2)
    t = th[::2]
    x, v = rec.motion(th)
    com, vm = rec.volts(th)
    mass = film.mass * (hooks.mass(rec.session_time) if hooks.mass else 1.0)
    kl = film.kl * hooks.kl
    cl = 2 * film.zeta * np.sqrt(film.kl * film.mass)
    res: dict[str, Any] = {"t": t, "x": x[::2], "v": v[::2], "command": com[::2]}
    vf = vm
    for f in hooks.drive:
        vf = f(rec, th, vf)
    res["voltage"] = (vf if hooks.seen else vm)[::2]
    if rec.protocol in ("tap", "weight"):
        force = rec.calibration(t, mass, kl, cl, hooks)
        res["T"], res["fa"] = force, np.zeros_like(t)
    else:
        fa = film.gain * vf * vf
        for f in hooks.act:
            fa = f(rec, th, vf, fa)
        xf, vf2 = x, v
        for f in hooks.move:
            xf, vf2 = f(rec, th, xf, vf2)
        one = np.ones(steps + 1)
        sc, sh = hooks.scale(rec, t) if hooks.scale else (one, one)
        arms = [(k, tau, 1.0, 0.0, 0.0) for k, tau in zip(film.k, film.tau, strict=True)] + hooks.arms
        ka, ta, c0, c1, dl = (np.array(q, dtype=float) for q in zip(*arms, strict=True))
        kk = np.array([s[0] for s in hooks.strips], dtype=float)
        ek = np.array([s[1] for s in hooks.strips], dtype=float)
        force, ten = _run(
            h,
            xf,
            vf2,
            fa,
            np.asarray(sc, float),
            np.asarray(sh, float),
            ka,
            ta,
            c0,
            c1,
            dl,
            kk,
            ek,
            hooks.strip_nl,
            film.k0,
            mass,
            kl,
            cl,
            hooks.film[0],
            pad(hooks.film[1]),
            hooks.slip[0],
            pad(hooks.slip[1]),
            hooks.damp[0],
            pad(hooks.damp[1]),
            hooks.cell[0],
            pad(hooks.cell[1]),
            carry,
            1.0,
        )
        force = force + offset
        res["T"], res["fa"] = ten, fa[::2]
    for f in hooks.sensor:
        force = f(rec, res, force)
    for f in hooks.drift:
        force = f(rec, res, force)
    res["force"] = force
    xm = res["x"]
    for f in hooks.x_sensor:
        xm = f(rec, res, xm)
    res["displacement"] = xm
    return res
