"""Tables of a comparison: treatments side by side, what they cost, and what was left out."""

from collections.abc import Mapping
from typing import Any

from markupsafe import Markup

from hil.experiments.treatment import TITLES
from hil.report.tables import NONE, Cell, Mark, Table, number

Document = dict[str, Any]
Row = Mapping[str, Any]


def places(result: Document) -> list[tuple[str, int | None]]:
    """The experiments in the order in which they were run."""
    found = ((row["experiment"], row["axis"]) for robot in result["robots"] for row in robot["rows"])
    return list(dict.fromkeys(found))


def place_name(experiment: str, axis: int | None) -> str:
    """An experiment in words."""
    return experiment.replace("-", " ") if axis is None else f"axis {axis}, {experiment.replace('-', ' ')}"


def way_name(row: Row) -> str:
    """A treatment in words; drive-closed unless it says otherwise."""
    name: str = row["compensation"]
    return TITLES.get(name, name) + (", host-closed" if row["loop"] == "host" else "")


def change(percent: float | None) -> str:
    """A change in percent with its sign."""
    return NONE if percent is None else number(percent, "{:+.0f} %")


def overview(result: Document, key: str = "overview", caption: str | Markup = "") -> Table | None:
    """The tip's peak of every treatment in every experiment."""
    if not any(row["tip_peak_mm"] is not None for robot in result["robots"] for row in robot["rows"]):
        return None
    columns, several = places(result), len(result["robots"]) > 1
    rows: list[list[Cell]] = []
    for robot in result["robots"]:
        ways = list(dict.fromkeys((row["compensation"], row["loop"]) for row in robot["rows"] if "left_out" not in row))
        for way in ways:
            own = {(row["experiment"], row["axis"]): row for row in robot["rows"] if (row["compensation"], row["loop"]) == way}
            name = way_name(next(iter(own.values())))
            rows.append([*([robot["name"]] if several else []), name, *(_peak(own.get(place)) for place in columns)])
    head = ("robot", "what acts") if several else ("what acts",)
    header = (*head, *(f"{place_name(*place)} (mm)" for place in columns))
    limits = {robot["tip_mm"] for robot in result["robots"]}
    asked = f" Asked: ±{limits.pop():g} mm." if len(limits) == 1 else ""
    said = caption or "Largest equivalent displacement of the tip in the window in which each run is judged."
    return Table(key, "Tip peaks side by side", "", header, rows, frozenset(range(len(head))), said + asked)


def _peak(row: Row | None) -> Cell:
    if row is None or "left_out" in row:
        return Mark(None, "left out")
    if row["tip_peak_mm"] is None:
        return Mark(None, "refused by its trial" if row["trial"] == "refused" else "not judged")
    return Mark(row["within_spec"], f"{row['tip_peak_mm']:.3f}")


def experiment(result: Document, name: str, axis: int | None) -> Table | None:
    """One experiment: a row per robot and treatment."""
    several, rows = len(result["robots"]) > 1, list[list[Cell]]()
    for robot in result["robots"]:
        for row in _in_order(robot["rows"], name, axis):
            rows.append([*([robot["name"]] if several else []), *_cells(row)])
    if not rows:
        return None
    head = ("robot",) if several else ()
    header = (
        *head,
        "what acts",
        "closed in",
        "tip peak (mm)",
        "change",
        "spectrum area (m/s²·Hz)",
        "change",
        "specification",
        "trial",
        "compliance at 1 Hz",
        "largest",
    )
    left = len(head)
    return Table(
        f"table-{key_of(name, axis)}",
        f"{place_name(name, axis).capitalize()}: every treatment",
        "",
        header,
        rows,
        frozenset({*range(left + 2), left + 6, left + 7}),
        "Changes are against nothing, closed in the same place. The trial is a cancellation's own check on the accelerometer "
        "before it is used. Compliance: how many times further the motor gives way to a disturbing torque than without the "
        "treatment, at 1 Hz and at the frequency from 0.1 to 30 Hz where it gives way most, for the worst of the moved axes at "
        "the worst speed; from the model, so without one there is none." + _host_words(rows, left),
    )


def _host_words(rows: list[list[Cell]], left: int) -> str:
    if not any(row[left + 1] == "host" for row in rows):
        return ""
    return (
        " The fixed notch runs on the host alone, which closes the loop over the bus with a sample of delay, and is compared "
        "with nothing acting there."
    )


def _in_order(rows: list[Row], name: str, axis: int | None) -> list[Row]:
    """Drive-closed first, as they were run; what was left out behind."""
    own = [row for row in rows if (row["experiment"], row["axis"]) == (name, axis)]
    return sorted(own, key=lambda row: "left_out" in row)


def _cells(row: Row) -> list[Cell]:
    factors = row["compliance"]
    told = [NONE, NONE] if factors is None else [f"× {factors['slow']:.2f}", f"× {factors['peak']:.2f}"]
    if "left_out" in row:
        within = Mark(None, "left out")
    elif "not_judged" in row:
        within = Mark(None, "not judged")
    else:
        within = Mark(row["within_spec"], "within" if row["within_spec"] else "outside")
    trial: Cell = NONE if row["trial"] is None else Mark(row["trial"] == "accepted", row["trial"])
    return [
        TITLES.get(row["compensation"], row["compensation"]),
        row["loop"],
        number(row["tip_peak_mm"], "{:.4f}"),
        change(row["tip_peak_change_pct"]),
        number(row["spectrum_area"], "{:.3f}"),
        change(row["spectrum_area_change_pct"]),
        within,
        trial,
        *told,
    ]


def left_out(result: Document) -> Table | None:
    """What was not run or not judged, grouped by the reason."""
    reasons: dict[tuple[str, str], list[str]] = {}
    for robot in result["robots"]:
        for row in robot["rows"]:
            reason = row.get("left_out") or row.get("not_judged")
            if reason:
                where = "line motion" if row["axis"] is None else f"axis {row['axis']}"
                reasons.setdefault((robot["name"], reason), []).append(f"{way_name(row)} ({where})")
    if not reasons:
        return None
    rows: list[list[Cell]] = [[name, "; ".join(ways), reason] for (name, reason), ways in reasons.items()]
    return Table("left-out", "What was left out or not judged", "", ("robot", "what", "why"), rows, frozenset({0, 1, 2}))


def compliances(result: Document) -> Table | None:
    """How far the motor gives way, by axis and treatment."""
    rows: list[list[Cell]] = []
    several = len(result["robots"]) > 1
    for robot in result["robots"]:
        plain = {(each["axis"], each["loop"]): each for each in robot["compliance"] if each["compensation"] == "none"}
        for each in robot["compliance"]:
            own = plain.get((each["axis"], each["loop"]))
            factors = [NONE, NONE] if own is None else [f"× {each[part] / own[part]:.2f}" for part in ("slow", "peak")]
            rows.append([
                *([robot["name"]] if several else []), f"axis {each['axis']}", way_name(each),
                number(each["slow"], "{:.4f}"), factors[0], number(each["peak"], "{:.4f}"), factors[1],
                number(each["peak_hz"], "{:.1f}"),
            ])  # fmt: skip
    if not rows:
        return None
    head = ("robot",) if several else ()
    header = (*head, "axis", "what acts", "at 1 Hz (rad/(N·m))", "", "largest (rad/(N·m))", "", "at (Hz)")
    return Table(
        "compliance",
        "What lower gains and filters cost: compliance of the motor",
        "",
        header,
        rows,
        frozenset(range(len(head) + 2)),
        "|θ_m/τ_d| = |P/(1 + P C)|: how far the motor turns under a disturbing torque beside its own, the loop closed, from the "
        "model. Filters that follow the speed: the worst speed, where they act. Cancellation leaves the loop as it is.",
    )


def story(result: Document) -> Table | None:
    """The steps that led to a comparison, where it has a story."""
    told = result.get("story")
    if not told or not told["steps"]:
        return None
    rows: list[list[Cell]] = []
    for step in told["steps"]:
        linked: Cell = NONE
        if step["link"]:
            linked = Markup('<a href="{}">{}</a>').format(step["link"], "report" if step["link"].endswith(".html") else "file")
        rows.append([step["name"], step["what"], Mark(step["holds"], ""), number(step["seconds"], "{:.1f}"), linked])
    caption = Markup(
        "The bench file knew nothing of plant and transmission error: <a href='{}'>{}</a>. Each step is a command of its own "
        "that can be repeated on a real robot."
    ).format(told["bench_file"], told["bench_file"])
    header = ("step", "what came", "done", "time (s)", "")
    return Table("story", "From a bench file to a quiet arm", "", header, rows, frozenset({0, 1, 2, 4}), caption)


def key_of(experiment: str, axis: int | None) -> str:
    """For anchors."""
    return experiment if axis is None else f"{experiment}-axis{axis}"
