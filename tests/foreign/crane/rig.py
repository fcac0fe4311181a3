"""Truth rig crane: simulate sessions of a small laboratory and write them as MCAP."""

from __future__ import annotations

import copy
import datetime as dt
import json
import sys
from pathlib import Path

import numpy as np

from . import effects as fx
from . import sim
from .faults import FAULTS, apply_fault, choose_fault
from .record import write_mcap
from .session import Session, draw_session, inputs

KINDS = ("clean", "single", "unlisted", "pair", "fault")
DEC = 4


def plain_cfg(sess: Session) -> fx.Cfg:
    """Configuration of the plain model with the true rig."""
    return fx.Cfg(mass=sess.rig["mass"], kl=sess.rig["kl"], cl=sess.rig["cl"])


def simulate(
    sess: Session, cfg: fx.Cfg, t0: float, rate: float, film: dict | None = None, only: set | None = None
) -> list:
    """Noise-free channels of every recording at its own rate (fs); internal rate at least `rate`."""
    f = film or sess.film
    a, b, c, dx, df = sim.linear_model(f["k0"], f["ki"], f["ti"], cfg.mass, cfg.kl, cfg.cl, cfg.strip)
    base = cfg.t0 if cfg.t0 is not None else t0
    st_mech = np.zeros(sim.NSTATE)
    st: dict = {}
    steps: dict = {}
    out = []
    for rec in sess.recs:
        if only is not None and rec.rid not in only:
            out.append(None)
            continue
        quick = rec.protocol in ("chirp", "sphs", "tap")
        over = max(1, int(np.ceil((rate if quick else min(rate, 2000)) / rec.fs)))
        if rec.loading == "calibration":
            out.append(calibration(sess, cfg, rec, st, over))
            continue
        t, x, cmd, v = inputs(rec, sess, over)
        h2 = t[1]
        h = 2 * h2
        if h not in steps:
            steps[h] = sim.discretise(a, b, h)
        em, bp, bq, br = steps[h]
        xt = x
        for m in cfg.move:
            xt = m(xt, t, h2, rec)
        xm = x
        for m in cfg.xsens:
            xm = m(xm, t, rec)
        vf = v
        if rec.loading == "electrical":
            for m in cfg.drive:
                vf = m(vf, h2, st, rec)
        fa = f["ka"] * vf * vf / (1.0 if cfg.strip is None else cfg.strip["share"])  # the strip model takes its share
        if rec.loading == "electrical":
            for m in cfg.act:
                fa = m(fa, vf, h2, st, rec)
        tf = t[::2]
        gt = np.ones(len(tf))
        for m in cfg.soft:
            gt = gt * m(tf, h, st, rec, x[::2])
        st_mech[[0, 1, 2, 5, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 19]] = 0.0
        y = (
            sim.run(
                em,
                bp,
                bq,
                br,
                c,
                dx,
                df,
                cfg.kl,
                xt,
                fa,
                gt,
                h,
                cfg.fcode,
                cfg.fp,
                cfg.ft,
                cfg.ak,
                cfg.at,
                cfg.amode,
                cfg.ccode,
                cfg.cp,
                cfg.rcode,
                cfg.rp,
                cfg.rt,
                base,
                st_mech,
            )
            + base
        )
        rec.x_out, rec.v_out = x[::2], v[::2]
        for m in cfg.sens:
            y = m(y, tf, rec, st)
        for m in cfg.drift:
            y = m(y, tf, rec, st, base)
        s = slice(None, None, over)
        tu = st.pop("tu", None)
        out.append(
            {
                "force": y[s],
                "x": xm[::2][s],
                "v": v[::2][s],
                "cmd": cmd[::2][s],
                "t": tf[s],
                "tu": None if tu is None else tu[s],
                "cur": None if cfg.current is None else cfg.current(v[::2][s], h * over),
            }
        )
    return out


def calibration(sess: Session, cfg: fx.Cfg, rec, st: dict, over: int) -> dict:
    """Tap (clamp alone rings) and weights."""
    n = round(rec.duration * rec.fs) * over
    t = np.arange(n + 1) / (rec.fs * over)
    u = t - rec.p["rest"]
    size = sess.meta["_peak"]
    if rec.protocol == "tap":
        w = np.sqrt(cfg.kl / cfg.mass)
        z = cfg.cl / (2 * np.sqrt(cfg.kl * cfg.mass))
        y = np.where(u > 0, 0.5 * size * np.exp(-z * w * np.maximum(u, 0)) * np.sin(w * np.sqrt(1 - z * z) * u), 0.0)
    else:
        y = np.zeros_like(t)
        for k, m in enumerate(sess.meta["_masses"]):
            a = (u - 3 * k) / 0.2
            nxt = sess.meta["_masses"][k - 1] if k else 0.0
            y += (m - nxt) * 9.81 * np.clip(a, 0, 1)
    rec.x_out, rec.v_out = 0 * t, 0 * t
    for m in cfg.sens:
        y = m(y, t, rec, st)
    s = slice(None, None, over)
    return {"force": y[s], "x": 0 * t[s], "v": 0 * t[s], "cmd": 0 * t[s], "t": t[s], "tu": None, "cur": None}


def prepare(sess: Session, rng: np.random.Generator) -> tuple[dict, float, list]:
    """Reference sizes of the clean session, pre-load and clean traces."""
    f = sess.film
    sess.meta["_peak"] = 1.0
    sess.meta["_masses"] = [0.01]
    clean = simulate(sess, plain_cfg(sess), 0.0, 3000)
    mech = [(r, o) for r, o in zip(sess.recs, clean, strict=True) if r.loading == "mechanical"]
    el = [(r, o) for r, o in zip(sess.recs, clean, strict=True) if r.loading == "electrical"]
    es = [o["x"] - o["force"] / sess.rig["kl"] for _, o in mech]
    dyn = [np.max(np.abs(o["force"])) for r, o in mech if r.protocol == "chirp"]
    load = -min(o["force"].min() for _, o in mech + el)
    peak = max(np.max(np.abs(o["force"])) for _, o in mech)
    natural = f["k0"] * f["l1"] * (f["lam"] - 1) / f["lam"] * rng.uniform(0.5, 0.9)
    t0 = max(natural, 1.4 * load)
    spans = sess.recs[-1].t0 + sess.recs[-1].duration
    span = max(spans, 60.0)
    ref = {
        "emax": max(np.max(np.abs(e)) for e in es),
        "amax": max(0.5 * (e.max() - e.min()) for e in es),
        "load": load,
        "peak": peak,
        "dyn": max(dyn),
        "vmax": f["vmax"],
        "span": span,
        "mean": t0,
        "power": max(np.mean(np.gradient(o["x"], o["t"][1]) ** 2) for _, o in mech),
        "fmax": max(o["force"].max() for _, o in mech) + t0,
        "exposure": sum(float(np.sum(o["v"] ** 2) * o["t"][1]) for _, o in el) + 1e-9,
    }
    sess.meta["_peak"] = max(dyn)
    m1 = max(t0 + peak, 0.02) / 9.81
    sess.meta["_masses"] = [float(f"{m1 * q:.2g}") for q in (0.2, 0.4, 0.7, 1.0)]
    fa = f["ka"] * f["vmax"] ** 2
    scale = min(dyn[0], 3 * fa) if el else dyn[0]
    nz = sess.noise
    nz["force"] = max(nz["rel"] * scale, nz["prel"] * peak, 5e-5)
    nz["x"] = nz["xrel"] * min(np.max(np.abs(o["x"])) for _, o in mech)
    nz["v"] = nz["vrel"] * f["vmax"]
    return ref, t0, clean


class Detector:
    """Detectability of a difference of traces after projecting out the plain model's parameters."""

    def __init__(self, sess: Session, t0: float) -> None:
        self.sess, self.t0 = sess, t0
        self.base = simulate(sess, plain_cfg(sess), t0, 3000)
        self.cols: np.ndarray | None = None

    def flat(self, out: list) -> np.ndarray:
        """Decimated force of all recordings, means removed, in units of the decimated noise."""
        s = self.sess.noise["force"]
        parts = []
        for o in out:
            y = o["force"][::DEC]
            parts.append((y - y.mean()) * (np.sqrt(DEC) / s))
        return np.concatenate(parts)

    def columns(self) -> None:
        """Derivatives by finite differences, with prior rows."""
        f, sess = self.sess.film, self.sess
        b0 = self.flat(self.base)
        st = sess.stated
        n = len(f["ki"])
        elec = any(r.loading == "electrical" for r in sess.recs)
        names = (
            ["k0"]
            + [f"k{i}" for i in range(n)]
            + [f"t{i}" for i in range(n)]
            + ["mass", "kl", "cl"]
            + (["ka"] if elec else [])
        )
        cols, prior = [], []
        for q in names:
            d = 0.005
            film = copy.deepcopy(f)
            cfg = plain_cfg(sess)
            p = 0.0
            if q in ("k0", "ka"):
                film[q] *= 1 + d
            elif q in ("mass", "kl", "cl"):
                setattr(cfg, q, getattr(cfg, q) * (1 + d))
                p = st[q] / st[q + "_sd"]
            else:
                arr = film["ki" if q[0] == "k" else "ti"] = film["ki" if q[0] == "k" else "ti"].copy()
                arr[int(q[1:])] *= 1 + d
            cols.append((self.flat(simulate(sess, cfg, self.t0, 2000, film)) - self.b2) / d)
            prior.append(p)
        self.cols = np.array(cols)
        gram = self.cols @ self.cols.T + np.diag(np.array(prior) ** 2)
        self.inv = np.linalg.pinv(gram, rcond=1e-14, hermitian=True)
        del b0

    def project(self, delta: np.ndarray) -> np.ndarray:
        """Remaining difference."""
        if self.cols is None:
            self.b2 = self.flat(simulate(self.sess, plain_cfg(self.sess), self.t0, 2000))
            self.columns()
        return delta - (self.inv @ (self.cols @ delta)) @ self.cols

    def delta(self, effs: list, ss: list[float], rate: float = 3000) -> np.ndarray:
        """Difference that effects make."""
        cfg = plain_cfg(self.sess)
        for e, s in zip(effs, ss, strict=True):
            e.apply(cfg, s)
        d = self.flat(simulate(self.sess, cfg, self.t0, rate)) - self.flat(self.base)
        if cfg.xsens:
            c2 = plain_cfg(self.sess)
            c2.move = [lambda x, t, h, rec: _chain(cfg.xsens, x, t, rec)]
            d = d - (self.flat(simulate(self.sess, c2, self.t0, rate)) - self.flat(self.base))
        return d

    def strength(self, effs: list, ss: list[float]) -> float:
        """Detectability d."""
        d = self.delta(effs, ss)
        if not np.all(np.isfinite(d)):
            return np.inf
        r = self.project(d)
        return float(np.sqrt(max(np.dot(d, r), 0.0)))


def _chain(hooks, x, t, rec):
    for m in hooks:
        x = m(x, t, rec)
    return x


def find_severity(det: Detector, eff: fx.Effect, target: float) -> tuple[float, float]:
    """Severity that gives the wanted strength, or the cap."""
    s, p = eff.start, 1.0
    last = None
    best = (eff.start, 0.0, 1e9)
    for _ in range(5):
        d = det.strength([eff], [s])
        if not np.isfinite(d):
            s *= 0.3
            continue
        miss = abs(np.log(max(d, 1e-9) / target))
        if miss < best[2]:
            best = (s, d, miss)
        if miss < 0.08 or (s >= eff.cap * 0.999 and d < target):
            break
        if last and abs(np.log(s / last[0])) > 1e-6 and d > 0 and last[1] > 0:
            p = float(np.clip(np.log(d / last[1]) / np.log(s / last[0]), 0.5, 3.0))
        last = (s, d)
        s = float(np.clip(s * (target / max(d, 1e-6)) ** (1 / p), s * 0.003, min(eff.cap, s * 30)))
    return best[0], best[1]


def form_distance(det: Detector, eff: fx.Effect, s: float, make) -> float:
    """Rough rms distance of the effect's trace to the textbook form's best fit, over the effect's rms."""
    if eff.textbook:
        return 0.0
    d = det.project(det.delta([eff], [s]))
    n = float(np.dot(d, d))
    if not n:
        return 0.0
    best = 0.5
    rows = []
    for k in range(4 if eff.name == "rig_constants" else 2):
        tb = make(k)
        q = det.project(det.delta([tb], [min(s, tb.cap)]))
        if np.all(np.isfinite(q)):
            rows.append(q)
    if rows:
        a = np.array(rows)
        co = np.linalg.lstsq(a @ a.T, a @ d, rcond=1e-10)[0]
        best = min(best, float(np.sqrt(max(np.dot(d - co @ a, d - co @ a), 0) / n)))
    return round(best, 3)


def build_truth(sess: Session, kind: str) -> dict:
    """Everything that is simulated, before noise: outputs, truth."""
    rng = np.random.default_rng([sess.seed, KINDS.index(kind), 55])
    ref, t0, _ = prepare(sess, rng)
    truth: dict = {
        "specimen_id": sess.style["spec"],
        "kind": kind,
        "listed": [],
        "fault": {"id": "", "recordings": [], "key": "", "right_value": ""},
        "unlisted": "",
        "stage": "",
        "depends_on": [],
        "severity": {},
        "form": "",
        "form_distance": 0.0,
        "strength": 0.0,
        "strength_alone": [],
    }
    effs, ss = [], []
    if kind in ("single", "unlisted", "pair"):
        det = Detector(sess, t0)
        if kind == "unlisted":
            pool = sorted(fx.UNLISTED)
            el = any(r.loading == "electrical" for r in sess.recs)
            if not el:
                pool = [q for q in pool if q not in ("voltage_crosstalk", "charge_trapping", "partial_discharge")]
            if not any(r.protocol == "chirp" for r in sess.recs):
                pool = [q for q in pool if q not in ("frame_resonance", "base_acceleration", "film_string_mode")]
        else:
            pool = sorted(fx.possible(sess))
        want = 2 if kind == "pair" else 1
        tries = 0
        while len(effs) < want and tries < 7:
            tries += 1
            ok = [q for q in pool if all(e.name != q for e in effs)]
            if want == 2:
                ok = [q for q in ok if all(e.stage != fx.STAGE[q] for e in effs)]
            name = str(rng.choice(ok))
            if kind == "unlisted":
                eff = fx.unlisted(name, sess, np.random.default_rng([sess.seed, 5, tries]), ref)
            else:
                erng = np.random.default_rng([sess.seed, 5, tries])
                eff = fx.listed(name, str(rng.choice(fx.FORMS[name])), sess, erng, ref)
                eff.params["_try"] = tries
            target = float(np.exp(rng.uniform(np.log(20), np.log(2000))))
            s, d = find_severity(det, eff, target)
            if (d < 10 or d > 2500) and tries < 7:
                pool = [q for q in pool if q != name]
                continue
            effs.append(eff)
            ss.append(s)
            truth["strength_alone"].append(round(d, 1))
        if kind == "unlisted":
            truth["unlisted"] = effs[0].name
        else:
            truth["listed"] = [e.name for e in effs]
            fds = []
            for e, s in zip(effs, ss, strict=True):

                def make(k: int, e=e) -> fx.Effect:
                    return fx.listed(
                        e.name,
                        fx.FORMS[e.name][0],
                        sess,
                        np.random.default_rng([sess.seed, 5, e.params["_try"] + 50 * k]),
                        ref,
                    )

                fds.append(form_distance(det, e, s, make))
            truth["form_distance"] = fds[0] if len(fds) == 1 else max(fds)
            truth["form_distances"] = fds
        truth["strength"] = truth["strength_alone"][0] if len(effs) == 1 else round(det.strength(effs, ss), 1)
        truth["stage"] = "+".join(e.stage for e in effs)
        truth["depends_on"] = sorted({q for e in effs for q in e.depends})
        by = {e.name: e.severity(s) for e, s in zip(effs, ss, strict=True)}
        truth["severity"] = {}
        for name, sev in by.items():
            for k, v in sev.items():  # the same key of two mechanisms is kept apart by the name
                truth["severity"][f"{name}.{k}" if k in truth["severity"] else k] = v
        truth["severity_by_mechanism"] = by
        truth["form"] = "+".join(e.form for e in effs)
        truth["parameters"] = [e.params | {"s": s, "mechanism": e.name} for e, s in zip(effs, ss, strict=True)]
    cfg = plain_cfg(sess)
    for e, s in zip(effs, ss, strict=True):
        e.apply(cfg, s)
    out = simulate(sess, cfg, t0, 8000)
    return {"truth": truth, "out": out, "t0": cfg.t0 if cfg.t0 is not None else t0, "ref": ref, "rng": rng, "cfg": cfg}


def pink(rng: np.random.Generator, n: int) -> np.ndarray:
    """1/f noise of unit standard deviation."""
    m = max(n, 4)
    sp = np.fft.rfft(rng.standard_normal(m))
    k = np.arange(len(sp))
    sp[1:] /= np.sqrt(k[1:])
    sp[0] = 0
    y = np.fft.irfft(sp, m)[:n]
    return y / max(y.std(), 1e-12)


def add_noise(y: np.ndarray, dts: float, sd: float, kind: str, double: bool, rng: np.random.Generator) -> np.ndarray:
    """Sensor noise of the session's kind."""
    n = len(y)
    e = rng.standard_normal(n)
    if kind == "pink":
        e = 0.8 * e + 0.6 * pink(rng, n)
    elif kind == "bursts":
        env = np.ones(n)
        for _ in range(max(1, int(n * dts / 8))):
            a = int(rng.uniform(0, n))
            env[a : a + int(rng.uniform(0.05, 0.6) / dts)] *= rng.uniform(2, 5)
        e = e * env
    elif kind == "slow":
        t = np.arange(n) * dts
        T = n * dts
        e = e + sum(rng.normal() * np.sin(np.pi * (k + 1) * t / T + rng.uniform(0, 6.28)) / (k + 1) for k in range(3))
    if kind == "doubled" and double:
        e = 2 * e
    return y + sd * e


def geometry(sess: Session) -> dict:
    """Specimen keys."""
    f = sess.film
    g = {
        "film_length_mm": f["length"],
        "film_width_mm": f["width"],
        "film_thickness_mm": f["thick"],
        "stretch_1": f["lam"],
        "total_length_mm": round(f["l1"], 3),
    }
    if f["layers"] > 1:
        g["layers"] = f["layers"]
    g.update({k: v for k, v in sess.meta.items() if not k.startswith("_")})
    return g


def metadata(sess: Session, rec) -> dict:
    """Metadata of one recording."""
    p = rec.p
    material = {
        "acrylic": "acrylic",
        "silicone": "silicone",
        "stack": "acrylic",
        "soft": "silicone",
        "stiff": "acrylic",
    }
    start = dt.datetime.fromtimestamp(sess.style["start"] + rec.t0, dt.UTC)
    m = {
        "recording_id": rec.rid,
        "protocol": rec.protocol,
        "loading": rec.loading,
        "specimen_id": sess.style["spec"],
        "started_at": start.isoformat(timespec="milliseconds"),
        "rig_id": sess.style["rigid"],
        "material": material[sess.film["kind"]],
        **geometry(sess),
    }
    if rec.protocol == "chirp":
        m |= {"frequency_start_hz": p["f1"], "frequency_stop_hz": p["f2"], "sweep": p["sweep"], "repeats": p["rep"]}
        if p["rep"] > 1:
            m["period_s"] = p["period"]
    elif rec.protocol == "sphs":
        m |= {
            "period_s": p["period"],
            "periods": p["nper"],
            "lines": p["lines"],
            "drive_kv": p["kv"],
            "frequency_start_hz": float(p["ks"][0] / p["period"]),
            "frequency_stop_hz": float(p["ks"][-1] / p["period"]),
        }
    elif rec.protocol == "cyclic":
        m |= {"frequency_hz": p["f"], "cycles": p["ncy"], "strain_pp": p["pp"]}
    elif rec.protocol == "step" and rec.loading == "electrical":
        m |= {"on_s": p["on"], "off_s": p["off"], "drive_kv": p["kv"], "controller": "open", "cycles": p["cyc"]}
    elif rec.protocol == "weight":
        m["masses_kg"] = ",".join(repr(q) for q in sess.meta["_masses"])
    return m


def rig_keys(sess: Session, fmax: float) -> dict:
    """Rig record."""
    s = sess.stated
    rng_std = [0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500]
    r = {
        "rig_id": sess.style["rigid"],
        "clamp_mass_kg": s["mass"] * 1e3,
        "clamp_mass_kg_sd": s["mass_sd"] * 1e3,
        "load_cell_stiffness_n_per_mm": s["kl"],
        "load_cell_stiffness_n_per_mm_sd": s["kl_sd"],
        "load_cell_damping_n_s_per_mm": s["cl"],
        "load_cell_damping_n_s_per_mm_sd": s["cl_sd"],
        "load_cell_range_n": next(q for q in rng_std if q > 1.1 * fmax),
    }
    if sess.style["state_tau"]:
        r |= {"amplifier_gain_kv_per_v": s["amp_gain"], "amplifier_gain_kv_per_v_sd": s["amp_gain_sd"]}
    n = sess.noise
    if n["stated"] == "off":
        r |= {"force_noise_sd": n["force"] * n["factor"], "displacement_noise_sd": n["x"] * n["factor"]}
        if any(q.loading == "electrical" for q in sess.recs):
            r["voltage_noise_sd"] = n["v"] * n["factor"]
    return {k: (float(f"{v:.6g}") if isinstance(v, float) else v) for k, v in r.items()}


def channels(sess: Session, rec, o: dict, rng: np.random.Generator, double: bool, frange: float) -> dict:
    """Channels with noise and converter steps."""
    n, st = sess.noise, sess.style
    d0 = 1 / rec.fs
    q = 2 * frange / 2 ** n["bits"]

    def conv(y, step):
        return np.round(y / step) * step

    ch = {
        "force": {
            "values": conv(add_noise(o["force"], d0, n["force"], n["kind"], double, rng), q),
            "dt": d0,
            "unit": "N",
            "resolution": q,
        }
    }
    if rec.loading == "mechanical":
        k = st["xdec"] if rec.fs >= 2000 else 1
        ch["displacement"] = {
            "values": add_noise(o["x"][::k], d0 * k, n["x"], "white", False, rng),
            "dt": d0 * k,
            "unit": "mm",
        }
    if rec.loading == "electrical":
        k = st["vdec"] if rec.fs >= 2000 else 1
        qv = 20 * sess.rig["amp_gain"] / 2**16
        ch["voltage"] = {
            "values": conv(add_noise(o["v"][::k], d0 * k, n["v"], "white", False, rng), qv),
            "dt": d0 * k,
            "unit": "kV",
            "resolution": qv,
        }
        if st["command"]:
            ch["command"] = {
                "values": conv(add_noise(o["cmd"], d0, 1e-4, "white", False, rng), 20 / 2**16),
                "dt": d0,
                "unit": "V",
            }
        if st["leak"]:
            cur = o["v"] * 0.05 + (o["cur"] if o["cur"] is not None else 0)
            ch["leakage_current"] = {"values": add_noise(cur, d0, 0.02, "white", False, rng), "dt": d0, "unit": "µA"}
    if st["temperature"] and rec.loading != "calibration":
        k = int(rec.fs // 2)
        tu = o["tu"] if o["tu"] is not None else np.zeros_like(o["t"])
        room = st["temp0"] + 0.2 * np.sin(2 * np.pi * (rec.t0 + o["t"]) / 5400)
        ch["temperature"] = {
            "values": np.round(add_noise((room + tu)[::k], 0.5, 0.03, "white", False, rng), 2),
            "dt": d0 * k,
            "unit": "degC",
            "resolution": 0.01,
        }
    return ch


def write_session(seed: int, kind: str, folder: Path) -> dict:
    """Write the session's recordings into folder and return the truth."""
    if kind not in KINDS:
        raise ValueError(f"kind must be one of {KINDS}")
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    sess = draw_session(seed, KINDS.index(kind))
    if kind == "clean" and (seed % 3 == 0) == (sess.noise["kind"] == "white"):
        # one third of the clean sessions has noise that is not white
        r = np.random.default_rng([seed, 31])
        sess.noise["kind"] = str(r.choice(["pink", "bursts", "slow", "doubled"])) if seed % 3 == 0 else "white"
    fault = choose_fault(sess, np.random.default_rng([seed, 77])) if kind == "fault" else None
    made = build_truth(sess, kind)
    truth, out, t0, rng = made["truth"], made["out"], made["t0"], made["rng"]
    fmax = made["ref"]["fmax"] + max(0.0, t0 - made["ref"]["mean"])
    rigk = rig_keys(sess, fmax)
    nrng = np.random.default_rng(sess.noise["seed"])
    if fault in ("foreign_recording", "specimen_changed", "recording_other_rig"):
        out, truth["fault"] = FAULTS[fault](sess, out, t0, rng, simulate, plain_cfg)
    live = [i for i, r in enumerate(sess.recs) if r.loading != "calibration"]
    dbl = int(rng.choice(live))
    data = []
    for i, (rec, o) in enumerate(zip(sess.recs, out, strict=True)):
        data.append(
            {
                "rec": rec,
                "meta": metadata(sess, rec),
                "rig": dict(rigk),
                "o": o,
                "ch": channels(sess, rec, o, nrng, i == dbl, rigk["load_cell_range_n"]),
            }
        )
    if fault and not truth["fault"]["id"]:
        truth["fault"] = apply_fault(fault, sess, data, rng)
    noise = sess.noise["kind"]
    for d in data:
        rec = d["rec"]
        ns = round((sess.style["start"] + rec.t0) * 1000) * 1000000
        write_mcap(
            folder / f"{rec.rid}.mcap", d["meta"], d["rig"], d["ch"], ns, sess.style["block"], sess.style["compression"]
        )
    truth["noise"] = f"{noise}, force sd {sess.noise['force']:.3g} N, stated {sess.noise['stated']}" + (
        f", doubled in {sess.recs[dbl].rid}" if noise == "doubled" else ""
    )
    truth["session"] = sess.label
    truth["truth"] = {
        "film": sess.film,
        "rig": sess.rig,
        "stated": sess.stated,
        "preload_n": t0,
        "noise": sess.noise,
        "reference": made["ref"],
        "style": sess.style,
        "recordings": [r.rid for r in sess.recs],
        "effects": truth.pop("parameters", []),
    }
    return json.loads(json.dumps(truth, default=_plain))


def _plain(v):
    """numpy to JSON."""
    if isinstance(v, np.ndarray):
        return v.tolist()
    if isinstance(v, np.generic):
        return v.item()
    return str(v)


def main() -> None:
    """SEED KIND FOLDER."""
    seed, kind, folder = int(sys.argv[1]), sys.argv[2], Path(sys.argv[3])
    t = write_session(seed, kind, folder)
    (folder.parent / "truth.json").write_text(json.dumps(t, indent=1))


if __name__ == "__main__":
    main()
