"""Build steps that pyproject.toml cannot say: the core in C, and the commit that a wheel is made from."""

import runpy
import sys
import tomllib
from pathlib import Path

from setuptools import Distribution, setup
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build_py import build_py
from setuptools.command.sdist import sdist

PROJECT = Path(__file__).resolve().parent
sys.path.insert(0, str(PROJECT))  # nothing is installed yet

from hil.core.build import LAW, BuildError, build, compiler  # noqa: E402

PLANT = runpy.run_path(str(PROJECT / "plant_emulator" / "core" / "build.py"))["PLANT"]
commit_text = runpy.run_path(str(PROJECT / "drive_profiles" / "version.py"))["commit_text"]


def write_commit(folder: str) -> None:
    """Write the commit beside the version module of a folder that is built, where it is known."""
    if commit := commit_text():
        path = Path(folder) / "drive_profiles" / "commit"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(commit + "\n", encoding="ascii")


def compiler_from_pypi() -> list[str]:
    """Return the package that has a C compiler, where the machine has none; builds install it for themselves."""
    try:
        compiler()
    except BuildError:
        groups = tomllib.loads((PROJECT / "pyproject.toml").read_text(encoding="utf-8"))["dependency-groups"]
        return list(groups["compiler"])
    return []


class BuildWithCore(build_py):
    """Build of the packages with their core; a checkout's core lies in the checkout, and it keeps no commit."""

    def run(self) -> None:
        """Build the core, then the packages, then add the commit."""
        build(LAW)
        build(PLANT)
        super().run()
        if not self.editable_mode:
            write_commit(self.build_lib)


class SourceWithCommit(sdist):
    """Source archive, which has no .git."""

    def make_release_tree(self, base_dir: str, files: list[str]) -> None:
        """Copy the files, then add the commit."""
        super().make_release_tree(base_dir, files)
        write_commit(base_dir)


class PlatformWheel(bdist_wheel):
    """Wheel for every Python on one platform: the core is loaded, not imported."""

    def get_tag(self) -> tuple[str, str, str]:
        """Tag of the wheel."""
        return "py3", "none", super().get_tag()[2]


class WithCore(Distribution):
    """Distribution with machine code."""

    def has_ext_modules(self) -> bool:
        """Say so: its files belong to a platform."""
        return True


setup(
    distclass=WithCore,
    setup_requires=compiler_from_pypi(),
    cmdclass={"build_py": BuildWithCore, "sdist": SourceWithCommit, "bdist_wheel": PlatformWheel},
)
