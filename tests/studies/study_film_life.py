"""Life from the film: fitted on two layouts, does it predict a third one that was never tested within its 90 % interval?

    python -m tests.studies.study_film_life [--campaigns N] [--seed N]

Lives are drawn flaw by flaw by a simulator of its own (`tests.helpers.weak_films`), with thin lines, another size and thickness
for each layout, and thickness scatter. Counted are campaigns whose interval holds the true median of the third layout, and
those whose interval of a sample's median holds the median of ten new specimens.
"""

from __future__ import annotations

import argparse
import sys

import numpy as np

from pipeline.fit.survival.film_life import FilmLayout, FilmLives, fit_film_life, predict_film_life
from pipeline.fit.survival.lifetime_distributions import Lives
from schemas.errors import DealabError
from tests.helpers.weak_films import SHEETS, Film, Sheet, draw_lives, true_median_s

VOLTAGES_KV, ASKED_KV = (7.0, 9.0), 7.5
EACH, ASKED, END_S = 8, 10, 2e4
PIECES = 60


def describe_layout(sheet: Sheet) -> FilmLayout:
    """The layout as the fit sees it: its thickness in strips across the lines."""
    y = (np.arange(PIECES) + 0.5) / PIECES * sheet.width_mm - sheet.width_mm / 2
    area = np.full(PIECES, sheet.length_mm * sheet.width_mm / PIECES)
    return FilmLayout(sheet.name, sheet.thickness_at(y), area, sheet.scatter)


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--campaigns", type=int, default=200)
    parser.add_argument("--seed", type=int, default=9)
    arguments = parser.parse_args()
    good = True
    print("| predicted | campaigns | holds the true median | holds the median of ten | width × | not fitted |")
    print("|---|---:|---:|---:|---:|---:|")
    for number, third in enumerate(SHEETS):
        rng = np.random.default_rng((arguments.seed, number))
        others = [sheet for sheet in SHEETS if sheet is not third]
        # The last one is what is asked for; the others, predicted in a quarter as many, show that it is no lucky choice.
        campaigns = arguments.campaigns if number == len(SHEETS) - 1 else arguments.campaigns // 4
        film = Film()
        truth = true_median_s(film, third, ASKED_KV, rng)
        held, sampled, widths, refused = 0, 0, [], 0
        for _ in range(campaigns):
            groups = []
            for sheet in others:
                for voltage in VOLTAGES_KV:
                    time, failed = draw_lives(film, sheet, voltage, EACH, END_S, rng)
                    groups.append(FilmLives(describe_layout(sheet), voltage, Lives.right_censored(time, failed)))
            observed = float(np.median(draw_lives(film, third, ASKED_KV, ASKED, np.inf, rng)[0]))
            try:
                found = predict_film_life(fit_film_life(groups), describe_layout(third), ASKED_KV, ASKED)
            except DealabError:
                refused += 1
                continue
            held += found.median_s.lower <= truth <= found.median_s.upper
            sampled += found.sample_median_s.lower <= observed <= found.sample_median_s.upper
            widths.append(found.median_s.upper / found.median_s.lower)
        counted = campaigns - refused
        print(
            f"| {third.name}, from {' and '.join(sheet.name for sheet in others)} | {campaigns} | {100 * held / counted:.1f} % |"
            f" {100 * sampled / counted:.1f} % | {np.median(widths):.2f} | {refused} |",
            flush=True,
        )
        if number == len(SHEETS) - 1:
            good = 0.85 <= held / counted <= 0.95 and 0.85 <= sampled / counted <= 0.95
    if not good:
        print("\n- **missed**: 85 to 95 % of the campaigns")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
