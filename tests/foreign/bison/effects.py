"""The listed mechanisms: families of forms. `build(mechanism, form, s, q, w)` gives the effect of severity s.

q is a dict of shape numbers u0…u9 in 0…1 (fixed per session), so that the search over s keeps the shape.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

from . import core
from .plan import Rec, World, film_k
from .simulate import Effect

# mechanism: stage, severity key, smallest and largest severity of the range, what the session must hold, depends on
SPEC: dict[str, tuple[str, str, float, float, tuple[str, ...], tuple[str, ...]]] = {
    "rig_constants": ("rig", "stiffness_error", 0.002, 0.20, ("mech",), ("frequency",)),
    "load_cell_damping": ("rig", "damping_ratio", 0.0002, 0.03, ("mech",), ("frequency",)),
    "drive_lag": ("drive", "rise_time_constant_s", 2e-5, 0.01, ("elec",), ("frequency", "voltage")),
    "amplitude_softening": ("film", "drop", 0.0005, 0.30, ("mech",), ("amplitude",)),
    "cyclic_softening": ("film", "loss", 0.0005, 0.25, ("mech",), ("cycle", "largest_strain")),
    "missing_relaxation": ("film", "stiffness_ratio", 0.001, 0.60, ("mech",), ("frequency",)),
    "power_law_relaxation": ("film", "stiffness_ratio", 0.001, 0.60, ("mech",), ("frequency",)),
    "baseline_drift": ("drift", "per_decade", 0.0001, 0.10, ("any",), ("record_time",)),
    "thermal_softening": ("film", "softening", 0.0005, 0.24, ("mech",), ("session_time", "temperature")),
    "field_dependent_permittivity": ("actuation", "fraction", 0.001, 0.15, ("elec",), ("voltage",)),
    "frequency_dependent_permittivity": ("actuation", "per_decade", 0.0005, 0.06, ("elec",), ("frequency",)),
    "electrode_degradation": ("actuation", "loss", 0.002, 0.40, ("elec",), ("exposure",)),
    "slack": ("film", "ladder", 0.02, 1.0, ("mech",), ("amplitude",)),
    "strain_stiffening": ("film", "stiffening", 0.002, 0.30, ("mech",), ("amplitude",)),
    "sensor_delay": ("sensor", "delay_s", 2e-6, 0.002, ("mech",), ("frequency",)),
    "gain_error": ("sensor", "gain", 0.0005, 0.20, ("any",), ()),
    "drive_offset": ("drive", "offset_kv", 0.002, 0.5, ("elec",), ("voltage",)),
    "leakage": ("drive", "droop", 0.001, 0.20, ("elec",), ("voltage",)),
    "wrinkling": ("actuation", "ladder", 0.02, 0.9, ("elec",), ("voltage",)),
    "clamp_slip": ("contact", "ladder", 0.05, 10.0, ("mech",), ("amplitude",)),
    "mains_hum": ("sensor", "amplitude_n", 1e-6, 0.02, ("any",), ("record_time",)),
    "sensor_saturation": ("sensor", "ladder", 0.003, 1.0, ("mech",), ("amplitude",)),
    "passive_strip": ("film", "share", 0.01, 0.8, ("elec",), ("frequency",)),
}

FORMS: dict[str, tuple[str, ...]] = {
    "rig_constants": ("both", "glued_lead", "frame_compliance", "film_mass", "drying_grease", "gel_mount"),
    "load_cell_damping": ("viscous", "hysteretic", "air_drag", "guide_friction", "tuned_lead"),
    "drive_lag": ("rise_fall", "slew", "electrode_line", "two_pole", "patches"),
    "amplitude_softening": ("running", "bond_rate", "strain_domains", "logistic_domains", "mean_square"),
    "cyclic_softening": ("textbook", "rate", "bond_population", "log_count", "pseudo_elastic"),
    "missing_relaxation": ("arm", "log_normal", "davidson", "activated", "diffusion"),
    "power_law_relaxation": ("springpot", "cut_off", "tempered", "two_slopes", "ladder"),
    "baseline_drift": ("log", "exponential", "diffusion", "wander", "barriers", "fading_log"),
    "thermal_softening": ("first_order", "self_heating", "conduction", "room_cycle", "shift"),
    "field_dependent_permittivity": ("quadratic", "langevin", "johnson", "domains", "linear"),
    "frequency_dependent_permittivity": ("log", "debye", "cole_cole", "two_layer", "davidson"),
    "electrode_degradation": ("exponential", "weibull", "paths", "edge_diffusion", "logistic"),
    "slack": ("hard", "rounded", "fibres", "bending_rest", "buckling"),
    "strain_stiffening": ("ogden", "gent", "fibres", "langevin", "crystals", "even_odd"),
    "sensor_delay": ("shift", "two_pole", "pole", "moving_mean", "allpass"),
    "gain_error": ("constant", "range_switch", "session_drift", "compressive", "shelf"),
    "drive_offset": ("constant", "dead_band", "per_recording", "slow_charge", "patches"),
    "leakage": ("power", "poole_frenkel", "ion_drift", "trap_filling", "filaments"),
    "wrinkling": ("onset", "domains", "fast_domains", "slow_growth", "edge_only"),
    "clamp_slip": ("slider", "iwan", "bouc_wen", "activated", "stribeck"),
    "mains_hum": ("two_lines", "harmonics", "wandering", "pulses", "per_recording"),
    "sensor_saturation": ("clip", "rounded", "overload", "stops", "leaning"),
    "passive_strip": ("zener", "elastic", "power_law", "spectrum", "graded"),
}


def spread(n: int, tau: float, decades: float) -> np.ndarray:
    """Times spread evenly in the logarithm about tau."""
    return tau * 10 ** np.linspace(-decades, decades, n)


def springpot(k: float, alpha: float, lo: float, hi: float) -> list[tuple[float, float]]:
    """Arms that together give k (jω)^alpha between the times lo and hi."""
    n = round(2.5 * np.log10(hi / lo) + 0.5)
    edges = np.geomspace(lo, hi, n + 1)
    tau = np.sqrt(edges[1:] * edges[:-1])
    dl = np.log(edges[1] / edges[0])
    w = k * np.sin(np.pi * alpha) / np.pi * dl * tau**-alpha
    return [(float(a), float(b)) for a, b in zip(w, tau, strict=True)]


def shift(y: np.ndarray, rate: float, delay: float) -> np.ndarray:
    """The signal later by a delay (of any fraction of a sample)."""
    t = np.arange(y.size) / rate
    return CubicSpline(t, y)(np.maximum(t - delay, 0.0))


def later(rec: Rec, w: World, share: float) -> bool:
    """Whether a recording lies after a share of the session."""
    return rec.index >= max(1, round(share * (len(w.recs) - 1)))


def session_end(w: World) -> float:
    """End of the session in seconds."""
    return w.recs[-1].t0 + w.recs[-1].duration


def exposure_total(w: World) -> float:
    """∫V²dt of the whole session, roughly (kV² s)."""
    x = 0.0
    for rec in w.recs:
        if rec.loading == "electrical":
            if rec.protocol == "step":
                x += rec.p["on"] * float(np.sum(np.square(rec.p["levels"])))
            else:
                x += 0.45 * rec.p["kv"] ** 2 * rec.duration
    return max(x, 1e-6)


def build(mech: str, form: str, s: float, q: dict[str, float], w: World) -> Effect:
    """The effect of one mechanism in one form."""
    return BUILDERS[mech](form, s, q, w)


def span(u: float, a: float, b: float) -> float:
    """Linear map of u in 0…1."""
    return a + u * (b - a)


def lspan(u: float, a: float, b: float) -> float:
    """Logarithmic map of u in 0…1."""
    return float(a * (b / a) ** u)


def rig_constants(form: str, s: float, q: dict, w: World) -> Effect:
    sg = 1.0 if q["u0"] > 0.5 else -1.0
    if form == "both":
        ratio = span(q["u1"], -0.9, 0.5)
        return Effect(d_mass=lambda rec: ratio * sg * s, d_kl=lambda rec: sg * s)
    if form == "glued_lead":
        at = 0.0 if q["u2"] < 0.5 else span(q["u1"], 0.2, 0.6)
        return Effect(d_mass=lambda rec: s if (at == 0.0 or later(rec, w, at)) else 0.6 * s)
    if form == "frame_compliance":
        kf = w.kl / s
        f_b = span(q["u1"], 250, 500)
        m_b = kf / (2 * np.pi * f_b) ** 2
        return Effect(rig=(core.FRAME, [m_b, kf, 2 * 0.03 * np.sqrt(kf * m_b), 0.0]))
    if form == "film_mass":

        def inertia(x: np.ndarray, v: np.ndarray, h: float, rec: Rec, st: dict) -> np.ndarray:
            return 0.5 * s * w.mass * np.gradient(np.gradient(x, h), h)

        return Effect(d_mass=lambda rec: s, force_in=inertia)
    if form == "drying_grease":
        tau = span(q["u1"], 0.3, 1.0) * session_end(w)
        return Effect(d_mass=lambda rec: s * (0.6 + 0.4 * np.exp(-rec.t0 / tau)))
    # gel mount: part of the cell's stiffness relaxes
    arms: list[float] = [2.0]
    for tau in (lspan(q["u1"], 3e-3, 0.03), lspan(q["u2"], 0.03, 0.5)):
        arms += [0.9 * s * w.kl, tau]
    return Effect(d_kl=lambda rec: -s, rig=(core.CELL_ARMS, arms))


def load_cell_damping(form: str, s: float, q: dict, w: World) -> Effect:
    c = 2 * s * np.sqrt(w.kl * w.mass)
    om = np.sqrt(w.kl / w.mass)
    if form == "viscous":
        return Effect(d_cl=c)
    if form == "hysteretic":
        arms = [4.0]
        each = 2 * s / 1.18
        for x in (0.1, 0.31, 0.97, 3.0):
            arms += [each * w.kl, x / om]
        return Effect(rig=(core.CELL_ARMS, arms), d_kl=lambda rec: -0.7 * each)
    vel = max(0.4 * w.files["f_chirp"] / w.kl * om, 1e-3)
    if form == "air_drag":
        return Effect(rig=(core.DRAG, [c * 3 * np.pi / 8 / vel]))
    if form == "guide_friction":
        return Effect(rig=(core.FRICTION, [c * np.pi / 4 * vel * 0.2, 0.1 * vel]), d_cl=0.6 * c)
    f2 = span(q["u1"], 0.75, 1.6) * om
    m2 = w.mass * s * 1.2
    return Effect(rig=(core.TUNED, [m2, m2 * f2**2, 2 * span(q["u2"], 0.04, 0.15) * m2 * f2]))


def drive_lag(form: str, s: float, q: dict, w: World) -> Effect:
    if form == "rise_fall":
        r = span(q["u1"], 1.3, 4.0)
        return Effect(drive=lambda v, h, rec, st: core.one_pole(v, s, s * r, 1e9, h, float(v[0])))
    if form == "slew":
        slew = w.v_max / (3.0 * s)
        return Effect(drive=lambda v, h, rec, st: core.one_pole(v, 0.1 * s, 0.1 * s, slew, h, float(v[0])))
    if form == "two_pole":

        def two(v: np.ndarray, h: float, rec: Rec, st: dict) -> np.ndarray:
            a = core.one_pole(v, 0.6 * s, 0.6 * s, 1e9, h, float(v[0]))
            return core.one_pole(a, 0.6 * s, 0.6 * s, 1e9, h, float(v[0]))

        return Effect(drive=two)
    if form == "electrode_line":
        m = np.arange(1, 7)
        ws = 1.0 / (2 * m - 1) ** 2
        ws = ws / ws.sum()
        taus = 2.0 * s / (2 * m - 1.0) ** 2

        def line(v: np.ndarray, h: float, rec: Rec, st: dict) -> np.ndarray:
            return core.relax_sum(v, taus, ws, h, np.full(6, v[0]))

        return Effect(drive=line)
    z = np.array([-1.4, -0.6, 0.0, 0.6, 1.4]) * span(q["u1"], 0.6, 1.4)
    taus = s * np.exp(z)

    def patches(v: np.ndarray, h: float, rec: Rec, st: dict) -> np.ndarray:
        out = np.zeros_like(v)
        for tau in taus:
            out += core.one_pole(v, float(tau), float(tau), 1e9, h, float(v[0])) ** 2
        return out / taus.size

    return Effect(vsq=patches)


def amplitude_softening(form: str, s: float, q: dict, w: World) -> Effect:
    a = w.a_max
    ta = lspan(q["u3"], 1.0, 4.0)
    if form == "running":
        ac = a * span(q["u1"], 0.5, 1.3)
        m = span(q["u2"], 0.5, 1.5)
        x = (a / ac) ** (2 * m)
        return Effect(film=(core.SOFTEN, [0, s, ac, m, (1 + x) / x - 1, ta]))
    if form == "bond_rate":
        ac = a * span(q["u1"], 0.4, 1.0)
        m = span(q["u2"], 1.0, 2.5)
        x = (a / ac) ** m
        return Effect(film=(core.SOFTEN, [1, s * (1 + x) / x, ac, m, lspan(q["u4"], 0.05, 0.6), ta]), persist=False)
    if form == "strain_domains":
        ac = a * span(q["u1"], 0.4, 1.0)
        m = span(q["u2"], 1.5, 3.0)
        x = (a / ac) ** m
        return Effect(film=(core.SOFTEN, [2, s * (1 + x) / x, ac, m, 0, ta]))
    if form == "logistic_domains":
        return Effect(film=(core.SOFTEN, [3, 1.6 * s, a * span(q["u1"], 0.4, 0.9), span(q["u2"], 2.0, 5.0), 0, ta]))
    ac = a * span(q["u1"], 0.5, 1.2)
    x = (a / ac) ** 2
    return Effect(film=(core.SOFTEN, [4, s * (1 + x) / x, ac, lspan(q["u4"], 2, 10), 0, ta]), persist=False)


def cyclic_softening(form: str, s: float, q: dict, w: World) -> Effect:
    a = w.a_max * span(q["u1"], 0.3, 0.9)
    n0 = lspan(q["u2"], 3, 60)
    code = {"textbook": 0, "rate": 1, "bond_population": 2, "log_count": 3, "pseudo_elastic": 4}[form]
    return Effect(film=(core.DAMAGE, [code, s, a, n0, 0, 2.0]))


def missing_relaxation(form: str, s: float, q: dict, w: World) -> Effect:
    k = s * w.k0
    # a time that the film's own arms do not hold
    choices = np.geomspace(3e-3, 15, 40)
    far = np.array([np.min(np.abs(np.log(c / w.taus))) if len(w.taus) else 9.0 for c in choices])
    good = choices[far > np.log(3)]
    tau = float(good[int(q["u1"] * (len(good) - 1))]) if len(good) else 5.0
    if form == "arm":
        return Effect(arms=[(k, tau)])
    if form == "log_normal":
        t = spread(7, tau, 0.9)
        g = np.exp(-0.5 * (np.linspace(-2, 2, 7)) ** 2)
        return Effect(arms=[(float(k * x / g.sum()), float(y)) for x, y in zip(g, t, strict=True)])
    if form == "davidson":
        t = spread(8, tau, 1.2)
        t = t[t < tau * 2.5]
        g = np.linspace(0.3, 1.0, t.size) ** 2
        return Effect(arms=[(float(k * x / g.sum()), float(y)) for x, y in zip(g, t, strict=True)])
    if form == "diffusion":
        m = np.arange(1, 7)
        g = 1.0 / (2 * m - 1.0) ** 2
        return Effect(arms=[(float(k * x / g.sum()), float(tau * x)) for x in g])
    f0 = lspan(q["u2"], 0.3, 2.0) * k * w.a_max * 0.5
    return Effect(film=(core.EYRING, [k, f0, f0 / (k * tau)]))


def power_law_relaxation(form: str, s: float, q: dict, w: World) -> Effect:
    k = s * w.k0
    al = span(q["u1"], 0.12, 0.45)
    if form == "springpot":
        return Effect(arms=springpot(k, al, 1e-4, 300))
    if form == "cut_off":
        return Effect(arms=springpot(k, al, lspan(q["u2"], 2e-4, 5e-3), lspan(q["u3"], 3, 30)))
    if form == "tempered":
        lim = lspan(q["u2"], 3, 40)
        return Effect(arms=[(a * float(np.exp(-t / lim)), t) for a, t in springpot(k, al, 1e-4, 300)])
    if form == "two_slopes":
        knee = lspan(q["u2"], 0.02, 0.5)
        b = al * 0.5
        arms = springpot(k, al, knee, 300)
        fast = springpot(k * knee ** (b - al), b, 1e-4, knee)
        g = np.sin(np.pi * al) / np.sin(np.pi * b)
        return Effect(arms=arms + [(x * float(g), t) for x, t in fast])
    # ladder: discrete steps of a self-similar tree, two per decade and uneven
    arms = []
    tau = 2e-4
    j = 0
    while tau < 100:
        arms.append((float(k * np.sin(np.pi * al) / np.pi * np.log(8.0) * tau**-al * (1.25 if j % 2 else 0.75)), tau))
        tau *= 8.0
        j += 1
    return Effect(arms=arms)


def baseline_drift(form: str, s: float, q: dict, w: World) -> Effect:
    b = s * w.preload * (-1.0 if q["u0"] < 0.75 else 1.0)
    t0 = lspan(q["u1"], 0.3, 5.0)
    if form == "log":
        return Effect(drift=lambda t, rec, st: b * np.log10(1 + t / t0))
    if form == "exponential":
        tau = lspan(q["u1"], 5, 40)
        return Effect(drift=lambda t, rec, st: 1.5 * b * (1 - np.exp(-t / tau)))
    if form == "diffusion":
        return Effect(drift=lambda t, rec, st: b * np.sqrt(t / 20.0))
    if form == "wander":

        def wander(t: np.ndarray, rec: Rec, st: dict) -> np.ndarray:
            r = np.random.default_rng(int(q["u2"] * 1e9) + rec.index)
            n = int(t[-1] / 2) + 4
            steps = np.cumsum(r.normal(size=n)) / np.sqrt(20.0)
            walk = CubicSpline(np.arange(n) * 2.0, steps - steps[0])(t)
            return b * 0.8 * np.log10(1 + t / t0) + 0.4 * b * walk

        return Effect(drift=wander)
    if form == "barriers":
        taus = spread(5, lspan(q["u1"], 2, 20), 0.7)
        return Effect(drift=lambda t, rec, st: 1.5 * b * np.mean([1 - np.exp(-t / x) for x in taus], axis=0))

    def session(t: np.ndarray, rec: Rec, st: dict) -> np.ndarray:
        # the bridge warms up: what is left of the drift fades over the session
        return b * np.log10(1 + t / t0) * (0.3 + 0.9 * np.exp(-rec.t0 / (0.35 * session_end(w))))

    return Effect(drift=session)


def thermal_softening(form: str, s: float, q: dict, w: World) -> Effect:
    end = session_end(w)
    beta = span(q["u1"], 0.006, 0.03)
    rise = s / beta
    cool = -1.0 if q["u5"] < 0.25 else 1.0

    def profile(t: np.ndarray) -> np.ndarray:
        if form == "conduction":
            tau = span(q["u2"], 0.3, 1.0) * end
            return cool * rise * np.sqrt(t / tau) / np.sqrt(1 + t / tau)
        if form == "room_cycle":
            per = span(q["u2"], 0.3, 0.9) * end
            return rise * 0.5 * (1 - np.cos(2 * np.pi * t / per + 0.3)) + 0.022 * rise
        tau = span(q["u2"], 0.15, 0.7) * end
        return cool * rise * (1 - np.exp(-t / tau))

    if form == "self_heating":
        heat = s / (w.f_peak * w.a_max * 60.0)

        return Effect(film=(core.HEAT, [0, 1.0, heat * 3.0, lspan(q["u2"], 30, 300)]))
    if form == "shift":

        def shifted(rec: Rec, t: np.ndarray, st: dict) -> tuple[np.ndarray, np.ndarray]:
            dt = profile(rec.t0 + t)
            # warmer: faster and a little softer
            return 1.0 - 0.4 * beta * dt, np.exp(np.clip(3.0 * beta * dt, -1, 1.5))

        return Effect(scale=shifted, temperature=lambda rec, t, st: profile(rec.t0 + t))

    def scaled(rec: Rec, t: np.ndarray, st: dict) -> tuple[np.ndarray, float]:
        return np.maximum(1.0 - beta * profile(rec.t0 + t), 0.05), 1.0

    return Effect(scale=scaled, temperature=lambda rec, t, st: profile(rec.t0 + t))


def field_dependent_permittivity(form: str, s: float, q: dict, w: World) -> Effect:
    def factor(v: np.ndarray) -> np.ndarray:
        x = np.abs(v) / w.v_max
        if form == "quadratic":
            return 1 - s * x * x
        if form == "linear":
            return 1 - s * x
        if form == "johnson":
            b = (1 - min(s, 0.6)) ** -3 - 1
            return (1 + b * x * x) ** (-1 / 3)
        if form == "langevin":
            a = span(q["u1"], 1.5, 3.0)
            z = np.maximum(a * x, 1e-4)
            lan = 3 * (1 / np.tanh(z) - 1 / z) / z
            full = 3 * (1 / np.tanh(a) - 1 / a) / a
            return 1 - s * (1 - lan) / (1 - full)
        mid, wid = span(q["u1"], 0.5, 0.8), span(q["u2"], 0.08, 0.15)
        g = 1 / (1 + np.exp(-(x - mid) / wid))
        g0, g1 = 1 / (1 + np.exp(mid / wid)), 1 / (1 + np.exp(-(1 - mid) / wid))
        return 1 - s * (g - g0) / (g1 - g0)

    return Effect(act=lambda v, fa, h, rec, st: fa * factor(v))


def frequency_dependent_permittivity(form: str, s: float, q: dict, w: World) -> Effect:
    """Share D of the permittivity follows late; per decade about s."""
    tau = lspan(q["u1"], 3e-3, 1.0)
    if form == "log":
        taus = np.geomspace(1e-4, 100, 12)
        ws = np.full(12, 1 / 12)
        big = 6.0 * s
    elif form == "debye":
        taus, ws, big = np.array([tau]), np.ones(1), 2.0 * s
    elif form == "cole_cole":
        taus = spread(9, tau, 1.3)
        al = span(q["u2"], 0.3, 0.6)
        x = np.log(taus / tau)
        ws = np.sin(al * np.pi) / (np.cosh((1 - al) * x) - np.cos(al * np.pi))
        big = 2.6 * s
    elif form == "davidson":
        taus = np.geomspace(tau * 0.01, tau * 1.5, 8)
        ws = np.linspace(0.2, 1, 8) ** 2
        big = 2.4 * s
    else:  # two layers: the field itself relaxes, the force is its square
        big = 1.2 * s

        def layers(v: np.ndarray, fa: np.ndarray, h: float, rec: Rec, st: dict) -> np.ndarray:
            lag = core.relax_sum(v, np.array([tau]), np.ones(1), h, np.array([v[0]]))
            eff = (1 - big) * v + big * lag
            return w.gain * eff * eff

        return Effect(act=layers)
    ws = ws / ws.sum()

    def disperse(v: np.ndarray, fa: np.ndarray, h: float, rec: Rec, st: dict) -> np.ndarray:
        return (1 - big) * fa + big * core.relax_sum(fa, taus, ws, h, np.full(taus.size, fa[0]))

    return Effect(act=disperse)


def electrode_degradation(form: str, s: float, q: dict, w: World) -> Effect:
    total = exposure_total(w)
    x0 = total * span(q["u1"], 0.25, 1.0)

    def degrade(v: np.ndarray, fa: np.ndarray, h: float, rec: Rec, st: dict) -> np.ndarray:
        x = st.get("exposure", 0.0) + np.cumsum(v * v) * h
        st["exposure"] = float(x[-1])
        z = x / x0
        if form == "exponential":
            d = 1 - np.exp(-z)
        elif form == "weibull":
            d = 1 - np.exp(-(z ** span(q["u2"], 0.5, 2.2)))
        elif form == "edge_diffusion":
            d = np.sqrt(z) / (1 + 0.3 * np.sqrt(z))
        elif form == "logistic":
            b = span(q["u2"], 3, 7)
            g0 = 1 / (1 + np.exp(b * 0.5))
            d = (1 / (1 + np.exp(-b * (z - 0.5))) - g0) / (1 - g0)
        else:  # conducting paths, each with the voltage from which it burns away
            m = 6
            hurt = st.setdefault("paths", np.zeros(m))
            out = np.zeros_like(v)
            for j in range(m):
                lim = w.v_max * (0.3 + 0.65 * j / m)
                a = np.cumsum(np.maximum(np.abs(v) - lim, 0.0)) * h / (0.15 * w.v_max) * 0.6 * np.square(w.v_max) / x0
                now = hurt[j] + a
                out += 1 - np.exp(-now)
                hurt[j] = now[-1]
            d = out / m
        return fa * np.maximum(1 - s * d, 0.02)

    return Effect(act=degrade)


def slack(form: str, s: float, q: dict, w: World) -> Effect:
    load = w.files["f_neg"]
    on = load / (1 + s)
    code = {"hard": 0, "rounded": 1, "fibres": 2, "bending_rest": 3, "buckling": 4}[form]
    p2 = {
        "hard": 0.0, "rounded": span(q["u1"], 0.05, 0.2), "fibres": span(q["u1"], 0.1, 0.35),
        "bending_rest": span(q["u1"], 0.05, 0.3), "buckling": span(q["u1"], 0.1, 0.5),
    }[form]  # fmt: skip
    pre = (
        on
        * {"hard": 1.0, "rounded": 1 / (1 - p2), "fibres": 1 + 2 * p2, "bending_rest": 1.0, "buckling": 1.0 + p2}[form]
    )
    return Effect(film=(core.SLACK, [code, on, p2]), preload=pre)


def strain_stiffening(form: str, s: float, q: dict, w: World) -> Effect:
    ref = 0.5 * w.length
    rmax = max(w.a_max * 2 / ref, 0.02)
    if form == "ogden":
        a = span(q["u1"], 1.6, 3.0)
        lim = 0.5
        # slope of n at r = 1 relative to the one at 0: (1+lim)^(a-1) - 1
        norm = 1.0 / ((1 + lim) ** (a - 1) - 1)
        return Effect(film=(core.STIFFEN, [0, s * norm, ref, a, lim, 1.0]))
    if form == "gent":
        j = span(q["u1"], 1.6, 3.0)
        at1 = 1 / (1 - 1 / j**2) - 1
        return Effect(film=(core.STIFFEN, [1, s, ref, j, 0.5 / at1]))
    if form == "fibres":
        lo, hi = 0.15 * rmax * q["u1"], max(0.6 * rmax, span(q["u2"], 0.5, 1.0) * min(1.0, 1.6 * rmax))
        return Effect(film=(core.STIFFEN, [2, s, ref, lo, hi, rmax / hi]))
    if form == "langevin":
        z = span(q["u1"], 1.3, 2.5)
        at1 = (3 - 1 / z**2) / (3 * (1 - 1 / z**2)) - 1
        return Effect(film=(core.STIFFEN, [3, s, ref, z, 0.5 / at1]))
    if form == "crystals":
        start = 0.25 * rmax * q["u1"]
        return Effect(
            film=(core.STIFFEN, [4, 0.7 * s, ref, start, lspan(q["u2"], 0.05, 0.5), lspan(q["u3"], 0.1, 1.5)]),
            persist=False,
        )
    return Effect(film=(core.STIFFEN, [5, 0.4 * s, ref, span(q["u1"], 0.2, 0.9)]))


def sensor_delay(form: str, s: float, q: dict, w: World) -> Effect:
    channel = "force" if q["u0"] < 0.65 else "displacement"

    def apply(ch: dict, rec: Rec, st: dict) -> None:
        if channel not in ch or rec.loading == "calibration":
            return
        y = ch[channel]
        y0 = y[0]
        rate = rec.rate
        if form == "shift":
            out = shift(y, rate, s)
        else:
            # finer than the samples, so that short filters keep their meaning
            m = int(np.clip(np.ceil(4.0 / (s * rate)), 1, 400)) if s * rate < 4 else 1
            if form == "moving_mean":
                t = np.arange(y.size) / rate
                prim = CubicSpline(t, y).antiderivative()
                a = np.maximum(t - 2 * s, 0.0)
                out = np.where(t > 0, (prim(t) - prim(a)) / np.maximum(t - a, 1e-12), y0)
            elif m > 12:
                # series of the delay: exact to the third order for short times
                t = np.arange(y.size) / rate
                sp = CubicSpline(t, y)
                order = {"two_pole": 0.75, "pole": 1.0, "allpass": 0.5}[form]
                out = y - s * sp(t, 1) + order * s * s * sp(t, 2)
            else:
                t = np.arange(y.size) / rate
                tf = np.arange((y.size - 1) * m + 1) / (rate * m)
                z = CubicSpline(t, y)(tf) - y0
                h = 1 / (rate * m)
                if form == "pole":
                    g = h / (2 * s)
                    z = lfilter([g, g], [1 + g, g - 1], z)
                elif form == "two_pole":
                    g = h / s
                    z = lfilter([g, g], [1 + g, g - 1], lfilter([g, g], [1 + g, g - 1], z))
                else:  # all-pass of first order: delay 2/a
                    g = 2 * h / (2 * s)
                    z = lfilter([g - 1, g + 1], [g + 1, g - 1], z)
                out = z[::m] + y0
        ch[channel] = out

    return Effect(sensor=apply)


def gain_error(form: str, s: float, q: dict, w: World) -> Effect:
    sg = 1.0 if q["u0"] < 0.5 else -1.0
    top = w.preload + w.f_peak
    at = span(q["u1"], 0.25, 0.75)
    channel = "displacement" if q["u2"] < 0.25 and form in ("range_switch", "session_drift") else "force"

    def apply(ch: dict, rec: Rec, st: dict) -> None:
        if channel not in ch:
            return
        y = ch[channel]
        if form == "constant":
            y = y * (1 + sg * s)
        elif form == "range_switch":
            y = y * (1 + sg * s) if later(rec, w, at) else y
        elif form == "session_drift":
            t = np.arange(y.size) / rec.rate + rec.t0
            y = y * (1 + sg * s * t / session_end(w))
        elif form == "compressive":
            y = y * (1 + sg * s * (y / top))
        else:
            f = lspan(q["u3"], 0.02, 0.3)
            a = np.exp(-2 * np.pi * f / rec.rate)
            slow = lfilter([1 - a], [1, -a], y - y[0]) + y[0]
            y = slow + (y - slow) * (1 + sg * s)
        ch[channel] = y

    return Effect(sensor=apply)


def drive_offset(form: str, s: float, q: dict, w: World) -> Effect:
    sg = 1.0 if q["u0"] < 0.5 else -1.0

    def apply(v: np.ndarray, h: float, rec: Rec, st: dict) -> np.ndarray:
        if form == "constant":
            return v + sg * s
        if form == "dead_band":
            a = np.abs(v)
            return np.sign(v) * (np.sqrt((a - s) ** 2 + (0.3 * s) ** 2) + (a - s)) / 2
        if form == "per_recording":
            r = np.random.default_rng(int(q["u2"] * 1e9) + rec.index)
            return v + s * (sg + 0.25 * r.normal())
        # slow charge of an insulator in the lead, over the session
        t = rec.t0 + np.arange(v.size) * h
        return v + sg * s * (0.2 + 0.8 * (1 - np.exp(-t / (0.4 * session_end(w)))))

    if form == "patches":
        zs = np.array([-1.2, -0.4, 0.4, 1.2]) * 0.8 + sg

        def vsq(v: np.ndarray, h: float, rec: Rec, st: dict) -> np.ndarray:
            x = np.abs(v) / (0.15 * w.v_max)
            grow = x / (1 + x)
            return np.mean([(v + s * z * grow) ** 2 for z in zs], axis=0)

        return Effect(vsq=vsq)
    return Effect(drive=apply)


def leakage(form: str, s: float, q: dict, w: World) -> Effect:
    """The film sees less than the amplifier gives; droop s at the largest voltage."""
    at_film = bool(w.noise.get("command")) and q["u9"] < 0.4
    s = min(s, 0.6)
    wmax = w.v_max * (1 - s)

    def apply(v: np.ndarray, h: float, rec: Rec, st: dict) -> object:
        if form in ("power", "poole_frenkel", "ion_drift"):
            n = {"power": span(q["u1"], 2.0, 4.0), "poole_frenkel": span(q["u1"], 5, 8), "ion_drift": 1.5}[form]
            a = s * w.v_max / wmax**n
            mem = 0.8 if form == "ion_drift" else 0.0
            state = np.array([0.2 if mem else 1.0])
            out = core.leaky(v, 1.0, a, n, lspan(q["u2"], 0.3, 4.0), mem, h, state)
        elif form == "trap_filling":
            taus = spread(4, lspan(q["u2"], 0.2, 3.0), 0.6)
            fill = core.relax_sum((v / w.v_max) ** 2, taus, np.full(4, 0.25), h, np.zeros(4))
            out = v * (1 - s * fill)
        else:
            x = np.abs(v) / w.v_max
            th = np.linspace(span(q["u1"], 0.3, 0.5), 0.95, 6)
            g = np.mean([1 / (1 + np.exp(-(x - c) / 0.03)) for c in th], axis=0)
            out = v / (1 + s / (1 - s) * g)
        return (out, out) if at_film else out

    return Effect(drive=apply)


def wrinkling(form: str, s: float, q: dict, w: World) -> Effect:
    vc = w.v_max / (1 + s)
    on, off = lspan(q["u1"], 0.02, 0.3), lspan(q["u2"], 0.4, 2.5)
    if form == "onset":
        vcs = np.array([vc])
    elif form in ("domains", "fast_domains"):
        vcs = vc * (1 + np.linspace(0, span(q["u3"], 0.15, 0.4), 10))
        if form == "fast_domains":
            on, off = 0.003, lspan(q["u2"], 0.02, 0.2)
    elif form == "slow_growth":
        vcs = np.array([vc, vc * 1.05])
        on, off = lspan(q["u1"], 0.5, 2.0), lspan(q["u2"], 1.5, 4.0)
    else:
        vcs = np.concatenate([np.full(3, vc), np.full(2, 99.0)])

    def apply(v: np.ndarray, fa: np.ndarray, h: float, rec: Rec, st: dict) -> np.ndarray:
        return fa * core.wrinkle_state(v, vcs, on, off, h, np.zeros(vcs.size))

    return Effect(act=apply)


def clamp_slip(form: str, s: float, q: dict, w: World) -> Effect:
    fs = w.f_peak / (1 + s)
    kh = w.k_peak * span(q["u1"], 0.6, 3.0)
    if form == "slider":
        return Effect(contact=(core.COULOMB, [kh, fs, fs]))
    if form == "stribeck":
        return Effect(contact=(core.COULOMB, [kh, fs, fs * span(q["u2"], 0.7, 0.95)]))
    if form == "iwan":
        m = 6
        share = np.linspace(0.5, 1.6, m)
        stiff = 40.0 * w.k_peak / m
        return Effect(contact=(core.IWAN, [m, kh, 0, 0, *(fs * share / m), *([stiff] * m)]))
    if form == "bouc_wen":
        return Effect(contact=(core.BOUC, [kh, fs, fs / (60 * w.k_peak), span(q["u2"], 1.2, 4.0)]))
    f0 = fs / span(q["u2"], 6, 12)
    speed = 2.0 * w.a_max * np.exp(-fs / f0)
    return Effect(contact=(core.CREEP, [kh, f0, speed]))


def mains_hum(form: str, s: float, q: dict, w: World) -> Effect:
    def apply(t: np.ndarray, rec: Rec, st: dict) -> np.ndarray:
        r = np.random.default_rng(int(q["u2"] * 1e9) + rec.index)
        ph = r.uniform(0, 2 * np.pi, 8)
        f = 50.0 + 0.02 * r.normal()
        w0 = 2 * np.pi * f * t
        if form == "two_lines":
            return s * (np.sin(w0 + ph[0]) + 0.3 * np.sin(2 * w0 + ph[1]))
        if form == "harmonics":
            return s * sum(np.sin((j + 1) * w0 + ph[j]) / (j + 1) ** 0.8 for j in range(5)) * 0.8
        if form == "wandering":
            n = int(t[-1]) + 4
            walk = np.cumsum(r.normal(size=n)) * 0.25
            return s * np.sin(w0 + CubicSpline(np.arange(n), walk)(t) + ph[0])
        if form == "pulses":
            x = (2 * f * t + ph[0] / 6.28) % 1.0
            pulse = np.exp(-0.5 * ((x - 0.5) / 0.1) ** 2)
            sign = np.where(((f * t + ph[0] / 12.57) % 1.0) < 0.5, 1.0, -0.7)
            return 1.8 * s * pulse * sign
        return s * (0.2 + 1.6 * r.random()) * (np.sin(w0 + ph[0]) + 0.5 * np.sin(3 * w0 + ph[1]))

    return Effect(drift=apply)


def sensor_saturation(form: str, s: float, q: dict, w: World) -> Effect:
    peak = w.files["peak"]
    lim = peak / (1 + s)

    def apply(ch: dict, rec: Rec, st: dict) -> None:
        y = ch["force"]
        if form == "clip":
            y = np.clip(y, -lim, lim)
        elif form == "rounded":
            b = span(q["u1"], 0.03, 0.15) * lim
            over = np.maximum(np.abs(y) - lim, 0)
            y = np.sign(y) * (np.minimum(np.abs(y), lim) + b * np.tanh(over / b))
        elif form == "leaning":
            over = np.maximum(np.abs(y) - lim, 0)
            y = np.sign(y) * (np.minimum(np.abs(y), lim) + span(q["u1"], 0.1, 0.4) * over)
        elif form == "stops":
            out = np.zeros_like(y)
            for z in np.linspace(1.0, 1.0 + 0.5 * s + 0.02, 5):
                out += np.clip(y, -lim * z, lim * z)
            y = out / 5
        else:  # overload: the amplifier is held and comes back slowly
            clipped = np.clip(y, -lim, lim)
            lost = y - clipped
            a = np.exp(-1 / (rec.rate * lspan(q["u1"], 0.003, 0.03)))
            tail = lfilter([1 - a], [1, -a], lost)
            y = np.where(lost != 0, clipped, clipped + 0.5 * tail)
        ch["force"] = y

    return Effect(sensor=apply)


def passive_strip(form: str, s: float, q: dict, w: World) -> Effect:
    """Strip in series; s = 1 - k_P/(k + k_P) at low frequency, its compliance share. The metadata know nothing of it."""
    s = min(s, 0.85)
    kp = w.k0 * (1 - s) / s
    tau = lspan(q["u1"], 0.01, 3.0)
    if form == "elastic":
        arms: list[tuple[float, float]] = []
    elif form == "zener":
        arms = [(kp * span(q["u2"], 0.5, 4.0), tau)]
    elif form == "power_law":
        arms = springpot(kp * span(q["u2"], 0.2, 0.8), span(q["u3"], 0.15, 0.35), 1e-3, 30)
    elif form == "spectrum":
        arms = [(kp * span(q["u2"], 0.5, 3.0) / 5, float(t)) for t in spread(5, tau, 0.8)]
    else:  # graded: stiffening steps towards the clamp, slow and fast
        arms = [(kp * span(q["u2"], 0.3, 1.5), tau), (kp * span(q["u3"], 0.3, 1.5), tau / 12)]
    flat: list[float] = [kp, float(len(arms))]
    for k, t in arms:
        flat += [k, t]
    return Effect(film=(core.STRIP, flat))


BUILDERS: dict[str, Callable[[str, float, dict, World], Effect]] = {name: globals()[name] for name in SPEC}


def severity_of(mech: str, form: str, s: float, q: dict, w: World) -> dict[str, float]:
    """Severity in the keys of physics.md section 5."""
    if mech == "slack":
        return {"onset": 1 / (1 + s), "ladder": s, "onset_tension_n": w.files["f_neg"] / (1 + s)}
    if mech == "wrinkling":
        return {"onset_kv": w.v_max / (1 + s), "ladder": s}
    if mech == "clamp_slip":
        return {"slip_force": 1 / (1 + s), "ladder": s, "slip_force_n": w.f_peak / (1 + s)}
    if mech == "sensor_saturation":
        return {"limit_n": w.files["peak"] / (1 + s), "ladder": s}
    if mech == "passive_strip":
        return {"ratio": 1 - s, "time_constant_s": lspan(q["u1"], 0.01, 3.0)}
    if mech == "rig_constants":
        sg = 1.0 if q["u0"] > 0.5 else -1.0
        if form == "both":
            return {"mass_error": sg * s * span(q["u1"], -0.9, 0.5), "stiffness_error": sg * s}
        if form in ("frame_compliance", "gel_mount"):
            return {"stiffness_error": -s}
        return {"mass_error": s}
    if mech == "gain_error":
        return {"gain": s if q["u0"] < 0.5 else -s}
    if mech == "drive_offset":
        return {"offset_kv": -s if form == "dead_band" or q["u0"] >= 0.5 else s}
    if mech == "baseline_drift":
        return {"per_decade": -s if q["u0"] < 0.75 else s}
    if mech == "thermal_softening":
        b = span(q["u1"], 0.006, 0.03)
        return {"softening": s, "per_kelvin": b, "rise_k": s / b}
    return {SPEC[mech][1]: s}


__all__ = ["BUILDERS", "FORMS", "SPEC", "build", "film_k", "severity_of"]
