"""Decoding MCAP messages that hold one sample each, JSON or protobuf, and finding fields in them.

Does not belong here: which fields are wanted and what they mean (ingest.mcap_messages).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

from ingest.mcap_records import Channel, Schema
from schemas.errors import RefusedError

LARGEST_MESSAGE = 1 << 20
"""Longest message that is decoded, bytes. Small objects grow tenfold when decoded."""

_SHOWN = 40
"""Most fields that are listed."""

_DEEPEST = 6
"""Most keys in a row of a field that is listed; a message type may contain itself."""


class Decoder(Protocol):
    """Decodes the messages of one channel and finds fields in them."""

    def decode(self, content: memoryview) -> Any:
        """The message. Raises `ValueError` when the bytes are none."""

    def getter(self, path: tuple[str, ...]) -> Callable[[Any], Any]:
        """What finds a field in a message, None where the message has none. `RefusedError` if it never can."""

    def fields(self, message: Any) -> Sequence[str]:
        """The fields of a message that hold numbers or texts, in the way a mapping writes them."""


class _Json:
    def decode(self, content: memoryview) -> Any:
        try:
            return json.loads(bytes(content))
        except RecursionError:
            raise ValueError("nested too deeply") from None

    def getter(self, path: tuple[str, ...]) -> Callable[[Any], Any]:
        def get(message: Any) -> Any:
            for key in path:
                if isinstance(message, dict):
                    message = message.get(key)
                elif isinstance(message, list) and key.isdecimal() and int(key) < len(message):
                    message = message[int(key)]
                else:
                    return None
            return message

        return get

    def fields(self, message: Any) -> Sequence[str]:
        found: list[str] = []

        def visit(value: Any, path: tuple[str, ...]) -> None:
            if len(found) >= _SHOWN or len(path) > _DEEPEST:
                return
            if isinstance(value, dict):
                for key, inner in value.items():
                    visit(inner, (*path, key))
            elif isinstance(value, list):
                for place, inner in enumerate(value[:_SHOWN]):
                    visit(inner, (*path, str(place)))
            elif value is not None and path:
                found.append(".".join(path))

        visit(message, ())
        return found


class _Protobuf:
    """Dynamic messages of the type that the channel's schema, a serialised FileDescriptorSet, describes."""

    def __init__(self, schema: Schema, where: str) -> None:
        from google.protobuf import descriptor_pb2, descriptor_pool, message, message_factory

        self._where = where
        self._error = message.DecodeError
        pool = descriptor_pool.DescriptorPool()
        try:
            files = {f.name: f for f in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file}
            for name in _dependencies_first(files):
                pool.Add(files[name])
            self._type = message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))
        except (message.DecodeError, KeyError, TypeError, ValueError) as error:
            raise RefusedError(
                f'the schema "{schema.name[:80]}" cannot be used: {str(error)[:200]}',
                where=where,
                expected="a FileDescriptorSet with that message type and all it needs",
            ) from None

    def decode(self, content: memoryview) -> Any:
        try:
            return self._type.FromString(bytes(content))
        except self._error:
            raise ValueError("not a message of this type") from None

    def getter(self, path: tuple[str, ...]) -> Callable[[Any], Any]:
        steps: list[tuple[str | int, bool]] = []
        descriptor, repeated = self._type.DESCRIPTOR, False
        for key in path:
            if repeated:
                if not key.isdecimal():
                    raise self._no_field(path, "a number from 0, the field before is a list")
                steps.append((int(key), False))
                repeated = False
                continue
            found = descriptor.fields_by_name.get(key) if descriptor is not None else None
            if found is None:
                names = [f.name for f in descriptor.fields] if descriptor is not None else []
                raise self._no_field(
                    path, "one of " + ", ".join(names[:_SHOWN]) if names else "a field without deeper ones"
                )
            repeated = found.is_repeated
            steps.append((key, found.has_presence))
            descriptor = found.message_type
        if repeated or descriptor is not None:
            raise self._no_field(path, "a number; this field holds more")

        def get(message: Any) -> Any:
            for key, presence in steps:
                if isinstance(key, int):
                    if key >= len(message):
                        return None
                    message = message[key]
                elif presence and not message.HasField(key):
                    return None
                else:
                    message = getattr(message, key)
            return message

        return get

    def fields(self, message: Any) -> Sequence[str]:
        found: list[str] = []

        def visit(descriptor: Any, path: tuple[str, ...]) -> None:
            for inner in descriptor.fields:
                if len(found) >= _SHOWN or len(path) > _DEEPEST:
                    return
                name = (*path, inner.name, "0") if inner.is_repeated else (*path, inner.name)
                if inner.message_type is None:
                    found.append(".".join(name))
                else:
                    visit(inner.message_type, name)

        visit(self._type.DESCRIPTOR, ())
        return found

    def _no_field(self, path: tuple[str, ...], expected: str) -> RefusedError:
        return RefusedError(
            f'the messages have no field "{".".join(path)[:80]}" to read',
            where=self._where,
            expected=expected,
            remedy="Correct field in the mapping TOML",
        )


def _dependencies_first(files: Mapping[str, Any]) -> list[str]:
    """The files in an order in which each comes after those it imports."""
    order: dict[str, None] = {}
    waiting = list(files)
    entered: set[str] = set()
    while waiting:
        name = waiting[-1]
        if name in order or name not in files:
            waiting.pop()
        elif name in entered:
            order[waiting.pop()] = None
        else:
            entered.add(name)
            waiting += [d for d in files[name].dependency if d not in entered]
    return list(order)


def decoder(channel: Channel, schema: Schema | None, where: str) -> Decoder:
    """The decoder for a channel's messages. Raises `RefusedError` for encodings and schemas that cannot be read."""
    encoding = channel.message_encoding
    if encoding == "json":
        return _Json()
    if encoding == "protobuf" and schema is not None and schema.encoding == "protobuf":
        return _Protobuf(schema, where)
    raise RefusedError(
        f'messages are encoded as "{encoding[:40]}" with a schema of the kind '
        f'"{schema.encoding[:40] if schema else "none"}"',
        where=where,
        expected="json, or protobuf with a protobuf schema",
    )
