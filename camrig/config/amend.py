"""A hand-written YAML file changed in single places: its comments, its order and its layout stay.

What is changed is cut out and put in by the marks that the YAML parser gives every value; nothing else is touched.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml

from camrig.config.document import KeyPath, load_document, parse_document
from camrig.config.kept_file import check_writable, write
from camrig.config.rig_file import read_rig
from camrig.errors import ConfigError, InputError

_MERGE = "tag:yaml.org,2002:merge"


def amend_rig(path: Path, changes: Mapping[KeyPath, object]) -> None:
    """Write changes into a rig's file, as ``amended`` takes them, if what comes out is a rig.

    Raises InputError, and leaves the file as it is, where it is not or a change has no place in it.
    """
    changed = amended(load_document(path).text, changes)
    try:
        read_rig(parse_document(str(path), changed))
    except ConfigError as error:
        raise InputError(f"{path} is left as it is, with the changes it would not load:\n{error}") from error
    write(path, changed)


def check_amendable(path: Path, places: Iterable[KeyPath]) -> None:
    """Ask before a long job whether its result can be put into a rig's file, at places as ``amended`` takes them.

    Raises InputError where the file cannot be written, or a place is one that ``amended`` refuses.
    """
    check_writable(path)
    try:
        amended(load_document(path).text, dict.fromkeys(places))
    except InputError as error:
        raise InputError(f"{path} cannot take what --write would set: {error}") from error


def amended(text: str, changes: Mapping[KeyPath, object]) -> str:
    """Return a YAML text with values set: ``{("lenses", "lab", "fx"): 827.7}``.

    A step into a list is an index, its length to add an item, or the ``id`` of an item. Keys that are not there are
    made. Values are what YAML can say: numbers, text, booleans, None, lists and mappings; they are written in one
    line. Raises InputError for a step that leads nowhere, and where more than the place would change: in what several
    places share (``&anchor``, ``*alias``), and in what is merged from elsewhere (``<<``).
    """
    for path, value in changes.items():
        text = _Place(text, path).put(value)
    return text


class _Place:
    """Where one change goes: the deepest node on its path that the text has, and what is left of the path."""

    def __init__(self, text: str, path: KeyPath) -> None:
        root = yaml.compose(text, Loader=yaml.SafeLoader)
        if not isinstance(root, yaml.MappingNode):
            raise InputError("a file without keys cannot be amended")
        self.text = text
        self.path = path
        self.shared = _shared(root)
        self.node: yaml.Node = root
        self.missing = list(path)
        while self.missing and (found := _step(self.node, self.missing[0])) is not None:
            self._refuse_shared(found)
            self.node = found
            self.missing.pop(0)
        if len(self.missing) > 1 and _merges(self.node, self.missing[0]):
            raise InputError(f"{_name(path)}: stands in what is merged from elsewhere (<<); write it out there")

    def _refuse_shared(self, node: yaml.Node) -> None:
        if id(node) in self.shared:
            raise InputError(
                f"{_name(self.path)}: stands in what is shared (&anchor in line {node.start_mark.line + 1}, *alias), "
                "and would change wherever it is used; write it out in each place"
            )

    def put(self, value: object) -> str:
        """Return the text with the value there."""
        if not self.missing:
            return self._replaced(value)
        step, *inner = self.missing
        if any(isinstance(key, int) and key > 0 for key in inner):
            raise InputError(f"{_name(self.path)}: the file has no such place")
        for key in reversed(inner):
            value = {key: value} if isinstance(key, str) else [value]
        if isinstance(self.node, yaml.MappingNode) and isinstance(step, str):
            return self._inserted(f"{_flow(step)}: {_flow(value)}")
        if isinstance(self.node, yaml.SequenceNode) and step == len(self.node.value):
            return self._inserted(_flow(value))
        if _is_empty(self.node):
            return self._replaced({step: value} if isinstance(step, str) else [value])
        raise InputError(f"{_name(self.path)}: the file has no such place")

    def _replaced(self, value: object) -> str:
        for node in _inside(self.node):
            self._refuse_shared(node)
        if any(isinstance(token, yaml.AnchorToken) for token in self._head()):
            raise InputError(f"{_name(self.path)}: has an &anchor, which would be lost; take it away there")
        begin, end = self.node.start_mark.index, self._last_before(self.node.end_mark.index).end_mark.index
        end = len(self.text[:end].rstrip("\n"))
        if isinstance(self.node, yaml.CollectionNode) and not self.node.flow_style:
            # A block begins on a line of its own; in one line it goes to where its key or its dash is.
            begin = self._last_before(begin).end_mark.index
        before, after = self.text[:begin], self.text[end:]
        space = "" if before[-1:] in {" ", "[", "{", ""} else " "
        return f"{before}{space}{_flow(value)}{after}"

    def _inserted(self, entry: str) -> str:
        node = self.node
        assert isinstance(node, yaml.CollectionNode)
        last = self._last_before(node.end_mark.index - bool(node.flow_style))
        end = last.end_mark.index
        if node.flow_style:
            comma = "" if isinstance(last, yaml.FlowMappingStartToken | yaml.FlowSequenceStartToken) else ", "
            comma = " " if isinstance(last, yaml.FlowEntryToken) else comma
            return f"{self.text[:end]}{comma}{entry}{self.text[end:]}"
        line_end = self.text.find("\n", len(self.text[:end].rstrip("\n")))
        head = self.text if line_end < 0 else self.text[:line_end]
        tail = "" if line_end < 0 else self.text[line_end:]
        dash = "- " if isinstance(node, yaml.SequenceNode) else ""
        return f"{head}\n{' ' * self._column()}{dash}{entry}{tail or chr(10)}"

    def _column(self) -> int:
        """Return where the entries of a block begin; its own mark is at the anchor or the tag before it, if any."""
        blocks = yaml.BlockMappingStartToken | yaml.BlockSequenceStartToken | yaml.BlockEntryToken
        begin = self.node.start_mark.index
        tokens = yaml.scan(self.text, Loader=yaml.SafeLoader)
        column: int = next(t.start_mark.column for t in tokens if t.start_mark.index >= begin and isinstance(t, blocks))
        return column

    def _head(self) -> Iterator[yaml.Token]:
        """Yield the anchor and the tag that stand before the node's value, if any."""
        for token in yaml.scan(self.text, Loader=yaml.SafeLoader):
            if token.start_mark.index >= self.node.start_mark.index:
                if isinstance(token, yaml.AnchorToken | yaml.TagToken):
                    yield token
                elif token.end_mark.index > token.start_mark.index:
                    return

    def _last_before(self, limit: int) -> yaml.Token:
        """Return the last token that ends by then; a block's own end mark is past the comments that follow it."""
        tokens = yaml.scan(self.text, Loader=yaml.SafeLoader)
        written = (token for token in tokens if token.start_mark.index < token.end_mark.index <= limit)
        return max(written, key=lambda token: token.end_mark.index)


def _step(node: yaml.Node, key: str | int) -> yaml.Node | None:
    """Return what a step leads to."""
    if isinstance(node, yaml.MappingNode):
        # What is merged from elsewhere (<<) is not found: a key of the mapping's own overrides it.
        return next((value for name, value in node.value if name.value == key), None)
    if isinstance(node, yaml.SequenceNode):
        if isinstance(key, int):
            return node.value[key] if key < len(node.value) else None
        return next((item for item in node.value if _is_named(item, key)), None)
    return None


def _merges(node: yaml.Node, key: str | int) -> bool:
    """Tell whether a mapping has a key from elsewhere (``<<``): one of its own would hide all that is in that."""
    pairs = node.value if isinstance(node, yaml.MappingNode) else []
    merged = [value for name, value in pairs if name.tag == _MERGE]
    every = [each for value in merged for each in (value.value if isinstance(value, yaml.SequenceNode) else [value])]
    return any(_step(each, key) is not None or _merges(each, key) for each in every)


def _shared(root: yaml.Node) -> set[int]:
    """Return the ids of the nodes that stand in more than one place."""
    return {node for node, places in Counter(id(node) for node in _inside(root)).items() if places > 1}


def _inside(root: yaml.Node) -> Iterator[yaml.Node]:
    """Yield a node and all in it, as often as they are referred to; what a shared one holds only once."""
    waiting, seen = [root], set[int]()
    while waiting:
        node = waiting.pop()
        yield node
        if isinstance(node, yaml.CollectionNode) and id(node) not in seen:
            seen.add(id(node))
            pairs = node.value if isinstance(node, yaml.MappingNode) else [(item,) for item in node.value]
            waiting += [each for pair in pairs for each in pair]


def _is_named(item: yaml.Node, name: str) -> bool:
    pairs = item.value if isinstance(item, yaml.MappingNode) else []
    return any(key.value == "id" and value.value == name for key, value in pairs)


def _is_empty(node: yaml.Node) -> bool:
    return isinstance(node, yaml.ScalarNode) and node.tag == "tag:yaml.org,2002:null"


def _flow(value: Any) -> str:
    """Write a value in one line."""
    text = yaml.safe_dump(value, default_flow_style=True, sort_keys=False, allow_unicode=True, width=float("inf"))
    return str(text).removesuffix("\n").removesuffix("\n...")


def _name(path: Iterable[str | int]) -> str:
    return "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in path).removeprefix(".")
