"""The kinds of figures that can leave a page, and the function that draws each."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from matplotlib.figure import Figure

from reports.figures.picture import Picture
from reports.figures.printed import diagnosis, lab, lives, relaxing, responses, steps
from reports.figures.printed.style import DOUBLE, SINGLE


@dataclass(frozen=True)
class Kind:
    """How a kind is drawn, and the width that it has unless another is asked for."""

    draw: Callable[..., Figure]
    width: str = SINGLE


KINDS: Mapping[str, Kind] = {
    "response": Kind(responses.draw_response, DOUBLE),
    "spectrum": Kind(responses.draw_spectrum),
    "force-under-voltage": Kind(responses.draw_force_under_voltage),
    "blocked-force": Kind(responses.draw_blocked_force),
    "voltage-squared": Kind(steps.draw_against_square),
    "step-response": Kind(steps.draw_traces),
    "sensing": Kind(steps.draw_sensing),
    "force-map": Kind(steps.draw_forces),
    "relaxation": Kind(relaxing.draw_relaxation),
    "cycle": Kind(relaxing.draw_cycle),
    "cycle-residual": Kind(relaxing.draw_cycle_residual),
    "diagnosis": Kind(diagnosis.draw_comparison),
    "residual-map": Kind(diagnosis.draw_residual_map),
    "held-out": Kind(diagnosis.draw_held_out),
    "survival": Kind(lives.draw_survival),
    "lifetimes": Kind(lives.draw_probability),
    "control": Kind(lab.draw_control),
    "timeline": Kind(lab.draw_timeline, DOUBLE),
}


def draw_picture(picture: Picture, width: str | None = None) -> Figure:
    """The printed figure of what a page shows; `width` is `single` or `double`, the kind's own where it is None."""
    kind = KINDS[picture.kind]
    figure = kind.draw(*picture.data, **picture.options, width=width or kind.width)
    figure.set_label(picture.finding)
    return figure
