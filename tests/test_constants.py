"""A number has one name in a package, and a name one number; what is allowed beside that says why."""

import ast
import re
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

EXIT = "exit statuses of commands, beside those that they share"
FRAME = "each file writes down the frame, object or file that it reads"
ALLOWED = {
    "hil": {
        "EXIT_FILE": EXIT,
        "EXIT_INTERNAL": EXIT,
        "EXIT_INTERRUPTED": EXIT,
        "EXIT_SDO": EXIT,
        "EXIT_USAGE": EXIT,
        "FEWEST": "samples of a window in a figure, and periods of an excitation: no relation",
        "SCHEMA": "each kind of result.json counts its own",
        "SPEED_LOWPASS_HZ": "of the law, forwards; of the analysis, forwards and backwards",
    },
    "drive_profiles": {
        "MAX_BYTES": "each kind of file has its own bound",
        "TWO_PI": "the circle",
        "_POLL_S": "how often a bus and a device look: two loops that may part",
    },
    "plant_emulator": {
        "COB_ID": FRAME,
        "DEVICE_TYPE": "each node's own",
        "ERROR_BEHAVIOUR": FRAME,
        "EXIT_FILE": EXIT,
        "EXIT_USAGE": EXIT,
        "MAX_BACKLOG_BYTES": "of a TCP connection, and of a pseudo-terminal",
        "PRODUCT_CODE": "each node's own",
        "SECOND": "nanoseconds in one: a unit",
        "SHOWN": "rows of a table, and lines of a figure",
        "TURN_FRAMES": "frames that each server of a bus moves before it lets another in",
        "_IDENTITY": FRAME,
        "_INT16": FRAME,
        "_LENGTH": FRAME,
        "_LIMIT": FRAME,
        "_NEVER": "an instant beyond all others",
        "_NS_PER_MS": "a unit",
    },
}


def is_number(node: ast.expr) -> bool:
    """Whether an expression is made of numbers alone: 0x80, -1.0, 2 ** 15 - 1, (2, 3, 5)."""
    match node:
        case ast.Constant(value=value):
            return isinstance(value, int | float) and not isinstance(value, bool)
        case ast.UnaryOp(operand=operand):
            return is_number(operand)
        case ast.BinOp(left=left, right=right):
            return is_number(left) and is_number(right)
        case ast.Tuple(elts=parts):
            return bool(parts) and all(map(is_number, parts))
        case ast.Attribute(value=ast.Name(id="math")):
            return True
    return False


def numbers(module: ast.Module) -> Iterator[str]:
    """Names to which a module gives a number at its top level."""
    for statement in module.body:
        if isinstance(statement, ast.AnnAssign) and statement.value is not None and isinstance(statement.target, ast.Name):
            pairs: list[tuple[ast.expr, ast.expr]] = [(statement.target, statement.value)]
        elif isinstance(statement, ast.Assign):
            (target, *_), value = statement.targets, statement.value
            both = isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple)
            pairs = list(zip(target.elts, value.elts, strict=True)) if both else [(target, value)]  # type: ignore[attr-defined]
        else:
            continue
        yield from (target.id for target, value in pairs if isinstance(target, ast.Name) and is_number(value))


@pytest.mark.ci
@pytest.mark.parametrize("package", sorted(ALLOWED))
def test_no_two_modules_of_a_package_give_one_name_to_numbers_of_their_own(package: str) -> None:
    found: dict[str, list[str]] = defaultdict(list)
    for path in sorted((ROOT / package).rglob("*.py")):
        for name in numbers(ast.parse(path.read_text(encoding="utf-8"))):
            found[name].append(str(path.relative_to(ROOT)))
    twice = {name: where for name, where in found.items() if len(where) > 1 and name not in ALLOWED[package]}
    assert not twice, "import the constant, or name what differs"


def test_the_scan_sees_numbers_however_they_are_written() -> None:
    text = 'A = 4.0\nB, C = 1, 2\nD: int = -3\nE = (2, 3, 5)\nF = 2.0 * math.pi\nG = "4"\nH = f(4)\nJ = True\nK = (1, "a")\n'
    assert list(numbers(ast.parse(text))) == ["A", "B", "C", "D", "E", "F"]


KIND = re.compile(r"(Bound|Probability|Accuracy|Measured( with .*?)?): ", re.DOTALL)
"""First words of what stands behind a constant: what nature, a standard or a data sheet allows; a level of confidence; the result
of a measurement, which it names; and a step, a grid or a tolerance with the error that it leaves.

*A factor of 2* says what a division and a multiplication by √2 change at most, in standard errors if nothing else is named, on
the drawn robots 10700, 10712, 10730 and 10735; a plant's fit on the last three, since the lag of the first lies at its bound."""
MOST_CONSTANTS = {"hil/design": (231, 10), "hil/experiments": (177, 21)}
"""Numbers at the top of a package's modules, and how many of them are of no kind, so somebody's choice: neither may rise."""


def explained(module: ast.Module) -> Iterator[tuple[str, str]]:
    """Names to which a module gives a number, and the sentences behind it."""
    for statement, after in zip(module.body, [*module.body[1:], None], strict=True):
        says = after.value.value if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant) else ""
        yield from ((name, str(says)) for name in numbers(ast.Module([statement], [])))


def constants(package: str) -> Iterator[tuple[str, str, dict[str, str]]]:
    """Names and sentences of a package's constants, each with all of its module."""
    for path in sorted((ROOT / package).rglob("*.py")):
        found = dict(explained(ast.parse(path.read_text(encoding="utf-8"))))
        yield from ((name, says, found) for name, says in found.items())


@pytest.mark.ci
@pytest.mark.parametrize("package", sorted(MOST_CONSTANTS))
def test_estimates_and_judgements_rest_on_no_more_constants_than_before(package: str) -> None:
    found, (most, most_others) = list(constants(package)), MOST_CONSTANTS[package]
    assert len(found) <= most, "derive it, or let it replace another one"
    assert not [name for name, says, _ in found if not says], "say what it is"
    others = [name for name, says, _ in found if not KIND.match(says)]
    assert len(others) <= most_others, "begin with Bound, Probability, Measured or Accuracy, and a colon"


@pytest.mark.ci
@pytest.mark.parametrize("package", sorted(MOST_CONSTANTS))
def test_a_measured_constant_names_its_measurement(package: str) -> None:
    """It has a number of robots, recordings or the like, or names a constant of its module that was measured with it."""
    nameless = []
    for name, says, module in constants(package):
        same = re.match(r"Measured with `(\w+)`", says)
        told = module.get(same[1], "") if same else says
        if says.startswith("Measured") and not (
            re.search(r"\b(robot|recording|ramp|gear|drive|arm)s?\b|docs/", told) and re.search(r"\d", told)
        ):
            nameless.append(name)
        assert all((ROOT / page).is_file() for page in re.findall(r"docs/[\w-]+\.md", says)), f"{name} names a page that is not"
    assert not nameless, "name the robots, the recordings or the page that gave it"
