"""Kinds of TOML files of all three tools, told apart by keys that no other kind has."""

from collections.abc import Callable, Collection, Iterator

from drive_profiles.files.toml_lines import KeyPath

ANY = "*"
"""Stands for the number or the name of a table."""

KINDS: dict[str, tuple[KeyPath, ...]] = {
    "a bench file": (("bus", "sync_period_s"), ("axis", ANY, "limits")),
    "a robot file": (("axis", ANY, "gear_damping_nm_s_rad"), ("axis", ANY, "torque_limit_nm")),
    "a model file": (("axis", ANY, "plant"), ("axis", ANY, "ate", "standard_error")),
    "a design file": (("axis", ANY, "sensitivity_peak"),),
    "a file of faults": (("fault",),),
    "a layout of a recording": (("column",), ("unit",)),
    "a spread of plants": (("gear_stiffness_percent",), ("arm_inertia_percent",), ("a2_percent",)),
    "a drive profile": (("identity",), ("parameters",)),
    "a parameter set": (("header",), ("tuning",), ("limits",), ("communication",), ("commissioning",)),
}


def kinds_of(paths: Collection[KeyPath]) -> Iterator[str]:
    """Yield the kinds of which a file has a key, by the paths of all its keys."""
    for kind, marks in KINDS.items():
        if any(_fits(path, mark) for mark in marks for path in paths):
            yield kind


def _fits(path: KeyPath, mark: KeyPath) -> bool:
    return len(path) == len(mark) and all(key in {part, ANY} for part, key in zip(path, mark, strict=True))


def mistaken(paths: Collection[KeyPath], allowed: Callable[[KeyPath], bool]) -> tuple[str, str] | None:
    """Return the kind of a file and the one that is expected; None if it may be that one.

    Args:
        paths: Paths of the keys of the file.
        allowed: True for a path that the expected kind has.
    """
    expected = [kind for kind, marks in KINDS.items() if any(allowed(mark) for mark in marks)]
    found = list(kinds_of(paths))
    return (found[0], expected[0]) if found and expected and not set(found) & set(expected) else None
