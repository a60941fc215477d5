"""`hil demo`: the paper's experiments, and tours of two other robots.

All robots are emulated.
"""

import shutil
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drive_profiles.cli.application import command, folded
from drive_profiles.cli.completion import complete_reference
from hil.cli import console
from hil.cli.console import ExitStatus
from hil.cli.live import LiveCommand, LiveOption, shown_live
from hil.cli.options import ForceOption, JsonOption
from hil.cli.run import run_and_report

if TYPE_CHECKING:  # --help must not wait for it
    from hil.tour import TourOutcome

DEMO_EPILOG = console.epilog_of_runs({ExitStatus.NOT_MET: "a claim does not hold, or a run could not be judged"})
ROBOT_SEED = 77
"""Seed of the robot that the tour shows unless another is chosen: one on which every step has something to show."""

OutOption = Annotated[Path, typer.Option("--out", help="Directory for recordings, result.json and report.html.")]


@command(cls=LiveCommand, epilog=DEMO_EPILOG)
def demo(
    out: OutOption = Path("demo"),
    force: ForceOption = False,
    as_json: JsonOption = False,
    robot: Annotated[
        str, typer.Option("--robot", help="Robot file of the emulator, or `reference`.", autocompletion=complete_reference)
    ] = "reference",
    robot_seed: Annotated[
        int, typer.Option("--robot-seed", min=0, help="Seed of the unknown robot (plant-emulator fleet).")
    ] = ROBOT_SEED,
    no_tour: Annotated[
        bool, typer.Option("--no-tour", help="Only the paper's experiments, without the other two robots.")
    ] = False,
    live: LiveOption = None,
) -> None:
    """Run the paper's experiments on an emulated robot, with a report.

    Two more emulated robots follow: an unknown one, and a whole arm.

    The second part draws the unknown robot by a seed. It identifies the robot, designs and uploads a notch, and compares
    four runs: untreated, with the notch, the designed notch and cancellation. At the end it shows the robot's true values.

    The last part takes a whole arm of six axes, learns a cancellation on its line, and runs the line with it.

    Example: hil demo --out demo
    """
    with console.exit_on_error():
        from hil.emulator import EmulatorProcess

        console.result_directory(out, "demo", force=force)
        with EmulatorProcess(robot) as emulator:
            from hil.bench.bench import load_bench
            from hil.experiments.plan import demo_experiments
            from hil.experiments.treatment import known_from

            bench = console.bench_on_emulator(load_bench("reference"), str(emulator.address))
            with shown_live(live, bench.bus.address, "reference"):
                status = run_and_report(
                    bench, demo_experiments(bench), out, as_json=as_json, is_paper=True, knowledge=known_from("reference", bench)
                )
        if not no_tour and status in {0, ExitStatus.NOT_MET}:
            status = _run_tours(robot_seed, out, live, as_json=as_json) or status
        for line in next_steps(tool_prefix(sys.argv[0])):
            console.say(line)
        if status:
            raise typer.Exit(status)


NEXT = (
    ("the emulated robot, for any tool to connect to", "plant-emulator serve --robot reference --bus local:/tmp/robot.sock"),
    (
        "in another terminal: one experiment on it",
        "hil run constant-acceleration --axis 2 --treatment notch --bench reference --bus local:/tmp/robot.sock",
    ),
    (
        "identify its plant",
        "hil identify plant --bench reference --bus local:/tmp/robot.sock --axis 2 --model model.toml",
    ),
    ("check the bus load of your own bench", "hil plan --bench bench.toml"),
)
"""Commands that somebody may want after the demo, with what each is for."""


def next_steps(prefix: str = "") -> list[str]:
    """Return lines on further steps, each with its command.

    `prefix` is the folder of the tools with its slash; empty if the shell finds them.
    """
    lines = ["", "What next:"]
    for purpose, example in NEXT:
        lines += [f"  {purpose}", *(f"    {line}" for line in folded(prefix + example, 74))]
    if not (Path(__file__).parents[2] / "docs" / "tuning.md").is_file():
        return lines  # a wheel has no pages
    return [
        *lines,
        "  A whole arm, from its links to a quiet line: docs/arm.md",
        "  A robot of your own, from its bench file to the designed notch, step by step: docs/tuning.md",
    ]


def tool_prefix(program: str) -> str:
    """Return the folder in front of a tool's name; empty on PATH."""
    path = Path(program)
    found = shutil.which(path.name)
    if path.name != "hil" or path.parent == Path() or (found is not None and Path(found).resolve() == path.resolve()):
        return ""
    folder = path.parent
    return f"{folder.relative_to(Path.cwd()) if folder.is_relative_to(Path.cwd()) else folder}/"


def _run_tours(seed: int, out: Path, live: int | None, *, as_json: bool) -> int:
    """Run the demo's other parts, and return the exit status.

    The first part's report links to them. After a part that was interrupted, or failed for another reason than its
    findings, the next does not run.
    """
    from hil.report.writer import write_report_of

    try:
        own = _run_tour(seed, out, live, as_json=as_json)
        if own not in {ExitStatus.DONE, ExitStatus.NOT_MET}:
            return own
        return _run_arm_tour(out, live, as_json=as_json) or own
    finally:
        write_report_of(out)


def _run_tour(seed: int, out: Path, live: int | None, *, as_json: bool) -> int:
    """Run the tour, the demo's second part, and return the exit status."""
    from hil import tour
    from hil.emulator import EmulatorProcess, draw_robot
    from hil.report.pages.demo import TOUR_FOLDER

    console.say(f"your own robot: an unknown one, drawn by seed {seed}; --robot-seed draws another")
    with tempfile.TemporaryDirectory(prefix="hil-") as folder:
        robot = draw_robot(seed, Path(folder))
        with (
            EmulatorProcess(str(robot.robot_file)) as emulator,
            shown_live(live, str(emulator.address), str(robot.bench_file)),
        ):
            done = tour.run(str(emulator.address), out / TOUR_FOLDER, reporter=console.SpokenReporter(), robot=robot)
    # what was refused on a robot that anybody may draw is said, and no fault of the demo
    return _tell("your own robot", out / TOUR_FOLDER, done, as_json=as_json)


def _run_arm_tour(out: Path, live: int | None, *, as_json: bool) -> int:
    """Run the arm's tour, the demo's last part, and return the status."""
    from hil import arm_tour
    from hil.emulator import EmulatorProcess
    from hil.report.pages.demo import ARM_FOLDER

    console.say("a whole arm: six axes; only its joints and its motors' inertias are known")
    with EmulatorProcess("reference-arm") as emulator, shown_live(live, str(emulator.address), "reference-arm"):
        done = arm_tour.run(str(emulator.address), out / ARM_FOLDER, reporter=console.SpokenReporter())
    return _tell("a whole arm", out / ARM_FOLDER, done, as_json=as_json)


def _tell(what: str, folder: Path, done: "TourOutcome", *, as_json: bool) -> int:
    """Write the page of a tour, print its results, and return the exit status."""
    from hil.report.tables import compare as tables
    from hil.report.writer import write_report_of

    page = write_report_of(folder)
    console.show_comparison(done.result, err=as_json)
    console.echo_lines(tables.notch_sentences(done.result), err=as_json)
    claims = done.result.tour.claims or ()
    console.show(tables.claims(done.result), err=as_json)
    console.say(f"{what}: {page}")
    for unmet in [] if done.comparison is None else done.comparison.unmet:
        console.say(f"not compared: {unmet}")
    if done.failure is not None:
        code = console.exit_status_of(done.failure)
        if code == ExitStatus.INTERNAL:
            raise done.failure
        console.say(f"{what}: {console.message_of(done.failure)}")
        return code
    return ExitStatus.DONE if all(claim.holds for claim in claims) else ExitStatus.NOT_MET
