"""Tables of lives on the pages of a night: counted as the specimens that they hold."""

from __future__ import annotations

import re
from pathlib import Path

import duckdb

from tests.strangers.nights import run_night

MAPPING = """kind = "lifetimes"
[csv]
delimiter = ";"
[columns.specimen_id]
column = "id"
[columns.lifetime]
column = "life"
unit = "s"
[recording]
recording_id = "lives"
campaign = "north"
configuration = "plain"
voltage_setpoint_kv = 6.0
"""


def test_a_campaign_of_tables_has_the_specimens_of_their_rows(tmp_path: Path) -> None:
    """It had none, beside "9 of 10 specimens failed"."""
    folder = tmp_path / "files"
    folder.mkdir()
    (folder / "lives.csv").write_text("id;life\nA;100\nB;150\nC;220\nD;> 300\n")
    (folder / "lives.csv.toml").write_text(MAPPING)
    made = run_night(folder, tmp_path / "night")
    page = (made.lab / "reports" / "index.html").read_text(encoding="utf-8")
    (table,) = (part for part in page.split("<table") if "Campaigns, the latest first" in part.split("</table>")[0])
    cells = re.findall(r"<t[dh][^>]*>(.*?)</t[dh]>", table.split("<tbody>")[1].split("</tr>")[0], flags=re.DOTALL)
    assert [re.sub(r"<[^>]+>", "", cell).strip() for cell in cells][:3] == ["north", "4", "1"]


def test_lists_without_a_campaign_are_campaigns_of_their_own(tmp_path: Path) -> None:
    """Two lists that name none were one group of all their lives, compared with each other, and stood on no page at all."""
    folder = tmp_path / "files"
    folder.mkdir()
    nameless = MAPPING.replace('campaign = "north"\n', "")
    for name, lives in (("first", "A;100\nB;150\nC;220\n"), ("second", "A;4100\nB;6150\nC;> 9000\n")):
        (folder / f"{name}.csv").write_text("id;life\n" + lives)
        (folder / f"{name}.csv.toml").write_text(nameless.replace('"lives"', f'"{name}"'))
    made = run_night(folder, tmp_path / "night")
    with duckdb.connect(str(made.lab / "results.duckdb"), read_only=True) as connection:
        groups = connection.sql("SELECT campaign, specimens, failures FROM survival_summaries ORDER BY ALL").fetchall()
        told = connection.sql(
            "SELECT recording_id, what, value FROM assumptions WHERE what = 'campaign' ORDER BY ALL"
        ).fetchall()
        compared = connection.sql("SELECT count(*) FROM survival_comparisons").fetchall()
    assert groups == [("first", 3, 3), ("second", 3, 2)]
    assert told == [("first", "campaign", "first"), ("second", "campaign", "second")]
    assert compared == [(0,)]
    page = (made.lab / "reports" / "campaigns" / "second.html").read_text(encoding="utf-8")
    assert "2 of 3 specimens failed" in page


def test_blanks_around_the_name_of_a_campaign_make_no_other(tmp_path: Path) -> None:
    folder = tmp_path / "files"
    folder.mkdir()
    for name, campaign in (("first", "north"), ("second", " north ")):
        (folder / f"{name}.csv").write_text(f"id;life\n{name}-1;100\n{name}-2;150\n")
        text = MAPPING.replace('"lives"', f'"{name}"').replace('"north"', f'"{campaign}"')
        (folder / f"{name}.csv.toml").write_text(text)
    made = run_night(folder, tmp_path / "night")
    with duckdb.connect(str(made.lab / "results.duckdb"), read_only=True) as connection:
        assert connection.sql("SELECT campaign, specimens FROM survival_summaries").fetchall() == [("north", 4)]
