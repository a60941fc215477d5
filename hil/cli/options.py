"""Options that several commands of ``hil`` take."""

from pathlib import Path
from typing import Annotated

import typer

from drive_profiles.address import BUS_VARIABLE, AddressError, parse_bit_rate
from drive_profiles.cli.completion import AxisCompleter, complete_list, complete_reference
from hil.control.treatments import TABLE, LoopName, PlainTreatmentName, Treatment, TreatmentName


def names_of(*needs: str) -> str:
    """Return the names of treatments with given needs, for a help text."""
    return ", ".join(each.name for each in TABLE if each.needs in needs)


def described(row: Treatment) -> str:
    """Return a treatment's name, and its title if that differs."""
    return row.name if row.title == row.name else f"{row.name} ({row.title})"


AXES = AxisCompleter(Path(__file__).parents[1] / "bench")
"""Completers of axes of the bench file."""

BenchOption = Annotated[
    str, typer.Option("--bench", help="Bench file (TOML), or `reference`, or `reference-arm`.", autocompletion=complete_reference)
]
OptionalBenchOption = Annotated[
    str | None,
    typer.Option("--bench", help="Bench file (TOML), or `reference`, or `reference-arm`.", autocompletion=complete_reference),
]
BusOption = Annotated[str | None, typer.Option("--bus", help=f"Bus address; default: {BUS_VARIABLE}, then the bench file's.")]
MovedAxisOption = Annotated[int, typer.Option("--axis", help="Number of the axis.", autocompletion=AXES.one)]
LoopOption = Annotated[LoopName, typer.Option("--loop", help="Where the loop is closed.")]
TreatmentOption = Annotated[
    TreatmentName,
    typer.Option(
        "--treatment", metavar="NAME", help=f"Treatment of the vibration: {', '.join(described(row) for row in TABLE)}."
    ),
]
TreatmentListOption = Annotated[
    list[str] | None,
    typer.Option(
        "--treatment",
        metavar="NAME[,NAME]",
        autocompletion=complete_list(lambda: [row.name for row in TABLE]),
        help=f"Comma-separated list of: {', '.join(row.name for row in TABLE)}. "
        "Default: those that suit the motion, if the files allow them.",
    ),
]
PlainTreatmentOption = Annotated[PlainTreatmentName, typer.Option("--treatment", help="Plan with the notch or without.")]
OrdersOption = Annotated[
    str,
    typer.Option("--orders", metavar="K[,K]", help="Orders of the transmission error, comma-separated; also fractions."),
]
DescriptionsOption = Annotated[
    list[str] | None,
    typer.Option(
        "--description",
        metavar="FILE[:NODE]",
        help="EDS, DCF or XDD of a node: drive.eds:2; repeatable. Not needed for a drive whose set-up is heard.",
    ),
]
NewOutOption = Annotated[Path | None, typer.Option("--out", help="Directory; default: a new one in bench-out.")]
ForceOption = Annotated[bool, typer.Option("--force", help="Replace the files of an older result in --out.")]
OverloadOption = Annotated[bool, typer.Option("--overload", help="Run even if the frames do not fit on the bus (hil plan).")]
YesOption = Annotated[bool, typer.Option("--yes", help="Move a real robot without asking.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON on standard output, all else on standard error.")]

INERTIA = "--motor-inertia-kg-m2"
LEAST_INERTIA_KG_M2, MOST_INERTIA_KG_M2 = 1e-9, 10.0


def orders_from(text: str) -> tuple[float, ...]:
    """Return the set of orders that `--orders` names.

    Raises:
        typer.BadParameter: It is not a set of orders.
    """
    from hil.robot_tables import orders_of

    try:
        return orders_of(text)
    except ValueError as error:
        raise typer.BadParameter(str(error), param_hint="--orders") from None


def bit_rate_from(text: str | None) -> int | None:
    """Return the rate of `--bitrate` in bit/s, spelled as in a bus address.

    Raises:
        typer.BadParameter: It is none.
    """
    try:
        return None if text is None else parse_bit_rate(text)
    except AddressError as error:
        raise typer.BadParameter(str(error), param_hint="--bitrate") from None


def inertias_from(texts: list[str], axes: tuple[int, ...]) -> dict[int, float]:
    """Return the inertias of `--motor-inertia-kg-m2` by axis.

    A value without an axis is that of the only axis.

    Raises:
        typer.BadParameter: A value is not an inertia, an axis has two, or is unknown.
    """
    found: dict[int, float] = {}
    for text in texts:
        name, _, value = text.rpartition("=")
        try:
            axis = int(name) if name else axes[0] if len(axes) == 1 else None
            inertia = float(value)
        except ValueError:
            what = f"{text!r} is not an inertia; expected e.g. 2.6e-4, or 2=2.6e-4 for axis 2"
            raise typer.BadParameter(what, param_hint=INERTIA) from None
        if axis is None:
            raise typer.BadParameter(
                f"{text} has no axis number; for several axes, give e.g. 2={text} for axis 2", param_hint=INERTIA
            )
        if not LEAST_INERTIA_KG_M2 <= inertia <= MOST_INERTIA_KG_M2:
            limits = f"{LEAST_INERTIA_KG_M2:g} to {MOST_INERTIA_KG_M2:g}"
            raise typer.BadParameter(f"{text}: expected an inertia from {limits} kg·m²", param_hint=INERTIA)
        if axis in found:
            raise typer.BadParameter(f"axis {axis} has two inertias; give one", param_hint=INERTIA)
        found[axis] = inertia
    return found
