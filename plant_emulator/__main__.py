"""`python -m plant_emulator`."""

from plant_emulator.cli.main import main

main()
