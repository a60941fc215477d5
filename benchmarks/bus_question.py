"""`python -m benchmarks.bus_question`: host-closed or drive-closed over CAN? Two motions over bit rates and SYNC periods.

Each cell is one run of the reference bench in one process, in lock-step, on a wire with bit times or on an ideal bus. A cell that
the plan of the bus refuses for its load is not run, but for a few that are kept as proof. Cells are kept on disk, so a study that
was interrupted goes on where it stopped; a change of the code or of the bench begins anew.
"""

import argparse
import hashlib
import json
import math
import multiprocessing
import re
import sys
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes

import hil
import plant_emulator
from hil.bench.bench import Bench, load_bench
from hil.control.treatments import LoopName
from hil.errors import UnsafeRequestError
from hil.experiments.motions import CONSTANT_ACCELERATION, LINE_MOTION
from hil.experiments.plan import Experiment, entries
from hil.master.motion import FilterUse
from hil.master.session import Session
from hil.plan.advice import FD_DATA_BITRATE, packed, packed_alone, per_axis
from hil.plan.bus_plan import Cycle
from hil.plan.check import plan_cycle, stability
from hil.plan.wire import CLASSIC_MAX_BITRATE, WireTiming, rate_text
from hil.recording import BusLog
from hil.report import style
from hil.report.svg import standalone
from plant_emulator.bus.in_process import InProcessChannel
from plant_emulator.bus.medium import medium_for
from plant_emulator.robots.robot import load_robot
from plant_emulator.world import World

FAST = WireTiming(CLASSIC_MAX_BITRATE, FD_DATA_BITRATE)
RATES: tuple[WireTiming | None, ...] = (
    WireTiming(125_000),
    WireTiming(250_000),
    WireTiming(500_000),
    WireTiming(1_000_000),
    FAST,
    None,
)
PERIODS_S = (250e-6, 500e-6, 1e-3, 2e-3, 4e-3)
LOOPS: tuple[LoopName, ...] = ("drive", "host")
WAYS: tuple[FilterUse, ...] = ("none", "notch")
MOTIONS: tuple[int | None, ...] = (2, None)
"""The axis of the constant acceleration, and None for the line."""
WORKERS = 2
PARTS = ("hil/control", "hil/master", "hil/can", "hil/experiments", "hil/analysis.py", "hil/bench", "plant_emulator")

LINE_AXES = (2, 3, 5)
"""Axes of the reference robot that move in the line motion."""

Kind = Literal["run", "does not fit", "refused", "stopped", "not judged"]


@dataclass(frozen=True)
class Cell:
    """One run of the study.

    Attributes:
        axis: Of the constant acceleration; None: the line of axes 2, 3 and 5.
        loop: Where it is closed.
        period_s: SYNC period.
        wire: None: an ideal bus.
        compensation: Without or with the notch.
    """

    axis: int | None
    loop: LoopName
    period_s: float
    wire: WireTiming | None
    compensation: FilterUse

    @property
    def axes(self) -> tuple[int, ...]:
        """Those that move."""
        return LINE_AXES if self.axis is None else (self.axis,)

    @property
    def name(self) -> str:
        """For a file and for people."""
        motion = "line" if self.axis is None else f"axis{self.axis}"
        rate = "ideal" if self.wire is None else f"{self.wire.bitrate // 1000}k"
        if self.wire is not None and self.wire.data_bitrate is not None:
            rate += f"-fd{self.wire.data_bitrate // 1000}k"
        return f"{motion}-{self.loop}-{rate}-{1e6 * self.period_s:.0f}us-{self.compensation}"

    def fits(self, bench: Bench) -> bool:
        """What the master's own plan says of the bus."""
        state = self.compensation == "notch" and self.loop == "drive"
        cycle = plan_cycle(bench, self.axes, self.loop, self.period_s, notch_state=state)
        return cycle.delay_periods(self.wire) == 1


@dataclass(frozen=True)
class Found:
    """What became of a cell.

    Attributes:
        kind: run; does not fit (the plan's word, or a run that stopped for want of answers); refused (by the master's own check
            of the loop); stopped; not judged.
        words: Why.
        tip_mm: Largest tip displacement in the window of the second order, or of the line.
        area: Of the acceleration spectrum, m/s²·Hz.
        missed: Cycles of the motion that lack an answer.
    """

    kind: Kind
    words: str = ""
    tip_mm: float | None = None
    area: float | None = None
    missed: int = 0


_OVERLOADS: tuple[tuple[int | None, LoopName, float], ...] = (
    (2, "host", 250e-6),
    (2, "host", 500e-6),
    (None, "host", 500e-6),
    (None, "drive", 250e-6),
)
PROOFS = tuple(Cell(*overload, WireTiming(1_000_000), way) for overload in _OVERLOADS for way in WAYS)
"""Cells that the plan refuses for their load, run all the same."""


def grid() -> list[Cell]:
    """All cells, the slow ones first."""
    return [
        Cell(axis, loop, period, rate, way)
        for period in PERIODS_S for axis in MOTIONS for loop in LOOPS for rate in RATES for way in WAYS
    ]  # fmt: skip


def measure(cell: Cell) -> Found:
    """Run one cell."""
    bench = load_bench("reference")
    period = {"sync_period_s": cell.period_s, "host_sync_period_s": cell.period_s, "answer_timeout_s": 0.05}
    bench = bench.model_copy(update={"bus": bench.bus.model_copy(update=period)})
    world = World(load_robot("reference"))
    rates = (None, None) if cell.wire is None else (cell.wire.bitrate, cell.wire.data_bitrate)
    channel = InProcessChannel(world, medium_for(world, *rates))
    name = LINE_MOTION if cell.axis is None else CONSTANT_ACCELERATION
    experiment = Experiment(name, cell.axis, cell.compensation, cell.loop)
    try:
        with Session(bench, channel, BusLog(None)) as session:
            session.bring_up()
            result = session.run(experiment.motion(bench), cell.compensation, cell.loop)
    except UnsafeRequestError as error:
        unstable = "unstable" in str(error)
        return Found("refused", f"pole radius {error.value:.2f}" if unstable else f"M_s {error.value:.3g}")
    entry = entries(bench, experiment, result, "")[0]
    if result.stopped is not None:
        lost = "answer" in result.stopped.reason
        return Found("does not fit" if lost else "stopped", result.stopped.reason, missed=result.missed_cycles)
    if entry.invalid is not None:
        return Found("not judged", entry.invalid, missed=result.missed_cycles)
    return Found("run", "", entry.tip_peak_mm, entry.spectrum_area, result.missed_cycles)


def _code() -> str:
    """What decides over the cells, as a few digits."""
    root = Path(hil.__file__).parents[1]
    emulator = Path(plant_emulator.__file__).parents[1]
    digest = hashlib.sha256()
    for part in PARTS:
        place = (emulator if part.startswith("plant") else root) / part
        for path in sorted([place] if place.is_file() else place.rglob("*")):
            if path.suffix in {".py", ".toml"} and "pytest_plugin" not in str(path):
                digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


def _kept(job: tuple[Cell, Path]) -> tuple[Cell, Found]:
    """A cell's result from its file, or from a run that leaves one."""
    cell, folder = job
    path = folder / f"{cell.name}.json"
    if path.is_file():
        return cell, Found(**json.loads(path.read_text(encoding="utf-8")))
    found = measure(cell)
    path.with_suffix(".part").write_text(json.dumps(asdict(found)), encoding="utf-8")
    path.with_suffix(".part").replace(path)
    return cell, found


def study(folder: Path) -> dict[Cell, Found]:
    """All cells: those that fit, and the proofs, are run; the others are the plan's word."""
    bench = load_bench("reference")
    folder = folder / _code()
    folder.mkdir(parents=True, exist_ok=True)
    cells = grid()
    found = {cell: Found("does not fit", "plan") for cell in cells}
    fits = [cell for cell in cells if cell in PROOFS or cell.fits(bench)]
    with multiprocessing.get_context("spawn").Pool(WORKERS) as pool:
        for number, (cell, what) in enumerate(pool.imap_unordered(_kept, [(cell, folder) for cell in fits]), 1):
            found[cell] = what
            sys.stderr.write(f"{number}/{len(fits)} {cell.name}: {what.kind} {what.words} {what.tip_mm or ''}\n")
    return found


# -- limits from the plan --------------------------------------------------------------------------------------------------


@cache
def longest_stable_s(axes: tuple[int, ...]) -> float:
    """The longest period at which every host-closed loop with a model stands a period of delay, with the notch; to 5 µs."""
    bench, low, high = load_bench("reference"), 250, 1000
    while high - low > 5:
        middle = (low + high) // 2
        levels = {axis.level for axis in stability(bench, axes, "host", 1e-6 * middle, 1)}
        low, high = (middle, high) if levels <= {"stable", "not known"} else (low, middle)
    return 1e-6 * low


def shortest_s(bench: Bench, axes: tuple[int, ...], loop: LoopName, wire: WireTiming) -> float:
    """The shortest SYNC period in which every answer comes, whatever the contents; with the notch."""
    return plan_cycle(bench, axes, loop, PERIODS_S[-1], notch_state=loop == "drive").shortest_period_s(wire)


def elsewhere(bench: Bench) -> list[str]:
    """What the plan says of other wiring for the host-closed line."""
    cycle = plan_cycle(bench, LINE_AXES, "host", 500e-6, notch_state=False)
    classic, fd = WireTiming(CLASSIC_MAX_BITRATE), WireTiming(CLASSIC_MAX_BITRATE, FD_DATA_BITRATE)
    rows: list[tuple[str, list[Cycle], WireTiming]] = [
        ("classic CAN, 1 Mbit/s, as the bench maps it", [cycle], classic),
        ("the same, frames packed (torques in one RPDO, position alone in the TPDO)", [packed(cycle)], classic),
        (f"CAN FD, 1 Mbit/s and {rate_text(FD_DATA_BITRATE)}", [cycle], fd),
        ("CAN FD, frames packed", [packed(cycle)], fd),
        ("one classic bus per axis, 1 Mbit/s", per_axis(cycle), classic),
        ("one classic bus per axis, frames packed", per_axis(packed_alone(cycle)), classic),
        ("one CAN FD bus per axis", per_axis(cycle), fd),
    ]
    lines = ["| wiring, line motion, host-closed | shortest period | 0.5 ms | 0.25 ms |", "|---|---|---|---|"]
    for title, buses, wire in rows:
        shortest = max(bus.shortest_period_s(wire) for bus in buses)
        cells = ["fits" if shortest <= period else "–" for period in (500e-6, 250e-6)]
        lines.append(f"| {title} | {1e6 * shortest:.0f} µs | {cells[0]} | {cells[1]} |")
    return lines


# -- the page --------------------------------------------------------------------------------------------------------------


def _pair(
    found: dict[Cell, Found], axis: int | None, loop: LoopName, period: float, rate: WireTiming | None
) -> tuple[Found, Found]:
    without, with_ = (found[Cell(axis, loop, period, rate, way)] for way in WAYS)
    return without, with_


def _words(without: Found, with_: Found) -> str:
    if without.kind == with_.kind == "run":
        return f"{without.tip_mm:.3f} / {with_.tip_mm:.3f}"
    worse = with_ if with_.kind != "run" else without
    if worse.kind == "refused":
        return "unstable" if worse.words.startswith("pole") else worse.words
    return "–" if worse.words == "plan" else "– (run)"


def _rate_name(rate: WireTiming | None) -> str:
    if rate is None:
        return "ideal bus"
    return rate.name if rate.data_bitrate is None else f"FD, {rate.name}"


def table(found: dict[Cell, Found], axis: int | None) -> list[str]:
    """Tip peak without and with the notch, by loop, period and bit rate."""
    heads = [_rate_name(rate) for rate in RATES]
    lines = [f"| loop | SYNC period | {' | '.join(heads)} |", "|---|---|" + "---|" * len(heads)]
    for loop in LOOPS:
        for period in PERIODS_S:
            cells = [_words(*_pair(found, axis, loop, period, rate)) for rate in RATES]
            lines.append(f"| {loop}-closed | {1e3 * period:g} ms | {' | '.join(cells)} |")
    return lines


def reduction_pct(found: dict[Cell, Found], axis: int | None, loop: LoopName, period: float, rate: WireTiming | None) -> float:
    """Reduction by the notch: of the tip peak (one axis), of the spectrum's area (line); nan where there is no pair."""
    without, with_ = _pair(found, axis, loop, period, rate)
    name = "area" if axis is None else "tip_mm"
    before, after = getattr(without, name), getattr(with_, name)
    return math.nan if before is None or after is None else float(100.0 * (1.0 - after / before))


def _range(values: Iterable[float]) -> str:
    known = [value for value in values if not math.isnan(value)]
    return f"{min(known):.0f} to {max(known):.0f} %" if known else "none"


def figure(found: dict[Cell, Found], bench: Bench) -> str:
    """Suppression over SYNC period for both loops, and the period from which each bit rate carries them."""
    with style.styled():
        drawing, panels = style.panels(2, 2, 6.6, sharex=True, sharey="row")
        for row, axis in enumerate(MOTIONS):
            for column, loop in enumerate(LOOPS):
                _panel(panels[row, column], found, bench, axis, loop)
        for panel in panels[-1]:
            panel.set_xlabel("SYNC period (ms)")
        style.legend_above(drawing, panels[0, 0], columns=3)
        return standalone(str(style.to_svg(drawing, "bus")), "Reduction by the notch over the SYNC period")


_LINES: dict[WireTiming | None, dict[str, Any]] = {
    FAST: {"color": style.ORANGE, "linestyle": (0, (3, 1)), "marker": "P", "markersize": 5.0},
    None: {"color": style.BLACK, "linestyle": "-", "marker": "o", "markerfacecolor": style.PAPER, "markersize": 6.0},
    WireTiming(1_000_000): {"color": style.BLUE, "linestyle": (0, (5, 1.5)), "marker": "s"},
    WireTiming(500_000): {"color": style.VERMILLION, "linestyle": (0, (5, 1.5, 1, 1.5)), "marker": "^", "markersize": 4.5},
    WireTiming(250_000): {"color": style.GREEN, "linestyle": (0, (1, 1)), "marker": "D", "markersize": 4.5},
    WireTiming(125_000): {"color": style.PURPLE, "linestyle": (0, (1, 2)), "marker": "v"},
}


def _panel(panel: Axes, found: dict[Cell, Found], bench: Bench, axis: int | None, loop: LoopName) -> None:
    axes = LINE_AXES if axis is None else (axis,)
    for rate in reversed(RATES):
        values = [reduction_pct(found, axis, loop, period, rate) for period in PERIODS_S]
        label = _rate_name(rate)
        panel.plot(1e3 * np.array(PERIODS_S), values, label=label, **_LINES[rate])
    panel.set_xscale("log")
    panel.set_xlim(0.2, 8.0)
    panel.set_xticks([1e3 * period for period in PERIODS_S], [f"{1e3 * period:g}" for period in PERIODS_S])
    panel.minorticks_off()
    for rate in reversed(RATES):
        if rate is not None:
            _mark_shortest(panel, 1e3 * shortest_s(bench, axes, loop, rate), rate)
    if loop == "host":
        edge = 1e3 * longest_stable_s(axes)
        panel.axvspan(edge, panel.get_xlim()[1], color=style.SHADE, zorder=0)
        panel.annotate(
            f"refused: loop not stable\nfrom {edge:.2f} ms on", (edge, 0.88), xytext=(6, 0), va="top",
            xycoords=("data", "axes fraction"), textcoords="offset points", fontsize=7.5,
            bbox={"facecolor": style.SHADE, "edgecolor": "none", "pad": 1.0},
        )  # fmt: skip
    what = "line, area of spectrum" if axis is None else "axis 2, tip peak"
    panel.set_title(f"{what}: {loop}-closed")
    panel.set_ylabel("Reduction by the notch (%)" if loop == LOOPS[0] else "")
    panel.set_ylim(0.0, 60.0)
    asked = bench.specification.line_area_reduction_pct
    if axis is None and asked is not None:
        panel.axhline(asked, **style.LIMIT)
        panel.annotate(
            f"paper: {asked:g} %", (0.0, asked), xytext=(3, -3), ha="left", va="top",
            xycoords=("axes fraction", "data"), textcoords="offset points", fontsize=7.5,
            bbox={"facecolor": style.PAPER, "edgecolor": "none", "pad": 0.6},
        )  # fmt: skip


def _mark_shortest(panel: Axes, shortest_ms: float, rate: WireTiming) -> None:
    """Draw the shortest period that a bit rate carries, with its name along the line, on the same side of every line."""
    panel.axvline(shortest_ms, color=_LINES[rate]["color"], linestyle=_LINES[rate]["linestyle"], linewidth=0.9)
    low, high = panel.get_xlim()
    if low < shortest_ms < high:
        panel.annotate(
            f"{'FD' if rate.data_bitrate else rate_text(rate.bitrate)}: {shortest_ms:.2f} ms", (shortest_ms, 0.03),
            xytext=(-3, 0), ha="right", va="bottom", rotation=90, rotation_mode="default",
            xycoords=("data", "axes fraction"), textcoords="offset points", fontsize=7.0,
        )  # fmt: skip


def _fill(text: str, indent: str = "") -> str:
    """A paragraph with one sentence per line."""
    return re.sub(r"(?<=\D\.) (?=[A-Z*–])", f"\n{indent}", " ".join(text.split()))


def page(found: dict[Cell, Found], bench: Bench) -> str:
    """docs/bus.md."""
    wire, names = WireTiming(CLASSIC_MAX_BITRATE), {2: "constant acceleration, axis 2", None: "line, axes 2, 3, 5"}
    rows = []
    for axis in MOTIONS:
        axes = LINE_AXES if axis is None else (axis,)
        host, drive = (shortest_s(bench, axes, loop, wire) for loop in ("host", "drive"))
        limits = (longest_stable_s(axes), host, drive)
        rows.append(f"| {names[axis]} | " + " | ".join(f"{1e6 * limit:.0f} µs" for limit in limits) + " |")
    limit = bench.specification.tip_mm
    return "\n".join([
        "# Host-closed or drive-closed over CAN?", "",
        _fill("""With this page you can decide where to close the loop. The answer is **drive-closed**. No SYNC period of the
              drives is both long enough for classic CAN and short enough for a loop that the host closes:"""), "",
        "| motion | host-closed loop is stable up to | 1 Mbit/s carries it from | 1 Mbit/s carries drive-closed from |",
        "|---|---|---|---|", *rows, "",
        "![Reduction by the notch over the SYNC period](bus.svg)", "",
        _fill("""Vertical lines: the shortest period at which a bit rate carries all answers at worst-case stuffing, with the
              notch. Shaded: periods that the master refuses (unstable, or M_s above 4). Dotted: the paper's 26 %."""), "",
        _fill("""`python -m benchmarks.bus_question --out docs` makes this page. It runs the emulated reference robot once for
              each cell, in lock-step. Frames take their bit times, stuff bits included."""), "",
        *(line for axis in MOTIONS for line in (
            f"## Tip peak without / with the notch, mm: {names[axis]}" + (f" (limit: {limit:g} mm)" if axis else ""), "",
            *table(found, axis), "")),
        _fill("""–: does not fit. By `hil plan`, not every answer comes before the next SYNC at worst-case stuffing. Cells
              with *run* were run nevertheless, and stopped. *unstable*, *M_s*: the master refuses the run before it enables a
              drive. The line has no limit for the tip; the paper reports 26 % less area of the spectrum."""), "",
        "## Other wiring, calculated by `hil plan` only", "", *elsewhere(bench), "",
        "## Conclusions", "",
        *(_fill(f"{number}. {text}", "   ") for number, text in enumerate(_meaning(found, bench), 1)), "",
    ])  # fmt: skip


def _meaning(found: dict[Cell, Found], bench: Bench) -> list[str]:
    """Conclusions from the cells, in sentences."""
    real, one, wire = tuple(rate for rate in RATES if rate is not None), (2,), WireTiming(CLASSIC_MAX_BITRATE)

    def taken(axis: int | None, loop: LoopName, rates: tuple[WireTiming | None, ...]) -> str:
        return _range(reduction_pct(found, axis, loop, period, rate) for period in PERIODS_S for rate in rates)

    def us(axes: tuple[int, ...], loop: LoopName) -> str:
        return f"{1e6 * shortest_s(bench, axes, loop, wire):.0f} µs"

    stable, stable_line = (f"{1e6 * longest_stable_s(axes):.0f} µs" for axes in (one, LINE_AXES))
    limit = bench.specification.tip_mm
    with_notch = [f for c, f in found.items() if c.axis == 2 and c.loop == "drive" and c.compensation == "notch" and c.wire]
    peaks = [f.tip_mm for f in with_notch if f.tip_mm is not None]
    above = sum(peak > limit for peak in peaks)
    return [
        f"""Close the loop in the drive. At bit rates that carry the frames, the notch lowers axis 2's tip peak by
        {taken(2, "drive", real)}. It lowers the area of the line's spectrum by {taken(None, "drive", real)}.""",
        f"""The bus then carries only set-points: its period affects their smoothness, not the stability of the loop. On an
        ideal bus the notch lowers the tip peak by {taken(2, "drive", (None,))}, at any period from 0.25 to 4 ms.""",
        f"""With the notch, {above} of the {len(peaks)} drive-closed cells of axis 2 on a real bus are above {limit:g} mm; the
        largest has {max(peaks):.3f} mm.""",
        f"""On an ideal bus, the notch reduces the peak of a host-closed loop as much ({taken(2, "host", (None,))}; line
        {taken(None, "host", (None,))}). But with one period of delay that loop is stable only up to a period of {stable}
        (axis 2) or {stable_line} (all three). Lower gains would make it stable, but less stiff.""",
        f"""Classic CAN at 1 Mbit/s needs {us(one, "host")} for one axis and the accelerometer, {us(LINE_AXES, "host")} for
        three. So the host can close one axis at 0.5 ms, with little margin on the bus and M_s near its limit. For three axes
        no period suits both bus and loop.""",
        f"""1 Mbit/s carries one drive-closed axis from {us(one, "drive")} on, and three from {us(LINE_AXES, "drive")} on.
        For three axes 2 ms is a sound default, or 4 ms at 500 kbit/s.""",
        """A run that does not fit ends within a few cycles, because answers are missing or late.""",
        """CAN FD (1 and 5 Mbit/s) carries three axes at 0.5 ms host-closed, at 1 ms drive-closed.""",
        """These numbers are of one robot, one seed and one set of gains: `hil plan` gives the limits of another bench.""",
    ]


def main() -> None:
    """Run what is missing, and write bus.md and bus.svg."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs"), help="directory of bus.md and bus.svg")
    parser.add_argument("--cells", type=Path, default=Path("build/bus-question"), help="where cells are kept")
    arguments = parser.parse_args()
    found, bench = study(arguments.cells), load_bench("reference")
    arguments.out.mkdir(parents=True, exist_ok=True)
    (arguments.out / "bus.svg").write_text(figure(found, bench) + "\n", encoding="utf-8")
    (arguments.out / "bus.md").write_text(page(found, bench), encoding="utf-8")


if __name__ == "__main__":
    main()
