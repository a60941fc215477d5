"""The passport's file: SQLite; runs are added, none is removed."""

import math
import sqlite3
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, contextmanager
from dataclasses import astuple, dataclass, field, fields
from pathlib import Path
from typing import TypeVar

from hil.errors import FileProblemError

APPLICATION_ID = 0x48494C50
"""Mark of the file in its header, by which it is told from SQLite files of other programs."""
VERSION = 2
PATIENCE_S = 2.0
"""Time for which another program may write before that is said."""
MOST_KEPT_RUNS = 100_000
MOST_TEXT = 4000
"""Characters of a note, a name or a path."""
MOST_ORDERS = 200
"""Orders of a run."""

_TABLES = """
CREATE TABLE run (
    hash TEXT PRIMARY KEY, robot TEXT NOT NULL, axis INTEGER NOT NULL, measured_utc TEXT NOT NULL, learnt_by TEXT NOT NULL,
    note TEXT NOT NULL, temperature_c REAL, load_kg REAL, direction TEXT, top_rps REAL, posture_deg TEXT, emulated INTEGER,
    source TEXT NOT NULL, joint_low_deg REAL, joint_high_deg REAL, pole_pairs INTEGER, slots INTEGER, seen_by TEXT
) STRICT;
CREATE TABLE line (
    hash TEXT NOT NULL REFERENCES run(hash), motor_order REAL NOT NULL, a_arcsec REAL NOT NULL, a_error_arcsec REAL NOT NULL,
    phi_deg REAL NOT NULL, phi_error_deg REAL NOT NULL, PRIMARY KEY (hash, motor_order)
) STRICT;
CREATE TRIGGER run_stays BEFORE DELETE ON run BEGIN SELECT RAISE(ABORT, 'a passport keeps every run'); END;
CREATE TRIGGER line_stays BEFORE DELETE ON line BEGIN SELECT RAISE(ABORT, 'a passport keeps every run'); END;
CREATE TRIGGER run_is_fixed BEFORE UPDATE ON run BEGIN SELECT RAISE(ABORT, 'a passport changes no run'); END;
CREATE TRIGGER line_is_fixed BEFORE UPDATE ON line BEGIN SELECT RAISE(ABORT, 'a passport changes no run'); END;
CREATE TABLE side (
    hash TEXT NOT NULL REFERENCES run(hash), motor_order REAL NOT NULL, a_forward_arcsec REAL NOT NULL,
    a_backward_arcsec REAL NOT NULL, a_sigmas REAL NOT NULL, phi_turn_deg REAL NOT NULL, phi_sigmas REAL NOT NULL,
    PRIMARY KEY (hash, motor_order)
) STRICT;
CREATE TRIGGER side_stays BEFORE DELETE ON side BEGIN SELECT RAISE(ABORT, 'a passport keeps every run'); END;
CREATE TRIGGER side_is_fixed BEFORE UPDATE ON side BEGIN SELECT RAISE(ABORT, 'a passport changes no run'); END;
"""


class PassportFileError(FileProblemError):
    """The file of a passport cannot be used."""


@dataclass(frozen=True)
class OrderLine:
    """One order of a run.

    Attributes:
        a_error_arcsec: Its standard error; 0 if it is not known.
    """

    order: float
    a_arcsec: float
    a_error_arcsec: float
    phi_deg: float
    phi_error_deg: float


@dataclass(frozen=True)
class OrderSides:
    """One order of a run, in either direction alone.

    Attributes:
        a_sigmas: Difference of both amplitudes over its standard error, not below 0.
        phi_turn_deg: Phase forwards less the phase backwards, −180° … 180°.
        phi_sigmas: Its size over its standard error.
    """

    order: float
    a_forward_arcsec: float
    a_backward_arcsec: float
    a_sigmas: float
    phi_turn_deg: float
    phi_sigmas: float


@dataclass(frozen=True)
class PassportRun:
    """One identification of one gear.

    Attributes:
        direction: `forward` or `backward`; None for both together.
        joint_low_deg: Lower end of the joint's way; None if it is not known.
        pole_pairs: Pole pairs of the motor, from the bench file.
        seen_by: `motion` if the motor's own motion was measured and removed, `torque` for its torque.
        sides: Orders in either direction alone, those too that are not lines.
    """

    content: str
    robot: str
    axis: int
    measured_utc: str
    learnt_by: str
    note: str
    temperature_c: float | None = None
    load_kg: float | None = None
    direction: str | None = None
    top_rps: float | None = None
    joint_low_deg: float | None = None
    joint_high_deg: float | None = None
    pole_pairs: int | None = None
    slots: int | None = None
    seen_by: str | None = None
    emulated: bool | None = None
    source: str = ""
    lines: tuple[OrderLine, ...] = field(default=())
    sides: tuple[OrderSides, ...] = field(default=())


_RUN_COLUMNS = tuple(each.name for each in fields(PassportRun) if each.name not in {"content", "lines", "sides"})


@contextmanager
def _opened(path: Path) -> Iterator[sqlite3.Connection]:
    """The file, with its tables; made if it is missing."""
    try:
        with closing(sqlite3.connect(path, timeout=PATIENCE_S, isolation_level=None)) as connection:
            connection.row_factory = sqlite3.Row
            connection.execute("PRAGMA foreign_keys = ON")
            _check(path, connection)
            yield connection
    except sqlite3.OperationalError as error:
        if "locked" in str(error) or "busy" in str(error):
            raise PassportFileError(path, "another program is writing it; wait until it ends, and try again") from error
        raise PassportFileError(path, f"cannot be used: {error}") from error
    except sqlite3.DatabaseError as error:
        raise PassportFileError(path, f"not a passport, or a damaged one: {error}; give another with --file") from error


def _check(path: Path, connection: sqlite3.Connection) -> None:
    (mark,), (version,) = (connection.execute(f"PRAGMA {name}").fetchone() for name in ("application_id", "user_version"))
    (tables,) = connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
    if mark == 0 and tables == 0:
        _make(connection)
    elif mark != APPLICATION_ID:
        raise PassportFileError(path, "an SQLite file of another program, not a passport; give another with --file")
    elif version != VERSION:
        raise PassportFileError(
            path, f"a passport of version {version}; this program knows {VERSION}: use the one that wrote it, or another --file"
        )
    elif connection.execute("PRAGMA quick_check").fetchone()[0] != "ok":
        raise PassportFileError(path, "damaged; restore it from your last back-up")


def _make(connection: sqlite3.Connection) -> None:
    """Make the tables, unless another program has just done it."""
    connection.execute("BEGIN IMMEDIATE")
    if connection.execute("PRAGMA user_version").fetchone()[0] == 0:
        for statement in filter(None, (text.strip() for text in _TABLES.split(";\n"))):
            connection.execute(statement if statement.endswith("END") else f"{statement};")
        connection.execute(f"PRAGMA application_id = {APPLICATION_ID}")
        connection.execute(f"PRAGMA user_version = {VERSION}")
    connection.execute("COMMIT")


def add(path: Path, runs: Iterable[PassportRun]) -> int:
    """Add runs to a passport; return the number of new ones.

    In one transaction.

    Raises:
        PassportFileError: The file cannot be used, or is full.
    """
    with _opened(path) as connection:
        connection.execute("BEGIN IMMEDIATE")
        (before,) = connection.execute("SELECT count(*) FROM run").fetchone()
        for run in runs:
            _put(connection, run)
        (after,) = connection.execute("SELECT count(*) FROM run").fetchone()
        if after > MOST_KEPT_RUNS:
            connection.execute("ROLLBACK")
            raise PassportFileError(
                path, f"it would hold {after} runs; at most {MOST_KEPT_RUNS} are allowed; give another --file"
            )
        connection.execute("COMMIT")
    return int(after - before)


def _put(connection: sqlite3.Connection, run: PassportRun) -> None:
    """Add one run."""
    row = {"hash": run.content, **{name: getattr(run, name) for name in _RUN_COLUMNS}}
    row["emulated"] = None if run.emulated is None else int(run.emulated)
    names = ", ".join(row)
    sql = f"INSERT OR IGNORE INTO run ({names}) VALUES ({', '.join('?' * len(row))})"  # noqa: S608 - names of this file alone
    if connection.execute(sql, tuple(row.values())).rowcount == 1:
        lines = [(run.content, *astuple(each)) for each in run.lines]
        connection.executemany("INSERT INTO line VALUES (?, ?, ?, ?, ?, ?)", lines)
    sides = [(run.content, *astuple(each)) for each in run.sides]
    connection.executemany("INSERT OR IGNORE INTO side VALUES (?, ?, ?, ?, ?, ?, ?)", sides)


def read(path: Path) -> list[PassportRun]:
    """All runs of a passport, by robot, axis and date.

    Raises:
        PassportFileError: The file cannot be used.
    """
    with _opened(path) as connection:
        lines = _by_run(connection, "line", OrderLine)
        sides = _by_run(connection, "side", OrderSides)
        rows = connection.execute("SELECT * FROM run ORDER BY robot, axis, measured_utc, hash").fetchall()
    return [_run(row, tuple(lines.get(row["hash"], ())), tuple(sides.get(row["hash"], ()))) for row in rows]


_Kept = TypeVar("_Kept")


def _by_run(connection: sqlite3.Connection, table: str, kind: Callable[..., _Kept]) -> dict[str, list[_Kept]]:
    found: dict[str, list[_Kept]] = {}
    for content, *numbers in connection.execute(f"SELECT * FROM {table} ORDER BY hash, motor_order"):  # noqa: S608 - a fixed name
        if all(math.isfinite(number) for number in numbers):
            found.setdefault(content, []).append(kind(*numbers))
    return found


def _run(row: sqlite3.Row, lines: tuple[OrderLine, ...], sides: tuple[OrderSides, ...]) -> PassportRun:
    values = {name: row[name] for name in _RUN_COLUMNS}
    values["emulated"] = None if row["emulated"] is None else bool(row["emulated"])
    return PassportRun(content=row["hash"], **values, lines=lines, sides=sides)
