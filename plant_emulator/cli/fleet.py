"""plant-emulator fleet: robots drawn by seed, with bench files."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from drive_profiles.cli.application import command
from drive_profiles.cli.console import fail, table
from plant_emulator.cli.console import EmulatorExitStatus, ends, exit_on_error, exit_on_value_error

if TYPE_CHECKING:
    from plant_emulator.trials.rows import Row, Value

EPILOG = ends(FILE="a file already exists, or cannot be written")

KindName = Literal["linear", "real", "any", "both"]

SeedsOption = Annotated[str, typer.Option("--seeds", "--seed", metavar="SEEDS", help="Seeds of the robots: 7, 1-40, 1-40,50.")]
KindOption = Annotated[
    KindName,
    typer.Option(
        "--kind",
        help="Gears: linear; real (hysteresis up to 2 N·m, softness, current lag); any (the same, up to 5 N·m); "
        "both (linear for odd seeds, real for even ones).",
    ),
]
ArmsOption = Annotated[bool, typer.Option("--arms", help="Whole arms of six coupled axes, instead of single axes.")]
UrdfOption = Annotated[
    Path | None,
    typer.Option("--urdf", help="The arm of this URDF file, for which motors, gears and transmission errors are drawn."),
]
HomeOption = Annotated[
    str | None,
    typer.Option("--home-deg", metavar="ANGLES", help="With --urdf: joint angles at home, from the base on: 0,-90,90,0,90,0."),
]
TipOption = Annotated[
    str | None,
    typer.Option("--tip-link", help="With --urdf: the link of the tip. Default: the last link, if only one ends the arm."),
]
OutOption = Annotated[Path, typer.Option("--out", help="Folder for the files; created if missing.")]

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
ARM_COLUMNS = (
    ("mass kg", "mass_kg", 1.0),
    ("payload kg", "payload_kg", 1.0),
    ("reach m", "reach_m", 1.0),
    ("modes at home Hz", "mode_1_hz", 1.0),
    ("", "mode_2_hz", 1.0),
    ("", "mode_3_hz", 1.0),
)


@command("stable", epilog=EPILOG, hidden=True)  # the old name
@command(epilog=EPILOG)
def fleet(
    seeds: SeedsOption,
    out: OutOption,
    kind: KindOption = "both",
    arms: ArmsOption = False,
    urdf: UrdfOption = None,
    home_deg: HomeOption = None,
    tip_link: TipOption = None,
) -> None:
    """Draw robots by seed, and write them with bench files.

    The ranges are those of industrial robots; the bench files contain no knowledge of the drawn values.

    Equal seeds give equal robots. `robots.csv` lists the drawn values, a line per robot. Robots in the folder are never replaced.

    Examples:
        plant-emulator fleet --seeds 7 --out fleet

        plant-emulator fleet --seeds 1-40 --kind real --out fleet

        plant-emulator fleet --seeds 1-10 --arms --out arms

        plant-emulator fleet --seeds 1 --urdf arm.urdf --home-deg 0,-60,100,0,50,0 --out mine
    """
    from drive_profiles.files.safefile import write_atomically
    from plant_emulator.rehearsal.many.seeds import seeds_of
    from plant_emulator.trials.rows import csv_text

    home = _home(home_deg, tip_link, urdf)
    with exit_on_error():
        with exit_on_value_error():
            named = seeds_of(seeds)
        files = {out / f"{name}-{seed}.toml" for name in ("robot", "bench") for seed in named}
        there = sorted(str(path) for path in files if path.exists())
        if there:
            more = f" and {len(there) - 1} more" if len(there) > 1 else ""
            exist = "exist" if more else "exists"
            what = f"{there[0]}{more} already {exist}; nothing was written; choose other seeds or another folder"
            raise fail(what, EmulatorExitStatus.FILE)
        before = _listed(out)
        rows: list[Row] = []
        texts: dict[str, str] = {}
        for seed in named:
            if urdf is None:
                robot, bench, row = _drawn(seed, kind, arms)
            else:
                with exit_on_value_error():
                    robot, bench, row = _driven(seed, urdf, out, home, tip_link)
            texts[f"robot-{seed}.toml"], texts[f"bench-{seed}.toml"] = robot, bench
            rows.append(row)
        for name, text in texts.items():
            write_atomically(out / name, text.encode())
        write_atomically(out / "robots.csv", csv_text([*before, *rows]).encode(), force=bool(before))
    first, columns = (("seed",), ARM_COLUMNS) if arms or urdf is not None else (("seed", "kind"), COLUMNS)
    cells = [(*(str(row[name]) for name in first), *(_number(row[name], factor) for _, name, factor in columns)) for row in rows]
    table("", (*first, *(head for head, *_ in columns)), cells)
    what = "one robot and its bench file" if len(rows) == 1 else f"{len(rows)} robots and their bench files"
    typer.echo(f"{what} in {out}; robots.csv lists the drawn values", err=True)


def _listed(out: Path) -> "list[Row]":
    from plant_emulator.trials.rows import read_rows

    path = out / "robots.csv"
    if not path.exists():
        return []
    rows = read_rows(path)
    if rows and all((out / f"robot-{row.get('seed')}.toml").exists() for row in rows):
        return rows
    what = f"{path} is not the list of the robots in {out}; nothing was written; choose another folder"
    raise fail(what, EmulatorExitStatus.FILE)


def _home(home_deg: str | None, tip_link: str | None, urdf: Path | None) -> tuple[float, ...]:
    if urdf is None and (home_deg, tip_link) != (None, None):
        raise typer.BadParameter("needs --urdf; other arms are drawn", param_hint="--home-deg, --tip-link")
    try:
        return tuple(float(each) for each in home_deg.split(",")) if home_deg else ()
    except ValueError:
        raise typer.BadParameter(
            f"{home_deg!r} is not a list of angles; expected e.g. 0,-90,90,0,90,0", param_hint="--home-deg"
        ) from None


def _driven(seed: int, urdf: Path, out: Path, home_deg: tuple[float, ...], tip_link: str | None) -> "tuple[str, str, Row]":
    """Return robot file, bench file and facts of a URDF arm."""
    from plant_emulator.robots.blank_bench import blank_bench, file_text
    from plant_emulator.robots.drawn_arms import arm_facts, draw_drives

    robot = draw_drives(urdf.name, urdf.parent, home_deg, seed, tip_link)
    read = robot.with_links_read(urdf.parent)
    arm = robot.arm.model_copy(update={"urdf": os.path.relpath(urdf, out)})
    text = file_text(robot.model_copy(update={"arm": arm}))
    return text, blank_bench(read, drawing=arm), {"seed": seed, **arm_facts(read)}


def _drawn(seed: int, kind: str, arms: bool) -> "tuple[str, str, Row]":
    from plant_emulator.rehearsal.many.one import drawn, facts
    from plant_emulator.robots.blank_bench import blank_bench, file_text
    from plant_emulator.robots.drawn_arms import arm_facts, draw_arm

    if not arms:
        robot, bench = drawn(seed, kind)
        return file_text(robot), bench, facts(seed, kind)
    arm = draw_arm(seed)
    return file_text(arm), blank_bench(arm), {"seed": seed, **arm_facts(arm)}


def _number(value: "Value", factor: float) -> str:
    return f"{factor * value:.3g}" if isinstance(value, int | float) else "–"
