"""Implicit time integration of film (trapezoidal rule), contact and rig (Newmark with beta 1/12, fourth order).

The film is a spring with dashpots whose internal strains are integrated; the unknown of a step is the place of the
clamp. All quantities are deviations from the rested, pre-stretched state. Base units N, mm, s.
"""

from __future__ import annotations

import numpy as np
from numba import njit

# codes of the film law
LINEAR, STIFFEN, SOFTEN, DAMAGE, SLACK, STRIP, MEMBRANE, EYRING, TEAR, HEAT = range(10)
# codes of the contact
NO_CONTACT, COULOMB, IWAN, BOUC, CREEP = range(5)
# codes of the rig
NO_RIG, DRAG, FRICTION, CELL_ARMS, TUNED, HARDEN, FRAME = range(7)


@njit(cache=True)
def stretch_map(e: float, p: np.ndarray, chi: float) -> float:
    """Effective extension g(e) of a stiffening film; p[0] form, p[1] size b at the scale p[2] (mm)."""
    form = int(p[0])
    b = p[1]
    r = e / p[2]
    if form == 0:  # Ogden-like: even and odd term, as a law in the stretch gives
        a = p[3]
        lam = 1.0 + p[4] * r
        lam = max(lam, 0.3)
        n = (lam**a - 1.0) / (a * p[4])
        return e + b * p[5] * p[2] * (n - r)
    if form == 1:  # Gent: a limit of the chains
        j = p[3]
        q = r * r / (j * j)
        q = min(q, 0.95)
        return e * (1.0 + b * (1.0 / (1.0 - q) - 1.0) * p[4])
    if form == 2:  # fibres that straighten one after another
        g = 0.0
        m = 8
        for j in range(m):
            s = p[3] + (p[4] - p[3]) * (j + 0.5) / m
            if r > s:
                g += r - s
        return e + b * p[5] * p[2] * g / m
    if form == 3:  # chains of finite length (Pade of the inverse Langevin function)
        z = abs(r) / p[3]
        z = min(z, 0.93)
        return e * (1.0 + b * p[4] * ((3.0 - z * z) / (3.0 * (1.0 - z * z)) - 1.0))
    if form == 4:  # crystals that grow and melt: chi from its rate equation
        return e * (1.0 + b * chi)
    return e * (1.0 + b * (p[3] * r + (1.0 - p[3]) * r * r))


@njit(cache=True)
def film_factor(code: int, p: np.ndarray, st: np.ndarray, e: float) -> float:
    """Factor on the linear tension of softening, damaged or heated films (states of the last step)."""
    if code == SOFTEN:
        form = int(p[0])
        if form == 0:  # running amplitude, reversible bonds in equilibrium
            x = st[0] / p[2]
            return 1.0 - p[1] * (1.0 + p[4]) * (x ** (2 * p[3]) / (1.0 + x ** (2 * p[3])))
        if form == 1:  # rate equation of bonds that break by motion and heal
            return 1.0 - p[1] * st[1]
        if form == 2:  # domains that open at their own strain
            x = abs(e) / p[2]
            return 1.0 - p[1] * (1.0 - 1.0 / (1.0 + x ** p[3]))
        if form == 3:  # two-level domains, logistic in the running amplitude
            lo = 1.0 / (1.0 + np.exp(p[3]))
            return 1.0 - p[1] * (1.0 / (1.0 + np.exp(-(st[0] / p[2] - 1.0) * p[3])) - lo) / (1.0 - lo)
        x = st[2] / (p[2] * p[2])  # mean square of the strain
        return 1.0 - p[1] * x / (1.0 + x)
    if code == DAMAGE:
        return 1.0 - st[3]
    if code == HEAT:
        return 1.0 - p[1] * st[0]
    return 1.0


@njit(cache=True)
def film_commit(code: int, p: np.ndarray, st: np.ndarray, e: float, e_old: float, tension: float, h: float) -> None:
    """Advance the film's own states by one step."""
    if code == STIFFEN:
        if int(p[0]) == 4:
            r = e / p[2]
            goal = 0.0
            if r > p[3]:
                goal = (r - p[3]) / (1.0 - p[3])
            tau = p[4] if goal > st[0] else p[5]
            st[0] += h / (tau + h) * (goal - st[0])
    elif code == SOFTEN:
        form = int(p[0])
        # running amplitude: half of the span between decaying peaks
        a = h / p[5]
        st[3] = max(e, st[3] + a * (e - st[3]))
        st[4] = min(e, st[4] + a * (e - st[4]))
        st[0] = 0.5 * (st[3] - st[4])
        if form == 1:
            brk = h / p[4] * (st[0] / p[2]) ** p[3]
            hea = h / p[4]
            st[1] = (st[1] + brk) / (1.0 + brk + hea)
        elif form == 4:
            st[5] += h / (p[3] + h) * (e - st[5])
            st[2] += h / (p[5] + h) * (2.0 * (e - st[5]) ** 2 - st[2])
    elif code == DAMAGE:
        form = int(p[0])
        # st: 0 largest strain, 1 cycles so far, 2 running amplitude, 3 damage, 4/5 peaks, 6… populations
        a = h / p[5]
        st[4] = max(e, st[4] + a * (e - st[4]))
        st[5] = min(e, st[5] + a * (e - st[5]))
        amp = 0.5 * (st[4] - st[5])
        st[0] = max(st[0], abs(e))
        de = abs(e - e_old)
        amp_m = max(st[0], 1e-9)
        dn = de / (4.0 * max(amp, 0.1 * amp_m))
        st[1] += dn
        d = p[1]
        if form == 0:
            st[3] = d * (1.0 - np.exp(-st[0] / p[2])) * (1.0 - np.exp(-st[1] / p[3]))
        elif form == 1:  # rate equation towards the level of the present amplitude; no healing
            goal = d * (1.0 - np.exp(-amp / p[2]))
            if goal > st[3]:
                st[3] += dn / p[3] * (goal - st[3])
        elif form == 2:  # populations of bonds, each with its own breaking strain; only overloaded ones break
            m = 8
            s = 0.0
            for j in range(m):
                lim = p[2] * 0.25 * 1.6**j
                over = abs(e) / lim
                if over > 1.0:
                    st[6 + j] += de / (4.0 * lim) / p[3] * (1.0 - st[6 + j])
                s += st[6 + j]
            st[3] = d * s / m * 1.6
        elif form == 3:  # logarithmic in the count, a power in the largest strain
            x = st[0] / p[2]
            st[3] = d * x / (1.0 + x) * np.log(1.0 + st[1] / p[3] * 3.0) * 0.6
            st[3] = min(st[3], 0.7)
        else:  # below the largest strain so far the film is soft, on the virgin path it is not
            w = max(st[0] * st[0] - e * e, 0.0) / (p[2] * p[2])
            st[6] += dn / p[3] * (1.0 - st[6])
            hold = (1.0 - np.exp(-st[0] / p[2])) * st[6]
            st[3] = d * (0.45 * (w / (0.3 + w)) * (0.4 + 0.6 * st[6]) + 0.7 * hold)
    elif code == HEAT:
        st[0] += p[2] * tension * (e - e_old) - h / p[3] * st[0]
    elif code == TEAR:
        # st0 length of the tear (share), grows by the path beyond a strain
        over = abs(e) / p[2] - 1.0
        if over > 0.0:
            st[0] += p[3] * over * abs(e - e_old) / p[2] * (0.05 + st[0]) * max(0.0, 1.0 - st[0])


@njit(cache=True)
def slack_map(t: float, p: np.ndarray) -> float:
    """Tension of a film that cannot push; p[0] form, p[1] tension of the onset (a positive deviation)."""
    form = int(p[0])
    on = p[1]
    if form == 0:
        return max(-on, t)
    if form == 1:  # rounded corner, which begins at the onset
        c = on / (1.0 - p[2])
        b = c * p[2]
        if t >= -c + b:
            return t
        if t <= -c - b:
            return -c
        return -c + (t + c + b) ** 2 / (4.0 * b)
    if form == 2:  # fibres of different length: each goes slack at its own tension
        m = 12
        s = 0.0
        for j in range(m):
            o = on * (1.0 + p[2] * ((j + 0.5) / m * 2.0))
            s += max(-o, t)
        return s / m
    if form == 3:  # a rest of stiffness in bending
        return t if t > -on else -on + p[2] * (t + on)
    z = -(t + on)  # buckled film: stiffness falls steadily
    if z <= 0.0:
        return t
    return -on - p[2] * on * (1.0 - np.exp(-z / (p[2] * on)))


@njit(cache=True)
def slack_slope(t: float, p: np.ndarray) -> float:
    d = 1e-4 * (abs(p[1]) + 1e-6)
    return (slack_map(t + d, p) - slack_map(t - d, p)) / (2 * d)


@njit(cache=True)
def iwan_force(u: float, cp: np.ndarray, cst: np.ndarray) -> float:
    m = int(cp[0])
    s = cp[1] * u
    for j in range(m):
        q = cp[4 + m + j] * (u - cst[1 + j])
        lim = cp[4 + j]
        if q > lim:
            q = lim
        elif q < -lim:
            q = -lim
        s += q
    return s


@njit(cache=True)
def contact_step(code: int, t_try: float, kt: float, cp: np.ndarray, cst: np.ndarray, h: float) -> float:
    """Increment of slip for a trial tension; the tension falls by kt per slip."""
    u = cst[0]
    if code == COULOMB:  # cp: hold spring, static limit, dynamic limit, speed scale
        lim = cp[1]
        if cst[1] > 0.5:
            lim = cp[2]
        r = t_try - cp[0] * u
        if abs(r) <= lim:
            return 0.0
        lim = cp[2]
        du = (abs(r) - lim) / (kt + cp[0])
        return du if r > 0 else -du
    if code == IWAN:
        du = 0.0
        m = int(cp[0])
        for _ in range(6):
            f = t_try - kt * du - iwan_force(u + du, cp, cst)
            k = kt + cp[1]
            for j in range(m):
                if abs(cp[4 + m + j] * (u + du - cst[1 + j])) < cp[4 + j]:
                    k += cp[4 + m + j]
            step = f / k
            du += step
            if abs(step) < 1e-10:
                break
        return du
    if code == BOUC:  # cp: hold spring, slip force, yield way, exponent
        z = cst[1]
        num = t_try - cp[0] * u - cp[1] * z
        sg = 1.0 if num * z > 0 else -1.0
        dz = (1.0 - min(abs(z), 1.0) ** cp[3] * (0.5 * sg + 0.5)) / cp[2]
        return num / (kt + cp[0] + cp[1] * dz)
    # CREEP: activated sliding, cp: hold spring, force scale, speed
    du = 0.0
    for _ in range(8):
        r = (t_try - cp[0] * u - (kt + cp[0]) * du) / cp[1]
        r = min(r, 40.0)
        r = max(r, -40.0)
        f = du - h * cp[2] * np.sinh(r)
        df = 1.0 + h * cp[2] * np.cosh(r) * (kt + cp[0]) / cp[1]
        step = f / df
        du -= step
        if abs(step) < 1e-11:
            break
    return du


@njit(cache=True)
def contact_commit(code: int, du: float, cp: np.ndarray, cst: np.ndarray) -> None:
    cst[0] += du
    if code == COULOMB:
        cst[1] = 1.0 if abs(du) > 0.0 else 0.0
    elif code == IWAN:
        m = int(cp[0])
        for j in range(m):
            k = cp[4 + m + j]
            q = k * (cst[0] - cst[1 + j])
            if q > cp[4 + j]:
                cst[1 + j] = cst[0] - cp[4 + j] / k
            elif q < -cp[4 + j]:
                cst[1 + j] = cst[0] + cp[4 + j] / k
    elif code == BOUC:
        z = cst[1]
        sg = 1.0 if du * z > 0 else -1.0
        z += du / cp[2] * (1.0 - min(abs(z), 1.0) ** cp[3] * (0.5 * sg + 0.5))
        cst[1] = min(1.0, max(-1.0, z))


@njit(cache=True)
def integrate(
    x0: np.ndarray,
    fa: np.ndarray,
    scale: np.ndarray,
    speed: np.ndarray,
    h: float,
    every: int,
    k0: float,
    ks: np.ndarray,
    taus: np.ndarray,
    mass: float,
    kl: float,
    cl: float,
    fcode: int,
    fp: np.ndarray,
    fst: np.ndarray,
    ccode: int,
    cp: np.ndarray,
    cst: np.ndarray,
    rcode: int,
    rp: np.ndarray,
) -> np.ndarray:
    """Force of the load cell at every `every`-th step. x0 and fa on the fine grid; scale and speed of length 1 or n."""
    n = x0.size
    out = np.zeros((n - 1) // every + 1)
    na = ks.size
    al = np.zeros(na)
    var_scale = scale.size > 1
    var_speed = speed.size > 1
    q = h / (2.0 * taus) * speed[0]
    # arms of a strip: fp[0] spring, fp[1] count, then k and tau
    ns = int(fp[1]) if fcode == STRIP else 0
    bet = np.zeros(max(ns, 1))
    z_old = 0.0
    xp = 0.0
    v = 0.0
    a = 0.0
    g_old = 0.0
    e_old = 0.0
    xe = 0.0  # Eyring arm
    ym = 0.0
    vm = 0.0
    yt = 0.0
    vt = 0.0
    xb = 0.0
    vb = 0.0
    nr = int(rp[0]) if rcode == CELL_ARMS else 0
    gam = np.zeros(max(nr, 1))
    linear = fcode in (LINEAR, STRIP, DAMAGE, SOFTEN, HEAT, EYRING, MEMBRANE) and ccode == 0 and rcode in (0, 3, 4, 6)
    x0_1 = 0.0
    x0_2 = 0.0
    for i in range(1, n):
        sc = scale[i] if var_scale else scale[0]
        if var_speed:
            for j in range(na):
                q[j] = h / (2.0 * taus[j]) * speed[i]
        kt = k0
        hist = 0.0
        for j in range(na):
            w = 1.0 / (1.0 + q[j])
            kt += ks[j] * w
            hist += ks[j] * (al[j] * (1.0 - q[j]) + q[j] * g_old) * w
        kp = 0.0
        hp = 0.0
        if fcode == STRIP:
            kp = fp[0]
            for j in range(ns):
                qq = h / (2.0 * fp[3 + 2 * j])
                w = 1.0 / (1.0 + qq)
                kp += fp[2 + 2 * j] * w
                hp += fp[2 + 2 * j] * (bet[j] * (1.0 - qq) + qq * z_old) * w
        krig = kl
        hrig = 0.0
        if rcode == CELL_ARMS:
            for j in range(nr):
                qq = h / (2.0 * rp[2 + 2 * j])
                w = 1.0 / (1.0 + qq)
                krig += rp[1 + 2 * j] * w
                hrig += rp[1 + 2 * j] * (gam[j] * (1.0 - qq) + qq * xp) * w
        y = xp + h * v + 0.5 * h * h * a
        du = 0.0
        e = 0.0
        tens = 0.0
        g = 0.0
        z = 0.0
        rounds = 1 if linear else 3
        for _ in range(rounds):
            e = x0[i] - y
            tan = kt * sc
            if ccode != 0:
                e -= cst[0]
            for part in range(2):
                if fcode == STIFFEN:
                    g = stretch_map(e, fp, fst[0])
                    d = 1e-6
                    tan = kt * sc * (stretch_map(e + d, fp, fst[0]) - g) / d
                    tens = sc * (kt * g - hist)
                elif fcode == SLACK:
                    g = e
                    tl = sc * (kt * e - hist) - fa[i]
                    tens = slack_map(tl, fp) + fa[i]
                    tan = kt * sc * slack_slope(tl, fp) + 1e-9
                elif fcode == STRIP:
                    z = (sc * (kt * e - hist) - fa[i] + sc * hp) / (sc * (kt + kp))
                    g = e - z
                    tens = sc * (kt * g - hist)
                    tan = sc * kt * kp / (kt + kp)
                elif fcode == EYRING:
                    g = e
                    tens = sc * (kt * e - hist) + fp[0] * (e - xe)
                    tan = sc * kt + fp[0]
                elif fcode == MEMBRANE:
                    g = e
                    tens = sc * (kt * e - hist) + fp[0] * (fp[3] * e - ym) * fp[3]
                    tan = sc * kt + fp[0] * fp[3] * fp[3]
                elif fcode == TEAR:
                    g = e
                    f = 1.0 - fp[1] * fst[0]
                    if e > 0.0:
                        f -= fp[4] * fp[1] * fst[0] * e / (e + fp[2])
                    tens = sc * (kt * e - hist) * f
                    tan = sc * kt * f
                else:
                    g = e
                    f = film_factor(fcode, fp, fst, e) if fcode != LINEAR else 1.0
                    tens = sc * (kt * e - hist) * f
                    tan = sc * kt * f
                tens -= fa[i]
                if ccode == 0 or part == 1:
                    break
                du = contact_step(ccode, tens, tan, cp, cst, h)
                if du == 0.0:
                    break
                e -= du
            an = 12.0 * (y - xp - h * v) / (h * h) - 5.0 * a
            vn = v + 0.5 * h * (a + an)
            ext = 0.0
            dext = 0.0
            if rcode == DRAG:
                ext = rp[0] * abs(vn) * vn
                dext = 12.0 * rp[0] * abs(vn) / h
            elif rcode == FRICTION:
                th = np.tanh(vn / rp[1])
                ext = rp[0] * th
                dext = rp[0] * (1.0 - th * th) / rp[1] * 6.0 / h
            elif rcode == TUNED:
                ext = rp[1] * (y - yt) + rp[2] * (vn - vt)
            elif rcode == HARDEN:
                ext = kl * rp[0] * (y / rp[1]) ** 2 * y + kl * rp[2] * y * y / rp[1]
                dext = 3 * kl * rp[0] * (y / rp[1]) ** 2 + 2 * kl * rp[2] * y / rp[1]
            elif rcode == FRAME:
                ext = -kl * xb - cl * vb
            res = mass * an + krig * y - hrig + cl * vn + ext - tens
            jac = 12.0 * mass / (h * h) + krig + 6.0 * cl / h + dext + tan
            y -= res / jac
        if linear:
            # one Newton step is exact: bring the film's values to the solved place
            e2 = x0[i] - y
            if fcode == STRIP:
                z = (sc * (kt * e2 - hist) - fa[i] + sc * hp) / (sc * (kt + kp))
                g = e2 - z
            else:
                g = e2
            tens += tan * (e2 - e)
            e = e2
        elif ccode != 0:
            e = x0[i] - y - cst[0] - du
            g = e if fcode != STIFFEN else stretch_map(e, fp, fst[0])
        an = 12.0 * (y - xp - h * v) / (h * h) - 5.0 * a
        vn = v + 0.5 * h * (a + an)
        for j in range(na):
            al[j] = (al[j] * (1.0 - q[j]) + q[j] * (g_old + g)) / (1.0 + q[j])
        for j in range(ns):
            qq = h / (2.0 * fp[3 + 2 * j])
            bet[j] = (bet[j] * (1.0 - qq) + qq * (z_old + z)) / (1.0 + qq)
        for j in range(nr):
            qq = h / (2.0 * rp[2 + 2 * j])
            gam[j] = (gam[j] * (1.0 - qq) + qq * (xp + y)) / (1.0 + qq)
        if ccode != 0:
            contact_commit(ccode, du, cp, cst)
        if fcode == EYRING:
            r = fp[0] * (e - xe) / fp[1]
            r = min(r, 30.0)
            r = max(r, -30.0)
            slope = 1.0 + h * fp[2] * np.cosh(r) * fp[0] / fp[1]
            xe += h * fp[2] * np.sinh(r) / slope
        elif fcode == MEMBRANE:
            # fp: spring, mass, damper, coupling; a small mass driven by the stretch
            acc = (fp[0] * (fp[3] * e - ym) - fp[2] * vm) / fp[1]
            vm += h * acc
            ym += h * vm
        elif fcode != LINEAR:
            film_commit(fcode, fp, fst, e, e_old, tens, h)
        if rcode == TUNED:
            acc = (rp[1] * (y - yt) + rp[2] * (vn - vt)) / rp[0]
            vt += h * acc
            yt += h * vt
        elif rcode == FRAME:
            # rp: mass, spring, damper of the frame, reaction mass of the coil
            a0 = (x0[i] - 2.0 * x0_1 + x0_2) / (h * h) if i > 2 else 0.0
            acc = (kl * (y - xb) + cl * (vn - vb) - rp[1] * xb - rp[2] * vb - rp[3] * a0) / rp[0]
            vb += h * acc
            xb += h * vb
        x0_2 = x0_1
        x0_1 = x0[i]
        xp = y
        v = vn
        a = an
        e_old = e
        g_old = g
        z_old = z
        if i % every == 0:
            out[i // every] = kl * (xp - xb)
    return out


@njit(cache=True)
def one_pole(u: np.ndarray, tau_up: float, tau_down: float, slew: float, h: float, y0: float) -> np.ndarray:
    """First-order lag with its own time for rise and fall of the magnitude, and a limit of the rate."""
    y = np.empty_like(u)
    s = y0
    y[0] = s
    for i in range(1, u.size):
        tau = tau_up if abs(u[i]) >= abs(s) else tau_down
        if tau > 0:
            # exact for an input that is linear within the step
            x = h / tau
            e = np.exp(-x)
            m = 1.0 - (1.0 - e) / x if x > 1e-4 else 0.5 * x
            d = (1.0 - e) * (u[i - 1] - s) + m * (u[i] - u[i - 1])
        else:
            d = u[i] - s
        if d > slew * h:
            d = slew * h
        elif d < -slew * h:
            d = -slew * h
        s += d
        y[i] = s
    return y


@njit(cache=True)
def relax_sum(u: np.ndarray, taus: np.ndarray, ws: np.ndarray, h: float, st: np.ndarray) -> np.ndarray:
    """Weighted sum of trapezoidal low passes (rate equations of a population); st keeps their states."""
    y = np.zeros_like(u)
    m = taus.size
    prev = u[0]
    for i in range(u.size):
        s = 0.0
        for j in range(m):
            q = h / (2 * taus[j])
            st[j] = (st[j] * (1 - q) + q * (prev + u[i])) / (1 + q)
            s += ws[j] * st[j]
        prev = u[i]
        y[i] = s
    return y


@njit(cache=True)
def play(u: np.ndarray, r: float, y0: float) -> np.ndarray:
    """Play operator of half width r."""
    y = np.empty_like(u)
    s = y0
    for i in range(u.size):
        if u[i] - r > s:
            s = u[i] - r
        elif u[i] + r < s:
            s = u[i] + r
        y[i] = s
    return y


@njit(cache=True)
def wrinkle_state(v: np.ndarray, vc: np.ndarray, tau_on: float, tau_off: float, h: float, st: np.ndarray) -> np.ndarray:
    """Share of the force that a population of domains, each wrinkling beyond its voltage, still passes on."""
    y = np.empty_like(v)
    m = vc.size
    for i in range(v.size):
        s = 0.0
        a = abs(v[i])
        for j in range(m):
            goal = 0.0
            if a > vc[j]:
                goal = 1.0 - (vc[j] / a) ** 2
            tau = tau_on if goal > st[j] else tau_off
            st[j] += h / (tau + h) * (goal - st[j])
            s += st[j]
        y[i] = 1.0 - s / m
    return y


@njit(cache=True)
def leaky(v: np.ndarray, rs: float, a: float, n: float, tau: float, mem: float, h: float, st: np.ndarray) -> np.ndarray:
    """Voltage behind a series resistor with a current a|V|^n (state of conduction st[0] grows with time tau)."""
    y = np.empty_like(v)
    s = st[0]
    for i in range(v.size):
        u = abs(v[i])
        w = u
        for _ in range(6):
            f = w + rs * a * s * w**n - u
            w -= f / (1.0 + rs * a * s * n * max(w, 1e-9) ** (n - 1.0))
        y[i] = w if v[i] >= 0 else -w
        goal = 1.0 if mem == 0.0 else (1.0 - mem) + mem * 2.0 * (w / 7.0) ** 2
        s += h / (tau + h) * (goal - s)
    st[0] = s
    return y
