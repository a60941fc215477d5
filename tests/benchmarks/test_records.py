"""The header that is made from numpy dtypes: a C compiler puts every field where numpy has it."""

import subprocess
from pathlib import Path

import numpy as np
import pytest

from benchmarks.records import CONSTANTS, RECORDS, header

ODD = {
    "Aligned": np.dtype([("a", np.int8), ("b", np.float64), ("c", np.uint16), ("d", np.float32)], align=True),
    "Packed": np.dtype([("a", np.int8), ("b", np.float64), ("c", np.bool_), ("d", np.int32, (2, 3)), ("e", np.uint64)]),
    "Sparse": np.dtype({"names": ["late", "early"], "formats": ["i2", "f8"], "offsets": [21, 3], "itemsize": 40}),
}
"""Dtypes with gaps, without alignment, with arrays, and with fields that are not named in the order in which they lie."""


def _compiled(compiler: str, folder: Path, text: str, body: str = "return 0;") -> subprocess.CompletedProcess[str]:
    (folder / "records.h").write_text(text)
    source = folder / "main.c"
    source.write_text(f'#include <stdio.h>\n#include "records.h"\nint main(void)\n{{\n{body}\n}}\n')
    command = [compiler, "-Wall", "-Wextra", "-Werror", str(source), "-o", str(folder / "main")]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def _places(records: dict[str, np.dtype]) -> dict[str, tuple[int, int]]:
    found = {name: (0, dtype.itemsize) for name, dtype in records.items()}
    for name, dtype in records.items():
        for field, (kind, offset, *_) in (dtype.fields or {}).items():
            found[f"{name}.{field}"] = offset, kind.itemsize
    return found


@pytest.mark.parametrize("records", [RECORDS, ODD], ids=["ours", "odd"])
def test_every_field_lies_where_numpy_has_it(compiler, tmp_path, records):
    wanted = _places(records)
    lines = []
    for place in wanted:
        record, _, field = place.partition(".")
        offset = f"offsetof({record}, {field})" if field else "(size_t)0"
        size = f"sizeof((({record} *)0)->{field})" if field else f"sizeof({record})"
        lines.append(f'    printf("{place} %zu %zu\\n", {offset}, {size});')
    built = _compiled(compiler, tmp_path, header(records), "\n".join(lines))
    assert built.returncode == 0, built.stderr
    said = subprocess.run([str(tmp_path / "main")], capture_output=True, text=True, check=True).stdout
    found = {name: (int(offset), int(size)) for name, offset, size in map(str.split, said.splitlines())}
    assert found == wanted


def test_values_arrive_in_their_fields(compiler, tmp_path):
    rows = np.zeros(2, ODD["Packed"])
    rows["a"], rows["b"], rows["c"], rows["e"] = -5, 0.1, True, 1 << 63
    rows["d"] = np.arange(6).reshape(2, 3) - 3
    (tmp_path / "rows").write_bytes(rows.tobytes())
    body = """
    Packed rows[2];
    if (fread(rows, sizeof(Packed), 2, stdin) != 2) return 1;
    unsigned long long e = rows[1].e;
    printf("%d %a %d %d %d %llu", rows[1].a, rows[1].b, rows[1].c, rows[1].d[0][0], rows[1].d[1][2], e);
    return 0;"""
    built = _compiled(compiler, tmp_path, header(ODD), body)
    assert built.returncode == 0, built.stderr
    with (tmp_path / "rows").open("rb") as file:
        said = subprocess.run([str(tmp_path / "main")], stdin=file, capture_output=True, text=True, check=True).stdout
    a, b, *rest = said.split()
    assert (int(a), float.fromhex(b), [*map(int, rest)]) == (-5, 0.1, [1, -3, 2, 1 << 63])


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("    double counts_per_rev;\n", ""),
        ("    double latch_counts[11];", "    double latch_counts[12];"),
        (
            "    int64_t periods_per_set_point;\n    int64_t extrapolation_periods;",
            "    int64_t extrapolation_periods;\n    int64_t periods_per_set_point;",
        ),
    ],
    ids=["a field is missing", "an array is longer", "two are exchanged"],
)
def test_the_compiler_refuses_a_record_that_is_not_numpys(compiler, tmp_path, old, new):
    text = header()
    assert old in text
    built = _compiled(compiler, tmp_path, text.replace(old, new))
    assert built.returncode != 0
    assert "Motion" in built.stderr


def test_constants_keep_all_their_digits(compiler, tmp_path):
    lines = [f'    printf("{name} %a\\n", (double){name});' for name in CONSTANTS]
    built = _compiled(compiler, tmp_path, header(), "\n".join(lines))
    assert built.returncode == 0, built.stderr
    said = subprocess.run([str(tmp_path / "main")], capture_output=True, text=True, check=True).stdout
    assert {name: float.fromhex(value) for name, value in map(str.split, said.splitlines())} == CONSTANTS


@pytest.mark.parametrize(
    ("dtype", "words"),
    [
        (np.dtype(np.float64), "without fields"),
        (np.dtype([("z", np.complex128)]), "R.z: C has no number"),
        (np.dtype([("h", np.float16)]), "R.h: C has no number"),
        (np.dtype([("b", np.dtype(np.int32).newbyteorder())]), "R.b: C has no number"),
        (np.dtype({"names": ["a", "b"], "formats": ["f8", "f8"], "offsets": [0, 4]}), "R.b begins at byte 4"),
        (np.dtype([("θ", np.float64)]), "'θ' is no name in C"),
        (np.dtype([("inner", [("x", np.float64)])]), "R.inner: C has no number"),
    ],
)
def test_what_c_cannot_say_is_refused(dtype, words):
    with pytest.raises(ValueError, match=words):
        header({"R": dtype}, {})
