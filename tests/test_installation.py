"""The installation needs nothing that is not in the lock, with any supported pip and any .venv that is there."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("drive_profiles", "hil", "plant_emulator")
FILES = (
    "Makefile", "MANIFEST.in", "pyproject.toml", "setup.py", "requirements.lock", "requirements-compiler.lock",
    "requirements-test.lock", "LICENSE", "README.md",
)  # fmt: skip
BUILT = ("__pycache__", "*.native", "*_abi.py")
OLDEST_PIP = "23.0.1"
WINDOWS_ONLY = {"colorama": ""}
FOR_TESTS = {"pytest", "mypy", "ruff", "distributed", "hypothesis"}


def run(folder, *command, **changes):
    mine = {"VIRTUAL_ENV", "PYTHONPATH", "MAKEFLAGS", "CI"}
    environment = {key: value for key, value in os.environ.items() if key not in mine} | changes
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{command} ended with {done.returncode}:\n{done.stdout}\n{done.stderr}"
    return done.stdout


def interpreter(minor):
    """A Python 3.minor of this machine; None where there is none."""
    kept = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    found = shutil.which(f"python3.{minor}"), *sorted(map(str, kept.glob(f"3.{minor}.*/bin/python3")))
    for each in filter(None, found):
        works = subprocess.run([each, "-c", f"import sys, venv; sys.exit(sys.version_info[:2] != (3, {minor}))"], check=False)
        if works.returncode == 0:
            return each
    return None


@pytest.fixture
def project(tmp_path):
    """A copy of what the installation needs, without a .venv."""
    for name in FILES:
        shutil.copy(ROOT / name, tmp_path)
    for name in PACKAGES:
        shutil.copytree(ROOT / name, tmp_path / name, ignore=shutil.ignore_patterns(*BUILT))
    (tmp_path / "tests").mkdir()
    return tmp_path


def venv(project, *options, python=sys._base_executable):
    run(project, python, "-m", "venv", *options, ".venv")
    return project / ".venv" / "bin" / "python"


def installed(project):
    """Versions by name, as pip lists them."""
    lines = run(project, ".venv/bin/python", "-m", "pip", "list", "--format=freeze").splitlines()
    return {re.sub(r"[-_.]+", "-", name).lower(): version for name, _, version in (line.partition("==") for line in lines)}


def locked(path):
    return dict(re.findall(r"^([a-z0-9-]+)==(\S+)", path.read_text(encoding="utf-8"), re.MULTILINE))


def test_what_make_has_installed_for_these_tests_lacks_nothing():
    """The locks were installed without looking for what a package asks for: they are complete."""
    run(ROOT, sys.executable, "-m", "pip", "check")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("pip", "minor"),
    [(OLDEST_PIP, 11), ("23.2.1", 12), ("24.0", 13), ("", 14)],
)
def test_the_demo_installs_with_this_pip_exactly_what_its_lock_says(project, pip, minor):
    """Each pip with another Python, or with this one where that is not here; no pip before 23.1.2 starts in 3.12."""
    python = venv(project, python=interpreter(minor) or sys._base_executable)
    run(project, python, "-m", "pip", "install", "-q", "--upgrade", f"pip=={pip}" if pip else "pip")
    run(project, "make", ".venv/installed")
    assert not FOR_TESTS & is_as_locked(project).keys()


@pytest.mark.slow
def test_the_tests_install_with_the_oldest_pip_exactly_what_their_lock_says(project):
    python = venv(project)
    run(project, python, "-m", "pip", "install", "-q", f"pip=={OLDEST_PIP}")
    run(project, "make", ".venv/testable")
    assert is_as_locked(project, "requirements-test.lock").keys() >= FOR_TESTS


def is_as_locked(project, lock="requirements.lock"):
    """Versions by name; nothing that one of them or the project asks for is missing."""
    found = installed(project)
    wanted = locked(project / lock)
    assert {name: found.get(name) for name in wanted} | WINDOWS_ONLY == wanted | WINDOWS_ONLY
    run(project, ".venv/bin/python", "-m", "pip", "check")
    assert "hil" in run(project, ".venv/bin/hil", "--version")
    return found


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_the_demo_runs_where_there_is_no_compiler(project, tmp_path_factory):
    """The PATH has what make and its recipes need, and no cc."""
    folder = tmp_path_factory.mktemp("bin")
    for name in ("sh", "bash", "env", "make", "touch", "git", "uname", "dirname", "cat", "rm", "mkdir", "sed"):
        if path := shutil.which(name):
            (folder / name).symlink_to(path)
    (folder / "python3").symlink_to(sys._base_executable)
    assert not any(shutil.which(name, path=str(folder)) for name in ("cc", "gcc", "clang"))
    said = run(project, "make", ".venv/installed", PATH=str(folder))
    assert "There is no C compiler: installing requirements-compiler.lock into .venv" in said
    run(project, ".venv/bin/hil", "demo", "--no-tour", "--out", "demo", PATH=str(folder))
    assert (project / "demo" / "report.html").is_file()


@pytest.mark.slow
def test_a_venv_that_has_no_pip_is_used_and_nothing_of_it_deleted(project):
    """As uv makes them; the pip is that of Python itself, which is another one than those above."""
    mine = venv(project, "--without-pip").parents[1] / "mine"
    mine.touch()
    run(project, "make", ".venv/installed")
    assert not FOR_TESTS & is_as_locked(project).keys()
    assert mine.exists()
    run(project, "make", "clean")
    assert mine.exists()


def test_a_venv_that_does_not_start_is_left_alone_and_said(project):
    (project / ".venv" / "bin").mkdir(parents=True)
    done = subprocess.run(["make", ".venv/installed"], cwd=project, capture_output=True, text=True, check=False)  # noqa: S607
    assert done.returncode != 0
    assert ".venv has no Python 3.11 or newer that starts; move it away or remove it" in done.stderr
    assert (project / ".venv" / "bin").is_dir()


def test_both_locks_hold_the_same_version_of_what_is_in_both():
    demo, tests = (locked(ROOT / name) for name in ("requirements.lock", "requirements-test.lock"))
    assert demo.items() <= tests.items()
    assert not FOR_TESTS & demo.keys()
