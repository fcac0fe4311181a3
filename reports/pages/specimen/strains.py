"""The part of a specimen's page about its strain: stiffness and phase at each amplitude, and the models of each."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from reports.blocks import Figure, Head, Pair, Row, Section, Table, bold, flow, sub
from reports.evidence import drawable, together
from reports.evidence import measured as measured_responses
from reports.figures.curves import arms, stiffness
from reports.figures.responses import Lines
from reports.figures.strains import Swing, by_amplitude
from reports.names import short
from reports.pages.draft import Draft
from reports.results import Query
from reports.results import Row as Record
from schemas.numbers import ABSENT, NBSP, compact, percent, significant

_SQL = """SELECT *
FROM amplitude_fits
WHERE specimen_id = $specimen AND selected
ORDER BY amplitude"""
_AVERAGE_SQL = """SELECT *
FROM model_fits
WHERE specimen_id = $specimen AND loading = 'mechanical' AND method = 'corrected' AND weighting = 'noise' AND selected
  AND coalesce(extension, '') = ''"""
_SAME = 0.05
"""Amplitudes within this share of each other are one, as in averages."""


def section(draft: Draft) -> Section | None:
    """Stiffness and phase by strain and frequency with the model of each strain; None where one amplitude is all there is."""
    query = Query(_SQL, {"specimen": draft.item})
    fits = [f for f in draft.results.rows(query) if drawable(f)]
    if len(fits) < 2:
        return None
    average = next(iter(draft.results.rows(Query(_AVERAGE_SQL, {"specimen": draft.item}))), None)
    lines = [_lines(draft, f["amplitude"]) for f in fits]
    span = np.concatenate([one.frequency for one in lines])
    grid = np.geomspace(span.min(), span.max(), 120)
    swings = [Swing(_strain(f["amplitude"]), one, stiffness(f, grid)) for f, one in zip(fits, lines, strict=True)]
    mean = stiffness(average, grid) if average is not None else None
    top, ends = float(span.max()), [_at_top(one, float(span.max())) for one in lines]
    fall = f"{significant(abs(ends[0]), 2)} to {significant(abs(ends[-1]), 2)}{NBSP}N/mm"
    turn = float(np.ptp([np.degrees(np.angle(v)) for v in ends]))
    where = f"at {compact(top, 2)}{NBSP}Hz, from {swings[0].name} to {swings[-1].name} strain"
    href = draft.data("strains", _data(fits, lines))
    who = short(draft.item, 40)
    pair = Pair(
        (
            Figure(
                by_amplitude(swings, grid, mean, phase=False, alt=f"Stiffness of {who} {where}: {fall}."),
                flow(bold("Magnitude"), f" {where}: {fall}. Strain is peak to peak; lines: the model of each; dashed: of their average."),
                href,
            ),
            Figure(
                by_amplitude(swings, grid, mean, phase=True, alt=f"Phase of {who} {where} changes by {significant(turn, 2)}°."),
                flow(bold("Phase"), f" {where}: it changes by {significant(turn, 2)}°."),
                href,
            ),
        )
    )  # fmt: skip
    table = _table(query, fits, average)
    return Section("strains", f"Stiffness over strain: {fall} {where}", "Strain", (pair, table))


def _strain(amplitude: float) -> str:
    return percent(2 * amplitude)


def _lines(draft: Draft, amplitude: float) -> Lines:
    """The corrected lines of all recordings of that amplitude."""
    found = measured_responses(draft.results, draft.item, "mechanical")
    stage = found.stage("corrected")
    return together([one for name, one in stage.items() if abs(found.amplitude[name] - amplitude) <= _SAME * amplitude])


def _at_top(lines: Lines, frequency: float) -> complex:
    """The usable value nearest to a frequency."""
    good = np.flatnonzero(lines.usable)
    return complex(lines.value[good[np.argmin(np.abs(lines.frequency[good] - frequency))]])


def _data(fits: Sequence[Record], lines: Sequence[Lines]) -> dict[str, np.ndarray]:
    value = np.concatenate([one.value for one in lines])
    return {
        "strain_pp": np.concatenate([np.full(o.size, 2 * f["amplitude"]) for f, o in zip(fits, lines, strict=True)]),
        "frequency_hz": np.concatenate([one.frequency for one in lines]),
        "magnitude_n_per_mm": np.abs(value),
        "phase_deg": np.degrees(np.angle(value)),
        "standard_error_n_per_mm": np.concatenate([one.error for one in lines]),
        "usable": np.concatenate([one.usable for one in lines]),
    }


def _table(query: Query, fits: Sequence[Record], average: Record | None) -> Table:
    """The models of each strain, and that of their average below."""
    shown = [*fits, *([average] if average is not None else [])]
    most = max(len(arms(f)) for f in shown)
    columns = [
        ("k", 0, "k0_n_per_mm"),
        *(("k", i, f"k{i}_n_per_mm") for i in range(1, most + 1)),
        *(("c", i, f"c{i}_n_s_per_mm") for i in range(1, most + 1)),
    ]
    rows = tuple(
        Row(
            (
                "average" if f is average else _strain(f["amplitude"]),
                str(f["model_order"]),
                *(ABSENT if f[c] is None else significant(f[c], 3) for _, _, c in columns),
                significant(f["magnitude_error_n_per_mm"], 2),
                significant(f["phase_error_deg"], 2),
            ),
            "sel" if f is average else "",
        )
        for f in shown
    )
    heads = (
        Head("Strain, peak to peak"), Head("Order", "n"), *(Head(sub(letter, i), "n") for letter, i, _ in columns),
        Head("Magnitude error, N/mm", "n"), Head("Phase error, °", "n"),
    )  # fmt: skip
    below = (
        "k in N/mm, c in N s/mm; –: a pure dashpot; their standard deviations are in the database. Fitted to the corrected responses of each strain alone,"
        " weighted by their noise. The average is of complex values over the strains, each strain's deviation from it counted."
    )
    return Table("Models of each strain, and of their average", heads, rows, query.shown(), below=below, kind="wide")
