"""Writer of a directory's page, by the kind of its result."""

from pathlib import Path

from hil.report.pages.arm import write_arm_report
from hil.report.pages.ate import write_ate_report
from hil.report.pages.compare import write_compare_report
from hil.report.pages.demo import write_report
from hil.report.pages.learn import write_learning_report
from hil.report.pages.learn_motion import write_motion_learning_report
from hil.report.pages.plant import write_plant_report
from hil.report.pages.recorded_ate import write_recorded_ate_report
from hil.results.arm import ArmResult
from hil.results.ate import AteResult
from hil.results.base import RESULT_FILE
from hil.results.comparison import TreatmentTable
from hil.results.files import ResultFileError, load_any
from hil.results.learning import LearningResult, MotionLearningResult
from hil.results.plant import PlantResult
from hil.results.recorded_ate import RecordedAteResult
from hil.results.runs import ExperimentsResult


def write_report_of(directory: Path, *, is_interactive: bool = False) -> Path:
    """Write `report.html` into a directory of results; return its path.

    Args:
        directory: Directory with result.json and the files that it names.
        is_interactive: True if the figures of the page can be zoomed.

    Raises:
        NotPossibleError: It shall be interactive, and Bokeh is not installed.
        OSError: result.json or a recording cannot be read, or the page cannot be written.
        ValueError: result.json is not a readable result, or one without a page.
    """
    result = load_any(directory / RESULT_FILE)
    match result:
        case ExperimentsResult():
            return write_report(directory, is_interactive=is_interactive)
        case TreatmentTable():
            return write_compare_report(directory, is_interactive=is_interactive)
        case LearningResult():
            return write_learning_report(directory, is_interactive=is_interactive)
        case MotionLearningResult():
            return write_motion_learning_report(directory, is_interactive=is_interactive)
        case AteResult():
            return write_ate_report(directory, is_interactive=is_interactive)
        case RecordedAteResult():
            return write_recorded_ate_report(directory, is_interactive=is_interactive)
        case ArmResult():
            return write_arm_report(directory, is_interactive=is_interactive)
        case PlantResult():
            return write_plant_report(directory, is_interactive=is_interactive)
    raise ResultFileError(directory / RESULT_FILE, f"a result of the kind {result.kind!r} has no report of its own")
