"""`python -m plant_emulator`."""

from plant_emulator.cli import main

main()
