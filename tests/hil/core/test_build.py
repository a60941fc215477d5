"""The core builds with gcc and clang without a warning, from nothing, and says what it lacks where it cannot."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from hil.core import build
from hil.core.build import LAW, ROOT, BuildError, compile_core, compiler
from hil.core.declarations import declarations
from plant_emulator.core.build import PLANT

COMPILERS = [
    pytest.param(name, marks=pytest.mark.skipif(not shutil.which(name), reason=f"no {name}")) for name in ("gcc", "clang")
]


@pytest.mark.ci
@pytest.mark.parametrize("core", [LAW, PLANT], ids=lambda core: core.name)
@pytest.mark.parametrize("name", COMPILERS)
def test_the_core_compiles_without_a_warning(name, core, tmp_path):
    assert compile_core(core, [name], tmp_path / "core", ["-Werror"]).exists()


@pytest.mark.parametrize("name", COMPILERS)
def test_the_law_compiles_in_single_precision_and_promotes_nothing_to_double(name, tmp_path):
    precise = ["-fsingle-precision-constant"] if name == "gcc" else ["-cl-single-precision-constant"]
    law = [str(path) for path in sorted((ROOT / "hil" / "control").glob("*.c"))]
    words = [name, "-std=c99", "-O2", *build.WARNINGS, "-Werror", "-DHIL_SINGLE", "-I", str(ROOT), "-c", *law]
    words += [*precise, "-Wdouble-promotion"] if name == "gcc" else ["-Wno-implicit-float-conversion"]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_a_compiler_that_refuses_the_sources_is_quoted(tmp_path):
    with pytest.raises(BuildError, match=r"^gcc ended with 1:\n(.|\n)*no-such-option"):
        compile_core(LAW, ["gcc"], tmp_path / "core", ["-fno-such-option"])
    assert list(tmp_path.iterdir()) == []


def test_a_compiler_that_is_not_there_is_named(tmp_path):
    with pytest.raises(BuildError, match=r"^/no/cc cannot be started \(No such file or directory\); set CC to a C compiler$"):
        compile_core(LAW, ["/no/cc"], tmp_path / "core")


def test_the_compiler_is_that_of_the_environment_or_one_on_the_path_or_zig(monkeypatch, tmp_path):
    monkeypatch.setenv("CC", "clang -m64")
    assert compiler() == ["clang", "-m64"]
    monkeypatch.delenv("CC")
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(build.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(BuildError, match=r"^there is no C compiler .*; install one, or the package ziglang from PyPI$"):
        compiler()
    monkeypatch.setattr(build.importlib.util, "find_spec", lambda name: name)
    assert compiler() == [sys.executable, "-m", "ziglang", "cc"]


def copied(tmp_path):
    """Packages of a checkout, without anything built."""
    for name in ("drive_profiles", "hil", "plant_emulator"):
        shutil.copytree(ROOT / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__", "*.native", "*_abi.py"))
    return tmp_path


def run(folder, program, **environment):
    words = [sys.executable, "-c", f"import sys; sys.path.insert(0, {str(folder)!r})\n{program}"]
    return subprocess.run(words, cwd=folder, capture_output=True, text=True, env=os.environ | environment, check=False)


SAY = "from hil.core.library import CORE; print(round(CORE.call.lowpass_blend(20.0, 250e-6), 6))"
FALL = """
from plant_emulator.motion.axes import Axes
from plant_emulator.motion.record import POSITION
from plant_emulator.robots.robot import load_robot

axes = Axes(load_robot("reference"))
axes.open_brake(0, POSITION, 8)
axes.advance(400)
print(repr(float(axes.plant_state["motor_angle_rad"][0])))
"""


def edited(folder, path, old, new):
    source = folder / path
    assert source.read_text().count(old) == 1
    source.write_text(source.read_text().replace(old, new))


@pytest.mark.ci
@pytest.mark.skipif(not shutil.which("cc"), reason="no C compiler")
def test_a_core_that_is_missing_or_stale_is_built_on_import_and_one_that_cannot_be_is_refused(tmp_path):
    folder = copied(tmp_path)
    nothing = run(folder, SAY, CC="/no/cc")
    assert "law.native was built from other sources, and cannot be rebuilt: /no/cc cannot be started" in nothing.stderr
    assert run(folder, SAY).stdout == "0.03093\n"
    assert run(folder, SAY, CC="/no/cc").stdout == "0.03093\n", "what is built is kept"
    edited(folder, "hil/control/notch.c", "2.0 * w / (1.0 + w)", "2.5 * w / (1.0 + w)")
    assert "cannot be rebuilt" in run(folder, SAY, CC="/no/cc").stderr, "a stale core computes nothing"
    assert run(folder, SAY).stdout == "0.038663\n"
    edited(folder, "hil/core/build.py", '"-ffp-contract=off"', '"-ffp-contract=off", "-DOTHER"')
    assert "cannot be rebuilt" in run(folder, SAY, CC="/no/cc").stderr, "so does one of other options"
    assert run(folder, SAY).stdout == "0.038663\n"


@pytest.mark.slow
@pytest.mark.skipif(not shutil.which("cc"), reason="no C compiler")
def test_a_header_that_the_control_period_inlines_makes_the_plant_stale(tmp_path):
    folder = copied(tmp_path)
    before = run(folder, FALL)
    assert float(before.stdout) != 0.0
    edited(folder, "plant_emulator/physics/friction.h", "level *= (1.0 - e) / (1.0 + e)", "level *= (0.5 - e) / (1.0 + e)")
    assert "plant.native was built from other sources, and cannot be rebuilt" in run(folder, FALL, CC="/no/cc").stderr
    assert abs(float(run(folder, FALL).stdout) - float(before.stdout)) > 1e-3


def test_the_declarations_of_a_core_have_its_records_and_its_numbers_and_no_bodies():
    for core in (LAW, PLANT):
        text, numbers = declarations(ROOT, core.header)
        assert "struct law {" in text
        assert numbers["START_LOWPASS_HZ"] == 20.0
        assert "inline" not in text


@pytest.mark.slow
@pytest.mark.skipif(not shutil.which("gcc"), reason="no gcc")
def test_the_property_tests_pass_on_a_core_that_watches_its_memory_and_its_arithmetic(tmp_path):
    folder = copied(tmp_path)
    shutil.copytree(ROOT / "tests", folder / "tests", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", folder)
    options = ["-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-fno-omit-frame-pointer"]
    made = run(
        folder,
        "import hil.core.build as b\n"
        "from hil.core.declarations import module_text\n"
        "from plant_emulator.core.build import PLANT\n"
        "for core in (b.LAW, PLANT):\n"
        f"    b.compile_core(core, ['gcc'], options={options!r})\n"
        "    core.declarations.write_text(module_text(b.ROOT, core.header, core.digest()))\n",
        PYTHONPATH=str(folder),
    )
    assert made.returncode == 0, made.stderr
    preload = [
        subprocess.run(
            [str(shutil.which("gcc")), f"-print-file-name={name}"], capture_output=True, text=True, check=True
        ).stdout.strip()
        for name in ("libasan.so", "libubsan.so")
    ]
    words = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-p",
        "no:cacheprovider",
        "tests/hil/core/test_law.py",
        "tests/hil/core/test_border.py",
        "tests/hil/master/test_guard.py",
        "tests/hil/master/test_run.py",
    ]
    words += ["tests/plant_emulator/core", "-m", "not slow"]
    environment = os.environ | {"LD_PRELOAD": " ".join(preload), "ASAN_OPTIONS": "detect_leaks=0", "PYTHONPATH": str(folder)}
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, f"{done.stdout[-3000:]}\n{done.stderr[-3000:]}"
    assert Path(folder, "hil/core/law.native").exists()
