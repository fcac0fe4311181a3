"""Random specimens, rigs and sessions, and the inputs of each recording on the half-step grid."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.signal import lfilter

EPS0 = 8.8541878e-6


@dataclass
class Rec:
    """One recording: protocol, drive, times."""

    rid: str
    protocol: str
    loading: str
    p: dict
    duration: float
    fs: float
    over: int
    t0: float = 0.0
    cache: dict = field(default_factory=dict)


@dataclass
class Session:
    """Specimen, true rig, stated rig and recordings."""

    seed: int
    film: dict
    rig: dict
    stated: dict
    recs: list[Rec]
    meta: dict
    noise: dict
    style: dict
    label: str


def draw_film(rng: np.random.Generator) -> dict:
    """Draw a film: geometry and Maxwell–Wiechert constants."""
    kind = rng.choice(["acrylic", "silicone", "stack", "soft", "stiff"], p=[0.3, 0.2, 0.2, 0.15, 0.15])
    layers = 1
    if kind == "stack":
        layers = int(rng.integers(2, 6))
        length, width, thick = rng.uniform(10, 25), rng.uniform(10, 25), rng.choice([0.5, 1.0])
        lam = rng.uniform(1.5, 2.2)
        mod, ratio = rng.uniform(0.06, 0.2), (1.0, 6.0)
    elif kind == "acrylic":
        length, width, thick = rng.uniform(25, 60), rng.uniform(25, 60), rng.choice([0.5, 1.0])
        lam = rng.uniform(1.2, 2.0)
        mod, ratio = rng.uniform(0.08, 0.5), (1.0, 5.0)
    elif kind == "stiff":
        length, width, thick = rng.uniform(20, 50), rng.uniform(25, 60), rng.choice([0.5, 1.0, 1.5])
        lam = rng.uniform(1.2, 1.6)
        mod, ratio = rng.uniform(0.5, 1.2), (0.8, 4.0)
    elif kind == "silicone":
        length, width, thick = rng.uniform(30, 60), rng.uniform(25, 60), rng.choice([0.3, 0.6])
        lam = rng.uniform(1.1, 1.4)
        mod, ratio = rng.uniform(0.4, 1.2), (0.1, 0.6)
    else:
        length, width, thick = rng.uniform(30, 60), rng.uniform(25, 60), rng.choice([0.2, 0.4, 0.6])
        lam = rng.uniform(1.1, 1.5)
        mod, ratio = rng.uniform(0.15, 0.4), (0.1, 0.8)
    length, width = round(length, 1), round(width, 1)
    lam = round(lam, 2)
    area = width * thick * layers / lam
    l1 = length * lam
    k0 = mod * area / l1
    n = int(rng.choice([1, 2, 3], p=[0.35, 0.4, 0.25]))
    tau = np.sort(np.exp(rng.uniform(np.log(1e-3), np.log(1.5), n)))[::-1]
    for i in range(1, n):
        tau[i] = min(tau[i], tau[i - 1] / 4)
    tau = np.maximum(tau, 2e-4)
    ki = k0 * rng.uniform(*ratio) * rng.dirichlet(np.full(n, 3.0))
    er = rng.uniform(2.6, 4.9) if kind[0] == "s" or kind == "acrylic" else rng.uniform(2.6, 3.4)
    return {
        "kind": kind,
        "layers": layers,
        "length": length,
        "width": width,
        "thick": float(thick),
        "lam": lam,
        "l1": l1,
        "k0": k0,
        "ki": ki,
        "ti": tau,
        "er": er,
        "modulus": mod,
    }


def draw_session(seed: int, salt: int) -> Session:
    """Draw everything that a clean session has."""
    rng = np.random.default_rng([seed, salt, 7001])
    film = draw_film(rng)
    quasi = film["kind"] == "stack" and rng.random() < 0.5
    mech_only = rng.random() < (0.5 if quasi else 0.2)
    full = rng.random() < 0.4
    kinf = film["k0"] + film["ki"].sum()
    # rig
    fr = rng.uniform(20, 150)
    kl = max(kinf * np.exp(rng.uniform(np.log(1.5), np.log(20))), 1.0)
    mass = (kl + kinf) / (2 * np.pi * fr) ** 2
    zeta = rng.uniform(0.003, 0.02)
    rig = {
        "mass": mass,
        "kl": kl,
        "cl": 2 * zeta * np.sqrt(kl * mass),
        "zeta": zeta,
        "amp_tau": rng.uniform(2e-4, 1.5e-3),
        "amp_gain": rng.choice([0.8, 1.0, 1.5]),
    }
    sd = {q: rng.uniform(0.003, 0.02) for q in ("mass", "kl", "amp_gain")}
    sd["cl"] = rng.uniform(0.05, 0.2)
    stated = {}
    for q in ("mass", "kl", "cl", "amp_gain"):
        z = np.clip(rng.standard_normal(), -2, 2)
        stated[q] = rig[q] / (1 + sd[q] * z)
        stated[q + "_sd"] = sd[q] * stated[q]
    rig["amp_gain_true"] = rig["amp_gain"] * (1 + sd["amp_gain"] * np.clip(rng.standard_normal(), -2, 2))
    stated["amp_gain"], stated["amp_gain_sd"] = rig["amp_gain"], sd["amp_gain"] * rig["amp_gain"]
    # electrode and actuation
    partial = (not mech_only) and rng.random() < 0.4
    share = 1.0
    meta = {}
    if partial:
        la = round(film["l1"] * rng.uniform(0.35, 0.75), 1)
        share = la / film["l1"]
        meta["active_length_mm"] = la
    wa = film["width"] / np.sqrt(film["lam"])  # current width, electrode over the whole width
    z = film["thick"] / np.sqrt(film["lam"])
    er_st = film["er"] / (1 + 0.04 * np.clip(rng.standard_normal(), -2, 2))
    ka = EPS0 * film["er"] * wa / z * film["layers"] * share
    vmax = min(rng.uniform(4, 8), 45 * z, 0.95 * 10 * rig["amp_gain"])
    film.update(share=share, wa=wa, z=z, ka=ka, vmax=vmax, partial=partial)
    if partial or rng.random() < 0.5:
        meta.setdefault("active_length_mm", round(film["l1"], 3))
        meta["active_width_mm"] = round(wa, 1)
        meta["active_drawn"] = "stretched"
    meta["relative_permittivity"], meta["relative_permittivity_sd"] = round(er_st, 3), round(0.05 * er_st, 3)
    # recordings
    fs = float(rng.choice([1000, 2000, 2000, 2500, 4000]))
    fmax = float(min(rng.choice([60, 80, 100, 100, 120]), fs / 12))
    amp0 = film["l1"] * rng.uniform(0.0015, 0.006)
    nl = 2 if not full else int(rng.integers(2, 4))
    amps = amp0 * np.array([1.0, rng.uniform(1.6, 2.5), rng.uniform(2.6, 4)])[:nl]
    rep = int(rng.choice([1, 1, 2] if not full else [1, 2, 3]))
    tsw = float(rng.uniform(7, 14)) if rep > 1 or full else float(rng.uniform(10, 22))
    f1 = round(float(rng.uniform(0.5, 2.0)), 2)
    sweep = str(rng.choice(["log", "log", "linear"]))
    tail = float(min(max(3.2 * film["ti"].max(), 0.8), 5.0))
    rest = round(float(rng.uniform(0.4, 1.2)), 2)

    def chirp(a: float) -> dict:
        per = round(tsw + tail, 1)
        return {
            "protocol": "chirp",
            "loading": "mechanical",
            "amp": a,
            "f1": f1,
            "f2": fmax,
            "tsw": tsw,
            "rep": rep,
            "period": per,
            "rest": rest,
            "sweep": sweep,
            "dur": rest + per * rep,
            "fs": fs,
        }

    mech = [chirp(a) for a in amps]
    period = float(rng.choice([1.0, 2.0, 2.0, 4.0]))
    nper = int(max(4, round(rng.uniform(9, 18) / period)))
    lines = str(rng.choice(["odd", "odd", "random_odd", "full"]))
    nv = int(rng.integers(2, 4)) if not full else int(rng.integers(3, 6))
    levels = np.round(vmax * np.linspace(rng.uniform(0.45, 0.6), 1.0, nv), 2)
    kmax = int(fmax * period)
    ks = np.arange(1, kmax + 1)
    if lines != "full":
        ks = ks[ks % 2 == 1]
    if lines == "random_odd":
        keep = np.ones(len(ks), bool)
        for i in range(0, len(ks) - 3, 4):
            keep[i + rng.integers(4)] = False
        ks = ks[keep]
    elec = (
        []
        if mech_only
        else [
            {
                "protocol": "sphs",
                "loading": "electrical",
                "kv": float(v),
                "period": period,
                "nper": nper,
                "lines": lines,
                "ks": ks,
                "rest": rest,
                "dur": rest + period * nper,
                "fs": fs,
            }
            for v in levels
        ]
    )
    nst = 0 if mech_only else int(rng.choice([0, 1, 2] if not full else [2, 3]))
    sfs = float(rng.choice([250, 500, 1000]))
    on, off = round(float(rng.uniform(2, 5)), 1), round(float(rng.uniform(2, 6)), 1)
    for v in np.round(vmax * np.linspace(0.6, 1, nst), 2) if nst else []:
        elec.append(
            {
                "protocol": "step",
                "loading": "electrical",
                "kv": float(v),
                "on": on,
                "off": off,
                "cyc": 3,
                "rest": 1.5,
                "dur": 1.5 + 3 * (on + off),
                "fs": sfs,
            }
        )
    stra = (
        np.array([0.1, 0.2, 0.3, 0.4, 0.5]) if film["kind"] == "stack" else np.linspace(0.01, rng.uniform(0.04, 0.1), 5)
    )
    stra = np.round(stra, 3)
    if not full and not quasi:
        stra = stra[:: int(rng.choice([2, 4]))]
    freqs = np.round(np.exp(rng.uniform(np.log(0.2), np.log(5), 1 if not quasi else 2)), 2)
    ncy = int(rng.integers(5, 11))
    cyc = []
    if quasi or full or rng.random() < 0.6:
        for f in freqs:
            for s in stra:
                cyc.append(
                    {
                        "protocol": "cyclic",
                        "loading": "mechanical",
                        "pp": float(s),
                        "f": float(f),
                        "ncy": ncy,
                        "rest": 1.0,
                        "dur": 1.0 + ncy / f,
                        "fs": float(max(100, min(500, 2 ** np.ceil(np.log2(f * 100))))),
                    }
                )
    relax = []
    if full or rng.random() < 0.4:
        relax = [
            {
                "protocol": "step",
                "loading": "mechanical",
                "pp": float(stra[len(stra) // 2]),
                "rest": 2.0,
                "ramp": 0.1,
                "dur": float(rng.uniform(20, 50)),
                "fs": 200.0,
            }
        ]
    if quasi:
        mech = [chirp(amps[0])]
        mech[0]["f2"] = min(fmax, 20.0)
    if quasi and not mech_only:
        elec = elec[:3]
    blocks = [mech, elec, cyc, relax]
    if rng.random() < 0.5:
        blocks = [mech, cyc, elec, relax]
    lst = [r for b in blocks for r in b]
    if (full or rng.random() < 0.6) and not (quasi and rng.random() < 0.5):
        lst.append(dict(mech[0]))
    while len(lst) < 8:
        lst.append(dict(lst[int(rng.integers(len(lst)))]))
    lst = lst[:28] if full else lst[:14]
    cal = []
    if rng.random() < 0.3:
        cal.append({"protocol": "tap", "loading": "calibration", "dur": 8.0, "fs": fs, "rest": 1.0})
    if rng.random() < 0.3:
        cal.append({"protocol": "weight", "loading": "calibration", "dur": 18.0, "fs": 200.0, "rest": 3.0})
    lst = cal + lst
    out = []
    t = 0.0
    for _i, r in enumerate(lst):
        dyn = r["protocol"] in ("chirp", "sphs", "tap")
        over = int(np.ceil((8000 if dyn else 2000) / r["fs"])) if dyn else int(np.ceil(1500 / r["fs"]))
        n = int(np.ceil(r["dur"] * r["fs"] / 4 + 1)) * 4
        rec = Rec("", r["protocol"], r["loading"], r, n / r["fs"], r["fs"], over, t)
        out.append(rec)
        t += rec.duration + float(rng.uniform(40, 400))
    noise = draw_noise(rng)
    style = {
        "compression": str(rng.choice(["zstd", "lz4", "none"])),
        "block": int(rng.choice([500, 1000, 1000, 2000])),
        "xdec": int(rng.choice([1, 1, 1, 2])),
        "vdec": int(rng.choice([1, 1, 2])),
        "command": bool(rng.random() < 0.5),
        "temperature": bool(rng.random() < 0.3),
        "leak": bool(rng.random() < 0.2),
        "temp0": rng.uniform(19, 25),
        "start": int(1.7e9 + rng.integers(0, 6e7)),
        "prefix": str(rng.choice(["run", "m", "rec", "t", "meas"])),
        "num0": int(rng.integers(1, 400)),
        "spec": f"{rng.choice(['dea', 'film', 'p', 'q'])}{rng.integers(100, 999)}",
        "rigid": f"bench{rng.integers(1, 9)}",
        "state_tau": bool(rng.random() < 0.5),
    }
    for i, rec in enumerate(out):
        rec.rid = f"{style['spec']}_{style['prefix']}{style['num0'] + i:04d}"
    label = ("full" if full else "compact") + ("_mechanical" if mech_only else "") + ("_quasistatic" if quasi else "")
    return Session(seed, film, rig, stated, out, meta, noise, style, label)


def draw_noise(rng: np.random.Generator) -> dict:
    """Kind and size of the noise (relative sizes; the scale is set with the signals)."""
    stat = "off" if rng.random() < 0.66 else "absent"
    kind = str(rng.choice(["white", "pink", "bursts", "slow", "doubled"], p=[0.64, 0.12, 0.08, 0.08, 0.08]))
    return {
        "kind": kind,
        "rel": float(np.exp(rng.uniform(np.log(0.003), np.log(0.02)))),
        "stated": stat,
        "factor": float(rng.uniform(0.7, 1.3)),
        "prel": float(np.exp(rng.uniform(np.log(0.0003), np.log(0.0015)))),
        "xrel": float(rng.uniform(0.00003, 0.0002)),
        "vrel": float(rng.uniform(0.0002, 0.001)),
        "bits": int(rng.choice([16, 16, 18, 24])),
        "seed": int(rng.integers(2**31)),
    }


def sine_sweep(t: np.ndarray, p: dict) -> np.ndarray:
    """Sweep with soft ends, zero outside."""
    ts, f1, f2 = p["tsw"], p["f1"], p["f2"]
    s = np.clip(t, 0, ts)
    if p["sweep"] == "log":
        r = np.log(f2 / f1)
        ph = 2 * np.pi * f1 * ts / r * (np.exp(s / ts * r) - 1)
    else:
        ph = 2 * np.pi * (f1 * s + 0.5 * (f2 - f1) / ts * s * s)
    w1, w2 = min(0.5 / f1, 0.1 * ts), min(0.25, 0.03 * ts)
    taper = np.where(s < w1, 0.5 - 0.5 * np.cos(np.pi * s / w1), 1.0)
    taper = taper * np.where(s > ts - w2, 0.5 - 0.5 * np.cos(np.pi * (ts - s) / w2), 1.0)
    return np.where((t > 0) & (t < ts), np.sin(ph) * taper, 0.0)


def inputs(rec: Rec, sess: Session, over: int):
    """Displacement, amplifier command (V) and film voltage (kV) on the half-step grid of rate 2 fs over."""
    if over in rec.cache:
        return rec.cache[over]
    p = rec.p
    dt = 1 / (rec.fs * over * 2)
    n = round(rec.duration * rec.fs) * over
    t = np.arange(2 * n + 1) * dt
    x = np.zeros_like(t)
    v = np.zeros_like(t)
    u = t - p["rest"]
    l1 = sess.film["l1"]
    if rec.protocol == "chirp":
        for r in range(p["rep"]):
            x += p["amp"] * sine_sweep(u - r * p["period"], p)
    elif rec.protocol == "cyclic":
        s = np.clip(u, 0, p["ncy"] / p["f"])
        x = 0.5 * p["pp"] * l1 * (1 - np.cos(2 * np.pi * p["f"] * s))
    elif rec.protocol == "step" and rec.loading == "mechanical":
        x = p["pp"] * l1 * 0.5 * (1 - np.cos(np.pi * np.clip(u / p["ramp"], 0, 1)))
    elif rec.protocol == "step":
        ph = np.mod(u, p["on"] + p["off"])
        v = np.where((u > 0) & (ph < p["on"]) & (u < p["cyc"] * (p["on"] + p["off"])), p["kv"], 0.0)
    elif rec.protocol == "sphs":
        ks = p["ks"]
        m = round(p["period"] / dt)
        j = np.arange(len(ks)) + 1
        sp = np.zeros(m // 2 + 1, complex)
        sp[ks] = np.exp(-1j * np.pi * j * (j - 1) / len(ks))
        w = np.fft.irfft(sp, m)
        w = 2 * (w - w.min()) / (w.max() - w.min()) - 1
        one = p["kv"] * np.sqrt((1 + w) / 2)
        idx = np.round(u / dt).astype(int)
        v = np.where((idx >= 0) & (idx < p["nper"] * m), one[np.mod(idx, m)], 0.0)
    g = sess.rig["amp_gain_true"]
    cmd = v / sess.rig["amp_gain"]
    if rec.loading == "electrical":
        a = np.exp(-dt / sess.rig["amp_tau"])
        q = sess.rig["amp_tau"] * (1 - a) / dt
        v = lfilter([1 - q, q - a], [1, -a], cmd * g)
    rec.cache[over] = (t, x, cmd, v)
    return rec.cache[over]
