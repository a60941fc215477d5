"""The door to the compiler: the same numbers as Python, and never yesterday's code."""

import math
import os
import re
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from hil.control import machine_code
from hil.control.compiled import compiled
from hil.control.notch import notch_coefficients

ROOT = Path(__file__).parents[3]

FORTY_PERIODS = """
from hil.control.cascade import Cascade
from plant_emulator.motion.axes import Axes
from plant_emulator.motion.period import advance
from plant_emulator.motion.record import POSITION
from plant_emulator.robots.robot import load_robot

axes = Axes(load_robot("reference"))
Cascade(25.0, 0.2, 4.0).write(axes.cascade_config[0])
axes.open_brake(0, POSITION, 1)
axes.set_point(0, axes.counts(0) + 100)
axes.advance(40)
print(float(axes.plant_state["motor_angle_rad"][0]).hex(), advance.loaded)
"""


SUMS = """
import sys
import numpy as np
from hil.control.compiled import compiled


@compiled
def sums(values, start):
    total = start
    for value in values:
        total += np.sqrt(value) / 3.0
    return total, total * total


found = [x.hex() for x in sums(np.arange(50.0), 0.1)]
print("numba" in sys.modules, *found)
"""


def run(folder, *arguments):
    path = os.pathsep.join([str(folder), str(ROOT)])
    command, environment = [sys.executable, *arguments], {**os.environ, "PYTHONPATH": path}
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=True).stdout


SOURCES = ("plant_emulator/physics/integration.py", "plant_emulator/physics/angle_grid.py", "plant_emulator/physics/sensing.py",
           "plant_emulator/motion/references.py", "hil/control/notch.py", "hil/control/servo.py")  # fmt: skip


@pytest.fixture
def copied(tmp_path):
    """A folder of their own for the packages, whose sources a test may edit."""
    for package in ("drive_profiles", "hil", "plant_emulator"):
        shutil.copytree(ROOT / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__"))
    return tmp_path


def folder_of_the_control_period(folder):
    program = "from plant_emulator.motion.period import advance; print(advance._folder())"
    return run(folder, "-c", program).strip()


@pytest.mark.slow
def test_the_control_period_is_compiled_anew_after_an_edit_of_any_source_that_it_inlines(copied):
    before = {folder_of_the_control_period(copied)}
    for source in SOURCES:
        path = copied / source
        path.write_text(f"{path.read_text(encoding='utf-8')}\nEDITED = True\n", encoding="utf-8")
        after = folder_of_the_control_period(copied)
        assert Path(after).parent == copied / "plant_emulator" / "motion" / "__pycache__"
        assert after not in before, source
        before.add(after)


@pytest.mark.slow  # the control period is compiled twice
def test_a_robot_moves_otherwise_after_an_edit_of_the_physics(copied):
    first, loaded = run(copied, "-c", FORTY_PERIODS).split()
    assert loaded == "0"
    assert run(copied, "-c", FORTY_PERIODS).split() == [first, "1"]  # unchanged: from the disk
    path = copied / "plant_emulator" / "physics" / "integration.py"
    text = path.read_text(encoding="utf-8")
    assert text.count("h = period_s / substeps") == 1
    path.write_text(text.replace("h = period_s / substeps", "h = 0.5 * period_s / substeps"), encoding="utf-8")
    other, loaded = run(copied, "-c", FORTY_PERIODS).split()
    assert (other != first, loaded) == (True, "0")


def test_the_compiler_keeps_ieee_arithmetic_bit_for_bit():
    rng = np.random.default_rng(4)
    for _ in range(200):
        arguments = (*rng.uniform(1.0, 40.0, 2), *rng.uniform(0.01, 0.5, 2), 250e-6)
        assert notch_coefficients(*arguments) == notch_coefficients.py_func(*arguments)


def test_a_division_by_zero_is_a_number_of_ieee_and_no_exception():
    assert not all(math.isfinite(value) for value in notch_coefficients(0.0, 0.0, 0.1, 0.1, 250e-6))


@pytest.mark.slow
def test_what_lies_on_disk_runs_without_numba_and_gives_the_same_bits(tmp_path):
    (tmp_path / "gadget").mkdir()
    (tmp_path / "gadget" / "sums.py").write_text(SUMS, encoding="utf-8")
    said = [run(tmp_path, "-m", "gadget.sums") for _ in range(2)]
    assert [line.split()[0] for line in said] == ["True", "False"]  # numba imported?
    assert said[0].split()[1:] == said[1].split()[1:]


@compiled
def mixed(values, count, flag, share):
    values[0].a = values[0].a + count
    return share if flag else values[0].a, share * count


def test_each_kind_of_arguments_has_its_own_machine_code_and_the_arrays_are_the_callers():
    one, other = np.zeros(1, [("a", "<f8")]), np.zeros(2, [("b", "<f8"), ("a", "<f8")])
    assert mixed(one, 3, False, 0.5) == (3.0, 1.5)
    assert mixed(other, 4, True, 0.5) == (0.5, 2.0)
    assert mixed(one, 3, False, 0.5) == (6.0, 1.5)
    assert mixed(one, 2.5, False, 2.0) == (8.5, 5.0)
    assert (one["a"][0], other["a"].tolist()) == (8.5, [4.0, 0.0])
    assert mixed(other[1:], 1, False, 2.0) == (1.0, 2.0)


@compiled
def added(record, more):
    record.a += more
    return record.a


def test_a_record_is_the_callers_too():
    rows = np.zeros(2, [("b", "<f8"), ("a", "<f8")])
    assert [added(rows[1], 2.0), added(rows[1], 2.0), added(rows[0], 1.0)] == [2.0, 4.0, 1.0]
    assert rows["a"].tolist() == [1.0, 4.0]


def test_what_is_not_in_one_piece_is_left_to_numba():
    every_other = np.zeros(4, [("a", "<f8")])[::2]
    assert mixed(every_other, 3, False, 0.5) == (3.0, 1.5)
    assert mixed(every_other.copy(), 3, False, 0.5) == (6.0, 1.5)


@pytest.mark.parametrize("arguments", [(), (1.0,), (np.zeros(1, [("a", "<f8")]), 1, True)])
def test_too_few_arguments_are_refused(arguments):
    mixed(np.zeros(1, [("a", "<f8")]), 3, False, 0.5)
    with pytest.raises(TypeError):
        mixed(*arguments)


def test_threads_do_not_mix_their_arguments():
    def work(share):
        return all(notch_coefficients(10.0, 10.0 + share, 0.1, 0.2, 250e-6) == wanted[share] for _ in range(3000))

    wanted = {share: notch_coefficients(10.0, 10.0 + share, 0.1, 0.2, 250e-6) for share in (0.5, 1.5, 2.5)}
    with ThreadPoolExecutor(3) as pool:
        assert all(pool.map(work, wanted))


def test_a_broken_file_is_made_anew(tmp_path):
    path = tmp_path / "code.o"
    assert machine_code.load(path, ("d",)) is None
    for content in (b"", b"{}\n", b'["x", "d", "0"]\nrubbish', b"[]\n"):
        path.write_bytes(content)
        assert machine_code.load(path, ("d",)) is None


@compiled
def allocating(count):
    return np.empty(count)


def test_what_needs_numba_runs_with_it_and_other_users_of_numba_keep_their_own_cache_folder():
    from numba.core import config as numba_config  # noqa: PLC0415 - half a second, which collection would wait

    assert len(allocating(3)) == 3
    assert allocating.dispatcher.overloads
    assert "compiled-" not in numba_config.CACHE_DIR


ALLOCATING = """
import numpy as np
from hil.control.compiled import compiled


@compiled
def squares(count):
    return np.arange(count) ** 2


print(squares(4).sum(), sum(squares.dispatcher.stats.cache_hits.values()))
"""


@pytest.mark.slow
def test_what_needs_numba_is_kept_by_numba(tmp_path):
    (tmp_path / "gadget").mkdir()
    (tmp_path / "gadget" / "squares.py").write_text(ALLOCATING, encoding="utf-8")
    assert [run(tmp_path, "-m", "gadget.squares").split() for _ in range(3)] == [["14", "0"], ["14", "1"], ["14", "1"]]


def test_a_numba_with_other_insides_only_starts_more_slowly(tmp_path, monkeypatch):
    def other(*_):
        raise AttributeError("no attribute 'codegen'")

    monkeypatch.setattr(machine_code, "save", other)

    def twice(x):
        return 2.0 * x

    function = compiled(twice)
    monkeypatch.setattr(function, "_folder", lambda: tmp_path)
    assert function(21.0) == 42.0
    assert function.loaded == 0
    assert function.refused == {("d",): "AttributeError: no attribute 'codegen'"}


def in_folder(function, folder, monkeypatch):
    monkeypatch.setattr(function, "_folder", lambda: folder)
    return function


def with_other_insides(monkeypatch, old, new):
    """Let the compiler translate something else than numba runs."""
    save = machine_code.save

    def altered(path, kinds, fresh, arguments):
        text = fresh.library.get_llvm_str()
        assert old in text
        library = SimpleNamespace(get_llvm_str=lambda: text.replace(old, new), codegen=fresh.library.codegen)
        other = SimpleNamespace(library=library, signature=fresh.signature, fndesc=fresh.fndesc, entry_point=fresh.entry_point)
        return save(path, kinds, other, arguments)

    monkeypatch.setattr(machine_code, "save", altered)


def test_machine_code_with_another_result_is_thrown_away_and_said_so(tmp_path, monkeypatch):
    def shifted(x):
        return x + 0.5

    with_other_insides(monkeypatch, "fadd double", "fsub double")
    function = in_folder(compiled(shifted), tmp_path, monkeypatch)
    with pytest.warns(RuntimeWarning, match=r"shifted: machine code thrown away.* 1\.5 where numba gives 2\.5"):
        assert function(2.0) == 2.5
    assert function.refused == {("d",): "it gives 1.5 where numba gives 2.5"}
    assert not list(tmp_path.glob("*.o"))
    assert function(3.0) == 3.5


def test_machine_code_that_writes_something_else_is_thrown_away_and_the_callers_array_is_numbas(tmp_path, monkeypatch):
    def shift(share, values):
        values[1] = values[1] + share

    with_other_insides(monkeypatch, "fadd double", "fsub double")
    function, values = in_folder(compiled(shift), tmp_path, monkeypatch), np.array([1.0, 2.0])
    with pytest.warns(RuntimeWarning, match="shift: machine code thrown away.* leaves argument 1 otherwise"):
        function(0.25, values)
    assert values.tolist() == [1.0, 2.25]
    assert not list(tmp_path.glob("*.o"))


@pytest.mark.parametrize("bits", [0x7FF8000000000001, 0x8000000000000000])
def test_a_nan_and_a_zero_count_by_their_bits(bits):
    value, plain = np.array([bits, 0x7FF8000000000000 if bits >> 62 == 1 else 0], "u8").view("f8").tolist()
    with pytest.raises(machine_code.DifferentBitsError):
        machine_code._judge(lambda: value, lambda: plain, ())
    machine_code._judge(lambda: value, lambda: value, ())


def test_the_judgement_leaves_the_arrays_of_the_call_alone(tmp_path, monkeypatch):
    def swapped(one, other, record):
        one[0] += 1.0
        other[0] *= 2.0
        record.a += one[0]
        return record.a

    rows, same = np.zeros(2, [("b", "<f8"), ("a", "<f8")]), np.array([1.0])
    function = in_folder(compiled(swapped), tmp_path, monkeypatch)
    assert function(same, same, rows[1]) == 4.0  # one array twice: (1 + 1) * 2
    assert (same.tolist(), rows["a"].tolist()) == ([4.0], [0.0, 4.0])
    assert len(list(tmp_path.glob("*.o"))) == 1
    assert function.refused == {}


def test_a_number_is_of_its_kind_whatever_the_first_one_was(tmp_path, monkeypatch):
    def halved(count):
        return count // 2 * 1.0

    function = in_folder(compiled(halved), tmp_path, monkeypatch)
    assert [function(np.uint8(3)), function(-3), function(1 << 40)] == [1.0, -2.0, float(1 << 39)]
    assert list(tmp_path.glob("*.o"))


def alone(x):
    return (x,)


def truth(x):
    return x > 0.0


@pytest.mark.parametrize(("function", "said"), [(alone, r"gives back .*float64"), (truth, "gives back bool")])
def test_what_a_saved_function_could_not_give_back_stays_with_numba(function, said, tmp_path, monkeypatch):
    door = in_folder(compiled(function), tmp_path, monkeypatch)
    for x in (1.0, -1.0):
        found, wanted = door(x), function(x)
        assert (found, type(found)) == (wanted, type(wanted))
    (reason,) = door.refused.values()
    assert re.search(said, reason)


def test_what_needs_more_than_the_c_library_stays_with_numba_and_says_what(tmp_path, monkeypatch):
    def filled(count):
        return np.ones(count).sum()

    function = in_folder(compiled(filled), tmp_path, monkeypatch)
    assert function(3) == 3.0
    assert re.search("it needs .*NRT", function.refused["q",])
