"""The truth rig: sessions of recordings with effects hidden in them, made by physics of its own.

It shares no code with the pipeline, only the types of a recording. Everything happens in the time domain, and every
effect has a form that the pipeline's extension equations do not have: what finds it here can find it in a laboratory.

    session = full_session(seed=7, effects=["clamp_slip"])             30 recordings, typical severity
    session = compact_session(7, [("leakage", 0.1), hide("slack", 0.8, residual=0.1)], material="silicone")
    session.recordings                 as the ingest would yield them, in time order
    session.noise_free                 the same before noise and converter: to score predictions against
    session.truth.specimen             film (k0, k, tau; .stiffness(f), .relaxation(t)), rig, permittivity, geometry
    session.truth.equivalent           {"leakage": {"droop": 0.1}, …}: what the contract's severity keys would say
    session.make_recording("tap")      the recording that a design would give after the session
    session.extended(design, …)        the session with them

The plain rig is exactly the linear model: relaxing film with a preload, clamp and load cell, squared voltage, uniform
film whose sensing region follows the tension through the film's compliance, amplifier without lag. The specimen, the
pauses and the noise depend on the seed alone, not on the effects. Rig constants lie within two standard deviations of
what the rig file says, permittivity likewise. Every recording starts with the film at rest; damage, exposure, slip,
temperature, wrinkles, slow arms and the load cell's memory go on from recording to recording.

Severity. `Effect.severity` is in the unit of the kind's `key` (see `effects.KINDS`, with typical and strong values); 0 is
the plain rig, exactly. Onset types (`slack`, `wrinkling`, `clamp_slip`, `sensor_saturation`): (largest load of the plain
session)/(onset) − 1. `passive_strip`: 1 − ratio. `strain_stiffening`: rise of the tangent at the largest extension of the
session. `amplitude_softening`, `cyclic_softening`: loss at the largest amplitude and extension. `thermal_softening`: per kelvin, for a
warming of `rise_k`. `Kind.exact` says where the severity defines the extension's parameter; elsewhere `equivalent` is the nearest
value and the forms differ by tens of per cent. Effects scale the film's answer to motion; the preload itself changes under `slack` only.

Designs of recordings: a dict with `protocol` (chirp, sphs, cyclic, step, cycle, tap, weight), for step also `loading`
(electrical or mechanical), and any of

    all         rest_before_s (60; time since the last recording), extra_clamp_mass_kg (0; on the clamp and in the
                metadata), pre_extension_mm (0; film held that much longer, relaxed, displacement recorded from there),
                sample_rate_hz, temperature (False; record it), warmer_k (none; room warmer by that, temperature recorded)
    chirp       strain_pp at low frequency (0.02), frequency_start_hz (1), frequency_stop_hz (100), sweep (log), sweep_s (6),
                rest_s (2), repeats (2), knee_hz (30; above it the amplitude falls as 1/f)
    sphs        drive_kv (7; peak), frequency_start_hz (0.5), frequency_stop_hz (100), period_s (2), periods (7),
                lines (odd; full, random_odd), lines_seed, rest_s (0.5), polarity (1; −1), leakage_current (False)
    cyclic      strain_pp (0.04; from 0 to it), frequency_hz (1), cycles (10), rest_s (1)
    step        electrical: drive_kv (7), on_s (5), off_s (5), cycles (3), rest_s (1), edge_s (0.02), polarity (1),
                leakage_current (False)
                mechanical: strain_pp (0.05; the height), ramp_s (0.2), hold_s (40), rest_s (8), after_s (6)
    cycle       strain_pp (0.1; the peak), rate_per_s (0.05), rest_s (1)
    tap         taps (3), tap_n (1), tap_every_s (3); no film
    weight      masses_kg ((0.02, 0.05, 0.1)), plateau_s (5); no film

An unknown protocol, loading or key is a `ValueError`; a key that is None counts as absent.
"""

from tests.helpers.truth_rig.effects import KINDS, MECHANISMS, UNLISTED, Effect, Kind, hide, random_effect
from tests.helpers.truth_rig.material import MATERIALS, Film, Rig, Specimen, random_specimen
from tests.helpers.truth_rig.session import (
    Session,
    Truth,
    compact_designs,
    compact_session,
    full_designs,
    full_session,
    make_session,
)

__all__ = [
    "KINDS",
    "MATERIALS",
    "MECHANISMS",
    "UNLISTED",
    "Effect",
    "Film",
    "Kind",
    "Rig",
    "Session",
    "Specimen",
    "Truth",
    "compact_designs",
    "compact_session",
    "full_designs",
    "full_session",
    "hide",
    "make_session",
    "random_effect",
    "random_specimen",
]
