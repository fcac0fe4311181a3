"""The part of a campaign's page that says where the film fails: sites, regions, and what its thickness lets expect."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from reports.blocks import Block, Figure, Fold, Head, Pair, Row, Section, Table, bold, flow
from reports.figures import film, palette
from reports.figures import survival as figures
from reports.figures.survival import Share
from reports.names import short, visible
from reports.pages.campaign import causes, film_lives
from reports.pages.campaign.lives import Lives
from reports.pages.draft import Draft
from reports.results import Query
from reports.results import Row as Record
from schemas.lifetimes import OUTSIDE_THE_FILM
from schemas.numbers import ABSENT, among, bounds, capital, percent, significant

_REGIONS_SQL = """SELECT configuration, region, predicted_share, predicted_share_lower, predicted_share_upper, observed_share,
       observed_share_lower, observed_share_upper, failures, unknown_site, other_failures
FROM weak_regions
WHERE campaign = $campaign
ORDER BY configuration, region"""


def failures(draft: Draft, found: Lives) -> Section | None:
    """Where the film fails: sites and regions found, and the regions that the thickness of the film lets expect."""
    failed = [r for r in found.lifetimes if r["failed"]]
    known = [r for r in failed if r["failure_site"] or r["failure_region"]]
    query = Query(_REGIONS_SQL, {"campaign": draft.item})
    expected = draft.results.rows(query)
    if not known and not expected:
        return None
    blocks: list[Block | Fold] = []
    in_film = [r for r in failed if r["failure_site"] not in OUTSIDE_THE_FILM]
    plan = _maps(draft, in_film)
    if plan is not None:
        blocks.append(plan)
    shares = _shares(found, in_film, expected)
    if shares:
        texts = "; ".join(f"{s.label}: {s.count} of {s.total}" for s in shares)
        blocks.append(
            Figure(
                figures.regions(shares, alt=f"Failures by region. {texts}."),
                flow(bold("Regions."), " Failures in the film, not those at the lead: found, with the exact 95 % interval of the share", "; diamond: expected from the simulated thickness." if expected else "."),
                draft.data(
                    "regions",
                    {
                        "group": [s.label for s in shares], "failures": [s.count for s in shares], "of": [s.total for s in shares],
                        "observed_share": [s.observed for s in shares], "lower_95": [s.low for s in shares], "upper_95": [s.high for s in shares],
                        "predicted_share": [s.predicted for s in shares],
                    },
                ),
            )
        )  # fmt: skip
    blocks.append(_site_table(draft))
    competing = causes.at_end(draft)
    if competing is not None:
        blocks.append(competing)
    if expected:
        blocks.append(_region_table(query, expected))
    layouts = _layouts(draft)
    if layouts is not None:
        blocks.append(layouts)
    blocks += film_lives.blocks(draft)
    return Section("where", _where_heading(known), "Where the film fails", tuple(blocks))


def clopper_pearson(count: int, total: int) -> tuple[float, float]:
    """Exact 95 % limits of a share, `count` of `total`."""
    from scipy.special import betaincinv  # a third of a second, and seldom needed

    low = 0.0 if count == 0 else float(betaincinv(count, total - count + 1, 0.025))
    high = 1.0 if count == total else float(betaincinv(count + 1, total - count, 0.975))
    return low, high


def _shares(found: Lives, failed: Sequence[Record], expected: Sequence[Record]) -> list[Share]:
    shares = []
    configurations = list(dict.fromkeys(c for c, _ in found.groups))
    alone = len({r["configuration"] for r in failed if r["failure_region"]}) < 2
    for i, configuration in enumerate(configurations):
        mine = [r for r in failed if r["configuration"] == configuration and r["failure_region"]]
        if not mine:
            continue
        for region in ("left", "centre", "right"):
            count = sum(r["failure_region"] == region for r in mine)
            low, high = clopper_pearson(count, len(mine))
            predicted = next(
                (
                    e["predicted_share"]
                    for e in expected
                    if (e["configuration"], e["region"]) == (configuration, region)
                ),
                None,
            )
            shares.append(
                Share(
                    region if alone else f"{short(configuration or '', 16)}, {region}",
                    palette.group(i),
                    count,
                    len(mine),
                    count / len(mine),
                    low,
                    high,
                    predicted,
                )
            )
    return shares


def _site_table(draft: Draft) -> Table:
    query = Query(
        "SELECT configuration, coalesce(failure_site, 'unknown') AS site, coalesce(failure_region, 'unknown') AS region, count(*) AS failures\n"
        "FROM lifetimes\nWHERE campaign = $campaign AND failed\nGROUP BY ALL\nORDER BY configuration, failures DESC, site, region",
        {"campaign": draft.item},
    )
    rows = tuple(
        Row((short(r["configuration"] or ABSENT, 60), visible(r["site"]), visible(r["region"]), str(r["failures"])))
        for r in draft.results.rows(query)
    )
    heads = (Head("Configuration"), Head("Site"), Head("Region"), Head("Failures", "n"))
    return Table("Failures by site and region", heads, rows, query.shown(), kind="narrow")


def _region_table(query: Query, expected: Sequence[Record]) -> Table:
    rows = []
    for e in expected:
        total = sum(x["failures"] or 0 for x in expected if x["configuration"] == e["configuration"])
        low, high = e["observed_share_lower"], e["observed_share_upper"]
        agrees = ABSENT
        if None not in (low, high, e["predicted_share"]):
            agrees = "yes" if low <= e["predicted_share"] <= high else "no"
        share = bounds(e["predicted_share"], e["predicted_share_lower"], e["predicted_share_upper"], 100.0)
        found = bounds(e["observed_share"], low, high, 100.0)
        count = f"{e['failures'] or 0} of {total}"
        label = short(e["configuration"] or "", 60)
        rows.append(Row((label, visible(e["region"] or ""), share, count, found, agrees)))
    heads = (
        Head("Configuration"), Head("Region"), Head("Expected, %", "n"), Head("Failures", "n"), Head("Found, %", "n"), Head("Agrees"),
    )  # fmt: skip
    below = (
        "Expected: from the simulated thickness, life falling with a power of the field; in brackets the range over plausible"
        " powers. Found: exact 95 % interval in brackets. Agrees: the expected share lies inside it."
        f" Only failures in the film count. {_others(expected)}"
    )
    return Table("Weak regions: expected against found", heads, tuple(rows), query.shown(), below=below, kind="narrow")


def _others(expected: Sequence[Record]) -> str:
    """How many failures are not in the film, and of how many nobody noted the site."""
    others = {e["configuration"]: e["other_failures"] or 0 for e in expected}
    unknown = sum(e["unknown_site"] or 0 for e in expected)
    apart = sum(others.values())
    text = f"Not in the film, and left aside: {apart or 'none'}"
    if apart:
        text += f" ({', '.join(f'{short(c or ABSENT, 40)} {n}' for c, n in others.items() if n)})"
    return text + (f"; counted although nobody noted the site: {unknown}." if unknown else ".")


_LAYOUT_SQL = """SELECT configuration, scheme, thickness_limit, thin_share, thinnest, predicted_rod_share, observed_rod_share,
       peak_field_mv_per_m
FROM electrode_layouts
WHERE campaign = $campaign
ORDER BY configuration, scheme"""


def _layouts(draft: Draft) -> Table | None:
    """How much of each electrode lies on thin film."""
    query = Query(_LAYOUT_SQL, {"campaign": draft.item})
    found = draft.results.rows(query)
    if not found:
        return None
    rows = tuple(
        Row(
            (
                short(r["configuration"] or ABSENT, 60), visible(r["scheme"] or ""), percent(r["thin_share"]), percent(r["thinnest"]),
                percent(r["predicted_rod_share"]), percent(r["observed_rod_share"]), significant(r["peak_field_mv_per_m"]),
            )
        )
        for r in found
    )  # fmt: skip
    heads = (
        Head("Configuration"), Head("Scheme"), Head("On thin film", "n"), Head("Thinnest", "n"), Head("At rods, expected", "n"),
        Head("At rods, found", "n"), Head("Peak field, MV/m", "n"),
    )  # fmt: skip
    limits = {r["thickness_limit"] for r in found if r["thickness_limit"]}
    limit = f" Thin: below {percent(limits.pop())} of the median thickness." if len(limits) == 1 else ""
    below = f"Share of the active area on thin film; thinnest place over the median.{limit}"
    return Table("Electrodes on the film", heads, rows, query.shown(), below=below)


_FILM_SQL = """SELECT configuration, scheme, x_mm, y_mm, relative_thickness, active
FROM film_maps
WHERE campaign = $campaign
ORDER BY configuration, scheme, y_mm, x_mm"""
_MAPS = 6


def _maps(draft: Draft, failed: Sequence[Record]) -> Block | None:
    """The simulated thickness of each configuration's film, by the better scheme where there are two."""
    data = draft.results.columns(Query(_FILM_SQL, {"campaign": draft.item}))
    if not data["x_mm"].size:
        return None
    schemes = {str(s) for s in data["scheme"]}
    scheme = "continuous" if "continuous" in schemes else sorted(schemes)[0]
    chosen = np.array([str(s) == scheme for s in data["scheme"]])
    names = [n for n in dict.fromkeys(data["configuration"][chosen]) if n is not None][:_MAPS]
    films = {}
    for name in names:
        m = chosen & (data["configuration"] == name)
        real = [data[c][m].astype(float) for c in ("x_mm", "y_mm", "relative_thickness")]
        films[name] = film.grid(real[0], real[1], real[2], np.array([bool(a) for a in data["active"][m]]))
    values = np.concatenate([f.relative[np.isfinite(f.relative)] for f in films.values()])
    span = (float(np.quantile(values, 0.01)), float(np.quantile(values, 0.99)))
    href = draft.data("film", {n: data[n] for n in data})
    drawn = []
    for name, shown in films.items():
        mine = [r["failure_region"] for r in failed if r["configuration"] == name]
        counts = {region: mine.count(region) for region in film.REGIONS}
        total = sum(counts.values())
        words = ", ".join(f"{region} {n}" for region, n in counts.items()) if total else "none with a region noted"
        thinnest = tell_thinnest(shown)
        alt = (
            f"{short(name, 40)}: film {percent(span[0])} to {percent(span[1])} of the median thickness. {thinnest}"
            f" Failures: {words}."
        )
        drawn.append(
            Figure(
                film.thickness_map(shown, span, counts, short(name, 42), alt=alt),
                flow(f"{thinnest} Failures: {words}. Shade: ", percent(span[1]), " (light) to ", percent(span[0]), " (dark) of the median thickness; blue: edge of the electrode; lengths in mm."),
                href,
            )
        )  # fmt: skip
    return Pair(tuple(drawn), "trio")


def tell_thinnest(shown: film.Film) -> str:
    """Where the simulated film is thinnest under the electrode, and what that does to the field; a sentence."""
    found = film.find_thinnest(shown)
    if found is None:
        return "No thickness is known under the electrode."
    return (
        f"Thinnest under the electrode {found.place}: {percent(found.relative)} of the median thickness, so that the field there"
        f" is {significant(1 / found.relative)} times that at the median."
    )


def _where_heading(known: Sequence[Record]) -> str:
    sites = [r["failure_site"] for r in known if r["failure_site"]]
    if not sites:
        return "Where the film fails"
    common = max(sorted(set(sites)), key=sites.count)
    place = {"rod": "at a rod", "lead": "at the lead", "active": "in the active region", "edge": "at the edge"}.get(
        common, f"at: {visible(common)}"
    )
    number = sites.count(common)
    return f"{capital(among(number, len(sites), 'failure'))} {'lies' if number == 1 else 'lie'} {place}"
