"""Checks of the rig: time domain against the formulas, files read back (`python -m bison.check FIRST LAST`)."""

from __future__ import annotations

import struct
import sys
import tempfile
from pathlib import Path

import numpy as np
from mcap.reader import make_reader

from .plan import draw_world
from .rig import draw_noise, write_session
from .simulate import Detector, respond, simulate


def read(path: Path) -> tuple[dict, dict, dict]:
    """Metadata, rig and channels of a recording."""
    meta: dict = {}
    data: dict = {}
    with path.open("rb") as f:
        rd = make_reader(f)
        for m in rd.iter_metadata():
            meta[m.name] = dict(m.metadata)
        for _, ch, msg in rd.iter_messages():
            b = msg.data
            n, shift, i = 0, 0, 19
            while True:
                n |= (b[i] & 127) << shift
                shift += 7
                i += 1
                if b[i - 1] < 128:
                    break
            start, dt = struct.unpack("<q", b[1:9])[0], struct.unpack("<d", b[10:18])[0]
            d = data.setdefault(ch.topic, {"unit": ch.metadata["unit"], "v": [], "t": [], "dt": dt})
            v = np.frombuffer(b[i : i + n], "<f8")
            d["v"].append(v)
            d["t"].append(start * 1e-9 + np.arange(v.size) * dt)
    for d in data.values():
        d["v"], d["t"] = np.concatenate(d["v"]), np.concatenate(d["t"])
    return meta["recording"], meta.get("rig", {}), data


def formulas(first: int, last: int) -> None:
    """Clean sessions against the transfer functions of physics.md sections 2 and 3, in units of the noise."""
    worst = []
    for seed in range(first, last):
        r = np.random.default_rng([seed, 77])
        w = draw_world(r)
        coarse = simulate(w, [], coarse=True)
        draw_noise(r, "clean", w, coarse)
        plain = simulate(w, [])
        det = Detector(w, plain)
        low = min(float(c["force"].min()) for x, c in zip(w.recs, plain, strict=True) if x.loading != "calibration")
        rows = []
        for rec, c in zip(w.recs, plain, strict=True):
            if rec.protocol not in ("chirp", "sphs", "cyclic"):
                continue
            u = c["voltage"] ** 2 if rec.loading == "electrical" else c["displacement"]
            e = c["force"] - w.preload - respond(w, u, rec.rate, rec.loading, det.base)
            e = e[int(0.2 * e.size) :] if rec.protocol == "sphs" else e
            y = c["force"] - w.preload
            rows.append(
                (rec.protocol, e.std() / w.noise["sd"], np.abs(e).max() / w.noise["sd"], y.std() / w.noise["sd"])
            )
        top = max(rows, key=lambda x: x[1])
        worst.append(top[1])
        lead = [f"{a} {max((x[1] for x in rows if x[0] == a), default=0):.3f}" for a in ("chirp", "sphs", "cyclic")]
        print(seed, w.label, "rms error / noise:", *lead, f"signal/noise {max(x[3] for x in rows):.0f}",
              f"lowest tension {low:.2f} N of preload {w.preload:.2f}", f"d {det.d(plain, plain):.1f}")  # fmt: skip
    print("largest rms error / noise", max(worst))


def files(seed: int) -> None:
    """Write and read back; deterministic."""
    with tempfile.TemporaryDirectory(dir=Path(__file__).parent / "_dev") as tmp:
        for kind in ("clean", "fault"):
            write_session(seed, kind, Path(tmp) / "a")
            write_session(seed, kind, Path(tmp) / "b")
        a, b = sorted(Path(tmp, "a").iterdir()), sorted(Path(tmp, "b").iterdir())
        print("same bytes twice:", all(x.read_bytes() == y.read_bytes() for x, y in zip(a, b, strict=True)))
        for p in a[:12]:
            m, g, d = read(p)
            print(
                p.name, m, {k: (v["unit"], v["v"].size, float(v["v"].min()), float(v["v"].max())) for k, v in d.items()}
            )
        print(g)


if __name__ == "__main__":
    formulas(int(sys.argv[1]), int(sys.argv[2]))
    files(int(sys.argv[1]))
