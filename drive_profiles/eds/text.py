"""The text of an EDS or DCF, rewritable value by value.

This module does not know what a key means. It keeps the lines as they are, so that a rewrite changes no byte that it need not.
Keys and section names are compared without regard to case, and sections of objects by their numbers: ``[1a00Sub00]``
is ``[1A00sub0]``. Of repeated keys the first counts, as for the Windows call with which most of these files are
read by their makers' tools; a later section adds the keys that the first has not.

Source: CiA 306-1 (format).
"""

import codecs
import contextlib
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from drive_profiles.errors import FileError, Problem

MAX_BYTES = 4 << 20
"""Largest file that is read. The largest known, a servo drive with 7000 sections, has 0.9 MB."""
MAX_SECTIONS = 20_000
MAX_ENTRIES = 200_000
MAX_LINE = 4096
MAX_PROBLEMS = 5_000
"""Number of warnings that are listed; further ones are only counted."""
BLANK = " \t\f\v\x1a\0\ufeff"
"""Characters that are dropped at both ends of names, keys and values: blanks, the end mark of DOS, the mark of UTF-8."""

_SAMPLE = 512
"""Bytes by which UTF-16 without a mark is told from text with a few NULs in it."""
_LINE = re.compile(r"[^\r\n]*(?:\r\n|\r|\n|\Z)")
_OBJECT = re.compile(r"([0-9a-f]{1,4})(?:sub([0-9a-f]+)|(name|value|denotation))?", re.IGNORECASE)
_NEVER_LETTERS = re.compile(r"[^\W\d_]([\u2018\u201c-\u2039\u203a\u02c6\u02dc\u20ac])[^\W\d_]|[\u0080-\u009f]")


def quoted(text: str) -> str:
    """Quote text from a file for a message."""
    return repr(text if len(text) <= 60 else text[:57] + "...")


class EdsEntry(NamedTuple):
    """One ``key=value`` line, numbered from 1; comments are still in the value."""

    key: str
    value: str
    line: int


class Replacement(NamedTuple):
    """A value that is written over another.

    With `keeps_comment` text after ``#`` or ``;`` is a comment, which stays; in a string it belongs to the value.
    """

    value: str
    keeps_comment: bool


@dataclass(slots=True)
class EdsSection:
    """The keys between one ``[name]`` and the next.

    Attributes:
        line: Line number of the head.
        last: Line number of the last key, or of the head.
        entries: First entry of each key, by `folded` key.
    """

    name: str
    line: int
    last: int = 0
    entries: dict[str, EdsEntry] = field(default_factory=dict)
    repeated: list[EdsEntry] = field(default_factory=list)

    def get(self, key: str) -> EdsEntry | None:
        """Return the entry of a key with a value; ``LowLimit=`` has none."""
        entry = self.entries.get(key.lower())
        return entry if entry is not None and entry.value else None

    def text(self, key: str) -> str:
        """Return the value of a key, empty if there is none."""
        entry = self.entries.get(key.lower())
        return entry.value if entry is not None else ""


@dataclass(slots=True)
class Findings:
    """Faults of a file in bounded number; `beyond` counts those not listed."""

    warnings: list[Problem] = field(default_factory=list)
    refused: list[Problem] = field(default_factory=list)
    beyond: int = 0
    _known: set[Problem] = field(default_factory=set)

    def warn(self, line: int, section: str, key: str, message: str, expected: str = "") -> None:
        """Note a repair and what was expected; line 0 is the file."""
        self._add(self.warnings, Problem(line, _key(section, key), message, expected))

    def remark(self, section: EdsSection, entry: EdsEntry, remark: str, expected: str) -> None:
        """Warn of the value of an entry, and name what was expected."""
        self.warn(entry.line, section.name, entry.key, f"{quoted(entry.value)} {remark}", expected)

    def refuse(self, line: int, section: str, key: str, message: str, expected: str = "") -> None:
        """Note an object that is left out of the dictionary, like `warn`."""
        self._add(self.refused, Problem(line, _key(section, key), message, expected))

    def closed(self) -> tuple[tuple[Problem, ...], tuple[Problem, ...]]:
        """Return warnings and refusals, sorted by line."""
        warnings, refused = sorted(self.warnings), sorted(self.refused)
        if self.beyond:
            warnings.append(Problem(0, "", f"has {self.beyond} more problems, not listed", "a description of a CANopen device"))
        return tuple(warnings), tuple(refused)

    def _add(self, problems: list[Problem], problem: Problem) -> None:
        if problem in self._known:
            return  # a key may be looked at twice
        if len(problems) < MAX_PROBLEMS:
            problems.append(problem)
            self._known.add(problem)
        else:
            self.beyond += 1


@dataclass(frozen=True, slots=True)
class Document:
    """The text of a file, divided into sections.

    Attributes:
        lines: Lines with their ends; together they are the file.
        encoding: Codec that turns the lines back into the bytes of the file.
        sections: Sections by `section_id`.
    """

    path: Path
    lines: list[str]
    encoding: str
    sections: dict[str, EdsSection]

    def rewritten(self, replace: dict[int, Replacement], insert: dict[int, list[str]]) -> bytes:
        """Return the file with values replaced, and lines added, by line number.

        Raises:
            UnicodeEncodeError: The encoding of the file has no such character.
        """
        end = next((line[len(line.rstrip("\r\n")) :] for line in self.lines if line.endswith(("\r", "\n"))), "\n")
        parts: list[str] = []
        for number, line in enumerate(self.lines, 1):
            parts.append(_with_value(line, replace[number]) if number in replace else line)
            for text in insert.get(number, ()):
                if not parts[-1].endswith(("\r", "\n")):
                    parts[-1] += end  # the last line of the file
                parts.append(text + end)
        return "".join(parts).encode(self.encoding)


def section_id(name: str) -> str:
    """Return the key of a section."""
    name = name.strip(BLANK)
    match = _OBJECT.fullmatch(name)
    if match is None:
        return folded(name)
    number, subindex, suffix = match.groups()
    index = f"{int(number, 16):04X}"
    if subindex is not None:
        return f"{index}sub{int(subindex[-8:], 16):X}" if len(subindex) <= 8 else folded(name)
    return index + (suffix or "").lower()


def folded(key: str) -> str:
    """Return a key in lower case and without blanks, for comparisons."""
    return "".join(key.lower().split()) if " " in key or "\t" in key else key.lower()


def comment_start(value: str) -> int:
    """Return the position at which a comment begins in a value.

    Examples: ``0x07 # VAR`` and ``rw ; note``. Names and strings may hold these characters: do not use it for them.
    """
    ends = [at for mark in "#;" if (at := value.find(mark)) >= 0]
    return min(ends, default=len(value))


def read(data: bytes, path: Path, findings: Findings) -> Document:
    """Divide a file into its sections.

    Raises:
        FileError: The file is too large, or is not text.
    """
    text, encoding = _decoded(data, path, findings)
    lines = [match.group() for match in _LINE.finditer(text) if match.group()]
    document = Document(path, lines, encoding, {})
    section: EdsSection | None = None
    count = 0
    for number, line in enumerate(lines, 1):
        stripped = line.strip(BLANK + "\r\n")
        if not stripped or stripped[0] in ";#":
            continue
        if len(line) > MAX_LINE:
            findings.warn(
                number, section.name if section else "", "", f"line of {len(line)} characters ignored", f"at most {MAX_LINE}"
            )
        elif stripped[0] == "[":
            section = _opened(document, stripped, number, findings)
        else:
            count += 1
            if count > MAX_ENTRIES:
                raise FileError(path, (Problem(number, "", "too many keys", f"at most {MAX_ENTRIES}"),))
            _keep(document, section, stripped, number, findings)
    return document


def _key(section: str, key: str) -> str:
    head = f"[{quoted(section)[1:-1]}]" if section else ""
    return f"{head} {quoted(key)[1:-1]}".strip() if key else head


def _with_value(line: str, new: Replacement) -> str:
    """Replace the value in a line; blanks stay, and comments if wanted."""
    head, _, rest = line.partition("=")
    body = rest.rstrip("\r\n")
    old = body.strip(BLANK)
    start = body.find(old) if old else 0
    if new.keeps_comment:
        old = old[: comment_start(old)].rstrip(BLANK)
    return f"{head}={rest[:start]}{new.value}{rest[start + len(old) :]}"


def _opened(document: Document, stripped: str, number: int, findings: Findings) -> EdsSection:
    """Return the section that a head line opens, or continues."""
    name, bracket, rest = stripped[1:].partition("]")
    name = name.strip(BLANK)
    rest = rest.strip(BLANK)
    if not bracket:
        name = name[: comment_start(name)].strip(BLANK)
        findings.warn(number, name, "", 'section header lacks "]"; assumed', "[name]")
    elif rest:
        findings.warn(number, name, "", f"{quoted(rest)} after a section header; ignored", "a comment on a line of its own")
    identity = section_id(name)
    first = document.sections.get(identity)
    if first is not None:
        return EdsSection(name, number, number, first.entries, first.repeated)  # shares the entries: what is new is added there
    if len(document.sections) >= MAX_SECTIONS:
        raise FileError(document.path, (Problem(number, "", "too many sections", f"at most {MAX_SECTIONS}"),))
    section = document.sections[identity] = EdsSection(name, number, number)
    return section


def _keep(document: Document, section: EdsSection | None, stripped: str, number: int, findings: Findings) -> None:
    """Add a line to its section, or note why not."""
    key, equals, value = stripped.partition("=")
    key = key.strip(BLANK)
    if section is None or not equals or not key:
        wrong = "outside any section" if section is None else "not key=value"
        findings.warn(
            number, section.name if section else "", "", f"{quoted(stripped)} is {wrong}; ignored", "key=value in a section"
        )
        return
    if " " in key or "\t" in key:
        findings.warn(number, section.name, key, f"read as {''.join(key.split())}", "a key without blanks")
    entry = EdsEntry(key, value.strip(BLANK), number)
    first = section.entries.setdefault(folded(key), entry)
    if first is entry:
        owner = document.sections[section_id(section.name)]
        if owner is section:
            section.last = number
        else:
            findings.warn(
                number,
                section.name,
                key,
                f"taken from a second [{section.name}], line {section.line}; the first is in line {owner.line}",
                "each section once",
            )
        return
    section.repeated.append(entry)
    same = first.value == entry.value
    made = "repeats" if same else f"{quoted(entry.value)} is ignored; {quoted(first.value)} is taken from"
    findings.warn(number, section.name, key, f"{made} line {first.line}", "each key once")


def _decoded(data: bytes, path: Path, findings: Findings) -> tuple[str, str]:
    """Decode a file; return its text, and the codec that restores it."""
    if len(data) > MAX_BYTES:
        raise FileError(path, (Problem(0, "", f"is larger than {MAX_BYTES >> 20} MiB", "a description of a CANopen device"),))
    for mark, codec in ((codecs.BOM_UTF16_LE, "utf-16-le"), (codecs.BOM_UTF16_BE, "utf-16-be")):
        if data.startswith(mark):
            try:
                text = data.decode(codec)
            except UnicodeDecodeError as error:
                raise FileError(
                    path, (Problem(0, "", f"begins like UTF-16, but is not ({error.reason})", "UTF-8 text"),)
                ) from error
            findings.warn(1, "", "", "read as UTF-16", "UTF-8 text")
            return text, codec
    for codec, empty, letters in (
        ("utf-16-le", data[1:_SAMPLE:2], data[:_SAMPLE:2]),
        ("utf-16-be", data[:_SAMPLE:2], data[1:_SAMPLE:2]),
    ):
        if len(empty) > 2 and not any(empty) and all(letters) and len(data) % 2 == 0:  # no text has a NUL at every other place
            with contextlib.suppress(UnicodeDecodeError):
                text = data.decode(codec)
                findings.warn(1, "", "", "is UTF-16 without a byte order mark; read as UTF-16", "UTF-8 text")
                return text, codec
    try:
        return data.decode("utf-8"), "utf-8"
    except UnicodeDecodeError as error:
        line = len(re.findall(rb"\r\n|\r|\n", data[: error.start])) + 1
        codec = next(codec for codec in _code_pages(data))
        text = data.decode(codec)
        findings.warn(line, "", "", f"byte 0x{data[error.start]:02X} is not UTF-8; the file is read as {codec}", "UTF-8 text")
        return text, codec


def _code_pages(data: bytes) -> Iterator[str]:
    """Yield the likely single-byte code pages; the last accepts any byte."""
    try:
        text = data.decode("cp1252")
    except UnicodeDecodeError:
        pass
    else:
        # Windows has punctuation where DOS has letters: “ between two letters is an ö of DOS.
        yield "cp850" if _NEVER_LETTERS.search(text) else "cp1252"
    yield "cp850" if _NEVER_LETTERS.search(data.decode("latin-1")) else "latin-1"
