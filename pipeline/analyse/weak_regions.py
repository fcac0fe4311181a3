"""Weak regions of films over rods: thickness by finite elements against the places where specimens failed, and their lives."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from pipeline.analyse.analysis import Analysis
from pipeline.analyse.film_lives import LayoutLives, film_life_tables
from pipeline.analyse.inputs import Measured
from pipeline.fit.survival.electrode_design import ElectrodeDesign, design_electrodes
from pipeline.fit.survival.film_life import PLAUSIBLE_EXPONENT, fit_film_life, lay_film
from pipeline.fit.survival.weak_regions import (
    THIN,
    FilmGrid,
    LayoutCheck,
    RegionShare,
    check_layout,
    compare_regions,
    electrodes,
    on_grid,
)
from pipeline.physics.thickness.continuous import continuous_thickness
from pipeline.physics.thickness.film import RodFilm, ThicknessMap
from pipeline.physics.thickness.incremental import incremental_thickness
from schemas.errors import NotIdentifiableError
from schemas.lifetimes import OUTSIDE_THE_FILM, LifetimeRow
from schemas.metadata import RecordingMetadata
from schemas.tables import TABLES

if TYPE_CHECKING:
    import pyarrow as pa

ELEMENTS = 3000
"""Elements of a film. Against 32 000 the shares of the regions and of the rods change by 0.008 at most, that of thin film
under the electrodes by 0.003, in a tenth of the time."""


def analyse_weak_regions(recordings: Sequence[Measured]) -> Analysis:
    """Expected and found failures of each campaign's configurations whose recordings say where their rods are."""
    analysis = Analysis()
    groups: dict[tuple[str, str], list[Measured]] = {}
    for one in recordings:
        about = one.metadata
        if isinstance(about, RecordingMetadata) and about.rods is not None and about.configuration is not None:
            groups.setdefault((about.campaign or "", about.configuration), []).append(one)
    layouts: dict[str, list[LayoutLives]] = {}
    for (campaign, configuration), members in sorted(groups.items()):
        what = f"weak regions of {configuration}" + (f" ({campaign})" if campaign else "")
        analysis.attempt(what, _configuration, analysis, campaign or None, configuration, members)
        lives = analysis.attempt(f"life from the film: {configuration}", _lay, configuration, members)
        if lives is not None:
            layouts.setdefault(campaign, []).append(lives)
    for campaign, tested in layouts.items():
        tables = analysis.attempt("life from the film", film_life_tables, campaign or None, tested)
        if tables is not None:
            analysis.add(tables)
        if len(tested) > 1:
            firsts = {name: own[0] for (where, name), own in sorted(groups.items()) if where == campaign}
            analysis.attempt("electrode designs", _design, analysis, campaign or None, tested, firsts)
    return analysis


def _lay(configuration: str, members: Sequence[Measured]) -> LayoutLives:
    """The configuration's film under its electrodes, by the better of the two schemes, and its lives."""
    about = members[0].metadata
    assert isinstance(about, RecordingMetadata)
    if about.layer_thickness_mm is None:
        raise NotIdentifiableError(
            "film_thickness_mm not given", where=about.recording_id, expected="the thickness of the undeformed film"
        )
    film = rod_film(about)
    layout = lay_film(configuration, _maps(film)[0], electrodes(film, about.electrode_gap_mm), about.layer_thickness_mm)
    return LayoutLives(layout, [life for one in members for life in one.of(LifetimeRow)])


def _design(
    analysis: Analysis, campaign: str | None, tested: Sequence[LayoutLives], members: Mapping[str, Measured]
) -> None:
    """Electrodes that would live longer, for each configuration of a campaign, by the law of all its lives."""
    law = fit_film_life([group for one in tested for group in one.groups()], PLAUSIBLE_EXPONENT)
    for name, member in members.items():
        about = member.metadata
        assert isinstance(about, RecordingMetadata)
        film = rod_film(about)
        designs = design_electrodes(_maps(film)[0], electrodes(film, about.electrode_gap_mm), law)
        analysis.add(electrode_design_tables(campaign, name, designs))


def electrode_design_tables(
    campaign: str | None, configuration: str, designs: Sequence[ElectrodeDesign]
) -> dict[str, pa.Table]:
    """Tables `electrode_designs` and `electrode_shapes` of one configuration."""
    about = {"campaign": campaign, "configuration": configuration}
    shapes = [
        {
            **about, "design": one.design, "number": number, "x_low_mm": r.x_low, "x_high_mm": r.x_high,
            "y_low_mm": r.y_low, "y_high_mm": r.y_high,
        }
        for one in designs
        for number, r in enumerate(one.electrodes, start=1)
    ]  # fmt: skip
    return {
        "electrode_designs": TABLES["electrode_designs"].from_objects(designs, **about),
        "electrode_shapes": TABLES["electrode_shapes"].rows(shapes),
    }


def _configuration(analysis: Analysis, campaign: str | None, configuration: str, members: Sequence[Measured]) -> None:
    about = members[0].metadata
    assert isinstance(about, RecordingMetadata)
    film = rod_film(about)
    layout = electrodes(film, about.electrode_gap_mm)
    failures = [life for one in members for life in one.of(LifetimeRow) if life.failed]
    in_film = [life for life in failures if life.failure_site not in OUTSIDE_THE_FILM]
    continuous, incremental = _maps(film)
    shares = compare_regions(continuous, layout, [(life.failure_region, life.failure_site) for life in in_film])
    sites = [life.failure_site for life in in_film]
    voltages = [life.voltage_kv for one in members for life in one.of(LifetimeRow) if life.voltage_kv is not None]
    checks = [
        check_layout(
            one,
            layout,
            sites,
            voltage_kv=max(voltages, default=None),
            thickness_mm=about.film_thickness_mm,
        )
        for one in (continuous, incremental)
    ]
    grids = [on_grid(one, layout) for one in (continuous, incremental)]
    others = len(failures) - len(in_film)
    analysis.add(weak_region_tables(campaign, configuration, shares, checks, grids, others))


def weak_region_tables(
    campaign: str | None,
    configuration: str,
    shares: Sequence[RegionShare],
    checks: Sequence[LayoutCheck],
    grids: Sequence[FilmGrid],
    other_failures: int,
) -> dict[str, pa.Table]:
    """Tables `weak_regions`, `electrode_layouts` and `film_maps` of one configuration.

    `other_failures` is the number of its failures that are not in the film.
    """
    about = {"campaign": campaign, "configuration": configuration}
    regions, layouts, maps = (TABLES[name] for name in ("weak_regions", "electrode_layouts", "film_maps"))
    return {
        "weak_regions": regions.from_objects(
            shares,
            **about,
            other_failures=other_failures,
            predicted_share=lambda share: share.predicted,
            predicted_share_lower=lambda share: share.predicted_range[0],
            predicted_share_upper=lambda share: share.predicted_range[1],
            observed_share=lambda share: share.observed,
            observed_share_lower=lambda share: share.observed_interval and share.observed_interval[0],
            observed_share_upper=lambda share: share.observed_interval and share.observed_interval[1],
        ),
        "electrode_layouts": layouts.from_objects(checks, **about, thickness_limit=THIN),
        "film_maps": maps.stack(maps.arrays(grid.x_mm.size, **about, **vars(grid)) for grid in grids),
    }


def rod_film(about: RecordingMetadata) -> RodFilm:
    """The film over its rods from a recording's metadata: direction 2 runs along the rods, direction 1 across.

    Parameters
    ----------
    about : sizes of the undeformed film and its stretches; a film of no stated size ends with its electrode

    Returns
    -------
    The finished film

    Raises
    ------
    NotIdentifiableError
        A size is missing, or the rods do not fit.
    """
    whole = None not in (about.film_length_mm, about.film_width_mm)
    sizes = ("film_length_mm", "film_width_mm") if whole else ("active_length_mm", "active_width_mm")
    names = ("stretch_1", "stretch_2", *sizes, "rod_spacing_mm", "rod_diameter_mm")
    missing = [name for name in names if getattr(about, name) is None]
    if missing:
        raise NotIdentifiableError(
            f"{', '.join(missing)} not given", where=about.recording_id, expected="the geometry of film and rods"
        )
    across, along = (getattr(about, name) for name in sizes)
    stretch_across, stretch_along = about.stretch_1 or 1.0, about.stretch_2 or 1.0
    if whole or about.active_drawn == "undeformed":
        across, along = across * stretch_across, along * stretch_along
    try:
        return RodFilm(
            length_mm=along,
            width_mm=across,
            rods=about.rods or 1,
            rod_spacing_mm=about.rod_spacing_mm or 0.0,
            rod_diameter_mm=about.rod_diameter_mm or 0.0,
            stretch_along=stretch_along,
            stretch_across=stretch_across,
        )
    except ValueError as error:
        raise NotIdentifiableError(str(error), where=about.recording_id) from None


@functools.lru_cache(maxsize=4)
def _maps(film: RodFilm) -> tuple[ThicknessMap, ThicknessMap]:
    """Both schemes; configurations that differ in their electrodes only share one film."""
    return continuous_thickness(film, elements=ELEMENTS), incremental_thickness(film, elements=ELEMENTS)
