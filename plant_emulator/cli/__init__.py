"""The commands of ``plant-emulator``; `cli.main` joins them."""
