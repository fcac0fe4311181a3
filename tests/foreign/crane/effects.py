"""Hidden effects: listed mechanisms in several forms each, and effects that no id names.

Each effect has a severity s that goes to zero with the effect. `apply(cfg, s)` puts it into the configuration.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.signal import lfilter

from . import sim
from .session import Rec, Session

G = np.linspace(0, 1.5, sim.NLUT)
GS = np.linspace(-1.3, 1.3, sim.NLUT)


@dataclass
class Cfg:
    """What one simulation runs with: hooks per stage, all neutral at first."""

    mass: float = 1.0
    kl: float = 1.0
    cl: float = 1.0
    strip: dict | None = None
    fcode: int = 0
    fp: np.ndarray = field(default_factory=lambda: np.zeros(8))
    ft: np.ndarray = field(default_factory=lambda: np.zeros(sim.NLUT))
    ak: np.ndarray = field(default_factory=lambda: np.zeros(0))
    at: np.ndarray = field(default_factory=lambda: np.ones(0))
    amode: int = 0
    ccode: int = 0
    cp: np.ndarray = field(default_factory=lambda: np.zeros(8))
    rcode: int = 0
    rp: np.ndarray = field(default_factory=lambda: np.ones(8))
    rt: np.ndarray = field(default_factory=lambda: np.zeros(sim.NLUT))
    drive: list[Callable] = field(default_factory=list)
    act: list[Callable] = field(default_factory=list)
    soft: list[Callable] = field(default_factory=list)
    move: list[Callable] = field(default_factory=list)
    xsens: list[Callable] = field(default_factory=list)
    sens: list[Callable] = field(default_factory=list)
    drift: list[Callable] = field(default_factory=list)
    current: Callable | None = None
    t0: float | None = None


@dataclass
class Effect:
    """One hidden effect."""

    name: str
    stage: str
    form: str
    textbook: bool
    apply: Callable[[Cfg, float], None]
    start: float
    cap: float
    depends: list[str]
    severity: Callable[[float], dict]
    params: dict
    needs_t0: bool = False


def spline(rng: np.random.Generator, grid: np.ndarray = G, knots: int = 6, power: float = 1.0) -> np.ndarray:
    """Monotone random table with 0 at 0, 1 at 1."""
    k = np.linspace(0, 1.5, knots + 3)
    inc = rng.gamma(0.8, 1.0, knots + 2) * (k[1:] ** (power - 1)) + 0.02
    f = PchipInterpolator(k, np.concatenate([[0], np.cumsum(inc)]))
    return f(np.minimum(grid, 1.5)) / f(1.0)


def table(rng: np.random.Generator, name: str) -> np.ndarray:
    """Named maps of 0…1.5 with 0 at 0 and 1 at 1."""
    u = G
    if name == "hill":
        m, a = rng.uniform(1, 2), rng.uniform(0.6, 1.5)
        f = (u / a) ** m / (1 + (u / a) ** m)
        return f * (1 + (1 / a) ** m) / (1 / a) ** m
    if name == "threshold":
        a = rng.uniform(0.2, 0.5)
        return np.maximum(u - a, 0) / (1 - a)
    if name == "step":
        a, w = rng.uniform(0.4, 0.7), rng.uniform(0.03, 0.1)
        f = 1 / (1 + np.exp(-(u - a) / w))
        return (f - f[0]) / (np.interp(1, u, f) - f[0])
    if name == "exp":
        a = rng.uniform(0.3, 0.8)
        return (1 - np.exp(-u / a)) / (1 - np.exp(-1 / a))
    if name == "square":
        return u**2
    if name == "saturating":
        a = rng.uniform(0.3, 0.8)
        return u**2 / (u**2 + a**2) * (1 + a**2)
    return spline(rng)


FORMS: dict[str, list[str]] = {
    "rig_constants": ["mass_and_stiffness", "load_dependent_stiffness", "cable_mass", "mount_relaxation"],
    "load_cell_damping": ["viscous", "quadratic_drag", "dry_friction", "second_resonance", "play"],
    "drive_lag": ["first_order", "rise_and_fall", "rate_dependent", "slew", "two_states"],
    "amplitude_softening": ["hill_running", "threshold_running", "spline_running", "spline_instant", "structure"],
    "cyclic_softening": ["exp_strain", "threshold_path", "spline_work", "two_populations", "time_under_strain"],
    "missing_relaxation": ["one_arm", "stretched", "two_arms", "load_dependent_time", "box_of_times"],
    "power_law_relaxation": ["ladder", "two_slopes", "load_dependent", "log_steps"],
    "baseline_drift": ["log", "exponential", "power", "spline_session", "two_states"],
    "thermal_softening": ["first_order", "work_heated", "threshold", "two_states", "spline"],
    "field_dependent_permittivity": ["quadratic", "threshold", "saturating", "spline", "lagged"],
    "frequency_dependent_permittivity": [
        "log_ladder",
        "one_state",
        "two_states",
        "field_dependent_time",
        "random_ladder",
    ],
    "electrode_degradation": ["cycles_exp", "exposure_exp", "exposure_threshold", "spline_exposure", "voltage_rate"],
    "slack": ["clip", "reduced_slope", "soft", "fibres", "late_return"],
    "strain_stiffening": ["gent", "ogden", "engagement", "langevin", "spline_with_state"],
    "sensor_delay": [
        "shift_force",
        "pole_force",
        "two_pole_force",
        "shift_displacement",
        "pole_displacement",
        "buffer_steps",
    ],
    "gain_error": ["from_recording", "weights", "warm_up", "two_slopes", "range_switch"],
    "drive_offset": ["constant", "decaying", "dead_zone", "per_recording", "smooth_rectified"],
    "leakage": ["power", "threshold", "poole_frenkel", "growing", "spline"],
    "wrinkling": ["cap", "spline_cap", "slow_return", "two_thresholds", "reduced_growth"],
    "clamp_slip": ["coulomb", "bouc_wen", "creep", "stribeck", "two_patches"],
    "mains_hum": ["two_lines", "modulated", "rectified", "wandering"],
    "sensor_saturation": ["hard", "soft", "one_sided", "late_release"],
    "passive_strip": ["one_state", "two_states", "slower_arms", "spread_states"],
}
STAGE = {
    **dict.fromkeys(["drive_lag", "drive_offset", "leakage"], "drive"),
    **dict.fromkeys(
        ["field_dependent_permittivity", "frequency_dependent_permittivity", "electrode_degradation", "wrinkling"],
        "actuation",
    ),
    **dict.fromkeys(
        [
            "amplitude_softening",
            "cyclic_softening",
            "missing_relaxation",
            "power_law_relaxation",
            "thermal_softening",
            "slack",
            "strain_stiffening",
            "passive_strip",
        ],
        "film",
    ),
    "clamp_slip": "contact",
    "rig_constants": "rig",
    "load_cell_damping": "rig",
    **dict.fromkeys(["sensor_delay", "gain_error", "mains_hum", "sensor_saturation"], "sensor"),
    "baseline_drift": "drift",
}
CAP = {
    "rig_constants": 0.4,
    "load_cell_damping": 0.06,
    "drive_lag": 0.02,
    "amplitude_softening": 0.6,
    "cyclic_softening": 0.5,
    "missing_relaxation": 1.2,
    "power_law_relaxation": 1.2,
    "baseline_drift": 0.2,
    "thermal_softening": 0.45,
    "field_dependent_permittivity": 0.3,
    "frequency_dependent_permittivity": 0.12,
    "electrode_degradation": 0.8,
    "slack": 1.0,
    "strain_stiffening": 0.6,
    "sensor_delay": 0.004,
    "gain_error": 0.4,
    "drive_offset": 1.0,
    "leakage": 0.4,
    "wrinkling": 1.0,
    "clamp_slip": 6.0,
    "mains_hum": 0.04,
    "sensor_saturation": 1.0,
    "passive_strip": 1.0,
}
DEP = {
    "rig_constants": ["frequency"],
    "load_cell_damping": ["frequency"],
    "drive_lag": ["frequency"],
    "amplitude_softening": ["amplitude"],
    "cyclic_softening": ["largest_strain", "cycle"],
    "missing_relaxation": ["frequency"],
    "power_law_relaxation": ["frequency"],
    "baseline_drift": ["record_time"],
    "thermal_softening": ["session_time"],
    "field_dependent_permittivity": ["voltage"],
    "frequency_dependent_permittivity": ["frequency"],
    "electrode_degradation": ["exposure"],
    "slack": ["amplitude"],
    "strain_stiffening": ["amplitude"],
    "sensor_delay": ["frequency"],
    "gain_error": [],
    "drive_offset": ["voltage"],
    "leakage": ["voltage"],
    "wrinkling": ["voltage"],
    "clamp_slip": ["amplitude"],
    "mains_hum": ["record_time"],
    "sensor_saturation": ["amplitude"],
    "passive_strip": ["frequency"],
}
KEY = {
    "drive_lag": "rise_time_constant_s",
    "amplitude_softening": "drop",
    "cyclic_softening": "loss",
    "missing_relaxation": "stiffness_ratio",
    "power_law_relaxation": "stiffness_ratio",
    "baseline_drift": "per_decade",
    "field_dependent_permittivity": "fraction",
    "frequency_dependent_permittivity": "per_decade",
    "electrode_degradation": "loss",
    "strain_stiffening": "stiffening",
    "sensor_delay": "delay_s",
    "gain_error": "gain",
    "drive_offset": "offset_kv",
    "leakage": "droop",
    "load_cell_damping": "damping_ratio",
    "mains_hum": "amplitude_n",
}


def first(u: np.ndarray, dt: float, tau: float) -> np.ndarray:
    """First-order state from rest."""
    a = np.exp(-dt / tau)
    g = tau * (1 - a) / dt
    return lfilter([1 - g, g - a], [1, -a], u)


def possible(sess: Session) -> list[str]:
    """Mechanisms that these recordings can show."""
    pr = [(r.protocol, r.loading) for r in sess.recs]
    ch, sp = ("chirp", "mechanical") in pr, ("sphs", "electrical") in pr
    large = {
        round(r.p["amp"], 9) if r.protocol == "chirp" else r.p["pp"] for r in sess.recs if r.loading == "mechanical"
    }
    out = [
        "missing_relaxation",
        "power_law_relaxation",
        "baseline_drift",
        "thermal_softening",
        "mains_hum",
        "sensor_saturation",
        "gain_error",
    ]
    if len(large) > 1:
        out += ["amplitude_softening", "cyclic_softening", "slack", "strain_stiffening", "clamp_slip"]
    if ch:
        out += ["sensor_delay"]
        fr = np.sqrt((sess.rig["kl"] + sess.film["k0"]) / sess.rig["mass"]) / 2 / np.pi
        if max(r.p["f2"] for r in sess.recs if r.protocol == "chirp") > 0.6 * fr:
            out += ["rig_constants", "load_cell_damping"]
    if sp:
        nv = len({r.p["kv"] for r in sess.recs if r.loading == "electrical"})
        out += ["drive_lag", "frequency_dependent_permittivity", "electrode_degradation"]
        if nv > 1:
            out += ["field_dependent_permittivity", "drive_offset", "leakage", "wrinkling"]
        if sess.film["partial"]:
            out += ["passive_strip"]
    return out


def listed(name: str, form: str, sess: Session, rng: np.random.Generator, ref: dict) -> Effect:
    """Build a listed mechanism in a form; `ref` has emax, load, peak, fmax, vmax of the clean session."""
    i = FORMS[name].index(form)
    f, rig = sess.film, sess.rig
    k0, kinf = f["k0"], f["k0"] + f["ki"].sum()
    emax, vmax, peak = ref["emax"], ref["vmax"], ref["peak"]
    span = ref["span"]
    par: dict = {}
    needs = False

    def sev(s: float) -> dict:
        return {KEY.get(name, "size"): s}

    dep = list(DEP[name])
    cap = CAP[name]
    sign = float(rng.choice([-1, 1]))
    if name == "rig_constants":
        part = float(rng.choice([0.0, 0.35, 0.65, 1.0]))
        par = {
            "sign": sign,
            "part_of_mass": part,
            "sign2": float(rng.choice([-1, 1])),
            "f2_hz": float(rng.uniform(160, 300)),
        }
        par["tau_s"] = float(np.exp(rng.uniform(np.log(0.003), np.log(0.05))))
        tb = spline(rng, np.abs(GS))

        def ap(c: Cfg, s: float) -> None:
            if i == 0:
                c.mass *= 1 + sign * s * part
                c.kl *= 1 + par["sign2"] * s * (1 - part)
            elif i == 1:
                c.rcode = 3
                c.kl *= 1 + sign * s * 0.3
                c.rp[0], c.rp[1], c.rt = sign * s * c.kl, peak / c.kl, tb
            elif i == 2:  # a cable or bolt that is held on the clamp by a stiff spring
                c.rcode = 4
                c.rp[0], c.rp[1], c.rp[2] = s * c.mass, 2 * np.pi * par["f2_hz"], 0.1
            else:  # the mount of the cell relaxes: stiffer when driven fast
                c.rcode = 6
                c.rp[0], c.rp[1] = s * c.kl, par["tau_s"]

        def sev(s: float) -> dict:
            if i == 0:
                o = {"mass_error": sign * s * part, "stiffness_error": par["sign2"] * s * (1 - part)}
                return {k: v for k, v in o.items() if v}
            return {"mass_error": s} if i == 2 else {"stiffness_error": sign * s if i == 1 else s}

    elif name == "load_cell_damping":
        w = np.sqrt((rig["kl"] + kinf) / rig["mass"])
        xr = ref["dyn"] / rig["kl"]
        par = {
            "f2_hz": float(np.clip(w / 2 / np.pi * rng.choice([0.55, 0.75, 1.3]), 8, 140)),
            "z2": rng.uniform(0.01, 0.05),
        }

        def ap(c: Cfg, s: float) -> None:
            cc = 2 * s * np.sqrt(c.kl * c.mass)
            if i == 0:
                c.cl += cc
            elif i == 1:
                c.rcode, c.rp[0] = 1, cc * 3 * np.pi / 8 / (w * xr)
            elif i == 2:
                c.rcode, c.rp[0], c.rp[1] = 2, cc * w * xr * np.pi / 4, w * xr * 0.1
            elif i == 3:
                c.rcode = 4
                c.rp[0], c.rp[1], c.rp[2] = 4 * s * c.mass, 2 * np.pi * par["f2_hz"], par["z2"]
                c.mass *= 1 - 2 * s
            else:
                c.rcode, c.rp[0], c.rp[1] = 5, 4 * s * c.kl, 4 * s * c.kl * xr * 0.4
    elif name == "drive_lag":
        par = {"fall_over_rise": float(rng.uniform(2, 6))}

        def ap(c: Cfg, s: float) -> None:
            def d(v: np.ndarray, dt: float, st: dict, rec: Rec) -> np.ndarray:
                if i == 0:
                    return first(v, dt, s)
                if i == 1:
                    return sim.lag(v, dt, s, s * par["fall_over_rise"], 0.0, 0)
                if i == 2:
                    return sim.lag(v, dt, s, s, 0.0, 1)
                if i == 3:
                    return sim.lag(v, dt, 0.3 * s, 0.3 * s, 0.15 * vmax / s, 0)
                return 0.6 * first(v, dt, 0.4 * s) + 0.4 * first(v, dt, 2 * s)

            c.drive.append(d)

        def sev(s: float) -> dict:
            o = {"rise_time_constant_s": s}
            if i == 1:
                o["fall_time_constant_s"] = s * par["fall_over_rise"]
            if i == 3:
                o = {"rise_time_constant_s": 0.3 * s, "slew_kv_per_s": 0.15 * vmax / s}
            return o
    elif name == "amplitude_softening":
        tb = table(rng, ["hill", "threshold", "spline", "spline", "exp"][i])
        par = {"hold_s": float(rng.uniform(0.5, 3)), "structure_s": float(rng.uniform(0.05, 0.4))}

        def ap(c: Cfg, s: float) -> None:
            c.fcode, c.ft = 1, tb
            scale = ref["amax"] if i != 3 else emax
            c.fp[:5] = [s, scale, par["hold_s"], [0, 0, 0, 1, 2][i], par["structure_s"]]

        def sev(s: float) -> dict:
            return {"drop": s, "strain_scale": 0.5 * ref["amax"] / f["l1"]}
    elif name == "cyclic_softening":
        tb = table(rng, ["exp", "threshold", "spline", "exp", "spline"][i])
        par = {"cycles": float(np.exp(rng.uniform(np.log(2), np.log(30)))), "rate": float(rng.uniform(0.5, 3))}

        def ap(c: Cfg, s: float) -> None:
            c.fcode, c.ft = 2, tb
            c.fp[:6] = [s, ref["amax"], par["cycles"], [0, 0, 1, 0, 2][i], par["rate"], 0.5 if i == 3 else 0.0]

        def sev(s: float) -> dict:
            return {"loss": s, "cycles": par["cycles"]}
    elif name == "missing_relaxation":
        lo, hi = (np.log(0.3), np.log(12)) if rng.random() < 0.5 else (np.log(2e-3), np.log(0.3))
        tx = float(np.exp(rng.uniform(lo, hi)))
        if i == 0:
            w, tt = np.array([1.0]), np.array([tx])
        elif i == 1:
            z = np.linspace(-2.0, 1.2, 8)
            w, tt = np.exp(0.6 * z - 0.35 * np.exp(z)), tx * 10 ** (z / 2)
        elif i == 2:
            w, tt = np.array([0.6, 0.4]), np.array([tx, tx / rng.uniform(8, 40)])
        elif i == 3:
            w, tt = np.array([1.0]), np.array([tx])
        else:
            tt = tx * 10 ** np.linspace(-0.7, 0.7, 7)
            w = rng.gamma(1.5, 1.0, 7)
        w = w / w.sum()
        par = {"time_constant_s": tx}

        def ap(c: Cfg, s: float) -> None:
            c.ak, c.at = s * k0 * w, np.maximum(tt, 3e-4)
            if i == 3:
                c.amode = 1
                c.rp[7] = 0.3 * s * k0 * emax

        def sev(s: float) -> dict:
            return {"stiffness_ratio": s, "time_constant_s": tx}
    elif name == "power_law_relaxation":
        al = float(rng.uniform(0.12, 0.4))
        tt = 10 ** np.linspace(1.9, -3.2, 16)
        a2 = al * np.where(tt > 0.05, rng.uniform(0.5, 0.8), 1.2) if i == 1 else np.full(16, al)
        step = np.log(tt[0] / tt[1])
        w = np.sin(np.pi * al) / np.pi * step * (tt / 1.0) ** (-a2)
        if i == 1:
            w *= np.where(tt > 0.05, 0.05 ** (a2 - al * 1.2), 1.0)
        if i == 3:
            w[::2] *= 1.9
            w[1::2] *= 0.1
        par = {"exponent": al}

        def ap(c: Cfg, s: float) -> None:
            c.ak, c.at = s * k0 * w, tt
            if i == 2:
                c.amode = 1
                c.rp[7] = 0.15 * s * k0 * emax

        def sev(s: float) -> dict:
            return {"exponent": al, "stiffness_ratio": s}
    elif name == "baseline_drift":
        par = {
            "restart": bool(rng.random() < 0.5) if i != 3 else False,
            "t0": float(rng.uniform(1, 20)),
            "tau": float(rng.uniform(5, 40)),
        }
        tb = spline(rng, G)

        def ap(c: Cfg, s: float) -> None:
            def d(y: np.ndarray, t: np.ndarray, rec: Rec, st: dict, base: float) -> np.ndarray:
                tt = t if par["restart"] else t + rec.t0
                a = -s * base
                if i == 0:
                    return y + a * np.log10(1 + tt / par["t0"])
                if i == 1:
                    return y + 2 * a * (1 - np.exp(-tt / (par["tau"] * (1 if par["restart"] else 8))))
                if i == 2:
                    return y + a * (tt / 10) ** 0.3
                if i == 3:
                    return y + 3 * a * np.interp(tt / span, G, tb)
                return y + a * (1.5 * (1 - np.exp(-tt / 6)) + 1.0 * (1 - np.exp(-tt / 90)))

            c.drift.append(d)

        if not par["restart"]:
            dep = ["session_time"]
    elif name == "thermal_softening":
        par = {"tau_s": float(span * rng.uniform(0.1, 0.6)), "kelvin": float(rng.uniform(3, 8)), "sign": 1.0}
        tb = spline(rng, G)
        pw = ref["power"]
        if i == 1:
            dep = ["exposure"]
            par["tau_s"] = float(rng.uniform(30, 300))

        def tempf(t: np.ndarray, dt: float, st: dict, rec: Rec, x: np.ndarray | None) -> np.ndarray:
            ts = rec.t0 + t
            if i == 0 or i == 2:
                u = (1 - np.exp(-ts / par["tau_s"])) / (1 - np.exp(-span / par["tau_s"]))
            elif i == 1:
                last, val = st.get("th", (0.0, 0.0))
                val *= np.exp(-(rec.t0 - last) / par["tau_s"])
                q = np.gradient(x, dt) ** 2 / pw if x is not None else np.zeros_like(t)
                u = sim.lag_from(q, dt, par["tau_s"], par["tau_s"], val)
                st["th"] = (rec.t0 + t[-1], float(u[-1]))
            elif i == 3:
                u = 0.5 * (1 - np.exp(-ts / (span / 20))) + 0.5 * (1 - np.exp(-ts / (span / 2))) / 0.865
            else:
                u = np.interp(ts / span, G, tb)
            return u

        def ap(c: Cfg, s: float) -> None:
            def so(t: np.ndarray, dt: float, st: dict, rec: Rec, x: np.ndarray) -> np.ndarray:
                u = tempf(t, dt, st, rec, x)
                st["tu"] = u * par["kelvin"]
                return 1 - s * (np.maximum(u - 0.3, 0) / 0.7 if i == 2 else u)

            c.soft.append(so)

        def sev(s: float) -> dict:
            return {"per_kelvin": s / par["kelvin"], "rise_k": par["kelvin"]}
    elif name == "field_dependent_permittivity":
        tb = table(rng, ["square", "threshold", "saturating", "spline", "square"][i])
        par = {"tau_s": float(rng.uniform(0.05, 1.0))}

        def ap(c: Cfg, s: float) -> None:
            def a(fa: np.ndarray, v: np.ndarray, dt: float, st: dict, rec: Rec) -> np.ndarray:
                u = np.abs(v) / vmax
                if i == 4:
                    u = np.sqrt(np.maximum(first(u * u, dt, par["tau_s"]), 0))
                return fa * (1 - s * np.interp(u, G, tb))

            c.act.append(a)
    elif name == "frequency_dependent_permittivity":
        if i in (0, 4):
            tt = 10 ** np.linspace(0.8, -2.8, 11)
            w = np.full(11, 0.36) * (rng.gamma(1.2, 1 / 1.2, 11) if i == 4 else 1)
        elif i == 2:
            tt, w = np.array([rng.uniform(0.3, 1), rng.uniform(0.005, 0.02)]), np.array([1.4, 1.4])
        else:
            tt, w = np.array([np.exp(rng.uniform(np.log(0.004), np.log(0.1)))]), np.array([2.5])
        par = {"times": [float(q) for q in tt]}

        def ap(c: Cfg, s: float) -> None:
            def a(fa: np.ndarray, v: np.ndarray, dt: float, st: dict, rec: Rec) -> np.ndarray:
                o = fa * (1 - s * w.sum() * 0.5)
                for q, wt in zip(tt, w, strict=True):
                    o = o + s * wt * (sim.lag(fa, dt, q, q, 0.0, 1) if i == 3 else first(fa, dt, q))
                return o

            c.act.append(a)
    elif name == "electrode_degradation":
        tot = ref["exposure"]
        tb = [None, None, table(rng, "threshold"), spline(rng), None][i]
        par = {"cycles": float(rng.uniform(100, 400)), "share": float(rng.uniform(0.2, 0.8))}
        if i == 0:
            dep = ["cycle"]

        def ap(c: Cfg, s: float) -> None:
            def a(fa: np.ndarray, v: np.ndarray, dt: float, st: dict, rec: Rec) -> np.ndarray:
                x0 = st.get("ex", 0.0)
                rate = (v * v if i != 4 else v**4 / vmax**2) / tot
                if i == 0:  # cycles of the drive: path of V² over twice its largest value
                    rate = np.abs(np.gradient(v * v)) / dt / (2 * vmax**2) / par["cycles"]
                x = x0 + np.cumsum(rate) * dt
                st["ex"] = float(x[-1])
                if i in (2, 3):
                    m = np.interp(np.minimum(x, 1.5), G, tb)
                elif i == 0:
                    m = 1 - np.exp(-x)
                else:
                    m = (1 - np.exp(-x / par["share"])) / (1 - np.exp(-1 / par["share"]))
                return fa * (1 - s * m)

            c.act.append(a)

        def sev(s: float) -> dict:
            return {"loss": s, "cycles": par["cycles"]}
    elif name == "slack":
        load = ref["load"]
        needs = True
        th0 = 0.0 if i == 0 else float(rng.uniform(0, 0.15)) * load
        tb = np.interp(np.linspace(0, 3, sim.NLUT), *_fibres(rng))
        par = {
            "residual": float(rng.uniform(0.05, 0.3)) if i != 0 else 0.0,
            "onset_tension_n": th0,
            "tau_s": float(rng.uniform(0.01, 0.1)),
        }

        def ap(c: Cfg, s: float) -> None:
            c.fcode, c.ft = 4, tb
            c.t0 = load / (1 + s) + th0
            w = [1.0, 1.0, 0.06 * load, 0.25 * load, par["tau_s"]][i]
            c.fp[:4] = [th0, [0, 0, 1, 2, 3][i], par["residual"], w]

        def sev(s: float) -> dict:
            return {"onset": 1 / (1 + s), "excess": s}
    elif name == "strain_stiffening":
        ft = _stiff(rng, i, f["lam"], emax / f["l1"])
        par = {"tau_s": float(rng.uniform(0.05, 0.5)), "relaxing": 0.5 if i == 4 else 0.0}

        def ap(c: Cfg, s: float) -> None:
            c.fcode, c.ft = 3, ft
            c.fp[:4] = [s * k0 * emax * 0.5, emax, par["relaxing"], par["tau_s"]]
    elif name == "sensor_delay":
        par = {"channel": "displacement" if i in (3, 4) else "force", "block_s": float(rng.uniform(1, 4))}

        def ap(c: Cfg, s: float) -> None:
            def d(y: np.ndarray, t: np.ndarray, rec: Rec, st: dict | None = None) -> np.ndarray:
                if i in (0, 3):
                    return np.interp(t - s, t, y)
                if i == 5:  # the buffer is read earlier or later from block to block
                    return np.interp(t - s * (0.6 + 0.4 * np.sign(np.sin(np.pi * t / par["block_s"]))), t, y)
                dt = t[1] - t[0]
                y0 = y[0]
                if i == 2:
                    return y0 + first(first(y - y0, dt, s / 2), dt, s / 2)
                return y0 + first(y - y0, dt, s)

            (c.xsens if i in (3, 4) else c.sens).append(d)

        def sev(s: float) -> dict:
            return {"delay_s": s, "channel": par["channel"]}
    elif name == "gain_error":
        if i == 1 and not any(r.protocol == "weight" for r in sess.recs):
            i = 0
        nmech = [j for j, r in enumerate(sess.recs) if r.loading != "calibration"]
        cut = int(rng.choice(nmech[1:-1])) if len(nmech) > 3 else nmech[-1]
        par = {"from": sess.recs[cut].rid if i in (0,) else "", "sign": sign, "channel": "force"}
        dep = [["session_time"], [], ["session_time"], ["amplitude"], ["amplitude"]][i]

        def ap(c: Cfg, s: float) -> None:
            def d(y: np.ndarray, t: np.ndarray, rec: Rec, st: dict) -> np.ndarray:
                j = sess.recs.index(rec)
                if i == 0:
                    return y * (1 + sign * s * (j >= cut))
                if i == 1:
                    return y * (1 + sign * s)
                if i == 2:
                    return y * (1 + sign * s * np.exp(-(rec.t0 + t) / (0.25 * span)))
                m = y[0] if len(y) else 0.0
                if i == 3:
                    return y + sign * s * np.maximum(y - m, 0)
                big = np.max(np.abs(y - m)) > 0.55 * peak
                return y * (1 + sign * s * big)

            c.sens.append(d)

        def sev(s: float) -> dict:
            return {"gain": sign * s}
    elif name == "drive_offset":
        per = rng.uniform(-1, 1, len(sess.recs))
        par = {"sign": sign, "tau_s": float(rng.uniform(1, 8))}

        def ap(c: Cfg, s: float) -> None:
            def d(v: np.ndarray, dt: float, st: dict, rec: Rec) -> np.ndarray:
                if i == 0:
                    return v + sign * s
                if i == 1:
                    return v + sign * s * (0.4 + 0.6 * np.exp(-np.arange(len(v)) * dt / par["tau_s"]))
                if i == 2:
                    return np.sign(v) * np.maximum(np.abs(v) - s, 0)
                if i == 3:
                    return v + s * per[sess.recs.index(rec)]
                return np.sqrt(v * v + s * s) + 0.5 * s

            c.drive.append(d)

        def sev(s: float) -> dict:
            return {"offset_kv": {0: sign * s, 1: sign * s, 2: -s, 3: s, 4: 0.5 * s}[i]}
    elif name == "leakage":
        m = float(rng.uniform(3, 6))
        th = table(rng, "threshold")
        tb = spline(rng, power=2.0)
        par = {"exponent": m, "rc_s": float(rng.uniform(0.02, 0.3)), "tau_s": float(rng.uniform(3, 15))}

        def droop(v: np.ndarray, dt: float) -> np.ndarray:
            u = np.abs(v) / vmax
            if i == 0:
                return 0.35 + 0.65 * u ** (m - 1)
            if i == 1:
                return np.interp(u, G, th)
            if i == 2:
                return np.exp(4 * (np.sqrt(np.minimum(u, 1.2)) - 1))
            if i == 3:
                return u * (0.5 + 0.5 * first(u * u, dt, par["tau_s"]))
            return np.interp(u, G, tb)

        def ap(c: Cfg, s: float) -> None:
            def d(v: np.ndarray, dt: float, st: dict, rec: Rec) -> np.ndarray:
                return v * (1 - s * first(droop(v, dt), dt, par["rc_s"]))

            c.drive.append(d)
            c.current = lambda v, dt: 30.0 * s * droop(v, dt) * np.abs(v) / vmax
    elif name == "wrinkling":
        tb = spline(rng)
        par = {"return_s": float(rng.uniform(0.3, 2)), "residual": float(rng.uniform(0.1, 0.4))}

        def ap(c: Cfg, s: float) -> None:
            vc = vmax / (1 + s)

            def a(fa: np.ndarray, v: np.ndarray, dt: float, st: dict, rec: Rec) -> np.ndarray:
                fc = f["ka"] * vc * vc
                ex = np.maximum(fa - fc, 0)
                if i == 0:
                    return fa - ex
                if i == 1:
                    u = ex / fc
                    return fa - ex * np.interp(np.minimum(u * 1.2, 1.5), G, np.clip(tb, 0, 1))
                if i == 2:  # wrinkles come at once and go slowly
                    w = sim.lag_from(ex, dt, 0.005, par["return_s"] * (v.max() / vc), 0.0)
                    return fa - np.minimum(w, 0.9 * fa)
                if i == 3:  # onset above, release below
                    on = sim.lag_from((np.abs(v) > vc).astype(float), dt, 0.002, 0.05, 0.0)
                    rel = 1 - 0.25 * min(1.0, 4 * s)
                    return fa - on * np.maximum(fa - rel * fc, 0) * 0.5 - 0.5 * ex * (1 - on)
                return fa - ex * (1 - par["residual"])

            c.act.append(a)

        def sev(s: float) -> dict:
            return {"onset_kv": vmax / (1 + s), "excess": s}
    elif name == "clamp_slip":
        kh = float(kinf * rng.uniform(0.3, 1.5))
        par = {"holding_n_per_mm": kh}

        def ap(c: Cfg, s: float) -> None:
            r = s if i in (1, 2) else 1 + s  # smooth forms start far beyond the largest load
            c.ccode = i + 1
            c.cp[:4] = [peak / r, kh, kinf, [0, 3.0, 0.3 * emax, 1 - 0.3 * min(1.0, 5 * s), 0][i]]

        def sev(s: float) -> dict:
            return {"slip_force": 1 / s if i in (1, 2) else 1 / (1 + s), "excess": s - 1 if i in (1, 2) else s}
    elif name == "mains_hum":
        par = {
            "second": float(rng.uniform(0, 0.7)),
            "df": float(rng.uniform(-0.02, 0.02)),
            "ph": rng.uniform(0, 6.28, 40).tolist(),
        }

        def ap(c: Cfg, s: float) -> None:
            def d(y: np.ndarray, t: np.ndarray, rec: Rec, st: dict) -> np.ndarray:
                j = sess.recs.index(rec)
                th = 2 * np.pi * (50 + par["df"]) * t + par["ph"][j]
                if i == 0:
                    return y + s * (np.sin(th) + par["second"] * np.sin(2 * th + 1))
                if i == 1:
                    return y + s * np.sin(th) * (1 + 0.5 * np.sin(2 * np.pi * 0.21 * t + j))
                if i == 2:
                    return y + s * 1.6 * (np.maximum(np.sin(th), 0.3) - 0.42)
                return y + s * np.sin(th + 0.8 * np.sin(2 * np.pi * 0.05 * t))

            c.sens.append(d)
    elif name == "sensor_saturation":
        hi = ref["fmax"]

        def ap(c: Cfg, s: float) -> None:
            lim = hi / (1 + s) / (0.9 if i == 1 else 1.0)

            def d(y: np.ndarray, t: np.ndarray, rec: Rec, st: dict) -> np.ndarray:
                if i == 1:
                    k = 0.9 * lim
                    ex = np.maximum(np.abs(y) - k, 0)
                    return np.sign(y) * (np.minimum(np.abs(y), k) + (lim - k) * np.tanh(ex / (lim - k)))
                if i == 3:  # overload is left late
                    ov = np.maximum(y - lim, 0)
                    return np.minimum(y, lim) - 0.15 * (sim.lag_from(ov, t[1] - t[0], 0.002, 0.08, 0.0) - 0) * (y < lim)
                return np.minimum(y, lim) if i == 2 else np.clip(y, -lim, lim)

            c.sens.append(d)

        def sev(s: float) -> dict:
            return {"limit_n": hi / (1 + s) / (0.9 if i == 1 else 1.0), "excess": s}
    else:  # passive_strip
        sh = f["share"]
        tx = float(np.exp(rng.uniform(np.log(0.01), np.log(2))))
        kp0 = k0 / (1 - sh)
        if i == 0:
            w, tt = np.array([1.0]), np.array([tx])
        elif i == 1:
            w, tt = np.array([0.5, 0.5]), np.array([tx, tx / 10])
        elif i == 3:
            tt = tx * 10 ** np.linspace(-1, 1, 5)
            w = rng.dirichlet(np.ones(5))
        else:
            w, tt = np.zeros(0), np.zeros(0)
        par = {"time_constant_s": tx, "slower": float(rng.uniform(2, 6))}

        def ap(c: Cfg, s: float) -> None:
            ki, ti = f["ki"] / (1 - sh), f["ti"]
            if i == 2:
                ki = np.concatenate([ki * (1 - 0.8 * s), ki * 0.8 * s])
                ti = np.concatenate([ti, ti * par["slower"]])
            c.strip = {
                "share": sh,
                "k0": kp0,
                "ki": np.concatenate([ki, s * 3 * kp0 * w]),
                "ti": np.concatenate([ti, tt]),
            }

        def sev(s: float) -> dict:
            return {"ratio": sh, "time_constant_s": tx * (par["slower"] if i == 2 else 1), "arm_over_spring": s}

    return Effect(name, STAGE[name], FORMS[name][i], i == 0, ap, 0.25 * cap, cap, dep, sev, par, needs)


def _fibres(rng: np.random.Generator):
    """Tension below the threshold when fibres go slack one after the other."""
    u = np.linspace(0, 3, 200)
    share = 1 - np.clip(spline(rng, np.minimum(u / 2, 1.5)), 0, 0.93)
    return u, np.concatenate([[0], np.cumsum(0.5 * (share[1:] + share[:-1]) * np.diff(u))])


def _stiff(rng: np.random.Generator, i: int, lam: float, strain: float) -> np.ndarray:
    """Extra elastic force over strain (units of the largest strain), 0 and flat at 0, slope 2 of the unit at 1."""
    lam = max(lam, 2.0 if i == 0 else 1.6)  # where the law is convex
    e = GS * strain * lam
    la = lam + e
    if i == 0:  # Gent
        top = lam * (1 + 1.3 * strain)
        jm = 1.5 * (top**2 + 2 / top - 3)

        def t(q):
            return (q - q**-2) / (1 - np.minimum((q**2 + 2 / q - 3) / jm, 0.97))
    elif i == 1:  # Ogden, large exponent
        a = rng.uniform(5, 8)

        def t(q):
            return q ** (a - 1) - q ** (-a / 2 - 1)
    elif i == 3:  # inverse Langevin (Padé)
        lm = lam * (1.15 + strain * rng.uniform(1.6, 2.5))

        def t(q):
            y = np.minimum(q / lm, 0.98)
            return y * (3 - y * y) / (1 - y * y)

    if i in (0, 1, 3):
        d = 1e-5
        g0 = (t(lam + d) - t(lam - d)) / (2 * d)
        f = t(la) - t(lam) - g0 * e
    elif i == 2:  # threads take part above a threshold, with a soft knee
        a, w = rng.uniform(0.2, 0.5), 0.05
        f = w * np.logaddexp(0, (GS - a) / w) - w * np.logaddexp(0, -a / w)
        f -= GS / (1 + np.exp(a / w))
    else:
        sl = spline(rng, np.abs(GS)) * np.where(GS < 0, rng.uniform(-0.2, 0.6), 1.0)
        f = np.concatenate([[0], np.cumsum(0.5 * (sl[1:] + sl[:-1]) * np.diff(GS))])
        f -= np.interp(0, GS, f)
    sl1 = np.gradient(f, GS)[int(np.argmin(np.abs(GS - 1)))]
    return np.ascontiguousarray(f * 2.0 / max(sl1, 1e-9))


UNLISTED = {
    "frame_resonance": ("rig", ["frequency"]),
    "voltage_crosstalk": ("sensor", ["voltage"]),
    "edge_tear": ("film", ["largest_strain", "session_time"]),
    "misaligned_pull": ("rig", ["amplitude", "frequency"]),
    "humidity": ("film", ["session_time"]),
    "charge_trapping": ("actuation", ["voltage", "record_time"]),
    "rod_expansion": ("rig", ["exposure"]),
    "guide_friction": ("contact", ["amplitude"]),
    "vibrometer_cyclic_error": ("sensor", ["amplitude"]),
    "ventilation": ("record", ["record_time"]),
    "converter_step": ("sensor", ["amplitude"]),
    "base_acceleration": ("sensor", ["frequency"]),
    "partial_discharge": ("actuation", ["voltage"]),
    "film_string_mode": ("film", ["frequency"]),
}


def unlisted(name: str, sess: Session, rng: np.random.Generator, ref: dict) -> Effect:
    """Build an effect that no id names."""
    f, rig = sess.film, sess.rig
    k0, kinf = f["k0"], f["k0"] + f["ki"].sum()
    peak, emax, vmax, span = ref["peak"], ref["emax"], ref["vmax"], ref["span"]
    w0 = 2 * np.pi * rng.uniform(15, 55)
    z0 = rng.uniform(0.01, 0.05)
    sign = float(rng.choice([-1, 1]))
    th = float(rng.uniform(0.5, 0.75))
    par = {"f_hz": w0 / 2 / np.pi, "zeta": z0, "sign": sign, "threshold": th}
    nmech = [j for j, r in enumerate(sess.recs) if r.loading == "mechanical"]
    jt = int(rng.choice(nmech[1:])) if len(nmech) > 1 else nmech[0]
    ft = float(rng.uniform(0.3, 0.7))
    ph = rng.uniform(0, 6.28, 60)
    tau = float(rng.uniform(0.3, 4))
    cap = 1.0

    def ap(c: Cfg, s: float) -> None:
        if name == "frame_resonance":

            def mv(x, t, dt, rec):
                # the frame bends under the shaker's reaction: resonator added to the true stretch
                q = np.exp(-z0 * w0 * dt)
                wd = w0 * np.sqrt(1 - z0 * z0) * dt
                r = lfilter([0, w0 * dt * q * np.sin(wd)], [1, -2 * q * np.cos(wd), q * q], x)
                return x + sign * s * 0.3 * (r - x)

            c.move.append(mv)
        elif name == "voltage_crosstalk":
            c.sens.append(
                lambda y, t, rec, st: (
                    y + sign * s * peak * (rec.v_out / vmax + 0.002 * np.gradient(rec.v_out, t[1] - t[0]) / vmax)
                )
            )
        elif name == "edge_tear":

            def so(t, dt, st, rec, x):
                j = sess.recs.index(rec)
                tt = ft * rec.duration
                return 1 - s * 0.4 * (
                    1.0 if j > jt else 0.0 if j < jt else 1 / (1 + np.exp(-np.clip((t - tt) / 0.02, -50, 50)))
                )

            c.soft.append(so)
        elif name == "misaligned_pull":

            def se(y, t, rec, st):
                # a sideways mode is driven by the square of the stretch and pulls at the load cell
                dt = t[1] - t[0]
                q, wd = np.exp(-z0 * w0 * dt), w0 * np.sqrt(1 - z0 * z0) * dt
                u = (rec.x_out / emax) ** 2
                return y + s * 0.2 * peak * (
                    lfilter([0, w0 * dt * q * np.sin(wd)], [1, -2 * q * np.cos(wd), q * q], u) - u
                )

            c.sens.append(se)
        elif name == "humidity":

            def so(t, dt, st, rec, x):
                return 1 + s * 0.4 * np.sin(2 * np.pi * (rec.t0 + t) / span * (2.5 + 1.5 * th) + ph[0])

            c.soft.append(so)
        elif name == "charge_trapping":

            def d(v, dt, st, rec):
                q = sim.lag_from(np.abs(v) - st.get("q", 0.0), dt, tau, 5 * tau, st.get("q", 0.0))
                st["q"] = float(q[-1]) * 0.3
                return v - s * 0.5 * q * np.abs(v) / vmax

            c.drive.append(d)
        elif name == "rod_expansion":

            def dr(y, t, rec, st, base):
                q = np.gradient(rec.x_out, t[1] - t[0]) ** 2 / ref["power"] if rec.loading == "mechanical" else 0 * t
                u = sim.lag_from(q, t[1] - t[0], 20.0, 20.0, 0.0)
                return y + sign * s * peak * u

            c.drift.append(dr)
        elif name == "guide_friction":
            c.fcode = 5
            fr = s * 0.3 * peak
            c.fp[:4] = [fr * 0.5, kinf * 0.5 * min(1, s * 4), fr, kinf * 0.2 * min(1, s * 4)]
        elif name == "vibrometer_cyclic_error":
            lam = 0.1 * emax
            c.xsens.append(lambda x, t, rec, st=None: x + s * 0.3 * lam * np.sin(2 * np.pi * x / lam))
        elif name == "ventilation":

            def se(y, t, rec, st):
                j = sess.recs.index(rec)
                f1 = 0.3 + 1.2 * ((j * 0.37) % 1)
                return y + s * 0.2 * peak * np.sin(2 * np.pi * f1 * t + ph[j]) * (1 + 0.4 * np.sin(0.5 * t + j))

            c.sens.append(se)
        elif name == "converter_step":

            def se(y, t, rec, st):
                m = ref["mean"] + 0.15 * sign * peak
                return y + s * 0.3 * peak * ((y > m) - 0.5)

            c.sens.append(se)
        elif name == "base_acceleration":

            def se(y, t, rec, st):
                dt = t[1] - t[0]
                return y + sign * s * 4 * rig["mass"] * np.gradient(np.gradient(rec.x_out, dt), dt)

            c.sens.append(se)
        elif name == "partial_discharge":

            def a(fa, v, dt, st, rec):
                r = np.random.default_rng([sess.seed, 99, sess.recs.index(rec)])
                n = int(rec.duration * 6)
                k = (r.uniform(0, 1, n) * (len(fa) - 1)).astype(int)
                p = np.zeros_like(fa)
                p[k] = (np.abs(v[k]) / vmax > th) * r.exponential(1, n)
                q = np.exp(-dt / 0.03)
                return fa * (1 - np.minimum(s * lfilter([1], [1, -q], p), 0.95))

            c.act.append(a)
        else:
            c.fcode = 6
            c.fp[:3] = [s * 0.3 * k0, w0, z0]

    stage, dep = UNLISTED[name]
    return Effect(name, stage, name, False, ap, 0.2, cap, list(dep), lambda s: {"size": s}, par)
