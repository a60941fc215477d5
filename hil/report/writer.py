"""Writer of a directory's page, by the kind of its result."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from hil.report import style
from hil.report.pages import arm, ate, compare, demo, learn, learn_motion, plant, recorded_ate
from hil.report.pages.page import Page, render
from hil.results.arm import ArmResult
from hil.results.ate import AteResult
from hil.results.base import RESULT_FILE, Result
from hil.results.comparison import TreatmentTable
from hil.results.files import ResultFileError, load_any
from hil.results.learning import LearningResult, MotionLearningResult
from hil.results.plant import PlantResult
from hil.results.recorded_ate import RecordedAteResult
from hil.results.runs import ExperimentsResult

_PAGES: tuple[tuple[type[Result], Callable[[Path, Any], Page]], ...] = (
    (ExperimentsResult, demo.page_of),
    (TreatmentTable, compare.page_of),
    (LearningResult, learn.page_of),
    (MotionLearningResult, learn_motion.page_of),
    (AteResult, ate.page_of),
    (RecordedAteResult, recorded_ate.page_of),
    (ArmResult, arm.page_of),
    (PlantResult, plant.page_of),
)
"""Kinds of results, each with its page, from directory and result."""


def write_report_of(directory: Path, *, is_interactive: bool = False) -> Path:
    """Write `report.html` into a directory of results; return its path.

    Raises:
        NotPossibleError: It shall be interactive, and Bokeh is not installed.
        OSError: result.json or a recording cannot be read, or the page cannot be written.
        ValueError: result.json is not a readable result, or one without a page.
    """
    result = load_any(directory / RESULT_FILE)
    page_of = next((made for kind, made in _PAGES if isinstance(result, kind)), None)
    if page_of is None:
        raise ResultFileError(directory / RESULT_FILE, f"a result of the kind {result.kind!r} has no report of its own")
    with style.styled():
        page = page_of(directory, result)
    return render(directory / "report.html", page, is_interactive=is_interactive)
