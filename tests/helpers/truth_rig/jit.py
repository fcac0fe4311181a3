"""Where compiled kernels are kept between runs: the test cache of the repository.

Imported before any kernel is decorated. A cached kernel is checked against its own file only, so every kernel's helpers
live in the kernel's file.
"""

from __future__ import annotations

from pathlib import Path

import numba

numba.config.CACHE_DIR = str(Path(__file__).resolve().parents[3] / ".pytest_cache" / "numba")

kernel = numba.njit(cache=True)
