"""Specimens, rigs, protocols, noise and the files of the laboratory `auk`."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.writer import CompressionType, Writer
from scipy.signal import lfilter

from .core import Film, Hooks, simulate

EPS0 = 8.8541878e-6
GRAVITY = 9.80665
UNITS = {
    "force": "N",
    "displacement": "mm",
    "voltage": "kV",
    "command": "V",
    "capacitance": "pF",
    "temperature": "degC",
}


@dataclass
class Rec:
    """One recording: protocol, drive and metadata."""

    protocol: str
    loading: str
    duration: float
    rate: float
    par: dict[str, Any]
    meta: dict[str, str]
    rates: dict[str, float] = field(default_factory=dict)
    session_time: float = 0.0
    exposure: float = 0.0  # integral of V^2 before this recording, kV^2 s
    heat: float = 0.0
    amp_tau: float = 1e-4
    amp_gain: float = 1.5
    room: float = 22.0
    index: int = 0
    rec_id: str = ""
    noise_factor: float = 1.0
    cache: dict[Any, Any] = field(default_factory=dict)

    def motion(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Displacement and velocity of the driven end (kept)."""
        key = ("m", t.size)
        if key not in self.cache:
            self.cache[key] = self._motion(t)
        return self.cache[key]

    def volts(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Command in V and the monitored voltage in kV (kept)."""
        key = ("v", t.size)
        if key not in self.cache:
            self.cache[key] = self._volts(t)
        return self.cache[key]

    def _motion(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        p = self.par
        x, v = np.zeros_like(t), np.zeros_like(t)
        if self.protocol == "chirp":
            f0, f1, dur = p["f0"], p["f1"], p["sweep_s"]
            for r in range(p["repeats"]):
                s = t - p["rest"] - r * p["period"]
                on = (s > 0) & (s < dur)
                q = s[on]
                if p["sweep"] == "log":
                    lk = np.log(f1 / f0)
                    ph = 2 * np.pi * f0 * dur / lk * (np.exp(q / dur * lk) - 1)
                    w = 2 * np.pi * f0 * np.exp(q / dur * lk)
                else:
                    ph = 2 * np.pi * (f0 * q + 0.5 * (f1 - f0) * q * q / dur)
                    w = 2 * np.pi * (f0 + (f1 - f0) * q / dur)
                ramp = p["ramp"]
                up, dn = np.clip(q / ramp, 0, 1), np.clip((dur - q) / (0.3 * ramp), 0, 1)
                env = up * up * (3 - 2 * up) * dn * dn * (3 - 2 * dn)
                den = 6 * up * (1 - up) / ramp * dn * dn * (3 - 2 * dn)
                den -= up * up * (3 - 2 * up) * 6 * dn * (1 - dn) / (0.3 * ramp)
                x[on] = p["amp"] * env * np.sin(ph)
                v[on] = p["amp"] * (den * np.sin(ph) + env * w * np.cos(ph))
        elif self.protocol == "cyclic":
            s = t - p["rest"]
            on = (s > 0) & (s < p["cycles"] / p["freq"])
            w = 2 * np.pi * p["freq"]
            x[on] = 0.5 * p["pp"] * (1 - np.cos(w * s[on]))
            v[on] = 0.5 * p["pp"] * w * np.sin(w * s[on])
        elif self.protocol == "step" and self.loading == "mechanical":
            y = np.clip((t - p["rest"]) / p["ramp"], 0, 1)
            x = p["size"] * y * y * (3 - 2 * y)
            v = p["size"] * 6 * y * (1 - y) / p["ramp"]
        return x, v

    def _volts(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        c = np.zeros_like(t)
        p = self.par
        if self.loading != "electrical":
            return c, c
        if self.protocol == "sphs":
            k = p["lines"]
            kk = np.arange(1, k.size + 1)
            ph = -np.pi * kk * (kk - 1) / k.size
            g = np.arange(8192) / 8192
            base = np.zeros(8192)
            for a, b in zip(k, ph, strict=True):
                base += np.cos(2 * np.pi * a * g + b)
            peak = 1.02 * np.abs(base).max()
            dt = t[1] - t[0]
            per = round(p["period"] / dt)
            u = np.zeros(per)
            tau = np.arange(per) * dt / p["period"]
            for a, b in zip(k, ph, strict=True):
                u += np.cos(2 * np.pi * a * tau + b)
            u = u / peak
            n0 = round(p["rest"] / dt)
            one = np.sqrt((1 + u) / 2) if p["root"] else (1 + u) / 2
            end = p["rest"] + p["period"] * p["periods"]
            up = np.clip((t - p["rest"] + 0.2) / 0.2, 0, 1)
            dn = np.clip((end + 0.2 - t) / 0.2, 0, 1)
            env = up * up * (3 - 2 * up) * dn * dn * (3 - 2 * dn)
            c = p["kv"] * env * one[(np.arange(t.size) - n0) % per]
        else:
            for kv, on, off in p["edges"]:
                up, dn = np.clip((t - on) / p["edge"], 0, 1), np.clip((t - off) / p["edge"], 0, 1)
                c += kv * (up**3 * (10 - 15 * up + 6 * up * up) - dn**3 * (10 - 15 * dn + 6 * dn * dn))
        dt = t[1] - t[0]
        q = dt / (dt + 2 * self.amp_tau)
        v = lfilter([q, q], [1, q * 2 - 1], c)
        return c / self.amp_gain, v

    def calibration(self, t: np.ndarray, mass: float, kl: float, cl: float, hooks: Hooks) -> np.ndarray:
        """Force of tap and weight recordings."""
        f = np.zeros_like(t)
        if self.protocol == "weight":
            for m, on, off in self.par["loads"]:
                y = np.clip((t - on) / 0.3, 0, 1) - np.clip((t - off) / 0.3, 0, 1)
                f += m * GRAVITY * y
            return f
        w = np.sqrt(kl / mass)
        z = cl / (2 * np.sqrt(kl * mass)) + (hooks.damp[1][0] / (2 * np.sqrt(kl * mass)) if hooks.damp[0] == 1 else 0.0)
        wd = w * np.sqrt(1 - z * z)
        for t0 in self.par["taps"]:
            s = np.maximum(t - t0, 0)
            f += self.par["size"] * np.exp(-z * w * s) * np.sin(wd * s) * (t > t0)
        return f


@dataclass
class Session:
    """All that is drawn before an effect is hidden."""

    film: Film
    recs: list[Rec]
    offset: float
    rig: dict[str, str]
    common: dict[str, str]
    sd: dict[str, float]
    res: dict[str, float]
    truth: dict[str, Any]
    style: str
    noise: dict[str, Any]
    prior: np.ndarray
    cap0: float
    emax: float = 0.0
    vmax: float = 0.0
    tneg: float = 0.0
    tmax: float = 0.0
    length: float = 60.0
    share: float = 1.0
    fmin: float = 0.1
    ftop: float = 1.0
    vrms2: float = 1.0


def loguni(rng: np.random.Generator, a: float, b: float) -> float:
    """Log-uniform draw."""
    return float(np.exp(rng.uniform(np.log(a), np.log(b))))


def _arms(rng: np.random.Generator, material: str, k0: float) -> tuple[list[float], list[float]]:
    n = int(rng.integers(1, 4))
    hi, lo = (3.0, 0.5) if material == "acrylic" else (0.9, 0.1)
    spans = {1: [(0.004, 0.2)], 2: [(0.1, 2.0), (0.003, 0.04)], 3: [(0.6, 4.0), (0.03, 0.2), (0.0015, 0.008)]}[n]
    tau = [loguni(rng, *s) for s in spans]
    k = [k0 * loguni(rng, lo, hi) for _ in tau]
    if material == "acrylic" and n == 3:
        k[2] *= 2.0
    return k, tau


def draw_film(rng: np.random.Generator) -> tuple[Film, dict[str, Any], dict[str, str], float, float]:
    """A specimen on a rig; geometry, metadata, mean force and rest capacitance."""
    acrylic = rng.random() < 0.5
    lam = rng.choice([1.2, 1.3, 1.4, 1.5, 1.8, 2.0] if acrylic else [1.1, 1.15, 1.2, 1.25, 1.3])
    l1 = float(rng.choice([30.0, 40.0, 50.0, 60.0]))
    l2 = float(rng.choice([30.0, 40.0, 50.0]))
    hf = float(rng.choice([0.5, 1.0]) if acrylic else rng.choice([0.2, 0.3, 0.5, 0.6]))
    mu = loguni(rng, 0.02, 0.09) if acrylic else loguni(rng, 0.06, 0.4)
    layers = 1
    a0 = l2 * hf * layers
    k0 = mu * (1 + 2 / lam**3) * a0 / l1
    pre = mu * (lam - lam**-2) * a0
    pure = rng.random() < 0.25
    lam2 = 1.0 if pure else 1 / np.sqrt(lam)
    tot = l1 * lam
    drawn = "stretched" if rng.random() < 0.5 else "undeformed"
    full = rng.random() < 0.5
    share = 1.0 if full else float(rng.choice([0.4, 0.5, 0.6, 0.75]))
    wcur = l2 * lam2 * (1.0 if full else float(rng.choice([0.6, 0.8, 1.0])))
    z = hf / (lam * lam2)
    eps_nom = 4.7 if acrylic else 2.8
    eps = eps_nom * (1 + 0.05 * rng.standard_normal())
    lcur = tot * share
    gain_full = EPS0 * eps * wcur / z * layers
    cap = 1e-3 * 8.8541878 * eps * wcur * lcur / z * layers
    k, tau = _arms(rng, "acrylic" if acrylic else "silicone", k0)
    fc = loguni(rng, 20, 150)
    kl = max(loguni(rng, 2, 25), 4.0 * k0)
    mass = kl / (2 * np.pi * fc) ** 2
    zeta = loguni(rng, 0.006, 0.04)
    film = Film(k0, k, tau, mass, kl, zeta, gain_full * share)
    al, aw = (lcur, wcur) if drawn == "stretched" else (lcur / lam, wcur / lam2)
    meta = {
        "material": str(
            rng.choice(["VHB 4910", "polyacrylate"])
            if acrylic
            else rng.choice(["PlatSil 7315", "silicone", "Elastosil"])
        ),
        "film_length_mm": f"{l1:g}",
        "film_width_mm": f"{l2:g}",
        "film_thickness_mm": f"{hf:g}",
        "stretch_1": f"{lam:g}",
        "layers": str(layers),
        "active_length_mm": f"{al:.4f}",
        "active_width_mm": f"{aw:.4f}",
        "active_drawn": drawn,
        "total_length_mm": f"{tot:g}",
        "relative_permittivity": f"{eps_nom:g}",
    }
    if pure:
        meta["stretch_2"] = "1"
    if rng.random() < 0.5:
        meta["relative_permittivity_sd"] = f"{0.1 * eps_nom:.3g}"
    truth = {"fc_hz": fc, "preload_n": pre, "permittivity": eps, "share": share, "mu_mpa": mu, "thickness_z": z}
    return film, truth, meta, pre, cap


def draw_session(rng: np.random.Generator, need: str = "") -> Session:
    """Composition, specimen, rig and noise. need: '', 'e', 'm' or 'w' (electrical, mechanical, weights)."""
    film, truth, common, pre, cap = draw_film(rng)
    length = float(common["total_length_mm"])
    u = rng.random()
    style = "full" if u < 0.4 else ("compact" if u < 0.8 else "mechanical")
    if need in ("e", "w") and style == "mechanical":
        style = "compact"
    big = rng.uniform(0.015, 0.05)
    recs: list[Rec] = []
    srate = float(rng.choice([1000.0, 2000.0, 4000.0]))
    f0 = float(rng.choice([0.5, 1.0, 2.0]))
    f1 = float(min(rng.choice([80.0, 100.0, 120.0, 150.0]), 0.24 * srate))
    sweep = "log" if rng.random() < 0.65 else "linear"
    csec = float(rng.choice([10.0, 15.0, 20.0]))
    common["configuration"] = str(rng.choice(["single", "frame A", "standard"]))

    def chirp(amp: float, rep: int) -> Rec:
        rest = float(rng.choice([0.5, 1.0]))
        gap = float(rng.choice([1.0, 2.0]))
        sw = csec if rep == 1 else max(csec / 2, 6.0)
        p = {
            "f0": f0,
            "f1": f1,
            "sweep_s": sw,
            "rest": rest,
            "repeats": rep,
            "period": sw + gap,
            "sweep": sweep,
            "amp": amp,
            "ramp": 0.4,
        }
        m = {"frequency_start_hz": f"{f0:g}", "frequency_stop_hz": f"{f1:g}", "sweep": sweep, "repeats": str(rep)}
        m["strain_pp"] = f"{2 * amp / length:.5g}"
        if rep > 1:
            m["period_s"] = f"{sw + gap:g}"
        tail = 3.0
        return Rec("chirp", "mechanical", rest + rep * (sw + gap) - gap + tail, srate, p, m)

    def sphs(kv: float) -> Rec:
        period = float(rng.choice([1.0, 2.0])) if style == "full" else 1.0
        n = int(f1 * period)
        kind = lines_kind
        k = np.arange(1, n + 1)
        if kind != "full":
            k = k[k % 2 == 1]
        if kind == "random_odd":
            keep = np.ones(k.size, bool)
            pick = np.random.default_rng(lseed)
            for g in range(0, k.size - 3, 4):
                keep[g + int(pick.integers(0, 4))] = False
            k = k[keep]
        per = int(rng.integers(8, 13)) if period == 1.0 else 8
        p = {"lines": k, "period": period, "periods": per, "kv": kv, "rest": 0.5, "root": root}
        m = {
            "period_s": f"{period:g}",
            "periods": str(per),
            "lines": kind,
            "drive_kv": f"{kv:g}",
            "frequency_start_hz": f"{k[0] / period:g}",
            "frequency_stop_hz": f"{k[-1] / period:g}",
        }
        return Rec("sphs", "electrical", 0.5 + per * period + 0.5, srate, p, m)

    def vstep(levels: list[float], on: float, off: float) -> Rec:
        e = []
        t = 1.0
        rate = float(rng.choice([500.0, 1000.0, 2000.0]))
        for kv in levels:
            e.append((kv, t, t + on))
            t += on + off
        m = {
            "on_s": f"{on:g}",
            "off_s": f"{off:g}",
            "cycles": str(len(levels)),
            "controller": "open",
            "drive_kv": f"{max(levels):g}",
        }
        return Rec("step", "electrical", t, rate, {"edges": e, "edge": float(rng.choice([20, 30, 40])) / rate}, m)

    def cyclic(pp: float, freq: float, cycles: int) -> Rec:
        m = {"frequency_hz": f"{freq:g}", "cycles": str(cycles), "strain_pp": f"{pp:g}"}
        rate = 200.0 if freq < 1 else 500.0
        p = {"freq": freq, "cycles": cycles, "pp": pp * length, "rest": 0.5}
        return Rec("cyclic", "mechanical", 0.5 + cycles / freq + 1.0, rate, p, m)

    lines_kind = str(rng.choice(["full", "odd", "random_odd"]))
    lseed = int(rng.integers(1 << 30))
    root = bool(rng.random() < 0.6)
    z = truth["thickness_z"]
    vtop = float(np.clip(np.round(rng.uniform(12, 22) * z * 2) / 2, 3.0, 8.0))
    amps = [a * big * length for a in ((0.3, 0.6, 1.0) if rng.random() < 0.5 else (0.35, 1.0))]
    fr = [float(x) for x in rng.choice([0.1, 0.2, 0.5, 1.0, 2.0, 5.0], size=3, replace=False)]
    rep = int(rng.choice([1, 2, 3]))
    pps = [round(big * 2 * f, 4) for f in (0.4, 0.8, 1.2, 1.6, 2.0)]
    if style == "full":
        recs += [chirp(a, rep) for a in amps] + [
            sphs(round(vtop * q, 2)) for q in rng.permutation([0.4, 0.6, 0.8, 1.0])
        ]
        recs.append(vstep([round(vtop * q, 2) for q in (0.4, 0.6, 0.8, 0.9, 1.0)], 4.0, 4.0))
        for f in fr[: int(rng.integers(1, 3))]:
            recs += [cyclic(p, f, max(2, min(6, int(12 * f)))) for p in pps]
        recs.append(_relax(rng, big, length))
        recs.append(chirp(amps[0], 1))
    else:
        recs += [chirp(a, rep if i == 0 else 1) for i, a in enumerate(amps)]
        if style == "compact":
            nv = int(rng.integers(2, 4))
            recs += [sphs(round(vtop * q, 2)) for q in np.linspace(0.5, 1.0, nv)]
            recs.append(vstep([round(vtop * q, 2) for q in (0.5, 0.75, 1.0)], 4.0, 3.0))
        f = fr[0]
        recs += [cyclic(p, f, max(2, min(6, int(12 * f)))) for p in pps[:: 2 if style == "compact" else 1]]
        if rng.random() < 0.6:
            recs.append(_relax(rng, big, length))
        if rng.random() < 0.6 or style == "mechanical":
            recs.append(chirp(amps[0], 1))
    start = {"protocol": "tap"}
    if rng.random() < 0.35:
        p = {"taps": [0.5, 3.0, 5.5], "size": 0.05 + 0.1 * rng.random()}
        recs.insert(0, Rec(start["protocol"], "calibration", 8.0, 2000.0, p, {}))
    if rng.random() < 0.3 or need == "w":
        ms = [0.01, 0.02, 0.05, 0.1] if rng.random() < 0.5 else [0.02, 0.05, 0.1]
        p = {"loads": [(m, 3.0 + 6 * i, 6.0 + 6 * i) for i, m in enumerate(ms)], "first": 3.0}
        recs.insert(
            0, Rec("weight", "calibration", 3.0 + 6 * len(ms), 200.0, p, {"masses_kg": ",".join(f"{m:g}" for m in ms)})
        )
    sdrel = {"clamp_mass_kg": loguni(rng, 0.003, 0.02), "load_cell_stiffness_n_per_mm": loguni(rng, 0.003, 0.02)}
    f_sd = loguni(rng, 3e-4, 2.5e-3) * float(np.clip(pre, 0.4, 1.5))
    sd = {
        "force": f_sd,
        "displacement": loguni(rng, 1e-4, 6e-4),
        "voltage": loguni(rng, 5e-4, 3e-3),
        "command": 1e-3,
        "capacitance": loguni(rng, 0.002, 0.01),
        "temperature": 0.02,
    }
    res = {
        "force": f_sd * rng.uniform(0.1, 0.6),
        "displacement": 1e-4,
        "voltage": 5e-4,
        "command": 3e-4,
        "capacitance": 1e-3,
        "temperature": 0.01,
    }
    zn = rng.standard_normal(2)
    mnom = film.mass * 1e3 / (1 + sdrel["clamp_mass_kg"] * zn[0])
    klnom = film.kl / (1 + sdrel["load_cell_stiffness_n_per_mm"] * zn[1])
    peak = pre + 1.6 * (film.k0 + sum(film.k)) * big * length * 2 + 0.5
    rng_n = next((x for x in (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0) if x > peak), 200.0)
    rig = {
        "clamp_mass_kg": f"{mnom:.6g}",
        "clamp_mass_kg_sd": f"{mnom * sdrel['clamp_mass_kg']:.3g}",
        "load_cell_stiffness_n_per_mm": f"{klnom:.6g}",
        "load_cell_stiffness_n_per_mm_sd": f"{klnom * sdrel['load_cell_stiffness_n_per_mm']:.3g}",
        "load_cell_range_n": f"{rng_n:g}",
    }
    if rng.random() < 0.6:
        cl = 2 * film.zeta * np.sqrt(film.kl * film.mass)
        s = rng.uniform(0.1, 0.3)
        rig["load_cell_damping_n_s_per_mm"] = f"{cl * (1 + s * rng.standard_normal() * 0.7):.4g}"
        rig["load_cell_damping_n_s_per_mm_sd"] = f"{cl * s:.3g}"
    if rng.random() < 0.6:
        rig["amplifier_gain_kv_per_v"] = "1.5"
    if rng.random() > 1 / 3:
        rig["force_noise_sd"] = f"{f_sd * rng.uniform(0.7, 1.3):.3g}"
        rig["displacement_noise_sd"] = f"{sd['displacement'] * rng.uniform(0.8, 1.2):.3g}"
    has_com = rng.random() < 0.4
    has_cap = rng.random() < 0.35
    has_temp = rng.random() < 0.25
    t, expo, heat = 0.0, 0.0, 0.0
    tau = loguni(rng, 4e-5, 1.2e-4)
    half = rng.random() < 0.25
    for i, r in enumerate(recs):
        r.index, r.session_time, r.amp_tau, r.exposure, r.heat = i, t, tau, expo, heat
        r.room = 22 + rng.normal(0, 0.02)
        ch = {"mechanical": ["displacement", "force"], "electrical": ["voltage", "force"], "calibration": ["force"]}[
            r.loading
        ]
        r.rates = dict.fromkeys(ch, r.rate)
        if half and r.protocol == "chirp" and r.rate >= 2000:
            r.rates["displacement"] = r.rate / 2
        if has_com and r.loading == "electrical":
            r.rates["command"] = r.rate
        if has_cap and r.loading == "electrical" and r.protocol == "step":
            r.rates["capacitance"] = 50.0
        if has_temp:
            r.rates["temperature"] = 10.0
        if r.loading == "electrical":
            _, v = r.volts(np.arange(int(r.duration * 1000)) / 1000.0)
            expo += float(np.sum(v * v)) / 1000
        if r.protocol == "chirp":
            heat += r.par["amp"] ** 2 * r.duration
        t += r.duration + float(np.round(rng.uniform(30, 200)))
    kind = "white"
    noise = {"kind": kind, "double": -1, "stated": "force_noise_sd" in rig}
    q = np.array(
        [np.nan] * (1 + 2 * len(film.k)) + [sdrel["clamp_mass_kg"], sdrel["load_cell_stiffness_n_per_mm"], 0.5, 0.1]
    )
    ses = Session(film, recs, pre, rig, common, sd, res, truth, style, noise, q, cap)
    ses.length, ses.share, ses.fmin = length, truth["share"], min(fr[0], f0)
    ses.emax = max([r.par.get("amp", 0) for r in recs] + [r.par.get("pp", 0) for r in recs])
    ses.vmax = vtop
    _tame(ses)
    rig["load_cell_range_n"] = (
        f"{next((x for x in (1.0, 2.0, 5.0, 10.0, 20.0, 50.0) if x > pre + 1.3 * ses.tmax), 100.0):g}"
    )
    return ses


def _tame(ses: Session) -> None:
    """Scale the drives so that the pre-load is never lost, as an experimenter would."""
    carry = np.zeros(4)
    limit = 0.75 * ses.offset
    groups: dict[str, float] = {}
    tops: dict[int, float] = {}
    for r in ses.recs:
        if r.loading != "calibration":
            res = simulate(ses.film, r, Hooks(), 1000.0, carry, 0.0)
            tops[r.index] = float(max(np.abs(res["T"]).max(), np.abs(res["force"]).max() * limit / 2.5))
            g = r.protocol + r.loading
            groups[g] = max(groups.get(g, 0.0), tops[r.index])
    for r in ses.recs:
        r.cache = {}
        g = r.protocol + r.loading
        if r.loading == "mechanical" and groups[g] > limit:
            q = limit / groups[g]
            for key in ("amp", "pp", "size"):
                if key in r.par:
                    r.par[key] *= q
            if "strain_pp" in r.meta:
                r.meta["strain_pp"] = f"{float(r.meta['strain_pp']) * q:.5g}"
        if r.loading == "electrical" and groups[g] > limit:
            q = float(np.floor(100 * np.sqrt(limit / groups[g])) / 100)
            if "kv" in r.par:
                r.par["kv"] = round(r.par["kv"] * q, 3)
            if "edges" in r.par:
                r.par["edges"] = [(round(v * q, 3), a, b) for v, a, b in r.par["edges"]]
            r.meta["drive_kv"] = f"{r.par.get('kv') or max(v for v, _, _ in r.par['edges']):g}"
    ses.tmax = min(max(tops.values()), limit)
    ses.emax = max([r.par.get("amp", 0) for r in ses.recs] + [r.par.get("pp", 0) for r in ses.recs])
    kvs = [r.par["kv"] for r in ses.recs if "kv" in r.par]
    kvs += [v for r in ses.recs if "edges" in r.par for v, _, _ in r.par["edges"]]
    ses.vmax = max(kvs, default=1.0)
    expo = heat = 0.0
    for r in ses.recs:
        r.exposure, r.heat = expo, heat
        if r.loading == "electrical":
            _, v = r.volts(np.arange(int(r.duration * 1000)) / 1000.0)
            expo += float(np.sum(v * v)) / 1000
        if r.protocol == "chirp":
            heat += r.par["amp"] ** 2 * r.duration


def _relax(rng: np.random.Generator, big: float, length: float) -> Rec:
    size = big * length * float(rng.choice([1.0, 1.6]))
    p = {"rest": 1.0, "ramp": float(rng.choice([0.1, 0.2])), "size": size}
    m = {"strain_pp": f"{size / length:.5g}"}
    return Rec("step", "mechanical", float(rng.choice([20.0, 30.0, 40.0])), 200.0, p, m)


def coloured(rng: np.random.Generator, n: int, rate: float, kind: str) -> np.ndarray:
    """Noise of unit standard deviation (short-term)."""
    w = rng.standard_normal(n)
    if kind == "pink":
        f = np.fft.rfftfreq(n, 1 / rate)
        s = np.fft.rfft(rng.standard_normal(n)) * np.sqrt(5.0 / np.maximum(f, 0.2))
        p = np.fft.irfft(s, n)
        return 0.8 * w + 0.6 * p
    if kind == "burst":
        g = np.ones(n)
        for _ in range(int(rng.integers(2, 6))):
            a = int(rng.integers(0, n))
            g[a : a + int(rng.uniform(0.05, 0.4) * rate)] *= rng.uniform(2, 5)
        return w * g
    if kind == "slow":
        return w * (1 + 0.6 * np.sin(2 * np.pi * rng.uniform(0.5, 2) * np.arange(n) / n + rng.uniform(0, 6.28)))
    return w


def _schema() -> tuple[bytes, Any]:
    fd = descriptor_pb2.FileDescriptorProto(name="dealab/sample_block.proto", package="dealab", syntax="proto3")
    m = fd.message_type.add(name="SampleBlock")
    ty = descriptor_pb2.FieldDescriptorProto
    m.field.add(name="start_time_ns", number=1, type=ty.TYPE_SFIXED64, label=ty.LABEL_OPTIONAL)
    m.field.add(name="sample_interval_s", number=2, type=ty.TYPE_DOUBLE, label=ty.LABEL_OPTIONAL)
    m.field.add(name="values", number=3, type=ty.TYPE_DOUBLE, label=ty.LABEL_REPEATED)
    pool = descriptor_pool.DescriptorPool()
    pool.Add(fd)
    cls = message_factory.GetMessageClass(pool.FindMessageTypeByName("dealab.SampleBlock"))
    return descriptor_pb2.FileDescriptorSet(file=[fd]).SerializeToString(), cls


SCHEMA, BLOCK = _schema()


def write_mcap(
    path: Path,
    meta: dict[str, str],
    rig: dict[str, str],
    chans: list[dict[str, Any]],
    start_ns: int,
    block: int,
    comp: str,
) -> None:
    """One recording; a channel is {name, unit, rate, values, meta}; values NaN in a stretch mean a gap."""
    ct = {"zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4, "none": CompressionType.NONE}[comp]
    with path.open("wb") as fh:
        w = Writer(fh, compression=ct, chunk_size=512 * 1024)
        w.start(profile="", library="auk-daq 1.2")
        sid = w.register_schema("dealab.SampleBlock", "protobuf", SCHEMA)
        w.add_metadata("recording", meta)
        w.add_metadata("rig", rig)
        msgs = []
        for c in chans:
            cid = w.register_channel(f"/{c['name']}", "protobuf", sid, {"unit": c["unit"], **c.get("meta", {})})
            dt = 1.0 / c["rate"]
            vals = c["values"]
            seq = 0
            for a in range(0, len(vals), block):
                part = vals[a : a + block]
                ok = np.isfinite(part)
                if not ok.all():
                    if not ok.any():
                        continue
                    idx = np.flatnonzero(ok)
                    cut = np.flatnonzero(np.diff(idx) > 1)
                    runs = np.split(idx, cut + 1)
                else:
                    runs = [np.arange(len(part))]
                for r in runs:
                    ts = start_ns + round((a + r[0]) * dt * 1e9)
                    b = BLOCK(start_time_ns=ts, sample_interval_s=dt, values=part[r[0] : r[-1] + 1])
                    msgs.append((ts, cid, seq, b.SerializeToString()))
                    seq += 1
        for ts, cid, seq, data in sorted(msgs, key=lambda q: (q[0], q[1])):
            w.add_message(cid, log_time=ts, publish_time=ts, sequence=seq, data=data)
        w.finish()
