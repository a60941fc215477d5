"""The command line ``drive-profiles``.

`profiles`, `realise`, `convert` and `eds` need no bus, `read` and `compare` read drives, `write` and `restore` write to them by
the transaction of `transact`. Each module adds its commands to the application by its `mount`; `main` calls them all. `console`
has exit statuses, tables and questions, and `options` the options that several commands take.
"""
