"""Tables of lives on the pages of a night: counted as the specimens that they hold."""

from __future__ import annotations

import re
from pathlib import Path

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
