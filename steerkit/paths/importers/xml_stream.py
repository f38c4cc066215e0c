"""XML read piece by piece, so that a map of any size takes little memory, and none that is made to harm."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from pathlib import Path as FilePath
from typing import Any
from xml.sax import SAXException
from xml.sax.handler import ContentHandler

from steerkit._support.errors import require

_CHUNK = 1 << 12
_DEEPEST = 100


class Node:
    """An element: its tag without prefix, its attributes, its text, the elements in it."""

    __slots__ = ("attributes", "children", "tag", "text", "where")

    def __init__(self, tag: str, attributes: dict[str, str], where: str):
        self.tag, self.attributes, self.where = tag, attributes, where
        self.text = ""
        self.children: list[Node] = []

    def all(self, tag: str) -> list[Node]:
        """The elements of that tag right below."""
        return [child for child in self.children if child.tag == tag]

    def find(self, *tags: str) -> Node | None:
        """The first element below along the tags; None if there is none."""
        node: Node | None = self
        for tag in tags:
            node = next((child for child in node.children if child.tag == tag), None) if node else None
        return node

    def get(self, name: str, default: str | None = None) -> str:
        """An attribute; raises ValueError for one that is missing and has no default."""
        value = self.attributes.get(name, default)
        if value is None:
            raise ValueError(f"{self.where}: <{self.tag}> has no {name}; it has {', '.join(self.attributes) or 'none'}")
        return value

    def number(self, name: str, default: float | None = None) -> float:
        """An attribute as a finite number; raises ValueError where it is none, or missing without a default."""
        text = self.get(name, None if default is None else repr(default))
        return _number(text, f"{self.where}: <{self.tag}> {name}")

    def value(self) -> float:
        """The text as a finite number; raises ValueError where it is none."""
        return _number(self.text, f"{self.where}: <{self.tag}>")


def _number(text: str, where: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    require(math.isfinite(value) and "_" not in text, where, f"is {text.strip()[:40]!r}, expected a number")
    return value


def records(file: str | FilePath, wanted: set[str], marks: set[str] = frozenset()) -> Iterator[Node | str]:  # type: ignore[assignment]
    """The elements of the tags `wanted`, whole, one after the other, and the tags `marks` where such an element begins.

    Nothing but the element at hand is kept. Raises ValueError for what is no XML, damaged or cut off, and for entities,
    of which a small file can unfold to gigabytes; ImportError's advice where the package for it is missing.
    """
    try:
        from defusedxml.common import DefusedXmlException
        from defusedxml.expatreader import create_parser
    except ImportError:
        raise ValueError(f"{file}: maps and tracks need a package: pip install 'steerkit-control[roads]'") from None

    class Handler(ContentHandler):
        def __init__(self) -> None:
            super().__init__()
            self.ready: list[Node | str] = []
            self.stack: list[Node] = []
            self.depth = 0

        def startElement(self, name: str, attrs: Any) -> None:
            tag = name.rpartition(":")[2]
            self.depth += 1
            require(self.depth <= _DEEPEST, f"{file}", f"more than {_DEEPEST} elements within each other: no map")
            if self.stack or tag in wanted:
                node = Node(tag, dict(attrs.items()), f"{file}, line {parser.getLineNumber()}")
                if self.stack:
                    self.stack[-1].children.append(node)
                self.stack.append(node)
            elif tag in marks:
                self.ready.append(tag)

        def endElement(self, name: str) -> None:
            self.depth -= 1
            if self.stack:
                node = self.stack.pop()
                if not self.stack:
                    self.ready.append(node)

        def characters(self, content: str) -> None:
            if self.stack:
                self.stack[-1].text += content

    empty = True
    handler, parser = Handler(), create_parser(forbid_dtd=False, forbid_entities=True, forbid_external=True)
    parser.setContentHandler(handler)
    try:
        with FilePath(file).open("rb") as stream:
            while chunk := stream.read(_CHUNK):
                empty = False
                parser.feed(chunk)
                yield from handler.ready
                handler.ready.clear()
        parser.close()
        require(not empty, f"{file}", "no XML, damaged or cut off (it is empty)")
    except DefusedXmlException as error:
        what = f"declares entities ({type(error).__name__}), which maps do not need and attacks do"
        raise ValueError(f"{file}: {what}; remove its <!DOCTYPE ...>") from error
    except (SAXException, LookupError, UnicodeError) as error:
        text = " ".join(str(error).replace("<unknown>:", "at line and column ").split())[:100]
        raise ValueError(f"{file}: no XML, damaged or cut off ({text})") from error
    except OSError as error:
        raise ValueError(f"{file}: cannot be read ({error.strerror})") from error
    yield from handler.ready


def root_of(file: str | FilePath) -> str:
    """The first tag of an XML file, to know what kind of map it is; raises ValueError for what is no XML."""
    try:
        with FilePath(file).open("rb") as stream:
            head = stream.read(16 * _CHUNK)
    except OSError as error:
        raise ValueError(f"{file}: cannot be read ({error.strerror})") from error
    found = re.search(rb"<(?:[A-Za-z0-9]+:)?([A-Za-z][\w.-]*)[\s>/]", head)
    require(found, f"{file}", "is no XML")
    assert found is not None
    return found[1].decode("ascii", "replace")
