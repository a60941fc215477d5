"""Build steps that pyproject.toml cannot say: a wheel keeps the commit it was made from, in drive_profiles/commit."""

import runpy
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py
from setuptools.command.sdist import sdist

PROJECT = Path(__file__).resolve().parent
commit_text = runpy.run_path(str(PROJECT / "drive_profiles" / "version.py"))["commit_text"]  # nothing is installed yet


def write_commit(folder: str) -> None:
    """Write the commit beside the version module of a folder that is built, where it is known."""
    if commit := commit_text():
        path = Path(folder) / "drive_profiles" / "commit"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(commit + "\n", encoding="ascii")


class BuildWithCommit(build_py):
    """Build of the packages; an editable one reads its checkout each time, and keeps no commit."""

    def run(self) -> None:
        """Build, then add the commit."""
        super().run()
        if not self.editable_mode:
            write_commit(self.build_lib)


class SourceWithCommit(sdist):
    """Source archive, which has no .git either."""

    def make_release_tree(self, base_dir: str, files: list[str]) -> None:
        """Copy the files, then add the commit."""
        super().make_release_tree(base_dir, files)
        write_commit(base_dir)


setup(cmdclass={"build_py": BuildWithCommit, "sdist": SourceWithCommit})
