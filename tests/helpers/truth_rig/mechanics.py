"""Film, contact, clamp and load cell in the time domain: one integrator, fourth-order Runge-Kutta.

Film: springs and dampers under a strain measure; each arm's damper displacement q is a state, q' = (u − q)/τ. Clamp and
load cell: the oscillator they are. States that change slowly against a step (damage, running amplitude, temperature,
slip, ladders of arms) are advanced between steps. Everything an effect adds vanishes exactly where its parameter is 0.

Does not belong here: drive and actuation, which are settled before; sensors, which come after.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from tests.helpers.truth_rig.jit import kernel


class Law(NamedTuple):
    """Constants of the mechanics in N, mm, s. All but the first four are 0 in the plain rig.

    `drag` N s/mm grows with the clamp's speed, half way at `drag_speed`. `second_…`: small mass on the clamp, whose damping doubles with its speed. `payne_…`:
    drop of stiffness and its amplitude scale mm. `damage_…`: loss, strain scale mm, curvature, cycles. `heat_…`: kelvin
    per N mm, time constant s, loss of stiffness per kelvin. `slack_…`: share of the preload in which the film buckles,
    residual stiffness share. `limit_mm`, `limit_offset`: Gent-type strain measure. `slip_…`: least force N,
    hardening N/mm and spread of the sliders. `misaligned` N/mm² and its time s. `wave_…`: transverse mode, stiffness N/mm, rad/s, damping ratio.
    """

    mass: float
    cell_stiffness: float
    cell_damping: float
    preload: float
    drag: float = 0.0
    drag_speed: float = 1.0
    second_mass: float = 0.0
    second_stiffness: float = 0.0
    second_damping: float = 0.0
    second_speed: float = 1.0
    payne_drop: float = 0.0
    payne_scale: float = 1.0
    damage_loss: float = 0.0
    damage_scale: float = 1.0
    damage_curvature: float = 1.0
    damage_cycles: float = 1.0
    heat_per_energy: float = 0.0
    heat_time: float = 1.0
    heat_loss: float = 0.0
    slack_softness: float = 0.0
    slack_residual: float = 0.0
    limit_mm: float = 0.0
    limit_offset: float = 0.0
    slip_force: float = 0.0
    slip_hardening: float = 0.0
    slip_spread: float = 1.0
    misaligned: float = 0.0
    misaligned_time: float = 0.0
    wave_stiffness: float = 0.0
    wave_rate: float = 1.0
    wave_damping: float = 0.0

    def record(self) -> Any:
        """The constants as the kernels take them: by reference, not as thirty arguments."""
        return np.array([tuple(self)], dtype=[(name, np.float64) for name in self._fields])[0]


OF_THE_CELL = ("drag", "drag_speed", "second_mass", "second_stiffness", "second_damping", "second_speed")
"""Constants that stay when there is no film."""

# What the film remembers from recording to recording, by index.
LARGEST, DAMAGE, PATH, HEAT, SLIDER = range(5)
SLIDERS = 4
"""Sliders of the clamp, each a play operator of the tension; their memories begin at `SLIDER`."""
MEMORY = SLIDER + SLIDERS


@kernel
def strain_measure(e, law):
    """Strain measure u(e) in mm and its slope; u = e where there is no limit. u(0) = 0, u'(0) = 1."""
    if law.limit_mm <= 0.0:
        return e, 1.0
    v0 = law.limit_offset
    v = min(max(v0 + e / law.limit_mm, -0.97), 0.97)
    slope0 = (1 + v0 * v0) / (1 - v0 * v0) ** 2
    slope = (1 + v * v) / (1 - v * v) ** 2
    return law.limit_mm * (v / (1 - v * v) - v0 / (1 - v0 * v0)) / slope0, slope / slope0


@kernel
def slipped(tension, stiffness, law, memory):
    """How far the film slips at once, mm, when its tension N would be `tension` without, falling by `stiffness` per mm.

    Sliders of forces from `slip_force` to `slip_spread` times that, each as compliant as four hardening springs; none has
    a rate. Changes their places in `memory`.
    """
    each = 1 / (SLIDERS * law.slip_hardening)
    moving = np.zeros(SLIDERS, dtype=np.bool_)
    reach = np.zeros(SLIDERS)
    for i in range(SLIDERS):
        force = law.slip_force * law.slip_spread ** (i / (SLIDERS - 1))
        away = tension - memory[SLIDER + i]
        if abs(away) > force:
            moving[i] = True
            reach[i] = memory[SLIDER + i] + math.copysign(force, away)
    total = 0.0
    for _ in range(SLIDERS):
        pull, count = 0.0, 0
        for i in range(SLIDERS):
            if moving[i]:
                pull += each * (tension - reach[i])
                count += 1
        total = pull / (1 + stiffness * each * count)
        settled = True
        for i in range(SLIDERS):
            if moving[i] and (tension - stiffness * total - reach[i]) * (tension - reach[i]) <= 0.0:
                moving[i], settled = False, False
        if settled:
            break
    for i in range(SLIDERS):
        if moving[i]:
            memory[SLIDER + i] += tension - stiffness * total - reach[i]
    return total


@kernel
def _rate(y, d, x0, v0, fa, g, past, spring, u_before, slip, law, k_sum, k, rate, strip_sum, strip_k, strip_rate):
    """Time derivatives `d` of the states `y`; returns film tension over the preload, film extension, strain measure.

    y: clamp position and speed, damper displacements of the film's arms, of the strip's arms, then where they are there
    the second mass and the transverse mode, position and speed each. `past`, `spring`: force of the ladder arms if the strain measure stayed, and per mm of its change.
    """
    n, m = k.size, strip_k.size
    held = 0.0
    for i in range(n):
        held += k[i] * y[2 + i]
    total = x0 - y[0] - slip
    e = total
    if m > 0:
        strip_held = 0.0
        for i in range(m):
            strip_held += strip_k[i] * y[2 + n + i]
        e = total * strip_sum / (k_sum + strip_sum)
        for _ in range(20):
            u, slope = strain_measure(e, law)
            excess = g * (k_sum * u - held) + past + spring * (u - u_before) - fa - strip_sum * (total - e) + strip_held
            change = excess / (g * k_sum * slope + spring * slope + strip_sum)
            e -= change
            if abs(change) < 1e-13:
                break
    u, _ = strain_measure(e, law)
    tension = g * (k_sum * u - held) + past + spring * (u - u_before) - fa
    further = 2 + n + m
    if law.wave_stiffness > 0.0:
        lag = e - y[further + 2]
        tension += law.wave_stiffness * lag
        d[further + 2] = y[further + 3]
        d[further + 3] = law.wave_rate * (law.wave_rate * lag - 2 * law.wave_damping * y[further + 3])
    if law.misaligned != 0.0:
        tension += law.misaligned * (e * e + 2 * law.misaligned_time * e * (v0 - y[1]))
    if law.slack_softness > 0.0 and tension < -law.preload:
        width = law.slack_softness * law.preload
        below = (tension + law.preload) / width
        kept = law.slack_residual
        tension = kept * width * below + (1 - kept) * width * below / (1 - below) - law.preload
    damping = law.cell_damping
    if law.drag > 0.0:
        speed = abs(y[1])
        damping += law.drag * (0.6 + 0.8 * speed / (speed + law.drag_speed))
    push = tension - law.cell_stiffness * y[0] - damping * y[1]
    if law.second_mass > 0.0:
        slide = y[further + 1] - y[1]
        rubbing = 0.6 + 0.8 * abs(slide) / (abs(slide) + law.second_speed)
        pull = law.second_stiffness * (y[further] - y[0]) + law.second_damping * rubbing * slide
        push += pull
        d[further] = y[further + 1]
        d[further + 1] = -pull / law.second_mass
    d[0] = y[1]
    d[1] = push / law.mass
    for i in range(n):
        d[2 + i] = (u - y[2 + i]) * rate[i]
    for i in range(m):
        d[2 + n + i] = (total - e - y[2 + n + i]) * strip_rate[i]
    return tension, e, u


@kernel
def integrate(
    x0, v0, fa, gain, step, law, k0, k, tau, strip_k0, strip_k, strip_tau, ladder_k, ladder_tau,
    tear_path, tear_loss, memory, ladder, kick, clamp, extension, tension,
):  # fmt: skip
    """Integrate one recording from rest.

    x0, v0, fa : (2 N + 1,) driven end mm and mm/s, actuation force at the ends N, at half steps
    gain : (N,) or (1,) stiffness of the film over its nominal one, from the room
    k0, k, tau; strip_k0, …; ladder_k, … : film, strip in series (none: empty), further arms (none: empty)
    tear_path, tear_loss : path mm at which the film tears and the stiffness share lost
    memory (8,), ladder (arms,) : carried from recording to recording, changed in place
    kick : (N,) speed mm/s given to the clamp before a step, or empty
    clamp, extension, tension : (N + 1,) filled with clamp position mm, film extension mm, film tension over preload N
    """
    steps, n, m, arms = clamp.size - 1, k.size, strip_k.size, ladder_k.size
    k_sum, strip_sum = k0 + k.sum(), strip_k0 + strip_k.sum()
    rate, strip_rate = 1 / tau, 1 / strip_tau
    half_decay, half_spring = np.empty(arms), np.empty(arms)
    decay, rise = np.empty(arms), np.empty(arms)
    for i in range(arms):
        h = step / ladder_tau[i]
        decay[i], rise[i] = math.exp(-h), -ladder_k[i] * math.expm1(-h) / h
        half_decay[i], half_spring[i] = math.exp(-h / 2), -ladder_k[i] * math.expm1(-h / 2) / (h / 2)
    full_spring, mid_spring, stiff = rise.sum(), half_spring.sum(), ladder_k.sum()
    has_more = law.second_mass > 0.0 or law.wave_stiffness > 0.0
    size = 2 + n + m + (4 if has_more else 0)
    y, trial = np.zeros(size), np.zeros(size)
    d1, d2, d3, d4 = np.zeros(size), np.zeros(size), np.zeros(size), np.zeros(size)
    slip = 0.0
    for i in range(SLIDERS):
        slip += memory[SLIDER + i] / (SLIDERS * max(law.slip_hardening, 1e-9))
    amplitude, mean = 0.0, 0.0
    e = x0[0] - slip
    u = 0.0
    # Rest: dampers relaxed, clamp where the relaxed film, the carried arms and the actuation hold it.
    for _ in range(60):
        u, _s = strain_measure(e, law)
        force = gain[0] * k0 * u + ladder.sum() - fa[0]
        if m > 0:
            y[0] = force / law.cell_stiffness
            strip = force / strip_k0
            e += 0.5 * (x0[0] - y[0] - slip - strip - e)
            for i in range(m):
                y[2 + n + i] = strip
        else:
            y[0] += 0.7 * (force / law.cell_stiffness - y[0])
            e = x0[0] - y[0] - slip
    if has_more:
        y[2 + n + m] = y[0]
        y[4 + n + m] = e
    for i in range(n):
        y[2 + i] = u
    e_before = e
    for s in range(steps + 1):
        j = 2 * s
        g = gain[0] if gain.size == 1 else gain[min(s, gain.size - 1)]
        if law.payne_drop > 0.0:
            g *= 1 - law.payne_drop * (1 - math.exp(-((2 * amplitude / law.payne_scale) ** 1.2)))
        if law.damage_loss > 0.0 and memory[LARGEST] > 0.0:
            g *= 1 - memory[DAMAGE] * (1 - 0.3 * min(abs(e_before) / memory[LARGEST], 1.0))
        if law.heat_loss > 0.0:
            g *= math.exp(-law.heat_loss * memory[HEAT])
        for i in range(tear_path.size):
            if memory[PATH] > tear_path[i]:
                g *= 1 - tear_loss[i]
        if kick.size > 0 and s < steps:
            y[1] += kick[s]
        past = ladder.sum()
        t, e, u = _rate(
            y, d1, x0[j], v0[j], fa[j], g, past, stiff, u, slip, law, k_sum, k, rate, strip_sum, strip_k, strip_rate
        )
        if law.slip_force > 0.0:
            whole = g * k_sum + stiff
            if m > 0:
                whole = whole * strip_sum / (whole + strip_sum)
            moved = slipped(t, whole, law, memory)
            if moved != 0.0:
                slip += moved
                u_before = u
                t, e, u = _rate(
                    y, d1, x0[j], v0[j], fa[j], g, past, stiff, u_before, slip, law, k_sum, k, rate,
                    strip_sum, strip_k, strip_rate,
                )  # fmt: skip
                for i in range(arms):
                    ladder[i] += ladder_k[i] * (u - u_before)
                past = ladder.sum()
        clamp[s], extension[s], tension[s] = y[0], e, t
        if s == steps:
            break
        moved = abs(e - e_before)
        if s > 0 and moved > 0.0:
            memory[PATH] += moved
            if law.payne_drop > 0.0:
                size_now = abs(e - mean)
                amplitude += (size_now - amplitude) * -math.expm1(-moved / (8 * amplitude + 0.02 * law.payne_scale))
                mean += (e - mean) * -math.expm1(-moved / (16 * amplitude + 0.02 * law.payne_scale))
            if abs(e) > memory[LARGEST]:
                memory[LARGEST] = abs(e)
            if law.damage_loss > 0.0:
                curve = law.damage_curvature
                target = law.damage_loss * math.tanh(curve * memory[LARGEST] / law.damage_scale) / math.tanh(curve)
                if target > memory[DAMAGE]:
                    cycles = moved / (2 * memory[LARGEST])
                    memory[DAMAGE] += (target - memory[DAMAGE]) * -math.expm1(-cycles / law.damage_cycles)
        if law.heat_loss > 0.0:
            power = 0.0
            for i in range(n):
                power += k[i] * (u - y[2 + i]) ** 2 * rate[i]
            memory[HEAT] += step * (law.heat_per_energy * power - memory[HEAT] / law.heat_time)
        e_before = e
        mid_past, full_past = 0.0, 0.0
        for i in range(arms):
            mid_past += half_decay[i] * ladder[i]
            full_past += decay[i] * ladder[i]
        for i in range(size):
            trial[i] = y[i] + 0.5 * step * d1[i]
        _rate(
            trial, d2, x0[j + 1], v0[j + 1], fa[j + 1], g, mid_past, mid_spring, u, slip, law, k_sum, k, rate,
            strip_sum, strip_k, strip_rate,
        )  # fmt: skip
        for i in range(size):
            trial[i] = y[i] + 0.5 * step * d2[i]
        _rate(
            trial, d3, x0[j + 1], v0[j + 1], fa[j + 1], g, mid_past, mid_spring, u, slip, law, k_sum, k, rate,
            strip_sum, strip_k, strip_rate,
        )  # fmt: skip
        for i in range(size):
            trial[i] = y[i] + step * d3[i]
        _rate(
            trial, d4, x0[j + 2], v0[j + 2], fa[j + 2], g, full_past, full_spring, u, slip, law, k_sum, k, rate,
            strip_sum, strip_k, strip_rate,
        )  # fmt: skip
        for i in range(size):
            y[i] += step / 6 * (d1[i] + 2 * d2[i] + 2 * d3[i] + d4[i])
        if arms > 0:
            # The ladder's arms take the step exactly for a strain measure that moves linearly within it.
            _t, _e, u_next = _rate(
                y, d2, x0[j + 2], v0[j + 2], fa[j + 2], g, full_past, full_spring, u, slip, law, k_sum, k, rate,
                strip_sum, strip_k, strip_rate,
            )  # fmt: skip
            for i in range(arms):
                ladder[i] = decay[i] * ladder[i] + rise[i] * (u_next - u)
            u = u_next


@kernel
def creep(force, gain, step, k0, k, tau):
    """Extension (N + 1,) mm of a film of relaxed spring `k0` and arms under a force (N + 1,) N, from rest under force[0].

    Arms take each step exactly for an extension that moves linearly within it.
    """
    n = k.size
    decay, rise, f = np.empty(n), np.empty(n), np.zeros(n)
    for i in range(n):
        h = step / tau[i]
        decay[i], rise[i] = math.exp(-h), -k[i] * math.expm1(-h) / h
    spring = rise.sum()
    out = np.empty(force.size)
    out[0] = force[0] / (gain[0] * k0)
    for s in range(1, force.size):
        g = gain[0] if gain.size == 1 else gain[min(s, gain.size - 1)]
        past = 0.0
        for i in range(n):
            past += decay[i] * f[i]
        out[s] = (force[s] / g - past + spring * out[s - 1]) / (k0 + spring)
        for i in range(n):
            f[i] = decay[i] * f[i] + rise[i] * (out[s] - out[s - 1])
    return out
