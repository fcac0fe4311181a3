"""The documents and the docstrings as pages: laid out for Sphinx, built, and looked through.

.venv-site/bin/python -m tests.tools.site     into build/site; exits 1 where a link is broken or a page asks the network for anything

A document keeps the links that it has on a forge: those to modules and folders of ours lead to the page of their docstrings, those
to other files to a copy. Nothing is fetched.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

from tests.tools.docstrings import inline
from tests.tools.house import first_paragraph

ROOT = Path(__file__).resolve().parents[2]
BUILD = ROOT / "build"
PACKAGES = ("schemas", "ingest", "pipeline", "reports")
PUBLIC = (
    "dealab", "schemas", "ingest.mcap_writer", "ingest.reader_kit", "ingest.columns", "ingest.read", "ingest.canonical",
    "ingest.inspect", "ingest.validate", "pipeline.lab.notebook", "pipeline.lab.fitted", "pipeline.physics", "pipeline.transform",
    "pipeline.fit",
)  # fmt: skip
"""What somebody outside of the house imports, and the science. What a document links has a page as well."""
LAST = ("tests", ".github")
"""Folders whose documents stand behind those of the packages."""
_LINK = re.compile(r"(\]\()([^)\s]+)(\))")
_FENCE = re.compile(r"(^```.*?^```)", re.MULTILINE | re.DOTALL)


def list_documents(root: Path) -> list[str]:
    """The Markdown that is ours, from the project's top: first the README, then the packages, the tests and the rest.

    What others wrote is left out: simulators and checks that stand in folders of their own below `tests`.
    """
    found = [path.relative_to(root) for folder in (*PACKAGES, *LAST) for path in (root / folder).rglob("*.md")]
    ours = [path for path in found if len(path.parts) <= 3]
    return ["README.md", *(path.as_posix() for path in sorted(ours, key=lambda path: (_rank(path), path)))]


def _rank(path: Path) -> tuple[int, bool]:
    return (*PACKAGES, *LAST).index(path.parts[0]), path.name != "README.md"


def list_modules(root: Path) -> list[str]:
    """Modules and packages of ours, but for those whose name says that they are private."""
    files = [path for package in PACKAGES for path in (root / package).rglob("*.py")]
    names = [".".join(path.relative_to(root).with_suffix("").parts).removesuffix(".__init__") for path in files]
    return ["dealab", *sorted(name for name in names if "._" not in name)]


def place(document: str) -> str:
    """Where a document stands on the site: the README is its first page, and no folder is hidden."""
    return "index.md" if document == "README.md" else document.removeprefix(".github/")


@dataclass
class Layout:
    """What Sphinx reads, as it is put together in a folder.

    Parameters
    ----------
    root, folder : the project's top, and where the pages' sources are laid
    documents, modules : what there is
    paged : modules that get a page: the public ones, what a document links, and the packages that these are in
    copied : files that a document links or shows
    listed : folders that a document links and that have no page of their own: each gets a list of its files
    """

    root: Path
    folder: Path
    documents: list[str]
    modules: list[str]
    paged: set[str] = field(default_factory=set)
    copied: set[str] = field(default_factory=set)
    listed: set[str] = field(default_factory=set)

    def write(self) -> None:
        """Lays out all pages. Raises `SystemExit` for a link that leads nowhere."""
        for name in self.modules:
            if any(name == public or name.startswith(f"{public}.") for public in PUBLIC):
                self._give_page(name)
        for document in self.documents:
            text = (self.root / document).read_text(encoding="utf-8")
            self._put(
                place(document), self.rewrite(document, text) + (self._contents() if document == "README.md" else "")
            )
        for name in self.listed:
            files = sorted(path.name for path in (self.root / name).iterdir() if path.is_file())
            self.copied |= {f"{name}/{file}" for file in files}
            lines = "\n".join(f"- [{file}]({file})" for file in files)
            self._put(f"{name}/index.md", f"---\norphan: true\n---\n\n# {name}\n\n{lines}\n")
        for name in self.copied:
            target = self.folder / name
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(self.root / name, target)
        for module in self.paged:
            self._put(f"api/{module}.rst", self._page(module))
        self._put("api/index.md", self._overview())

    def rewrite(self, document: str, text: str) -> str:
        """The text of a document with its links as they lead on the site; what stands between fences is left alone."""
        parts = _FENCE.split(text)
        for i in range(0, len(parts), 2):
            parts[i] = _LINK.sub(lambda found: f"](<{self._aim(document, found.group(2))}>)", parts[i])
        return "".join(parts)

    def _aim(self, document: str, target: str) -> str:
        file, hash_, anchor = target.partition("#")
        if "://" in target or not file:
            return target
        found = os.path.normpath(Path(document).parent / file)
        path = self.root / found
        module = ".".join(Path(found).with_suffix("").parts)
        if not path.exists():
            raise SystemExit(f"{document}: the link {target} leads nowhere")
        if found in self.documents:
            aim = place(found)
        elif module in self.modules:
            self._give_page(module)
            aim = f"api/{module}.rst"
        elif path.is_dir():
            self.listed.add(found)
            aim = f"{found}/index.md"
        else:
            self.copied.add(found)
            aim = found
        return os.path.relpath(aim, Path(place(document)).parent) + hash_ + anchor

    def _contents(self) -> str:
        """The order of all pages, at the end of the first."""
        names = [place(document).removesuffix(".md") for document in self.documents[1:]]
        own = [name for name in names if name.endswith("/README") or not name.startswith("tests/")]
        lines = "\n".join([*own, "api/index"])
        rest = "\n".join(name for name in names if name not in own)
        return f"\n```{{toctree}}\n:hidden:\n\n{lines}\n```\n\n```{{toctree}}\n:hidden:\n:caption: Results\n\n{rest}\n```\n"

    def _give_page(self, module: str) -> None:
        """A page for a module and for all packages that it is in."""
        parts = module.split(".")
        self.paged |= {".".join(parts[:n]) for n in range(1, len(parts) + 1)}

    def _page(self, module: str) -> str:
        """The page of a module: its docstrings, and what each module in it is for."""
        title = f"``{module}``"
        lines = [title, "=" * len(title), "", f".. automodule:: {module}", "   :members:", ""]
        below = [name for name in self.modules if name.rpartition(".")[0] == module]
        lines += [".. rubric:: Modules in it", ""] if below else []
        for name in below:
            short = name.rpartition(".")[2]
            link = f":doc:`{short} <{name}>`" if name in self.paged else f"``{short}``"
            lines += [link, f"    {inline(self._says(name))}", ""]
        paged = [f"   {name.rpartition('.')[2]} <{name}>" for name in below if name in self.paged]
        return "\n".join([*lines, *([".. toctree::", "   :hidden:", "", *paged, ""] if paged else [])])

    def _overview(self) -> str:
        tops = [name for name in self.modules if "." not in name]
        rows = "\n".join(f"- [`{name}`]({name}.rst): {self._says(name)}" for name in tops)
        contents = "\n".join(tops)
        about = "What their docstrings say: of the modules that others import, of the science, and of those that a document names."
        return f"# Modules\n\n{about}\n\n{rows}\n\n```{{toctree}}\n:hidden:\n\n{contents}\n```\n"

    def _says(self, module: str) -> str:
        path = self.root.joinpath(*module.split("."))
        return first_paragraph(path / "__init__.py" if path.is_dir() else path.with_suffix(".py"))

    def _put(self, name: str, text: str) -> None:
        path = self.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")


class _Page(HTMLParser):
    """What a page has and what it asks for."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.anchors: set[str] = set()
        self.links: set[str] = set()
        self.loaded: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if name in ("id", "name") and value:
                self.anchors.add(value)
            elif value and tag == "a" and name == "href":
                self.links.add(value)
            elif (
                value
                and not value.startswith(("#", "data:"))
                and name in ("src", "href", "srcset", "action", "data", "poster")
            ):
                self.loaded.add(value)


def look_through(site: Path) -> Iterator[str]:
    """What is wrong with built pages: links and files that lead nowhere, and whatever they load that is not beside them."""
    pages = {path: _Page(path.read_text(encoding="utf-8")) for path in site.rglob("*.html")}
    for path, page in sorted(pages.items()):
        name = path.relative_to(site)
        for target in sorted(page.loaded):
            if _is_remote(target):
                yield f"{name} loads {target} from the network"
            elif not _find(path, target).is_file():
                yield f"{name} loads {target}, which is not there"
        for target in sorted(page.links):
            if _is_remote(target):
                continue  # a link that the text has: nothing is loaded until a reader follows it
            file, _, anchor = target.partition("#")
            found = _find(path, file) if file else path
            if not found.is_file():
                yield f"{name} links {target}, which is not there"
            elif anchor and found in pages and unquote(anchor) not in pages[found].anchors:
                yield f"{name} links {target}, where there is no such place"
    for path in sorted(site.rglob("*.css")):
        for target in re.findall(
            r"(?:url\(|@import(?!\s*url\())\s*['\"]?([^'\")\s;]+)", path.read_text(encoding="utf-8")
        ):
            if _is_remote(target) and not target.startswith("data:"):
                yield f"{path.relative_to(site)} loads {target} from the network"


def _is_remote(target: str) -> bool:
    return bool(re.match(r"\w+:|//", target))


def _find(page: Path, target: str) -> Path:
    return Path(os.path.normpath(page.parent / unquote(target.partition("#")[0].partition("?")[0])))


def main() -> int:
    source, site = BUILD / "site-source", BUILD / "site"
    for folder in (source, site):
        shutil.rmtree(folder, ignore_errors=True)
    Layout(ROOT, source, list_documents(ROOT), list_modules(ROOT)).write()
    options = [
        "--fail-on-warning",
        "--keep-going",
        "--quiet",
        "--jobs",
        "2",
        "--doctree-dir",
        str(BUILD / "site-doctrees"),
    ]
    words = [
        sys.executable,
        "-m",
        "sphinx",
        "--conf-dir",
        str(ROOT / ".github" / "site"),
        *options,
        str(source),
        str(site),
    ]
    status = subprocess.run(words, cwd=ROOT, check=False).returncode
    if status:
        return status
    faults = list(look_through(site))
    for fault in faults:
        print(fault, file=sys.stderr)
    pages = sum(1 for _ in site.rglob("*.html"))
    print(f"{pages} pages, {len(faults)} faults: {site.relative_to(ROOT)}/index.html")
    return int(bool(faults))


if __name__ == "__main__":
    sys.exit(main())
