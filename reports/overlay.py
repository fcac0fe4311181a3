"""Several specimens or batches side by side: what the database says of each, and the page that shows them in one figure.

A batch is a material, a configuration, or both. How differences are judged does not belong here: the
caller brings them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from reports.blocks import Figure, Head, Link, Page, Row, Section, Table, Text, bold, flow
from reports.evidence import choice, curve, drawable, measured
from reports.figures.curves import arms, band, covariance, stiffness
from reports.figures.overlay import Overlaid, overlay
from reports.figures.palette import group
from reports.figures.panel import Sheet, on_sheet
from reports.figures.picture import Picture
from reports.figures.survival import GroupCurve, kaplan_meier
from reports.names import short, visible
from reports.pages.campaign import lives
from reports.pages.draft import Draft
from reports.results import Query, Results
from reports.results import Row as Record
from reports.site import Site
from schemas.arrays import Float
from schemas.errors import UsageError
from schemas.numbers import compact, joined, with_unit

_AT_HZ = (1.0, 10.0, 50.0)
"""Frequencies at which stiffness and loss angle are set side by side, whatever the order of the models."""
_WIDTH_PX = 980
_WORDS = ("Quantity", "Of")
"""Heads of columns with words."""


@dataclass(frozen=True)
class Quantity:
    """What is compared: its words, its unit, and values (n,) with standard deviations (n,) of each item's specimens."""

    words: str
    unit: str
    values: tuple[tuple[Float, Float], ...]


@dataclass(frozen=True)
class Member:
    """A specimen: its fit to use, and what its force under voltage and its self-sensing came to."""

    specimen_id: str
    fit: Record | None
    force: Record | None
    sensing: Record | None


@dataclass(frozen=True)
class Item:
    """What was asked for by that name: a specimen, or a batch of several."""

    name: str
    members: tuple[Member, ...]
    overlaid: Overlaid | None

    @property
    def is_batch(self) -> bool:
        return len(self.members) > 1


def read_items(site: Site, names: Sequence[str]) -> list[Item]:
    """Specimens and batches of these names; `UsageError` where one is unknown or none of them can be set beside another."""
    if len(set(names)) < 2:
        raise UsageError("there is nothing to compare with", expected="two or more different specimens or batches")
    return [_read_item(site, name) for name in dict.fromkeys(names)]


def _read_item(site: Site, name: str) -> Item:
    members = [name] if site.has_specimen(name) else _find_batch(site.results, name)
    if not members:
        raise UsageError(
            f'neither a specimen nor a batch is called "{short(name, 80)}"',
            expected="a specimen_id, a material, a configuration, or the last two joined by a comma",
        )
    found = tuple(_read_member(site.results, member) for member in members)
    drawn = []
    for member in found:
        if member.fit is None or not drawable(member.fit):
            continue
        response = measured(site.results, member.specimen_id, member.fit["loading"])
        if response.film is not None and response.film.size > 1 and member.fit["loading"] == "mechanical":
            drawn.append((response.film, curve(member.fit, response, response.film, {})))
    return Item(name, found, Overlaid(short(name, 20), tuple(drawn)) if drawn else None)


def _find_batch(results: Results, name: str) -> list[str]:
    rows = results.rows(
        Query(
            "SELECT DISTINCT specimen_id FROM recordings WHERE specimen_id <> '' AND status IN ('ok', 'damaged')"
            " AND $name IN (material, configuration, concat_ws(', ', material, configuration)) ORDER BY specimen_id",
            {"name": name},
        )
    )
    return [r["specimen_id"] for r in rows]


def _read_member(results: Results, specimen: str) -> Member:
    def rows(table: str, where: str = "true") -> list[Record]:
        return results.rows(
            Query(f"SELECT * FROM {table} WHERE specimen_id = $specimen AND {where}", {"specimen": specimen})
        )

    fits = rows("model_fits")
    forces = [f for f in fits if f["force_per_voltage_squared_n_per_kv2"] is not None and f["selected"]]
    force = min(forces, key=lambda f: (f["extension"] or "", f["loading"], f["method"]), default=None)
    return Member(specimen, choice(fits), force, next(iter(rows("sensing_fits")), None))


def list_quantities(items: Sequence[Item]) -> list[Quantity]:
    """What at least two items have, in the order of the table.

    Springs and times are set side by side only where all models have one order; stiffness and phase at given frequencies do
    not depend on it.
    """
    fits = [[m.fit for m in item.members if m.fit is not None] for item in items]
    found = []
    low, high = _shared_reach(items)
    for f in (f for f in _AT_HZ if low <= f <= high):
        found.append(Quantity(f"|k| at {compact(f)} Hz", "N/mm", tuple(_at(own, f, phase=False) for own in fits)))
        found.append(Quantity(f"phase at {compact(f)} Hz", "°", tuple(_at(own, f, phase=True) for own in fits)))
    found.append(Quantity("modulus", "MPa", tuple(_moduli(own) for own in fits)))
    orders = {(f["model_order"], f["loading"]) for own in fits for f in own}
    columns = [("main spring k₀", "N/mm", "k0_n_per_mm")] if len({loading for _, loading in orders}) == 1 else []
    if len(orders) == 1:
        for i in range(1, next(iter(orders))[0] + 1):
            digit = str(i).translate(str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉"))
            columns += [
                (f"spring k{digit}", "N/mm", f"k{i}_n_per_mm"),
                (f"damper c{digit}", "N s/mm", f"c{i}_n_s_per_mm"),
            ]
    found += [Quantity(words, unit, tuple(_column(own, column) for own in fits)) for words, unit, column in columns]
    force = tuple(_column([m.force for m in item.members if m.force], "force_per_voltage_squared_n_per_kv2", 1e3) for item in items)  # fmt: skip
    found.append(Quantity("force over V²", "mN/kV²", force))
    for words, unit, column in (
        ("force over capacitive strain", "N", "force_per_capacitive_strain_n"),
        ("sensitivity", "", "sensitivity"),
    ):
        values = tuple(_column([m.sensing for m in item.members if m.sensing], column) for item in items)
        found.append(Quantity(words, unit, values))
    return [q for q in found if sum(v.size > 0 for v, _ in q.values) > 1]


def _shared_reach(items: Sequence[Item]) -> tuple[float, float]:
    reaches = [item.overlaid.reach for item in items if item.overlaid is not None]
    return (max(r[0] for r in reaches), min(r[1] for r in reaches)) if reaches else (np.inf, 0.0)


def _at(fits: Sequence[Record], frequency: float, *, phase: bool) -> tuple[Float, Float]:
    f = np.array([frequency])
    values, sds = [], []
    for fit in fits:
        k, sd = stiffness(fit, f), band(fit, f)
        values.append(float(np.degrees(np.angle(k[0])) if phase else np.abs(k[0])))
        sds.append(np.nan if sd is None else float(np.degrees(sd[1, 0]) if phase else sd[0, 0]))
    return np.array(values), np.array(sds)


def _column(rows: Sequence[Record], column: str, factor: float = 1.0) -> tuple[Float, Float]:
    kept = [r for r in rows if r[column] is not None]
    sds = [np.nan if r[f"{column}_sd"] is None else factor * r[f"{column}_sd"] for r in kept]
    return np.array([factor * r[column] for r in kept], dtype=float), np.array(sds, dtype=float)


def _moduli(fits: Sequence[Record]) -> tuple[Float, Float]:
    """Moduli; each is proportional to the main spring, whose relative error it has (the geometry is taken as exact)."""
    kept = [f for f in fits if f["modulus_mpa"] and f["k0_n_per_mm"]]
    sds = [np.nan if f["k0_n_per_mm_sd"] is None else f["modulus_mpa"] * f["k0_n_per_mm_sd"] / f["k0_n_per_mm"] for f in kept]  # fmt: skip
    return np.array([f["modulus_mpa"] for f in kept], dtype=float), np.array(sds, dtype=float)


def read_parameters(first: Item, second: Item) -> tuple[Float, Float, Float] | None:
    """Logarithms (p,) of all parameters of two specimens' films and the covariance (p, p) of their difference.

    None where one is a batch, the orders differ, or no covariance is stored.
    """
    if first.is_batch or second.is_batch:
        return None
    both = []
    for fit in (first.members[0].fit, second.members[0].fit):
        found = covariance(fit) if fit is not None and fit["loading"] == "mechanical" else None
        if fit is None or found is None:
            return None
        logs = {"k0": fit["k0_n_per_mm"]}
        for i, arm in enumerate(arms(fit), 1):
            logs |= {f"c{i}": arm.c} if arm.k is None else {f"k{i}": arm.k, f"tau{i}": arm.tau}
        names = [n for n in found.names if n in logs]
        if len(names) != len(logs) or any(not logs[n] or logs[n] <= 0 for n in names):
            return None
        at = [found.names.index(n) for n in names]
        both.append((names, np.log([logs[n] for n in names]), found.matrix[np.ix_(at, at)]))
    if both[0][0] != both[1][0]:
        return None
    return both[0][1], both[1][1], both[0][2] + both[1][2]


def make_page(
    site: Site,
    items: Sequence[Item],
    heading: str,
    tables: Sequence[tuple[str, Sequence[str], Sequence[Sequence[str]]]],
    notes: Sequence[str],
) -> Page:
    """One page with the overlay, tables (caption, heads, rows) of what is compared, and what its intervals hold; it stands alone."""
    overlaid = [item.overlaid for item in items if item.overlaid is not None]
    sections = []
    if len(overlaid) > 1:
        image = draw_items(site, items, heading)
        caption = flow(
            bold("Stiffness and phase."),
            " Points: measured; lines: the model; of a batch the mean, its specimens thin. Below: how far each is off the first,"
            " with the 95 % band of the models, or of the mean where a batch is drawn.",
        )
        sections.append(Section("figure", "Stiffness over frequency", "Figure", (Figure(image, caption),)))
    curves, time_title = read_curves(site, items)
    if curves:
        told = _tell_lives(curves)
        caption = flow(bold("Survival."), " Kaplan–Meier with 95 % bands; open marks: alive when the test ended.")
        figure = Figure(draw_lives(curves, time_title, told), caption)
        sections.append(Section("lives", "Survival under voltage", "Survival", (figure,)))
    shown = [
        Table(
            visible(caption),
            tuple(Head(visible(head), "" if head in _WORDS else "n") for head in heads),
            tuple(Row(tuple(visible(cell) for cell in row)) for row in rows),
        )
        for caption, heads, rows in tables
        if rows
    ]
    sections.append(Section("numbers", "In numbers", "Numbers", (*shown, *(Text(visible(n), "sub") for n in notes))))
    members = [
        Row((visible(item.name), "batch" if item.is_batch else "specimen", joined([visible(m.specimen_id) for m in item.members])))
        for item in items
    ]  # fmt: skip
    who = Table("What was compared", (Head("Name"), Head("Kind"), Head("Specimens", "text")), tuple(members))
    sections.append(Section("items", "What was compared", "Items", (who,)))
    return Page(
        title=f"{joined([short(i.name, 30) for i in items])} compared", heading=heading, bar=(Link("Comparison"),),
        when=site.when(None), sections=tuple(sections), provenance=site.provenance(None),
    )  # fmt: skip


def draw_items(site: Site, items: Sequence[Item], finding: str) -> Picture:
    """The overlay by itself: of models, else of lives; `UsageError` where fewer than two of the items have either."""
    overlaid = [item.overlaid for item in items if item.overlaid is not None]
    if len(overlaid) < 2:
        return draw_lives(*read_curves(site, items), finding)
    with on_sheet(Sheet(width=_WIDTH_PX)):
        return overlay(overlaid, alt=finding)


def read_curves(site: Site, items: Sequence[Item]) -> tuple[list[GroupCurve], str]:
    """Survival curves of the items that are configurations with lives, in one unit, and the title of their time axis."""
    names = [item.name for item in items]
    found: list[tuple[GroupCurve, str, float, str]] = []
    volts: set[float] = set()
    for campaign in site.campaigns:
        lived = lives.load(Draft(site, "campaign", campaign))
        own = lives.list_curves(lived, names)
        found += [(g, campaign, *lived.unit) for g in own]
        volts |= {v for c, v in lived.groups if c in names and v is not None}
    if len(found) < 2:
        return [], ""
    factor, unit = min((f, u) for _, _, f, u in found)
    several = len({campaign for _, campaign, *_ in found}) > 1
    curves = [
        replace(
            g, name=f"{g.name}, {short(campaign, 20)}" if several else g.name, drawn=group(i),
            time=g.time * factor / own, laws={},
        )
        for i, (g, campaign, own, _) in enumerate(found)
    ]  # fmt: skip
    at = f"at {with_unit(compact(volts.pop()), 'kV')}" if len(volts) == 1 else "under voltage"
    return curves, f"Time {at}, {unit}"


def _tell_lives(curves: Sequence[GroupCurve]) -> str:
    return "Survival: " + "; ".join(f"{g.name}: {g.failed} of {g.total} failed" for g in curves)


def draw_lives(curves: Sequence[GroupCurve], time_title: str, finding: str) -> Picture:
    """Survival curves over each other, with numbers at risk; `UsageError` where there are fewer than two."""
    if len(curves) < 2:
        raise UsageError(
            "there is no figure of this", expected="mechanical models, or lives under voltage, of at least two of them"
        )
    return kaplan_meier(curves, time_title, alt=finding)


def describe_survival(results: Results, items: Sequence[Item]) -> list[Record]:
    """Tests of survival between configurations among the items, as the database has them."""
    names = [item.name for item in items]
    rows = results.rows("SELECT * FROM survival_comparisons ORDER BY configuration_a, configuration_b, test")
    return [r for r in rows if r["configuration_a"] in names and r["configuration_b"] in names]
