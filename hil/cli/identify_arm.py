"""`hil identify arm`: masses of an arm from its axes' plants."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drive_profiles.cli.application import command
from hil.cli.console import ExitStatus, epilog_without_motion, exit_on_error, result_directory, show_page, tell_result
from hil.cli.options import BenchOption, ForceOption, JsonOption, NewOutOption

if TYPE_CHECKING:  # --help must not wait for numpy and scipy
    from hil.results.arm import ArmResult

ARM_EPILOG = epilog_without_motion({
    ExitStatus.DONE: "identified",
    ExitStatus.FILE: "bad file, or too few postures in the model file",
    ExitStatus.NOT_MET: "the postures do not determine the masses; the message names one to add",
})  # fmt: skip


@command(epilog=ARM_EPILOG)
def arm(
    bench_file: BenchOption,
    model: Annotated[Path, typer.Option("--model", help="Model file with the postures; the arm's masses are added to it.")],
    out: NewOutOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Identify the masses of an arm from plants in several postures.

    It needs three postures or more, and predicts the dips of all others. It sends nothing, and needs no robot.
    hil identify plant --posture-deg measures the postures.

    Example: hil identify arm --bench bench.toml --model model.toml
    """
    with exit_on_error(moves=False):
        from hil.bench.bench import load_bench
        from hil.bench.model import load_identified

        where = result_directory(out, "identify-arm", force=force)
        bench, identified = load_bench(bench_file), load_identified(model)

        from hil.experiments.arm_masses import identify_arm
        from hil.results.base import RESULT_FILE

        result = identify_arm(bench, identified)
        result.write(where / RESULT_FILE)
        identified.with_arm(result.arm).save(model)
        tell_result(result, where, lambda: _summary(result), model, as_json=as_json)


def _summary(result: "ArmResult") -> None:
    """Print verdict and tables of the result's page, and dips along the line."""
    from hil.report.pages import arm as page

    show_page(page.verdict(result), page.dips(result), page.gears(result))
    for row in result.line[:: max(1, (len(result.line) - 1) // 4)]:
        dips = ", ".join(f"{hz:.2f} ± {off:.2f}" for hz, off in zip(row.dips_hz, row.standard_error_hz, strict=True))
        typer.echo(f"  rings at {100.0 * row.way_fraction:.0f} % of the line: {dips} Hz")
