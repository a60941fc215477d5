"""plant-emulator simulate: an experiment without a bus."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from drive_profiles.cli.application import command
from drive_profiles.cli.console import epilog, fail
from plant_emulator.cli.console import AXES, EmulatorExitStatus, RobotOption, exit_on_error, exit_on_value_error

if TYPE_CHECKING:  # --help must not wait for them
    from plant_emulator.studies.simulate import Simulation

SIMULATE_EPILOG = epilog(
    (EmulatorExitStatus.DONE, EmulatorExitStatus.USAGE, EmulatorExitStatus.FILE, EmulatorExitStatus.INTERRUPTED)
)


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

    The robot file must have `control` tables; --notch uses its `notch` tables.

    Example: plant-emulator simulate --robot robot.toml --axis 2 --notch --out axis2.csv
    """
    from plant_emulator.robots.robot import load_robot  # noqa: PLC0415 - --help must not wait for numpy
    from plant_emulator.studies.simulate import simulate as run  # noqa: PLC0415

    with exit_on_error():
        model = load_robot(robot)
        controls = {number: table.control for number, table in model.axis.items() if table.control is not None}
        filters = {number: (table.notch,) for number, table in model.axis.items() if notch and table.notch is not None}
        try:
            with exit_on_value_error():
                result = run(model, axis, controls=controls, notches=filters, sync_period_s=sync_period_s)
        except KeyError as error:
            raise fail(
                f"{robot}: axis.{error.args[0]}: no control table; a simulation needs the gains", EmulatorExitStatus.FILE
            ) from None
        _write(result, out)
    typer.echo(f"{len(result.time_s)} samples in {out}")


def _write(result: "Simulation", out: Path) -> None:
    import numpy as np  # noqa: PLC0415

    names: list[str] = ["time_s"]
    columns: list[Any] = [result.time_s]
    for column, number in enumerate(result.axes):
        for name, values in (
            ("reference_counts", result.reference_counts),
            ("position_counts", result.position_counts),
            ("arm_angle_rad", result.arm_angle_rad),
            ("torque_nm", result.torque_nm),
        ):
            names.append(f"axis{number}_{name}")
            columns.append(values[:, column])
    for column, name in enumerate(("x", "y", "z")):
        names.append(f"tip_{name}_m_s2")
        columns.append(result.tip_acceleration_m_s2[:, column])
    out.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(out, np.column_stack(columns), delimiter=",", header=",".join(names), comments="", fmt="%.10g")
