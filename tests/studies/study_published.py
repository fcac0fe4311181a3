"""Does the pipeline find the numbers that published analyses of lifetimes print, to their last digit?

    python -m tests.studies.study_published

Datasets, sources and numbers are those of `tests.helpers.published_analyses`.
"""

from __future__ import annotations

import argparse
import sys

from tests.helpers.published_analyses import ANALYSES


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--seed", type=int, help="nothing is drawn here")
    parser.parse_args()
    print("| dataset | source | statistic | published | ours |\n|---|---|---|---:|---:|")
    for one in ANALYSES:
        print(f"| {one.dataset} | {one.source} | {one.statistic} | {one.printed} | {one.ours} |")
    apart = [one for one in ANALYSES if one.ours != one.printed]
    print(f"\n{len(ANALYSES)} numbers of {len({one.dataset for one in ANALYSES})} analyses; {len(apart)} differ.")
    return 1 if apart else 0


if __name__ == "__main__":
    sys.exit(main())
