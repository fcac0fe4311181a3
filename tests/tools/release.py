"""What is given away: wheel and sdist are built, held against the project's files, installed alone and tried.

python -m tests.tools.release                         with the Python that runs it
python -m tests.tools.release python3.12 python3.13   with each of these

One line says what each check found, `ok` or `PROBLEM`; wheel and sdist are left in `dist/`. Imports nothing of dealab, for it runs
in the environment that builds.
"""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from collections.abc import Callable, Iterator
from hashlib import sha256
from pathlib import Path

from tests.tools import first_file, recipe

ROOT = Path(__file__).resolve().parents[2]
DIST = ROOT / "dist"
PACKAGES = ("schemas", "ingest", "pipeline", "reports")
READ = (".ipynb", ".md", ".png")
"""Endings of the files in our packages that people read and no program does."""
RIG = "ingest/README.md"
"""The document that says how a rig's computer gets the writer alone."""
AFTER = (
    "dealab status --lab first-lab",
    "dealab report --lab first-lab",
    "dealab figure P-07 response --out p07.pdf --lab first-lab",
    "dealab export --crate p07.zip --lab first-lab",
    "dealab verify p07.zip",
    "dealab validate --schema mapping",
    "dealab doctor --lab first-lab",
)
"""Tried after the first five minutes: what needs the files beside the code, such as templates, styles and schemas."""

FITS = "fits the contract"
"""What `dealab inspect` says of a recording without fault."""
BROUGHT = ("pip", "setuptools")
"""What an environment has by itself."""

Said = Iterator[tuple[bool, str]]
"""What checks found, one by one: whether it is right, and a line that says what."""


def list_files(root: Path) -> frozenset[str]:
    """Files of the project that git knows, from its top. Raises `subprocess.CalledProcessError` where there is no git."""
    words = ["git", "-c", f"safe.directory={root}", "ls-files", "-z"]  # also where the checkout is another user's
    done = subprocess.run(words, cwd=root, capture_output=True, text=True, check=True)
    return frozenset(filter(None, done.stdout.split("\0")))


def runs(name: str) -> bool:
    """Whether a file of the project belongs into the wheel: those of our packages, but for what is only read, and the door."""
    return name == "dealab.py" or (name.partition("/")[0] in PACKAGES and not name.endswith(READ))


def list_wheel(wheel: Path) -> frozenset[str]:
    """Files in a wheel, without those that say what it is."""
    return frozenset(name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name)


def list_sdist(sdist: Path) -> frozenset[str]:
    """Files in an sdist from the project's top, without the one that says what it is."""
    with tarfile.open(sdist) as archive:
        names = {member.name.partition("/")[2] for member in archive if member.isfile()}
    return frozenset(names - {"PKG-INFO"})


def compare(what: str, found: frozenset[str], wanted: frozenset[str]) -> tuple[bool, str]:
    """Whether something holds the files that it should, and what is missing or too much."""
    faults = [
        f"{len(names)} {state}: {', '.join(sorted(names)[:5])}{' …' if len(names) > 5 else ''}"
        for state, names in (("missing", wanted - found), ("too much", found - wanted))
        if names
    ]
    return not faults, f"{what}: {'; '.join(faults) or f'{len(found)} files, all that it should have and nothing else'}"


def build(folder: Path, *options: str) -> list[Path]:
    """Builds into a folder, with what is installed and no network. Raises `SystemExit` with what was said where that fails."""
    words = [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(folder), *options, str(ROOT)]
    _do(words, ROOT)
    return sorted(folder.iterdir())


def check_contents(folder: Path) -> Said:
    """Wheel and sdist against git's files, and against each other; leaves both in `dist/`."""
    files = list_files(ROOT)
    (straight,) = build(folder / "straight", "--wheel")
    sdist, wheel = sorted(build(folder / "through", "--sdist", "--wheel"), key=lambda path: path.suffix)
    yield compare(f"wheel {straight.name}", list_wheel(straight), frozenset(filter(runs, files)))
    yield compare(f"sdist {sdist.name}", list_sdist(sdist), files)
    through = folder / "unpacked"
    with tarfile.open(sdist) as archive:
        archive.extractall(through, filter="data")
    (again,) = through.iterdir()
    _do(
        [sys.executable, "-m", "build", "--no-isolation", "--wheel", "--outdir", str(folder / "again"), str(again)],
        again,
    )
    (second,) = (folder / "again").iterdir()
    same = straight.read_bytes() == wheel.read_bytes() == second.read_bytes()
    yield same, f"sdist builds {'the same wheel, byte by byte' if same else 'another wheel'}"
    DIST.mkdir(exist_ok=True)
    for path in (sdist, straight):
        (DIST / path.name).write_bytes(path.read_bytes())
        digest = sha256(path.read_bytes()).hexdigest()
        yield True, f"dist/{path.name}: {path.stat().st_size / 1e6:.1f} MB, sha256 {digest}"


def pins(version: str) -> list[str]:
    """What pip installs the pinned libraries by: with hashes where that Python has them, as in the Makefile."""
    hashed = ROOT / "requirements" / f"runtime-{version}.txt"
    return (
        ["--require-hashes", "--requirement", str(hashed)]
        if hashed.is_file()
        else ["--requirement", str(ROOT / "requirements.txt")]
    )


def apart(environment: Path) -> dict[str, str]:
    """Variables for programs of an environment: its commands first, and no way to the checkout."""
    kept = {
        name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "VIRTUAL_ENV", "PYTHONHOME")
    }
    return kept | {"PATH": f"{environment / 'bin'}{os.pathsep}{os.environ['PATH']}"}


def check_installed(python: str, wheel: Path, folder: Path) -> Said:
    """The wheel in an environment with the pinned libraries alone: the README's first five minutes, and what follows them."""
    version = _ask(python, "import sys; print('%d.%d' % sys.version_info[:2])")
    environment = folder / "full"
    _do([python, "-m", "venv", str(environment)], folder)
    own = str(environment / "bin" / "python")
    pip = [own, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    _do([*pip, "--only-binary", ":all:", *pins(version)], folder)
    _do([*pip, "--no-deps", str(wheel)], folder)
    _do([own, "-m", "pip", "check"], folder)
    hashes = "with hashes" if "--require-hashes" in pins(version) else "without hashes: none for this Python"
    yield True, f"Python {_ask(own, 'import platform; print(platform.python_version())')}: installs, pinned {hashes}"
    place = folder / "elsewhere"
    place.mkdir()
    where = Path(_ask(own, "import dealab; print(dealab.__file__)"))
    yield environment.resolve() in where.resolve().parents, f"runs from {where.relative_to(folder)}"
    readme = ROOT / "README.md"
    said = first_file.show(first_file.follow(readme, place, apart(environment)))
    yield said in readme.read_text(encoding="utf-8"), "the README's first five minutes say what it shows"
    for line in AFTER:
        first_file.run(line, place, apart(environment))
    pages = len(list((place / "first-lab" / "reports").rglob("*.html")))
    yield pages > 1, f"and then: {', '.join(line.split()[1] for line in AFTER)}; {pages} pages"
    yield from check_writer(wheel, environment, place)
    yield from check_recipe(python, version, place / "first", folder / "container")


def check_writer(wheel: Path, full: Path, place: Path) -> Said:
    """The writer alone, installed as the document tells, writes the README's example; the whole dealab reads it back."""
    (place / wheel.name).write_bytes(wheel.read_bytes())
    for line in commands_of_the_rig():
        first_file.run(line, place, apart(full) | {"PIP_CONSTRAINT": str(ROOT / "requirements.txt"), "PIP_QUIET": "1"})
    rig = place / "rig"
    (place / "write.py").write_text(writer_example(), encoding="utf-8")
    _do([str(rig / "bin" / "python"), "write.py"], place)
    done = first_file.run("dealab inspect P-12_chirp-1.mcap", place, apart(full))
    names = sorted(path.name.partition("-")[0] for path in rig.glob("lib/python*/site-packages/*.dist-info"))
    yield (
        done.said.startswith(f"P-12_chirp-1.mcap: {FITS}\n"),
        (
            f"the writer alone ({', '.join(name for name in names if name not in BROUGHT)}) writes what the whole reads; "
            f"{_measure(rig):.0f} MB installed, the whole {_measure(full):.0f} MB"
        ),
    )


def check_recipe(python: str, version: str, raw: Path, folder: Path) -> Said:
    """What the container recipe builds, built in a folder: a night as the container runs it, and whether it calls itself healthy."""
    environment = recipe.build_in(folder, python, version)
    lab = str(folder / "lab")
    variables = apart(environment) | {"NOW": "1", "RAW": str(raw), "LAB": lab}
    night = first_file.run(f"{recipe.PACKAGING / 'every-night'} --jobs 1", folder, variables)
    steps = recipe.list_steps(recipe.CONTAINERFILE.read_text(encoding="utf-8"))
    asked = shlex.join(word.replace("/lab", lab) for word in recipe.healthcheck(steps))
    health = first_file.run(asked, folder, variables)
    yield (
        "1 taken in" in night.said and "P-07" in health.said,
        ("the container recipe's steps, done in a folder: a night takes the file in, and the health check passes"),
    )


def commands_of_the_rig() -> list[str]:
    """The commands that install the writer alone, as the document shows them."""
    text = (ROOT / RIG).read_text(encoding="utf-8")
    (block,) = (block for block in re.findall(r"```sh\n(.*?)```", text, re.DOTALL) if "--no-deps" in block)
    return block.splitlines()


def writer_example() -> str:
    """The example of the README that writes a recording."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    return next(block for block in re.findall(r"```python\n(.*?)```", text, re.DOTALL) if "RecordingWriter" in block)


def _measure(environment: Path) -> float:
    """Size of what was installed into an environment, in MB."""
    (packages,) = environment.glob("lib/python*/site-packages")
    own = (*BROUGHT, "pkg_resources", "_distutils_hack")
    files = (path for path in packages.rglob("*") if path.relative_to(packages).parts[0].partition("-")[0] not in own)
    return sum(path.stat().st_size for path in files if path.is_file()) / 1e6


def _ask(python: str, code: str) -> str:
    return subprocess.run([python, "-c", code], cwd="/", capture_output=True, text=True, check=True).stdout.strip()


def _do(words: list[str], folder: Path) -> None:
    done = subprocess.run(words, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{' '.join(words)}: status {done.returncode}\n{done.stdout}")


def main(pythons: list[str]) -> int:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name).resolve()
        right = _tell(check_contents, folder)
        (wheel,) = (folder / "straight").iterdir()
        for number, python in enumerate(pythons or [sys.executable]):
            own = folder / str(number)
            own.mkdir()
            right &= _tell(check_installed, python, wheel, own)
    return int(not right)


def _tell(check: Callable[..., Said], *words: object) -> bool:
    """Prints what a check finds, as it comes; returns whether all is right."""
    right = True
    for is_right, line in check(*words):
        print(f"{'ok' if is_right else 'PROBLEM':8} {line}", flush=True)
        right &= is_right
    return right


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
