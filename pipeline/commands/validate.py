"""`dealab validate`: whether files keep to the published formats, and all that is wrong with them at once."""

from __future__ import annotations

from argparse import Namespace

from pipeline.commands.command import DONE, FAILED, RIGS, Command, argument, parse_path
from schemas.errors import UsageError

_NAMES = ("recording", "rig", "mapping")


def run(arguments: Namespace) -> int:
    from schemas.visible import make_safe

    if arguments.schema is not None:
        import json

        from ingest.mapping_schema import SCHEMAS

        print(json.dumps(SCHEMAS[arguments.schema](), indent=1, ensure_ascii=False))
        return DONE
    if not arguments.file:
        raise UsageError("no file is named", expected="FILE…, or --schema NAME")
    from ingest.validate import validate

    found = [validate(path, rigs=arguments.rigs) for path in arguments.file]
    for one in found:
        count = len(one.faults)
        said = "valid" if not count else f"{count} fault{'s' if count > 1 else ''}"
        print(make_safe(f"{one.path}: {one.what}, {said}"))
        for fault in one.faults:
            print(make_safe(f"  {fault}"))
    return FAILED if any(one.faults for one in found) else DONE


COMMAND = Command(
    ("run7.csv.toml", "rigs/rig-a.toml", "run7.json run7.mcap", "--schema mapping > mapping.schema.json"),
    (
        argument("file", nargs="*", type=parse_path, metavar="FILE"),
        argument("--schema", choices=_NAMES, help="prints the JSON Schema of that format and ends"),
        RIGS,
    ),
    run,
)
