"""Write README.md from the tables of the code."""

from pathlib import Path

from .forms import MECHANISMS, UNLISTED
from .rig import FAULTS

HEAD = """# Rig `auk`: silicone-and-acrylic laboratory with an electrodynamic shaker

    python -m auk.rig SEED KIND FOLDER      (from tests/foreign; KIND: clean, single, unlisted, pair, fault)

## Equations
States x', v', branch forces f_i, strips u_j, clamp slip u_s, two auxiliaries; fixed-step RK4 (numba, h = 1/4000 s or finer by the
recording's rate), inputs x0, its velocity and F_A analytic on the half-step grid:

    e = x0 - x' - sum(u_j) - u_s        T = g(e, memory) (k0 e + sum f_i) - F_A
    f_i' = k_i e' - f_i/tau_i           u_j' = (T - kappa_j u_j)/eta_j      u_s' = slip law(T)
    M v'' = T - kL x' - cL v' - extra   F = kL x' + mean pull (neo-Hookean pre-load)     F_A = gain V^2

Voltage edges are ramps that the recording's rate resolves. Amplifier lag 0.04 to 0.12 ms, before the monitor. Drive effects act after the
monitor, except where the truth has `seen_by_monitor`. Drives are scaled so that |T| stays below 0.75 of the pre-load and |F| below 2.5 N.

Strength: traces at 2 kHz thinned to 500 Hz, weighted to all samples; projected: k0, ki, taui, M, kL (priors), zeta (50 %), actuation gain
(10 %), an offset per recording. The derivatives are finite differences of the plain transfer functions (FFT), not of the time stepping.
Form distance: sqrt(1 - cos^2) of the projected traces against two settings of the textbook form, scale free: an upper bound of the
distance to the best fit, cut at 0.5; computed per session and stored in the truth. It is a fixed 0.5 for unlisted effects.

## Forms (the first of each list is the one used as the textbook reference)
"""


def main() -> None:
    """Write the file."""
    lines = [HEAD]
    for k, m in MECHANISMS.items():
        lines.append(f"- `{k}` ({m.stage}): " + ", ".join(m.forms))
    lines += ["", "## Unlisted", ""]
    lines += [f"- `{k}` ({m.stage}; {', '.join(m.depends)})" for k, m in UNLISTED.items()]
    lines += ["", "## Faults", "", ", ".join(FAULTS), "", (Path(__file__).parent / "CHECKED.md").read_text()]
    (Path(__file__).parent / "README.md").write_text("\n".join(lines))


if __name__ == "__main__":
    main()
