"""The cases of the bug reports, each with its outcome as its README gives it: one line each.

python -m tests.strangers.cases [NAME…]       all cases, or those named; folder: DEALAB_CASES, else ../shared/cases

Every outcome is coded here apart from the pipeline: from the README's numbers, not from what was once computed.
"""

from __future__ import annotations

import math
import os
import shutil
import sys
import tempfile
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from pipeline.lab.lab import Lab
from pipeline.lab.query import Query
from schemas.visible import shown
from tests.strangers.nights import REFUSED, NightOfOne, Taken, drafted, run_night

ROOT = Path(__file__).resolve().parents[2]
FOLDER = Path(os.environ.get("DEALAB_CASES", ROOT.parent / "shared" / "cases"))
OK, AS_ALLOWED, WRONG = "ok", "refused as allowed", "WRONG"
CHECKS: dict[str, Callable[[NightOfOne], Iterator[str]]] = {}
DRAFTS: dict[str, Callable[[dict[str, object], str], Iterator[str]]] = {}
Wrong = Iterator[str]


def check(function: Callable[[NightOfOne], Wrong]) -> Callable[[NightOfOne], Wrong]:
    """Registers the outcome of a case: what is wrong with the night over the folder of its name."""
    CHECKS[function.__name__] = function
    return function


def draft(function: Callable[[dict[str, object], str], Wrong]) -> Callable[[dict[str, object], str], Wrong]:
    """Registers what the draft of a mapping must say."""
    DRAFTS[function.__name__] = function
    return function


def near(found: float | None, expected: float, share: float, what: str) -> Wrong:
    """What is wrong where a figure is not within a share of the expected one."""
    if found is None or not math.isclose(float(found), expected, rel_tol=share):
        yield f"{what} is {found}, not {expected:g}"


def finite(taken: Taken, quantity: str) -> np.ndarray:
    """The samples of a channel that are there."""
    values = taken.columns.get(quantity, np.empty(0))
    return values[np.isfinite(values)]


def whole_recording(night: NightOfOne) -> Wrong:
    """All 400 samples of the triangle that most cases hold: 0.010 to 1.010 mm and back, −0.017 to 0.283 N and back."""
    taken = night.only
    up_and_down = np.minimum(np.arange(400), 400 - np.arange(400))
    for quantity, first, step in (("displacement", 0.010, 0.005), ("force", -0.017, 0.0015)):
        values = finite(taken, quantity)
        if values.size != 400 or not np.allclose(values, first + step * up_and_down, atol=2e-6):
            yield f"{values.size} {quantity} samples, not the triangle of 400: {taken.said}"


@check
def survivors_dropped(night: NightOfOne) -> Wrong:
    where = "FROM survival_summaries WHERE configuration = 'carbon black/silicone'"
    lives = "SELECT count(*) FROM lifetimes WHERE configuration = 'carbon black/silicone' AND"
    if night.value(f"{lives} failed") != 3 or night.value(f"{lives} NOT failed AND lifetime_s = 3600") != 5:
        yield "B is not 3 failures and 5 survivors at 3600 s"
    yield from near(night.value(f"SELECT restricted_mean_s {where}"), 3154, 1e-3, "restricted mean of B")
    yield from near(night.value(f"SELECT weibull_scale_s {where}"), 4921, 2e-3, "Weibull scale of B")


@check
def cycle_geometry_ignored(night: NightOfOne) -> Wrong:
    if night.only.status not in ("ok", "damaged"):
        yield f"status {night.only.status}: {night.only.said}"
    yield from near(night.value("SELECT k0_n_per_mm FROM best_models"), 0.060, 0.05, "k0")
    yield from _no_cube(night)


@check
def relaxation_no_rest(night: NightOfOne) -> Wrong:
    rows = night.rows("SELECT k1_n_per_mm / c1_n_s_per_mm, k2_n_per_mm / c2_n_s_per_mm FROM best_models")
    times = sorted(1 / rate for row in rows for rate in row if rate)
    if len(times) != 2 or not np.allclose(times, (5, 80), rtol=0.1):
        yield f"relaxation times {times} s, not 5 and 80 s"


@check
def chirp_8_rows_missing(night: NightOfOne) -> Wrong:
    lines = "SELECT count(*) FROM frequency_responses WHERE stage = 'measured' AND usable"
    if (night.value(lines) or 0) < 26:
        yield f"{night.value(lines)} usable lines of about 52"
    for key, value in (("k0_n_per_mm", 0.300), ("k1_n_per_mm", 0.120), ("c1_n_s_per_mm", 0.0060)):
        yield from near(night.value(f"SELECT {key} FROM best_models"), value, 0.01, key)


@check
def chirp_cut_early(night: NightOfOne) -> Wrong:
    usable = "FROM frequency_responses WHERE stage = 'measured' AND usable"
    highest = night.value(f"SELECT max(frequency_hz) {usable}")
    if highest is not None and highest > 2.0:
        yield f"lines up to {highest:g} Hz are usable"


@check
def chirp_force_negative(night: NightOfOne) -> Wrong:
    if "negative" not in (night.only.said + " ".join(night.attention)).lower():
        yield "nothing says that the stiffness is negative"


@check
def csv_blank_row_rate(night: NightOfOne) -> Wrong:
    taken = night.only
    if taken.status == REFUSED:
        return
    if taken.time_ns.size != 400:
        yield f"{taken.time_ns.size} instants, not 400"
    else:
        yield from near(taken.columns["displacement"][300], 0.510, 1e-6, "displacement at 3.00 s")


@check
def csv_ragged_rows(night: NightOfOne) -> Wrong:
    sizes = finite(night.only, "displacement").size, finite(night.only, "force").size
    if sizes != (400, 200):
        yield f"{sizes[0]} displacements and {sizes[1]} forces"


@check
def csv_si_suffix(night: NightOfOne) -> Wrong:
    yield from whole_recording(night)


@check
def csv_unicode_minus(night: NightOfOne) -> Wrong:
    yield from whole_recording(night)


@check
def cycle_geometry_no_stretch1(night: NightOfOne) -> Wrong:
    if night.only.status == REFUSED:
        if "stretch_1" not in night.only.said:
            yield f"refused without a word about stretch_1: {night.only.said}"
        return
    yield from _no_cube(night)


@check
def elapsed_hms_text(night: NightOfOne) -> Wrong:
    yield from whole_recording(night)
    yield from near(night.only.duration_s, 3.99, 1e-6, "duration")


@check
def excel_life_in_hours(night: NightOfOne) -> Wrong:
    lives = [row[0] for row in night.rows("SELECT lifetime_s FROM lifetimes ORDER BY lifetime_s")]
    if lives != [1800, 4500, 10800, 27000, 93600, 180900]:
        yield f"lives {lives}"


@check
def excel_numbers_as_text(night: NightOfOne) -> Wrong:
    yield from whole_recording(night)


@check
def excel_serial_in_csv(night: NightOfOne) -> Wrong:
    if night.only.status != REFUSED or "2096" not in night.only.said:
        yield f"status {night.only.status}: {night.only.said}"


@check
def excel_time_of_day(night: NightOfOne) -> Wrong:
    yield from whole_recording(night)
    yield from near(night.only.duration_s, 3.99, 1e-6, "duration")


@check
def h5_compound_table(night: NightOfOne) -> Wrong:
    yield from whole_recording(night)


@check
def h5_packed_integers(night: NightOfOne) -> Wrong:
    force = night.only.columns.get("force", np.empty(0))
    if not math.isclose(np.nanmin(force), -0.017, abs_tol=2e-5) or not math.isclose(
        np.nanmax(force), 0.283, abs_tol=1e-3
    ):
        yield f"forces from {np.nanmin(force):g} to {np.nanmax(force):g} N"
    if int(np.isnan(force).sum()) != 1:
        yield f"{int(np.isnan(force).sum())} NULL"


@draft
def inspect_logger_csv(found: dict[str, object], text: str) -> Wrong:
    yield from _drafts(found, text, "recording", {"displacement": "displacement (mm)", "force": "force (N)"})


@check
def life_alternating_voltage(night: NightOfOne) -> Wrong:
    failed = night.value("SELECT count(*) FROM lifetimes WHERE failed AND lifetime_s < 2")
    if failed and night.only.status == "ok" and "constant" not in night.only.said.lower():
        yield "a failure after 1 s, status ok, without a word"


@check
def life_zero(night: NightOfOne) -> Wrong:
    first = night.rows("SELECT survival FROM survival_curves WHERE survival < 1 ORDER BY time_s LIMIT 1")
    if not first or not math.isclose(first[0][0], 10 / 12, rel_tol=1e-6):
        yield f"the curve begins with {first}, not 10/12"
    yield from near(night.value("SELECT median_s FROM survival_summaries"), 40, 1e-9, "median")


@check
def local_time_end_of_summer(night: NightOfOne) -> Wrong:
    taken = night.only
    first = np.datetime64("2026-10-25T00:40:00", "ns").astype(np.int64)
    if taken.time_ns.size != 400 or not np.array_equal(taken.time_ns, first + 6_000_000_000 * np.arange(400)):
        yield f"{taken.time_ns.size} rows, status {taken.status}: {taken.said}"


@check
def loss_modulus_quote_in_header(night: NightOfOne) -> Wrong:
    rows = night.value("SELECT count(*) FROM frequency_responses WHERE stage = 'measured'")
    if rows != 30:
        yield f"{rows} rows, not 30: {night.only.said}"


@check
def matlab73_objects(night: NightOfOne) -> Wrong:
    if night.only.status != REFUSED or "object" not in night.only.said.lower():
        yield f"status {night.only.status}: {night.only.said}"


@check
def matlab_struct_array(night: NightOfOne) -> Wrong:
    if "has no columns" in night.only.said:
        yield night.only.said


@check
def mcap_out_of_order(night: NightOfOne) -> Wrong:
    yield from whole_recording(night)


@check
def overload_9_9e37(night: NightOfOne) -> Wrong:
    taken = night.only
    if taken.status == REFUSED:
        return
    lost = int(np.isnan(taken.columns["force"]).sum())
    if taken.status != "damaged" or lost != 3 or np.nanmax(taken.columns["force"]) > 1:
        yield f"status {taken.status}, {lost} NULL, largest {np.nanmax(taken.columns['force']):g} N"


@check
def relax_ramp_from_first_sample(night: NightOfOne) -> Wrong:
    yield from near(night.value("SELECT k0_n_per_mm FROM best_models"), 0.300, 0.05, "k0")
    rows = night.rows("SELECT k1_n_per_mm, k2_n_per_mm FROM best_models")
    arms = sorted(k for k in (rows[0] if rows else ()) if k)
    if len(arms) != 2 or not np.allclose(arms, (0.150, 0.200), rtol=0.1):
        yield f"arms {arms} N/mm, not 0.150 and 0.200"


@check
def samples_case(night: NightOfOne) -> Wrong:
    sql = "SELECT (SELECT count(*) FROM samples('Run-A')) AS upper, (SELECT count(*) FROM samples('run-a')) AS lower"
    with Query(Lab(night.lab)) as query:
        (found,) = query.run(sql).to_pylist()
    if found != {"upper": 1000, "lower": 777}:
        yield f"samples('Run-A') and samples('run-a') have {found['upper']} and {found['lower']} rows, not 1000 and 777"


@check
def select_in_recording(night: NightOfOne) -> Wrong:
    taken = night.only
    if taken.status == REFUSED and "select" in taken.said:
        return
    values = finite(taken, "displacement")
    if values.size != 400 or not math.isclose(values.max(), 2.02, abs_tol=0.006):
        yield f"{values.size} rows up to {values.max() if values.size else None} mm"


@check
def step_other_40_samples(night: NightOfOne) -> Wrong:
    yield from _no_traceback(night)


@check
def step_other_input_spike_50(night: NightOfOne) -> Wrong:
    yield from _no_traceback(night)


@check
def tdms_index(night: NightOfOne) -> Wrong:
    stale = night.files.get("stale.tdms")
    if stale is not None and stale.status == "ok" and stale.time_ns.size != 300:
        yield f"{stale.time_ns.size} samples, status ok"
    swapped = night.files.get("idx.tdms")
    if (
        swapped is not None
        and swapped.time_ns.size
        and (abs(swapped.duration_s - 5.98) > 1e-6 or swapped.time_ns.size != 300)
    ):
        yield f"idx.tdms lasts {swapped.duration_s} s with {swapped.time_ns.size} samples, not 5.98 s with 300"


@check
def tdms_unit_words(night: NightOfOne) -> Wrong:
    if night.only.status not in ("ok", "damaged"):
        yield night.only.said


@check
def time_of_day_only(night: NightOfOne) -> Wrong:
    if night.only.status != REFUSED or "date" not in night.only.said:
        yield f"status {night.only.status}: {night.only.said}"


@check
def toml_int(night: NightOfOne) -> Wrong:
    statuses = {t.name: t.status for t in night.files.values()}
    if night.exit_status != 3 or list(statuses.values()).count(REFUSED) < 3:
        yield f"exit {night.exit_status}, {statuses}"


@check
def unit_PF(night: NightOfOne) -> Wrong:
    taken = night.only
    if taken.status == "ok" and np.nanmax(taken.columns["capacitance"]) > 1e6:
        yield f"{np.nanmax(taken.columns['capacitance']):g} pF, status ok"
    if taken.status != "ok" and "PF" not in taken.said:
        yield f"{taken.status} without a word about PF: {taken.said}"


@check
def unit_row_time_conflict(night: NightOfOne) -> Wrong:
    if night.only.status != REFUSED or '"ms"' not in night.only.said:
        yield f"status {night.only.status}: {night.only.said}"


@draft
def dma_multi_temperature(found: dict[str, object], text: str) -> Wrong:
    expected = {"frequency": "Frequency", "storage": "Storage modulus", "loss": "Loss modulus"}
    yield from _drafts(found, text, "frequency_response", expected)
    data = next((FOLDER / "dma_multi_temperature").glob("*.csv"))
    with tempfile.TemporaryDirectory() as place:
        raw = Path(place) / "drafted"
        raw.mkdir()
        shutil.copy(data, raw)
        (raw / f"{data.name}.toml").write_text(text, encoding="utf-8")
        night = run_night(raw, Path(place))
        lines = "SELECT recording_id, count(*) FROM frequency_responses WHERE stage = 'measured' GROUP BY 1"
        sizes = [row[1] for row in night.rows(lines)]
        if sizes != [19] * 5:
            yield f"responses of {sizes} lines, not five of 19: {'; '.join(night.attention)}"
        curves = night.rows("SELECT reference_c, temperatures, warnings FROM master_curves")
        if [(round(at), count, said) for at, count, said in curves] != [(25, 5, None)]:
            yield f"master curves: {curves}"
        law = "SELECT c1_lower, c1_upper, c2_k_lower, c2_k_upper FROM shift_laws WHERE law = 'WLF' AND selected"
        for low, high, least, most in night.rows(law) or [(9, 9, 9, 9)]:
            if not (7.5 < low < 8 < high < 8.5 and 140 < least < 150 < most < 160):
                yield f"C1 {low:.3g} to {high:.3g}, C2 {least:.4g} to {most:.4g} K, not around 8 and 150 K"


@draft
def lifetime_excel_draft(found: dict[str, object], text: str) -> Wrong:
    expected = {"lifetime": "Time to breakdown [s]", "voltage": "Voltage [kV]", "configuration": "Electrode"}
    yield from _drafts(found, text, "lifetimes", expected | {"specimen_id": "Specimen"})


def _drafts(found: dict[str, object], text: str, kind: str, columns: dict[str, str]) -> Wrong:
    if found.get("kind") != kind:
        yield f"drafted as {found.get('kind')}: {text[:150]}"
        return
    mapped = found.get("columns")
    for name, column in columns.items():
        given = mapped.get(name, {}) if isinstance(mapped, dict) else {}
        if given.get("column") != column:
            yield f"{name} is drafted from {given.get('column')!r}, not {column!r}"


def _no_cube(night: NightOfOne) -> Wrong:
    pages = [p.name for p in (night.lab / "reports").rglob("*.html") if "mm cube" in p.read_text(encoding="utf-8")]
    if pages:
        yield f"read as a cube of 1 mm: {', '.join(pages[:3])}"


def _no_traceback(night: NightOfOne) -> Wrong:
    errors = [row[0] for row in night.rows("SELECT error FROM items WHERE error IS NOT NULL")]
    if errors:
        yield f"a traceback: {errors[0].strip().splitlines()[-1][:150]}"


def judge(name: str) -> tuple[str, str]:
    """The verdict on one case, and what it rests on."""
    if name in DRAFTS:
        folder = FOLDER / name
        text = drafted(folder / "raw" if (folder / "raw").is_dir() else folder)
        try:
            found = tomllib.loads(text)
        except tomllib.TOMLDecodeError:
            found = {}
        wrong = list(DRAFTS[name](found, text))
        return (WRONG, "; ".join(wrong)) if wrong else (OK, f"drafted as {found.get('kind')}")
    with tempfile.TemporaryDirectory() as place:
        folder = FOLDER / name
        plain = not (folder / "raw").is_dir() or name == "toml_int"
        night = run_night(folder if plain else folder / "raw", Path(place))
        if night.crash:
            return WRONG, f"the night crashed: {night.crash}"
        if not night.files:
            return WRONG, "; ".join(night.attention)
        wrong = list(CHECKS[name](night))
        said = "; ".join(t.said for t in night.files.values() if t.said)
        if any(t.status == REFUSED for t in night.files.values()) and not wrong:
            return AS_ALLOWED, said
        if wrong and all(t.status == REFUSED for t in night.files.values()):
            wrong.append(f"refused: {said}")
        return (WRONG, "; ".join(wrong)) if wrong else (OK, said)


def main(names: list[str]) -> int:
    """One line for each case; 1 where one is wrong or has no outcome here."""
    if not FOLDER.is_dir():
        print(f"DEALAB_CASES: no folder {FOLDER}", file=sys.stderr)
        return 1
    known = {**CHECKS, **DRAFTS}
    counts: dict[str, int] = {}
    for name in names or sorted(p.name for p in FOLDER.iterdir() if p.is_dir()):
        verdict, what = judge(name) if name in known else (WRONG, "no outcome is written down for it")
        counts[verdict] = counts.get(verdict, 0) + 1
        print(f"{name:<30} {verdict}{': ' if what else ''}{shown(what)[:300]}", flush=True)
    print(", ".join(f"{number} {verdict}" for verdict, number in sorted(counts.items())))
    return 1 if counts.get(WRONG) else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
