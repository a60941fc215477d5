"""The drive that most tests of this room want; a file that needs another one has a fixture of its own."""

import pytest

from tests.plant_emulator.rig import Rig


@pytest.fixture
def rig():
    """A drive with the gains of the reference bench, powered and pre-operational."""
    return Rig()
