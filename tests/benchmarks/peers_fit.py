"""The peers' side of `bench_fit`: run by the interpreter of `.venv-peers`, which has lmfit and pyvisco but not this package.

    python peers_fit.py lmfit|pyvisco|pyvisco_more < draws.json > results.json

Input: {"frequency": [...], "real": [[...]], "imag": [[...]], "relative": 0.01}, one row per draw. Output per draw: seconds for the
orders 1 to 3, and the third-order model (k0, k, tau). Only the standard library, numpy and the peer are imported.
"""

from __future__ import annotations

import contextlib
import io
import json
import sys
import time
import warnings

import numpy as np

STARTS = 12
ENOUGH = 1.2


def with_lmfit(f, value, sd, rng):
    """Orders 1 to 3 from 12 random starts each: logarithms of springs and times, complex weighted residual, lmfit's intervals."""
    import lmfit

    omega = 2 * np.pi * f

    def model(parameters, order):
        k = np.exp(np.clip([parameters[f"k{i}"].value for i in range(1, order + 1)], -40, 40))
        tau = np.exp([parameters[f"t{i}"].value for i in range(1, order + 1)])
        z = 1j * np.multiply.outer(omega, tau)
        return np.exp(np.clip(parameters["k0"].value, -40, 40)) + (z / (1 + z)) @ k

    def residual(parameters, order):
        r = (model(parameters, order) - value) / sd
        return np.concatenate([r.real, r.imag])

    low, high = np.log(np.abs(value).min()), np.log(np.abs(value).max())
    fast, slow = -np.log(300 * omega.max()), np.log(30 / omega.min())
    best = None
    for order in (1, 2, 3):
        best = None
        for _ in range(STARTS):
            p = lmfit.Parameters()
            p.add("k0", value=rng.uniform(low - 1, low + 1))
            for i in range(1, order + 1):
                p.add(f"k{i}", value=rng.uniform(low - 1, high + 1))
                p.add(f"t{i}", value=rng.uniform(fast + 2, slow - 2), min=fast, max=slow)
            found = lmfit.minimize(residual, p, args=(order,), method="leastsq", max_nfev=2000)
            if best is None or found.chisqr < best.chisqr:
                best = found
    p = best.params
    k0 = float(np.exp(p["k0"].value))
    return (
        k0,
        [float(np.exp(p[f"k{i}"].value)) for i in (1, 2, 3)],
        [float(np.exp(p[f"t{i}"].value)) for i in (1, 2, 3)],
    )


def pyvisco_terms(f, value, terms):
    """So many terms with pyvisco's own optimisation of moduli and times. It has no variances and no rig."""
    import pandas as pd
    from pyvisco import prony

    columns = {"f": f, "omega": 2 * np.pi * f, "E_stor": value.real, "E_loss": value.imag}
    master = pd.DataFrame(columns | {"E_stor_filt": value.real, "E_loss_filt": value.imag})
    master.modul, master.domain, master.RefT = "E", "freq", 0
    with contextlib.redirect_stdout(io.StringIO()):
        found = prony.fit_freq(prony.discretize(master, "min", terms), master, opt=True)
    table = found["df_terms"]
    share, e0 = table["alpha_i"].to_numpy(), float(found["E_0"])
    return e0 * float(1 - share.sum()), [float(x) for x in e0 * share], [float(x) for x in table["tau_i"]]


def with_pyvisco(f, value, sd, rng):
    """1, 2 and 3 terms."""
    return [pyvisco_terms(f, value, terms) for terms in (1, 2, 3)][-1]


def with_pyvisco_more(f, value, sd, rng):
    """Terms raised until the weighted residual is what noise alone would leave, at most 14."""
    for terms in range(3, 15):
        k0, k, tau = pyvisco_terms(f, value, terms)
        z = 2j * np.pi * np.multiply.outer(f, np.array(tau))
        model = k0 + (z / (1 + z)) @ np.array(k)
        if (np.abs(model - value) ** 2 / sd**2).sum() < ENOUGH * 2 * f.size:
            break
    return k0, k, tau


def main() -> None:
    warnings.simplefilter("ignore")
    peer = {"lmfit": with_lmfit, "pyvisco": with_pyvisco, "pyvisco_more": with_pyvisco_more}[sys.argv[1]]
    data = json.load(sys.stdin)
    f = np.array(data["frequency"])
    rng = np.random.default_rng(0)
    results = []
    for real, imag in zip(data["real"], data["imag"], strict=True):
        value = np.array(real) + 1j * np.array(imag)
        sd = data["relative"] * np.abs(value) / np.sqrt(2)
        started = time.perf_counter()
        k0, k, tau = peer(f, value, sd, rng)
        results.append({"seconds": time.perf_counter() - started, "k0": k0, "k": k, "tau": tau})
    json.dump(results, sys.stdout)


if __name__ == "__main__":
    main()
