"""The page of a plant identification: one self-contained HTML file."""

from pathlib import Path

from hil.report.figures import plant as figures_plant
from hil.report.pages.page import Page, PageHead, PageVerdict, Section, bench_lines, filled_sections
from hil.report.report_table import Cell, ReportTable, value_and_error
from hil.results.plant import PlantResult


def page_of(_: Path, result: PlantResult) -> Page:
    """Return the page of `hil identify plant`, also if it has identified nothing."""
    head = PageHead.of(result, f"Plant of axis {result.axis}")
    return Page(head, verdict(result), sections(result), provenance=provenance(result))


def sections(result: PlantResult) -> list[Section]:
    """All chapters for which there is data."""
    return filled_sections(
        (
            "plant",
            "Plant",
            (figures_plant.parameters(result), figures_plant.modes(result), figures_plant.frequency_response(result)),
        ),
        ("arm", "The arm at the tip", (figures_plant.tip(result),)),
        ("slow", "Friction and gravity", (figures_plant.friction(result),)),
        ("limits", "How far these data reach", (_cannot_tell(result), figures_plant.checks(result))),
    )


def _cannot_tell(result: PlantResult) -> ReportTable:
    rows: list[list[Cell]] = [[line] for line in result.cannot_tell or ()]
    return ReportTable("cannot-tell", "What these data cannot tell", "", ("",), rows, is_prose=True)


def verdict(result: PlantResult) -> PageVerdict:
    """Verdict at the top of the page."""
    remarks, parameters = result.remarks, result.parameters
    if result.stopped is not None:
        return PageVerdict("bad", "■", "The run was stopped", (result.stopped, *remarks))
    if parameters is None:
        return PageVerdict("bad", "✘", "Not identified", (*(result.not_identified or ()), *remarks))
    f_a, stiffness = parameters["antiresonance_hz"], parameters["gear_stiffness_nm_rad"]
    headline = (
        f"f_a = {' ± '.join(value_and_error(f_a.value, f_a.standard_error))} Hz, "
        f"K_g = {' ± '.join(value_and_error(1e-3 * stiffness.value, 1e-3 * stiffness.standard_error))} kN·m/rad"
    )
    return PageVerdict("good", "✔", headline, remarks)


def provenance(result: PlantResult) -> list[tuple[str, str]]:
    """Bench, instant, versions and excitation of the measurement."""
    lines, plan = bench_lines(result.bench), result.plan
    if plan is not None:
        low, high = plan.travel_rev
        shape = result.request.shape
        lines += [
            (
                "Excitation",
                f"{shape} on the {plan.excitation}, peak {plan.amplitude_nm:.3g} N·m, crest {plan.crest_factor:.2f}",
            ),
            ("Motion", f"{plan.bias_rps:.3g} rev/s back and forth, {low:.1f} … {high:.1f} motor revolutions".replace("-", "−")),
        ]
    return lines
