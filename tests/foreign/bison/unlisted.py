"""Effects that no listed mechanism is."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

from . import core
from .effects import later, lspan, session_end, span
from .plan import Rec, World
from .simulate import Effect

# name: stage, depends on, needs, smallest and largest size, key
UNLISTED: dict[str, tuple[str, tuple[str, ...], tuple[str, ...], float, float, str]] = {
    "frame_resonance": ("rig", ("frequency",), ("mech",), 1e-4, 0.3, "reaction_share"),
    "coil_pickup": ("sensor", ("frequency", "rate"), ("mech",), 1e-4, 0.3, "share_of_inertia"),
    "voltage_rate_crosstalk": ("sensor", ("voltage", "frequency"), ("elec",), 1e-7, 3e-3, "n_s_per_kv"),
    "laser_tilt": ("sensor", ("amplitude",), ("mech",), 1e-4, 0.2, "square_share"),
    "humidity": ("film", ("session_time",), ("mech",), 1e-3, 0.8, "shift_of_times"),
    "charge_trapping": ("actuation", ("voltage", "exposure"), ("elec",), 1e-3, 0.5, "trapped_share"),
    "rocking_armature": ("rig", ("frequency",), ("mech",), 1e-4, 0.3, "gain_at_100_hz"),
    "rod_expansion": ("rig", ("record_time",), ("any",), 1e-5, 0.1, "stroke_mm"),
    "remanent_polarisation": ("actuation", ("voltage",), ("elec",), 1e-3, 0.5, "remanent_share"),
    "membrane_mode": ("film", ("frequency",), ("mech",), 1e-4, 0.5, "modal_share"),
    "rod_backlash": ("rig", ("amplitude",), ("mech",), 1e-4, 0.3, "play_share"),
    "converter_ripple": ("sensor", ("amplitude",), ("any",), 1e-5, 0.05, "ripple_share"),
    "floor_vibration": ("rig", ("record_time",), ("any",), 1e-5, 0.2, "level_share"),
    "baseline_jumps": ("drift", ("record_time",), ("any",), 1e-5, 0.1, "jump_share"),
    "supply_ripple": ("drive", ("voltage", "record_time"), ("elec",), 1e-4, 0.3, "ripple_share"),
    "edge_tear": ("film", ("largest_strain", "amplitude"), ("mech",), 1e-3, 0.8, "torn_share"),
    "air_squeeze": ("film", ("amplitude", "rate"), ("mech",), 1e-4, 0.3, "rate_share"),
    "tiring_actuation": ("actuation", ("session_time", "voltage"), ("elec",), 1e-3, 0.5, "recovery_share"),
}


def build_unlisted(name: str, s: float, q: dict[str, float], w: World) -> Effect:
    """The effect of an unlisted cause at size s."""
    return globals()["_" + name](s, q, w)


def _frame_resonance(s: float, q: dict, w: World) -> Effect:
    """A mode of the table, driven by the reaction of the shaker, moves the foot of the load cell."""
    f_c = np.sqrt(w.kl / w.mass) / (2 * np.pi)
    f = span(q["u1"], 12, 95)
    if abs(np.log(f / f_c)) < 0.25:
        f *= 1.5 if f < 60 else 0.6
    m = 3.0 * w.mass / s
    k = m * (2 * np.pi * f) ** 2
    c = 2 * span(q["u2"], 0.01, 0.04) * np.sqrt(k * m)
    return Effect(rig=(core.FRAME, [m, k, c, w.mass * span(q["u3"], 1.0, 4.0)]))


def _coil_pickup(s: float, q: dict, w: World) -> Effect:
    """The current of the voice coil, as its acceleration, couples into the bridge of the load cell."""

    def apply(ch: dict, rec: Rec, st: dict) -> None:
        if "displacement" in ch:
            t = np.arange(ch["displacement"].size) / rec.rate
            ch["force"] = ch["force"] + s * w.mass * CubicSpline(t, ch["displacement"])(t, 2)

    return Effect(sensor=apply)


def _voltage_rate_crosstalk(s: float, q: dict, w: World) -> Effect:
    """Displacement current of the high-voltage lead in the bridge."""

    def apply(ch: dict, rec: Rec, st: dict) -> None:
        if "voltage" in ch:
            v = ch["voltage"]
            ch["force"] = ch["force"] + s * np.gradient(v) * rec.rate

    return Effect(sensor=apply)


def _laser_tilt(s: float, q: dict, w: World) -> Effect:
    """The laser's target tilts: the reading has a square of the motion."""
    sg = 1.0 if q["u0"] < 0.5 else -1.0

    def apply(ch: dict, rec: Rec, st: dict) -> None:
        if "displacement" in ch:
            x = ch["displacement"]
            ch["displacement"] = x + sg * s * x * x / w.a_max

    return Effect(sensor=apply)


def _humidity(s: float, q: dict, w: World) -> Effect:
    """Damp air plasticises: the times of relaxation shift, the permittivity rises."""
    tau = span(q["u1"], 0.2, 0.7) * session_end(w)

    def wet(rec: Rec, t: np.ndarray) -> np.ndarray:
        return 1 - np.exp(-(rec.t0 + t) / tau)

    def scale(rec: Rec, t: np.ndarray, st: dict) -> tuple[float, np.ndarray]:
        return 1.0, np.exp(s * wet(rec, t))

    def act(v: np.ndarray, fa: np.ndarray, h: float, rec: Rec, st: dict) -> np.ndarray:
        return fa * (1 + 0.25 * s * wet(rec, np.arange(fa.size) * h))

    return Effect(scale=scale, act=act)


def _charge_trapping(s: float, q: dict, w: World) -> Effect:
    """Charge creeps into the film, opposes the field and stays for a while."""
    tau = lspan(q["u1"], 1.0, 8.0)

    def act(v: np.ndarray, fa: np.ndarray, h: float, rec: Rec, st: dict) -> np.ndarray:
        slow = core.relax_sum(v, np.array([tau, 6 * tau]), np.array([0.6, 0.4]), h, np.zeros(2))
        return w.gain * (v - s * slow) ** 2

    return Effect(act=act)


def _rocking_armature(s: float, q: dict, w: World) -> Effect:
    """The armature rocks between laser spot and clamp: the film moves more towards a rocking mode above the band."""
    sg = 1.0 if q["u0"] < 0.5 else -1.0
    f0 = span(q["u1"], 180, 320)
    z = 0.03

    def move(x: np.ndarray, h: float, rec: Rec, st: dict) -> np.ndarray:
        om = 2 * np.pi * f0
        den = np.array([4 + 4 * z * om * h + (om * h) ** 2, -8 + 2 * (om * h) ** 2, 4 - 4 * z * om * h + (om * h) ** 2])
        num = np.array([4.0, -8.0, 4.0])
        return x + sg * s * (f0 / 100) ** 2 * -lfilter(num / den[0], den / den[0], x)

    return Effect(motion=move)


def _rod_expansion(s: float, q: dict, w: World) -> Effect:
    """The drive rod breathes with the air conditioning; the laser looks at its cold end."""
    per = lspan(q["u1"], 15, 70)

    def drift(t: np.ndarray, rec: Rec, st: dict) -> np.ndarray:
        ph = 2 * np.pi * (rec.t0 + t) / per
        saw = np.sin(ph) + 0.35 * np.sin(2 * ph + 1.0)
        if rec.loading == "calibration":
            return np.zeros_like(t)
        return w.k0 * s * w.length / 50 * saw

    return Effect(drift=drift)


def _remanent_polarisation(s: float, q: dict, w: World) -> Effect:
    """Domains that keep part of their polarisation: the force depends on whether the voltage rises or falls."""
    rs = w.v_max * np.linspace(0.05, 0.45, 5)

    def act(v: np.ndarray, fa: np.ndarray, h: float, rec: Rec, st: dict) -> np.ndarray:
        keep = st.setdefault("domains", np.zeros(rs.size))
        p = np.zeros_like(v)
        for j, r in enumerate(rs):
            y = core.play(v, float(r), float(keep[j]))
            keep[j] = y[-1]
            p += y
        return fa + w.gain * s * v * (p / rs.size - 0.7 * v)

    return Effect(act=act)


def _membrane_mode(s: float, q: dict, w: World) -> Effect:
    """The film's own transverse mode takes energy near one frequency."""
    f_c = np.sqrt(w.kl / w.mass) / (2 * np.pi)
    f = span(q["u1"], 15, 85)
    if abs(np.log(f / f_c)) < 0.25:
        f *= 1.5 if f < 55 else 0.6
    k = s * w.k_peak
    m = k / (2 * np.pi * f) ** 2
    return Effect(film=(core.MEMBRANE, [k, m, 2 * span(q["u2"], 0.015, 0.05) * np.sqrt(k * m), 1.0]), persist=False)


def _rod_backlash(s: float, q: dict, w: World) -> Effect:
    """Play between rod and clamp: the film follows the laser's motion with a dead way."""
    r = s * w.a_max * 0.5

    def move(x: np.ndarray, h: float, rec: Rec, st: dict) -> np.ndarray:
        return core.play(x, r, 0.0)

    return Effect(motion=move)


def _converter_ripple(s: float, q: dict, w: World) -> Effect:
    """Integral nonlinearity of the converter, periodic in the reading."""
    top = w.preload + w.f_peak
    per = top / span(q["u1"], 7, 30)

    def apply(ch: dict, rec: Rec, st: dict) -> None:
        y = ch["force"]
        ch["force"] = y + s * top * 0.2 * (np.sin(2 * np.pi * y / per) + 0.4 * np.sin(4 * np.pi * y / per + 1))

    return Effect(sensor=apply)


def _floor_vibration(s: float, q: dict, w: World) -> Effect:
    """A pump next door: a narrow band that comes and goes, through the clamp's inertia."""
    f = span(q["u1"], 9, 33)

    def drift(t: np.ndarray, rec: Rec, st: dict) -> np.ndarray:
        r = np.random.default_rng(int(q["u2"] * 1e9) + rec.index)
        n = int(t[-1]) + 5
        env = np.abs(CubicSpline(np.arange(n), r.normal(size=n))(t))
        walk = CubicSpline(np.arange(n), np.cumsum(r.normal(size=n)) * 0.6)(t)
        return s * 0.2 * w.preload * env * np.sin(2 * np.pi * f * t + walk)

    return Effect(drift=drift)


def _baseline_jumps(s: float, q: dict, w: World) -> Effect:
    """The bridge jumps now and then (a bad contact), and stays."""

    def drift(t: np.ndarray, rec: Rec, st: dict) -> np.ndarray:
        r = np.random.default_rng(int(q["u2"] * 1e9) + rec.index)
        y = np.zeros_like(t)
        for at in r.uniform(0, t[-1], r.integers(1, 5)):
            y += np.where(t > at, s * w.preload * r.normal(), 0.0)
        return y

    return Effect(drift=drift)


def _supply_ripple(s: float, q: dict, w: World) -> Effect:
    """The converter's ripple, filtered away in the monitor, proportional to the voltage."""
    f = span(q["u1"], 21, 47)

    def drive(v: np.ndarray, h: float, rec: Rec, st: dict) -> np.ndarray:
        r = np.random.default_rng(int(q["u2"] * 1e9) + rec.index)
        t = np.arange(v.size) * h
        return v * (1 + s * np.sin(2 * np.pi * f * t + r.uniform(0, 6.28)))

    return Effect(drive=drive)


def _edge_tear(s: float, q: dict, w: World) -> Effect:
    """A tear at the edge that opens under tension only and grows beyond a strain; it stays."""
    return Effect(film=(core.TEAR, [0, s, w.a_max * span(q["u1"], 0.25, 0.55), lspan(q["u2"], 0.05, 0.5), 1.5]))


def _air_squeeze(s: float, q: dict, w: World) -> Effect:
    """The air between film and guard is squeezed: a force on the clamp with the square of the speed's sign."""

    def push(x: np.ndarray, v: np.ndarray, h: float, rec: Rec, st: dict) -> np.ndarray:
        if rec.loading != "mechanical":
            return np.zeros_like(x)
        vel = np.gradient(x, h)
        top = 2 * np.pi * 60 * w.a_max
        # only when the film opens (moves away), a suction
        return -s * w.f_peak * np.where(vel > 0, (vel / top) ** 2, 0.15 * (vel / top) ** 2)

    return Effect(force_in=push)


def _tiring_actuation(s: float, q: dict, w: World) -> Effect:
    """Actuation recovers with the time of rest between recordings and tires while driven (reversible)."""
    tau_d, tau_r = lspan(q["u1"], 5, 30), lspan(q["u2"], 100, 600)

    def act(v: np.ndarray, fa: np.ndarray, h: float, rec: Rec, st: dict) -> np.ndarray:
        z0 = st.get("tired", 0.0) * np.exp(-(rec.t0 - st.get("tired_at", 0.0)) / tau_r)
        z = core.relax_sum((v / w.v_max) ** 2, np.array([tau_d]), np.ones(1), h, np.array([z0]))
        st["tired"], st["tired_at"] = float(z[-1]), rec.t0 + rec.duration
        return fa * (1 - s * z)

    return Effect(act=act)


__all__ = ["UNLISTED", "build_unlisted", "later"]
