"""plant-emulator stable: robots drawn by seed, with bench files that know nothing of them."""

# ruff: noqa: PLC0415 - the robots are imported inside the command, so that --help stays quick

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from drive_profiles.cli.console import epilog, fail, table
from plant_emulator.cli.console import EmulatorExitStatus, exit_on_error, exit_on_value_error

if TYPE_CHECKING:
    from plant_emulator.rehearsal.many.rows import Row, Value

EPILOG = epilog(
    (EmulatorExitStatus.DONE, EmulatorExitStatus.USAGE, EmulatorExitStatus.FILE, EmulatorExitStatus.INTERRUPTED),
    {EmulatorExitStatus.FILE: "a file is there already, or cannot be written"},
)

KindName = Literal["linear", "real", "any", "both"]

SeedsOption = Annotated[str, typer.Option("--seeds", "--seed", metavar="SEEDS", help="Seeds of the robots: 7, 1-40, 1-40,50.")]
KindOption = Annotated[
    KindName,
    typer.Option(
        "--kind",
        help="linear gears; real ones, with hysteresis up to 2 N·m, softness and current lag; any, up to 5 N·m; "
        "both: linear for odd seeds, real for even ones.",
    ),
]
OutOption = Annotated[Path, typer.Option("--out", help="Folder for the files; made where it is not there.")]

COLUMNS = (
    ("N", "reduction_ratio", 1.0),
    ("f_a Hz", "antiresonance_hz", 1.0),
    ("A₁ ″", "a1_arcsec", 1.0),
    ("A₂ ″", "a2_arcsec", 1.0),
    ("A₄ ″", "a4_arcsec", 1.0),
    ("encoder bits", "encoder_bits", 1.0),
    ("lag ms", "current_lag_s", 1e3),
    ("Dahl N·m", "hysteresis_nm", 1.0),
    ("soft %", "softness", 100.0),
    ("noise m/s²", "noise_m_s2", 1.0),
    ("SYNC ms", "sync_period_s", 1e3),
)


def mount(app: typer.Typer) -> None:
    """Make it `plant-emulator stable`."""
    app.command("stable", epilog=EPILOG)(stable)


def stable(seeds: SeedsOption, out: OutOption, kind: KindOption = "both") -> None:
    """Draw robots by seed from the ranges that industry's robots fill; write each with a bench file that knows nothing of it.

    Equal seeds give equal robots. `robots.csv` has what was drawn, a line per robot.

    Examples:
        plant-emulator stable --seeds 7 --out stable

        plant-emulator stable --seeds 1-40 --kind real --out stable
    """
    from drive_profiles.files.safefile import write_atomically
    from plant_emulator.rehearsal.many.one import drawn, facts
    from plant_emulator.rehearsal.many.seeds import seeds_of
    from plant_emulator.rehearsal.many.table import csv_text
    from plant_emulator.robots.writing import file_text

    with exit_on_error():
        with exit_on_value_error():
            named = seeds_of(seeds)
        files = {out / f"{name}-{seed}.toml" for name in ("robot", "bench") for seed in named} | {out / "robots.csv"}
        there = sorted(str(path) for path in files if path.exists())
        if there:
            more = f" and {len(there) - 1} more" if len(there) > 1 else ""
            raise fail(f"{there[0]}{more}: there already; nothing was written, choose another folder", EmulatorExitStatus.FILE)
        rows = []
        for seed in named:
            robot, bench = drawn(seed, kind)
            write_atomically(out / f"robot-{seed}.toml", file_text(robot).encode())
            write_atomically(out / f"bench-{seed}.toml", bench.encode())
            rows.append(facts(seed, kind))
        write_atomically(out / "robots.csv", csv_text(rows).encode())
    table("", ("seed", "kind", *(head for head, *_ in COLUMNS)), [_cells(row) for row in rows])
    typer.echo(f"{len(rows)} robots and their bench files in {out}; robots.csv has all that was drawn", err=True)


def _cells(row: "Row") -> tuple[str, ...]:
    return (str(row["seed"]), str(row["kind"]), *(_number(row[name], factor) for _, name, factor in COLUMNS))


def _number(value: "Value", factor: float) -> str:
    return f"{factor * value:.3g}" if isinstance(value, int | float) else "–"
