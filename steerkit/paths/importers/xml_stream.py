"""XML read element by element, so that a map of any size takes little memory, and none that is made to harm."""

import math
from collections.abc import Collection, Iterator
from pathlib import Path as FilePath
from xml.etree.ElementTree import Element, ParseError

from steerkit._support.errors import optional, require
from steerkit._support.files import opened

_DEEPEST = 100


def get(node: Element, name: str, default: str | None = None) -> str:
    """An attribute; raises ValueError for one that is missing and has no default."""
    value = node.get(name, default)
    if value is None:
        raise ValueError(f"{shown(node)} has no {name}")
    return value


def number(node: Element, name: str, default: float | None = None) -> float:
    """An attribute as a finite number; raises ValueError where it is none, or missing without a default."""
    text = get(node, name, None if default is None else repr(default))
    return finite(text, f"{shown(node)} {name}")


def value(node: Element) -> float:
    """The text as a finite number; raises ValueError where it is none."""
    return finite(node.text or "", shown(node))


def shown(node: Element) -> str:
    """How an element begins, for messages."""
    attributes = "".join(f' {key}="{text}"' for key, text in node.items())
    return f"<{' '.join((node.tag + attributes[:80]).split())}>"


def finite(text: str, where: str) -> float:
    """A text as a finite number; raises ValueError where it is none."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    require(math.isfinite(value) and "_" not in text, where, f"is {text.strip()[:40]!r}, expected a number")
    return value


def records(file: str | FilePath, wanted: Collection[str], begun: Collection[str] = ()) -> Iterator[Element]:
    """The elements of the tags `wanted`, whole, one after the other; those of the tags `begun` where they begin.

    Nothing but the element at hand is kept. Raises ValueError for what is no XML, damaged or cut off, and for entities,
    of which a small file can unfold to gigabytes; ImportError's advice where the package for it is missing.
    """
    around, whole = list[Element](), None
    for event, node in _events(file):
        if event == "start":
            around.append(node)
            require(len(around) <= _DEEPEST, f"{file}", f"more than {_DEEPEST} elements within each other: no map")
            if whole is None and node.tag in wanted:
                whole = node
            elif whole is None and node.tag in begun:
                yield node
            continue
        around.pop()
        if node is whole:
            yield node
            whole = None
        if whole is None and around:
            around[-1].remove(node)


def root_of(file: str | FilePath) -> str:
    """The first tag of an XML file, to know what kind of map it is; raises ValueError for what is no XML."""
    _, root = next(_events(file))
    return str(root.tag)


def _events(file: str | FilePath) -> Iterator[tuple[str, Element]]:
    """("start" or "end", element), tags without their namespace."""
    common, reader = (optional(f"defusedxml.{name}", f"{file}: XML", "roads") for name in ("common", "ElementTree"))
    try:
        with opened(file) as stream:
            for event, node in reader.iterparse(stream, ("start", "end")):
                node.tag = node.tag.rpartition("}")[2]
                yield event, node
    except common.DefusedXmlException as error:
        what = f"declares entities ({type(error).__name__}), which maps do not need and attacks do"
        raise ValueError(f"{file}: {what}; remove its <!DOCTYPE ...>") from error
    except (ParseError, LookupError, UnicodeError) as error:
        raise ValueError(f"{file}: no XML, damaged or cut off ({str(error)[:100]})") from error
    except OSError as error:
        raise ValueError(f"{file}: cannot be read ({error.strerror})") from error
