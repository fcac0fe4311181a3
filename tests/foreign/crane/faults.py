"""Everyday faults put into a clean session."""

from __future__ import annotations

import copy

import numpy as np

from .session import Session


def _truth(fid: str, recs, key: str = "", value="", detail: str = "") -> dict:
    return {"id": fid, "recordings": recs, "key": key, "right_value": value, "detail": detail}


def choose_fault(sess: Session, rng: np.random.Generator) -> str:
    """One of the faults that this session can show, evenly."""
    el = any(r.loading == "electrical" for r in sess.recs)
    cyc = any(r.protocol == "cyclic" for r in sess.recs)
    names = [*SIMPLE, "foreign_recording", "specimen_changed", "recording_other_rig"]
    if not cyc:
        names.remove("strain_wrong")
    if not el:
        names.remove("size_wrong")
    return str(rng.choice(names))


def foreign_recording(sess, out, t0, rng, simulate, plain_cfg):
    """One recording is of another specimen."""
    live = [r for r in sess.recs if r.loading == "mechanical"]
    rec = live[int(rng.integers(len(live)))]
    f = copy.deepcopy(sess.film)
    sc = float(np.exp(rng.choice([-1, 1]) * rng.uniform(0.35, 0.9)))
    f["k0"], f["ki"], f["ti"] = f["k0"] * sc, f["ki"] * sc * rng.uniform(0.6, 1.6), f["ti"] * rng.uniform(0.4, 2.5)
    o = simulate(sess, plain_cfg(sess), t0 * max(sc, 0.5) ** 0.8, 8000, f, {rec.rid})
    i = sess.recs.index(rec)
    return [*out[:i], o[i], *out[i + 1 :]], _truth(
        "foreign_recording", [rec.rid], "specimen_id", "another specimen", f"scale {sc:.3f}"
    )


def specimen_changed(sess, out, t0, rng, simulate, plain_cfg):
    """Re-clamped or torn from a recording on."""
    live = [i for i, r in enumerate(sess.recs) if r.loading == "mechanical"]
    i = live[int(rng.integers(1, len(live)))] if len(live) > 1 else live[0]
    f = copy.deepcopy(sess.film)
    torn = rng.random() < 0.5
    sc = float(rng.uniform(0.6, 0.92)) if torn else float(rng.choice([rng.uniform(0.75, 0.93), rng.uniform(1.07, 1.3)]))
    f["k0"], f["ki"] = f["k0"] * sc, f["ki"] * sc
    if torn:
        f["ka"] = f["ka"] * sc
    tn = t0 * (sc if torn else float(rng.uniform(0.85, 1.15)))
    ids = {r.rid for r in sess.recs[i:]}
    o = simulate(sess, plain_cfg(sess), tn, 8000, f, ids)
    return out[:i] + o[i:], _truth(
        "specimen_changed",
        [r.rid for r in sess.recs[i:]],
        "specimen_id",
        "new specimen from here",
        f"{'torn' if torn else 're-clamped'}, stiffness x {sc:.3f}",
    )


def recording_other_rig(sess, out, t0, rng, simulate, plain_cfg):
    """One recording (a sweep where there is one) comes from another rig."""
    live = [r for r in sess.recs if r.protocol in ("chirp", "sphs")]
    rec = live[int(rng.integers(len(live)))]
    c = plain_cfg(sess)
    c.mass *= float(np.exp(rng.choice([-1, 1]) * rng.uniform(0.4, 1.0)))
    c.kl *= float(np.exp(rng.choice([-1, 1]) * rng.uniform(0.3, 0.9)))
    o = simulate(sess, c, t0, 8000, None, {rec.rid})
    i = sess.recs.index(rec)
    return [*out[:i], o[i], *out[i + 1 :]], _truth(
        "foreign_rig", [rec.rid], "rig_id", "another rig", f"mass {c.mass * 1e3:.4g} kg, stiffness {c.kl:.4g} N/mm"
    )


FAULTS = {
    "foreign_recording": foreign_recording,
    "specimen_changed": specimen_changed,
    "recording_other_rig": recording_other_rig,
}

SIMPLE = [
    "channels_swapped",
    "sign_one",
    "sign_all",
    "unit_one",
    "unit_all",
    "rate_one",
    "rate_all",
    "clock_drift",
    "skew",
    "strain_wrong",
    "size_wrong",
    "rig_of_another",
    "dead_channel",
    "drop_out",
    "mass_wrong",
    "gain_from",
    "clipped",
]


def apply_fault(name: str, sess: Session, data: list, rng: np.random.Generator) -> dict:
    """Change channels or metadata; returns the truth of the fault."""
    live = [d for d in data if d["rec"].loading != "calibration"]
    mech = [d for d in live if d["rec"].loading == "mechanical"]
    quick = [d for d in live if d["rec"].protocol in ("chirp", "sphs")]
    d = live[int(rng.integers(len(live)))]
    dm = mech[int(rng.integers(len(mech)))]
    dq = quick[int(rng.integers(len(quick)))]

    def other(x) -> str:
        return "displacement" if "displacement" in x["ch"] else "voltage"

    if name == "channels_swapped":
        a, b = dm["ch"]["force"], dm["ch"]["displacement"]
        a["values"], b["values"] = b["values"], a["values"]
        a["dt"], b["dt"] = b["dt"], a["dt"]
        return _truth("channels_swapped", [dm["rec"].rid], "columns", "force<->displacement")
    if name in ("sign_one", "sign_all"):
        q = "force" if rng.random() < 0.6 else "displacement"
        sel = [dm] if name == "sign_one" else [x for x in data if q in x["ch"]]
        for x in sel:
            x["ch"][q]["values"] = -x["ch"][q]["values"]
        return _truth("sign_flipped", [dm["rec"].rid] if name == "sign_one" else "all", f"{q}.scale", -1)
    if name in ("unit_one", "unit_all"):
        q = str(rng.choice(["force", "displacement"]))
        fac = float(rng.choice([10, 1000, 9.81, 2, 2 * 2**0.5] if name == "unit_one" else [10, 1000, 9.81]))
        fac = fac if rng.random() < 0.5 else 1 / fac
        if name == "unit_one" and rng.random() < 0.3 and any(x["rec"].loading == "electrical" for x in live):
            q = "voltage"
        pool = [x for x in live if q in x["ch"]]
        sel = [pool[int(rng.integers(len(pool)))]] if name == "unit_one" else [x for x in data if q in x["ch"]]
        for x in sel:
            x["ch"][q]["values"] = x["ch"][q]["values"] * fac
            if x["ch"][q].get("resolution"):
                x["ch"][q]["resolution"] *= fac
        return _truth("unit_slip", [x["rec"].rid for x in sel] if name == "unit_one" else "all", f"{q}.scale", 1 / fac)
    if name in ("rate_one", "rate_all"):
        fac = 1 + float(rng.uniform(0.02, 0.1)) * float(rng.choice([-1, 1]))
        sel = [dq] if name == "rate_one" else data
        for x in sel:
            for c in x["ch"].values():
                c["dt"] *= fac
        return _truth(
            "sample_rate_wrong", [dq["rec"].rid] if name == "rate_one" else "all", "sample_interval_s", 1 / fac
        )
    if name == "clock_drift":
        ppm = float(rng.uniform(20, 200) * rng.choice([-1, 1]))
        for x in live:
            c = x["ch"]["force"]
            n = len(c["values"])
            k = np.arange(n)
            base = np.interp(k * (1 + ppm * 1e-6), k, x["o"]["force"])
            c["values"] = c["values"] - x["o"]["force"] + base
        return _truth(
            "clock_drift",
            "all",
            "force.sample_interval_s",
            f"{ppm:.1f} ppm",
            "true interval of force = stated x (1 + ppm)",
        )
    if name == "skew":
        k = int(rng.integers(1, 9)) * int(rng.choice([-1, 1]))
        c = dq["ch"]["force"]
        c["values"] = (
            np.concatenate([np.full(k, c["values"][0]), c["values"][:-k]])
            if k > 0
            else np.concatenate([c["values"][-k:], np.full(-k, c["values"][-1])])
        )
        return _truth("channel_skew", [dq["rec"].rid], "force.delay_s", k * c["dt"], f"{k} samples late")
    if name == "strain_wrong":
        fac = float(rng.choice([0.5, 2.0]))
        v = {}
        for x in live:
            if "strain_pp" in x["meta"]:
                v[x["rec"].rid] = x["meta"]["strain_pp"]
                x["meta"]["strain_pp"] = x["meta"]["strain_pp"] * fac
        return _truth("strain_wrong", list(v), "strain_pp", v)
    if name == "size_wrong":
        key = str(rng.choice(["film_length_mm", "film_width_mm", "film_thickness_mm"]))
        fac = float(rng.choice([0.1, 0.5, 2, 10]))
        right = data[0]["meta"][key]
        for x in data:
            x["meta"][key] = round(right * fac, 5)
        return _truth("size_wrong", "all", key, right)
    if name == "rig_of_another":
        right = {k: data[0]["rig"][k] for k in ("clamp_mass_kg", "load_cell_stiffness_n_per_mm")}
        fm = float(np.exp(rng.choice([-1, 1]) * rng.uniform(0.4, 1.0)))
        fk = float(np.exp(rng.choice([-1, 1]) * rng.uniform(0.3, 0.9)))
        for x in data:
            for k, q in (("clamp_mass_kg", fm), ("load_cell_stiffness_n_per_mm", fk)):
                x["rig"][k] = float(f"{x['rig'][k] * q:.6g}")
                x["rig"][k + "_sd"] = float(f"{x['rig'][k + '_sd'] * q:.6g}")
        return _truth("foreign_rig", "all", "rig", right)
    if name == "dead_channel":
        q = "force" if rng.random() < 0.6 else other(d)
        c = d["ch"][q]
        sd = {"force": sess.noise["force"], "displacement": sess.noise["x"], "voltage": sess.noise["v"]}[q]
        n = len(c["values"])
        level = float(c["values"][0])
        c["values"] = np.full(n, level) if rng.random() < 0.5 else level + sd * rng.standard_normal(n)
        return _truth("dead_channel", [d["rec"].rid], q, "no data")
    if name == "drop_out":
        c = dq["ch"]["force" if rng.random() < 0.6 else other(dq)]
        n = len(c["values"])
        a = int(n * rng.uniform(0.25, 0.6))
        b = a + int(n * rng.uniform(0.08, 0.25))
        c["values"] = c["values"].copy()
        c["values"][a:b] = 0.0 if rng.random() < 0.5 else c["values"][a]
        q = next(k for k, v in dq["ch"].items() if v is c)
        return _truth("dead_channel", [dq["rec"].rid], q, f"lost from {a * c['dt']:.2f} to {b * c['dt']:.2f} s")
    if name == "mass_wrong":
        right = data[0]["rig"]["clamp_mass_kg"]
        fac = float(rng.choice([10.0, 1000.0]))
        for x in data:
            for k in ("clamp_mass_kg", "clamp_mass_kg_sd"):
                x["rig"][k] = float(f"{x['rig'][k] * fac:.6g}")
        return _truth("rig_constants", "all", "clamp_mass_kg", right)
    if name == "gain_from":
        i = int(rng.integers(1, len(live)))
        g = float(rng.choice([rng.uniform(0.7, 0.95), rng.uniform(1.05, 1.4)]))
        for x in live[i:]:
            x["ch"]["force"]["values"] = x["ch"]["force"]["values"] * g
        return _truth("gain_error", [x["rec"].rid for x in live[i:]], "force.scale", 1 / g)
    c = dm["ch"]["force"]
    v = c["values"]
    mid = v.mean()
    lim = mid + (v.max() - mid) * float(rng.uniform(0.4, 0.8))
    low = -np.inf if rng.random() < 0.5 else mid + (v.min() - mid) * 0.7
    c["values"] = np.clip(v, low, lim)
    return _truth("sensor_saturation", [dm["rec"].rid], "force", f"clipped at {lim:.4g} N")
