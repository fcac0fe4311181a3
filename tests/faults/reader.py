"""A program that reads a lab's database in a loop until it is told to stop, and says what it met. Started by the harness.

python -m tests.faults.reader LAB
"""

from __future__ import annotations

import json
import sys
import threading
from pathlib import Path

from pipeline import Lab
from pipeline.lab.query import Query

QUERY = """
SELECT (SELECT max(run_id)::INT FROM runs) AS run,
       (SELECT count(*) FROM recordings WHERE protocol = 'lifetime' AND status = 'ok') AS recordings,
       (SELECT count(*) FROM lifetimes) AS lives,
       (SELECT sum(specimens)::INT FROM survival_summaries) AS specimens,
       (SELECT count(*) FROM previews WHERE recording_id NOT IN (SELECT recording_id FROM recordings)) AS strays
"""
"""Numbers of one state of the lab: every life has its recording, its row, and its place in a survival curve."""


def main() -> int:
    lab = Lab(Path(sys.argv[1]))
    stop = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.readline(), stop.set()), daemon=True).start()
    wrong: list[str] = []
    states: set[int] = set()
    queries, last = 0, 0
    while not stop.wait(0.02):  # what it looks for are states, which do not change while it asks again and again
        try:
            with Query(lab) as database:
                (row,) = database.run(QUERY).to_pylist()
        except Exception as error:
            wrong.append(f"a reader met {type(error).__name__}: {error}")
            continue
        queries += 1
        states.add(row["run"])
        if len({row["recordings"], row["lives"], row["specimens"]}) != 1 or row["strays"]:
            wrong.append(f"a reader saw a mixed state: {row}")
        if row["run"] < last:
            wrong.append(f"a reader saw run {row['run']} after run {last}")
        last = row["run"]
    print(json.dumps({"queries": queries, "states": len(states), "wrong": wrong[:20]}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
