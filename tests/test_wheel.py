"""The wheel works without the lock, on every Python that is here, with the newest and with the oldest dependencies allowed."""

import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import urllib.request
import zipfile

import pytest

from tests.test_installation import BUILT, PACKAGES, ROOT, interpreter

MINORS = (11, 12, 13, 14)
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
EXTRAS = PROJECT["optional-dependencies"]
WORKERS = """
from distributed import LocalCluster
from plant_emulator.trials.executors import DaskWorkers

if __name__ == "__main__":
    with LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster:
        with DaskWorkers(cluster.scheduler_address) as workers:
            print(workers.submit(abs, -3).result())
"""
CONTROL = """
import control
print(abs(control.ss([[-1.0]], [[1.0]], [[1.0]], [[0.0]])(0.0)))
"""
PLUG_IN = """
def test_it_turns_a_revolution(hil_drive):
    start = hil_drive.position_rev
    hil_drive.move_by(1.0)
    assert abs(hil_drive.position_rev - start - 1.0) < 0.01
"""

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1800)]


def run(folder, *command):
    """Run a program without what this test's own environment has; its standard output."""
    mine = {"VIRTUAL_ENV", "PYTHONPATH", "HIL_BUS"}
    environment = {key: value for key, value in os.environ.items() if key not in mine}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{command} ended with {done.returncode}:\n{done.stdout[-3000:]}\n{done.stderr[-3000:]}"
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """The wheel, built from a copy: a build leaves files in the project."""
    folder = tmp_path_factory.mktemp("wheel")
    for name in ("MANIFEST.in", "pyproject.toml", "setup.py", "LICENSE", "README.md"):
        shutil.copy(ROOT / name, folder)
    for name in PACKAGES:
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns(*BUILT))
    run(folder, sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "--no-build-isolation", "--wheel-dir", "dist", ".")
    (found,) = (folder / "dist").glob("*.whl")
    return found


def oldest(folder):
    """A file of constraints: each dependency of the version that pyproject.toml names as the oldest."""
    named = [*PROJECT["dependencies"], *(each for extra in EXTRAS.values() for each in extra)]
    lines = [re.sub(r"^([\w-]+)>=([\d.]+).*$", r"\1==\2.*", each) for each in named]
    assert all("==" in line for line in lines)
    (folder / "oldest.txt").write_text("\n".join(lines), encoding="utf-8")
    return "--constraint", "oldest.txt"


def test_one_wheel_serves_every_python_of_a_platform(wheel):
    assert re.fullmatch(r"hil_bench-[\w.]+-py3-none-(?!any)\w+\.whl", wheel.name)
    names = zipfile.ZipFile(wheel).namelist()
    for package, core in (("hil", "law"), ("plant_emulator", "plant")):
        assert {f"{package}/core/{core}.native", f"{package}/core/{core}_abi.py", f"{package}/core/core.h"} <= set(names)
    assert "hil/control/notch.c" in names, "whoever builds firmware finds the law"


@pytest.mark.skipif(sys.platform != "linux", reason="manylinux is Linux")
def test_the_wheel_asks_for_nothing_but_the_c_library(wheel):
    said = run(wheel.parent, sys.executable, "-m", "auditwheel", "show", wheel)
    assert re.search(r"manylinux_2_\d+_", said), said


def test_the_source_archive_builds_the_wheel(tmp_path):
    folder = tmp_path / "project"
    folder.mkdir()
    for name in ("MANIFEST.in", "pyproject.toml", "setup.py", "LICENSE", "README.md"):
        shutil.copy(ROOT / name, folder)
    for name in PACKAGES:
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    program = "from setuptools.build_meta import build_sdist; print(build_sdist('dist'))"
    archive = folder / "dist" / run(folder, sys.executable, "-c", program).splitlines()[-1]
    with tarfile.open(archive) as held:
        names = held.getnames()
    assert not [name for name in names if name.endswith((".native", "_abi.py"))], "what was built belongs to a machine"
    assert [name for name in names if name.endswith("hil/control/notch.c")]
    # pip would keep the wheel of an archive, and take it again for another archive at the same path
    building = ("--no-cache-dir", "--no-deps", "--no-build-isolation", "--wheel-dir", "dist")
    run(tmp_path, sys.executable, "-m", "pip", "wheel", "-q", *building, archive)
    (made,) = (tmp_path / "dist").glob("*.whl")
    assert "hil/core/law.native" in zipfile.ZipFile(made).namelist()


@pytest.mark.parametrize(
    ("minor", "versions"),
    [*((minor, "newest") for minor in MINORS[1:]), (MINORS[0], "oldest")],
)
def test_what_is_installed_from_the_wheel_works(tmp_path, wheel, minor, versions):
    """Each Python once, the first with the oldest versions.

    The first Python with the newest is nearly what the lock has, with which all other tests run.
    """
    python = interpreter(minor)
    if python is None:
        pytest.skip(f"no Python 3.{minor} here")
    run(tmp_path, python, "-m", "venv", "venv")
    installed = tmp_path / "venv" / "bin"
    constraints = oldest(tmp_path) if versions == "oldest" else ()
    wanted = f"{wheel}[{','.join(EXTRAS)}]" if versions == "oldest" else wheel
    run(tmp_path, installed / "python", "-m", "pip", "install", "-q", "--no-compile", *constraints, wanted, "pytest")
    run(tmp_path, installed / "python", "-m", "pip", "check")
    run(tmp_path, installed / "hil", "demo", "--no-tour", "--out", "demo")
    assert (tmp_path / "demo" / "report.html").is_file()
    bus = f"local:{tmp_path}/bus.sock"
    with subprocess.Popen(
        [installed / "plant-emulator", "serve", "--robot", "reference", "--bus", bus, "--until-stdin-closes"],
        cwd=tmp_path, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    ) as server:  # fmt: skip
        assert server.stdout.readline(), "the server says where it serves"
        tool = installed / "drive-profiles"
        assert "2" in run(tmp_path, tool, "scan", "--bus", bus)
        run(tmp_path, tool, "pull", "--node", "2", "--bus", bus, "--out", "axis2.toml")
        run(tmp_path, tool, "upload", "axis2.toml", "--node", "2", "--bus", bus, "--yes")
        server.stdin.close()
    (tmp_path / "test_mine.py").write_text(PLUG_IN, encoding="utf-8")
    assert "1 passed" in run(tmp_path, installed / "python", "-m", "pytest", "-q", "test_mine.py")
    if versions == "oldest":
        the_extras_work(tmp_path, installed)


def the_extras_work(folder, installed):
    """What each extra is for: files of other programs, there and back, plots in a page, workers elsewhere, and the comparison."""
    files = [f"line.{kind}" for kind in ("dbc", "mf4", "mcap", "parquet")]
    run(folder, installed / "hil", "export", "demo", "--run", "line-motion-drive-none", *(f"--to={file}" for file in files))
    assert all((folder / file).stat().st_size for file in files)
    with subprocess.Popen(
        [installed / "hil", "scope", "demo", "--port", "0", "--until-stdin-closes"],
        cwd=folder, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    ) as scope:  # fmt: skip
        address = re.search(r"http://\S+", scope.stdout.readline())
        with urllib.request.urlopen(address[0], timeout=60) as page:  # noqa: S310 - our own, on loopback
            assert b"<title>hil scope</title>" in page.read()
        scope.stdin.close()
    for program, said in ((WORKERS, "3"), (CONTROL, "1.0")):
        (folder / "program.py").write_text(program, encoding="utf-8")
        assert run(folder, installed / "python", "program.py").split() == [said]
