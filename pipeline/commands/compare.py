"""`dealab compare`: several specimens or batches in one figure, with their differences, intervals and tests."""

from __future__ import annotations

import math
from argparse import Namespace
from typing import TYPE_CHECKING, Any, NamedTuple

from pipeline.commands.command import DONE, LAB, Command, argument, parse_path
from pipeline.lab.lab import Lab
from schemas.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from pipeline.fit.comparing import Difference
    from reports.overlay import Item, Quantity


class Numbers(NamedTuple):
    """A table: its caption, heads and rows of text."""

    caption: str
    heads: list[str]
    rows: list[list[str]]


_PAGE = (".html", ".htm")
_ALPHA, _NAMED = 0.05, 3


def run(arguments: Namespace) -> int:
    from ingest.atomic import written_whole
    from reports.figures.paper import ENDINGS, write_figure
    from reports.overlay import describe_survival, draw_items, list_quantities, make_page, read_items
    from reports.render import html
    from reports.results import Results
    from reports.site import Site
    from schemas.visible import make_safe

    out = arguments.out
    if out is not None and out.suffix.lower() not in (*_PAGE, *ENDINGS):
        raise UsageError(
            f"{out}: a comparison has no such format", expected=f"a file that ends in .html, {', '.join(ENDINGS)}"
        )
    lab = Lab(arguments.lab)
    lab.require_database()
    with Results(lab.folder) as results:
        site = Site(results)
        items = read_items(site, arguments.names)
        quantities = list_quantities(items)
        lives = describe_survival(results, items)
        if not quantities and not lives:
            raise UsageError(
                "these have nothing in common that could be compared",
                expected="fitted models, self-sensing or lives of at least two of them",
            )
        tables, differing = compare_items(items, quantities)
        heading = describe_finding(items, differing, len(quantities))
        notes = [*note_intervals(items), *test_whole_films(items), *describe_lives(lives)]
        if out is not None:
            with written_whole(out) as file:
                if out.suffix.lower() in _PAGE:
                    file.write_text(html(make_page(site, items, heading, tables, notes)), encoding="utf-8")
                else:
                    form = ENDINGS[out.suffix.lower()]
                    write_figure(
                        draw_items(site, items, heading).draw(), file, form, title="Comparison", finding=heading
                    )
    print(make_safe(heading))
    for table in tables:
        if table.rows:
            print(make_safe("\n".join(("", table.caption, *lay_out(table.heads, table.rows)))))
    print(make_safe("\n".join(("", *notes))))
    if out is not None:
        print(f"Written: {out}")
    return DONE


def compare_items(items: Sequence[Item], quantities: Sequence[Quantity]) -> tuple[list[Numbers], list[str]]:
    """The tables of numbers, and which quantities differ from the first at 5 % after Holm's correction.

    Two items stand in one table; of more the differences have a table of their own, a row for each item.
    """
    from pipeline.fit.comparing import Sample, compare_samples
    from pipeline.fit.survival.tests import holm

    sizes = [max((q.values[i][0].size for q in quantities), default=0) for i in range(len(items))]
    names = [i.name + (f" (n = {n})" if i.is_batch else "") for i, n in zip(items, sizes, strict=True)]
    found: list[list[Difference | None]] = []
    for q in quantities:
        samples = [Sample(*values) if values[0].size else None for values in q.values]
        first = samples[0]
        found.append([compare_samples(first, s) if first is not None and s is not None else None for s in samples[1:]])
    p_values = holm([math.nan if d is None else d.p_value for row in found for d in row])
    corrected = p_values.reshape(len(found), len(items) - 1).tolist()
    values, differences, differing = [], [], []
    for q, own, p_own in zip(quantities, found, corrected, strict=True):
        words = f"{q.words}, {q.unit}" if q.unit else q.words
        values.append([words, *(_value(*v) for v in q.values)])
        for item, difference, p in zip(items[1:], own, p_own, strict=True):
            differences.append([words, item.name, *_difference(difference, q.values[0][0], p)])
        if any(p < _ALPHA for p in p_own):
            differing.append(q.words)
    heads = ["Difference (95 %)", "in %", "p (Holm)"]
    if len(items) == 2:
        rows = [[*v, *d[2:]] for v, d in zip(values, differences, strict=True)]
        return [Numbers("Parameters and their difference", ["Quantity", *names, *heads], rows)], differing
    return [
        Numbers("Parameters", ["Quantity", *names], values),
        Numbers(f"Differences from {items[0].name}", ["Quantity", "Of", *heads], differences),
    ], differing


def _value(values: object, sds: object) -> str:
    """A value ± its SD; of a batch the mean ± the SD among its specimens."""
    import numpy as np

    from schemas.numbers import ABSENT, pm, significant

    numbers, spreads = np.asarray(values), np.asarray(sds)
    if not numbers.size:
        return ABSENT
    sd = float(np.std(numbers, ddof=1)) if numbers.size > 1 else float(spreads[0])
    return pm(float(numbers.mean()), sd) if sd > 0 else significant(float(numbers.mean()))


def _difference(found: Difference | None, first: object, p: float) -> list[str]:
    import numpy as np

    from schemas.numbers import ABSENT, bounds, p_value, span

    if found is None:
        return [ABSENT, ABSENT, ABSENT]
    base = abs(float(np.mean(np.asarray(first))))
    share = span(100 * found.lower / base, 100 * found.upper / base) if base > 0 else ABSENT
    return [bounds(found.value, found.lower, found.upper), share, p_value(p)]


def describe_finding(items: Sequence[Item], differing: Sequence[str], tested: int) -> str:
    """What the comparison shows, in a sentence; the first few quantities that differ are named."""
    from schemas.numbers import digits, joined

    names = joined([item.name for item in items])
    if not tested:
        return f"{names}: only their lives can be compared"
    if not differing:
        return f"{names}: no difference is shown in {digits(tested, 'quantity', 'quantities')}"
    shown = [*differing[:_NAMED], *([f"{len(differing) - _NAMED} more"] if len(differing) > _NAMED else [])]
    return f"{names} differ in {len(differing)} of {digits(tested, 'quantity', 'quantities')}: {joined(shown)}"


def note_intervals(items: Sequence[Item]) -> list[str]:
    """What the intervals of the table hold, so that none is taken for more."""
    from schemas.numbers import joined

    notes = []
    if sum(not item.is_batch for item in items) > 1:
        notes.append(
            "Specimen against specimen: the interval holds the errors of both measurements, not how far two films of "
            "one batch are apart, so that nearly all films differ."
        )
    if sum(item.is_batch for item in items) > 1:
        notes.append("Batch against batch: Welch's t interval of the means.")
    if any(i.is_batch for i in items) and not all(i.is_batch for i in items):
        notes.append("Specimen against batch: whether it may be one of the batch (t, prediction interval).")
    left_out = [item.name for item in items if item.overlaid is None]
    if left_out and len(left_out) < len(items):
        notes.append(f"Without a mechanical response over frequency, and so not in the figure: {joined(left_out)}.")
    notes.append("p-values are corrected for all tests of the table by Holm's method. In %: of the first.")
    return notes


def test_whole_films(items: Sequence[Item]) -> list[str]:
    """Wald's test of all springs and times of a specimen against the first, where both models have one order."""
    from pipeline.fit.comparing import compare_parameters
    from reports.overlay import read_parameters
    from schemas.numbers import p_equals, significant

    lines = []
    for item in items[1:]:
        both = read_parameters(items[0], item)
        if both is not None:
            whole = compare_parameters(*both)
            lines.append(
                f"All parameters of {item.name} against {items[0].name} at once (Wald): "
                f"χ² {significant(whole.chi2)} for {whole.freedom}, {p_equals(whole.p_value)}."
            )
    return lines


def describe_lives(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """A line for each test of survival between two of the items."""
    from schemas.numbers import NBSP, compact, p_equals

    lines = []
    for r in rows:
        volts = "" if r["voltage_kv"] is None else f" at {compact(r['voltage_kv'])}{NBSP}kV"
        lines.append(
            f"Lives of {r['configuration_a']} and {r['configuration_b']}{volts}, {r['test']}: {p_equals(r['p_value'])}."
        )
    return lines


def lay_out(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """A table for a terminal: the first column to the left, the others to the right."""
    table = [list(heads), *(list(r) for r in rows)]
    wide = [max(len(row[i]) for row in table) for i in range(len(heads))]
    lines = [
        "  ".join(c.ljust(w) if i == 0 else c.rjust(w) for i, (c, w) in enumerate(zip(row, wide, strict=True))).rstrip()
        for row in table
    ]
    return [lines[0], "  ".join("─" * w for w in wide), *lines[1:]]


COMMAND = Command(
    ("PA-1 PA-2 --out pa.html", "polyacrylate silicone --out films.pdf"),
    (
        argument(
            "names",
            nargs="+",
            metavar="NAME",
            help="a specimen, or a batch: a material, a configuration, or `material, configuration`",
        ),
        argument("--out", type=parse_path, metavar="FILE", help="a page (.html), or the figure (.pdf, .svg, .png)"),
        LAB,
    ),
    run,
)
