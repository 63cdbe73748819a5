"""A TOML file that people write, read into a model: whatever is wrong with it is one clear line.

The line names the file, the field, what stands there and what was expected. Any value can be overridden from the
command line.
"""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from camber.schemas.base import Model
from camber.schemas.bounded_toml import NestingError, parse_toml, read_toml

M = TypeVar("M", bound=Model)

Overrides = Mapping[str, Any] | Sequence[str]
"""`{"surrogates.map_sigma_m": 0.1}`, or `["surrogates.map_sigma_m=0.10"]`: there a value is read as TOML, and what is
no TOML value is text."""


class FileError(ValueError):
    """The file cannot be used; one clear line with the file, the field and what was expected."""


def load_toml(
    cls: type[M],
    path: Path,
    overrides: Overrides = (),
    *,
    context: Mapping[str, Any],
    error: type[FileError],
    what: str,
) -> tuple[M, tuple[str, ...]]:
    """The model in a file, and what was changed from it as `field=value`; raises `error`.

    `context` is for the model's validators; `what` the file was expected to be, in words.
    """
    try:
        table = read_toml(path)
    except OSError as problem:
        raise error(f"{path}: {problem.strerror or problem}, expected {what}") from None
    except ValueError as problem:
        raise error(f"{path}: not TOML: {problem}") from None
    changes = (
        dict(overrides)
        if isinstance(overrides, Mapping)
        else dict(_parse_override(text, error) for text in overrides)
    )
    for field, value in changes.items():
        _set(table, field, value, error)
    try:
        model = cls.model_validate(table, context=context)
    except ValidationError as problem:
        raise error(_one_line(cls, problem, path, frozenset(changes))) from None
    return model, tuple(f"{field}={value}" for field, value in changes.items())


def _parse_override(text: str, error: type[FileError]) -> tuple[str, Any]:
    field, equals, value = text.partition("=")
    field = field.strip()
    if not equals or not field:
        raise error(f"--set {text!r}: expected field=value, such as surrogates.map_sigma_m=0.10")
    try:
        parsed = parse_toml(f"value = {value.strip()}")
    except NestingError as problem:
        raise error(f"--set {field}: {problem}") from None
    except tomllib.TOMLDecodeError:
        return field, value.strip()
    # A value with a newline in it could bring further keys along.
    return field, parsed["value"] if set(parsed) == {"value"} else value.strip()


def _set(table: dict[str, Any], field: str, value: Any, error: type[FileError]) -> None:
    *parents, last = field.split(".")
    for depth, parent in enumerate(parents):
        below = table.setdefault(parent, {})
        if not isinstance(below, dict):
            raise error(f"--set {field}: {'.'.join(parents[: depth + 1])} is no table, expected one")
        table = below
    table[last] = value


def _one_line(cls: type[Model], error: ValidationError, path: Path, changed: frozenset[str]) -> str:
    first = error.errors(include_url=False, include_context=False)[0]
    location = first["loc"]
    field = ".".join(str(part) for part in location)
    where = f"{path}: --set" if any(f"{field}.".startswith(f"{name}.") for name in changed) else f"{path}:"
    if not location:
        return f"{where} {first['msg']}"
    names, expected = _known_at(cls, location)
    if first["type"] == "extra_forbidden":
        close = difflib.get_close_matches(str(location[-1]), names, n=1)
        hint = f"did you mean {close[0]}? " if close else ""
        return f"{where} {field} is not known; {hint}expected one of {', '.join(names)}"
    if first["type"] == "missing":
        return f"{where} {field} is missing, expected {expected}"
    shown = "" if isinstance(first["input"], dict) else f" is {str(first['input'])[:60]!r}"
    message = first["msg"].removeprefix("Input ").removeprefix("Value ")
    return f"{where} {field}{shown}: {message}" + (f" ({expected})" if expected else "")


def _known_at(cls: type[Model], location: tuple[int | str, ...]) -> tuple[list[str], str]:
    """The keys that are known beside the last part of `location`, and the description of the nearest field."""
    models: list[type[BaseModel]] = [cls]
    description = ""
    for part in location[:-1]:
        tagged = [model for model in models if part in _tags(model)]
        info = next((keys[str(part)] for keys in map(_keys, models) if str(part) in keys), None)
        if tagged:
            models = tagged
        elif info is not None:
            models, description = _models_in(info.annotation), info.description or ""
        elif not isinstance(part, int):
            return [], description
    last = str(location[-1])
    names = [name for model in models for name in _keys(model)]
    info = next((keys[last] for keys in map(_keys, models) if last in keys), None)
    return names, description if info is None else info.description or ""


def _keys(model: type[BaseModel]) -> dict[str, FieldInfo]:
    """The fields of a model by their names in a file."""
    return {info.alias or name: info for name, info in model.model_fields.items()}


def _tags(model: type[BaseModel]) -> tuple[Any, ...]:
    """The words by which a model is chosen among others."""
    kind = model.model_fields.get("kind")
    return () if kind is None else get_args(kind.annotation)


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in get_args(annotation) for model in _models_in(part)]
