"""Design file: designed filters with predicted margins and tip peaks."""

from pathlib import Path
from typing import Annotated

from pydantic import Field

from drive_profiles.files.toml import Table, load, table_lines
from hil.bench.bench import Bench
from hil.bench.robot_file import RobotFile
from hil.control.notch import NOTCH_TRAPEZOID, NOTCHES, Notch
from hil.errors import NotPossibleError
from hil.robot_tables import AxisNumber, NotchTable, NotNegative, Positive


class DesignedAxis(Table):
    """The filters of one axis.

    Attributes:
        notch: The filters, written as in a bench file.
        tip_peak_mm: Tip peak predicted for the assumed plant on the bench file's ramp, by order.
        worst_tip_peak_mm: Tip peak of the worst of the plants, up or down the ramp, by order.
        sensitivity_peak: Largest M_s of all speeds and plants.
        phase_margin_deg: Smallest phase margin of all speeds and plants.
        gain_margin_db: Smallest gain margin of all speeds and plants.
        period_s: Sampling time of the loop for which the numbers were computed.
        delay_samples: Delay of that loop in samples.
        note: Origin of the plant.
    """

    notch: Annotated[tuple[NotchTable, ...], Field(min_length=1, max_length=NOTCHES)]
    tip_peak_mm: dict[str, NotNegative] = Field(default_factory=dict)
    worst_tip_peak_mm: dict[str, NotNegative] = Field(default_factory=dict)
    sensitivity_peak: Positive
    phase_margin_deg: NotNegative
    gain_margin_db: NotNegative
    period_s: Positive
    delay_samples: Annotated[int, Field(ge=0)] = 0
    note: str = ""


class Designs(RobotFile):
    """A design file.

    Attributes:
        robot: Name of the bench for which the filters were designed.
        axis: Filters of each axis, by its number.
    """

    kind = "the design file"

    axis: dict[AxisNumber, DesignedAxis] = Field(default_factory=dict)

    def dumps(self) -> str:
        """Return the file as TOML."""
        return "\n".join(table_lines(self.model_dump())) + "\n"


def load_designs(path: Path) -> Designs:
    """Read a design file.

    Raises:
        FileError: The file is not valid; every problem is listed by line.
    """
    return load(path, Designs)


def update_designs(path: Path, robot: str, number: int, axis: DesignedAxis) -> Designs:
    """Put one axis into a design file; a missing file is created.

    Raises:
        FileError: The file is not a design file, or cannot be written.
        NotPossibleError: The file belongs to another robot.
    """
    known = Designs.known(path, robot)
    updated = known.model_copy(update={"axis": dict(sorted({**known.axis, number: axis}.items()))})
    updated.save(path)
    return updated


def with_designs(bench: Bench, designs: Designs) -> Bench:
    """Return the bench with the designed filters of its axes.

    Raises:
        NotPossibleError: The file belongs to another robot, or names an axis that the bench does not have.
    """
    designs.check_robot(bench.name)
    if foreign := sorted(set(designs.axis) - set(bench.axis)):
        raise NotPossibleError(f"the design file has filters of axis {foreign[0]}, which bench {bench.name!r} does not have")
    changed = {
        number: bench.axis[number].model_copy(update={"notch": designed.notch}) for number, designed in designs.axis.items()
    }
    return bench.model_copy(update={"axis": {**bench.axis, **changed}})


def notch_table(notch: Notch) -> NotchTable:
    """A filter as a bench file writes it."""
    values = {name: value for name, value in vars(notch).items() if name != "mode"}
    return NotchTable(shape="trapezoid" if notch.mode == NOTCH_TRAPEZOID else "switched", **values)


def snippet(number: int, tables: tuple[NotchTable, ...]) -> list[str]:
    """Lines for a bench file or a design file."""
    return table_lines({"axis": {number: {"notch": [table.model_dump() for table in tables]}}})
