"""What the recording stage leaves for the diagnosis: a recording's features as text, or why it has none.

Apart from `pipeline.diagnose` so that the other stages, which carry it along, do not depend on the code of the diagnosis.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from schemas.arrays import Float

CYCLE, SYSTEM = "cycle", "system"


@dataclass(frozen=True)
class Single:
    """A record that can be asked without others: a large cycle, or a system of another kind.

    channels : (m,) each: time_s, stretch, stress (kPa) of a cycle; time_s, input, output of a system
    given : what the recording says of it; empty for nothing
    unit : of the output of a system
    """

    kind: str
    channels: Mapping[str, Float]
    given: Mapping[str, float] = field(default_factory=dict)
    unit: str = ""


@dataclass(frozen=True)
class SessionFeatures:
    """What the diagnosis gets of a recording.

    Parameters
    ----------
    content : as `pipeline.diagnose.features.encode` packs it; empty where there is none
    refused : why there is none
    single : the record itself, where it says something without a session
    unanswered : why a test that gives a frequency response gave none; empty where it gave one, or its protocol gives none
    """

    content: str
    refused: str = ""
    single: Single | None = None
    unanswered: str = ""
