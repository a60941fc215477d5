"""The commands of ``plant-emulator``: `serve`, `simulate`, `robustness` and `eds`; `cli.main` puts them together."""
