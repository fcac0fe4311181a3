"""Which mechanisms may act either way."""

from __future__ import annotations

from pipeline.diagnose.mechanisms import MECHANISMS


def test_a_permittivity_only_falls_with_frequency() -> None:
    """The loss of a passive dielectric is not negative. A strip in series that stiffens was named a permittivity that rises."""
    (per_decade,) = MECHANISMS["frequency_dependent_permittivity"].severities
    assert not per_decade.signed
    assert per_decade.least >= 0
