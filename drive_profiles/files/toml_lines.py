"""Line numbers of a TOML text."""

import re
import tomllib

KeyPath = tuple[str | int, ...]
"""Keys and indices of array elements, from the outermost table inwards."""

_SPACE = re.compile(r"[ \t]*")
_BLANK = re.compile(r"(?:[ \t\n]|#[^\n]*)*")
_KEY_PART = re.compile(r"""[A-Za-z0-9_-]+|"(?:\\.|[^"\\\n])*"|'[^'\n]*'""")
_STRING = re.compile(r'''"""(?:\\.|[^\\])*?"""(?:"{0,2})|\'\'\'.*?\'\'\'(?:'{0,2})|"(?:\\.|[^"\\\n])*"|'[^'\n]*\'''', re.DOTALL)
_SCALAR = re.compile(r"[^,\]}#\n]+")


def key_lines(text: str) -> dict[KeyPath, int]:
    """Return the line, from 1, of every key, table and array element.

    Paths are such as ``("axis", "2", "ate", "a2_arcsec")`` or ``("forearm_m", 1)``; of a table opened several times the first
    line counts. The text is what `tomllib` has accepted, with line feeds as line ends.
    """
    return _Scanner(text).scan()


class _Scanner:
    """Scanner that notes the line of each element of valid TOML."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.position = 0
        self.lines: dict[KeyPath, int] = {}
        self.elements: dict[KeyPath, int] = {}  # array of tables → index of the last
        self._line, self._counted = 1, 0

    def scan(self) -> dict[KeyPath, int]:
        table: KeyPath = ()
        while self._skip(_BLANK) < len(self.text):
            if self.text.startswith("[[", self.position):
                table = self._header(2)
                self.elements[table] = self.elements.get(table, -1) + 1
                table = (*table, self.elements[table])
                self._note(table)
            elif self.text[self.position] == "[":
                table = self._header(1)
            else:
                self._pair(table)
        return self.lines

    def _header(self, brackets: int) -> KeyPath:
        self.position += brackets
        path = self._key((), into_elements=True)
        self.position += brackets
        return path

    def _pair(self, table: KeyPath) -> None:
        path = self._key(table)
        self.position += 1  # the equals sign
        self._value(path)

    def _key(self, path: KeyPath, *, into_elements: bool = False) -> KeyPath:
        while True:
            if into_elements and path in self.elements:
                path = (*path, self.elements[path])
            self._skip(_SPACE)
            part = self._take(_KEY_PART)
            name = tomllib.loads(f"k={part}")["k"] if part[0] in "\"'" else part
            path = (*path, name)
            self._note(path)
            self._skip(_SPACE)
            if self.text[self.position] != ".":
                return path
            self.position += 1

    def _value(self, path: KeyPath) -> None:
        self._skip(_SPACE)
        match self.text[self.position]:
            case "[":
                self._items(path, "]")
            case "{":
                self._items(path, "}")
            case '"' | "'":
                self._take(_STRING)
            case _:
                self._take(_SCALAR)

    def _items(self, path: KeyPath, end: str) -> None:
        self.position += 1
        index = 0
        while self.text[self._skip(_BLANK)] != end:
            if end == "}":
                self._pair(path)
            else:
                self._note((*path, index))
                self._value((*path, index))
            index += 1
            if self.text[self._skip(_BLANK)] == ",":
                self.position += 1
        self.position += 1

    def _note(self, path: KeyPath) -> None:
        # Positions only grow, so lines are counted once over the whole text.
        self._line += self.text.count("\n", self._counted, self.position)
        self._counted = self.position
        self.lines.setdefault(path, self._line)

    def _skip(self, pattern: re.Pattern[str]) -> int:
        self._take(pattern)
        return self.position

    def _take(self, pattern: re.Pattern[str]) -> str:
        found = pattern.match(self.text, self.position)
        if found is None:
            raise ValueError(f"the scanner and tomllib disagree (at offset {self.position})")
        self.position = found.end()
        return found[0]
