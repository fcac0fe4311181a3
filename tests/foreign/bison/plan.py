"""The laboratory: specimen, rig and the recordings of a session, with their waveforms."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

EPS0 = 8.8541878e-6  # N/kV²


@dataclass
class Rec:
    """One recording: protocol, waveform parameters and times."""

    protocol: str
    loading: str
    duration: float
    rate: float
    p: dict = field(default_factory=dict)
    t0: float = 0.0  # seconds since the session began
    index: int = 0
    rate_x: float = 0.0  # rate of the second channel; 0 means the same
    name: str = ""


@dataclass
class World:
    """Everything that is true of the specimen and the rig, without the hidden effect."""

    k0: float
    ks: np.ndarray
    taus: np.ndarray
    mass: float
    kl: float
    cl: float
    gain: float  # N/kV², the plain actuation as the load cell circuit sees it
    tau_amp: float
    amp_gain: float
    v_max: float
    a_max: float
    f_peak: float
    k_peak: float
    preload: float
    length: float
    meta: dict
    rig: dict
    recs: list[Rec]
    noise: dict
    temperature: float
    label: str
    x_noise: float = 0.0
    v_noise: float = 0.0
    files: dict = field(default_factory=dict)


def log_uniform(r: np.random.Generator, a: float, b: float) -> float:
    """A number whose logarithm is uniform."""
    return float(np.exp(r.uniform(np.log(a), np.log(b))))


def film_k(w: World, s: np.ndarray | complex) -> np.ndarray:
    """Dynamic stiffness at the Laplace variable s."""
    k = w.k0 + 0 * s
    for ki, ti in zip(w.ks, w.taus, strict=True):
        k = k + ki * s * ti / (1 + s * ti)
    return k


def schroeder(t: np.ndarray, f0: float, lines: np.ndarray) -> np.ndarray:
    """Harmonics with Schroeder phases, scaled to ±1."""
    n = len(lines)
    ph = -np.pi * np.arange(n) * (np.arange(n) + 1) / n
    # sum by table: the signal is periodic
    big = 1 << 16
    spec = np.zeros(big // 2 + 1, complex)
    for m, a in zip(lines, ph, strict=True):
        spec[m] = np.exp(1j * a) * big / 2
    tab = np.fft.irfft(spec, big)
    pos = (t * f0 % 1.0) * big
    i = pos.astype(np.int64)
    fr = pos - i
    u = tab[i % big] * (1 - fr) + tab[(i + 1) % big] * fr
    return u / max(np.max(np.abs(tab)), 1e-12)


def motion(rec: Rec, t: np.ndarray) -> np.ndarray:
    """Displacement of the driven end (mm)."""
    p = rec.p
    if rec.protocol == "chirp" and rec.loading == "mechanical":
        x = np.zeros_like(t)
        for j in range(p["repeats"]):
            s = t - p["lead"] - j * p["period"]
            m = (s >= 0) & (s <= p["sweep_s"])
            x[m] = p["amp"] * sweep(s[m], p)
        return x
    if rec.protocol == "cyclic":
        s = t - p["lead"]
        m = (s >= 0) & (s <= p["cycles"] / p["f"])
        x = np.zeros_like(t)
        x[m] = p["amp"] * (1 - np.cos(2 * np.pi * p["f"] * s[m]))
        return x
    if rec.protocol == "step" and rec.loading == "mechanical":
        s = np.clip((t - p["lead"]) / p["ramp"], 0, 1)
        return p["amp"] * (s - np.sin(2 * np.pi * s) / (2 * np.pi))
    return np.zeros_like(t)


def sweep(s: np.ndarray, p: dict) -> np.ndarray:
    """A tapered sweep of unit amplitude."""
    f1, f2, d = p["f1"], p["f2"], p["sweep_s"]
    if p["kind"] == "log":
        c = np.log(f2 / f1)
        ph = 2 * np.pi * f1 * d / c * (np.exp(s / d * c) - 1)
    else:
        ph = 2 * np.pi * (f1 * s + 0.5 * (f2 - f1) / d * s * s)
    ramp = np.minimum(1.0, np.minimum(s, d - s) / (p["taper"] * d))
    return np.sin(ph) * (0.5 - 0.5 * np.cos(np.pi * np.clip(ramp, 0, 1)))


def wanted_voltage(rec: Rec, t: np.ndarray) -> np.ndarray:
    """Voltage asked of the amplifier (kV)."""
    p = rec.p
    if rec.protocol == "sphs":
        u = schroeder(t, 1 / p["period"], p["lines"])
        v = p["kv"] * np.sqrt(np.maximum(0.5 + 0.48 * u, 0)) if p["root"] else p["kv"] * (0.55 + 0.45 * u)
        return np.where(t < p["lead"], 0.0, v)
    if rec.protocol == "chirp" and rec.loading == "electrical":
        s = t - p["lead"]
        u = np.zeros_like(t)
        m = (s >= 0) & (s <= p["sweep_s"])
        u[m] = sweep(s[m], p)
        rise = np.clip((t - 0.3 * p["lead"]) / (0.2 * p["lead"]), 0, 1)
        return p["kv"] * np.sqrt(np.maximum(0.5 + 0.48 * u, 0)) * rise
    if rec.protocol == "step" and rec.loading == "electrical":
        s = t - p["lead"]
        n = np.floor(s / (p["on"] + p["off"])).astype(int)
        on = (s >= 0) & (s - n * (p["on"] + p["off"]) < p["on"]) & (n < p["n"])
        lev = np.asarray(p["levels"])[np.clip(n, 0, len(p["levels"]) - 1)]
        return np.where(on, lev, 0.0)
    return np.zeros_like(t)


def draw_world(r: np.random.Generator) -> World:
    """Draw specimen, rig and session."""
    family = r.choice(["acrylic", "acrylic", "stiff", "silicone", "stack"])
    order = int(r.integers(1, 4))
    lam = float(r.choice([1.2, 1.3, 1.4, 1.5, 2.0]))
    if family == "silicone":
        k0 = r.uniform(0.15, 0.6)
        rel = [r.uniform(0.2, 0.8), r.uniform(0.2, 0.6), r.uniform(0.3, 1.0)]
        t1 = log_uniform(r, 0.004, 0.2)
        eps = r.uniform(2.6, 3.2)
    elif family == "stack":
        k0 = r.uniform(0.3, 0.6)
        rel = [r.uniform(0.6, 1.5), r.uniform(1.0, 3.0), r.uniform(2.0, 6.0)]
        t1 = log_uniform(r, 0.3, 3.0)
        eps = r.uniform(4.2, 4.9)
    else:
        k0 = r.uniform(0.6, 1.4) * (1.6 if family == "stiff" else 1.0)
        rel = [r.uniform(0.6, 2.5), r.uniform(1.0, 3.0), r.uniform(1.5, 5.0)]
        t1 = log_uniform(r, 0.02, 0.5)
        eps = r.uniform(4.2, 4.9)
    taus, t = [], t1
    for _ in range(order):
        taus.append(t)
        t /= r.uniform(5, 15)
    taus = [x for x in taus if x > 4e-4]
    ks = k0 * np.array(rel[: len(taus)])
    taus = np.array(taus)
    total = float(r.choice([40.0, 50.0, 60.0, 70.0, 75.0, 80.0]))
    kl_nom = log_uniform(r, 5, 40)
    fc = r.uniform(20, 150)
    m_nom = kl_nom / (2 * np.pi * fc) ** 2
    if m_nom > 4e-4:
        kl_nom *= 4e-4 / m_nom
        m_nom = 4e-4
    kl_nom = max(kl_nom, 2.0)
    m_nom = kl_nom / (2 * np.pi * fc) ** 2
    zeta = log_uniform(r, 0.003, 0.03)
    cl_nom = 2 * zeta * np.sqrt(kl_nom * m_nom)
    sd_m, sd_k, sd_c = r.uniform(0.003, 0.02), r.uniform(0.003, 0.02), r.uniform(0.05, 0.25)
    mass = m_nom * (1 + sd_m * np.clip(r.normal(), -2, 2))
    kl = kl_nom * (1 + sd_k * np.clip(r.normal(), -2, 2))
    cl = cl_nom * (1 + sd_c * np.clip(r.normal(), -2, 2))
    # electrode
    thick = float(r.choice([0.5, 0.6, 1.0, 1.0, 1.0]))
    width = float(r.choice([30.0, 40.0, 50.0, 60.0]))
    drawn = str(r.choice(["stretched", "undeformed"]))
    full = r.random() < 0.45
    lam2 = 1 / np.sqrt(lam)
    l_a = total if full else float(np.round(total * r.uniform(0.4, 0.85), 1))
    w_a = float(np.round(width * lam2 * r.uniform(0.6, 0.95), 1))
    z = thick * lam2
    eps_sd = r.uniform(0.03, 0.1)
    eps_true = eps * (1 + eps_sd * np.clip(r.normal(), -2, 2))
    share = l_a / total
    gain = EPS0 * eps_true * w_a / z * share
    v_max = float(np.round(r.uniform(4.5, 8.5) * (thick / 1.0) ** 0.6, 1))
    preload = k0 * total * (1 - 1 / lam) * r.uniform(0.3, 0.6)
    # the actuation must not make the film slack
    preload = max(preload, 1.8 * gain * v_max**2)
    w = World(
        k0=float(k0), ks=ks, taus=taus, mass=float(mass), kl=float(kl), cl=float(cl), gain=float(gain),
        tau_amp=float(r.uniform(0.2e-3, 1.5e-3)), amp_gain=1.5 * (1 + 0.003 * np.clip(r.normal(), -2, 2)),
        v_max=v_max, a_max=0.0, f_peak=0.0, k_peak=0.0, preload=float(preload), length=total, meta={}, rig={}, recs=[],
        noise={}, temperature=float(r.uniform(19, 25)), label="",
    )  # fmt: skip
    f2 = float(r.choice([60.0, 80.0, 100.0, 100.0, 120.0]))
    w.k_peak = float(abs(film_k(w, 2j * np.pi * f2)))
    # the largest film tension over the sweep, with the clamp's resonance
    sj = 2j * np.pi * np.linspace(0.5, f2, 600)
    k = film_k(w, sj)
    den = kl + mass * sj**2 + cl * sj
    w.k_peak = float(np.max(np.abs(k * den / (k + den))))
    k_cell = float(np.max(np.abs(k * kl / (k + den))))
    a_top = min(0.05 * total, 0.65 * preload / w.k_peak, 0.8 * preload / k_cell)
    draw_session(r, w, f2, a_top)
    # peak force of the session, for the range of the cell
    w.meta = {
        "film_length_mm": f"{total / lam:.3f}", "film_width_mm": f"{width:g}", "film_thickness_mm": f"{thick:g}",
        "stretch_1": f"{lam:g}", "layers": "1", "active_length_mm": f"{l_a if drawn == 'stretched' else l_a / lam:.4g}",
        "active_width_mm": f"{w_a if drawn == 'stretched' else w_a / lam2:.4g}", "active_drawn": drawn,
        "total_length_mm": f"{total:g}", "relative_permittivity": f"{eps:.3g}", "relative_permittivity_sd": f"{eps * eps_sd:.2g}",
        "material": {"silicone": "PDMS", "stack": "acrylic stack"}.get(family, "acrylic"),
    }  # fmt: skip
    if full and r.random() < 0.5:
        del w.meta["total_length_mm"]
    w.rig = {
        "rig_id": f"vc-{r.integers(1, 9)}", "clamp_mass_kg": f"{m_nom * 1e3:.5g}", "clamp_mass_kg_sd": f"{m_nom * 1e3 * sd_m:.2g}",
        "load_cell_stiffness_n_per_mm": f"{kl_nom:.5g}", "load_cell_stiffness_n_per_mm_sd": f"{kl_nom * sd_k:.2g}",
        "load_cell_damping_n_s_per_mm": f"{cl_nom:.4g}", "load_cell_damping_n_s_per_mm_sd": f"{cl_nom * sd_c:.2g}",
    }  # fmt: skip
    w.files = {"sd_m": sd_m, "sd_k": sd_k, "sd_c": sd_c, "m_nom": m_nom, "kl_nom": kl_nom}
    if r.random() < 0.7:
        w.rig["amplifier_gain_kv_per_v"] = "1.5"
        w.rig["amplifier_gain_kv_per_v_sd"] = "0.005"
    return w


def chirp(r: np.random.Generator, w: World, amp: float, f2: float, base: dict) -> Rec:
    """A sweep of the shaker."""
    p = dict(base, amp=amp, f2=f2)
    slow = max(w.taus) if len(w.taus) else 0.1
    p["period"] = p["sweep_s"] + float(np.round(min(max(3 * slow, 0.5), 6.0), 1))
    return Rec("chirp", "mechanical", p["lead"] + p["repeats"] * p["period"], p["rate"], p)


def draw_session(r: np.random.Generator, w: World, f2: float, a_top: float) -> None:
    """Compose the recordings in their order."""
    kind = str(r.choice(["full", "compact", "compact", "mechanical", "electrical_compact"]))
    w.label = kind
    rate = float(r.choice([1000, 1000, 2000, 2000, 4000]))
    sweep_s = float(r.choice([10, 15, 20, 30])) if rate < 4000 else float(r.choice([8, 10, 12]))
    base = {
        "f1": float(r.choice([0.5, 1.0, 1.0, 2.0])), "sweep_s": sweep_s, "taper": 0.03, "repeats": int(r.choice([1, 2, 2, 3])),
        "kind": str(r.choice(["log", "log", "linear"])), "lead": float(np.round(r.uniform(0.5, 2), 1)), "rate": rate,
    }  # fmt: skip
    while base["repeats"] > 1 and base["repeats"] * sweep_s > 45:
        base["repeats"] -= 1
    n_amp = 3 if kind == "full" else int(r.choice([2, 3]))
    a_top *= r.uniform(0.6, 1.0)
    amps = a_top * np.array([0.25, 0.5, 1.0] if n_amp == 3 else [0.35, 1.0])
    amps = [float(np.round(a, 3)) for a in amps]
    seq: list[Rec] = [chirp(r, w, a, f2, base) for a in amps]
    # electrical
    e_rate = float(r.choice([1000, 1000, 2000]))
    f0 = float(r.choice([0.5, 1.0, 1.0]))
    top = round(f2 / f0)
    lk = str(r.choice(["odd", "odd", "full", "random_odd"]))
    lines = np.arange(1, top + 1) if lk == "full" else np.arange(1, top + 1, 2)
    if lk == "random_odd":
        groups = [lines[g : g + 4] for g in range(0, len(lines), 4)]
        lines = np.concatenate([np.delete(g, r.integers(0, 4)) if len(g) == 4 else g for g in groups])
    nper = int(r.integers(8, 21))
    if f0 < 1:
        nper = max(6, nper // 2 + 2)
    root = bool(r.random() < 0.6)
    n_v = int(r.integers(4, 6)) if kind == "full" else int(r.integers(2, 4))
    volts = [float(np.round(v, 2)) for v in np.linspace(0.4, 1.0, n_v) * w.v_max]
    lead_e = float(r.choice([0.0, 0.5, 1.0]))
    elec: list[Rec] = []
    for v in volts:
        elec.append(Rec("sphs", "electrical", lead_e + nper / f0, e_rate,
                        {"kv": v, "period": 1 / f0, "lines": lines, "kind": lk, "root": root, "lead": lead_e, "n": nper,
                         "f0": f0, "f2": f2}))  # fmt: skip
    if r.random() < 0.2:
        elec.append(Rec("chirp", "electrical", base["lead"] * 2 + sweep_s, e_rate,
                        {"kv": w.v_max, "lead": base["lead"] * 2, "sweep_s": sweep_s * 0.95, "f1": base["f1"], "f2": f2,
                         "kind": base["kind"], "taper": 0.03, "repeats": 1, "period": sweep_s}))  # fmt: skip
    on, off = float(r.choice([2, 5, 5, 10])), float(r.choice([3, 5, 8]))
    s_rate = float(r.choice([200, 500, 500, 1000]))
    if r.random() < 0.5:
        levels = [float(np.round(v, 2)) for v in np.linspace(0.4, 1, 4) * w.v_max]
        elec.append(Rec("step", "electrical", 2 + 4 * (on + off), s_rate,
                        {"on": on, "off": off, "n": 4, "levels": levels, "lead": 2.0}))  # fmt: skip
    else:
        for v in r.choice(volts, 2, replace=False) if kind == "full" else [volts[-1]]:
            n = int(r.integers(3, 6))
            elec.append(Rec("step", "electrical", 2 + n * (on + off), s_rate,
                            {"on": on, "off": off, "n": n, "levels": [float(v)] * n, "lead": 2.0}))  # fmt: skip
    # cyclic
    n_c = 5 if kind == "full" else int(r.integers(2, 4))
    freqs = list(r.choice([0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0], int(r.integers(1, 3)), replace=False))
    cyc: list[Rec] = []
    for f in sorted(float(x) for x in freqs):
        kf = abs(film_k(w, 2j * np.pi * f))
        kv = film_k(w, 2j * np.pi * f) - w.k0
        top_pp = min(0.5 * w.length, 1.5 * w.preload / kf, 1.4 * w.preload / max(abs(kv), 1e-6))
        pps = [float(np.round(x, 3)) for x in np.linspace(0.2, 1.0, n_c) * top_pp / w.length]
        if r.random() < 0.25:
            pps = list(r.permutation(pps))
        n = int(np.clip(round(r.uniform(5, 12)), 4, max(4, 80 * f)))
        c_rate = float(min(1000, max(50, 10 * round(r.uniform(80, 200) * f / 10))))
        for pp in pps:
            pp = max(pp, 0.002)
            f_true = f * (1 + 0.001 * r.normal())
            cyc.append(Rec("cyclic", "mechanical", 1 + n / f + 1, c_rate,
                           {"amp": pp * w.length / 2, "f": f_true, "f_nom": f, "cycles": n, "pp": pp, "lead": 1.0}))  # fmt: skip
    amp_r = min(0.5 * w.preload / w.k0, 1.2 * w.preload / (w.k0 + sum(w.ks)))
    relax = Rec("step", "mechanical", float(r.choice([40, 60, 100])), float(r.choice([50, 100, 200])),
                {"amp": float(np.round(amp_r * r.uniform(0.5, 1.0), 3)), "ramp": float(r.choice([0.2, 0.5, 1.0])),
                 "lead": 2.0})  # fmt: skip
    if kind == "full":
        seq += elec + cyc[:10] + [relax]
    elif kind == "compact":
        seq += elec
        seq += cyc[: int(r.integers(2, 4))]
        if r.random() < 0.4:
            seq.append(relax)
    elif kind == "mechanical":
        seq += [*cyc, relax]
    else:
        seq = seq[-1:] + elec + elec[: max(0, 7 - len(elec))]
        if r.random() < 0.5:
            seq.append(relax)
    if kind != "electrical_compact" or r.random() < 0.7:
        seq.append(chirp(r, w, amps[0] if kind != "electrical_compact" else amps[-1], f2, base))
    while len(seq) < 8:
        seq.insert(-1, chirp(r, w, float(r.choice(amps)), f2, base))
    if r.random() < 0.3:
        d = float(r.uniform(1, 2.5))
        seq.insert(0, Rec("tap", "calibration", d + 1, max(rate, 2000.0), {"amp": 0.3 * w.preload, "lead": 0.5}))
    if r.random() < 0.35:
        top_m = w.preload / 9.80665
        ms = [0.0] + [float(np.round(top_m * x, 4)) for x in (0.25, 0.5, 1.0)]
        seq.insert(0, Rec("weight", "calibration", 4.0 * len(ms), 200.0, {"masses": ms, "each": 4.0}))
    t = 0.0
    out = []
    for i, rec in enumerate(seq):
        rec = Rec(rec.protocol, rec.loading, rec.duration, rec.rate, rec.p)
        rec.index = i
        rec.t0 = t
        t += rec.duration + float(r.uniform(120, 900))
        out.append(rec)
    w.recs = out
    mech = [x for x in out if x.loading == "mechanical"]
    w.a_max = max([x.p["amp"] for x in mech] or [a_top])
    w.f_peak = max([x.p["amp"] * w.k_peak for x in mech if x.protocol == "chirp"] or [0.3 * w.preload])
