"""What a crate says of itself: RO-Crate 1.1 as JSON-LD, and the fields that DataCite asks for."""

from __future__ import annotations

import json
import mimetypes
import posixpath
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from schemas.errors import UsageError

METADATA, DATACITE, MANIFEST, PROVENANCE = (
    "ro-crate-metadata.json",
    "datacite.json",
    "manifest-sha256.txt",
    "provenance.json",
)
_CONTEXT = ["https://w3id.org/ro/crate/1.1/context", {"sha256": "https://schema.org/sha256"}]
_PROFILE = "https://w3id.org/ro/crate/1.1"
_LICENCE = "https://choosealicense.com/no-permission/"
_TYPES = {
    ".csv": "text/csv",
    ".json": "application/json",
    ".svg": "image/svg+xml",
    ".html": "text/html",
    ".txt": "text/plain",
}
_ASKED = ("creators", "title", "publisher", "publication_year", "license")
"""What DataCite or RO-Crate ask for and only a person knows."""


@dataclass(frozen=True)
class About:
    """What a person says of the data set; empty where nobody has.

    Parameters
    ----------
    creators : each with `name`, and `orcid`, `affiliation` and `affiliation_url` where known
    license : its address, such as https://creativecommons.org/licenses/by/4.0/
    """

    title: str = ""
    description: str = ""
    creators: tuple[Mapping[str, str], ...] = ()
    publisher: str = ""
    publisher_url: str = ""
    publication_year: int | None = None
    license: str = ""
    doi: str = ""
    keywords: tuple[str, ...] = field(default=())

    @property
    def missing(self) -> list[str]:
        """What is asked for and not stated."""
        return [name for name in _ASKED if not getattr(self, name)]


def read_about(path: Path | None) -> About:
    """Title, creators, publisher, licence from a TOML file; `UsageError` where it is none or has other keys."""
    if path is None:
        return About()
    import tomllib

    try:
        stated = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise UsageError(f"{path}: {error}", expected="a TOML file") from None
    known = About.__dataclass_fields__
    for key, value in stated.items():
        if key not in known:
            raise UsageError(f'{path}: "{key[:40]}" is no key', expected=", ".join(known))
        wanted = list if key in ("creators", "keywords") else int if key == "publication_year" else str
        if not isinstance(value, wanted):
            raise UsageError(f"{path}: {key}", expected={list: "a list", int: "a year", str: "text"}[wanted])
    for creator in stated.get("creators", ()):
        if not isinstance(creator, dict) or not isinstance(creator.get("name"), str):
            raise UsageError(f"{path}: creators", expected='tables with a name: [[creators]] name = "…"')
    given: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in stated.items()}
    return About(**given)


def write_datacite(about: About, title: str, year: int | None, version: str) -> dict[str, Any]:
    """DataCite's metadata (kernel 4.4) with what is stated; what is not stated is left out."""
    creators = [
        {
            "name": c["name"],
            "nameType": "Personal",
            **(
                {"nameIdentifiers": [{"nameIdentifier": c["orcid"], "nameIdentifierScheme": "ORCID"}]}
                if c.get("orcid")
                else {}
            ),
            **({"affiliation": [{"name": c["affiliation"]}]} if c.get("affiliation") else {}),
        }
        for c in about.creators
    ]
    stated: dict[str, Any] = {
        "schemaVersion": "http://datacite.org/schema/kernel-4",
        "types": {"resourceTypeGeneral": "Dataset", "resourceType": "laboratory results"},
        "titles": [{"title": about.title or title}],
        "creators": creators,
        "publisher": about.publisher,
        "publicationYear": about.publication_year or year,
        "version": version,
        "descriptions": [{"description": about.description, "descriptionType": "Abstract"}]
        if about.description
        else [],
        "subjects": [{"subject": k} for k in about.keywords],
        "rightsList": [{"rightsUri": about.license}] if about.license else [],
        "identifiers": [{"identifier": about.doi, "identifierType": "DOI"}] if about.doi else [],
    }
    return {k: v for k, v in stated.items() if v}


def write_metadata(
    about: About,
    title: str,
    run: Mapping[str, Any],
    recordings: Sequence[Mapping[str, Any]],
    digests: Mapping[str, tuple[str, int]],
) -> dict[str, Any]:
    """The crate's JSON-LD.

    Parameters
    ----------
    run : the last night: `software_version`, `started_at`, `finished_at`
    recordings : what the results rest on, with SHA-256; they are named, not carried
    digests : SHA-256 and size of each file of the crate but this one
    """
    urls = {c["affiliation"]: c.get("affiliation_url", "") for c in about.creators if c.get("affiliation")}
    places = {name: url or f"#affiliation-{i}" for i, (name, url) in enumerate(urls.items(), 1)}
    people: list[dict[str, Any]] = [
        {
            "@id": c.get("orcid") or f"#creator-{i}",
            "@type": "Person",
            "name": c["name"],
            **({"affiliation": {"@id": places[c["affiliation"]]}} if c.get("affiliation") else {}),
        }
        for i, c in enumerate(about.creators, 1)
    ]
    licence, publisher = about.license or _LICENCE, about.publisher_url or "#publisher"
    root: dict[str, Any] = {
        "@id": "./",
        "@type": "Dataset",
        "name": about.title or title,
        "description": about.description
        or f"Results of {len(recordings)} recordings of dielectric elastomer actuators: tables, "
        "models, figures and report, made by dealab.",
        "datePublished": str(run["finished_at"])[:10] or "unknown",
        "license": {"@id": licence},
        "hasPart": _unpack([{"@id": name} for name in sorted(digests)]),
        "mentions": {"@id": "#night"},
        **({"author": _unpack([{"@id": p["@id"]} for p in people])} if people else {}),
        **({"publisher": {"@id": publisher}} if about.publisher else {}),
        **({"identifier": about.doi} if about.doi else {}),
        **({"keywords": ", ".join(about.keywords)} if about.keywords else {}),
    }
    graph: list[dict[str, Any]] = [
        {"@id": METADATA, "@type": "CreativeWork", "conformsTo": {"@id": _PROFILE}, "about": {"@id": "./"}},
        root,
        {
            "@id": licence,
            "@type": "CreativeWork",
            "name": "Licence" if about.license else "No licence is stated",
            "description": "as stated by the authors" if about.license else "nobody may copy it without asking",
        },
        *people,
        *(_organise(places[name], name, url) for name, url in urls.items() if places[name] != publisher),
        *([_organise(publisher, about.publisher, about.publisher_url)] if about.publisher else []),
        {
            "@id": "#dealab",
            "@type": "SoftwareApplication",
            "name": "dealab",
            "version": run["software_version"],
            "softwareVersion": run["software_version"],
        },
        {
            "@id": "#night",
            "@type": "CreateAction",
            "name": f"night {run['run_id']}",
            "instrument": {"@id": "#dealab"},
            "startTime": str(run["started_at"]),
            "endTime": str(run["finished_at"]),
            "object": _unpack([{"@id": f"#recording-{r['source_sha256']}"} for r in _once(recordings)]),
            "result": [{"@id": name} for name in sorted(digests)],
        },
    ]
    for r in _once(recordings):
        graph.append(
            {
                "@id": f"#recording-{r['source_sha256']}",
                "@type": "CreativeWork",
                "name": r["recording_id"],
                "alternateName": posixpath.basename(str(r["source_path"])),
                "sha256": r["source_sha256"],
                "dateCreated": str(r["started_at"]),
                "about": r["specimen_id"] or "",
            }
        )
    for name, (digest, size) in sorted(digests.items()):
        ending = posixpath.splitext(name)[1]
        form = _TYPES.get(ending) or mimetypes.guess_type(name)[0] or "application/octet-stream"
        graph.append(
            {
                "@id": name,
                "@type": "File",
                "name": posixpath.basename(name),
                "encodingFormat": form,
                "contentSize": str(size),
                "sha256": digest,
            }
        )
    return {"@context": _CONTEXT, "@graph": graph}


def _organise(identity: str, name: str, url: str) -> dict[str, str]:
    """An organization as an entity."""
    known = {"@id": identity, "@type": "Organization", "name": name}
    return known | {"url": url} if url else known


def _unpack(values: list[dict[str, str]]) -> list[dict[str, str]] | dict[str, str]:
    """A list of one as that one, as RO-Crate wants it."""
    return values[0] if len(values) == 1 else values


def _once(recordings: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Recordings of one content once: a table of many lives is one file."""
    return list({r["source_sha256"]: r for r in recordings if r["source_sha256"]}.values())


def dump(value: Mapping[str, Any]) -> bytes:
    """JSON in one fixed form."""
    return (json.dumps(value, indent=1, ensure_ascii=False) + "\n").encode()
