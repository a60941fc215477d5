"""The command line ``hil``.

Each module is a command, or a group of commands, and adds itself to the application by its `mount`; `main` calls them all.
`console` has exit statuses, messages, progress and the question before a robot moves, and `options` the options that several
commands take. The commands import numpy only when they run, so that `--help` stays quick.
"""
