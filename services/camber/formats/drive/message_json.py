"""Messages as JSON, in recordings and for programs of others: exact, and described by a schema that they all read.

    unknown (None)        the field is absent: schemas then need no `null`, of which viewers make an error
    numbers               Python's shortest repr, which reads back as the same double; no NaN, no infinity
    tuples, arrays        lists; of an array of several dimensions row after row, its shape is in the schema
    bytes (`|u1`, bytes)  base64
    times                 as in the message: GPS nanoseconds, integers beyond 2**53

Viewers read only part of JSON Schema (no references, no alternatives, no lists within lists), so schemas keep to that.
Source: parseJsonSchema.ts of Foxglove Studio 1.87, from which Lichtblick came.
"""

from __future__ import annotations

import base64
import functools
import json
import types
import typing
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import numpy as np
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import core_schema

from camber.schemas.base import ArrayOf, Message, arrays_of
from camber.schemas.codec import DecodeError, validate

M = TypeVar("M", bound=Message)
Read = Callable[[Any], Any]
_KEPT = ("type", "description", "enum", "const", "minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum")
_KEPT_OF_TEXT = ("minLength", "maxLength", "pattern", "minItems", "maxItems", "contentEncoding")


def to_json(fields: Mapping[str, Any], cls: type[Message] | None) -> bytes:
    """Return the fields of a message, as `codec.unpack` gives them, as JSON; `cls` None: of an unknown class.

    Raises ValueError for NaN, infinity and what JSON does not have.
    """
    of_bytes = frozenset() if cls is None else _byte_fields(cls)

    def plain(value: object) -> Any:
        if isinstance(value, np.ndarray):
            return value.ravel().tolist()
        raise ValueError(f"a {type(value).__name__} is not written as JSON")

    known = {
        name: base64.b64encode(value.tobytes()).decode("ascii") if name in of_bytes else _known(value)
        for name, value in fields.items()
        if value is not None
    }
    text = json.dumps(known, default=plain, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    return text.encode("utf-8")


def from_json(cls: type[M], data: bytes) -> M:
    """Return the message of class `cls` in `data`; raises DecodeError and nothing else."""
    try:
        fields = json.loads(data, parse_constant=_no_number)
        return validate(cls, _read_model(cls, fields))
    except DecodeError:
        raise
    except (ValueError, TypeError, RecursionError, OverflowError, MemoryError, AttributeError) as error:
        raise DecodeError(f"{cls.__name__}: {type(error).__name__}: {error}"[:300]) from None


@functools.cache
def json_schema(cls: type[Message]) -> dict[str, Any]:
    """Return the JSON Schema of a message as `to_json` writes it."""
    schema = cls.model_json_schema(schema_generator=_JsonSchema)
    return {"title": cls.schema_name(), **_simple(schema, schema.get("$defs", {}))}


def _known(value: Any) -> Any:
    """Return a value without what is not known."""
    if isinstance(value, dict):
        return {name: _known(part) for name, part in value.items() if part is not None}
    return [_known(part) for part in value] if isinstance(value, tuple) else value


@functools.cache
def _byte_fields(cls: type[BaseModel]) -> frozenset[str]:
    return frozenset(name for name, kind in arrays_of(cls) if _is_bytes(kind))


def _is_bytes(kind: ArrayOf) -> bool:
    return kind.dtype == "|u1" and kind.shape == ("bytes",)


def _no_number(name: str) -> float:
    raise ValueError(f"{name} is no number of JSON")


def _read_model(cls: type[BaseModel], fields: Any) -> dict[str, Any]:
    if not isinstance(fields, dict):
        raise ValueError(f"expected an object of {cls.__name__}")
    for name, (may_be_unknown, read) in _readers(cls).items():
        value = fields.get(name)
        if value is not None:
            fields[name] = read(value)
        elif may_be_unknown:
            fields[name] = None
    return fields


@functools.cache
def _readers(cls: type[BaseModel]) -> dict[str, tuple[bool, Read]]:
    """By field: whether it may be unknown, and what makes of a value of JSON what the class takes."""
    return {
        name: (_may_be_none(info.annotation), _reader(info.annotation, info.metadata))
        for name, info in cls.model_fields.items()
    }


def _may_be_none(annotation: Any) -> bool:
    return types.NoneType in typing.get_args(annotation)


def _reader(annotation: Any, metadata: list[Any]) -> Read:
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is typing.Annotated:
        return _reader(arguments[0], [*metadata, *_flat(arguments[1:])])
    for item in metadata:
        if isinstance(item, ArrayOf):
            return functools.partial(_read_array, item)
    if origin in (types.UnionType, typing.Union):
        (known,) = (argument for argument in arguments if argument is not types.NoneType)
        return _reader(known, metadata)
    if origin is tuple:
        # All tuples of messages have one kind of item.
        return functools.partial(_read_tuple, _reader(arguments[0], []))
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return functools.partial(_read_model, annotation)
    return _as_it_is


def _flat(metadata: tuple[Any, ...]) -> list[Any]:
    return [part for item in metadata for part in (item.metadata if isinstance(item, FieldInfo) else [item])]


def _as_it_is(value: Any) -> Any:
    return value


def _read_tuple(read: Read, values: Any) -> Any:
    return tuple(map(read, values)) if isinstance(values, list) else values


def _read_array(kind: ArrayOf, values: Any) -> np.ndarray[Any, Any]:
    if _is_bytes(kind):
        return np.frombuffer(base64.b64decode(values, validate=True), np.uint8)
    with np.errstate(over="ignore"):  # what overflows is not what was written
        array = np.array(values, kind.dtype)
    if array.ndim != 1 or array.tolist() != values:
        raise ValueError(f"expected a list of numbers that {kind.dtype} holds exactly")
    # At most one length of each array is a name (`tests/unit/formats/drive/test_message_json.py`).
    return array.reshape([length if isinstance(length, int) else -1 for length in kind.shape])


class _JsonSchema(GenerateJsonSchema):
    def function_plain_schema(self, schema: core_schema.PlainValidatorFunctionSchema) -> JsonSchemaValue:
        kind = getattr(schema["function"]["function"], "__self__", None)
        if not isinstance(kind, ArrayOf):
            return super().function_plain_schema(schema)
        if _is_bytes(kind):
            return {"type": "string", "contentEncoding": "base64"}
        shape = " × ".join(str(length) for length in kind.shape)
        number = "number" if np.dtype(kind.dtype).kind == "f" else "integer"
        return {"type": "array", "items": {"type": number}, "description": f"{np.dtype(kind.dtype)}, {shape}"}


def _simple(schema: dict[str, Any], definitions: dict[str, Any]) -> dict[str, Any]:
    """Return a schema without references, alternatives, titles and defaults."""
    if "$ref" in schema:
        schema = {**definitions[schema["$ref"].rpartition("/")[2]], **schema}
    for part in schema.get("anyOf", ()):
        if part.get("type") != "null":
            return _simple({**part, **{n: v for n, v in schema.items() if n != "anyOf"}}, definitions)
    simple = {name: schema[name] for name in (*_KEPT, *_KEPT_OF_TEXT) if name in schema}
    if simple["type"] == "array":
        # The items of a tuple have one type, and limits of their own: those that are of all are kept.
        first, *others = schema.get("prefixItems") or [schema["items"]]
        common = {name: limit for name, limit in first.items() if all(limit == o.get(name) for o in others)}
        simple["items"] = _simple(common, definitions)
    if simple["type"] == "object":
        properties = schema.get("properties", {})
        simple["properties"] = {name: _simple(part, definitions) for name, part in properties.items()}
        required = [name for name in schema.get("required", ()) if not _may_be_null(properties[name])]
        simple |= {"required": required} if required else {}
        more = next(iter(schema.get("patternProperties", {}).values()), schema.get("additionalProperties"))
        if more is not None:
            simple["additionalProperties"] = _simple(more, definitions) if isinstance(more, dict) else more
    return simple


def _may_be_null(schema: dict[str, Any]) -> bool:
    return any(part.get("type") == "null" for part in schema.get("anyOf", ()))
