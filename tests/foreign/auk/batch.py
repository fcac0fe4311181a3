"""Write many sessions into a scratch folder and read them back: totals, times, structure, leaks."""

import json
import shutil
import sys
import time
from pathlib import Path

import numpy as np
from mcap.reader import make_reader

from .lab import BLOCK
from .rig import KINDS, write_session


def main() -> None:
    """python -m auk.batch FIRST LAST."""
    root = Path(__file__).parent / "out" / "batch"
    for seed in range(int(sys.argv[1]), int(sys.argv[2])):
        for kind in KINDS:
            shutil.rmtree(root, ignore_errors=True)
            t0, c0 = time.time(), time.process_time()
            try:
                tr = write_session(seed, kind, root)
            except Exception as err:
                print(seed, kind, "ERROR", repr(err), flush=True)
                continue
            cpu, wall = time.process_time() - c0, time.time() - t0
            json.dumps(tr)
            bad, n = 0, 0
            for p in sorted(root.glob("*.mcap")):
                with p.open("rb") as fh:
                    rd = make_reader(fh)
                    names = {m.name for m in rd.iter_metadata()}
                    tot = {}
                    for _, ch, m in rd.iter_messages():
                        v = np.array(BLOCK.FromString(m.data).values)
                        tot[ch.topic] = tot.get(ch.topic, 0) + v.size
                        bad += int((~np.isfinite(v)).sum())
                    n += 1
                    if names != {"recording", "rig"} or "/force" not in tot:
                        bad += 1
            what = tr["listed"] or tr["unlisted"] or tr["fault"]["id"]
            print(
                f"{seed} {kind:8s} {tr['session']:10s} n={n} bad={bad} cpu={cpu:.1f} wall={wall:.1f} {what} {tr['form']} "
                f"d={tr['strength']:.0f} fd={tr['form_distance']} {tr['noise']}",
                flush=True,
            )


if __name__ == "__main__":
    main()
