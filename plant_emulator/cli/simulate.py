"""plant-emulator simulate: an experiment without a bus."""

from pathlib import Path
from typing import Annotated

import typer

from drive_profiles.cli.application import command
from drive_profiles.cli.console import fail
from plant_emulator.cli.console import AXES, EmulatorExitStatus, RobotOption, ends, exit_on_error, exit_on_value_error

SIMULATE_EPILOG = ends()


@command(epilog=SIMULATE_EPILOG)
def simulate(
    out: Annotated[Path, typer.Option("--out", help="CSV file to write.")],
    robot: RobotOption = "reference",
    axis: Annotated[
        int | None,
        typer.Option("--axis", help="Constant acceleration of this axis; default: line motion.", autocompletion=AXES.one),
    ] = None,
    notch: Annotated[bool, typer.Option("--notch/--no-notch", help="With the axes' notch filters of the robot file.")] = False,
    sync_period_s: Annotated[float, typer.Option("--sync-period-s", help="Period of the set-points.")] = 0.002,
) -> None:
    """Run an experiment without CAN and write the true motion.

    The robot file must have `control` tables, except `reference`; --notch uses its `notch` tables.

    Example: plant-emulator simulate --robot robot.toml --axis 2 --notch --out axis2.csv
    """
    from plant_emulator.robots.robot import load_robot
    from plant_emulator.robots.tuning import own_tuning
    from plant_emulator.studies.simulate import axis_columns
    from plant_emulator.studies.simulate import simulate as run
    from plant_emulator.trials.rows import columns_csv

    with exit_on_error():
        model = load_robot(robot)
        own = own_tuning(robot, model)
        controls = {number: table.control for number, table in own.items() if table.control is not None}
        filters = {number: table.notch for number, table in own.items() if notch and table.notch}
        try:
            with exit_on_value_error():
                result = run(model, axis, controls=controls, notches=filters, sync_period_s=sync_period_s)
        except KeyError as error:
            place = f"axis.{error.args[0]}"
            needs = f"{robot}: {place}: no control table; a simulation needs the gains: add [{place}.control]"
            raise fail(needs, EmulatorExitStatus.FILE) from None
        tip = {f"tip_{name}_m_s2": result.tip_acceleration_m_s2[:, column] for column, name in enumerate("xyz")}
        columns = {"time_s": result.time_s} | axis_columns(result.axes, result.reference_counts, result) | tip
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_text(columns_csv(columns), encoding="ascii", newline="\n")
    typer.echo(f"{len(result.time_s)} samples in {out}")
