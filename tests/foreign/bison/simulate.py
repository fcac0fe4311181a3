"""Integrate a session with effects, measure how detectable they are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy.signal import lfilter

from . import core
from .plan import Rec, World, film_k, motion, wanted_voltage

GRAVITY = 9.80665
Hook = Callable[..., object]


@dataclass
class Effect:
    """What an effect changes, by stage; unset parts leave the plain model as it is."""

    drive: Hook | None = None  # (v, h, rec, st) -> film voltage, or (film voltage, monitor)
    vsq: Hook | None = None  # (v, h, rec, st) -> effective square of the voltage
    act: Hook | None = None  # (v, fa, h, rec, st) -> actuation force
    motion: Hook | None = None  # (x, h, rec, st) -> motion that the film sees
    force_in: Hook | None = None  # (x, v, h, rec, st) -> force on the clamp that lowers tension, added to F_A
    scale: Hook | None = None  # (rec, t, st) -> (stiffness factor, speed factor)
    arms: list[tuple[float, float]] = field(default_factory=list)
    film: tuple[int, list[float]] | None = None
    persist: bool = True  # the film's states carry over
    contact: tuple[int, list[float]] | None = None
    rig: tuple[int, list[float]] | None = None
    d_mass: Hook | None = None  # (rec) -> relative change
    d_kl: Hook | None = None
    d_cl: float = 0.0
    sensor: Hook | None = None  # (ch, rec, st)
    drift: Hook | None = None  # (t, rec, st) -> force
    temperature: Hook | None = None  # (rec, t, st) -> deviation in kelvin
    preload: float | None = None


def grid_of(w: World, rec: Rec, coarse: bool, least: float = 0.0) -> tuple[int, float]:
    """Steps per sample and step width."""
    fine = 20000.0
    want = {"chirp": fine, "sphs": fine, "step": 8000.0, "cyclic": 5000.0}.get(rec.protocol, 1000.0)
    if rec.protocol == "step" and rec.loading == "mechanical":
        want = 5000.0
    if coarse:
        want /= 4
    want = max(want, least)
    every = max(1, int(np.ceil(want / rec.rate)))
    return every, 1.0 / (rec.rate * every)


def simulate(w: World, effects: list[Effect], coarse: bool = False) -> list[dict[str, np.ndarray]]:
    """Noise-free recordings: `force` (deviation plus preload), `displacement` or `voltage` and `command`."""
    st: dict = {}
    empty = np.zeros(1)
    one = np.ones(1)
    film_states: dict[int, np.ndarray] = {}
    contact_states: dict[int, np.ndarray] = {}
    out = []
    preload = w.preload
    least = 0.0
    for ef in effects:
        # parts that are coupled explicitly want small steps everywhere
        if (ef.rig and ef.rig[0] in (core.FRAME, core.TUNED)) or (ef.film and ef.film[0] == core.MEMBRANE):
            least = 10000.0
        if ef.preload is not None:
            preload = ef.preload
    for rec in w.recs:
        n = round(rec.duration * rec.rate) + 1
        ts = np.arange(n) / rec.rate
        ch: dict[str, np.ndarray] = {}
        mass, kl, cl = w.mass, w.kl, w.cl
        for ef in effects:
            mass *= 1 + (ef.d_mass(rec) if ef.d_mass else 0.0)
            kl *= 1 + (ef.d_kl(rec) if ef.d_kl else 0.0)
            cl += ef.d_cl
        if rec.protocol == "tap":
            s = ts - rec.p["lead"]
            om = np.sqrt(kl / mass)
            z = cl / (2 * mass * om)
            wd = om * np.sqrt(max(1 - z * z, 1e-6))
            ch["force"] = np.where(s >= 0, rec.p["amp"] * np.exp(-z * om * s) * np.sin(wd * s), 0.0)
        elif rec.protocol == "weight":
            j = np.clip((ts / rec.p["each"]).astype(int), 0, len(rec.p["masses"]) - 1)
            lev = GRAVITY * np.array(rec.p["masses"])[j]
            a = np.exp(-1.0 / (rec.rate * 0.05))
            ch["force"] = lfilter([1 - a], [1, -a], lev)
        else:
            every, h = grid_of(w, rec, coarse, least)
            t = np.arange((n - 1) * every + 1) * h
            x = motion(rec, t)
            electric = rec.loading == "electrical"
            if electric:
                com = wanted_voltage(rec, t)
                v = core.one_pole(com * (w.amp_gain / 1.5), w.tau_amp, w.tau_amp, 1e9, h, 0.0)
                mon, film_v, vsq = v, v, None
                for ef in effects:
                    if ef.drive:
                        got = ef.drive(film_v, h, rec, st)
                        film_v, mon = got if isinstance(got, tuple) else (got, mon)
                    if ef.vsq:
                        vsq = ef.vsq(film_v, h, rec, st)
                if vsq is None:
                    vsq = film_v * film_v
                fa = w.gain * vsq
                for ef in effects:
                    if ef.act:
                        fa = ef.act(film_v, fa, h, rec, st)
                ch["voltage"] = mon[::every].copy()
                ch["command"] = com[::every] / 1.5
            else:
                v = np.zeros_like(t)
                fa = np.zeros_like(t)
                ch["displacement"] = x[::every].copy()
            xf = x
            for ef in effects:
                if ef.motion:
                    xf = ef.motion(xf, h, rec, st)
                if ef.force_in:
                    fa = fa + ef.force_in(x, v, h, rec, st)
            scale, speed = one, one
            for ef in effects:
                if ef.scale:
                    a, b = ef.scale(rec, t, st)
                    scale = scale * a
                    speed = speed * b
            ks, taus = list(w.ks), list(w.taus)
            fcode, fp, fst = 0, empty, np.zeros(20)
            ccode, cp, cst = 0, empty, np.zeros(20)
            rcode, rp = 0, empty
            for i, ef in enumerate(effects):
                for k, tau in ef.arms:
                    ks.append(k)
                    taus.append(max(tau, 2e-5))
                if ef.film:
                    fcode, fp = ef.film[0], np.array(ef.film[1], float)
                    if ef.persist:
                        fst = film_states.setdefault(i, fst)
                        if fcode == core.DAMAGE:
                            fst[4] = fst[5] = 0.0
                        if fcode == core.HEAT and "rest_from" in st:
                            fst[0] *= np.exp(-(rec.t0 - st["rest_from"]) / fp[3])
                        st["rest_from"] = rec.t0 + rec.duration
                    elif fcode == core.STIFFEN:
                        fst[0] = 0.0
                if ef.contact:
                    ccode, cp = ef.contact[0], np.array(ef.contact[1], float)
                if ef.rig:
                    rcode, rp = ef.rig[0], np.array(ef.rig[1], float)
            del contact_states
            contact_states = {}
            f = core.integrate(
                x if xf is x else np.ascontiguousarray(xf), np.ascontiguousarray(fa), np.atleast_1d(scale).astype(float),
                np.atleast_1d(speed).astype(float), h, every, w.k0, np.array(ks), np.array(taus), mass, kl, cl,
                fcode, fp, fst, ccode, cp, cst, rcode, rp,
            )  # fmt: skip
            ch["force"] = f + preload
        for ef in effects:
            if ef.temperature:
                ch["temperature"] = ef.temperature(rec, ts, st)
        for ef in effects:
            if ef.sensor:
                ef.sensor(ch, rec, st)
        for ef in effects:
            if ef.drift:
                ch["force"] = ch["force"] + ef.drift(ts, rec, st)
        out.append(ch)
    return out


def respond(w: World, u: np.ndarray, rate: float, loading: str, pars: tuple) -> np.ndarray:
    """Response of the linear plain model to a sampled input, by a numerical Laplace transform."""
    n = u.size
    big = 1 << int(np.ceil(np.log2(2 * n)))
    dt = 1 / rate
    sig = 8.0 / (big * dt)
    t = np.arange(n) * dt
    spec = np.fft.rfft(u * np.exp(-sig * t), big)
    s = sig + 2j * np.pi * np.fft.rfftfreq(big, dt)
    return np.fft.irfft(spec * transfer(s, loading, pars), big)[:n] * np.exp(sig * t)


def transfer(s: np.ndarray, loading: str, pars: tuple) -> np.ndarray:
    """F/x0, or F/V² with its sign, of the plain model."""
    k0, ks, taus, mass, kl, cl, gain = pars
    k = k0 + 0 * s
    for a, b in zip(ks, taus, strict=True):
        k = k + a * s * b / (1 + s * b)
    den = k + kl + mass * s * s + cl * s
    return (k * kl if loading == "mechanical" else -gain * kl) / den


def thin(y: np.ndarray, q: int) -> np.ndarray:
    """Block means (the decimation of the detectability)."""
    if q == 1:
        return y
    n = y.size // q * q
    return y[:n].reshape(-1, q).mean(1)


def plain_pars(w: World) -> list[tuple[str, tuple, float, float]]:
    """Parameters of the plain model: name, parameter sets shifted up, relative step, prior sd (0 none)."""
    base = (w.k0, w.ks, w.taus, w.mass, w.kl, w.cl, w.gain)
    d = 1e-3
    out = [("k0", (w.k0 * (1 + d), *base[1:]), d, 0.0)]
    for i in range(len(w.ks)):
        a = w.ks.copy()
        a[i] *= 1 + d
        out.append((f"k{i + 1}", (w.k0, a, *base[2:]), d, 0.0))
        b = w.taus.copy()
        b[i] *= 1 + d
        out.append((f"tau{i + 1}", (w.k0, w.ks, b, *base[3:]), d, 0.0))
    out.append(("mass", (*base[:3], w.mass * (1 + d), *base[4:]), d, w.files["sd_m"]))
    out.append(("kl", (*base[:4], w.kl * (1 + d), *base[5:]), d, w.files["sd_k"]))
    out.append(("gain", (*base[:6], w.gain * (1 + d)), d, 0.0))
    return out


class Detector:
    """d of a difference, after projecting out the plain model's parameters."""

    def __init__(self, w: World, plain: list[dict[str, np.ndarray]]) -> None:
        self.w = w
        self.sigma = w.noise["sd"]
        self.base = (w.k0, w.ks, w.taus, w.mass, w.kl, w.cl, w.gain)
        self.q = [max(1, int(rec.rate // 400)) for rec in w.recs]
        pars = plain_pars(w)
        self.names = [p[0] for p in pars]
        m = len(pars)
        prior = np.array([1.0 / p[3] ** 2 if p[3] > 0 else 0.0 for p in pars])
        self.cols: list[np.ndarray | None] = []
        a = np.diag(prior + 1e-9)
        self.inputs: list[np.ndarray | None] = []
        for rec, ch, q in zip(w.recs, plain, self.q, strict=True):
            if rec.protocol == "weight":
                self.cols.append(None)
                self.inputs.append(None)
                continue
            if rec.protocol == "tap":
                cols = np.zeros((len(thin(ch["force"], q)), m))
                t = np.arange(ch["force"].size) / rec.rate
                s = t - rec.p["lead"]
                for j, name in enumerate(self.names):
                    if name in ("mass", "kl"):
                        om0 = np.sqrt(w.kl / w.mass)
                        z = w.cl / (2 * w.mass * om0)
                        om = om0 * (1 + (5e-4 if name == "kl" else -5e-4))
                        y = np.where(s >= 0, rec.p["amp"] * np.exp(-z * om0 * s) * np.sin(om * s), 0.0)
                        y0 = np.where(s >= 0, rec.p["amp"] * np.exp(-z * om0 * s) * np.sin(om0 * s), 0.0)
                        cols[:, j] = thin((y - y0) / 1e-3, q)
                self.inputs.append(None)
            else:
                u = thin(ch["voltage"] ** 2 if rec.loading == "electrical" else ch["displacement"], q)
                self.inputs.append(u)
                rate = rec.rate / q
                n = u.size
                big = 1 << int(np.ceil(np.log2(2 * n)))
                sig = 8.0 * rate / big
                t = np.arange(n) / rate
                spec = np.fft.rfft(u * np.exp(-sig * t), big)
                s = sig + 2j * np.pi * np.fft.rfftfreq(big, 1 / rate)
                h0 = transfer(s, rec.loading, self.base)
                cols = np.empty((n, m))
                up = np.exp(sig * t)
                for j, (_, par, d, _) in enumerate(pars):
                    cols[:, j] = np.fft.irfft(spec * (transfer(s, rec.loading, par) - h0) / d, big)[:n] * up
            cols -= cols.mean(0)
            self.cols.append(cols)
            a += cols.T @ cols * (q / self.sigma**2)
        self.scale = 1 / np.sqrt(np.diag(a))
        self.inv = np.linalg.pinv(a * np.outer(self.scale, self.scale), rcond=1e-12, hermitian=True)

    def difference(self, plain: list[dict], other: list[dict]) -> list[np.ndarray]:
        """Force that the plain model does not give for the recorded inputs, decimated, mean removed."""
        out = []
        for rec, a, b, q, u in zip(self.w.recs, plain, other, self.q, self.inputs, strict=True):
            y = thin(b["force"] - a["force"], q)
            if u is not None:
                v = thin(b["voltage"] ** 2 if rec.loading == "electrical" else b["displacement"], q)
                if np.any(v != u):
                    y = y - respond(self.w, v - u, rec.rate / q, rec.loading, self.base)
            if rec.protocol != "weight":
                y = y - y.mean()
            else:
                y = y - y[: max(1, y.size // 4)].mean()
            out.append(y)
        return out

    def project(self, ys: list[np.ndarray]) -> list[np.ndarray]:
        """The part outside the plain model's reach."""
        b = np.zeros(len(self.names))
        for y, c, q in zip(ys, self.cols, self.q, strict=True):
            if c is not None:
                b += c.T @ y * (q / self.sigma**2)
        x = self.scale * (self.inv @ (self.scale * b))
        self.last = x
        return [y if c is None else y - c @ x for y, c in zip(ys, self.cols, strict=True)]

    def d(self, plain: list[dict], other: list[dict]) -> float:
        """Detectability."""
        ys = self.difference(plain, other)
        b = np.zeros(len(self.names))
        total = 0.0
        for y, c, q in zip(ys, self.cols, self.q, strict=True):
            total += float(y @ y) * q / self.sigma**2
            if c is not None:
                b += c.T @ y * (q / self.sigma**2)
        sb = self.scale * b
        total -= float(sb @ self.inv @ sb)
        if any("command" in p for p in plain) and self.w.noise.get("command"):
            for rec, a, o in zip(self.w.recs, plain, other, strict=True):
                if rec.loading == "electrical":
                    dv = o["voltage"] - a["voltage"]
                    g = a["voltage"]
                    dv = dv - g * (g @ dv) / max(float(g @ g), 1e-12)
                    total += float(dv @ dv) / self.w.v_noise**2
        return float(np.sqrt(max(total, 0.0)))


__all__ = ["Detector", "Effect", "film_k", "plain_pars", "respond", "simulate", "thin", "transfer"]
