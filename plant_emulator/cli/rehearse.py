"""plant-emulator rehearse: the documented path on many drawn robots."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drive_profiles.cli.application import command
from drive_profiles.cli.console import fail, print_json, table
from drive_profiles.cli.entry import interrupted
from plant_emulator.cli.console import EmulatorExitStatus, JsonOption, ends, exit_on_error, exit_on_value_error
from plant_emulator.cli.fleet import KindName, KindOption, OutOption
from plant_emulator.cli.pool import JobsOption, OnOption, executors_of, trials

if TYPE_CHECKING:
    from plant_emulator.rehearsal.many.rows import Kept
    from plant_emulator.trials.executors import Executors
    from plant_emulator.trials.rows import Row

EPILOG = ends(
    EmulatorExitStatus.BUS,
    EmulatorExitStatus.NOT_MET,
    DONE="done, whatever the numbers",
    FILE="bad file, or a folder that holds another rehearsal",
    BUS="no scheduler, or it is lost",
    NOT_MET="with --check: a goal is not reached",
    INTERRUPTED="interrupted; finished robots are kept",
)

ARMS = "arms"
"""What the settings of a rehearsal of arms have for a kind."""
SeedsOption = Annotated[str | None, typer.Option("--seeds", metavar="SEEDS", help="Seeds of the robots: 7, 1-1000, 1-40,50.")]
ArmsOption = Annotated[
    bool, typer.Option("--arms", help="Whole arms: learn on their line, test on others; seed 0 is the reference arm.")
]
OverBusOption = Annotated[bool, typer.Option("--over-bus", help="Use a bus: each robot is served, and each tool is a process.")]
ResumeOption = Annotated[bool, typer.Option("--resume", help="Continue the folder's rehearsal with the missing robots.")]
KeepOption = Annotated[bool, typer.Option("--keep", help="Keep all files of each robot, in files/SEED of the folder.")]
CheckOption = Annotated[bool, typer.Option("--check", help="End with exit status 9 if a goal is not reached.")]
SummaryOption = Annotated[
    Path | None,
    typer.Option("--summary", metavar="DIR", help="Run no robot: rewrite table and report of DIR, and print Markdown."),
]


@command(epilog=EPILOG)
def rehearse(
    seeds: SeedsOption = None,
    out: OutOption = Path("rehearsal"),
    kind: KindOption = "both",
    arms: ArmsOption = False,
    over_bus: OverBusOption = False,
    jobs: JobsOption = None,
    on: OnOption = None,
    resume: ResumeOption = False,
    keep: KeepOption = False,
    check: CheckOption = False,
    summary: SummaryOption = None,
    as_json: JsonOption = False,
) -> None:
    """Rehearse the documented path on many drawn robots.

    The report states on how many robots the tip becomes quiet, on which it does not, and why.

    Each robot is drawn by its seed and treated with a bench file that has no knowledge of it: identification, design,
    cancellation, learning; then its true tip is measured. Each robot's row is saved at once: an interruption loses only
    the robots under way.

    Examples:
        plant-emulator rehearse --seeds 1-1000 --out rehearsal

        plant-emulator rehearse --seeds 1-1000 --out rehearsal --resume

        plant-emulator rehearse --seeds 1-1000 --on dask:tcp://127.0.0.1:8786

        plant-emulator rehearse --seeds 7 --kind real --keep --out look

        plant-emulator rehearse --arms --seeds 0-20 --out arms

        plant-emulator rehearse --summary rehearsal
    """
    from plant_emulator.rehearsal.many.rows import Kept, RehearsalSettings
    from plant_emulator.rehearsal.many.seeds import seeds_of

    with exit_on_error():
        if summary is not None:
            if seeds is not None:
                raise fail("--summary only rewrites the report; do not give --seeds", EmulatorExitStatus.USAGE)
            kept = Kept(summary)
            kept.settings()
            _tell(kept, check=check, as_json=as_json, as_markdown=True)
            return
        if seeds is None:
            raise fail("--seeds is needed, such as --seeds 1-40; or --summary DIR", EmulatorExitStatus.USAGE)
        with exit_on_value_error():
            named = seeds_of(seeds)
        if arms and over_bus:
            raise fail("--arms uses no bus; leave --over-bus out", EmulatorExitStatus.USAGE)
        if on is not None and keep:
            raise fail("--keep needs this machine's file system; leave --on out", EmulatorExitStatus.USAGE)
        executors = executors_of(on, jobs)
        kept = Kept(out)
        kept.begin(RehearsalSettings(ARMS if arms else kind, over_bus), resume=resume)
        _run_missing(kept, named, executors, None if arms else kind, over_bus=over_bus, keep=keep)
        _tell(kept, check=check, as_json=as_json)


def _run_missing(
    kept: "Kept", seeds: Sequence[int], executors: "Executors", kind: KindName | None, *, over_bus: bool, keep: bool
) -> None:
    """Run the missing robots (arms without kind), saving each row at once."""
    from plant_emulator.rehearsal.arms.path import run_arm_seed
    from plant_emulator.rehearsal.many.one import kind_of, run_seed
    from plant_emulator.rehearsal.many.reading import is_quiet
    from plant_emulator.rehearsal.many.rows import crashed
    from plant_emulator.trials.executors import run_all

    there = kept.seeds()
    missing = [seed for seed in seeds if seed not in there]
    if len(missing) < len(seeds):
        typer.echo(f"{len(seeds) - len(missing)} of {len(seeds)} robots are done already", err=True)
    if not missing:
        return
    done = quiet = 0
    files = str(kept.folder.resolve() / "files") if keep else None

    def kept_words() -> str:
        return f"{done} of {len(missing)} robots are done and kept; continue with --resume"

    try:
        with trials("robots" if kind else "arms", len(missing), executors, kept_words) as step, executors:

            def on_row(row: "Row") -> None:
                nonlocal done, quiet
                seed = row["seed"]
                kept.keep({"kind": kind_of(seed, kind)} | dict(row) if isinstance(seed, int) and kind is not None else row)
                done, quiet = done + 1, quiet + is_quiet(row)
                step(1, f"{quiet} of {done} within the goal")

            if kind is None:
                run_all(missing, run_arm_seed, (files,), executors, on_row, crashed)
            else:
                run_all(missing, run_seed, (kind, over_bus, files), executors, on_row, crashed)
    except KeyboardInterrupt as error:
        raise fail(f"{interrupted(error)}; {kept_words()}", EmulatorExitStatus.INTERRUPTED) from None


def _tell(kept: "Kept", *, check: bool, as_json: bool, as_markdown: bool = False) -> None:
    """Write table and report of all robots in the folder."""
    from drive_profiles.files.safefile import write_json
    from plant_emulator.rehearsal.arms.summary import arm_claims, arm_sections
    from plant_emulator.rehearsal.many.claims import claims_of, document
    from plant_emulator.rehearsal.many.page import sections, write_page
    from plant_emulator.rehearsal.many.rows import CLAIMS_FILE, PAGE_FILE
    from plant_emulator.trials.page import as_markdown as tables_as_markdown
    from plant_emulator.trials.rows import write_table

    rows = kept.rows()
    if not rows:
        raise fail(f"{kept.folder}: no robot has a result yet", EmulatorExitStatus.FILE)
    are_arms = kept.settings().kind == ARMS
    found = arm_claims(rows) if are_arms else claims_of(rows)
    chapters = arm_sections(rows, found) if are_arms else sections(rows, found)
    whole = document(rows, found)
    written = [*write_table(kept.folder, rows), kept.folder / CLAIMS_FILE]
    write_json(kept.folder / CLAIMS_FILE, whole, force=True)
    written.append(write_page(kept.folder / PAGE_FILE, rows, found, chapters))
    if as_json:
        print_json(whole)
    elif as_markdown:
        typer.echo(tables_as_markdown(chapters))
    else:
        signs = {True: "yes", False: "no", None: "not judged"}
        lines = [(each.name, each.asked, each.measured, signs[each.holds]) for each in found]
        title = f"{len(rows)} {'arm' if are_arms else 'robot'}{'s' * (len(rows) != 1)}"
        table(title, ("claim", "asked", "measured", "holds"), lines)
    typer.echo(f"files: {', '.join(map(str, written))}", err=True)
    failed = [each for each in found if each.holds is False]
    for each in failed:
        typer.echo(f"not reached: {each.words}; goal {each.asked}, measured {each.measured}", err=True)
    if failed and check:
        raise typer.Exit(EmulatorExitStatus.NOT_MET)
