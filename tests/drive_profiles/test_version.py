"""The version names the commit that runs, without git where that can be."""

import importlib.metadata
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from drive_profiles.version import commit_of, commit_text, version_text

PROJECT = Path(__file__).parents[2]
COMMIT = "0123456789abcdef0123456789abcdef01234567"
OTHER = "f" * 40
needs_git = pytest.mark.skipif(shutil.which("git") is None, reason="no git here")


def git(folder, *command):
    names = ("-c", "user.name=Nobody", "-c", "user.email=nobody@example.org", "-c", "init.defaultBranch=main")
    done = subprocess.run([shutil.which("git"), "-C", str(folder), *names, *command], check=True, capture_output=True, text=True)
    return done.stdout.strip()


@pytest.fixture
def checkout(tmp_path):
    """A git checkout that looks like this project, with one commit."""
    folder = tmp_path / "checkout"
    (folder / "drive_profiles").mkdir(parents=True)
    (folder / "drive_profiles" / "a.py").write_text("A = 1\n")
    (folder / "pyproject.toml").write_text('[project]\nname = "hil-bench"\n')
    git(folder, "init", "-q")
    git(folder, "add", ".")
    git(folder, "commit", "-q", "-m", "first")
    return folder


@needs_git
def test_a_checkout_tells_its_commit(checkout):
    assert commit_of(checkout) == git(checkout, "rev-parse", "HEAD")
    assert commit_text(checkout) == git(checkout, "rev-parse", "--short=12", "HEAD")


@needs_git
@pytest.mark.parametrize("command", [("pack-refs", "--all"), ("checkout", "-q", "--detach"), ("checkout", "-q", "-b", "a/b")])
def test_however_git_keeps_it(checkout, command):
    git(checkout, *command)
    assert commit_of(checkout) == git(checkout, "rev-parse", "HEAD")


@needs_git
def test_a_worktree_tells_its_own_commit(checkout, tmp_path):
    git(checkout, "worktree", "add", "-q", "-b", "other", str(tmp_path / "tree"))
    git(tmp_path / "tree", "commit", "-q", "--allow-empty", "-m", "second")
    assert commit_of(tmp_path / "tree") == git(tmp_path / "tree", "rev-parse", "HEAD") != commit_of(checkout)
    git(checkout, "pack-refs", "--all")
    assert commit_of(tmp_path / "tree") == git(tmp_path / "tree", "rev-parse", "HEAD")


@needs_git
def test_changed_files_are_said_and_a_new_page_is_not(checkout):
    (checkout / "notes.md").write_text("mine\n")
    assert not commit_text(checkout).endswith("modified")
    (checkout / "drive_profiles" / "a.py").write_text("A = 2\n")
    assert commit_text(checkout) == f"{commit_of(checkout)[:12]}, modified"


@needs_git
def test_a_foreign_repository_around_it_is_not_ours(checkout):
    (checkout / "pyproject.toml").write_text('[project]\nname = "somebody-elses"\n')
    assert not commit_text(checkout, built=checkout / "absent")


def test_without_git_the_version_stands_alone(tmp_path, monkeypatch):
    monkeypatch.setattr("drive_profiles.version.commit_text", lambda: "")
    assert not commit_text(tmp_path, built=tmp_path / "absent")
    assert version_text.__wrapped__() == importlib.metadata.version("hil-bench")


def test_a_wheel_tells_the_commit_that_it_was_made_from(tmp_path):
    (tmp_path / "commit").write_text(f"{COMMIT[:12]}, modified\n")
    assert commit_text(tmp_path, built=tmp_path / "commit") == f"{COMMIT[:12]}, modified"


@pytest.mark.parametrize(
    "head", ["", "ref: refs/heads/gone", "ref: ../../../etc/passwd", "no commit", "\xff\xfe", COMMIT.upper()], ids=repr
)
def test_what_is_no_commit_is_none(tmp_path, head):
    (tmp_path / ".git").mkdir()
    (tmp_path / ".git" / "HEAD").write_bytes(head.encode("latin-1"))
    assert not commit_of(tmp_path)


def test_a_git_that_hangs_is_not_waited_for(tmp_path, monkeypatch):
    (tmp_path / ".git").mkdir()
    (tmp_path / ".git" / "HEAD").write_text(COMMIT)
    (tmp_path / "pyproject.toml").write_text('name = "hil-bench"\n')
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "git").write_text("#!/bin/sh\nexec sleep 60\n")
    (tmp_path / "bin" / "git").chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path / 'bin'}:/usr/bin:/bin")
    monkeypatch.setattr("drive_profiles.version._GIT_TIMEOUT_S", 0.05)
    assert commit_text(tmp_path) == COMMIT[:12]


@needs_git
@pytest.mark.slow
@pytest.mark.skipif(not (PROJECT / ".git").exists(), reason="not a checkout")
def test_a_wheel_and_an_archive_keep_the_commit_and_the_types(tmp_path):
    source = tmp_path / "source"
    git(tmp_path, "clone", "-q", "--depth", "1", f"file://{PROJECT}", str(source))
    wanted = commit_text(source)
    for hook, where in (("build_sdist", source), ("build_wheel", source)):
        command = f"import setuptools.build_meta as b; print(b.{hook}({str(tmp_path)!r}))"
        subprocess.run([sys.executable, "-c", command], cwd=where, check=True, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as file:
        assert file.read("drive_profiles/commit").decode().strip() == wanted
        assert {f"{name}/py.typed" for name in ("drive_profiles", "hil", "plant_emulator")} <= set(file.namelist())
    (archive,) = tmp_path.glob("*.tar.gz")
    shutil.unpack_archive(archive, tmp_path / "unpacked")
    (unpacked,) = (tmp_path / "unpacked").iterdir()
    assert commit_text(unpacked, unpacked / "drive_profiles" / "commit") == wanted
