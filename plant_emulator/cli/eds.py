"""plant-emulator eds: the EDS files of the emulated nodes."""

from pathlib import Path
from typing import Annotated

import typer

from drive_profiles.cli.application import command
from drive_profiles.cli.completion import complete_reference
from drive_profiles.cli.console import fail, numbered
from plant_emulator.cli.console import DriveOption, EmulatorExitStatus, ends, exit_on_error, exit_on_value_error

EDS_EPILOG = ends(FILE="a bad robot file, or the files cannot be written")


@command(epilog=EDS_EPILOG)
def eds(
    out: Annotated[Path, typer.Option("--out", help="Folder for the files; created if missing.")],
    robot: Annotated[
        str | None,
        typer.Option(
            "--robot",
            help="One file per node of this robot (a file or `reference`), instead of one per kind.",
            autocompletion=complete_reference,
        ),
    ] = None,
    drive: DriveOption = None,
) -> None:
    """Write the EDS files of the emulated drive and accelerometer.

    Tools that configure CANopen nodes read them.

    With --robot there is a file for every node: axis2.eds and so on, accelerometer.eds. Each states its node's serial
    number, motor, gains and, of a maker's drive, the maker's own objects.

    Examples:
        plant-emulator eds --out eds

        plant-emulator eds --robot robot.toml --drive 3=kollmorgen_akd --out eds
    """
    from plant_emulator.data_sheets import data_sheets, data_sheets_of
    from plant_emulator.robots.robot import load_robot, with_drives

    drives = numbered("--drive", drive)
    if drives and robot is None:
        raise fail("--drive needs --robot, whose axes it changes", EmulatorExitStatus.USAGE)
    with exit_on_error():
        with exit_on_value_error():
            model = None if robot is None else with_drives(load_robot(robot), drives)
        with exit_on_value_error(robot):
            sheets = data_sheets() if model is None else data_sheets_of(model)
        out.mkdir(parents=True, exist_ok=True)
        for name, text in sheets.items():
            path = out / name
            path.write_text(text, encoding="ascii", newline="\n")
            typer.echo(path)
