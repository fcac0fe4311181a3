"""Time integration: exact linear step with quadratic hold of the inputs, nonlinear parts by operator splitting."""

from __future__ import annotations

import numba as nb
import numpy as np
from scipy.linalg import expm

NLUT = 257
NSTATE = 24


def linear_model(k0: float, ki: np.ndarray, ti: np.ndarray, mass: float, kl: float, cl: float, strip: dict | None):
    """State matrices for [y_arms…, x', v'] and inputs [x0, F_A, N]; returns A, B and the tension row c, dx, df.

    y_i is the relaxing displacement of arm i: force of the arm ki (e - y_i), dy_i/dt = (e - y_i)/tau_i.
    """
    n = len(ki)
    if strip is None:
        nx = n + 2
        a = np.zeros((nx, nx))
        b = np.zeros((nx, 3))
        c = np.zeros(nx)
        kinf = k0 + ki.sum()
        c[:n] = -ki
        c[n] = -kinf
        dx, df = kinf, -1.0
        for i in range(n):
            a[i, i] = -1 / ti[i]
            a[i, n] = -1 / ti[i]
            b[i, 0] = 1 / ti[i]
    else:
        # active strip (arms scaled by 1/share) in series with a passive strip that has its own arms
        ra = 1.0 / strip["share"]
        ka, kai = k0 * ra, ki * ra
        kp, kpj, tp = strip["k0"], np.asarray(strip["ki"]), np.asarray(strip["ti"])
        m = len(kpj)
        nx = n + m + 2
        a = np.zeros((nx, nx))
        b = np.zeros((nx, 3))
        c = np.zeros(nx)
        ia, ip, ix = np.arange(n), n + np.arange(m), n + m
        kai_inf, kp_inf = ka + kai.sum(), kp + kpj.sum()
        s = kai_inf + kp_inf
        ea = np.zeros(nx)
        ea[ia] = kai / s
        ea[ip] = -kpj / s
        ea[ix] = -kp_inf / s
        eax, eaf = kp_inf / s, 1.0 / s
        ep = -ea.copy()
        ep[ix] -= 1.0
        epx, epf = 1.0 - eax, -eaf
        for i in range(n):
            a[i] = ea / ti[i]
            a[i, i] -= 1 / ti[i]
            b[i, 0], b[i, 1] = eax / ti[i], eaf / ti[i]
        for j in range(m):
            a[n + j] = ep / tp[j]
            a[n + j, n + j] -= 1 / tp[j]
            b[n + j, 0], b[n + j, 1] = epx / tp[j], epf / tp[j]
        c = kai_inf * ea
        c[ia] -= kai
        dx, df = kai_inf * eax, kai_inf * eaf - 1.0
        n = n + m
    a[n, n + 1] = 1.0
    a[n + 1] = c / mass
    a[n + 1, n] -= kl / mass
    a[n + 1, n + 1] -= cl / mass
    b[n + 1] = np.array([dx, df, 1.0]) / mass
    return a, b, c, dx, df


def discretise(a: np.ndarray, b: np.ndarray, h: float):
    """Exact step for inputs quadratic in the step: blocks for value, slope and second difference."""
    nx, nu = b.shape
    z = np.zeros((nx + 3 * nu, nx + 3 * nu))
    z[:nx, :nx] = a * h
    z[:nx, nx : nx + nu] = b * h
    z[nx : nx + nu, nx + nu : nx + 2 * nu] = np.eye(nu)
    z[nx + nu : nx + 2 * nu, nx + 2 * nu :] = np.eye(nu)
    e = expm(z)[:nx]
    return tuple(np.ascontiguousarray(q) for q in (e[:, :nx], *np.split(e[:, nx:], 3, axis=1)))


@nb.njit(cache=True)
def lut(table, u, lo, hi):
    """Linear interpolation in a table given on lo…hi, held outside."""
    s = (u - lo) / (hi - lo) * (len(table) - 1)
    if s <= 0:
        return table[0]
    if s >= len(table) - 1:
        return table[-1]
    i = int(s)
    return table[i] + (s - i) * (table[i + 1] - table[i])


@nb.njit(cache=True)
def film_force(fcode, fp, ft, st, e, fm, fa, g, t0, h, commit):
    """Film tension (deviation from the pre-load) from the linear elastic force fm and the states of the effect."""
    t = g * fm - fa
    if fcode == 1:  # amplitude softening: table of the running amplitude (or strain) in units of the largest
        if fp[3] == 1.0:
            amp = abs(e)
        else:
            hi, lo = st[0], st[1]
            r = h / fp[2]
            hi = e if e > hi else hi + (e - hi) * r
            lo = e if e < lo else lo + (e - lo) * r
            amp = 0.5 * (hi - lo)
            if fp[3] == 2.0:  # first-order structure, faster with larger amplitude
                x = st[2]
                x += (amp - x) * min(1.0, h / fp[4] * (1 + 4 * amp / fp[1]))
                if commit:
                    st[2] = x
                amp = x
            if commit:
                st[0], st[1] = hi, lo
        t = fm * (1 - fp[0] * lut(ft, amp / fp[1], 0.0, 1.5)) - fa
    elif fcode == 2:  # cyclic softening: damage that carries over
        hi, lo = max(st[3], e), min(st[4], e)
        amax = 0.5 * (hi - lo)
        deq = fp[0] * lut(ft, amax / fp[1], 0.0, 1.5)
        de = abs(e - st[5])
        if fp[3] == 0.0:
            dn = de / (4 * max(amax, 1e-9))
        elif fp[3] == 1.0:
            dn = de * abs(e) / (2 * fp[1] * fp[1])
        else:
            dn = h * abs(e) / fp[1] * fp[4]
        d1, d2 = st[6], st[7]
        d1 += max(deq * (1 - fp[5]) - d1, 0.0) * (1 - np.exp(-dn / fp[2]))
        d2 += max(deq * fp[5] - d2, 0.0) * (1 - np.exp(-dn / (12 * fp[2])))
        if commit:
            st[3], st[4], st[5], st[6], st[7] = hi, lo, e, d1, d2
        t = fm * (1 - d1 - d2) - fa
    elif fcode == 3:  # elastic extra force, table over -1.3…1.3 of the largest strain
        t = fm - fa + fp[0] * lut(ft, e / fp[1], -1.3, 1.3)
        if fp[2] > 0:  # part of it relaxes (first-order, faster when driven fast)
            x = st[8]
            q = lut(ft, e / fp[1], -1.3, 1.3)
            x += (q - x) * min(1.0, h / fp[3])
            t += fp[0] * fp[2] * (q - x)
            if commit:
                st[8] = x
    elif fcode == 4:  # slack below threshold
        tt = t0 + t
        th = fp[0]
        if fp[1] == 0.0:
            if tt < th:
                tt = th + fp[2] * (tt - th)
        elif fp[1] == 1.0:
            w = fp[3]
            z = (tt - th) / w
            soft = w * np.log1p(np.exp(-abs(z))) + (w * z if z > 0 else 0.0)
            tt = th + fp[2] * (tt - th) + (1 - fp[2]) * soft
        elif fp[1] == 2.0:  # fibres go slack one after the other (table of remaining share of the slope, integrated)
            if tt < th:
                tt = th - fp[3] * lut(ft, (th - tt) / fp[3], 0.0, 3.0)
        else:  # the bulge comes at once and goes with a time constant
            b = st[9]
            want = max(th - tt, 0.0)
            b = want if want > b else b + (want - b) * min(1.0, h / fp[3])
            if commit:
                st[9] = b
            tt = tt + b * (1 - fp[2])
        t = tt - t0
    elif fcode == 5:  # unlisted: friction of a guide, parallel stop elements
        x = st[10] + fp[1] * (e - st[11])
        x = min(max(x, -fp[0]), fp[0])
        y = st[12] + fp[3] * (e - st[11])
        y = min(max(y, -fp[2]), fp[2])
        if commit:
            st[10], st[11], st[12] = x, e, y
        t = fm - fa + x + y
    elif fcode == 6:  # unlisted: transverse mode of the film, a resonator that takes part in the tension
        w = fp[1]
        p, v = st[13], st[14]
        v += h * (-2 * fp[2] * w * v - w * w * (p - e))
        p += h * v
        if commit:
            st[13], st[14] = p, v
        t = fm - fa + fp[0] * (p - e)
    return t


@nb.njit(cache=True)
def run(em, bp, bq, br, c, dx, df, kl, x0h, fah, gt, h, fcode, fp, ft, ak, at, amode, ccode, cp, rcode, rp, rt, t0, st):
    """Integrate one recording; returns the force of the load cell (deviation from the pre-load)."""
    nx = em.shape[0]
    n = (len(x0h) - 1) // 2
    y = np.zeros(nx)
    yp = np.zeros(nx)
    out = np.zeros(n + 1)
    ix = nx - 2
    na = len(ak)
    af = np.zeros(na)
    afn = np.zeros(na)
    ea = np.exp(-h / at)
    ga = ak * at * (1 - ea) / h
    nonlin = fcode > 0 or na > 0 or ccode > 0 or rcode > 0 or np.any(gt != 1.0)
    n0 = 0.0
    nm = 0.0
    eold = 0.0
    slip = 0.0
    s2 = 0.0
    told = 0.0
    for k in range(n):
        xa, xm, xb = x0h[2 * k] - slip, x0h[2 * k + 1] - slip, x0h[2 * k + 2] - slip
        fa, fm_, fb = fah[2 * k], fah[2 * k + 1], fah[2 * k + 2]
        qx, rx = -3 * xa + 4 * xm - xb, 4 * xa - 8 * xm + 4 * xb
        qf, rf = -3 * fa + 4 * fm_ - fb, 4 * fa - 8 * fm_ + 4 * fb
        dn = n0 - nm
        for i in range(nx):
            s = bp[i, 0] * xa + bq[i, 0] * qx + br[i, 0] * rx + bp[i, 1] * fa + bq[i, 1] * qf + br[i, 1] * rf
            if nonlin:
                s += bp[i, 2] * n0 + bq[i, 2] * dn
            for j in range(nx):
                s += em[i, j] * y[j]
            yp[i] = s
        if nonlin:
            n1 = n0 + dn
            for it in range(2):
                e = xb - yp[ix]
                tl = dx * xb + df * fb
                for j in range(nx):
                    tl += c[j] * yp[j]
                t = film_force(fcode, fp, ft, st, e, tl + fb, fb, gt[k + 1], t0, h, it == 1)
                for j in range(na):
                    if amode == 0:
                        afn[j] = ea[j] * af[j] + ga[j] * (e - eold)
                    else:  # rate-dependent constant: faster under load
                        r = 1 + (abs(af[j]) / rp[7]) ** 1.5
                        ex = np.exp(-h * r / at[j])
                        afn[j] = ex * af[j] + ak[j] * at[j] / (h * r) * (1 - ex) * (e - eold)
                    t += afn[j]
                nn = t - tl
                xc, vc = yp[ix], yp[ix + 1]
                if rcode == 1:  # quadratic drag
                    nn -= rp[0] * abs(vc) * vc
                elif rcode == 2:  # dry friction, smoothed
                    nn -= rp[0] * np.tanh(vc / rp[1])
                elif rcode == 3:  # load cell stiffness depends on load
                    nn -= rp[0] * xc * lut(rt, xc / rp[1], -1.3, 1.3)
                elif rcode == 4:  # sprung mass on the clamp with damper (second resonance)
                    p, v = st[15], st[16]
                    acc = rp[1] * rp[1] * (xc - p) + 2 * rp[2] * rp[1] * (vc - v)
                    nn -= rp[0] * acc
                    if it == 1:
                        st[16] = v + h * acc
                        st[15] = p + h * st[16]
                elif rcode == 6:  # relaxing arm at the load cell
                    z = (st[17] + rp[0] * (xc - st[18])) * np.exp(-h / rp[1])
                    nn -= z
                    if it == 1:
                        st[17], st[18] = z, xc
                elif rcode == 5:  # hysteretic (play) damping: table of the amplitude
                    z = st[17] + (xc - st[18]) * rp[0]
                    z = min(max(z, -rp[1]), rp[1])
                    nn -= z
                    if it == 1:
                        st[17], st[18] = z, xc
                if it == 0 or it == 1:
                    corr = nn - n1
                    for i in range(nx):
                        yp[i] += bq[i, 2] * corr
                    n1 = nn
            for j in range(na):
                af[j] = afn[j]
            eold = xb - yp[ix]
            nm, n0 = n0, n1
            if ccode > 0:
                fs, kh, kinf = cp[0], cp[1], cp[2]
                phi = t - kh * slip
                if ccode == 1:
                    if abs(phi) > fs:
                        slip += np.sign(phi) * (abs(phi) - fs) / (kinf + kh)
                elif ccode == 2:  # smooth, Bouc-Wen
                    dt = t - told
                    if phi * dt > 0:
                        slip += dt / (kinf + kh) * min(1.0, (abs(phi) / fs) ** cp[3])
                elif ccode == 3:  # creep, rate depends on load
                    z = min(abs(phi) / fs, 6.0)
                    slip += np.sign(phi) * h * cp[3] * (np.sinh(z) - z)
                elif ccode == 4:  # static above kinetic threshold
                    lim = fs * (cp[3] if st[19] > 0 else 1.0)
                    if abs(phi) > lim:
                        slip += np.sign(phi) * (abs(phi) - lim) / (kinf + kh) * 0.5
                        st[19] = 1.0
                    elif phi * (t - told) < 0:
                        st[19] = 0.0
                else:  # two patches in series with different thresholds
                    p1, p2 = t - kh * (slip - s2), t - 1.7 * kh * s2
                    d1 = np.sign(p1) * max(abs(p1) - fs, 0.0) / (kinf + kh)
                    d2 = np.sign(p2) * max(abs(p2) - 1.5 * fs, 0.0) / (kinf + 1.7 * kh)
                    slip += 0.5 * (d1 + d2)
                    s2 += 0.5 * d2
                told = t
        for i in range(nx):
            y[i] = yp[i]
        out[k + 1] = kl * y[ix]
        if rcode == 3:
            out[k + 1] += rp[0] * y[ix] * lut(rt, y[ix] / rp[1], -1.3, 1.3)
    return out


@nb.njit(cache=True)
def lag(u, dt, up, down, slew, mode):
    """First-order state, exact for straight lines; mode 0 constants rising and falling, 1 constant grows with the level."""
    y = np.empty_like(u)
    y[0] = u[0]
    scale = np.max(np.abs(u)) + 1e-12
    for k in range(1, len(u)):
        tau = up if 0.5 * (u[k] + u[k - 1]) > y[k - 1] else down
        if mode == 1:
            tau *= 0.3 + 1.4 * abs(y[k - 1]) / scale
        m = (u[k] - u[k - 1]) / dt
        d = u[k] - m * tau + (y[k - 1] - u[k - 1] + m * tau) * np.exp(-dt / tau) - y[k - 1]
        if slew > 0:
            d = min(max(d, -slew * dt), slew * dt)
        y[k] = y[k - 1] + d
    return y


@nb.njit(cache=True)
def lag_from(u, dt, up, down, y0):
    """First-order state with a start value that is carried over."""
    y = np.empty_like(u)
    s = y0
    for k in range(len(u)):
        s += (u[k] - s) * (1 - np.exp(-dt / (up if u[k] > s else down)))
        y[k] = s
    return y
