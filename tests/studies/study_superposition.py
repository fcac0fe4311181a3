"""Do the 95 % limits of shifts and of the constants of Williams, Landel and Ferry hold their level, and how often does a sound superposition raise an alarm?

    python -m tests.studies.study_superposition [--draws N] [--seed N]

Films with a continuous spectrum (`tests.helpers.viscoelastic_truth`) at several temperatures, with noise of several kinds; the
shares of draws whose limits contain the truth are to be 93 to 97 %.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from pipeline.transform.shift_laws import WLF, fit_shift_laws
from pipeline.transform.superposition import superpose
from pipeline.transform.superposition_fit import Isotherm
from tests.helpers.viscoelastic_truth import C1, C2, REFERENCE, frequency_isotherms, log_shift, relaxation_isotherms

WANTED = (0.93, 0.97)
DESIGNS: Mapping[str, tuple[Callable[..., list[Isotherm]], Mapping[str, Any]]] = {
    "5 temperatures, 19 frequencies, 1 % and 0.17°": (frequency_isotherms, {}),
    "the same with 1 % of storage and of loss": (
        frequency_isotherms,
        {"magnitude_noise": 0.0, "phase_noise": 0.0, "parts_noise": 0.01},
    ),
    "8 temperatures, 10 frequencies, 3 % and 1°": (
        frequency_isotherms,
        {
            "temperatures": (-5.0, 5.0, 15.0, 25.0, 35.0, 45.0, 55.0, 65.0),
            "frequency_hz": np.geomspace(0.1, 100.0, 10),
            "magnitude_noise": 0.03,
            "phase_noise": np.radians(1.0),
        },
    ),
    "5 relaxations of 19 times, 0.3 %": (relaxation_isotherms, {}),
}


def judge(draw: Callable[..., list[Isotherm]], options: Mapping[str, Any], draws: int, seed: int) -> dict[str, float]:
    """Share of draws in which the limits contain the truth, by constant, and shares of alarms."""
    rng = np.random.default_rng(seed)
    held: dict[str, list[bool]] = {
        "shifts": [],
        "C1": [],
        "C2": [],
        "alarm": [],
        "p below 5 %": [],
        "vertical below 5 %": [],
    }
    for _ in range(draws):
        master = superpose(draw(rng, **options), reference_c=REFERENCE)
        held["shifts"] += [
            s.log_a_lower <= log_shift(s.temperature_c) <= s.log_a_upper for s in master.shifts if not s.fixed
        ]
        law = next(law for law in fit_shift_laws(master) if law.law == WLF)
        for name, value, truth in (("C1", law.c1, C1), ("C2", law.c2_k, C2)):
            held[name].append(value is not None and not value.lower > truth and not value.upper < truth)
        held["alarm"].append(bool(master.warnings))
        held["p below 5 %"].append(master.p_value < 0.05)
        held["vertical below 5 %"].append(master.vertical_p < 0.05)
    return {name: float(np.mean(found)) for name, found in held.items()}


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--draws", type=int, default=500, help="draws per design")
    parser.add_argument("--seed", type=int, default=35)
    arguments = parser.parse_args()
    print(f"{arguments.draws} draws of each, seed {arguments.seed}.\n")
    missed = []
    for name, (draw, options) in DESIGNS.items():
        shares = judge(draw, options, arguments.draws, arguments.seed)
        print(f"- {name}: " + ", ".join(f"{what} {100 * share:.1f} %" for what, share in shares.items()), flush=True)
        low, high = WANTED
        missed += [
            f"{name}: {what} {100 * shares[what]:.1f} %"
            for what in ("shifts", "C1", "C2")
            if not low <= shares[what] <= high
        ]
    for text in missed:
        print(f"- **missed**: {text}")
    return int(bool(missed))


if __name__ == "__main__":
    sys.exit(main())
