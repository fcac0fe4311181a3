"""One reader under atheris, which looks for inputs that take new ways through it. Started by `tests.bad_files.fuzz`.

    .venv-fuzz/bin/python -m tests.bad_files.guided READER [libFuzzer's options]

Guided search keeps what reaches new branches, so no input is a mutation of one known seed: the promise that is checked
is that of all files, not that of sealed ones. Of a parser that works in a child process (`ingest.apart`) it sees the ways
before and after, not those within.
"""

from __future__ import annotations

import importlib
import pkgutil
import sys
import tempfile
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["ingest", "schemas"]):
    import ingest

    for module in pkgutil.iter_modules(ingest.__path__):  # `ingest.read` imports readers when they are needed: too late
        importlib.import_module(f"ingest.{module.name}")
    from tests.bad_files.promises import Truth, examined
    from tests.bad_files.seeds import READERS, Seed


def main() -> None:
    reader = sys.argv.pop(1)
    seeds = READERS[reader]()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        corpus = folder / "corpus"
        corpus.mkdir()
        for number, seed in enumerate(seeds):
            (corpus / f"{number:02d}").write_bytes(bytes([number]) + seed.content)

        def test(data: bytes) -> None:
            """The first byte chooses the mapping, the rest is the file."""
            if not data:
                return
            seed = seeds[data[0] % len(seeds)]
            path = folder / f"file{seed.suffix}"
            path.write_bytes(data[1:])
            unsealed = Seed(seed.reader, seed.name, seed.suffix, b"", seed.mapping)
            verdict = examined(unsealed, Truth({}, None, object), path)
            if verdict.broken is not None:
                raise AssertionError(verdict.broken)

        atheris.Setup([sys.argv[0], "-max_len=20000", "-len_control=0", *sys.argv[1:], str(corpus)], test)
        atheris.Fuzz()


if __name__ == "__main__":
    main()
