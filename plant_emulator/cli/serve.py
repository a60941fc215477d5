"""plant-emulator serve: the emulated robot as a process."""

import contextlib
import gc
import os
import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from drive_profiles.address import BUS_VARIABLE, LOCAL, Address, AddressError, BusChoice, choose_bus, parse_address
from drive_profiles.cli.application import command
from drive_profiles.cli.console import fail, numbered
from drive_profiles.errors import FileError
from plant_emulator.cli.console import (
    AXES,
    DriveOption,
    EmulatorExitStatus,
    RobotOption,
    axis_numbers,
    ends,
    exit_on_error,
    exit_on_value_error,
)

if TYPE_CHECKING:  # --help must not wait for them
    from plant_emulator.bus.attach import Attachment
    from plant_emulator.bus.server import Server
    from plant_emulator.robots.robot import Robot
    from plant_emulator.serial.accelerometer import EmulatedSerialAccelerometer
    from plant_emulator.world import World

SERVE_EPILOG = ends(
    EmulatorExitStatus.BUS,
    DONE="stopped",
    FILE="bad robot, fault, profile or EDS file",
    INTERRUPTED="interrupted before it served",
)


DEFAULT_BUS = "local:/tmp/robot.sock"

ServedBusOption = Annotated[
    str | None,
    typer.Option(
        "--bus",
        help=f"Where to serve: local:PATH[@BITRATE] of a Unix socket, or any bus. Default: {BUS_VARIABLE}, then {DEFAULT_BUS}.",
    ),
]
ServedAxesOption = Annotated[
    str | None,
    typer.Option("--axis", metavar="N[,N]", help="Serve only these axes; default: all.", autocompletion=AXES.several),
]
HeldGainsOption = Annotated[
    Path | None,
    typer.Option(
        "--tuning",
        help="Gains that the drives hold from the start, as set with a maker's tool: a bench or tuning file, or `reference`.",
    ),
]
EdsOption = Annotated[
    list[str] | None,
    typer.Option(
        "--eds",
        metavar="AXIS=PATH",
        help="EDS file of an axis' drive: adds the objects that the profile lacks, without a function; repeatable.",
    ),
]
StoreTimeOption = Annotated[
    float | None, typer.Option("--store-time-s", min=0.0, help="Time for which a drive is silent while it stores.")
]
LoadEncoderOption = Annotated[
    int | None,
    typer.Option(
        "--load-encoder-bits", min=8, max=26, help="Bits of a second encoder on every joint (60E4h); docs/load-encoder.md."
    ),
]
WallOption = Annotated[bool, typer.Option("--wall", help="Let the local bus follow the wall clock; by default SYNC advances it.")]
HostLatencyOption = Annotated[
    float,
    typer.Option("--host-latency-us", min=0.0, max=1e6, help="Delay from a client's program to its controller, in bus time."),
]
FaultsOption = Annotated[Path | None, typer.Option("--faults", help="Faults on the wire: a TOML file of [[fault]] tables.")]
SeedOption = Annotated[int | None, typer.Option("--seed", min=0, help="Seed of all noise instead of the file's.")]
StreamOption = Annotated[bool, typer.Option("--stream", help="Use a stream socket although the system has seqpacket.")]
UntilStdinClosesOption = Annotated[
    bool,
    typer.Option(
        "--until-stdin-closes", help="End when standard input closes, for example when the program that started this one ends."
    ),
]
SlcanOption = Annotated[
    str | None, typer.Option("--slcan", metavar="PATH", help="Also serve the bus as a serial CAN adapter (slcan) at this path.")
]
VirtualcanOption = Annotated[
    str | None,
    typer.Option("--virtualcan", metavar="[HOST:]PORT", help="Also serve the bus over TCP, on this machine only (virtualcan)."),
]
SerialAccelerometerOption = Annotated[
    str | None,
    typer.Option("--serial-accelerometer", metavar="PATH", help="Also send the tip's acceleration on a serial port here."),
]
FramingOption = Annotated[
    Literal["line", "binary"], typer.Option("--framing", help="Frame format of the serial accelerometer; see docs/serial.md.")
]
SerialRateOption = Annotated[
    float, typer.Option("--serial-rate-hz", min=1.0, max=4000.0, help="Samples per second of the serial accelerometer.")
]


@command(epilog=SERVE_EPILOG)
def serve(
    robot: RobotOption = "reference",
    bus: ServedBusOption = None,
    axis: ServedAxesOption = None,
    drive: DriveOption = None,
    tuning: HeldGainsOption = None,
    eds: EdsOption = None,
    store_time_s: StoreTimeOption = None,
    load_encoder_bits: LoadEncoderOption = None,
    wall: WallOption = False,
    host_latency_us: HostLatencyOption = 0.0,
    faults: FaultsOption = None,
    seed: SeedOption = None,
    stream: StreamOption = False,
    until_stdin_closes: UntilStdinClosesOption = False,
    slcan: SlcanOption = None,
    virtualcan: VirtualcanOption = None,
    serial_accelerometer: SerialAccelerometerOption = None,
    framing: FramingOption = "line",
    serial_rate_hz: SerialRateOption = 1000.0,
) -> None:
    """Serve the robot on a bus until Ctrl-C.

    On a local bus it runs in lock-step or by the wall clock, on any other by the wall clock.

    Examples:
        plant-emulator serve --robot reference --bus local:/tmp/robot.sock

        plant-emulator serve --bus local:/tmp/robot.sock@1M --faults faults.toml

        plant-emulator serve --bus socketcan:vcan0

        plant-emulator serve --axis 2 --drive 2=kollmorgen_akd --tuning reference

        plant-emulator serve --slcan /tmp/robot.tty --serial-accelerometer /tmp/acc.tty

        plant-emulator serve --virtualcan 18000

        can_viewer -i hil_local -c /tmp/robot.sock
    """
    drives, sheets = numbered("--drive", drive), numbered("--eds", eds)
    address, endpoint = _addresses(bus, slcan, virtualcan)
    model = _robot(
        robot, axes=axis, drives=drives, tuning=tuning, eds=sheets, store_time_s=store_time_s,
        load_encoder_bits=load_encoder_bits, seed=seed,
    )  # fmt: skip

    from plant_emulator.announcement import announced
    from plant_emulator.serial.accelerometer import EmulatedSerialAccelerometer, MeasuredWorld
    from plant_emulator.world import World

    sensor = None if serial_accelerometer is None else EmulatedSerialAccelerometer(model, serial_rate_hz, framing)
    with exit_on_error(), exit_on_value_error(robot):
        world = World(model) if sensor is None else MeasuredWorld(model, sensor)
    server = _server(world, address, wall=wall, host_latency_s=1e-6 * host_latency_us, faults_file=faults, stream=stream)
    _stop_on_signal(server, until_stdin_closes=until_stdin_closes)
    for line in announced(model, world, str(address)):
        typer.echo(line)
    with contextlib.ExitStack() as ports:
        ports.callback(server.close)
        _open_ports(ports, address, slcan, serial_accelerometer, sensor)
        _open_virtualcan(server, endpoint)
        _run(server)


def _robot(
    robot: str,
    *,
    axes: str | None,
    drives: dict[int, str],
    tuning: Path | None,
    eds: dict[int, str],
    store_time_s: float | None,
    load_encoder_bits: int | None,
    seed: int | None,
) -> "Robot":
    """Return the robot of a file with the changes that the options ask for."""
    from plant_emulator.robots.robot import load_robot, part_of, with_drives

    with exit_on_error(), exit_on_value_error():
        model = load_robot(robot)
        if axes is not None:
            model = part_of(model, axis_numbers(axes, model))
        model = with_drives(model, drives, eds=eds, store_time_s=store_time_s, load_encoder_bits=load_encoder_bits)
        if tuning is not None:
            from plant_emulator.robots.tuning import load_tuning, tuned

            model = tuned(model, load_tuning(tuning).gains(model.axis))
    return model if seed is None else model.model_copy(update={"seed": seed})


def _stop_on_signal(server: "Server | Attachment", *, until_stdin_closes: bool) -> None:
    """Stop the server on Ctrl-C, SIGTERM or, if asked, closed standard input."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: server.stop())
    if until_stdin_closes:
        server.watch(sys.stdin.fileno())


def _run(server: "Server | Attachment") -> None:
    """Serve until something stops the server.

    What has been made until now lives as long as the process, so the garbage collector passes it over from here on: to go through
    the 200 000 objects of a served robot takes it 150 ms, in which the bus is silent.
    """
    from hil.can.errors import BusLostError

    sys.stdout.flush()
    gc.freeze()
    try:
        server.run()
    except BusLostError as error:
        raise fail(str(error), EmulatorExitStatus.BUS) from None


def _addresses(bus: str | None, slcan: str | None, virtualcan: str | None) -> "tuple[Address, tuple[str, int] | None]":
    from plant_emulator.bus.virtualcan import EndpointError, parse_endpoint

    try:
        choice = choose_bus(bus) or BusChoice(DEFAULT_BUS, "the default")
        address = parse_address(choice.address)
    except AddressError as error:
        raise fail(str(error), EmulatorExitStatus.USAGE) from None
    if bus is None or choice.passed_over:
        typer.echo(str(choice), err=True)  # of a plain --bus the announcement says enough
    if address.interface != LOCAL and slcan is not None:
        raise fail(f"--slcan needs a bus local:PATH, not {address}", EmulatorExitStatus.USAGE)
    if address.interface != LOCAL and virtualcan is not None:
        raise fail(f"--virtualcan needs a bus local:PATH, not {address}", EmulatorExitStatus.USAGE)
    try:
        return address, None if virtualcan is None else parse_endpoint(virtualcan)
    except EndpointError as error:
        raise fail(f"--virtualcan {error}", EmulatorExitStatus.USAGE) from None


def _server(
    world: "World", address: "Address", *, wall: bool, host_latency_s: float, faults_file: Path | None, stream: bool
) -> "Server | Attachment":
    """Return the local bus around a world, or its attachment."""
    from drive_profiles.files.toml import load
    from hil.can.errors import BusUnavailableError
    from hil.can.opening import open_channel
    from plant_emulator.bus.attach import Attachment
    from plant_emulator.bus.medium import medium_for
    from plant_emulator.bus.server import Server

    try:
        if address.interface == LOCAL:
            faults = None
            if faults_file is not None:
                from plant_emulator.bus.faults import FaultsFile
                from plant_emulator.bus.instant import FIRST_CLIENT

                file = load(faults_file, FaultsFile)
                file.check_ports(world.node_ids, FIRST_CLIENT)
                faults = file.faults()
            medium = medium_for(world, address.bitrate, wall=wall, host_latency_s=host_latency_s, faults=faults)
            return Server(world, address.channel, stream=stream, medium=medium)
        if wall or host_latency_s or faults_file is not None:
            raise fail(f"--wall, --host-latency-us and --faults need a bus local:PATH, not {address}", EmulatorExitStatus.USAGE)
        return Attachment(world, open_channel(address))
    except FileError as error:
        raise fail(str(error), EmulatorExitStatus.FILE) from None
    except ValueError as error:
        raise fail(f"{faults_file}: {error}", EmulatorExitStatus.FILE) from None
    except BusUnavailableError as error:
        raise fail(str(error), EmulatorExitStatus.BUS) from None
    except OSError as error:
        raise fail(f"cannot serve {address}: {error.strerror or error}", EmulatorExitStatus.BUS) from None


def _open_ports(
    ports: contextlib.ExitStack,
    address: "Address",
    slcan: str | None,
    accelerometer: str | None,
    sensor: "EmulatedSerialAccelerometer | None",
) -> None:
    """Open the serial ports beside the bus; `ports` closes them."""
    if slcan is None and accelerometer is None:
        return
    from hil.can.local import connect_local
    from plant_emulator.serial.accelerometer import LINE_BYTES
    from plant_emulator.serial.pseudo_terminal import PseudoTerminal
    from plant_emulator.serial.slcan import SlcanPort  # a system without terminals serves without them

    try:
        if slcan is not None:
            terminal = ports.enter_context(contextlib.closing(PseudoTerminal(slcan)))
            ports.enter_context(contextlib.closing(SlcanPort(terminal, connect_local(address))))
            typer.echo(f"slcan adapter: --bus slcan:{slcan}@{address.bitrate or 1_000_000}")
        if accelerometer is not None and sensor is not None:
            terminal = ports.enter_context(contextlib.closing(PseudoTerminal(accelerometer, max_backlog_bytes=LINE_BYTES)))
            sensor.write = terminal.write
            typer.echo(f"serial accelerometer at {accelerometer}")
    except (ImportError, AttributeError, OSError) as error:
        raise fail(f"no serial port: {getattr(error, 'strerror', None) or error}", EmulatorExitStatus.BUS) from None


def _open_virtualcan(server: "Server | Attachment", endpoint: tuple[str, int] | None) -> None:
    """Open the bus over TCP if requested; the server closes it."""
    from plant_emulator.bus.server import Server
    from plant_emulator.bus.virtualcan import VirtualcanListener

    if endpoint is None or not isinstance(server, Server):
        return
    host, port = endpoint
    try:
        listener = VirtualcanListener(host, port, lambda line: typer.echo(line, err=True))
    except OSError as error:
        words = os.strerror(error.errno or 0)  # its own words name the port again
        raise fail(f"--virtualcan {host}:{port}: {words}; --virtualcan 0 takes a free port", EmulatorExitStatus.BUS) from None
    server.open(listener)
    typer.echo(f"virtualcan: {listener}")
