"""The tool as a module, and what its help costs."""

import subprocess
import sys


def run(*arguments):
    return subprocess.run([sys.executable, *arguments], capture_output=True, text=True, check=False, timeout=60)


def test_the_package_runs_as_a_module():
    done = run("-m", "plant_emulator", "--help")
    assert done.returncode == 0, done.stderr
    assert "Usage: python -m plant_emulator [OPTIONS] COMMAND" in done.stdout


def test_help_loads_nothing_heavy():
    heavy = "{'numpy', 'pydantic', 'canopen', 'can', 'scipy', 'cffi', 'matplotlib', 'jinja2'}"
    done = run("-c", f"import sys, plant_emulator.cli.main; sys.exit(str({heavy} & set(sys.modules) or ''))")
    assert done.stderr.strip() == ""
