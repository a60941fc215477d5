r"""Reading and writing of users' files.

>>> from drive_profiles.errors import FileError
>>> from drive_profiles.files.toml import Table, loads
>>> class Axis(Table):
...     node: int
>>> loads("node = 2", Axis).node
2
>>> try:
...     loads("\nnode = 'two'", Axis, "axis.toml")
... except FileError as error:
...     print(error.problems[0].line, error.problems[0].key)
2 node
"""
