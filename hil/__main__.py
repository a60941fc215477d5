"""`python -m hil`."""

from hil.cli.main import main

main()
