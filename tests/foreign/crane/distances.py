"""Table of forms with rough form distances, for the README (one full session with a partial electrode)."""

import sys

import numpy as np

sys.path.insert(0, "tests/foreign")
from crane import effects as fx
from crane import rig
from crane.session import draw_session

for seed in range(400):
    sess = draw_session(seed, 1)
    pr = {(r.protocol, r.loading) for r in sess.recs}
    if (
        sess.label == "full"
        and sess.film["partial"]
        and ("weight", "calibration") in pr
        and ("step", "electrical") in pr
    ):
        break
ref, t0, _ = rig.prepare(sess, np.random.default_rng(0))
det = rig.Detector(sess, t0)
skip = int(sys.argv[1]) if len(sys.argv) > 1 else 0
for name, forms in list(fx.FORMS.items())[skip:]:
    row = []
    for form in forms:
        e = fx.listed(name, form, sess, np.random.default_rng(3), ref)
        s, _d = rig.find_severity(det, e, 300.0)

        def make(k: int, name: str = name) -> fx.Effect:
            return fx.listed(name, fx.FORMS[name][0], sess, np.random.default_rng(3 + k), ref)

        row.append(f"{form} {rig.form_distance(det, e, s, make):.2f}")
    print(f"- `{name}`: " + ", ".join(row), flush=True)
