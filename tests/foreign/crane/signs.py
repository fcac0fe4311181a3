"""Signs, size and convergence of every form: gain change per protocol, and difference between internal rates."""

import sys

import numpy as np

sys.path.insert(0, "tests/foreign")
from crane import effects as fx
from crane import rig
from crane.session import draw_session


def find(pred, start=0):
    for s in range(start, 400):
        q = draw_session(s, 1)
        if pred(q):
            return q
    return None


sess = find(
    lambda q: (
        "mech" not in q.label
        and "quasi" not in q.label
        and q.film["partial"]
        and len(q.film["ki"]) >= 2
        and q.label == "full"
        and any(r.protocol == "step" and r.loading == "electrical" for r in q.recs)
        and any(r.protocol == "weight" for r in q.recs)
    ),
    int(sys.argv[2]) if len(sys.argv) > 2 else 0,
)
ref, t0, _ = rig.prepare(sess, np.random.default_rng(0))
det = rig.Detector(sess, t0)
print(sess.label, len(sess.recs), "sd", sess.noise["force"], "T0", t0, {k: round(float(v), 4) for k, v in ref.items()})
names = sys.argv[1].split(",") if len(sys.argv) > 1 and sys.argv[1] != "all" else list(fx.FORMS) + list(fx.UNLISTED)
for name in names:
    for form in fx.FORMS.get(name, [name]):
        r = np.random.default_rng(3)
        e = fx.listed(name, form, sess, r, ref) if name in fx.FORMS else fx.unlisted(name, sess, r, ref)
        s, d = rig.find_severity(det, e, 300.0)
        o = {}
        for rate in (3000, 8000, 16000):
            c = rig.plain_cfg(sess)
            e.apply(c, s)
            o[rate] = rig.simulate(sess, c, t0, rate)
            if rate == 3000:
                t00 = c.t0
        g = {}
        conv = 0
        conv3 = 0
        for rec, a, b, cc, d0 in zip(sess.recs, o[8000], o[16000], o[3000], det.base, strict=False):
            f0 = d0["force"] - d0["force"].mean()
            dl = a["force"] - d0["force"]
            dl = dl - dl.mean()
            if rec.loading != "calibration":
                g.setdefault(rec.protocol[:4] + rec.loading[0], []).append(float(f0 @ dl / (f0 @ f0)))
            k = np.ptp(f0) + 1e-12
            conv = max(conv, np.sqrt(np.mean((a["force"] - b["force"]) ** 2)) / sess.noise["force"])
            conv3 = max(conv3, np.sqrt(np.mean((cc["force"] - b["force"]) ** 2)) / sess.noise["force"])
        print(
            f"{name:30s} {form:22s} d={d:7.1f} s={s:.4g} conv8k={conv:.3f} conv3k={conv3:.3f}",
            {k: [round(q * 100, 2) for q in v] for k, v in g.items()},
            flush=True,
        )
