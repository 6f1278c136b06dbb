"""A YAML file with the line of every key, and pydantic's findings as faults that name file, line and key."""

from __future__ import annotations

import difflib
import types
import typing
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError

from camrig.errors import ConfigError, Fault

KeyPath = tuple[str | int, ...]
"""Where in the file: keys of mappings and indices of lists, outermost first."""

ModelT = TypeVar("ModelT", bound=BaseModel)


class StrictModel(BaseModel):
    """Base of every section: frozen, unknown keys refused, NaN and infinity refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


@dataclass(frozen=True)
class Document:
    """A parsed YAML file: plain data, the line (from 1) on which each key path stands, and the text itself."""

    file: str
    data: dict[str, Any]
    lines: Mapping[KeyPath, int]
    text: str = ""

    def fault(self, at: KeyPath, message: str) -> Fault:
        """Return the fault ``message`` at a key path, with the line of its nearest ancestor in the file."""
        return Fault(self.file, self._line(at), self._name(at), message)

    def validate(self, model: type[ModelT], data: object, at: KeyPath = ()) -> tuple[ModelT | None, list[Fault]]:
        """Check ``data``, which stands at ``at`` in the file, against a model; return the model or all its faults."""
        try:
            return model.model_validate(data), []
        except ValidationError as error:
            return None, self._faults(model, error, at)

    def _faults(self, model: type[BaseModel], error: ValidationError, at: KeyPath) -> list[Fault]:
        faults = {}
        details = error.errors(include_url=False)
        for detail in details:
            if detail["type"] == "too_short" and any(_is_inside(other["loc"], detail["loc"]) for other in details):
                continue  # its items are there, and faulty themselves
            path = at + self._in_file(at, detail["loc"])
            if detail["type"] == "extra_forbidden":
                message = _unknown_key(str(detail["loc"][-1]), _keys_at(model, detail["loc"][:-1]))
            elif detail["type"] == "missing":
                message = "is missing"
            else:
                message = f"{_lower_first(detail['msg'].removeprefix('Value error, '))}; got {detail['input']!r}"
            faults[path, message] = self.fault(path, message)
        return list(faults.values())

    def _in_file(self, at: KeyPath, location: KeyPath) -> KeyPath:
        """Drop what pydantic adds to a location for the branches of a union; the last key may be missing."""
        kept: KeyPath = ()
        for place, key in enumerate(location):
            if at + kept + (key,) in self.lines or (place == len(location) - 1 and "[" not in str(key)):
                kept += (key,)
        return kept

    def _line(self, at: KeyPath) -> int:
        while at and at not in self.lines:
            at = at[:-1]
        return self.lines.get(at, 1)

    def _name(self, at: KeyPath) -> str:
        """Write a key path as ``heads[pt1].baud``: list items by their id where they have one."""
        text = ""
        node: Any = self.data
        for key in at:
            node = _child(node, key)
            if isinstance(key, int):
                label = node.get("id", key) if isinstance(node, dict) else key
                text += f"[{label}]"
            else:
                text += f".{key}" if text else str(key)
        return text


def load_document(path: Path) -> Document:
    """Read a YAML mapping; raises ConfigError for what cannot be read, is no YAML, or repeats a key."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        raise ConfigError([Fault(str(path), 0, "", f"cannot be read: {reason}")]) from error
    return parse_document(str(path), text)


def parse_document(file: str, text: str) -> Document:
    """Parse the text of a file; raises ConfigError for what is no YAML mapping or repeats a key."""
    loader: yaml.SafeLoader | None = None
    try:
        loader = yaml.SafeLoader(text)
        root = loader.get_single_node()
        if not isinstance(root, yaml.MappingNode):
            raise ConfigError([Fault(file, 1, "", "must hold a mapping of keys at its top level")])
        lines: dict[KeyPath, int] = {}
        faults: list[Fault] = []
        _collect(loader, root, (), lines, faults, file)
        if faults:
            raise ConfigError(faults)
        return Document(file, loader.construct_document(root), lines, text)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        problem = " ".join(part for part in (error.context, error.problem) if part)
        raise ConfigError([Fault(file, mark.line + 1 if mark else 0, "", f"is not valid YAML: {problem}")]) from error
    except RecursionError as error:
        raise ConfigError([Fault(file, 0, "", "is nested without end: something in it contains itself")]) from error
    except (yaml.YAMLError, ValueError) as error:
        raise ConfigError([Fault(file, 0, "", f"is not valid YAML: {error}")]) from error
    finally:
        if loader is not None:
            loader.dispose()


def _collect(
    loader: yaml.SafeLoader,
    node: yaml.Node,
    at: KeyPath,
    lines: dict[KeyPath, int],
    faults: list[Fault],
    file: str,
) -> None:
    lines.setdefault(at, node.start_mark.line + 1)
    if isinstance(node, yaml.SequenceNode):
        for index, item in enumerate(node.value):
            _collect(loader, item, (*at, index), lines, faults, file)
    elif isinstance(node, yaml.MappingNode):
        seen: set[str] = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode) and key.value in seen:
                faults.append(Fault(file, key.start_mark.line + 1, str(key.value), "this key stands twice"))
            seen.add(str(key.value))
        loader.flatten_mapping(node)
        for key, value in node.value:
            if isinstance(key, yaml.ScalarNode):
                name = loader.construct_object(key)
                if not isinstance(name, str):
                    text = "a key must be text; put it in quotes"
                    faults.append(Fault(file, key.start_mark.line + 1, key.value, text))
                lines[*at, name] = key.start_mark.line + 1
                _collect(loader, value, (*at, name), lines, faults, file)


def _child(node: Any, key: str | int) -> Any:
    try:
        return node[key]
    except (KeyError, IndexError, TypeError):
        return None


def _is_inside(location: KeyPath, outer: KeyPath) -> bool:
    return len(location) > len(outer) and location[: len(outer)] == outer


def _keys_at(model: type[BaseModel], location: KeyPath) -> set[str]:
    """Return the keys allowed where ``location`` leads inside a model, through lists, mappings and unions."""
    kinds: list[Any] = [model]
    for key in location:
        following: list[Any] = []
        for kind in kinds:
            if isinstance(kind, type) and issubclass(kind, BaseModel):
                if key in kind.model_fields:
                    following += _parts(kind.model_fields[str(key)].annotation)
                elif kind.__name__ == key:
                    following.append(kind)
            elif items := [argument for argument in typing.get_args(kind) if argument is not Ellipsis]:
                following += _parts(items[-1])
        kinds = following or kinds
    return {
        name for kind in kinds if isinstance(kind, type) and issubclass(kind, BaseModel) for name in kind.model_fields
    }


def _parts(annotation: Any) -> list[Any]:
    if typing.get_origin(annotation) in {typing.Union, types.UnionType}:
        return [part for argument in typing.get_args(annotation) for part in _parts(argument)]
    return [annotation]


def _unknown_key(key: str, allowed: set[str]) -> str:
    close = difflib.get_close_matches(key, allowed, n=1, cutoff=0.5)
    hint = f", did you mean '{close[0]}'?" if close else ""
    listed = f" (allowed: {', '.join(sorted(allowed))})" if allowed else ""
    return f"unknown key{hint}{listed}"


def _lower_first(text: str) -> str:
    return text[:1].lower() + text[1:]
