"""Every fault once: runs, and prints its truth."""

import sys
import tempfile
from pathlib import Path

sys.path.insert(0, "tests/foreign")
from crane import faults, rig

names = [*faults.SIMPLE, *faults.FAULTS]
for i, name in enumerate(names):
    rig.choose_fault = lambda sess, rng, name=name: name
    for seed in range(500 + i, 540):
        s = rig.draw_session(seed, 4)
        if any(r.protocol == "cyclic" for r in s.recs) and any(r.loading == "electrical" for r in s.recs):
            break
    with tempfile.TemporaryDirectory(dir=Path(__file__).parent) as tmp:
        t = rig.write_session(seed, "fault", Path(tmp) / "a")
    print(name, str(t["fault"])[:230])
