"""Run the stages of a test tier, and say at the end what failed and what each took.

    python -m tests.stages lint | everyday | ci | all

A stage that fails stops none of the others. CONTRIBUTING.md says what belongs to which tier. The `all` tier draws new random
examples in each run; its seed is printed, and `--seed` repeats it.
"""

import argparse
import os
import random
import re
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from xml.etree import ElementTree

ROOT = Path(__file__).parents[1]
BIN = Path(sys.executable).parent
RANDOM_FRAMES = 1_000_000
USERS = ("bench.toml", "model.toml", "design/design.toml", "demo/report.html", "drive-journals/axis2.json")
"""Files that somebody who uses the tools has beside the project's own."""
BELOW_HOME = (".bash_completions", ".cache", ".config", ".local/share", ".local/state", ".zfunc")
"""Where programs keep files of their own below a user's home."""
OURS = re.compile(r"[._]?(hil|hil[-_]bench|plant[-_]emulator|drive[-_]profiles)([-_.].*)?")
"""Names of the project's files and folders there; those of other programs are not its concern."""
SPELLED = ("README.md", "CONTRIBUTING.md", "docs", "drive_profiles", "hil", "plant_emulator")
"""Where people read words; tests misspell on purpose."""
SIDE_BY_SIDE = ("-n", "2", "--dist", "worksteal")
WITH_WAITING = ("-n", "3", "--dist", "worksteal")
"""Where workers wait for installations and for served robots: two used 80 % of two processors."""
ALONE = ("-p", "no:xdist")
SLAVE = ("tests/plant_emulator/slave", "tests/plant_emulator/image", "tests/plant_emulator/drive/test_state_machine.py")
"""The tests that take every branch of the slave engine and of the CiA 402 state machine."""
BRANCHES = (
    *("--cov=plant_emulator.slave", "--cov=plant_emulator.drive.state_machine", "--cov-branch"),
    *("--cov-report=term-missing:skip-covered", "--cov-fail-under=100"),
)


@dataclass(frozen=True)
class Stage:
    """A command, and whether it is pytest.

    Attributes:
        name: Word for it in the summary.
        command: Program and arguments.
        is_pytest: It is told to leave its results as JUnit XML.
        is_beside: It runs beside those that follow, up to the first that must be alone.
        is_alone: It runs when all before it have ended.
    """

    name: str
    command: tuple[str, ...]
    is_pytest: bool = False
    is_beside: bool = False
    is_alone: bool = False


@dataclass
class Result:
    """What a stage took, and which of its tests failed."""

    stage: Stage
    seconds: float
    status: int
    failed: list[str] = field(default_factory=list)
    passed: int = 0
    skipped: int = 0


def linters(*of_mypy: str) -> Iterator[Stage]:
    yield Stage("ruff check", (str(BIN / "ruff"), "check"))
    yield Stage("ruff format", (str(BIN / "ruff"), "format", "--check"))
    yield Stage("mypy", (str(BIN / "mypy"), *of_mypy))
    yield Stage("spelling", (str(BIN / "codespell"), *SPELLED))
    yield Stage("imports", (str(BIN / "lint-imports"), "--no-logo"))


def tests(name: str, *arguments: str) -> Stage:
    return Stage(
        name, (sys.executable, "-m", "pytest", "-q", "--durations=60", "--durations-min=1.5", *arguments), is_pytest=True
    )


def machine(which: str) -> Stage:
    """The virtual machine, whose own clock lets it run beside whatever else computes."""
    return replace(tests("virtual machine", *ALONE, "tests/vcan", "-m", which), is_beside=True)


def wall_clock(*arguments: str) -> Stage:
    """The tests of the wall clock; collecting all others would take half as long as running these."""
    own = sorted(path for path in (ROOT / "tests").rglob("test_*.py") if "mark.wall" in path.read_text(encoding="utf-8"))
    files = (str(path.relative_to(ROOT)) for path in own)
    return replace(tests("wall clock", *ALONE, *files, *arguments), is_alone=True)


def stages(tier: str, seed: int) -> Iterator[Stage]:
    """The stages of a tier.

    Args:
        tier: lint, everyday, ci or all.
        seed: Seed of the random examples, of which only `all` draws new ones.
    """
    new = ("--hypothesis-profile=random", f"--hypothesis-seed={seed}")
    if tier == "ci":
        yield machine("vm and not slow")
    elif tier == "all":
        yield machine("vm and slow")
    # beside the machine, which has one of the two cores, mypy's own workers may not find each other in time
    yield from linters(*(("--num-workers", "0") if tier in {"ci", "all"} else ()))
    if tier == "everyday":
        yield tests("tests", *SIDE_BY_SIDE, "-m", "not (ci or slow or wall or vm)")
    elif tier == "ci":
        yield tests("tests", *SIDE_BY_SIDE, "-m", "not (slow or wall or vm)")
        yield wall_clock("-m", "wall and not slow")
    elif tier == "all":
        others = (f"--ignore={path}" for path in SLAVE)
        yield tests("tests", *WITH_WAITING, *others, *new, "-m", "not (part or wall or vm)")
        yield tests("slave's branches", *SIDE_BY_SIDE, *BRANCHES, *new, "-m", "not (part or wall or vm)", *SLAVE)
        yield wall_clock(*new, "-m", "wall")


def facts_of(path: Path) -> tuple[int, int]:
    """Size and time of change."""
    facts = path.lstat()
    return facts.st_size, facts.st_mtime_ns


def files() -> dict[str, tuple[int, int]]:
    """Facts of every file that is here, but for caches, and of the project's files below the user's home."""
    found = {}
    for folder, folders, names in os.walk(ROOT):
        folders[:] = [
            each for each in folders if not each.startswith((".", "__pycache__", "node_modules")) and ".egg" not in each
        ]
        for path in (Path(folder, name) for name in names):
            found[str(path.relative_to(ROOT))] = facts_of(path)
    home = Path.home()
    for below in BELOW_HOME:
        for folder, _, names in os.walk(home / below):
            for path in (Path(folder, name).relative_to(home) for name in names):
                if any(OURS.fullmatch(part) for part in path.parts):
                    found[f"~/{path}"] = facts_of(home / path)
    return found


@contextmanager
def unwritten(results: list[Result]) -> Iterator[None]:
    """Fail where the tests of this context change, add or remove a file beside a user's, or one of ours below the user's home.

    The files of USERS lie there meanwhile.
    """
    mine = [path for path in map(ROOT.joinpath, USERS) if not path.exists()]
    folders = [path.parent for path in mine if not path.parent.exists()]
    for path in mine:
        path.parent.mkdir(exist_ok=True)
        path.write_text("# a user's\n", encoding="utf-8")
    before = files()
    try:
        yield
        changed = sorted(name for name, _ in before.items() ^ files().items())
        stage = Stage("files unwritten", ())
        failed = [f"the tests have written {name}" for name in dict.fromkeys(changed)]
        results.append(Result(stage, 0.0, int(bool(failed)), failed))
    finally:
        for path in mine:
            path.unlink(missing_ok=True)
        for folder in folders:
            folder.rmdir()


class Running:
    """A stage that has begun."""

    def __init__(self, stage: Stage, folder: Path) -> None:
        """Begin it; what it prints is kept if it runs beside others.

        Args:
            stage: Stage to run.
            folder: Folder for its results.
        """
        self.stage = stage
        self._results = folder / f"{stage.name.replace(' ', '-')}.xml"
        self._output = folder / f"{stage.name.replace(' ', '-')}.txt"
        command = [*stage.command, *([f"--junitxml={self._results}"] if stage.is_pytest else [])]
        # more threads of linear algebra in each of two workers would be in each other's way
        environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "COVERAGE_FILE": str(folder / "coverage")}
        self._begin = time.monotonic()
        if stage.is_beside:
            with self._output.open("wb") as output:
                self._process = subprocess.Popen(command, cwd=ROOT, env=environment, stdout=output, stderr=subprocess.STDOUT)
        else:
            print(f"\n== {stage.name}: {' '.join(stage.command)}", flush=True)
            self._process = subprocess.Popen(command, cwd=ROOT, env=environment)
        self._watch = threading.Thread(target=self._note_end, daemon=True)
        self._watch.start()

    def _note_end(self) -> None:
        self._process.wait()
        self._seconds = time.monotonic() - self._begin

    def end(self) -> Result:
        """Wait for its end, which may have been long ago."""
        self._watch.join()
        status = self._process.returncode
        result = Result(self.stage, self._seconds, status)
        if self.stage.is_beside:
            print(
                f"\n== {self.stage.name}: {' '.join(self.stage.command)}\n{self._output.read_text(errors='replace')}", flush=True
            )
        if self._results.exists():
            read(self._results, result)
        if status != 0 and not result.failed:
            result.failed.append(f"{self.stage.name} ended with {status}")
        return result


def run_all(wanted: Iterable[Stage], folder: Path) -> Iterator[Result]:
    """Run stages one after the other; those that run beside others end before one that must be alone, or at the end."""
    beside: list[Running] = []
    for stage in wanted:
        if stage.is_alone:
            yield from (each.end() for each in beside)
            beside = []
        running = Running(stage, folder)
        if stage.is_beside:
            beside.append(running)
        else:
            yield running.end()
    yield from (each.end() for each in beside)


def read(results: Path, result: Result) -> None:
    """Count what pytest wrote of its tests; one that fails twice, in itself and behind it, counts once."""
    for case in ElementTree.parse(results).iter("testcase"):  # noqa: S314 - written by our own pytest
        if case.find("failure") is not None or case.find("error") is not None:
            name = f"{case.get('classname', '').replace('.', '/')}.py::{case.get('name')}"
            if name not in result.failed:
                result.failed.append(name)
        elif case.find("skipped") is not None:
            result.skipped += 1
        else:
            result.passed += 1


def main() -> int:
    """Run a tier; 0 if all of it passed."""
    parser = argparse.ArgumentParser(description="Run the stages of a test tier.")
    parser.add_argument("tier", choices=["lint", "everyday", "ci", "all"])
    parser.add_argument("--seed", type=int, default=None, help="of the random examples of `all` (default: a new one)")
    parser.add_argument("--since", type=float, default=None, help="begin of the installation, in seconds of the epoch")
    given = parser.parse_args()
    begun = time.time()
    seed = random.SystemRandom().randrange(2**32) if given.seed is None else given.seed
    if given.tier == "all":
        os.environ.setdefault("HIL_RANDOM_FRAMES", str(RANDOM_FRAMES))
        print(f"seed of the random examples: {seed}; to repeat them: python -m tests.stages all --seed {seed}")
    results: list[Result] = []
    beside_a_user = unwritten(results) if given.tier in {"ci", "all"} else nullcontext()
    with tempfile.TemporaryDirectory(prefix="stages-") as folder, beside_a_user:
        results += run_all(stages(given.tier, seed), Path(folder))
    print()
    for result in results:
        for name in result.failed:
            print(f"FAILED {name}")
    if given.since is not None:
        print(f"{'before these':16} {begun - given.since:7.1f} s")
    for result in results:
        print(f"{result.stage.name:16} {result.seconds:7.1f} s  {'failed' if result.failed else 'passed'}")
    print(f"{'in all':16} {time.time() - (begun if given.since is None else given.since):7.1f} s")
    counted = [result for result in results if result.stage.is_pytest]
    if counted:
        failed, skipped = sum(len(each.failed) for each in counted), sum(each.skipped for each in counted)
        print(f"{sum(each.passed for each in counted)} passed, {failed} failed, {skipped} skipped")
    return 1 if any(result.failed for result in results) else 0


if __name__ == "__main__":
    sys.exit(main())
