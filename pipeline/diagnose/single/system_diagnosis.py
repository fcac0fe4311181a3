"""The diagnosis of a system of another kind: what a linear simulation of its records gets wrong, in bands about its
strongest resonance and by how large the output is, and which mechanism predicts it.

Does not belong here: the models (`oscillator`, `system_mechanisms`), and what their comparison means (`judge`,
`report`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import chi2

from pipeline.diagnose.judge import judge_predictions
from pipeline.diagnose.mechanisms import MECHANISMS
from pipeline.diagnose.results import AMBIGUOUS, NAMED, NONE, Diagnosis, Discrepancy, Residuals
from pipeline.diagnose.single.comparison import Comparison, compare_predictions
from pipeline.diagnose.single.oscillator import BAND_LIMITED, SystemRecord
from pipeline.diagnose.single.oscillator_fit import LinearStarts
from pipeline.diagnose.single.report import (
    Details,
    Films,
    describe_closest,
    describe_what_stays,
    list_smallest,
    name_unit,
    report_comparison,
)
from pipeline.diagnose.single.system_mechanisms import MOST_RESONANCES, SystemQuestion, ask_system, list_asked
from pipeline.physics.film import RelaxationModel
from schemas.arrays import Float
from schemas.assumptions import BETWEEN_SAMPLES, Assumption
from schemas.mechanisms import plain_name
from schemas.numbers import with_unit
from schemas.places import is_beyond_noise

OUTPUT = "system.output"
"""Kind of residuals: the output as both models, fitted to everything, simulate it."""
_SHOWN, _RESONANCES = 500, 25.0
"""Samples that are kept for figures at most, and turns of the resonance that they span."""
_NO_FILM = RelaxationModel(1.0, (), ())
"""Stands where a film's model would."""


def diagnose_system(
    specimen_id: str, records: Sequence[SystemRecord], protocols: Sequence[str], unit: str
) -> tuple[Diagnosis, Comparison]:
    """What a linear simulation gets wrong of a system's records, and which mechanism predicts a part left out.

    The simulation has one resonance, and one more as long as that predicts better than every mechanism does.

    Parameters
    ----------
    specimen_id : name of the system
    records : all with one sampling interval
    protocols : of the records
    unit : of the output

    Returns
    -------
    The diagnosis, and the comparison of the mechanisms behind it
    """
    starts = LinearStarts(records)
    for resonances in range(1, MOST_RESONANCES + 1):
        question = ask_system(records, resonances, starts=starts)
        comparison = compare_models(question)
        verdict = judge_predictions(comparison)
        if verdict == NONE or not _is_further_better(question):
            break
    measured, left_out, sd = question.measured, question.left_out, question.sd
    details = _collect_details(specimen_id, tuple(dict.fromkeys(protocols)), question, comparison, verdict, unit)
    return report_comparison(comparison, verdict, measured, left_out, sd, question.plain.whole, details), comparison


def compare_models(question: SystemQuestion) -> Comparison:
    """The mechanisms of a system by what they predict.

    Parameters
    ----------
    question : with the models
    """
    q = question
    return compare_predictions(
        q.plain, q.models, q.measured, q.left_out, q.sd, [place.p_value for place in _test_places(q)]
    )


def _is_further_better(q: SystemQuestion) -> bool:
    """Whether one resonance more predicts the part left out better than the plain model and every mechanism, beyond chance."""
    if q.further is None:
        return False
    first, *others = compare_predictions(q.plain, (*q.models, q.further), q.measured, q.left_out, q.sd).ranked
    return first.model is q.further and first.lower > 0 and all(other.beaten for other in others)


def _collect_details(
    specimen_id: str, protocols: tuple[str, ...], question: SystemQuestion, found: Comparison, verdict: str, unit: str
) -> Details:
    best = found.told.model
    parts = {
        part.name: (
            _compute_error(question.plain.unseen[part.values] - question.left_out[part.values], question.sd),
            _compute_error(best.unseen[part.values] - question.left_out[part.values], question.sd),
        )
        for part in question.parts
    }
    simulation = f"a simulation with {count_resonances(question.resonances)}"
    named = verdict in (NAMED, AMBIGUOUS)
    model, words = (
        (best, f"{plain_name(best.mechanism).lower()} ({best.variant})") if named else (question.plain, simulation)
    )
    noise = with_unit(f"{question.sd:.2g}", name_unit(unit))
    return Details(
        specimen_id=specimen_id,
        protocols=protocols,
        left_out=parts,
        films=Films(_NO_FILM, _NO_FILM),
        discrepancies=() if verdict == NONE else list_system_discrepancies(question),
        residuals=tuple(_list_residuals(question, found, verdict)),
        smallest=list_smallest(p.model for p in found.ranked),
        invisible=tuple(m for m in MECHANISMS if m not in list_asked()),
        could_not_ask=(
            f"This is no film in a rig: it is simulated with {count_resonances(question.resonances)}, and asked for what bends it",
            f"The noise of the output is taken to be {noise}: {question.noise}",
            _tell_hold(question),
            *_tell_untried(question),
            *(f"{name}: its model has no finite simulation of these records" for name in question.without),
        ),
        unexplained=(
            describe_what_stays(words, model.whole - question.measured, question.sd, unit),
            *(() if named else describe_closest(found)),
        ),
        assumed={name: (_assume_hold(question),) for name in question.names},
    )


def _tell_hold(question: SystemQuestion) -> str:
    if question.hold == BAND_LIMITED:
        return f"Between samples the input is taken to be one that {BAND_LIMITED}: as a straight or a held one it simulates the records no better"
    return f"Between samples the input {question.hold}: with that the records are simulated best"


def _assume_hold(question: SystemQuestion) -> Assumption:
    because = (
        "no key says it, and held or straight it simulates the records no better"
        if question.hold == BAND_LIMITED
        else "no key says it, and so the records are simulated best"
    )
    touches = "diagnosis of the system: delays of half an interval, resonances near half the sampling rate"
    return Assumption(BETWEEN_SAMPLES, question.hold, because, touches)


def _tell_untried(question: SystemQuestion) -> tuple[str, ...]:
    if question.resonances < MOST_RESONANCES:
        return ()
    return (
        f"More than {count_resonances(question.resonances)} were not tried: that there are more is neither shown nor excluded",
    )


def count_resonances(number: int) -> str:
    """`one resonance`, `2 resonances`."""
    return "one resonance" if number == 1 else f"{number} resonances"


def _compute_error(difference: Float, sd: float) -> float:
    return float(np.sqrt(np.mean((difference / sd) ** 2)))


def _list_residuals(question: SystemQuestion, found: Comparison, verdict: str) -> list[Residuals]:
    """Of every record the stretch about its largest output."""
    winner = found.told.model.variant if verdict in (NAMED, AMBIGUOUS) else ""
    forms = [question.plain.variant, *(e.variant for e in question.models)]
    plain, best = question.simulations[0], question.simulations[forms.index(winner)]
    shown = []
    for i, name in enumerate(question.names):
        time, measured = question.times[i], question.measured_outputs[i]
        turns = _RESONANCES * 2 * np.pi / question.angular_frequency / (time[1] - time[0])
        half = int(min(turns, _SHOWN)) // 2
        centre = int(np.argmax(np.abs(np.where(plain.compared[i], measured, 0.0))))
        part = slice(max(centre - half, 0), centre + half)
        n = measured[part].size
        shown.append(
            Residuals(
                recording_id=name,
                kind=np.full(n, OUTPUT),
                label=np.full(n, "about the largest output"),
                frequency_hz=np.full(n, np.nan),
                time_s=time[part],
                measured=measured[part],
                plain=plain.outputs[i][part],
                extended=best.outputs[i][part],
                sd=np.full(n, question.sd),
            )
        )
    return shown


_BANDS = (
    (0.0, 0.7, "below its resonance"),
    (0.7, 1.4, "about its resonance"),
    (1.4, 2.5, "about twice its resonance"),
    (2.5, 3.5, "about three times its resonance"),
    (3.5, np.inf, "above that"),
)
"""Bands over the resonance: lower and upper end, and in words."""
_WINDOWS = 30
"""Stretches of a record that are sorted by the output."""
_THIRDS = ("where the output is smallest", "where it is middling", "where it is largest")


def list_system_discrepancies(question: SystemQuestion) -> tuple[Discrepancy, ...]:
    """Bands of frequency, and thirds of a record by its output, in which the linear simulation is wrong; worst first.

    χ² of a band is that of its spectral lines, two values each; that of a third, of its samples.

    Parameters
    ----------
    question : with the plain simulation of all records
    """
    places = _test_places(question)
    wrong = (d for d in places if is_beyond_noise(d.p_value, len(places)))
    return tuple(sorted(wrong, key=lambda d: -d.chi2 / d.degrees_of_freedom))


def _test_places(question: SystemQuestion) -> list[Discrepancy]:
    """All bands and thirds of all records, whether the simulation is wrong there or not."""
    found = []
    plain = question.simulations[0]
    for name, times, y, simulated, compared in zip(
        question.names, question.times, question.measured_outputs, plain.outputs, plain.compared, strict=True
    ):
        interval = float(times[1] - times[0])
        found += _test_bands(name, interval, y[compared], simulated[compared], question)
        found += _test_levels(name, y[compared], simulated[compared], question)
    return found


def _test_bands(name: str, interval: float, y: Float, simulated: Float, question: SystemQuestion) -> list[Discrepancy]:
    resonance = question.angular_frequency / 2 / np.pi
    frequency = np.fft.rfftfreq(y.size, interval)[1:]
    measured, error = (2 * np.abs(np.fft.rfft(x)[1:]) ** 2 / y.size for x in (y, simulated - y))
    found = []
    for low, high, words in _BANDS:
        inside = (frequency >= low * resonance) & (frequency < high * resonance)
        if inside.any():
            last = min(high * resonance, float(frequency[-1]))
            where = f"{low * resonance:.3g} to {last:.3g} Hz"
            found.append(_make_discrepancy(name, where, words, measured[inside], error[inside], 2, question))
    return found


def _test_levels(name: str, y: Float, simulated: Float, question: SystemQuestion) -> list[Discrepancy]:
    windows = np.array_split(np.arange(y.size), _WINDOWS)
    order = np.argsort([float(np.std(y[w])) for w in windows])
    found = []
    for words, third in zip(_THIRDS, np.array_split(order, len(_THIRDS)), strict=True):
        chosen = np.concatenate([windows[i] for i in third])
        largest = float(np.abs(y[chosen]).max() / question.amplitude)
        where = f"outputs up to {100 * largest:.0f} % of the largest"
        found.append(_make_discrepancy(name, where, words, y[chosen] ** 2, (simulated - y)[chosen] ** 2, 1, question))
    return found


def _make_discrepancy(
    name: str, where: str, words: str, measured: Float, error: Float, each: int, question: SystemQuestion
) -> Discrepancy:
    """measured, error : (n,) squares, of `each` values"""
    square, freedom = float(error.sum()) / question.sd**2, each * error.size
    share = float(np.sqrt(error.sum() / measured.sum()))
    much = f"{100 * share:.2g} % of the output there" if share < 1 else "more than the output there"
    simulation = f"a simulation with {count_resonances(question.resonances)}"
    text = f"{words} ({where}), {simulation} is wrong by {much}"
    return Discrepancy(name, where, square, freedom, float(chi2.sf(square, freedom)), text)
