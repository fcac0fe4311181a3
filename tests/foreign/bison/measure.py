"""Distances of the forms from the textbook form (writes distances.py); run once, about five minutes."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from . import effects as fx
from .plan import draw_world
from .rig import CAPS, draw_noise, search, shapes
from .simulate import Detector, simulate


def main() -> None:
    """For each form: rms of what two textbook traces (the best of 5 shapes and sizes, scaled) leave, explains, over the rms of the effect."""
    k = 0
    while True:
        r = np.random.default_rng([int(sys.argv[1]), k])
        w = draw_world(r)
        k += 1
        if w.label == "compact" and any(x.protocol == "cyclic" for x in w.recs) and len(w.recs) <= 9:
            break
    plain = simulate(w, [], coarse=True)
    draw_noise(r, "clean", w, plain)
    w.noise["command"] = False
    det = Detector(w, plain)
    out: dict[str, float] = {}
    for mech in fx.SPEC:
        lo, hi = fx.SPEC[mech][2:4]
        cap = CAPS.get(mech, 2 * hi)

        def traces(form: str, q: dict, s: float) -> tuple[np.ndarray, np.ndarray]:
            ys = det.difference(plain, simulate(w, [fx.build(mech, form, s, q, w)], coarse=True))  # noqa: B023
            both = []
            for zs in (ys, det.project(ys)):
                both.append(np.concatenate([y * np.sqrt(x) for y, x in zip(zs, det.q, strict=True)]))
            return both[0], both[1]

        def fitted(form: str, q: dict) -> tuple[float, float]:
            return search(lambda x: fx.build(mech, form, x, q, w), lo * 0.05, cap, 150.0, w, det, plain)  # noqa: B023

        def own(j: int, k: int, u0: float) -> dict:
            q = shapes(np.random.default_rng([j, k]))
            q["u0"] = u0
            if mech == "mains_hum":  # noqa: B023
                q["u2"] = 0.31
            return q

        base = fx.FORMS[mech][0]
        s0, _ = fitted(base, own(0, 1, 0.2))
        book = [traces(base, own(j, 1, 0.2), s0) for j in range(3)]
        book += [traces(base, own(0, 1, 0.2), f * s0) for f in (0.5, 2.0)]
        for form in fx.FORMS[mech][1:]:
            q = own(0, 2, 0.2)
            s, d = fitted(form, q)
            if d < 8:
                continue
            got = []
            for n, y in enumerate(traces(form, q, s)):
                yy = float(y @ y)
                cols = [x[n] for x in book]
                left = [yy - float(y @ c) ** 2 / max(float(c @ c), 1e-30) for c in cols]
                a = np.stack([cols[i] for i in np.argsort(left)[:2]], 1)
                x = np.linalg.lstsq(a, y, rcond=None)[0]
                got.append(float(np.sqrt(max(float(np.sum((y - a @ x) ** 2)), 0) / yy)))
            out[f"{mech}/{form}"] = round(min(got), 3)
            print(mech, form, "raw, projected", np.round(got, 3), "d", round(d), flush=True)
    lines = ['"""Form distances, measured by measure.py."""', "", "DISTANCE: dict[str, float] = {"]
    lines += [f'    "{a}": {b},' for a, b in out.items()] + ["}", ""]
    Path(__file__).with_name(f"distances_{sys.argv[1]}.py").write_text("\n".join(lines))


if __name__ == "__main__":
    main()
