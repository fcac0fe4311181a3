"""Electrodes: do those that are laid over the thickness map live longer than the thesis' own at the same force?

    python -m tests.studies.study_electrodes [--campaigns N] [--seed N]

The film over three rods is computed by finite elements. Lives of the thesis' single and divided electrodes are drawn cell by
cell by a simulator of its own (`tests.helpers.rod_film_lives`), the law of the film's life is fitted to them, and from it
the electrodes are designed. Then new films, whose thickness scatters from cell to cell and from film to film as it did not
before, are tested with the new and with the thesis' divided electrodes at the same force: the mean ratio of their lives,
film by film. The study fails where that of shaped electrodes, over the campaigns, is not above 1 with 95 %.
"""

from __future__ import annotations

import argparse
import math
import sys

import numpy as np
from scipy import stats

from pipeline.fit.survival.electrode_design import RECTANGLES, SHAPED, design_electrodes
from pipeline.fit.survival.film_life import PLAUSIBLE_EXPONENT, FilmLives, fit_film_life, lay_film
from pipeline.fit.survival.lifetime_distributions import Lives
from pipeline.physics.thickness.continuous import continuous_thickness
from pipeline.physics.thickness.film import RodFilm
from pipeline.physics.thickness.layout import covered_share, separate_regions, single_region
from tests.helpers.rod_film_lives import draw_paired_lives

TESTED, NEW = 20, 1000
LOCAL_SCATTER, WHOLE_SCATTER = 0.03, 0.04
ELEMENTS = 3000


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--campaigns", type=int, default=20)
    parser.add_argument("--seed", type=int, default=3)
    arguments = parser.parse_args()
    film = RodFilm()
    film_map = continuous_thickness(film, elements=ELEMENTS)
    single, divided = single_region(film), separate_regions(film, 1.0)
    covers = [covered_share(film_map, one) for one in (single, divided)]
    found: dict[str, list[tuple[float, bool]]] = {RECTANGLES: [], SHAPED: []}
    for number in range(arguments.campaigns):
        rng = np.random.default_rng((arguments.seed, number))
        # Exponents of the hazard over the field between 8 and 15, as soft films have them.
        hazard, shape = float(rng.uniform(8, 15)), float(rng.uniform(1.2, 2.2))
        truth = {"exponent": hazard / shape, "shape": shape}
        lives = draw_paired_lives(film_map, covers, [1.0, 1.0], specimens=TESTED, rng=rng, local_scatter=0.01, **truth)
        unit = 40.0 / float(np.median(lives[0]))  # a single electrode lives 40 s
        names = ("single", "divided")
        groups = [
            FilmLives(lay_film(name, film_map, one, 1.0), 7.5, Lives.right_censored(unit * own, np.ones(TESTED, bool)))
            for name, one, own in zip(names, (single, divided), lives, strict=True)
        ]
        law = fit_film_life(groups, PLAUSIBLE_EXPONENT)
        for design in design_electrodes(film_map, divided, law):
            if design.design not in found:
                continue
            both = [covered_share(film_map, one) for one in (design.electrodes, divided)]
            tested = draw_paired_lives(
                film_map, both, [design.voltage_ratio, 1.0], specimens=NEW, rng=rng, local_scatter=LOCAL_SCATTER,
                whole_scatter=WHOLE_SCATTER, **truth,
            )  # fmt: skip
            ratio = float(np.mean(np.log(tested[0] / tested[1])))
            low, high = math.log(design.life_ratio.lower), math.log(design.life_ratio.upper)
            found[design.design].append((ratio, low <= ratio <= high))
    return report(found, arguments.campaigns)


def report(found: dict[str, list[tuple[float, bool]]], campaigns: int) -> int:
    print(f"{campaigns} campaigns of {TESTED} films of each layout; {NEW} new films for each design.\n")
    print("| electrodes | life × at equal force (95 %) | promised within 90 % limits |")
    print("|---|---:|---:|")
    wrong = []
    for name, pairs in found.items():
        logs = np.array([one[0] for one in pairs])
        half = float(stats.t.ppf(0.975, logs.size - 1) * logs.std(ddof=1) / math.sqrt(logs.size))
        low, middle, high = (math.exp(logs.mean() + side * half) for side in (-1, 0, 1))
        held = float(np.mean([one[1] for one in pairs]))
        print(f"| {name} | {middle:.3f} ({low:.3f} to {high:.3f}) | {100 * held:.0f} % |")
        if name == SHAPED and low <= 1:
            wrong.append(f"{name} electrodes do not live longer than the thesis' own")
    print("\n" + "\n".join(f"- **missed**: {one}" for one in wrong))
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
