"""The tool as a module, and what its help costs."""

import subprocess
import sys

import pytest


def run(*arguments):
    return subprocess.run([sys.executable, *arguments], capture_output=True, text=True, check=False, timeout=60)


def test_the_package_runs_as_a_module():
    done = run("-m", "hil", "--help")
    assert done.returncode == 0, done.stderr
    assert "Usage: python -m hil [OPTIONS] COMMAND" in done.stdout


COMMANDS = {
    "run": ["run", "line-motion"],
    "plan": ["plan"],
    "identify-plant": ["identify", "plant", "--axis", "2"],
    "identify-ate": ["identify", "ate", "--axis", "2"],
    "design": ["design", "notch", "--axis", "2"],
    "learn": ["learn", "--axis", "2", "--model", "learnt.toml"],
    "compare": ["compare"],
}


SCIPY = {f"scipy.{part}" for part in ("fft", "interpolate", "linalg", "optimize", "signal", "sparse", "special", "stats")}
HEAVY = {"canopen", "can", "cffi", "matplotlib", "jinja2", *SCIPY}
"""What takes a tenth of a second or more to load; scipy itself, without its parts, takes a fiftieth."""


@pytest.mark.slow
@pytest.mark.parametrize("command", COMMANDS.values(), ids=COMMANDS)
def test_a_bench_file_with_a_mistake_is_refused_before_anything_heavy_is_loaded(command, tmp_path):
    bench = tmp_path / "bench.toml"
    bench.write_text("name = 3\n", encoding="utf-8")
    program = (
        "import sys\nfrom hil.__main__ import main\n"
        f"try:\n    main()\nexcept SystemExit as end:\n    print(end.code, {HEAVY} & set(sys.modules) or 'none')"
    )
    done = run("-c", program, *command, "--bench", str(bench))
    assert done.stdout == "3 none\n", done.stderr
    assert f"{bench}:1: name: found 3" in done.stderr


def test_help_loads_nothing_heavy():
    heavy = "{'numpy', 'pydantic', 'canopen', 'can', 'scipy', 'cffi', 'matplotlib', 'jinja2'}"
    done = run("-c", f"import sys, hil.cli.main; sys.exit(str({heavy} & set(sys.modules) or ''))")
    assert done.stderr.strip() == ""
