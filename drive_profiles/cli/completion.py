"""Completion in the shell.

It offers names of profiles, robots and objects, axes of a bench file, and node-IDs; the shell completes all else.

A completer reads small files only, loads neither pydantic nor numpy, talks to no bus, and is silent where something is wrong.
Where no name fits, nothing is offered, and the shell goes on with file names.
"""

import contextlib
import io
import os
import re
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import typer

from drive_profiles.errors import DriveProfileError
from drive_profiles.files.reading import read_file
from drive_profiles.standard.objects import OBJECTS

Completer = Callable[[typer.Context, str], list[str]]

_FOLDER = Path(__file__).parents[1] / "vendors"
_MOST_BYTES = 1 << 20
_MOST_FILES = 50
_SECTION = re.compile(r"^\s*\[([0-9A-F]{4})(?:sub([0-9A-F]{1,2}))?\]", re.IGNORECASE | re.MULTILINE)
_SEPARATORS = re.compile("[=:]+")


def profile_names() -> list[str]:
    """Return the names of the package's profiles."""
    return sorted(path.stem for path in _FOLDER.glob("*.toml"))


def profiles_beginning(begun: str) -> list[str]:
    """Return the profiles, or after a slash products, beginning with a text."""
    family, slash, _ = begun.partition("/")
    names = profile_names()
    if slash and family in names:
        document = _document(_FOLDER / f"{family}.toml")
        products = [document["identity"].get("product"), *_further(document)]
        names = [f"{family}/{product}" for product in products if product]
    return [name for name in names if name.startswith(begun)]


def names_or_files(beginning: Callable[[str], Iterable[str]], *suffixes: str) -> Completer:
    """Return a completer of names, and of files beside them.

    If no name fits, it offers nothing, and the shell's own completion takes over.
    """

    def complete(ctx: typer.Context, incomplete: str) -> list[str]:
        fitting = list(beginning(incomplete))
        return fitting and [*fitting, *(path.name for path in _files(suffixes) if path.name.startswith(incomplete))]

    return complete


complete_profiles = names_or_files(profiles_beginning, ".toml")
SHIPPED = {"reference": "reference.toml", "reference-arm": "reference_arm.toml"}
"""Robots and benches that come with the packages: file of each by its name, in the folder of its own package."""
complete_reference = names_or_files(lambda begun: [name for name in SHIPPED if name.startswith(begun)], ".toml")


def complete_objects(ctx: typer.Context, incomplete: str) -> list[str]:
    """Complete names of parameters, or after a digit addresses, also of --eds."""
    known = _objects(ctx.params)
    if not incomplete[:1].isdigit():
        return sorted(name for name in known if name.startswith(incomplete))
    prefix = "0x" if incomplete.lower().startswith("0x") else ""
    addresses = {address for address in known.values() if address} | _eds_addresses(ctx.params.get("eds"))
    return sorted(f"{prefix}{address}" for address in addresses if f"{prefix}{address}".startswith(incomplete))


def complete_values(ctx: typer.Context, incomplete: str) -> list[str]:
    """Complete names of objects, each with an equals sign."""
    return [] if "=" in incomplete else [f"{name}=" for name in complete_objects(ctx, incomplete)]


class AxisCompleter:
    """Completers of axes, from the command line's bench or robot file.

    The files of `SHIPPED` are in a folder that each tool has of its own.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def one(self, ctx: typer.Context, incomplete: str) -> list[str]:
        """Complete the number of an axis."""
        return [number for number in self._numbers(ctx.params) if number.startswith(incomplete)]

    def several(self, ctx: typer.Context, incomplete: str) -> list[str]:
        """Complete numbers separated by commas, each once."""
        return complete_list(lambda: self._numbers(ctx.params))(ctx, incomplete)

    def with_profile(self, ctx: typer.Context, incomplete: str) -> list[str]:
        """Complete AXIS=PROFILE: first the axes, then the profile names."""
        axis, equals, begun = incomplete.partition("=")
        if not equals:
            return [f"{number}=" for number in self._numbers(ctx.params) if number.startswith(axis)]
        return [f"{axis}={name}" for name in profiles_beginning(begun)]

    def _numbers(self, given: Mapping[str, Any]) -> list[str]:
        named = given.get("bench_file") or given.get("robot")
        numbers: set[str] = set()
        for name in filter(None, named if isinstance(named, list | tuple) else [named]):
            shipped = SHIPPED.get(str(name))
            axes = _document(Path(name) if shipped is None else self._folder / shipped).get("axis", {})
            numbers |= {number for number in axes if number.isdigit()} if isinstance(axes, dict) else set()
        return sorted(numbers, key=int)


def complete_nodes(ctx: typer.Context, incomplete: str) -> list[str]:
    """Complete node-IDs of the bench and robot files in this folder."""
    found: dict[str, None] = {}
    for path in _files((".toml",)):
        for table in _tables(_document(path)):
            if isinstance(number := table.get("node_id"), int):
                found.setdefault(str(number))
    return [number for number in found if number.startswith(incomplete)]


def complete_list(names: Callable[[], Iterable[str]]) -> Completer:
    """Return a completer of names with commas between."""

    def complete(ctx: typer.Context, incomplete: str) -> list[str]:
        *before, last = incomplete.split(",")
        return [",".join([*before, name]) for name in names() if name.startswith(last) and name not in before]

    return complete


def _objects(given: Mapping[str, Any]) -> dict[str, str]:
    """Return the addresses of the standard's and the profiles' objects by name."""
    chosen, wanted = given.get("profile"), ""
    named = [_FOLDER / f"{name}.toml" for name in profile_names()]
    if chosen and chosen in profiles_beginning(chosen):
        family, _, wanted = chosen.partition("/")
        named = [_FOLDER / f"{family}.toml"]
    elif chosen:
        named = [Path(chosen)]
    known = {name: f"{index:04X}:{subindex:X}" for (index, subindex), (name, *_) in OBJECTS.items()}
    for path in named:
        document = _document(path)
        parameters = document.get("parameters", {})
        other = next(each for each in document["product"] if each["name"] == wanted) if wanted in _further(document) else {}
        for name, entry in (parameters | other.get("parameters", {})).items() if isinstance(parameters, dict) else ():
            whole = parameters.get(name, {}) | entry if isinstance(entry, dict) else {}
            if name not in other.get("absent", ()):
                known[name] = f"{whole['index']:04X}:{whole.get('subindex', 0):X}" if isinstance(whole.get("index"), int) else ""
    return known


def _further(document: Mapping[str, Any]) -> list[str]:
    """Return the names of a family's further products."""
    products = document.get("product")
    return [each["name"] for each in products if "name" in each] if isinstance(products, list) else []


def _eds_addresses(path: Path | None) -> set[str]:
    if path is None:
        return set()
    text = _text(path, 4 * _MOST_BYTES)
    return {f"{index.upper()}:{(subindex or '0').upper()}" for index, subindex in _SECTION.findall(text)}


def _tables(document: Mapping[str, Any]) -> Iterator[Mapping[str, Any]]:
    """Yield the tables of a bench or robot file that may name a node."""
    for key, value in document.items():
        if isinstance(value, dict):
            yield from (each for each in ([value] if key != "axis" else value.values()) if isinstance(each, dict))


def _files(suffixes: tuple[str, ...]) -> list[Path]:
    """Return the working directory's first files with a given suffix."""
    with contextlib.suppress(OSError):
        return sorted(path for path in Path().iterdir() if path.suffix in suffixes and path.is_file())[:_MOST_FILES]
    return []


def _document(path: Path) -> dict[str, Any]:
    with contextlib.suppress(tomllib.TOMLDecodeError, RecursionError):
        return tomllib.loads(_text(path, _MOST_BYTES))
    return {}


def _text(path: Path, most: int) -> str:
    try:
        return read_file(path, "a file", max_bytes=most).decode("utf-8", errors="replace")
    except (DriveProfileError, OSError):
        return ""


# -- bash ---------------------------------------------------------------------------------------------------------------


def joined(words: list[str], current: int) -> tuple[list[str], int, str]:
    """Join the words that bash splits at `=` and `:`.

    Returned are the words as typed, the index of the current one, and the part of it that bash keeps.

    >>> joined(["serve", "--drive", "2", "=", "emu"], 4)
    (['serve', '--drive', '2=emu'], 2, '2=')
    """
    whole: list[str] = []
    at, kept, is_open = 0, "", False
    for number, word in enumerate(words):
        is_separator = _SEPARATORS.fullmatch(word) is not None
        if whole and (is_separator or is_open):
            before = whole[-1]
            whole[-1] += word
        else:
            before = ""
            whole.append(word)
        is_open = is_separator
        if number == current:
            at, kept = len(whole) - 1, before + (word if is_separator else "")
            whole, is_open = whole[: at + 1], False
            break
    return whole, at, kept


@contextlib.contextmanager
def bash_words() -> Iterator[None]:
    """Adapt bash's completion request and answer to words as typed."""
    asked = [name for name, value in os.environ.items() if name.endswith("_COMPLETE") and value == "complete_bash"]
    given, current = os.environ.get("COMP_WORDS"), os.environ.get("COMP_CWORD", "")
    if not asked or given is None or not current.isdigit():
        yield
        return
    words, at, kept = joined(given.split("\n"), int(current))
    os.environ["COMP_WORDS"], os.environ["COMP_CWORD"] = "\n".join(words), str(at)
    offered = io.StringIO()
    try:
        with contextlib.redirect_stdout(offered):
            yield
    finally:
        for line in offered.getvalue().splitlines():
            typer.echo(_without(kept, line))


def _without(kept: str, line: str) -> str:
    """Return an offer without the beginning that bash keeps."""
    for start in range(len(kept)):
        if line.startswith(kept[start:]):
            return line[len(kept) - start :]
    return line
