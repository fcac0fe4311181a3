"""A page in the making: what its parts share, and the data files they leave beside it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from reports.csvfile import Column, csv
from reports.results import Results
from reports.site import Site


@dataclass
class Draft:
    """Page about one `item` of a `kind` (specimen, campaign, recording)."""

    site: Site
    kind: str
    item: str
    files: dict[str, str] = field(default_factory=dict)
    root: str = "../"

    @property
    def results(self) -> Results:
        return self.site.results

    def data(self, figure: str, columns: Mapping[str, Column]) -> str:
        """Keeps the data of a figure; gives the file's address from the page."""
        path = self.site.data_path(self.kind, self.item, figure)
        self.files[path] = csv(columns)
        return self.root + path
