"""Docstrings name the thing at once, and functions of many parameters explain each of them."""

import ast
import functools
import re
from pathlib import Path

import pytest

PROJECT = Path(__file__).parents[1]
PACKAGES = ("drive_profiles", "hil", "plant_emulator")
RELATIVE = re.compile(r"(?:What|How|Where|Of|As|Which|Who|Whether|When|Why)\b", re.IGNORECASE)
SHORT = 5
MANY = 4


def room_of(path):
    return ".".join(path.parts[: min(2, len(path.parts) - 1)])


PATHS = [path.relative_to(PROJECT) for package in PACKAGES for path in sorted((PROJECT / package).rglob("*.py"))]
ROOMS = sorted(set(map(room_of, PATHS)))


@functools.cache
def modules(room):
    """Path and tree of every module of a room, parsed once."""
    paths = [path for path in PATHS if room_of(path) == room]
    return tuple((path, ast.parse((PROJECT / path).read_text(encoding="utf-8"))) for path in paths)


def docstrings(tree):
    """All docstrings: of module, classes and functions, and the strings below an assignment."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            text = ast.get_docstring(node)
            if text:
                yield text
            for before, after in zip(node.body, node.body[1:], strict=False):
                if isinstance(before, ast.Assign | ast.AnnAssign) and isinstance(after, ast.Expr):
                    value = after.value
                    if isinstance(value, ast.Constant) and isinstance(value.value, str):
                        yield value.value


def attribute_lines(text):
    """The first line of each attribute in `Attributes:`, without its name."""
    _, _, section = text.partition("\nAttributes:\n")
    for line in section.splitlines():
        if line and not line.startswith(" "):
            return
        match = re.fullmatch(r" {4}[\w`*., ]+: (.*)", line)
        if match is not None:
            yield match[1]


def is_short_and_relative(line):
    return RELATIVE.match(line) is not None and len(line.split()) <= SHORT


def short_and_relative(tree):
    for text in docstrings(tree):
        yield from filter(is_short_and_relative, (text.strip().split("\n")[0], *attribute_lines(text)))


def is_command(path, function):
    """True for commands of a command line, whose options carry their help."""
    annotations = [ast.unparse(each.annotation) for each in arguments(function) if each.annotation is not None]
    return "cli" in path.parts and any("typer." in each or each.endswith("Option") for each in annotations)


def arguments(function):
    given = function.args
    named = [*given.posonlyargs, *given.args, *given.kwonlyargs]
    return [each for each in named if each.arg not in {"self", "cls"}]


def is_overload(function):
    return any(ast.unparse(each) == "overload" for each in function.decorator_list)


def public_functions(body, prefix=""):
    for node in body:
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            yield from public_functions(node.body, f"{prefix}{node.name}.")
        elif isinstance(node, ast.FunctionDef) and not node.name.startswith("_") and not is_overload(node):
            yield f"{prefix}{node.name}", node


def without_args(path, tree):
    module = ".".join(path.with_suffix("").parts[2:]) or path.stem
    for name, function in public_functions(tree.body):
        text = ast.get_docstring(function) or ""
        if len(arguments(function)) >= MANY and "Args:\n" not in text and not is_command(path, function):
            yield f"{module}:{name}"


@pytest.mark.slow
@pytest.mark.parametrize("room", ROOMS)
def test_no_short_docstring_begins_with_a_relative_word(room):
    lines = [line for path, tree in modules(room) for line in short_and_relative(tree)]
    assert lines == []


@pytest.mark.slow
@pytest.mark.parametrize("room", ROOMS)
def test_public_functions_of_four_parameters_explain_them(room):
    names = {name for path, tree in modules(room) for name in without_args(path, tree)}
    assert names == set()


@pytest.mark.parametrize(
    ("line", "is_bad"),
    [
        ("Of the signal.", True),
        ("What came of it.", True),
        ("As of the last cycle.", True),
        ("Whether it is one", True),
        ("Off-line copy of it.", False),
        ("Name of the signal.", False),
        ("Where the master has gone, the drive stops by itself.", False),
    ],
)
def test_the_count_sees_short_relative_openings_only(line, is_bad):
    assert is_short_and_relative(line) is is_bad


def test_the_count_sees_modules_classes_functions_and_attributes():
    source = '''
"""What it is."""
LIMIT = 3
"""Of the axis."""
class Axis:
    """An axis.

    Attributes:
        node: Of the drive.
        name (str): As given.
        period_s: Period of the law, s.

    Raises:
        ValueError: Of no use.
    """
    def turn(self):
        """How it turns.

        More words.
        """
'''
    assert sorted(short_and_relative(ast.parse(source))) == ["How it turns.", "Of the axis.", "Of the drive.", "What it is."]


def test_a_function_of_four_parameters_without_args_is_seen_and_a_command_is_not():
    source = '''
def law(a, b, *, c, d): "Compute."
def other(a, b, c): "Compute."
def command(a: BusOption, b, c, d): "Do it."
def _private(a, b, c, d): "Compute."
class Law:
    def step(self, a, b, c, d):
        """Step.

        Args:
            a: First.
        """
    def back(self, a, b, c, d): "Step."
'''
    tree = ast.parse(source)
    assert list(without_args(Path("hil/control/law.py"), tree)) == ["law:law", "law:command", "law:Law.back"]
    assert list(without_args(Path("hil/cli/law.py"), tree)) == ["law:law", "law:Law.back"]
