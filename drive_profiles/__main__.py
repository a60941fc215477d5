"""`python -m drive_profiles`."""

from drive_profiles.cli.main import main

main()
