"""The truth rig `auk`: sessions of recordings of one specimen, with or without a hidden effect."""

import json
import sys
from dataclasses import fields
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from .core import Film, Hooks, simulate
from .forms import MECHANISMS, UNLISTED, Mechanism, delayed
from .lab import UNITS, Session, coloured, draw_film, draw_session, loguni, write_mcap

KINDS = ("clean", "single", "unlisted", "pair", "fault")
DEC = 2000.0
SUB = 4
LAYOUTS = [(1000, "zstd"), (1000, "lz4"), (1024, "none"), (500, "zstd"), (2000, "lz4")]


def merge(*hooks: Hooks) -> Hooks:
    """Several effects at once (of different stages)."""
    out = Hooks()
    for h in hooks:
        for f in fields(Hooks):
            a, b = getattr(out, f.name), getattr(h, f.name)
            if isinstance(a, list):
                setattr(out, f.name, a + b)
            elif b != f.default:
                setattr(out, f.name, b)
    return out


def response(film: Film, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """physics.md 3.1: G = F/x0 and F/F_A (negative of H per gain)."""
    jw = 1j * w
    k = film.k0 + sum(ki * jw * ti / (1 + jw * ti) for ki, ti in zip(film.k, film.tau, strict=True))
    cl = 2 * film.zeta * np.sqrt(film.kl * film.mass)
    den = k + film.kl - film.mass * w * w + jw * cl
    return k * film.kl / den, -film.kl / den


def linear(film: Film, x: np.ndarray, v2: np.ndarray, rate: float) -> np.ndarray:
    """Plain force change by Fourier transform (padded); used for derivatives and for the check of clean sessions."""
    pad = int(25 * rate)
    down = np.linspace(1, 0, int(2 * rate))
    n = x.size + pad
    w = 2 * np.pi * np.fft.rfftfreq(n, 1 / rate)
    g, h = response(film, w)
    out = np.zeros(n // 2 + 1, complex)
    if np.any(x):
        z = np.zeros(n)
        z[: x.size] = x
        z[x.size : x.size + down.size] = x[-1] * down
        out += g * np.fft.rfft(z)
    if np.any(v2):
        z = np.zeros(n)
        z[: x.size] = v2
        out += film.gain * h * np.fft.rfft(z)
    return np.fft.irfft(out, n)[: x.size]


class Judge:
    """Traces of a session with and without effects, and the strength of the difference."""

    def __init__(self, ses: Session) -> None:
        """Simulate the plain session and its derivatives."""
        self.ses = ses
        self.plain = self.run(Hooks())
        ses.tmax = max(
            float(np.abs(p["T"]).max()) for p, r in zip(self.plain, ses.recs, strict=True) if r.loading != "calibration"
        )
        ses.tneg = max(
            float((-p["T"]).max()) for p, r in zip(self.plain, ses.recs, strict=True) if r.loading != "calibration"
        )
        ses.ftop = max(float(np.abs(p["force"]).max()) for p in self.plain)
        ses.vrms2 = max([float(np.mean(p["v"] ** 2)) for p in self.plain])
        self.wt = [np.sqrt(r.rates["force"] * SUB / DEC) / (ses.sd["force"] * r.noise_factor) for r in ses.recs]
        self.q, self.offq = self.basis()

    def run(self, hooks: Hooks) -> list[dict[str, Any]]:
        """All recordings on the coarse grid."""
        carry = np.zeros(4)
        off = hooks.preload if hooks.preload is not None else self.ses.offset
        return [simulate(self.ses.film, r, hooks, DEC, carry, off) for r in self.ses.recs]

    def basis(self) -> tuple[np.ndarray, None]:
        """Orthonormal basis of the weighted derivatives, priors as further rows, offsets removed."""
        ses = self.ses
        p0 = ses.film.vector()
        cols = []
        for i in range(p0.size):
            dp = p0.copy()
            dp[i] *= 1.001
            film = ses.film.with_vector(dp)
            parts = []
            for r, p, w in zip(ses.recs, self.plain, self.wt, strict=True):
                x, v2 = p["x"][::SUB], p["voltage"][::SUB] ** 2
                if r.loading == "calibration":
                    if r.protocol == "tap":
                        a = r.calibration(
                            p["t"], film.mass, film.kl, 2 * film.zeta * np.sqrt(film.kl * film.mass), Hooks()
                        )
                        b = r.calibration(p["t"], p0[-4], p0[-3], 2 * p0[-2] * np.sqrt(p0[-4] * p0[-3]), Hooks())
                        d = (a - b)[::SUB] / 1e-3
                    else:
                        d = np.zeros(x.size)
                else:
                    d = (linear(film, x, v2, DEC / SUB) - linear(ses.film, x, v2, DEC / SUB)) / 1e-3
                parts.append(w * (d - (0 if r.protocol == "weight" else d.mean())))
            row = np.zeros(p0.size)
            if np.isfinite(ses.prior[i]):
                row[i] = 1 / ses.prior[i]
            cols.append(np.concatenate([*parts, row]))
        m = np.array(cols).T
        n = np.linalg.norm(m, axis=0)
        return np.linalg.qr(m / np.where(n > 0, n, 1.0))[0], None

    def delta(self, hooks: Hooks) -> np.ndarray:
        """Weighted, projected difference."""
        got = self.run(hooks)
        parts = []
        if hooks.seen:
            for r, a, b in zip(self.ses.recs, got, self.plain, strict=True):
                w = np.sqrt(r.rates.get("voltage", r.rate) * SUB / DEC) / self.ses.sd["voltage"]
                parts.append(w * (a["voltage"] - b["voltage"])[::SUB])
            return np.concatenate(parts)
        for r, a, b, w in zip(self.ses.recs, got, self.plain, self.wt, strict=True):
            f = a["force"]
            if hooks.x_delay:
                f = f[0] + delayed(f - f[0], -hooks.x_delay * DEC)
            d = (f - b["force"])[::SUB]
            parts.append(w * (d - (0 if r.protocol == "weight" else d.mean())))
        y = np.concatenate([*parts, np.zeros(self.q.shape[1])])
        return y - self.q @ (self.q.T @ y)


def severity(mid: str, s: float, form: str, q: np.ndarray, ses: Session, extra: dict[str, Any]) -> dict[str, float]:
    """The severity under the keys of physics.md, section 5."""
    sg = 1.0 if q[0] > 0.5 else -1.0
    if mid == "rig_constants":
        if form in ("mass", "mass_grows_log"):
            return {"mass_error": sg * s}
        if form == "both":
            return {"mass_error": sg * s, "stiffness_error": -0.6 * sg * s}
        return {"stiffness_error": sg * s}
    if mid == "slack":
        on = ses.tneg / (1 + s)
        return {"onset": on / extra["preload"], "onset_n": on, "over_onset": s}
    if mid == "wrinkling":
        return {"onset_kv": ses.vmax / (1 + s)}
    if mid == "clamp_slip":
        return {"slip_force": 1 / (1 + s), "slip_force_n": ses.tmax / (1 + s)}
    if mid == "sensor_saturation":
        return {"limit_n": ses.ftop / (1 + s)}
    if mid == "thermal_softening":
        return {"per_kelvin": s / extra["rise_k"], "rise_k": extra["rise_k"]}
    if mid == "passive_strip":
        return {"ratio": 1 - s, "time_constant_s": 0.05 + 1.5 * float(q[0])}
    if mid in ("drive_offset", "gain_error"):
        return {MECHANISMS[mid].key: sg * s}
    if mid == "baseline_drift":
        return {"per_decade": s if q[0] <= 0.25 else -s}
    return {(MECHANISMS.get(mid) or UNLISTED[mid]).key: s}


def able(ses: Session, need: str) -> bool:
    """Can these recordings show an effect with this need?"""
    p = {r.protocol for r in ses.recs}
    return need in ("", "m") or (need == "e" and ses.style != "mechanical") or (need == "w" and "weight" in p)


def tune(
    judge: Judge, mech: Mechanism, form: Any, q: np.ndarray, target: float, seen: bool
) -> tuple[float, float, Hooks, np.ndarray]:
    """Severity that reaches a strength (three looks)."""

    def look(s: float) -> tuple[float, Hooks, np.ndarray]:
        h = form(s, judge.ses, q)
        h.seen = seen
        y = judge.delta(h)
        return float(np.linalg.norm(y)), h, y

    s = min(mech.start, mech.cap)
    pts = []
    best = None
    for _ in range(3):
        d, h, y = look(s)
        if not np.isfinite(d):
            s *= 0.3
            continue
        pts.append((np.log(s), np.log(max(d, 1e-9))))
        if best is None or abs(np.log(max(d, 1e-9) / target)) < abs(np.log(max(best[1], 1e-9) / target)):
            best = (s, d, h, y)
        if abs(np.log(max(d, 1e-9) / target)) < 0.1:
            break
        slope = 1.0
        if len(pts) > 1 and abs(pts[-1][0] - pts[-2][0]) > 1e-6:
            slope = float(np.clip((pts[-1][1] - pts[-2][1]) / (pts[-1][0] - pts[-2][0]), 0.4, 4.0))
        new = float(np.exp(pts[-1][0] + np.clip((np.log(target) - pts[-1][1]) / slope, -5, 5)))
        new = min(new, mech.cap)
        if abs(np.log(new / s)) < 1e-3:
            break
        s = new
    if best is None:
        raise FloatingPointError("the trace is not finite")
    return best


def distance(y: np.ndarray, judge: Judge, mech: Mechanism, name: str, s: float, q: np.ndarray) -> float:
    """Rough distance of the form's trace to the textbook form (scale, and one further severity, free)."""
    first = next(iter(mech.forms))
    if name == first:
        return 0.0
    best = 1.0
    for qq in (np.full(6, 0.7 if q[0] > 0.5 else 0.3), np.where(q > 0.5, 0.95, 0.05)):
        z = judge.delta(mech.forms[first](min(s, mech.cap), judge.ses, qq))
        n = np.linalg.norm(z)
        if np.isfinite(n) and n > 0:
            c = float(y @ z) / (n * np.linalg.norm(y))
            best = min(best, float(np.sqrt(max(1 - c * c, 0))))
    return round(min(best, 0.5), 3)


def write_session(seed: int, kind: str, folder: Path) -> dict[str, Any]:
    """Draw a session, hide what `kind` asks for, write its recordings into `folder`, and return the truth."""
    if kind not in KINDS:
        raise ValueError(f"unknown kind: {kind}")
    rng = np.random.default_rng([20261127, 0xA0C, seed, KINDS.index(kind)])
    mids = list(MECHANISMS)
    unl = list(UNLISTED)
    want: list[str] = []
    if kind == "single":
        want = [mids[int(rng.integers(len(mids)))]]
    elif kind == "unlisted":
        want = [unl[int(rng.integers(len(unl)))]]
    elif kind == "pair":
        while True:
            a, b = (mids[int(i)] for i in rng.choice(len(mids), 2, replace=False))
            if MECHANISMS[a].stage != MECHANISMS[b].stage:
                want = [a, b]
                break
    table = {**MECHANISMS, **UNLISTED}
    needs = {table[w].need for w in want}
    fault = FAULTS[int(rng.integers(len(FAULTS)))] if kind == "fault" else ""
    if fault == "gain_changed":
        needs.add("")
    ses = draw_session(rng, "w" if "w" in needs else ("e" if "e" in needs else ""))
    odd = rng.random() < (1 / 3 if kind == "clean" else 0.25)
    nk = str(rng.choice(["pink", "burst", "slow", "double"])) if odd else "white"
    ses.noise["kind"] = nk
    if nk == "double":
        i = int(rng.integers(len(ses.recs)))
        ses.recs[i].noise_factor = 2.0
        ses.noise["double"] = i
    truth: dict[str, Any] = {
        "listed": [],
        "unlisted": "",
        "stage": [],
        "depends_on": [],
        "severity": {},
        "form": "",
        "form_distance": 0.0,
        "strength": 0.0,
        "strength_alone": [],
    }
    hooks = Hooks()
    extra: dict[str, Any] = {"rise_k": float(rng.uniform(2, 8))}
    if want:
        judge = Judge(ses)
        made, forms, dist, ys = [], [], [], []
        for w in want:
            mech = table[w]
            for _ in range(3):
                name = list(mech.forms)[int(rng.integers(len(mech.forms)))]
                q = rng.random(6)
                com = any("command" in r.rates for r in ses.recs)
                seen = bool(kind == "single" and w in ("drive_lag", "leakage") and com and rng.random() < 0.5)
                if seen:
                    ses.rig["amplifier_gain_kv_per_v"] = "1.5"
                s, d, h, y = tune(judge, mech, mech.forms[name], q, loguni(rng, 20, 2000), seen)
                if d > 15:
                    break
            if h.preload is not None:
                extra["preload"] = h.preload
            made.append(h)
            forms.append(name)
            extra.setdefault("form_numbers", []).append([round(float(z), 4) for z in q])
            if seen:
                extra["seen_by_monitor"] = True
            dist.append(0.5 if kind == "unlisted" else (0.0 if seen else distance(y, judge, mech, name, s, q)))
            ys.append(y)
            truth["strength_alone"].append(d)
            sev = severity(w, s, name, q, ses, extra)
            truth["severity"].update(sev if kind != "pair" else {f"{w}.{k}": v for k, v in sev.items()})
            truth["stage"].append(mech.stage)
            truth["depends_on"] += [x for x in mech.depends if x not in truth["depends_on"]]
        hooks = merge(*made)
        truth["strength"] = float(np.linalg.norm(judge.delta(hooks))) if kind == "pair" else truth["strength_alone"][0]
        truth["form"] = "+".join(forms)
        truth["form_distance"] = max(dist)
        extra["form_distances"] = dist
        truth["listed"] = want if kind != "unlisted" else []
        truth["unlisted"] = want[0] if kind == "unlisted" else ""
    sid = f"{rng.choice(['S', 'P', 'AK', 'film-'])}{int(rng.integers(100, 9999))}"
    out = record(rng, ses, hooks, sid, extra)
    fa: dict[str, Any] = {"id": "", "recordings": [], "key": "", "right_value": None}
    if kind == "fault":
        fa, out = put_fault(rng, ses, out, fault)
        extra["fault_kind"] = fault
    files(rng, out, folder)
    f = ses.film
    extra |= {
        "k0": f.k0,
        "k": f.k,
        "tau": f.tau,
        "clamp_mass_kg": f.mass * 1e3,
        "load_cell_stiffness": f.kl,
        "damping_ratio": f.zeta,
        "gain_n_per_kv2": f.gain,
        "noise_sd": ses.sd,
        "style": ses.style,
        **ses.truth,
    }
    text = {
        "white": "white",
        "pink": "white and 1/f",
        "burst": "bursts",
        "slow": "level changes slowly",
        "double": f"doubled in recording {ses.noise['double']}",
    }[nk]
    return {
        "specimen_id": sid,
        "kind": kind,
        **truth,
        "fault": fa,
        "stage": truth["stage"][0] if len(truth["stage"]) == 1 else truth["stage"],
        "noise": text,
        "session": ses.style,
        "truth": _plainify(extra),
        "seed": seed,
    }


def _plainify(x: Any) -> Any:
    return json.loads(json.dumps(x, default=lambda o: o.tolist() if hasattr(o, "tolist") else float(o)))


def record(
    rng: np.random.Generator, ses: Session, hooks: Hooks, sid: str, extra: dict[str, Any]
) -> list[dict[str, Any]]:
    """Full-rate recordings with noise, as the laboratory's computer has them."""
    carry = np.zeros(4)
    off = hooks.preload if hooks.preload is not None else ses.offset
    start = datetime(
        2026,
        int(rng.integers(1, 11)),
        int(rng.integers(1, 28)),
        int(rng.integers(7, 15)),
        int(rng.integers(60)),
        tzinfo=UTC,
    )
    rid = f"{rng.choice(['auk', 'lab2', 'bench'])}-{int(rng.integers(1, 9))}"
    who = str(rng.choice(["mk", "jl", "ra", "tw"]))
    layout = LAYOUTS[int(rng.integers(len(LAYOUTS)))]
    style = int(rng.integers(3))
    out = []
    for i, r in enumerate(ses.recs):
        mult = int(np.ceil(4000 / r.rate))
        fine = r.rate * mult
        a = simulate(ses.film, r, hooks, fine, carry, off)
        grow = 2.0 / ((ses.film.k0 + sum(ses.film.k)) * ses.length)
        cc = ses.cap0 * (1 + grow * a["fa"] / max(ses.share, 0.1))
        for f in hooks.capacity:
            cc = f(r, a["t"], a["voltage"], cc)
        warm = hooks.warm(r, a["t"]) if hooks.warm else 0.0
        a["capacitance"] = cc
        a["temperature"] = r.room + 0.02 * np.sin(a["t"] / 40) + warm * extra["rise_k"]
        chans = {}
        for name, rate in r.rates.items():
            step = round(fine / rate)
            y = a[name][::step][: round(r.duration * rate)]
            nk = ses.noise["kind"] if name == "force" else "white"
            y = y + ses.sd[name] * (r.noise_factor if name == "force" else 1.0) * coloured(rng, y.size, rate, nk)
            res = ses.res[name]
            meta = {"resolution": f"{res:.3g}"} if style != 1 else {}
            chans[name] = {"rate": rate, "values": np.round(y / res) * res, "unit": UNITS[name], "meta": meta}
        rec_id = [f"{sid}-{i + 1:02d}", f"{sid}_{r.protocol}_{i + 1}", f"run{i + 1:03d}.{sid}"][style]
        r.rec_id = rec_id
        meta = {
            "recording_id": rec_id,
            "protocol": r.protocol,
            "loading": r.loading,
            "specimen_id": sid,
            "rig_id": rid,
            "operator": who,
            "started_at": (start + timedelta(seconds=r.session_time)).isoformat(),
            **ses.common,
            **r.meta,
        }
        out.append(
            {
                "meta": meta,
                "rig": {"rig_id": rid, **ses.rig},
                "chans": chans,
                "start": start + timedelta(seconds=r.session_time),
                "layout": layout,
                "offset_ns": {},
            }
        )
    return out


def files(rng: np.random.Generator, out: list[dict[str, Any]], folder: Path) -> None:
    """Write the MCAP files."""
    folder.mkdir(parents=True, exist_ok=True)
    for o in out:
        chans = [{"name": n, **c} for n, c in o["chans"].items()]
        ns = round(o["start"].timestamp() * 1e9)
        block, comp = o["layout"]
        write_mcap(folder / f"{o['meta']['recording_id']}.mcap", o["meta"], o["rig"], chans, ns, block, comp)


FAULTS = (
    "channels_swapped",
    "sign_one",
    "sign_all",
    "unit_one",
    "unit_all",
    "sample_rate",
    "clock_drift",
    "channel_skew",
    "strain_pp",
    "size",
    "foreign_recording",
    "foreign_rig",
    "dead_channel",
    "specimen_changed",
    "clamp_mass",
    "gain_changed",
    "clipped",
    "dropout",
)


def put_fault(
    rng: np.random.Generator, ses: Session, out: list[dict[str, Any]], fault: str
) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """One everyday fault; returns what would put it right and the recordings."""
    mech = [i for i, r in enumerate(ses.recs) if r.loading == "mechanical"]
    chirps = [i for i, r in enumerate(ses.recs) if r.protocol == "chirp"]
    sphs = [i for i, r in enumerate(ses.recs) if r.protocol == "sphs"]
    test = [i for i, r in enumerate(ses.recs) if r.loading != "calibration"]
    one = int(rng.choice(mech))
    ids = [o["meta"]["recording_id"] for o in out]
    fa: dict[str, Any] = {"id": fault, "recordings": [ids[one]], "key": "", "right_value": None}
    ch = str(rng.choice(["force", "displacement"]))
    factor = float(rng.choice([10, 0.1, 1000, 1e-3, 9.81, 1 / 9.81, 2, 0.5, 2 * np.sqrt(2), 0.5 / np.sqrt(2)]))
    c = out[one]["chans"]
    if fault == "channels_swapped":
        which = [one] if rng.random() < 0.6 else mech
        for i in which:
            b = out[i]["chans"]
            b["force"], b["displacement"] = b["displacement"], b["force"]
            for n in ("force", "displacement"):
                b[n]["unit"] = UNITS[n]
        fa |= {"recordings": [ids[i] for i in which], "key": "force<->displacement", "right_value": "swap"}
    elif fault in ("sign_one", "sign_all"):
        which = [one] if fault == "sign_one" else [i for i in range(len(out)) if ch in out[i]["chans"]]
        for i in which:
            out[i]["chans"][ch]["values"] = -out[i]["chans"][ch]["values"]
        fa |= {
            "id": "sign_flipped",
            "recordings": [ids[i] for i in which] if fault == "sign_one" else "all",
            "key": f"{ch}.scale",
            "right_value": -1,
        }
    elif fault in ("unit_one", "unit_all"):
        if sphs and rng.random() < 0.25:
            ch = "voltage"
            one = int(rng.choice(sphs))
        which = [one] if fault == "unit_one" else [i for i in range(len(out)) if ch in out[i]["chans"]]
        for i in which:
            out[i]["chans"][ch]["values"] = out[i]["chans"][ch]["values"] * factor
            if "resolution" in out[i]["chans"][ch]["meta"]:
                out[i]["chans"][ch]["meta"]["resolution"] = f"{ses.res[ch] * factor:.3g}"
        fa |= {
            "id": "unit_slip",
            "recordings": [ids[one]] if fault == "unit_one" else "all",
            "key": f"{ch}.scale",
            "right_value": 1 / factor,
        }
    elif fault == "sample_rate":
        q = float(1 + rng.choice([-1, 1]) * rng.uniform(0.02, 0.10))
        i = int(rng.choice(chirps + [j for j, r in enumerate(ses.recs) if r.protocol in ("cyclic", "sphs")]))
        right = out[i]["chans"]["force"]["rate"]
        for b in out[i]["chans"].values():
            b["rate"] *= q
        fa |= {"id": "sample_rate_wrong", "recordings": [ids[i]], "key": "sample_rate_hz", "right_value": right}
    elif fault == "clock_drift":
        ppm = float(rng.choice([-1, 1]) * rng.uniform(20, 200))
        which = test
        for i in which:
            out[i]["chans"]["force"]["rate"] *= 1 + ppm * 1e-6
        fa |= {"recordings": "all", "key": "force.clock_ppm", "right_value": ppm}
    elif fault == "channel_skew":
        n = int(rng.integers(2, 12))
        which = [int(rng.choice(chirps))] if rng.random() < 0.5 else chirps
        for i in which:
            b = out[i]["chans"]["force"]
            b["values"] = np.concatenate([np.full(n, b["values"][0]), b["values"][:-n]])
        fa |= {
            "recordings": [ids[i] for i in which],
            "key": "force.delay_s",
            "right_value": n / out[which[0]]["chans"]["force"]["rate"],
        }
    elif fault == "strain_pp":
        which = [i for i, r in enumerate(ses.recs) if r.protocol == "cyclic"]
        q = float(rng.choice([0.5, 2.0]))
        right = {ids[i]: out[i]["meta"]["strain_pp"] for i in which}
        for i in which:
            out[i]["meta"]["strain_pp"] = f"{float(out[i]['meta']['strain_pp']) * q:.5g}"
        fa |= {"id": "strain_wrong", "recordings": [ids[i] for i in which], "key": "strain_pp", "right_value": right}
    elif fault == "size":
        keys = ["film_length_mm", "film_width_mm", "film_thickness_mm"]
        key = keys[int(rng.integers(3 if ses.style != "mechanical" else 1))]
        q = float(rng.choice([0.1, 0.5, 2, 10]))
        right = float(out[0]["meta"][key])
        for o in out:
            o["meta"][key] = f"{right * q:g}"
        fa |= {"id": "size_wrong", "recordings": "all", "key": key, "right_value": right}
    elif fault in ("foreign_recording", "foreign_rig", "specimen_changed"):
        old, keep = ses.film, out
        v = old.vector()
        n = len(old.k)
        if fault == "foreign_recording":
            i = int(rng.choice(chirps))
            other, *_ = draw_film(rng)
            q = old.k0 * float(rng.choice([rng.uniform(0.35, 0.7), rng.uniform(1.5, 3)])) / other.k0
            ses.film = Film(other.k0 * q, [x * q for x in other.k], other.tau, old.mass, old.kl, old.zeta, old.gain)
            which = [i]
            fa |= {"recordings": [ids[i]], "key": "specimen_id", "right_value": "another specimen"}
        elif fault == "foreign_rig":
            i = int(rng.choice(chirps))
            which = [i]
            v[-4] *= float(rng.choice([rng.uniform(0.4, 0.75), rng.uniform(1.35, 2.5)]))
            v[-3] *= float(rng.uniform(0.6, 1.6))
            ses.film = old.with_vector(v)
            fa |= {
                "recordings": [ids[i]],
                "key": "clamp_mass_kg,load_cell_stiffness_n_per_mm",
                "right_value": [v[-4] * 1e3, v[-3]],
            }
        else:
            i = test[int(rng.integers(len(test) // 3, max(len(test) * 2 // 3, len(test) // 3 + 1)))]
            which = list(range(i, len(ses.recs)))
            q = float(rng.choice([rng.uniform(0.6, 0.88), rng.uniform(1.1, 1.3)]))
            v[: 1 + n] *= q
            v[-1] *= float(rng.uniform(0.85, 1.0)) if q < 1 else 1.0
            ses.film = old.with_vector(v)
            ses.offset *= q
            fa |= {"recordings": ids[i:], "key": "specimen_id", "right_value": "changed from " + ids[i]}
        state = ses.recs
        fresh = simulate_some(rng, ses, which)
        for i, chans in fresh.items():
            for name, b in chans.items():
                keep[i]["chans"][name]["values"] = b["values"]
        ses.recs, ses.film = state, old
        out = keep
    elif fault == "dead_channel":
        b = c[ch]
        m = ses.sd[ch] * rng.standard_normal(b["values"].size) if rng.random() < 0.6 else np.zeros(b["values"].size)
        b["values"] = np.round((float(b["values"][0]) + m) / ses.res[ch]) * ses.res[ch]
        fa |= {"key": ch, "right_value": None}
    elif fault == "clamp_mass":
        right = float(ses.rig["clamp_mass_kg"])
        q = float(rng.choice([10.0, 1000.0]))
        for o in out:
            o["rig"]["clamp_mass_kg"] = f"{right * q:.6g}"
            o["rig"]["clamp_mass_kg_sd"] = f"{float(ses.rig['clamp_mass_kg_sd']) * q:.3g}"
        fa |= {"id": "rig_constants", "recordings": "all", "key": "clamp_mass_kg", "right_value": right}
    elif fault == "gain_changed":
        i = test[int(rng.integers(len(test) // 3, max(len(test) * 2 // 3, len(test) // 3 + 1)))]
        g = float(1 + rng.choice([-1, 1]) * rng.uniform(0.04, 0.25))
        for j in range(i, len(out)):
            out[j]["chans"]["force"]["values"] = out[j]["chans"]["force"]["values"] * g
        fa |= {"id": "gain_error", "recordings": ids[i:], "key": "force.scale", "right_value": 1 / g}
    elif fault == "clipped":
        y = c[ch]["values"]
        m = float(np.median(y))
        top = float(np.abs(y - m).max()) * float(rng.uniform(0.4, 0.8))
        c[ch]["values"] = np.clip(y, m - top, m + top)
        fa |= {"id": "sensor_saturation", "key": ch, "right_value": None}
    elif fault == "dropout":
        y = c[ch]["values"].copy()
        n = y.size
        a = int(n * rng.uniform(0.25, 0.55))
        b = a + int(n * rng.uniform(0.1, 0.25))
        y[a:b] = np.nan if rng.random() < 0.35 else (0.0 if rng.random() < 0.5 else y[a])
        c[ch]["values"] = y
        fa |= {"id": "dead_channel", "key": f"{ch} from {a} to {b}", "right_value": None}
    return fa, out


def simulate_some(rng: np.random.Generator, ses: Session, which: list[int]) -> dict[int, dict[str, Any]]:
    """Channels of some recordings with the session's present film."""
    allrecs = ses.recs
    ses.recs = [allrecs[i] for i in which]
    names = [r.rec_id for r in ses.recs]
    out = record(rng, ses, Hooks(), "x", {"rise_k": 0.0})
    for r, n in zip(ses.recs, names, strict=True):
        r.rec_id = n
    ses.recs = allrecs
    return {i: o["chans"] for i, o in zip(which, out, strict=True)}


def main() -> None:
    """python -m auk.rig SEED KIND FOLDER."""
    seed, kind, folder = int(sys.argv[1]), sys.argv[2], Path(sys.argv[3])
    truth = write_session(seed, kind, folder)
    (folder.parent / "truth.json").write_text(json.dumps(truth, indent=1))


if __name__ == "__main__":
    main()
