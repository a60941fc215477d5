"""`hil plan`: frames of a cycle, and whether they fit."""

import math
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any

import typer

from drive_profiles.cli.application import command
from drive_profiles.cli.console import fail, finite, listed, print_json, table
from hil.cli.console import ExitStatus, bench_on, epilog_without_motion, exit_on_error
from hil.cli.options import AXES, BenchOption, BusOption, LoopOption, PlainTreatmentOption, bit_rate_from
from hil.control.treatments import treatment as row_of
from hil.errors import NotPossibleError

if TYPE_CHECKING:  # --help must not wait for numpy and scipy
    from hil.bench.bench import Bench
    from hil.plan.advice import Adviser
    from hil.plan.check import AxisStability, PlanVerdict
    from hil.plan.wire import WireTiming

PLAN_EPILOG = epilog_without_motion({
    ExitStatus.DONE: "fits and is stable",
    ExitStatus.FILE: "bad bench file",
    ExitStatus.NOT_MET: "does not fit, is not stable, a profile lacks what it needs, or a ramp is beyond a limit",
})  # fmt: skip


@command(epilog=PLAN_EPILOG)
def plan(
    bench_file: BenchOption,
    bus: BusOption = None,
    loop: LoopOption = "drive",
    sync_period_s: Annotated[float | None, typer.Option(help="SYNC period instead of the bench file's.")] = None,
    bitrate: Annotated[str | None, typer.Option(help="Bit rate instead of the bus address': 500k, 1M.")] = None,
    axes: Annotated[
        str | None, typer.Option(help="Axes that take part, e.g. 2,3,5; default: all.", autocompletion=AXES.several)
    ] = None,
    treatment: PlainTreatmentOption = "notch",
    as_json: Annotated[bool, typer.Option("--json", help="One JSON document instead of tables.")] = False,
) -> None:
    """Check the frames of a cycle, and the loop's stability.

    It prints the frames, whether they fit on the bus, and whether the loop is stable with the resulting delay. It sends
    nothing, and needs no robot.

    Example: hil plan --bench bench.toml --loop host --bitrate 1M
    """
    rate = bit_rate_from(bitrate)
    if sync_period_s is not None and not 1e-5 <= sync_period_s <= 10.0:
        raise fail(f"--sync-period-s {sync_period_s:g} is not between 10 µs and 10 s", ExitStatus.USAGE)
    with exit_on_error(moves=False):
        bench = bench_on(bench_file, bus)

        from hil.plan.advice import Adviser
        from hil.plan.check import check

        with_notch = row_of(treatment).filters == "variable"
        numbers = tuple(sorted(bench.axis)) if axes is None else tuple(sorted(listed("--axes", axes, "axis")))
        period = sync_period_s or (bench.bus.host_sync_period_s if loop == "host" else bench.bus.sync_period_s)
        state = with_notch and loop == "drive"
        try:
            verdict = check(bench, numbers, loop, period, state, with_notch=with_notch, bitrate=rate)
        except NotPossibleError as error:
            raise fail(str(error), ExitStatus.USAGE) from None
    adviser = Adviser(bench, numbers, loop, verdict, with_notch=with_notch)
    if as_json:
        print_json(document(bench, loop, verdict, adviser))
    else:
        _print(verdict, adviser)
        typer.echo("\n" + _sentence(verdict, adviser))
    if not verdict.is_good:
        raise typer.Exit(ExitStatus.NOT_MET)


# -- the tables ---------------------------------------------------------------------------------------------------------


def _wires(verdict: "PlanVerdict") -> "list[WireTiming]":
    from hil.plan.check import RATES
    from hil.plan.wire import WireTiming

    return [WireTiming(rate) for rate in RATES] if verdict.wire is None else [verdict.wire]


def _print(verdict: "PlanVerdict", adviser: "Adviser") -> None:
    at = adviser.wire.name
    period = f"{1e3 * verdict.cycle.period_s:g} ms"
    table("One cycle, bits on the wire", ("frame", "id", "bytes", "bits, no stuffing", "typical", "worst"), _frame_rows(verdict))
    table(f"The cycle every {period}, worst case", _HEADINGS, [_rate(verdict, wire) for wire in _wires(verdict)])
    table(f"Per second at {at}", ("what", "frames/s", "worst bits/s", "load %"), _second_rows(verdict, adviser.wire))
    header = ("frame", "id", "with heartbeats", "with SDO, EMCY", "deadline", "met")
    table(f"Latest arrival at {at}, µs from SYNC, or from its queueing", header, [
        (one.name, f"{one.can_id:03X}h", _microseconds(one.quiet_ns), _microseconds(one.busy_ns), _microseconds(one.deadline_ns),
         "yes" if one.is_met else "no")
        for one in verdict.cycle.responses(adviser.wire)
    ])  # fmt: skip
    table("Stability at that delay", _STABILITY, [_stability_row(axis) for axis in verdict.stability])
    if verdict.gaps:
        table("Missing entries, and limits that are exceeded", ("what",), [(gap,) for gap in verdict.gaps])
    if verdict.remarks:
        table("Restrictions of the drives", ("what",), [(words,) for words in verdict.remarks])
    if adviser.advice:
        columns = ("change", "cycle µs", "worst", "shortest period µs", "at ms", "fits", "loop", "needs")
        table(f"Remedies, at {at}", columns, [
            (one.title, f"{one.nominal_us:.0f}", f"{one.worst_us:.0f}", f"{1e6 * one.shortest_period_s:.0f}",
             f"{1e3 * one.period_s:g}", "yes" if one.fits else "no", one.level, one.needs)
            for one in adviser.advice
        ])  # fmt: skip
    longest = adviser.longest_stable_period_s if adviser.loop == "host" else None
    if longest is not None:
        typer.echo(
            f"\nhost-closed, one period of delay: {1e3 * longest:g} ms is the longest usual SYNC period with a stable loop"
        )


def _sentence(verdict: "PlanVerdict", adviser: "Adviser") -> str:
    if verdict.is_carried:
        return verdict.sentence
    remedies = [
        one.title if "SYNC" in one.title else f"{one.title}, SYNC every {1e3 * one.period_s:g} ms" for one in adviser.good
    ]
    return f"{verdict.sentence} Remedies: {'; '.join(remedies) or 'none known'}."


_STABILITY = ("axis", "period ms", "delay, periods", "worst at rev/s", "M_s", "gain margin dB", "phase margin °", "pole radius",
              "verdict")  # fmt: skip
_HEADINGS = ("bit rate", "cycle µs", "load %", "typical load %", "last answer µs", "with SDO, EMCY", "shortest period µs",
             "with 10 % free", "delay, periods")  # fmt: skip


def _frame_rows(verdict: "PlanVerdict") -> list[tuple[str, ...]]:
    cycle = verdict.cycle
    rows = [
        (frame.name, f"{frame.can_id:03X}h", str(frame.length), str(frame.nominal_bits), f"{frame.typical_bits:.1f}",
         str(frame.worst_bits))
        for frame in cycle.frames
    ]  # fmt: skip
    total = sum(frame.length for frame in cycle.frames)
    return [*rows, ("sum", "", str(total), str(cycle.nominal_bits), f"{cycle.typical_bits:.1f}", str(cycle.worst_bits))]


def _rate(verdict: "PlanVerdict", wire: "WireTiming") -> tuple[str, ...]:
    from hil.plan.bus_plan import MARGIN

    cycle = verdict.cycle
    delay = cycle.delay_periods(wire)
    typical = 100.0 * cycle.typical_bits / wire.bitrate / cycle.period_s
    return (
        wire.name,
        f"{1e-3 * cycle.worst_ns(wire):.0f}",
        f"{100.0 * cycle.load(wire):.1f}",
        f"{typical:.1f}",
        _microseconds(cycle.last_answer_ns(wire)),
        _microseconds(cycle.last_answer_ns(wire, is_busy=True)),
        f"{1e6 * cycle.shortest_period_s(wire):.0f}",
        f"{1e6 * cycle.shortest_period_s(wire, margin=MARGIN):.0f}",
        "does not fit" if delay is None else str(delay),
    )


def _second_rows(verdict: "PlanVerdict", wire: "WireTiming") -> list[tuple[str, ...]]:
    """Rows of the load by the cycle and by all other frames."""
    cycle = verdict.cycle
    groups: dict[str, tuple[float, float]] = {"cycle": (len(cycle.frames) / cycle.period_s, cycle.load(wire))}
    for message in cycle.background.messages(wire, is_busy=True):
        name = "heartbeats" if message.name.startswith("heartbeat") else message.name
        frames, load = groups.get(name, (0.0, 0.0))
        groups[name] = frames + 1e9 / message.period_ns, load + message.length_ns / message.period_ns
    groups["all"] = (sum(frames for frames, _ in groups.values()), sum(load for _, load in groups.values()))
    return [
        (name, f"{frames:.0f}", f"{load * wire.bitrate:.0f}", f"{100.0 * load:.1f}") for name, (frames, load) in groups.items()
    ]


def _stability_row(axis: "AxisStability") -> tuple[str, ...]:
    verdict = f"{axis.level}: {axis.reason}" if axis.reason else axis.level
    period = "-" if axis.period_s is None else f"{1e3 * axis.period_s:g}"
    numbers = (axis.sensitivity_peak, axis.gain_margin_db, axis.phase_margin_deg)
    shown = ["-" if math.isnan(number) else f"{number:.2f}" for number in numbers]
    radius = "-" if math.isnan(axis.pole_radius) else f"{axis.pole_radius:.5f}"
    speed = f"{axis.speed_rps:g}" if axis.speed_rps else "no notch"
    return (str(axis.axis), period, str(axis.delay_samples), "-" if axis.reason else speed, *shown, radius, verdict)


def _microseconds(time_ns: int | None) -> str:
    return "no bound" if time_ns is None else f"{1e-3 * time_ns:.0f}"


def document(bench: "Bench", loop: str, verdict: "PlanVerdict", adviser: "Adviser") -> dict[str, Any]:
    """Return the plan as JSON data.

    SI units, times of arrival in ns, None for unknown and unbounded values.
    """
    cycle = verdict.cycle
    frames = [
        {"name": f.name, "kind": f.kind, "id": f.can_id, "bytes": f.length, "nominal_bits": f.nominal_bits,
         "typical_bits": f.typical_bits, "worst_bits": f.worst_bits}
        for f in cycle.frames
    ]  # fmt: skip
    rates = [
        {"bitrate": wire.bitrate, "load": cycle.load(wire), "background_load": cycle.background_load(wire),
         "cycle_worst_ns": cycle.worst_ns(wire), "last_answer_ns": cycle.last_answer_ns(wire),
         "last_answer_busy_ns": cycle.last_answer_ns(wire, is_busy=True), "shortest_period_s": cycle.shortest_period_s(wire),
         "delay_periods": cycle.delay_periods(wire)}
        for wire in _wires(verdict)
    ]  # fmt: skip
    whole = {
        "bench": bench.name, "loop": loop, "period_s": cycle.period_s, "bitrate": verdict.wire and verdict.wire.bitrate,
        "fits": verdict.fits, "stable": verdict.is_stable, "ok": verdict.is_good, "verdict": verdict.sentence,
        "frames": frames, "bits": {"nominal": cycle.nominal_bits, "typical": cycle.typical_bits, "worst": cycle.worst_bits},
        "rates": rates, "responses": [asdict(one) for one in cycle.responses(adviser.wire)],
        "gaps": verdict.gaps, "remarks": verdict.remarks, "stability": [asdict(axis) for axis in verdict.stability],
        "advice": [asdict(one) for one in adviser.advice],
    }  # fmt: skip
    data: dict[str, Any] = finite(whole)
    return data
