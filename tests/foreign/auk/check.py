"""Checks of the rig itself: clean sessions against physics.md, every form's size and sign."""

import sys
import time

import numpy as np

from .core import Hooks, simulate
from .forms import MECHANISMS, UNLISTED
from .lab import draw_session
from .rig import Judge, linear, response, tune


def clean(seeds: int) -> None:
    """Time integration at the recording's rate against the transfer functions, in units of the noise."""
    worst: dict[str, float] = {}
    for s in range(seeds):
        ses = draw_session(np.random.default_rng(s))
        carry = np.zeros(4)
        for r in ses.recs:
            if r.loading == "calibration":
                continue
            fine = r.rate * np.ceil(4000 / r.rate)
            a = simulate(ses.film, r, Hooks(), fine, carry, 0.0)
            y = linear(ses.film, a["x"], a["voltage"] ** 2, fine)
            st = int(fine // r.rate)
            d = (a["force"] - y)[::st]
            key = r.protocol + "/" + r.loading
            e = float(np.sqrt(np.mean(d**2)) / ses.sd["force"])
            worst[key] = max(worst.get(key, 0), e)
            # complex response by projection on the excitation's band
            if r.protocol in ("chirp", "sphs"):
                u = a["x"] if r.protocol == "chirp" else a["voltage"] ** 2
                f = np.fft.rfftfreq(u.size, 1 / fine)
                fu, fy = np.fft.rfft(u - u[0] * 0), np.fft.rfft(a["force"])
                g, h = response(ses.film, 2 * np.pi * f)
                want = g if r.protocol == "chirp" else ses.film.gain * h
                if r.protocol == "chirp":
                    ok = (np.abs(fu) > 0.1 * np.abs(fu).max()) & (f > 2)
                    rel = np.abs(fy[ok] / fu[ok] / want[ok] - 1)
                    worst["G median rel"] = max(worst.get("G median rel", 0), float(np.median(rel)))
    for k, v in worst.items():
        print(f"{k:28s} {v:.5f}")


def forms(which: str = "") -> None:
    """Each form once: severity for d = 300, reach, sign hints."""
    table = {**MECHANISMS, **UNLISTED}
    for mid, mech in table.items():
        if which and which not in mid:
            continue
        t0 = time.time()
        rng = np.random.default_rng(abs(hash(mid)) % 1000 if False else len(mid) * 7)
        for _ in range(30):
            ses = draw_session(rng, mech.need if mech.need in "we" else "")
            if ses.style != "full" or sum(r.duration for r in ses.recs) < 240:
                break
        judge = Judge(ses)
        for name, form in mech.forms.items():
            try:
                s, d, h, _ = tune(judge, mech, form, rng.random(6), 300.0, False)
            except FloatingPointError as err:
                print(f"{mid:34s} {name:24s} FAILED {err}")
                continue
            b = judge.run(h)
            note = []
            for pro in ("chirp", "cyclic", "sphs"):
                i = [j for j, r in enumerate(ses.recs) if r.protocol == pro]
                if i:
                    j = i[-1] if pro == "sphs" else i[min(1, len(i) - 1)]
                    x, y = judge.plain[j], b[j]
                    sx, sy = x["force"].std(), y["force"].std()
                    note.append(f"{pro} {sy / sx - 1:+.3f}")
            print(f"{mid:34s} {name:24s} s={s:.4g} d={d:.0f} {' '.join(note)}")
        print(f"   {time.time() - t0:.1f} s", flush=True)


if __name__ == "__main__":
    clean(int(sys.argv[2])) if sys.argv[1] == "clean" else forms(sys.argv[2] if len(sys.argv) > 2 else "")
