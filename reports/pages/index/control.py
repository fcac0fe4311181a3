"""Control charts: does a rig, a batch, an operator or the share of refused files stay what it was?"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup

from reports.blocks import (
    Block,
    Figure,
    Fold,
    Head,
    Link,
    Page,
    Pair,
    Piece,
    Row,
    Section,
    Table,
    Text,
    bold,
    flow,
    name,
)
from reports.figures import control as figures
from reports.names import short
from reports.pages.draft import Draft
from reports.results import Query, moment
from reports.results import Row as Record
from reports.site import CONTROL, Site
from reports.words import followed
from schemas.arrays import Float
from schemas.control import FEWEST
from schemas.numbers import ABSENT, capital, counted, digits, pm, significant, with_unit, word

_GROUPS = {
    "rig": ("rigs", "Rigs"),
    "batch": ("batches", "Batches"),
    "operator": ("operators", "Operators"),
    "night": ("nights", "Nights"),
}
_DRAWN = 24
"""Charts drawn on the page; those with an alarm first."""
_ALARMS = Query(
    'SELECT grouped_by, name, quantity, unit, point_kind, point, "at", value, sd, expected, lower, upper, alarm\n'
    "FROM out_of_control"
)
_POINTS = Query(
    'SELECT grouped_by, name, quantity, unit, point_kind, point, "at", value, sd, points, expected, lower, upper, alarm\n'
    "FROM control_points"
)


def alarms(site: Site) -> list[Record]:
    """Points that leave their limits, the latest first."""
    return site.results.rows(_ALARMS)


def sentence(alarm: Record) -> Markup:
    """`Rig shaker: load-cell stiffness 21.17 ± 0.02 N/mm with PA-3, beyond its limits (expected 19.5 to 20.6 N/mm).`"""
    who = flow(f"{capital(alarm['grouped_by'])} ", name(alarm["name"])) if alarm["grouped_by"] != "night" else "Nights"
    unit = alarm["unit"] or ""
    limits = "" if alarm["lower"] is None else f" (expected {_between(alarm)}{' ' + unit if unit else ''})"
    about = (
        flow("with ", name(alarm["point"])) if alarm["point_kind"] != "run" else flow("in run ", name(alarm["point"]))
    )
    return flow(
        who, f": {followed(alarm['quantity'])} {with_unit(_value(alarm), unit)} ", about, f", {alarm['alarm']}{limits}."
    )  # fmt: skip


def _value(point: Record) -> str:
    if point["quantity"] == "refused_share":
        return f"{significant(100 * point['value'], 2)} %"
    return significant(point["value"], 4) if point["sd"] is None else pm(point["value"], point["sd"])


def _between(point: Record) -> str:
    scale, ending = (100.0, " %") if point["quantity"] == "refused_share" else (1.0, "")
    return f"{significant(scale * point['lower'])} to {significant(scale * point['upper'])}{ending}"


def page(site: Site) -> Page:
    """All charts, those with an alarm first."""
    draft = Draft(site, "lab", "control", root="")
    found = site.results.rows(_POINTS)
    charts: dict[tuple[str, str, str], list[Record]] = {}
    for point in found:
        charts.setdefault((point["grouped_by"], point["name"], point["quantity"]), []).append(point)
    out = alarms(site)
    limited = {k: points for k, points in charts.items() if points[0]["upper"] is not None and len(points) >= FEWEST}
    sections = [_alarm_section(site, out)] if out else []
    order = sorted(limited, key=lambda key: (not any(p["alarm"] for p in limited[key]), key))[:_DRAWN]
    for group, (anchor, title) in _GROUPS.items():
        keys = [key for key in order if key[0] == group]
        if keys:
            figures_ = [_figure(draft, key, limited[key]) for key in keys]
            pairs = tuple(Pair(tuple(figures_[i : i + 2])) for i in range(0, len(figures_), 2))
            sections.append(Section(anchor, _heading(title, keys, limited), title, pairs))
    sections.append(_all_charts(charts))
    return Page(
        title="Control charts",
        heading=_title(out, limited),
        bar=site.bar("", CONTROL),
        crumbs=(Link("Last night", "index.html"), Link("Control charts")),
        lede=(
            "Each point is compared with what the other points of its chart predict: limits are their 99.73 % prediction"
            " interval (Student’s t), so that one point in 370 leaves them by chance. Eight points in a row on one side of"
            " the median are an alarm, too."
        ),
        sections=tuple(sections),
        provenance=site.provenance(None),
        files=draft.files,
    )


def _title(out: Sequence[Record], limited: dict[tuple[str, str, str], list[Record]]) -> str:
    if out:
        return f"{capital(counted(len(out), 'point'))} out of control, in {counted(len(limited), 'chart')}"
    if limited:
        return f"{capital(counted(len(limited), 'control chart'))}: every point within its limits"
    return "Too few points for control charts"


def _heading(title: str, keys: Sequence[tuple[str, str, str]], charts: dict[tuple[str, str, str], list[Record]]) -> str:
    bad = sum(any(p["alarm"] for p in charts[key]) for key in keys)
    return (
        f"{title}: {word(bad)} of {counted(len(keys), 'chart')} with an alarm" if bad else f"{title}: within the limits"
    )


def _alarm_section(site: Site, out: Sequence[Record]) -> Section:
    rows = tuple(
        Row(
            (
                flow(capital(a["grouped_by"]), " ", name(a["name"])), followed(a["quantity"]),
                site.recording(a["point"], "") if a["point_kind"] == "recording" else site.specimen(a["point"], "") if a["point_kind"] == "specimen" else name(a["point"]),
                moment(a["at"]), flow(_value(a), " ", a["unit"] or ""), ABSENT if a["lower"] is None else _between(a), a["alarm"],
            )
        )
        for a in out[:100]
    )  # fmt: skip
    heads = (
        Head("Chart"), Head("Quantity"), Head("Point"), Head("Measured"), Head("Value", "n"), Head("Expected", "n"),
        Head("Why", "text"),
    )  # fmt: skip
    table = Table("Points that leave their limits, the latest first", heads, rows, _ALARMS.shown(), kind="wide")
    return Section("alarms", f"{capital(counted(len(out), 'point'))} out of control", "Alarms", (table,))


def _figure(draft: Draft, key: tuple[str, str, str], points: Sequence[Record]) -> Figure:
    group, chart, quantity = key
    scale = 100.0 if quantity == "refused_share" else 1.0

    def real(column: str) -> Float:
        return np.array([np.nan if p[column] is None else scale * p[column] for p in points], dtype=float)

    item = figures.Chart(
        [p["point"] for p in points], real("value"), real("sd"), real("expected"), real("lower"), real("upper"),
        np.array([p["alarm"] is not None for p in points]),
    )  # fmt: skip
    unit = "%" if quantity == "refused_share" else points[0]["unit"] or ""
    title = f"{capital(followed(quantity))}{', ' + unit if unit else ''}"
    who = "all nights" if group == "night" else f"{group} {short(chart, 40)}"
    bad = [p for p in points if p["alarm"]]
    words = f"{digits(len(points), 'point')}, " + (
        f"{short(', '.join(p['point'] for p in bad), 60)} out of control" if bad else "all within their limits"
    )
    kind = {"run": "Run", "recording": "Calibration", "specimen": "Specimen"}[points[0]["point_kind"]]
    columns = {n: [p[n] for p in points] for n in ("point", "at", "value", "sd", "expected", "lower", "upper", "alarm")}
    columns["at"] = ["" if t is None else t.isoformat() for t in columns["at"]]
    number = len(draft.files) + 1
    return Figure(
        figures.chart(item, title, f"{kind}, in the order of time", alt=f"{title} of {who}: {words}."),
        flow(bold(f"{capital(who)}."), f" {words}. Grey: limits; dashed: expected; bars: ±1 SD."),
        draft.data(f"control_{number:02d}", columns),
    )  # fmt: skip


_ALL = Query(
    "SELECT grouped_by, name, quantity, unit, count(*) AS points, min(value) AS least, median(value) AS middle,\n"
    "       max(value) AS most, count(alarm) AS alarms\nFROM control_points\nGROUP BY ALL\n"
    "ORDER BY alarms DESC, grouped_by, name, quantity"
)


def _all_charts(charts: dict[tuple[str, str, str], list[Record]]) -> Section:
    rows = []
    for key in sorted(charts, key=lambda k: (-sum(p["alarm"] is not None for p in charts[k]), k)):
        points = charts[key]
        scale = 100.0 if key[2] == "refused_share" else 1.0
        values = [scale * p["value"] for p in points]
        unit = "%" if scale != 1 else points[0]["unit"] or ""
        limited: Piece = "yes" if points[0]["upper"] is not None else "too few points"
        rows.append(
            Row(
                (
                    flow(capital(key[0]), " ", name(key[1])), followed(key[2]), unit, str(len(points)),
                    significant(min(values), 4), significant(float(np.median(values)), 4), significant(max(values), 4), limited,
                    str(sum(p["alarm"] is not None for p in points)),
                )
            )
        )  # fmt: skip
    heads = (
        Head("Chart"), Head("Quantity"), Head("Unit"), Head("Points", "n"), Head("Least", "n"), Head("Median", "n"), Head("Most", "n"),
        Head("Limits"), Head("Alarms", "n"),
    )  # fmt: skip
    table = Table("All charts", heads, tuple(rows), _ALL.shown())
    blocks: tuple[Block | Fold, ...] = (table,) if len(rows) <= 30 else (Fold(f"All {len(rows)} charts", (table,)),)
    note = Text(
        f"A chart has limits from {word(FEWEST)} points on. Specimens are judged by their mechanical fits.", "sub"
    )
    return Section("all", "All charts in numbers", "All charts", (*blocks, note))
