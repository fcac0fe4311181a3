"""Check of the written files: keys, rates, values, determinism, and the recorded transfer function of a clean session."""

import hashlib
import json
import sys
import tempfile
from pathlib import Path

import numpy as np
from mcap.reader import make_reader

sys.path.insert(0, "tests/foreign")
from crane import rig
from crane.record import BLOCK


def read(path: Path) -> tuple[dict, dict]:
    """Metadata and channels of one file."""
    ch: dict = {}
    with path.open("rb") as fh:
        r = make_reader(fh)
        meta = {m.name: m.metadata for m in r.iter_metadata()}
        for _, c, m in r.iter_messages():
            b = BLOCK()
            b.ParseFromString(m.data)
            assert m.log_time == b.start_time_ns
            ch.setdefault(c.topic, [b.start_time_ns, b.sample_interval_s, [], c.metadata])[2].extend(b.values)
    return meta, ch


for kind in rig.KINDS:
    seed = int(sys.argv[1])
    with tempfile.TemporaryDirectory(dir=Path(__file__).parent) as tmp:
        h = []
        for k in range(2):
            t = rig.write_session(seed, kind, Path(tmp) / str(k))
            h.append([hashlib.sha256(p.read_bytes()).hexdigest() for p in sorted((Path(tmp) / str(k)).glob("*"))])
            h[-1].append(json.dumps(t))
        same = h[0] == h[1]
        print(kind, seed, "files", len(h[0]) - 1, "identical twice:", same, list(t))
        for p in sorted((Path(tmp) / "0").glob("*.mcap"))[:: 3 if kind == "clean" else 100]:
            meta, ch = read(p)
            print(" ", p.name, p.stat().st_size, meta["recording"], meta["rig"])
            print(
                "   ",
                {
                    q: (len(v[2]), v[1], v[3], round(float(np.mean(v[2])), 4), round(float(np.std(v[2])), 4))
                    for q, v in ch.items()
                },
            )
