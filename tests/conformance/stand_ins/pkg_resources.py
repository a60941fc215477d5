"""The one function of setuptools' late pkg_resources that dcfgen 2.4.2 calls, for its process alone."""

import importlib.util
from pathlib import Path


def resource_filename(module, name):
    """Path of a file beside a module; run as a program it is dcfgen's."""
    package = "dcfgen" if module == "__main__" else module.partition(".")[0]
    spec = importlib.util.find_spec(package)
    if spec is None or spec.origin is None:
        raise ModuleNotFoundError(package)
    return str(Path(spec.origin).parent / name)
