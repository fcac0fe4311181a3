"""Finite elements of the demonstration film."""

from __future__ import annotations

import time
from typing import Any

from pipeline.physics.thickness.continuous import continuous_thickness
from pipeline.physics.thickness.film import RodFilm
from pipeline.physics.thickness.incremental import incremental_thickness

TITLE = "Film thickness over rods, 20 000 elements"


def run() -> list[dict[str, Any]]:
    rows = []
    for name, scheme in (("continuous", continuous_thickness), ("incremental", incremental_thickness)):
        started = time.perf_counter()
        found = scheme(RodFilm(), elements=20_000)
        seconds = time.perf_counter() - started
        note = f"{found.thickness.size} elements, {found.iterations} linear systems; aim: at most 10 s"
        rows.append({"name": name, "seconds": seconds, "note": note})
    return rows
