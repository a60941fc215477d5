"""The served robots of the bus' tests: what goes through a serial port comes from there."""

from tests.plant_emulator.bus.conftest import running, serve, start_server

__all__ = ["running", "serve", "start_server"]
