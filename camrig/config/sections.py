"""Reads a document section by section, so that a fault in one does not hide those of the others."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, TypeVar

from pydantic import BaseModel

from camrig.config.document import Document, KeyPath
from camrig.config.lenses import AnyLensModel, lens_model
from camrig.errors import Fault

ModelT = TypeVar("ModelT", bound=BaseModel)


@dataclass
class Sections:
    """A document and the faults found in it so far."""

    document: Document
    faults: list[Fault] = field(default_factory=list)

    def fault(self, at: KeyPath, message: str) -> None:
        """Note a fault."""
        self.faults.append(self.document.fault(at, message))

    def node(self, at: KeyPath) -> Any:
        """Return what stands at a key path."""
        node: Any = self.document.data
        for key in at:
            node = node[key]
        return node

    def checked(self, model: type[ModelT], data: object, at: KeyPath) -> ModelT | None:
        """Return the model of ``data``, which stands at ``at``; None where it has faults."""
        found, faults = self.document.validate(model, data, at)
        self.faults += faults
        return found

    def model(self, model: type[ModelT], at: KeyPath, default: ModelT | None = None) -> ModelT | None:
        """Return the model of what stands at ``at``; the default where its section is not in the file."""
        return self.checked(model, self.node(at), at) if at[0] in self.document.data else default

    def lenses(self) -> dict[str, AnyLensModel]:
        """Return the lenses that have no fault, by name."""
        section = self.document.data.get("lenses")
        if not isinstance(section, dict) or not section:
            self.fault(("lenses",), "must be a mapping of names with at least one lens")
            return {}
        found = {str(name): self.checked(lens_model(lens), lens, ("lenses", name)) for name, lens in section.items()}
        return {name: lens for name, lens in found.items() if lens is not None}

    def places(self, key: str, *, required: bool = False) -> list[KeyPath]:
        """Return where the items of a list stand."""
        section = self.document.data.get(key) or []
        if not isinstance(section, list) or (required and not section):
            self.fault((key,), f"must be a list with at least one of the {key}" if required else "must be a list")
            return []
        return [(key, index) for index in range(len(section))]

    def items(self, model: type[ModelT], key: str, *, required: bool = False) -> dict[KeyPath, ModelT]:
        """Return the models of a list's items that have no fault, by where they stand."""
        found = {at: self.model(model, at) for at in self.places(key, required=required)}
        return {at: item for at, item in found.items() if item is not None}


def written_ids(data: Any, *sections: str) -> Iterator[tuple[KeyPath, str]]:
    """Yield where each item of some lists stands and its id, as far as it has one, whatever else is wrong with it."""
    for section in sections:
        items = data.get(section)
        for index, item in enumerate(items if isinstance(items, list) else []):
            if isinstance(item, dict) and isinstance(item.get("id"), str):
                yield (section, index), item["id"]


def repeated_ids(data: Any, *sections: str) -> Iterator[tuple[KeyPath, str]]:
    """Yield a fault for every id that stood before in these lists."""
    first: dict[str, KeyPath] = {}
    for at, name in written_ids(data, *sections):
        earlier = first.setdefault(name, at)
        if earlier != at:
            yield (*at, "id"), f"'{name}' is already the id of {earlier[0]}[{earlier[1]}]; ids are unique"
