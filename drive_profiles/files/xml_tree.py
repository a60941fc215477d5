"""XML files as a tree of bounded size, with line numbers.

The files are not trusted: declarations of a document type or of entities are refused, so nothing is expanded or fetched, and
depth, elements and text are bounded.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

from drive_profiles.errors import FileError, Problem

MAX_DEPTH = 64
MAX_ELEMENTS = 200_000
MAX_TEXT = 4096


@dataclass(slots=True)
class Element:
    """One element of the tree: names without their name space."""

    tag: str
    attributes: dict[str, str]
    line: int
    children: "list[Element]" = field(default_factory=list)
    text: str = ""

    def walk(self) -> "Iterator[Element]":
        """Yield this element and its descendants in the file's order."""
        stack = [self]
        while stack:
            element = stack.pop()
            yield element
            stack.extend(reversed(element.children))

    def child(self, tag: str) -> "Element | None":
        """Return the first child of a name."""
        return next((child for child in self.children if child.tag == tag), None)


class _UnsafeError(Exception):
    """XML that no description needs, and that could do harm."""


def parse(data: bytes, path: Path, kind: str) -> Element:
    """Return the root element of an XML file of bounded size.

    Raises:
        FileError: It is not XML of the `kind` wanted (``an XDD file``), or unsafe; with the line.
    """
    parser = expat.ParserCreate()
    top = Element("", {}, 0)
    stack = [top]
    count = 0

    def start(name: str, attributes: dict[str, str]) -> None:
        nonlocal count
        count += 1
        if count > MAX_ELEMENTS or len(stack) > MAX_DEPTH:
            raise _UnsafeError(f"more than {MAX_ELEMENTS} elements, or deeper than {MAX_DEPTH}")
        local = {key.rpartition(":")[2]: value for key, value in attributes.items()}
        element = Element(name.rpartition(":")[2], local, parser.CurrentLineNumber)
        stack[-1].children.append(element)
        stack.append(element)

    def end(_name: str) -> None:
        stack.pop()

    def text(content: str) -> None:
        if len(stack[-1].text) < MAX_TEXT:
            stack[-1].text += content

    def refuse(*_: object) -> int:
        raise _UnsafeError("declares a document type or an entity")

    parser.StartElementHandler, parser.EndElementHandler, parser.CharacterDataHandler = start, end, text
    parser.StartDoctypeDeclHandler = parser.EntityDeclHandler = parser.ExternalEntityRefHandler = refuse
    try:
        parser.Parse(data, True)
    except _UnsafeError as error:
        plain = f"a plain {kind.partition(' ')[2]}"
        raise FileError(path, (Problem(parser.CurrentLineNumber, "", str(error), plain),)) from error
    except expat.ExpatError as error:
        raise FileError(path, (Problem(error.lineno, "", f"is not XML: {expat.ErrorString(error.code)}", kind),)) from error
    except (LookupError, ValueError) as error:  # an encoding that Python does not have, or that is none of single bytes
        raise FileError(path, (Problem(1, "", f"is not readable XML: {error}", f"{kind} in UTF-8"),)) from error
    return top.children[0]
