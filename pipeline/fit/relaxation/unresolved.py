"""Relaxations that are fitted alone, and an arm that is faster than their records resolve.

After a ramp the fastest arms have relaxed for the most part. What is left of one shows in the first windows only, and any
stiffness explains it with the relaxation time that goes with it: 10¹¹ N/mm was chosen for an arm of 0.3 N/mm. Such an
arm is no result, and a model without it would bend its other arms to follow those windows: they are left out, and the order is
chosen for the rest. Sweeps resolve the arms of their band: where there is one, nothing of this is done.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pipeline.fit.relaxation.observations import Block, Curve, Observations
from pipeline.fit.relaxation.results import RelaxationFit, SpecimenFits
from pipeline.physics.held_step import hold_kernel
from schemas.arrays import Bool
from schemas.numbers import significant

WIDEST = 1e3
"""Upper over lower 95 % limit of a stiffness from which it is not resolved."""
NOTICED = 0.3
"""Share of its standard deviation from which a window feels an arm."""
FEWEST = 8
"""Windows that a relaxation keeps, as many as it must have from the start."""
PASSES = 4
"""Most times that windows are left out: of simulated records of all kinds none needed more than two."""


def is_resolved(fit: RelaxationFit) -> bool:
    """Whether the stiffness of the fastest arm has limits that say something."""
    if fit.model.c_inf > 0:
        return False
    if not fit.model.k:
        return True
    found = fit.estimates[f"k{len(fit.model.k)}"]
    return found.lower is not None and found.upper is not None and found.upper <= WIDEST * found.lower


def without_first_windows(observations: Observations, fit: RelaxationFit) -> Observations | None:
    """The relaxations without the windows that feel the fit's fastest arm; None where too few would be left."""
    blocks: list[Block] = []
    for block in observations.blocks:
        if not isinstance(block, Curve):
            return None
        keep = ~_feels(block, fit)
        if keep.sum() < FEWEST:
            return None
        hold = replace(block.hold, start=block.hold.start[keep], width=block.hold.width[keep])
        blocks.append(replace(block, hold=hold, value=block.value[keep], weight=block.weight[keep]))
    rows = sum(block.rows for block in blocks)
    left_out = observations.rows - rows
    if not left_out:
        return None
    return replace(
        observations, blocks=tuple(blocks), data=observations.data - left_out, lines=observations.lines - left_out
    )


def _feels(block: Curve, fit: RelaxationFit) -> Bool:
    """(p,) true from the first window to the last that feels the fastest arm; the first one always does."""
    since = block.hold.since_last
    feels = since <= since.min()
    if fit.model.k and not fit.model.c_inf > 0:
        i = int(np.argmin(fit.model.tau))
        share = fit.model.k[i] * hold_kernel(block.hold, np.array([fit.model.tau[i]]))[0][:, 0]
        last = since[feels | (np.abs(share) * block.weight > NOTICED)].max()
        feels = since <= last
    return np.asarray(feels)


def describe_left_out(whole: Observations, kept: Observations, order: int) -> str:
    """Why a higher order was not taken, and which windows the chosen one does without."""
    ends = []
    for before, after in zip(whole.blocks, kept.blocks, strict=True):
        assert isinstance(before, Curve)
        assert isinstance(after, Curve)
        out = before.hold.since_last < after.hold.since_last.min()
        ends.append(float((before.hold.since_last + before.hold.width)[out].max(initial=0.0)))
    return (
        f"order {order} is not taken: its fastest arm shows in the first {whole.rows - kept.rows} windows only, up to"
        f" {significant(max(ends), 2)} s after the ramp, where any spring explains it. They are left out"
    )


def lowered(fits: SpecimenFits) -> SpecimenFits:
    """The fits with the highest order chosen whose fastest arm is resolved, and why the higher one is not taken."""
    lower = [fit.order for fit in fits.fits if fit.order < fits.selected_order]
    resolved = [order for order in lower if is_resolved(fits.of_order(order))]
    if not lower or is_resolved(fits.selected):
        return fits
    order = max(resolved, default=min(lower))
    why = f"order {fits.selected_order} is not taken, though it fits better: the data set no limits to its fastest arm"
    return replace(fits, selected_order=order, warnings=(*fits.warnings, why))
