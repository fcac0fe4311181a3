"""Checks: clean transfer functions against physics.md, and the noise-free trace of every form."""

import sys

import numpy as np

sys.path.insert(0, "tests/foreign")
from crane import rig
from crane.session import draw_session, inputs


def tf(seed):
    s = draw_session(seed, 0)
    r = np.random.default_rng(0)
    _, t0, _ = rig.prepare(s, r)
    out = rig.simulate(s, rig.plain_cfg(s), t0, 8000)
    f, g = s.film, s.rig
    res = []
    for rec, o in zip(s.recs, out, strict=False):
        if rec.protocol not in ("chirp", "sphs", "cyclic"):
            continue
        # exact answer in the frequency domain, zero padded long enough for all transients
        ov = int(np.ceil((16000 if rec.protocol != "sphs" else 8000) / rec.fs))
        t, x, _, v = inputs(rec, s, ov)
        u = x if rec.loading == "mechanical" else v * v
        n = len(u)
        tail = int(12 * max(f["ti"].max(), 0.2) / t[1])
        m = 1 << int(np.ceil(np.log2(n + tail)))
        U = np.fft.rfft(u, m)
        w = 2 * np.pi * np.fft.rfftfreq(m, t[1])
        k = f["k0"] + sum(ki * 1j * w * ti / (1 + 1j * w * ti) for ki, ti in zip(f["ki"], f["ti"], strict=False))
        den = k + g["kl"] - g["mass"] * w**2 + 1j * w * g["cl"]
        H = k * g["kl"] / den if rec.loading == "mechanical" else -f["ka"] * g["kl"] / den
        y = np.fft.irfft(U * H, m)[:n][:: 2 * ov]
        e = o["force"] - t0 - y[: len(o["force"])]
        res.append((rec.protocol, np.sqrt(np.mean(e**2)) / s.noise["force"], np.max(abs(e)) / s.noise["force"]))
        if rec.protocol == "sphs":
            # what a reader sees: last period of the sampled force against the sampled voltage squared
            m = round(rec.p["period"] * rec.fs)
            i0 = round(rec.p["rest"] * rec.fs) + (rec.p["nper"] - 1) * m
            if abs(rec.p["period"] * rec.fs - m) < 1e-6:
                Fs, Vs = np.fft.rfft(o["force"][i0 : i0 + m]), np.fft.rfft(o["v"][i0 : i0 + m] ** 2)
                ks = rec.p["ks"]
                wk = 2 * np.pi * ks / rec.p["period"]
                kk = f["k0"] + sum(
                    ki * 1j * wk * ti / (1 + 1j * wk * ti) for ki, ti in zip(f["ki"], f["ti"], strict=False)
                )
                Hk = f["ka"] * g["kl"] / (kk + g["kl"] - g["mass"] * wk**2 + 1j * wk * g["cl"])
                err = -Fs[ks] - Hk * Vs[ks]
                sn = s.noise["force"] * np.sqrt(m / rec.p["nper"])
                res.append(("sphs_lines", np.sqrt(np.mean(abs(err) ** 2)) / sn, np.max(abs(err)) / sn))
        rec.cache.clear()
    return s, res


if __name__ == "__main__":
    worst = {}
    for seed in range(int(sys.argv[1])):
        s, res = tf(seed)
        for p, a, b in res:
            w = worst.get(p, (0, 0))
            worst[p] = (max(w[0], a), max(w[1], b))
        print(seed, s.label, {p: (round(a, 3), round(b, 3)) for p, a, b in res}, flush=True)
    print("worst (rms, max) in noise sd", worst)
