"""Build backend: setuptools, which asks for a C compiler from PyPI where the machine has none."""

import sys
from pathlib import Path

from setuptools import build_meta
from setuptools.build_meta import *  # noqa: F403 - the hooks of setuptools, but for those below

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from hil.core.build import BuildError, compiler

COMPILER = "ziglang>=0.13,<0.17"
"""Compiler as a package; the versions with which the core was built, and gave the bits of gcc."""


def _with_compiler(wanted: list[str]) -> list[str]:
    try:
        compiler()
    except BuildError:
        return [*wanted, COMPILER]
    return wanted


def get_requires_for_build_wheel(config_settings: object = None) -> list[str]:
    """Return what a wheel needs to be built."""
    return _with_compiler(build_meta.get_requires_for_build_wheel(config_settings))


def get_requires_for_build_editable(config_settings: object = None) -> list[str]:
    """Return what an editable installation needs to be built."""
    return _with_compiler(build_meta.get_requires_for_build_editable(config_settings))
