"""What the recording stage leaves for the diagnosis: a recording's features as text, or why it has none.

Apart from `pipeline.diagnose` so that the other stages, which carry it along, do not depend on the code of the diagnosis.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SessionFeatures:
    """`content` as `pipeline.diagnose.features_io` packs it; empty where `refused` says why there is none."""

    content: str
    refused: str = ""
