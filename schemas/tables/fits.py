"""Models of the film: Maxwell-Wiechert models, ladders of orders, large cycles, predictions."""

from __future__ import annotations

from schemas.tables.table import (
    RECORDING_ID,
    SPECIMEN_ID,
    MadeBy,
    Table,
    real,
    text,
    truth,
    whole,
    with_bounds,
    with_sd,
)

ARMS = 8
"""Most arms of a stored relaxation model."""

_MODEL = (
    *with_sd("k0_n_per_mm", "N/mm", "main spring"),
    *(
        c
        for i in range(1, ARMS + 1)
        for c in (
            *with_sd(f"k{i}_n_per_mm", "N/mm", f"spring of arm {i}, longest relaxation first; NULL for a pure dashpot"),
            *with_sd(f"c{i}_n_s_per_mm", "N s/mm", f"damper of arm {i}"),
        )
    ),
)
_ERRORS = (
    real(
        "magnitude_error_n_per_mm", "N/mm", "mean | |k_model| - |k_measured| | over the usable lines (thesis, eq 4.14)"
    ),
    real("phase_error_deg", "deg", "mean |arg(k_model/k_measured)| over the usable lines (thesis, eq 4.14)"),
)

TABLES: tuple[Table, ...] = (
    Table(
        "model_fits",
        "Maxwell-Wiechert models, a row per specimen, loading, method, weighting and order",
        (
            SPECIMEN_ID,
            text("loading", "mechanical, electrical or joint"),
            text(
                "method", "forward (rig inside the model), corrected (divided response) or time_domain (large cycles)"
            ),
            text(
                "weighting",
                "weights of the lines: noise (by their variance), uniform (alike in N/mm) or relative (alike as a share of the"
                " magnitude); a statement about noise and a chosen order are of noise alone, and of large cycles",
            ),
            whole("model_order", "number of arms, pure dashpots included"),
            *_MODEL,
            *_ERRORS,
            *with_sd("clamp_mass_kg", "kg", "fitted clamp mass"),
            *with_sd("load_cell_stiffness_n_per_mm", "N/mm", "fitted load-cell stiffness"),
            *with_sd("load_cell_damping_n_s_per_mm", "N s/mm", "fitted load-cell damping"),
            *with_sd("force_per_voltage_squared_n_per_kv2", "N/kV^2", "fitted actuation force over voltage squared"),
            text("extension", "mechanisms in the model; empty for the plain one"),
            whole("frequency_lines", "complex values fitted"),
            real("reduced_chi2", "", "chi-squared over degrees of freedom"),
            real("bic", "", "Bayesian information criterion, -2 ln L + p ln N"),
            truth("selected", "this row's order is the chosen one for specimen, loading and method"),
            text(
                "warnings", "what limits the fit: active bounds, unresolved arms, positivity; empty when nothing does"
            ),
            real("order_p_value", "", "p of this order against the next: small means that the next is needed"),
            real("held_out_error", "SD of the noise", "root mean square error on recordings left out"),
            real("frequency_low_hz", "Hz", "lowest fitted frequency"),
            real("frequency_high_hz", "Hz", "highest fitted frequency"),
            real("positivity_chi2", "", "chi-squared per line of the best relaxation of any order"),
            real(
                "modulus_mpa",
                "MPa",
                "k0 times stretched length over stretched area; of a step of large height the secant of that step, no tangent",
            ),
            text("covariance", "covariance of the parameters at the solution, JSON {names, matrix}"),
            text("intervals", "95 % limits, JSON {parameter: {lower, upper, method}}; null: no limit on that side"),
            text("choices", "order that each rule would choose, JSON {test, bic, held_out}"),
            text("spread", "differences between the recordings, JSON {gain_sd, relative_sd, gains}; NULL for none"),
        ),
        key=("specimen_id", "loading", "method", "weighting", "extension", "model_order"),
        made_by=(
            MadeBy("specimen", where="coalesce(extension, '') = ''"),
            MadeBy("diagnosis", where="coalesce(extension, '') <> ''"),
        ),
        pages=("index", "campaign", "specimen", "control"),
    ),
    Table(
        "amplitude_fits",
        "Maxwell-Wiechert models of each amplitude by itself, beside those of their average in model_fits: a row per specimen,"
        " amplitude and order",
        (
            SPECIMEN_ID,
            real("amplitude", "", "strain amplitude of sinusoids, half of strain_pp; sweeps are not among them"),
            whole("recordings", "recordings of this amplitude"),
            whole("model_order", "number of arms, pure dashpots included"),
            *_MODEL,
            *_ERRORS,
            whole("frequency_lines", "complex values fitted"),
            real("reduced_chi2", "", "chi-squared over degrees of freedom"),
            truth("selected", "the order that is needed at this amplitude"),
            text("warnings", "what limits the fit"),
        ),
        key=("specimen_id", "amplitude", "model_order"),
        made_by=(MadeBy("specimen"),),
        pages=("specimen",),
    ),
    Table(
        "order_ladders",
        "responses over many decades: what each number of arms reaches, a row per specimen and number",
        (
            SPECIMEN_ID,
            whole("model_order", "number of arms asked for"),
            whole("resolved_arms", "arms that the data carry of them, a pure dashpot included"),
            real("relative_error", "", "root mean square of |model/measured - 1| over all lines and times"),
            real("r_squared_storage", "", "coefficient of determination of the real part; NULL without responses"),
            real("r_squared_loss", "", "coefficient of determination of the imaginary part; NULL without responses"),
            real("r_squared_relaxation", "", "coefficient of determination of relaxation in time; NULL without curves"),
            real("order_p_value", "", "p of this number against one more: small means that one more is needed"),
        ),
        key=("specimen_id", "model_order"),
        made_by=(MadeBy("specimen"),),
        pages=("specimen",),
    ),
    Table(
        "cycle_fits",
        "a large load-unload cycle as an equilibrium stress with relaxation branches,"
        " a row per recording, law and order",
        (
            RECORDING_ID,
            SPECIMEN_ID,
            text(
                "law",
                "equilibrium stress: non-affine (crosslinks and entanglements); or linear, where the length of the film is not given",
            ),
            truth(
                "law_given",
                "the recording's metadata give the law's parameters; false: fitted with the branches",
            ),
            whole("model_order", "number of branches asked for"),
            real("rmse_kpa", "kPa", "root mean square error of the nominal stress over the whole cycle"),
            real("relative_rmse", "", "the same over the largest stress"),
            real(
                "held_out_rmse_kpa",
                "kPa",
                "root mean square error on the last part of the cycle, after a fit to the rest",
            ),
            real("held_out_from_s", "s", "where that part begins, since the recording's first sample"),
            real(
                "residual_correlation", "", "correlation of neighbouring residuals: near 1 it is no noise that is left"
            ),
            whole("samples", "samples fitted"),
            truth("selected", "the order chosen for this law, by the error on the part left out"),
            text("equilibrium", "parameters of the law, moduli in kPa, JSON"),
            text("branches", "JSON list of {gamma_kpa, tau_s, eta_kpa_s} with _sd (null: not resolved), longest first"),
            text("warnings", "what limits the fit"),
        ),
        key=("recording_id", "law_given", "model_order"),
        made_by=(MadeBy("recording"),),
        pages=("specimen",),
    ),
    Table(
        "cycle_curves",
        "measured and modelled nominal stress of a large cycle, thinned for the pages",
        (
            RECORDING_ID,
            truth("law_given", "as in cycle_fits"),
            whole("model_order", "number of branches asked for"),
            real("time_s", "s", "since the recording's first sample"),
            real("stretch", "", "length over undeformed length"),
            real("measured_kpa", "kPa", "measured nominal stress"),
            real("modelled_kpa", "kPa", "modelled nominal stress"),
        ),
        key=("recording_id", "law_given", "model_order", "time_s"),
        made_by=(MadeBy("recording"),),
        pages=("specimen",),
    ),
    Table(
        "cycle_loops",
        "what each load-unload cycle, or period of a `cyclic` test, takes: work, loss, largest forces and secant stiffness, from one lowest"
        " displacement to the next; with all that the force as recorded holds, such as the damping of a load cell",
        (
            RECORDING_ID,
            SPECIMEN_ID,
            whole("cycle", "number of the cycle among those that close, from 1"),
            whole(
                "unclosed",
                "cycles of the recording before it that end elsewhere than they began, which have no loss of their own",
            ),
            real("start_s", "s", "its beginning, since the recording's first sample"),
            real("end_s", "s", "its end"),
            real(
                "displacement_low_mm",
                "mm",
                "lowest displacement; NULL where the machine gives stretch and stress, and the film's sizes are not given",
            ),
            real("displacement_high_mm", "mm", "highest displacement"),
            real(
                "stretch_low",
                "",
                "lowest stretch; NULL where the machine gives displacement and force, and the film's sizes are not given",
            ),
            real("stretch_high", "", "highest stretch"),
            real("force_low_n", "N", "lowest force as recorded"),
            real("force_high_n", "N", "highest force as recorded"),
            real("stress_low_kpa", "kPa", "lowest nominal stress; NULL as stretch_low"),
            real("stress_high_kpa", "kPa", "highest nominal stress"),
            real("loss_mj", "mJ", "area between loading and unloading; NULL of a stress without the film's sizes"),
            real(
                "loss_kj_per_m3", "kJ/m³", "the same per undeformed volume; NULL where the film's sizes are not given"
            ),
            real(
                "steady_loss_mj",
                "mJ",
                "area after the force has lost its drift from the cycle's beginning to its end: what a cycle takes once the film no"
                " longer relaxes from one to the next; NULL where the cycle begins or ends at rest",
            ),
            real("steady_loss_kj_per_m3", "kJ/m³", "the same per undeformed volume"),
            real(
                "loss_share",
                "",
                "loss_mj over the work of loading from lowest to highest displacement, force as recorded",
            ),
            real("secant_n_per_mm", "N/mm", "range of the force over range of the displacement"),
            real("secant_kpa", "kPa", "range of the stress over range of the stretch"),
            real(
                "modulus_kpa",
                "kPa",
                "slope of the straight line through the loading from 2 to 10 % elongation; NULL where it does not pass there or the stretch"
                " is not known",
            ),
        ),
        key=("recording_id", "cycle"),
        made_by=(MadeBy("recording"),),
        pages=("specimen",),
    ),
    Table(
        "pull_tests",
        "what a film tells that is pulled until it breaks; nominal stresses, in terms of ISO 37",
        (
            RECORDING_ID,
            SPECIMEN_ID,
            truth("broke", "the film broke; else strength, stretch at break and work are lower bounds"),
            *with_bounds("modulus_kpa", "kPa", "slope of the stress over the stretch at the start"),
            *with_sd("strength_kpa", "kPa", "largest stress"),
            real("stretch_at_break", "", "last stretch before the break; the largest where there was none"),
            real("stretch_at_break_upper", "", "first stretch after the break; NULL where there was none"),
            real("stress_at_100_kpa", "kPa", "stress at 100 % elongation; NULL where it was not reached"),
            real("stress_at_300_kpa", "kPa", "stress at 300 % elongation; NULL where it was not reached"),
            real("work_kpa", "kPa", "work to the break per undeformed volume, kJ/m³"),
            real("rate_per_s", "1/s", "rate of the stretch over the middle of its range"),
            text("warnings", "what limits the numbers"),
        ),
        key=("recording_id",),
        made_by=(MadeBy("recording"),),
        pages=("specimen",),
    ),
    Table(
        "pull_laws",
        "hyperelastic laws through a pull up to its break, a row per recording and law",
        (
            RECORDING_ID,
            SPECIMEN_ID,
            text("law", "neo-Hookean; Ogden, one term; non-affine (crosslinks and entanglements)"),
            text(
                "parameters", "JSON: moduli in kPa and the shape parameter, each with _sd (null: not told by the data)"
            ),
            real("young_kpa", "kPa", "slope of the law at stretch 1"),
            real("rmse_kpa", "kPa", "root mean square error of the nominal stress"),
            real("held_out_rmse_kpa", "kPa", "the same on parts of the curve that the fit has not seen"),
            truth("selected", "the law that the curve asks for, by the error on the parts left out"),
        ),
        key=("recording_id", "law"),
        made_by=(MadeBy("recording"),),
        pages=("specimen",),
    ),
    Table(
        "pull_curves",
        "measured and modelled nominal stress of a pull, thinned for the pages",
        (
            RECORDING_ID,
            text("curve", "measured, or the name of the law"),
            whole("sample", "number of the sample, from 0; of laws, of those that were fitted"),
            real("stretch", "", "length over undeformed length"),
            real("stress_kpa", "kPa", "nominal stress"),
        ),
        key=("recording_id", "curve", "sample"),
        made_by=(MadeBy("recording"),),
        pages=("specimen",),
    ),
    Table(
        "predictions",
        "the model of one loading or protocol against recordings of another",
        (
            SPECIMEN_ID,
            text("fitted_on", "what the model was fitted on"),
            text("predicted", "what it was asked to predict"),
            real("magnitude_error", "unit of the response", "mean absolute error of the magnitude"),
            real("phase_error_deg", "deg", "mean absolute error of the phase"),
            real("relative_error", "", "root mean square of |error|/|measured|"),
        ),
        key=("specimen_id", "fitted_on", "predicted"),
        made_by=(MadeBy("specimen"),),
        pages=("specimen",),
    ),
)
