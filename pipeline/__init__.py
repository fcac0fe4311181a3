"""From recordings to results: responses, models, survival, simulation, diagnosis, the database and the nightly.

`transform`, `fit`, `simulate` and `diagnose` are pure: arrays and frozen dataclasses in, frozen dataclasses out.
Files, databases and processes are touched in `lab`, `nightly` and `commands` only. `Lab` is the door for notebooks.
"""

from pipeline.lab.notebook import Lab

__all__ = ["Lab"]
