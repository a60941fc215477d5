"""plant-emulator: the emulated robot as a process, and its experiments without a bus."""

import contextlib
import enum
import os
import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from plant_emulator import cli_robustness

if TYPE_CHECKING:  # --help must not wait for them
    from drive_profiles.address import Address
    from plant_emulator.bus.attach import Attachment
    from plant_emulator.bus.server import Server
    from plant_emulator.robot import Robot
    from plant_emulator.serial_accelerometer import SerialAccelerometer
    from plant_emulator.world import World

app = typer.Typer(
    name="plant-emulator",
    help="An emulated robot: harmonic-drive axes behind CANopen drives, and an accelerometer at the tip.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)

EXIT_USAGE, EXIT_FILE, EXIT_BUS = 2, 3, 4

RobotOption = Annotated[str, typer.Option("--robot", help="Robot file (TOML), or `reference`.")]


class SerialFraming(enum.StrEnum):
    """How the serial accelerometer writes."""

    LINE = "line"
    BINARY = "binary"


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
    bus: Annotated[
        str, typer.Option("--bus", help="Where to serve: local:PATH[@BITRATE] of a Unix socket, or any bus.")
    ] = "local:/tmp/robot.sock",
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
    wall: Annotated[
        bool, typer.Option("--wall", help="The local bus follows the wall clock, whoever sends SYNC; else SYNC moves it.")
    ] = False,
    host_latency_us: Annotated[
        float, typer.Option("--host-latency-us", min=0.0, max=1e6, help="From a client's program to its controller, in bus time.")
    ] = 0.0,
    faults: Annotated[
        Path | None, typer.Option("--faults", help="What goes wrong on the wire: a TOML file of [[fault]] tables.")
    ] = None,
    seed: Annotated[int | None, typer.Option("--seed", min=0, help="Seed of all noise instead of the file's.")] = None,
    stream: Annotated[bool, typer.Option("--stream", help="Use a stream socket although the system has seqpacket.")] = False,
    until_stdin_closes: Annotated[
        bool, typer.Option("--until-stdin-closes", help="End when standard input ends, with the process that holds it.")
    ] = False,
    slcan: Annotated[
        str | None, typer.Option("--slcan", metavar="PATH", help="Also be a serial CAN adapter (slcan) at this path.")
    ] = None,
    virtualcan: Annotated[
        str | None,
        typer.Option(
            "--virtualcan", metavar="[HOST:]PORT", help="Also serve the bus over TCP, on this machine only (virtualcan)."
        ),
    ] = None,
    serial_accelerometer: Annotated[
        str | None,
        typer.Option("--serial-accelerometer", metavar="PATH", help="Also send the tip's acceleration on a serial port here."),
    ] = None,
    framing: Annotated[
        SerialFraming, typer.Option("--framing", help="How the serial accelerometer writes; docs/serial.md.")
    ] = SerialFraming.LINE,
    serial_rate_hz: Annotated[
        float, typer.Option("--serial-rate-hz", min=1.0, max=4000.0, help="Samples per second of the serial accelerometer.")
    ] = 1000.0,
) -> None:
    """Serve the robot on a local bus, or by the wall clock on any other, until Ctrl-C.

    Exit status: 0 stopped, 2 usage, 3 bad robot file, 4 the bus cannot be served, or is lost.

    Examples:
        plant-emulator serve --robot reference --bus local:/tmp/robot.sock

        plant-emulator serve --bus local:/tmp/robot.sock@1M --faults faults.toml

        plant-emulator serve --bus socketcan:vcan0

        plant-emulator serve --drive 2=kollmorgen_akd --store-time-s 0.4

        plant-emulator serve --slcan /tmp/robot.tty --serial-accelerometer /tmp/acc.tty

        plant-emulator serve --virtualcan 18000

        can_viewer -i hil_local -c /tmp/robot.sock
    """
    from drive_profiles.errors import DriveProfileError  # noqa: PLC0415 - --help must not wait for the compiler
    from plant_emulator.robot import load_robot, with_drives  # noqa: PLC0415

    drives, sheets = _by_axis("--drive", drive), _by_axis("--eds", eds)
    address, endpoint = _places(bus, slcan, virtualcan)
    try:
        model = load_robot(robot)
    except DriveProfileError as error:
        raise _fail(str(error), EXIT_FILE) from None
    try:
        model = with_drives(model, drives, eds=sheets, store_time_s=store_time_s)
    except ValueError as error:
        raise _fail(str(error), EXIT_USAGE) from None
    if seed is not None:
        model = model.model_copy(update={"seed": seed})

    from hil.can.channel import BusLostError  # noqa: PLC0415
    from plant_emulator.announcement import announced  # noqa: PLC0415
    from plant_emulator.serial_accelerometer import SerialAccelerometer  # noqa: PLC0415

    sensor = None if serial_accelerometer is None else SerialAccelerometer(model, serial_rate_hz, framing.value)
    world = _world(robot, model, sensor)
    world.axes.advance(0)  # compile, or load what is compiled, before anyone waits for an answer
    server = _server(world, address, _Wire(wall, 1e-6 * host_latency_us, faults), stream=stream)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: server.stop())
    if until_stdin_closes:
        server.watch(sys.stdin.fileno())
    for line in announced(model, world, str(address)):
        typer.echo(line)
    with contextlib.ExitStack() as ports:
        ports.callback(server.close)
        _open_ports(ports, address, slcan, serial_accelerometer, sensor)
        _open_virtualcan(server, endpoint)
        sys.stdout.flush()
        try:
            server.run()
        except BusLostError as error:
            raise _fail(str(error), EXIT_BUS) from None


def _places(bus: str, slcan: str | None, virtualcan: str | None) -> "tuple[Address, tuple[str, int] | None]":
    """Where to serve: the bus, and the TCP port beside it."""
    from drive_profiles.address import LOCAL, AddressError, parse_address  # noqa: PLC0415
    from plant_emulator.bus.virtualcan import EndpointError, parse_endpoint  # noqa: PLC0415

    try:
        address = parse_address(bus)
    except AddressError as error:
        raise _fail(f"--bus {error}", EXIT_USAGE) from None
    if address.interface != LOCAL and slcan is not None:
        raise _fail(f"--slcan: an adapter joins a bus local:PATH, not {bus}", EXIT_USAGE)
    if address.interface != LOCAL and virtualcan is not None:
        raise _fail(f"--virtualcan: over TCP a bus local:PATH is served, not {bus}", EXIT_USAGE)
    try:
        return address, None if virtualcan is None else parse_endpoint(virtualcan)
    except EndpointError as error:
        raise _fail(f"--virtualcan {error}", EXIT_USAGE) from None


class _Wire(NamedTuple):
    """What the local bus is like."""

    wall: bool
    host_latency_s: float
    faults: Path | None


def _server(world: "World", address: "Address", wire: _Wire, *, stream: bool) -> "Server | Attachment":
    """The local bus around a world, or the world on a bus that others keep."""
    from drive_profiles.address import LOCAL  # noqa: PLC0415
    from drive_profiles.errors import FileError  # noqa: PLC0415
    from drive_profiles.files import load  # noqa: PLC0415
    from hil.can.channel import BusUnavailableError, open_channel  # noqa: PLC0415
    from plant_emulator.bus.attach import Attachment  # noqa: PLC0415
    from plant_emulator.bus.faults import FaultsFile  # noqa: PLC0415
    from plant_emulator.bus.medium import medium_for  # noqa: PLC0415
    from plant_emulator.bus.server import AddressInUseError, Server  # noqa: PLC0415

    try:
        if address.interface == LOCAL:
            faults = None if wire.faults is None else load(wire.faults, FaultsFile).faults()
            medium = medium_for(world, address.bitrate, wall=wire.wall, host_latency_s=wire.host_latency_s, faults=faults)
            return Server(world, address.channel, stream=stream, medium=medium)
        if wire != (False, 0.0, None):
            raise _fail(f"--wall, --host-latency-us and --faults are for a bus local:PATH, not {address}", EXIT_USAGE)
        return Attachment(world, open_channel(address))
    except FileError as error:
        raise _fail(str(error), EXIT_FILE) from None
    except ValueError as error:
        raise _fail(f"{wire.faults}: {error}", EXIT_FILE) from None
    except BusUnavailableError as error:
        raise _fail(str(error), EXIT_BUS) from None
    except (AddressInUseError, OSError) as error:
        raise _fail(f"cannot serve {address}: {error}", EXIT_BUS) from None


def _world(robot: str, model: "Robot", sensor: "SerialAccelerometer | None") -> "World":
    """The world of a model, with a sensor on a serial line where there is one."""
    from drive_profiles.errors import DriveProfileError  # noqa: PLC0415
    from plant_emulator.serial_accelerometer import MeasuredWorld  # noqa: PLC0415
    from plant_emulator.world import World  # noqa: PLC0415

    try:
        return World(model) if sensor is None else MeasuredWorld(model, sensor)
    except DriveProfileError as error:
        raise _fail(str(error), EXIT_FILE) from None
    except ValueError as error:
        raise _fail(f"{robot}: {error}", EXIT_FILE) from None


def _open_ports(
    ports: contextlib.ExitStack,
    address: "Address",
    slcan: str | None,
    accelerometer: str | None,
    sensor: "SerialAccelerometer | None",
) -> None:
    """The serial ports beside the bus; `ports` closes them."""
    if slcan is None and accelerometer is None:
        return
    from hil.can.raw import connect_local  # noqa: PLC0415
    from plant_emulator.bus.slcan import SlcanPort  # noqa: PLC0415 - a system without terminals serves without them
    from plant_emulator.pseudo_terminal import PathTakenError, PseudoTerminal  # noqa: PLC0415
    from plant_emulator.serial_accelerometer import LINE_BYTES  # noqa: PLC0415

    try:
        if slcan is not None:
            terminal = ports.enter_context(contextlib.closing(PseudoTerminal(slcan)))
            ports.enter_context(contextlib.closing(SlcanPort(terminal, connect_local(address))))
            typer.echo(f"slcan adapter: --bus slcan:{slcan}@{address.bitrate or 1_000_000}")
        if accelerometer is not None and sensor is not None:
            terminal = ports.enter_context(contextlib.closing(PseudoTerminal(accelerometer, max_backlog_bytes=LINE_BYTES)))
            sensor.write = terminal.write
            typer.echo(f"serial accelerometer at {accelerometer}")
    except (PathTakenError, ImportError, AttributeError, OSError) as error:
        raise _fail(f"no serial port: {error}", EXIT_BUS) from None


def _open_virtualcan(server: "Server | Attachment", endpoint: tuple[str, int] | None) -> None:
    """The bus over TCP, where that is asked for; the server closes it."""
    from plant_emulator.bus.server import Server  # noqa: PLC0415
    from plant_emulator.bus.virtualcan import VirtualcanDoor  # noqa: PLC0415

    if endpoint is None or not isinstance(server, Server):
        return
    host, port = endpoint
    try:
        door = VirtualcanDoor(host, port, lambda line: typer.echo(line, err=True))
    except OSError as error:
        raise _fail(f"--virtualcan {host}:{port}: {error.strerror or error}", EXIT_BUS) from None
    server.open(door)
    typer.echo(f"virtualcan: {door}")


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
def eds(
    out: Annotated[Path, typer.Option("--out", help="Folder for the files; made if it is not there.")],
    robot: Annotated[
        str | None,
        typer.Option("--robot", help="One file for each node of this robot, a robot file or `reference`, instead of each kind."),
    ] = None,
    drive: Annotated[
        list[str] | None,
        typer.Option("--drive", metavar="AXIS=PROFILE", help="With --robot, as of `serve`; repeatable."),
    ] = None,
) -> None:
    """Write the EDS files of the emulated drive and accelerometer, for tools that configure CANopen nodes.

    With --robot the file of every node: axis2.eds and so on, accelerometer.eds, each with its node's serial number, motor, gains
    and, of a vendor's drive, the vendor's objects.

    Exit status: 0 done, 2 usage, 3 a bad robot file, or the files cannot be written.

    Examples:
        plant-emulator eds --out eds

        plant-emulator eds --robot robot.toml --drive 3=kollmorgen_akd --out eds
    """
    from drive_profiles.errors import DriveProfileError  # noqa: PLC0415
    from plant_emulator.data_sheets import data_sheets, data_sheets_of  # noqa: PLC0415 - --help must not wait for the compiler
    from plant_emulator.robot import load_robot, with_drives  # noqa: PLC0415

    drives = _by_axis("--drive", drive)
    if drives and robot is None:
        raise _fail("--drive says which drive an axis of --robot has: --robot is missing", EXIT_USAGE)
    try:
        model = None if robot is None else load_robot(robot)
    except DriveProfileError as error:
        raise _fail(str(error), EXIT_FILE) from None
    try:
        model = None if model is None else with_drives(model, drives)
    except ValueError as error:
        raise _fail(str(error), EXIT_USAGE) from None
    try:
        sheets = data_sheets() if model is None else data_sheets_of(model)
        out.mkdir(parents=True, exist_ok=True)
        for name, text in sheets.items():
            path = out / name
            path.write_text(text, encoding="ascii", newline="\n")
            typer.echo(path)
    except (DriveProfileError, OSError) as error:
        raise _fail(str(error), EXIT_FILE) from None
    except ValueError as error:
        raise _fail(f"{robot}: {error}", EXIT_FILE) from None


cli_robustness.mount(app)


def main() -> None:
    """Entry point of the console script."""
    try:
        app()
    except BrokenPipeError:
        os._exit(141)  # the reader of the output has gone; there is nothing to tell it


if __name__ == "__main__":
    main()
