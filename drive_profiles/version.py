"""Version and commit of this project, for `--version` and the reports."""

import subprocess
from functools import cache
from importlib import metadata
from pathlib import Path

DISTRIBUTION = "hil-bench"
COMMIT_FILE = Path(__file__).with_name("commit")
"""File in a wheel that holds the commit; written when the wheel is built (setup.py), absent in a checkout."""

_PROJECT = Path(__file__).parents[1]
_PACKAGES = ("drive_profiles", "hil", "plant_emulator")
_COMMIT_DIGITS = 12
_GIT_TIMEOUT_S = 2.0


@cache
def version_text() -> str:
    """Return the version and, if known, the commit: ``0.1.0 (commit 105b655a1b2c, modified)``.

    It is looked up once: a checkout that changes later does not change the code of this process.
    """
    try:
        number = metadata.version(DISTRIBUTION)
    except metadata.PackageNotFoundError:
        number = "not installed"
    commit = commit_text()
    return f"{number} (commit {commit})" if commit else number


def commit_text(project: Path = _PROJECT, built: Path = COMMIT_FILE) -> str:
    """Return the commit in twelve digits; "" if it is not known.

    In a checkout it comes from .git, with ", modified" if the files differ; in an installed wheel from the file that the build
    wrote. Another project's repository around the package is not taken for ours.
    """
    if (project / ".git").exists() and f'name = "{DISTRIBUTION}"' in _text(project / "pyproject.toml"):
        commit = commit_of(project)
        return commit[:_COMMIT_DIGITS] + (", modified" if commit and _is_modified(project) else "")
    return _first_line(built)


def commit_of(project: Path) -> str:
    """Read a checkout's commit from its .git folder, without git, or ""."""
    git = project / ".git"
    if git.is_file():  # a worktree: .git names the folder
        git = project / _first_line(git).removeprefix("gitdir:").strip()
    head = _first_line(git / "HEAD")
    if not head.startswith("ref:"):
        return _hexadecimal(head)
    name = head.removeprefix("ref:").strip()
    common = git / (_first_line(git / "commondir") or ".")
    return _hexadecimal(_first_line(git / name) or _first_line(common / name) or _packed(common, name))


def _packed(git: Path, name: str) -> str:
    """Return the commit of a reference that git has packed."""
    for line in _text(git / "packed-refs").splitlines():
        commit, _, reference = line.partition(" ")
        if reference == name:
            return commit
    return ""


def _is_modified(project: Path) -> bool:
    """Return True if git, where it runs, reports changed files."""
    # no lock is taken: another git may be at work in the checkout
    command = ["git", "--no-optional-locks", "-C", str(project), "diff", "--quiet", "HEAD", "--", *_PACKAGES]
    try:
        return subprocess.run(command, capture_output=True, timeout=_GIT_TIMEOUT_S, check=False).returncode == 1  # noqa: S603
    except (OSError, subprocess.TimeoutExpired):
        return False


def _hexadecimal(text: str) -> str:
    return text if text and not set(text) - set("0123456789abcdef") else ""


def _first_line(path: Path) -> str:
    return _text(path).partition("\n")[0].strip()


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return ""
