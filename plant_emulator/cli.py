"""plant-emulator: the emulated robot as a process, and its experiments without a bus."""

import os
import signal
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

app = typer.Typer(
    name="plant-emulator",
    help="An emulated robot: harmonic-drive axes behind CANopen drives, and an accelerometer at the tip.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)

EXIT_USAGE, EXIT_FILE, EXIT_BUS = 2, 3, 4

RobotOption = Annotated[str, typer.Option("--robot", help="Robot file (TOML), or `reference`.")]


def _fail(message: str, code: int) -> typer.Exit:
    typer.echo(message, err=True)
    return typer.Exit(code)


def _by_axis(option: str, given: list[str] | None) -> dict[int, str]:
    """AXIS=VALUE, taken apart."""
    values = {}
    for text in given or ():
        axis, _, value = text.partition("=")
        if not (axis.isascii() and axis.isdigit() and value):
            raise _fail(f"{option} {text}: AXIS=VALUE is wanted, such as 2={value or 'VALUE'}", EXIT_USAGE)
        if int(axis) in values:
            raise _fail(f"{option}: axis {axis} is given twice", EXIT_USAGE)
        values[int(axis)] = value
    return values


@app.command()
def serve(
    robot: RobotOption = "reference",
    bus: Annotated[str, typer.Option("--bus", help="Where to serve: local:PATH of a Unix socket.")] = "local:/tmp/robot.sock",
    drive: Annotated[
        list[str] | None,
        typer.Option("--drive", metavar="AXIS=PROFILE", help="Drive of an axis: name of a profile, or its file; repeatable."),
    ] = None,
    eds: Annotated[
        list[str] | None,
        typer.Option(
            "--eds", metavar="AXIS=PATH", help="EDS file of an axis' drive; its further objects do nothing; repeatable."
        ),
    ] = None,
    store_time_s: Annotated[
        float | None, typer.Option("--store-time-s", min=0.0, help="How long a drive is silent while it stores.")
    ] = None,
    seed: Annotated[int | None, typer.Option("--seed", min=0, help="Seed of all noise instead of the file's.")] = None,
    stream: Annotated[bool, typer.Option("--stream", help="Use a stream socket although the system has seqpacket.")] = False,
    until_stdin_closes: Annotated[
        bool, typer.Option("--until-stdin-closes", help="End when standard input ends, with the process that holds it.")
    ] = False,
) -> None:
    """Serve the robot on a local bus until Ctrl-C.

    Exit status: 0 stopped, 2 usage, 3 bad robot file, 4 the bus cannot be served.

    Examples:
        plant-emulator serve --robot reference --bus local:/tmp/robot.sock

        plant-emulator serve --drive 2=kollmorgen_akd --store-time-s 0.4

        can_viewer -i hil_local -c /tmp/robot.sock
    """
    from drive_profiles.address import LOCAL, AddressError, parse_address  # noqa: PLC0415
    from drive_profiles.errors import DriveProfileError  # noqa: PLC0415 - --help must not wait for the compiler
    from plant_emulator.robot import load_robot, with_drives  # noqa: PLC0415

    drives, sheets = _by_axis("--drive", drive), _by_axis("--eds", eds)
    try:
        address = parse_address(bus)
        if address.interface != LOCAL:
            raise _fail(f"--bus {bus}: the emulator serves local:PATH only", EXIT_USAGE)
        model = load_robot(robot)
    except AddressError as error:
        raise _fail(f"--bus {error}", EXIT_USAGE) from None
    except DriveProfileError as error:
        raise _fail(str(error), EXIT_FILE) from None
    try:
        model = with_drives(model, drives, eds=sheets, store_time_s=store_time_s)
    except ValueError as error:
        raise _fail(str(error), EXIT_USAGE) from None
    if seed is not None:
        model = model.model_copy(update={"seed": seed})

    from plant_emulator.bus.server import AddressInUseError, Server  # noqa: PLC0415
    from plant_emulator.world import World  # noqa: PLC0415

    try:
        world = World(model)
    except DriveProfileError as error:
        raise _fail(str(error), EXIT_FILE) from None
    except ValueError as error:
        raise _fail(f"{robot}: {error}", EXIT_FILE) from None
    world.axes.advance(0)  # compile, or load what is compiled, before anyone waits for an answer
    try:
        server = Server(world, address.channel, stream=stream)
    except (AddressInUseError, OSError) as error:
        raise _fail(f"cannot serve {address}: {error}", EXIT_BUS) from None
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: server.stop())
    if until_stdin_closes:
        server.watch(sys.stdin.fileno())
    nodes = ", ".join(f"axis {axis} at node {node}" for axis, node in model.node_ids.items())
    typer.echo(f"serving {model.name} on {address}: {nodes}, accelerometer at node {model.accelerometer.node_id}")
    for axis, node in model.node_ids.items():
        personality = world.drives[axis].personality
        typer.echo(f"node {node}: {personality.profile}")
        for note in personality.notes:
            typer.echo(f"  {note}")
    sys.stdout.flush()
    server.run()


@app.command()
def simulate(
    out: Annotated[Path, typer.Option("--out", help="CSV file to write.")],
    robot: RobotOption = "reference",
    axis: Annotated[int | None, typer.Option("--axis", help="Constant acceleration of this axis; left out: line motion.")] = None,
    notch: Annotated[bool, typer.Option("--notch/--no-notch", help="With the axes' notch filters of the robot file.")] = False,
    sync_period_s: Annotated[float, typer.Option("--sync-period-s", help="Period of the set-points.")] = 0.002,
) -> None:
    """Run an experiment without CAN and write the true motion; the robot file must give `control` (and `notch`) tables.

    Exit status: 0 done, 2 usage, 3 bad robot file.
    """
    import numpy as np  # noqa: PLC0415 - --help must not wait for the compiler

    from drive_profiles.errors import FileError  # noqa: PLC0415
    from plant_emulator.robot import load_robot  # noqa: PLC0415
    from plant_emulator.simulate import simulate as run  # noqa: PLC0415

    try:
        model = load_robot(robot)
        controls = {number: table.control for number, table in model.axis.items() if table.control is not None}
        filters = {number: (table.notch,) for number, table in model.axis.items() if notch and table.notch is not None}
        result = run(model, axis, controls=controls, notches=filters, sync_period_s=sync_period_s)
    except FileError as error:
        raise _fail(str(error), EXIT_FILE) from None
    except KeyError as error:
        raise _fail(f"{robot}: axis.{error.args[0]}: no control table; a simulation needs the gains", EXIT_FILE) from None
    except ValueError as error:
        raise _fail(str(error), EXIT_USAGE) from None
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
    typer.echo(f"{len(result.time_s)} samples in {out}")


@app.command()
def eds(out: Annotated[Path, typer.Option("--out", help="Folder for the files; made if it is not there.")]) -> None:
    """Write the EDS files of the emulated drive and accelerometer, for tools that configure CANopen nodes.

    Exit status: 0 done, 2 usage, 3 the files cannot be written.
    """
    from plant_emulator.data_sheets import data_sheets  # noqa: PLC0415 - --help must not wait for the compiler

    try:
        out.mkdir(parents=True, exist_ok=True)
        for name, text in data_sheets().items():
            path = out / name
            path.write_text(text, encoding="ascii", newline="\n")
            typer.echo(path)
    except OSError as error:
        raise _fail(str(error), EXIT_FILE) from None


def main() -> None:
    """Entry point of the console script."""
    try:
        app()
    except BrokenPipeError:
        os._exit(141)  # the reader of the output has gone; there is nothing to tell it


if __name__ == "__main__":
    main()
