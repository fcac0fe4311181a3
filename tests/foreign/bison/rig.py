"""Write a session with a hidden effect: `python -m bison.rig SEED KIND FOLDER`."""

from __future__ import annotations

import copy
import datetime as dt
import json
import sys
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from . import effects as fx
from . import mcapio
from .distances import DISTANCE
from .plan import Rec, World, draw_world, log_uniform
from .simulate import Detector, Effect, simulate
from .unlisted import UNLISTED, build_unlisted

CAPS = {"slack": 1.5, "wrinkling": 1.0, "clamp_slip": 15.0, "passive_strip": 0.8}
KINDS = ("clean", "single", "unlisted", "pair", "fault")
FAULTS = (
    "channels_swapped", "sign_flipped", "unit_slip", "sample_rate_wrong", "clock_drift", "channel_skew", "strain_wrong",
    "size_wrong", "foreign_recording", "foreign_rig", "dead_channel", "specimen_changed", "mass_entry", "gain_changed",
    "clipped", "drop_out",
)  # fmt: skip
FAULT_ID = {
    "mass_entry": "rig_constants", "gain_changed": "gain_error", "clipped": "sensor_saturation", "drop_out": "dead_channel",
}  # fmt: skip
FAULT_STAGE = {
    "mass_entry": "rig", "foreign_rig": "rig", "gain_changed": "sensor", "clipped": "sensor", "dead_channel": "sensor",
    "drop_out": "sensor", "specimen_changed": "film", "sign_flipped": "sensor", "channel_skew": "sensor",
}  # fmt: skip
RANGES = (0.5, 1, 2, 2.5, 5, 10, 20, 25, 50, 100, 200, 250, 500)


def shapes(r: np.random.Generator) -> dict[str, float]:
    """Numbers that fix the shape of a form while its size is searched."""
    return {f"u{i}": float(r.random()) for i in range(10)}


def holds(w: World, needs: tuple[str, ...]) -> bool:
    """Whether the session has what an effect needs to be seen."""
    mech = any(x.loading == "mechanical" for x in w.recs)
    elec = any(x.loading == "electrical" for x in w.recs)
    return all({"mech": mech, "elec": elec, "any": True}[n] for n in needs)


def fits(name: str, form: str, w: World) -> bool:
    """Further conditions of single mechanisms on the protocols."""
    volts = {round(lv, 2) for x in w.recs if x.loading == "electrical" for lv in x.p.get("levels", [x.p.get("kv", 0)])}
    if name in ("field_dependent_permittivity", "drive_offset", "wrinkling", "leakage"):
        return len(volts) >= 2
    if name in ("amplitude_softening", "slack", "strain_stiffening", "clamp_slip", "sensor_saturation"):
        return len({x.p["amp"] for x in w.recs if x.loading == "mechanical"}) >= 2
    return True


def search(build, lo: float, cap: float, target: float, w: World, det: Detector, plain: list) -> tuple[float, float]:
    """Severity whose detectability is the target, at most cap."""
    done: dict[float, float] = {}

    def d(s: float) -> float:
        if s not in done:
            done[s] = det.d(plain, simulate(w, [build(s)], coarse=True))
        return done[s]

    s = min(cap, max(lo, 0.25 * cap))
    p = 1.0
    for _ in range(7):
        got = d(s)
        if abs(np.log(max(got, 1e-9) / target)) < 0.15:
            break
        below = [x for x in done if done[x] < target]
        above = [x for x in done if done[x] >= target]
        if below and above and max(below) < min(above):
            a, b = max(below), min(above)
            la, lb = np.log(max(done[a], 1e-6)), np.log(done[b])
            u = float(np.clip((np.log(target) - la) / max(lb - la, 1e-9), 0.1, 0.9))
            s = float(a * (b / a) ** u)
        elif got < target:
            if s >= cap:
                break
            s = min(cap, s * float(np.clip((target / max(got, 1e-6)) ** (1 / p), 1.3, 30)))
        else:
            s = s * float(np.clip((target / got) ** (1 / p), 1e-3, 0.8))
    best = min(done, key=lambda x: abs(np.log(max(done[x], 1e-9) / target)))
    return best, done[best]


def draw_noise(r: np.random.Generator, kind: str, w: World, plain: list) -> None:
    """Noise of the channels, range and resolution of the cell."""
    mech = [c["force"] - w.preload for x, c in zip(w.recs, plain, strict=True) if x.loading == "mechanical"]
    w.files["f_chirp"] = w.f_peak
    slow = [c["force"] - w.preload for x, c in zip(w.recs, plain, strict=True)
            if x.protocol in ("cyclic", "step") and x.loading == "mechanical"]  # fmt: skip
    w.files["f_neg"] = max(
        [w.f_peak if any(x.protocol == "chirp" for x in w.recs) else 0.0] + [-float(y.min()) for y in slow]
    )
    w.f_peak = max([w.f_peak] + [float(np.abs(y).max()) for y in slow]) if mech else w.f_peak
    w.files["peak"] = float(max(np.max(np.abs(c["force"])) for c in plain))
    need = w.files["peak"] * r.uniform(1.05, 1.4)
    rng = next(x for x in RANGES if x >= need)
    sd = rng * log_uniform(r, 6e-5, 8e-4)
    if any(x.loading == "electrical" for x in w.recs):
        sd = min(sd, 0.1 * w.gain * w.v_max**2)
    third = r.random() < 1 / 3 if kind == "clean" else r.random() < 0.45
    sort = str(r.choice(["pink", "bursts", "level", "doubled"])) if third else "white"
    step = rng / 2 ** int(r.choice([16, 18, 20, 24]))
    while step > 1.2 * sd:
        step /= 4
    w.noise = {
        "sd": float(sd), "sort": sort, "range": rng, "step": step, "command": bool(r.random() < 0.5),
        "doubled": int(r.integers(len(w.recs))),
    }  # fmt: skip
    w.x_noise = float(min(w.a_max * log_uniform(r, 2e-5, 2e-4), 0.4 * sd / w.k_peak))
    w.v_noise = float(w.v_max * log_uniform(r, 5e-5, 4e-4))


def noise(r: np.random.Generator, w: World, rec: Rec, n: int) -> np.ndarray:
    """Noise of the force in one recording."""
    sd, sort = w.noise["sd"], w.noise["sort"]
    white = r.normal(size=n)
    t = np.arange(n) / rec.rate
    if sort == "pink":
        f = np.fft.rfftfreq(n, 1 / rec.rate)
        spec = (r.normal(size=f.size) + 1j * r.normal(size=f.size)) / np.sqrt(np.maximum(f, 0.05))
        spec[0] = 0
        p = np.fft.irfft(spec, n)
        return sd * (0.75 * white + 0.66 * p / max(p.std(), 1e-12))
    if sort == "bursts":
        env = np.full(n, 0.9)
        for at in r.uniform(0, t[-1], max(1, int(t[-1] / 8))):
            env += r.uniform(1, 4) * np.exp(-np.abs(t - at) / r.uniform(0.05, 0.4))
        return sd * env * white
    if sort == "level":
        return sd * white * np.exp(0.6 * np.sin(2 * np.pi * t / max(t[-1], 1) * r.uniform(0.3, 1.5) + r.uniform(0, 6)))
    if sort == "doubled" and rec.index == w.noise["doubled"]:
        return 2 * sd * white
    return sd * white


def write_session(seed: int, kind: str, folder: Path) -> dict:
    """Write the recordings of a session and return what is true of it."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    r = np.random.default_rng([seed, KINDS.index(kind), 7041])
    w = draw_world(r)
    if kind == "pair":
        while not holds(w, ("mech",)) or len({x.loading for x in w.recs}) < 2:
            w = draw_world(r)
    coarse = simulate(w, [], coarse=True)
    draw_noise(r, kind, w, coarse)
    det = Detector(w, coarse)
    temperature = bool(r.random() < 0.25)
    truth: dict = {
        "specimen_id": "", "kind": kind, "listed": [], "fault": {"id": "", "recordings": [], "key": "", "right_value": None},
        "unlisted": "", "stage": [], "depends_on": [], "severity": {}, "form": "", "form_distance": 0.0, "strength": 0.0,
        "strength_alone": [], "noise": "", "session": w.label, "truth": {},
    }  # fmt: skip
    parts: list[Effect] = []
    if kind in ("single", "pair"):
        names = [m for m in fx.SPEC if holds(w, fx.SPEC[m][4])]
        order = [str(m) for m in r.permutation(names)]
        forms, alone, target_of, dist = [], [], [], []
        for name in order:
            form = str(r.choice(fx.FORMS[name]))
            q = shapes(r)
            target = log_uniform(r, 20, 2000)
            if not fits(name, form, w):
                continue
            stage, key, lo, hi, _, dep = fx.SPEC[name]
            if truth["stage"] and stage in truth["stage"]:
                continue
            cap = CAPS.get(name, 2 * hi)
            s, d = search(lambda x: fx.build(name, form, x, q, w), lo * 0.05, cap, target, w, det, coarse)  # noqa: B023
            if not 18 <= d <= 2600:
                continue
            parts.append(fx.build(name, form, s, q, w))
            truth["listed"].append(name)
            truth["stage"].append(stage)
            truth["depends_on"] += [x for x in dep if x not in truth["depends_on"]]
            truth["severity"].update(fx.severity_of(name, form, s, q, w))
            forms.append(form)
            alone.append(d)
            target_of.append(target)
            dist.append(DISTANCE.get(f"{name}/{form}", 0.25) if form != fx.FORMS[name][0] else 0.0)
            truth["truth"].setdefault("shape", []).append(q)
            if name == "sensor_delay":
                truth["truth"]["channel"] = "force" if q["u0"] < 0.65 else "displacement"
            if name == "gain_error":
                truth["truth"]["channel"] = (
                    "displacement" if q["u2"] < 0.25 and form in ("range_switch", "session_drift") else "force"
                )
            if len(parts) == (1 if kind == "single" else 2):
                break
        truth["form"] = " + ".join(forms)
        truth["form_distance"] = float(max(dist)) if dist else 0.0
        truth["form_distances"] = dist
        truth["strength_alone"] = alone
        truth["truth"]["target"] = target_of
    elif kind == "unlisted":
        for name in [str(m) for m in r.permutation([m for m in UNLISTED if holds(w, UNLISTED[m][2])])]:
            q = shapes(r)
            stage, dep, _, lo, hi, key = UNLISTED[name]
            target = log_uniform(r, 20, 2000)
            s, d = search(lambda x: build_unlisted(name, x, q, w), lo * 0.05, hi, target, w, det, coarse)  # noqa: B023
            if not 18 <= d <= 2600:
                continue
            parts.append(build_unlisted(name, s, q, w))
            truth.update(unlisted=name, stage=[stage], depends_on=list(dep), severity={key: s}, form=name)
            truth["truth"].update(shape=[q], target=[target])
            break
    plain = simulate(w, [])
    clean = plain
    if parts:
        clean = simulate(w, parts)
        fine = Detector(w, plain)
        truth["strength"] = fine.d(plain, clean)
        if kind == "single":
            truth["strength_alone"] = [truth["strength"]]
    finish(r, w, kind, clean, temperature, truth, folder)
    return truth


def finish(
    r: np.random.Generator, w: World, kind: str, clean: list, temperature: bool, truth: dict, folder: Path
) -> None:
    """Noise, converters, metadata, faults; write the files."""
    spec = f"{r.choice(list('ABDEFGHKMPS'))}{r.integers(10, 99)}-{r.integers(100, 999)}"
    truth["specimen_id"] = spec
    start = dt.datetime(2024, 1, 8, 7, 30, tzinfo=dt.UTC) + dt.timedelta(
        days=int(r.integers(0, 600)), seconds=int(r.integers(0, 14000))
    )
    zone = dt.timezone(dt.timedelta(hours=int(r.choice([0, 1, 2]))))
    units = {"force": ("N", 1.0), "displacement": ("mm", 1.0), "voltage": ("kV", 1.0)}
    if r.random() < 0.15:
        units["force"] = ("mN", 1000.0)
    if r.random() < 0.15:
        units["displacement"] = ("µm", 1000.0)
    if r.random() < 0.15:
        units["voltage"] = ("V", 1000.0)
    half = bool(r.random() < 0.2)
    size = int(r.choice([250, 500, 1000, 1000, 2000]))
    comp = str(r.choice(["zstd", "zstd", "lz4", "none"]))
    say_step = bool(r.random() < 0.7)
    rig = dict(w.rig)
    rig["load_cell_range_n"] = f"{w.noise['range']:g}"
    if r.random() < 2 / 3:
        rig["force_noise_sd"] = f"{w.noise['sd'] * r.uniform(0.7, 1.3):.3g}"
        rig["displacement_noise_sd"] = f"{w.x_noise * r.uniform(0.7, 1.3):.3g}"
        rig["voltage_noise_sd"] = f"{w.v_noise * r.uniform(0.7, 1.3):.3g}"
    operator = str(r.choice(["mk", "jt", "ao", "L. Sand", "P. Ried"]))
    x_step, v_step = w.x_noise * r.uniform(0.3, 1.0), w.v_noise * r.uniform(0.3, 1.0)
    base_t = w.temperature
    own = []
    for rec, ch in zip(w.recs, clean, strict=True):
        out: dict[str, dict] = {}
        n = ch["force"].size
        f = ch["force"] + noise(r, w, rec, n)
        if rec.loading != "calibration":
            f = f + w.preload * 0.003 * r.normal()
        f = np.round(f / w.noise["step"]) * w.noise["step"]
        if "sensor_saturation" not in truth["listed"]:
            f = np.clip(f, -w.noise["range"], w.noise["range"])
        out["force"] = {"values": f, "dt": 1 / rec.rate, "step": w.noise["step"]}
        q = 2 if half and rec.rate >= 1000 else 1
        if "displacement" in ch:
            x = ch["displacement"][::q]
            x = np.round((x + w.x_noise * r.normal(size=x.size)) / x_step) * x_step
            out["displacement"] = {"values": x, "dt": q / rec.rate, "step": x_step}
        if "voltage" in ch:
            v = ch["voltage"][::q]
            v = np.round((v + w.v_noise * r.normal(size=v.size)) / v_step) * v_step
            out["voltage"] = {"values": v, "dt": q / rec.rate, "step": v_step}
            if w.noise["command"]:
                c = ch["command"][::q]
                out["command"] = {"values": np.round(c / 3e-4) * 3e-4, "dt": q / rec.rate, "step": 3e-4}
        if temperature and rec.loading != "calibration":
            m = int(rec.duration * 2) + 1
            tt = np.arange(m) / 2
            dev = np.zeros(m)
            if "temperature" in ch:
                dev = np.interp(tt, np.arange(n) / rec.rate, ch["temperature"])
            slow = 0.08 * np.sin(2 * np.pi * (rec.t0 + tt) / 5000.0)
            val = np.round((base_t + dev + slow + 0.02 * r.normal(size=m)) / 0.01) * 0.01
            out["temperature"] = {"values": val, "dt": 0.5, "step": 0.01}
        own.append(out)
    metas = []
    started = []
    for rec in w.recs:
        at = start + dt.timedelta(seconds=round(rec.t0, 3))
        started.append(at)
        name = f"{spec}_{rec.index + 1:02d}"
        rec.name = name
        m = {
            "recording_id": name, "protocol": rec.protocol, "loading": rec.loading, "specimen_id": spec,
            "started_at": at.astimezone(zone).isoformat(), "rig_id": rig["rig_id"], "operator": operator,
        }  # fmt: skip
        if rec.loading != "calibration":
            m.update(w.meta)
        p = rec.p
        if rec.protocol == "chirp":
            m.update(frequency_start_hz=f"{p['f1']:g}", frequency_stop_hz=f"{p['f2']:g}", sweep=p["kind"],
                     repeats=str(p["repeats"]), period_s=f"{p['period']:g}")  # fmt: skip
            if rec.loading == "electrical":
                m["drive_kv"] = f"{p['kv']:g}"
        elif rec.protocol == "sphs":
            m.update(frequency_start_hz=f"{p['f0'] * p['lines'][0]:g}", frequency_stop_hz=f"{p['f0'] * p['lines'][-1]:g}",
                     period_s=f"{p['period']:g}", periods=str(p["n"]), lines=p["kind"], drive_kv=f"{p['kv']:g}")  # fmt: skip
        elif rec.protocol == "cyclic":
            m.update(frequency_hz=f"{p['f_nom']:g}", cycles=str(p["cycles"]), strain_pp=f"{p['pp']:.4g}")
        elif rec.protocol == "step" and rec.loading == "electrical":
            m.update(on_s=f"{p['on']:g}", off_s=f"{p['off']:g}", drive_kv=f"{max(p['levels']):g}", controller="open")
        elif rec.protocol == "weight":
            m["masses_kg"] = ",".join(f"{x:g}" for x in p["masses"])
        metas.append(m)
    rigs = [dict(rig) for _ in w.recs]
    if kind == "fault":
        put_fault(r, w, own, metas, rigs, truth)
    for _rec, out, m, g, at in zip(w.recs, own, metas, rigs, started, strict=True):
        chans = []
        for topic, c in out.items():
            unit, k = units.get(topic, {"command": ("V", 1.0), "temperature": ("degC", 1.0)}.get(topic, ("", 1.0)))
            meta = {"resolution": f"{c['step'] * k:.4g}"} if say_step and c["step"] else {}
            chans.append({"topic": topic, "unit": unit, "start_ns": round(at.timestamp() * 1e9), "dt": c["dt"],
                          "values": c["values"] * k, "meta": meta, "keep": c.get("keep")})  # fmt: skip
        mcapio.write(folder / f"{m['recording_id']}.mcap", m, g, chans, size, comp)
    truth["noise"] = f"{w.noise['sort']}, sd {w.noise['sd']:.3g} N" + (
        f" (recording {w.recs[w.noise['doubled']].name})" if w.noise["sort"] == "doubled" else ""
    )
    truth["truth"].update(
        k0_n_per_mm=w.k0, k_n_per_mm=[float(x) for x in w.ks], tau_s=[float(x) for x in w.taus], clamp_mass_kg=w.mass * 1e3,
        load_cell_stiffness_n_per_mm=w.kl, load_cell_damping_n_s_per_mm=w.cl, force_per_voltage_squared_n_per_kv2=w.gain,
        preload_n=w.preload, amplifier_time_constant_s=w.tau_amp, force_noise_sd=w.noise["sd"],
        displacement_noise_sd=w.x_noise, voltage_noise_sd=w.v_noise, recordings=[x.name for x in w.recs],
    )  # fmt: skip


def put_fault(r: np.random.Generator, w: World, own: list, metas: list, rigs: list, truth: dict) -> None:
    """One everyday fault in an otherwise clean session."""
    names = [x.name for x in w.recs]
    n = len(w.recs)
    work = [i for i, x in enumerate(w.recs) if x.loading != "calibration"]
    mech = [i for i in work if w.recs[i].loading == "mechanical"]
    elec = [i for i in work if w.recs[i].loading == "electrical"]
    cyc = [i for i in work if w.recs[i].protocol == "cyclic"]
    fast = [i for i in work if w.recs[i].protocol in ("chirp", "sphs")]
    kinds = [f for f in FAULTS if not (f == "strain_wrong" and not cyc) and not (f == "mass_entry" and not mech)]
    fault = str(r.choice(kinds))
    sizes_seen = len(elec) > 0
    while fault == "size_wrong" and not sizes_seen:
        fault = str(r.choice(kinds))
    ids: list[int] = []
    key, right = "", None
    every = bool(r.random() < 0.4)
    other = "voltage"

    def pick(pool: list[int]) -> list[int]:
        return list(pool) if every else [int(r.choice(pool))]

    def second(i: int) -> str:
        return "displacement" if "displacement" in own[i] else "voltage"

    if fault == "channels_swapped":
        pool = mech if mech and r.random() < 0.7 else (elec or mech)
        ids = pick(pool)
        for i in ids:
            other = second(i)
            a, b = own[i]["force"], own[i][other]
            own[i]["force"], own[i][other] = {**b, "step": a["step"]}, {**a, "step": b["step"]}
        key, right = "channel mapping", f"force<->{other}"
    elif fault == "sign_flipped":
        chan = "displacement" if mech and r.random() < 0.45 else "force"
        ids = pick([i for i in work if chan in own[i]])
        for i in ids:
            own[i][chan]["values"] = -own[i][chan]["values"]
        key, right = f"{chan} scale", -1.0
    elif fault == "unit_slip":
        chan = str(r.choice(["force", "displacement", "voltage"]))
        pool = [i for i in work if chan in own[i]]
        if not pool:
            chan, pool = "force", work
        k = float(r.choice([10, 1000, 9.80665, 2, 2 * np.sqrt(2)]))
        if r.random() < 0.5:
            k = 1 / k
        ids = pick(pool)
        for i in ids:
            own[i][chan]["values"] = own[i][chan]["values"] * k
            own[i][chan]["step"] = 0
        key, right = f"{chan} scale", 1 / k
    elif fault == "sample_rate_wrong":
        k = 1 + r.uniform(0.02, 0.1) * (1 if r.random() < 0.5 else -1)
        ids = pick(fast)
        for i in ids:
            for c in own[i].values():
                c["dt"] *= k
        key, right = "sample_interval_s factor", 1 / k
    elif fault == "clock_drift":
        ppm = log_uniform(r, 20, 200) * (1 if r.random() < 0.5 else -1)
        ids = pick(fast)
        chan = "force" if r.random() < 0.5 else "second"
        for i in ids:
            c = own[i]["force" if chan == "force" else second(i)]
            v = c["values"]
            t = np.arange(v.size) * c["dt"]
            c["values"] = CubicSpline(t, v)(np.minimum(t * (1 + ppm * 1e-6), t[-1]))
        key, right = f"{chan if chan == 'force' else 'displacement or voltage'} clock ppm", float(ppm)
    elif fault == "channel_skew":
        k = int(r.integers(1, 9)) * (1 if r.random() < 0.5 else -1)
        ids = pick(fast)
        for i in ids:
            c = own[i]["force"]
            v = np.roll(c["values"], k)
            v[:k] = c["values"][0] if k > 0 else v[:k]
            if k < 0:
                v[k:] = c["values"][-1]
            c["values"] = v
        key, right = "force delay in samples", k
    elif fault == "strain_wrong":
        k = 2.0 if r.random() < 0.5 else 0.5
        ids = cyc
        for i in ids:
            metas[i]["strain_pp"] = f"{float(metas[i]['strain_pp']) * k:.4g}"
        key, right = "strain_pp factor", 1 / k
    elif fault == "size_wrong":
        what = str(r.choice(["film_thickness_mm", "active_width_mm", "total_length_mm", "film_length_mm"]))
        if what not in w.meta:
            what = "film_thickness_mm"
        k = float(r.choice([2, 10, 0.5, 0.1]))
        ids = work
        right = float(w.meta[what])
        for i in ids:
            metas[i][what] = f"{right * k:.5g}"
        key = what
    elif fault in ("foreign_recording", "foreign_rig", "specimen_changed"):
        alien = copy.copy(w)
        k = float(np.exp(r.uniform(0.12, 0.6) * (1 if r.random() < 0.5 else -1)))
        if fault == "foreign_rig":
            alien.mass = w.mass * float(np.exp(r.uniform(0.2, 0.8) * (1 if r.random() < 0.5 else -1)))
            alien.kl = w.kl * k
        else:
            alien.k0, alien.ks = w.k0 * k, w.ks * k
            if fault == "foreign_recording":
                alien.taus = w.taus * float(np.exp(r.normal() * 0.4))
            alien.preload = w.preload * k * r.uniform(0.9, 1.1)
        pool = mech or work
        if fault == "specimen_changed":
            at = int(r.integers(max(1, n // 3), max(2, int(0.8 * n))))
            ids = [i for i in work if i >= at]
            if not any(i in ids for i in mech):
                at = max(mech) if mech else at
                ids = [i for i in work if i >= at]
            if k < 1 and r.random() < 0.5:
                alien.gain = w.gain * k  # torn: narrower
        elif fault == "foreign_rig" and every:
            at = int(r.integers(1, n - 1))
            ids = [i for i in work if i >= at]
        else:
            ids = [int(r.choice(pool))]
        alien.recs = [w.recs[i] for i in ids]
        for i, ch in zip(ids, simulate(alien, []), strict=True):
            f = ch["force"] + noise(r, w, w.recs[i], ch["force"].size)
            own[i]["force"]["values"] = np.round(f / w.noise["step"]) * w.noise["step"]
        key = {"foreign_rig": "rig_id", "foreign_recording": "specimen_id"}.get(fault, "specimen from recording on")
        right = names[ids[0]] if fault == "specimen_changed" else None
        if fault == "foreign_rig":
            right = {"clamp_mass_kg": alien.mass * 1e3, "load_cell_stiffness_n_per_mm": alien.kl}
        truth["severity"] = {"stiffness_factor": k}
    elif fault == "dead_channel":
        ids = [int(r.choice(work))]
        chan = "force" if r.random() < 0.6 else second(ids[0])
        c = own[ids[0]][chan]
        level = float(c["values"][0])
        sd = {"force": w.noise["sd"], "displacement": w.x_noise, "voltage": w.v_noise}[chan]
        c["values"] = np.full(c["values"].size, level)
        if r.random() < 0.5:
            c["values"] = np.round((level + sd * r.normal(size=c["values"].size)) / c["step"]) * c["step"]
        key, right = f"{chan} of the recording", None
    elif fault == "mass_entry":
        k = 10.0 if r.random() < 0.5 else 1000.0
        right = float(rigs[0]["clamp_mass_kg"])
        for g in rigs:
            g["clamp_mass_kg"] = f"{right * k:.5g}"
            if k == 1000.0 and r.random() < 2:
                g["clamp_mass_kg_sd"] = f"{float(w.rig['clamp_mass_kg_sd']) * k:.2g}"
        ids = list(range(n))
        key = "clamp_mass_kg"
    elif fault == "gain_changed":
        at = int(r.integers(max(1, n // 3), max(2, int(0.8 * n))))
        if mech and not any(i >= at for i in mech):
            at = max(mech)
        k = float(np.exp(r.uniform(0.05, 0.7) * (1 if r.random() < 0.5 else -1)))
        ids = list(range(at, n))
        for i in ids:
            own[i]["force"]["values"] = own[i]["force"]["values"] * k
            own[i]["force"]["step"] *= k
        key, right = "force scale from this recording on", 1 / k
        truth["severity"] = {"gain": k - 1}
    elif fault == "clipped":
        ids = [int(r.choice(mech or work))]
        chan = "force" if r.random() < 0.6 else second(ids[0])
        v = own[ids[0]][chan]["values"]
        mid, amp = float(np.median(v)), float(np.max(np.abs(v - np.median(v))))
        lim = mid + amp * r.uniform(0.4, 0.85)
        own[ids[0]][chan]["values"] = np.minimum(v, lim)
        if r.random() < 0.5:
            own[ids[0]][chan]["values"] = np.maximum(own[ids[0]][chan]["values"], 2 * mid - lim)
        key, right = f"{chan} range", None
        truth["severity"] = {"limit": float(lim)}
    else:  # drop_out
        ids = [int(r.choice(fast or work))]
        chan = "force" if r.random() < 0.6 else second(ids[0])
        c = own[ids[0]][chan]
        m = c["values"].size
        a = int(m * r.uniform(0.2, 0.6))
        b = min(m - 1, a + int(m * r.uniform(0.03, 0.15)))
        v = c["values"].copy()
        v[a:b] = 0.0 if r.random() < 0.5 else v[a]
        c["values"] = v
        key, right = f"{chan} from sample {a} to {b}", None
    truth["fault"] = {
        "id": FAULT_ID.get(fault, fault),
        "recordings": "all" if len(ids) == n or set(ids) == set(work) else [names[i] for i in ids],
        "key": key,
        "right_value": right,
        "kind": fault,
    }
    truth["form"] = fault
    truth["stage"] = [FAULT_STAGE.get(fault, "record")]


def main() -> None:
    """Command line."""
    seed, kind, folder = int(sys.argv[1]), sys.argv[2], Path(sys.argv[3])
    truth = write_session(seed, kind, folder)
    (folder.parent / f"{folder.name}_truth.json").write_text(json.dumps(truth, indent=1))
    print(json.dumps({k: truth[k] for k in ("kind", "listed", "fault", "unlisted", "form", "strength")}))


if __name__ == "__main__":
    main()
