"""Build of the core: a shared library and its declarations.

The C sources become a library that belongs to no version of Python.

setup.py runs this file before anything is installed: it needs the standard library and cffi.
"""

import hashlib
import importlib.util
import os
import shutil
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
"""Folder of the packages, in a checkout and in an installation."""

STRICT = ("-std=c99", "-O3", "-ffp-contract=off")
"""Strict arithmetic: host and emulated drive compute the same bits, and so does the specification in Python."""
SHARED = ("-shared", "-fPIC", "-fno-semantic-interposition")
WARNINGS = ("-Wall", "-Wextra", "-Wconversion")
"""The tests make errors of them; a compiler of tomorrow that warns of more still builds the core."""
SUFFIX = ".native"
"""Of a library's file: Python takes one that ends with .so for a module of its own."""


class BuildError(RuntimeError):
    """No compiler was found, or it refused the sources."""


@dataclass(frozen=True)
class Core:
    """A shared library, and what it is made of.

    Attributes:
        name: Name of the core, and of its files but for the ending.
        package: Folder of the package that holds the files, below `ROOT`.
        header: Header that includes all that Python calls, below `ROOT`.
        folders: Folders of the C sources, below `ROOT`.
    """

    name: str
    package: str
    header: str
    folders: tuple[str, ...]

    @property
    def library(self) -> Path:
        """File of the shared library."""
        return ROOT / self.package / f"{self.name}{SUFFIX}"

    @property
    def declarations(self) -> Path:
        """File of the module that declares the library to Python."""
        return ROOT / self.package / f"{self.name}_abi.py"

    def files(self, *endings: str) -> list[Path]:
        """Sources with these endings, in a fixed order."""
        return sorted(path for folder in self.folders for path in (ROOT / folder).iterdir() if path.suffix in endings)

    def digest(self) -> str:
        """Digest of all sources and headers, and of the options that shape the machine code, in hexadecimal."""
        found = hashlib.sha256(" ".join((*STRICT, *SHARED)).encode())
        for path in self.files(".c", ".h"):
            found.update(path.relative_to(ROOT).as_posix().encode())
            found.update(path.read_bytes())
        return found.hexdigest()[:16]


LAW = Core("law", "hil/core", "hil/core/core.h", ("hil/core", "hil/control", "hil/can", "hil/design", "hil/logs", "hil/master"))
"""The control law, and what the bus, design, logs and the master have in C."""


def compiler() -> list[str]:
    """Return the command of the C compiler.

    It is $CC, cc, gcc or clang, or else the one in the package ziglang.

    Raises:
        BuildError: There is none of these.
    """
    if given := os.environ.get("CC"):
        return given.split()
    for name in ("cc", "gcc", "clang"):
        if shutil.which(name):
            return [name]
    if importlib.util.find_spec("ziglang") is not None:
        return [sys.executable, "-m", "ziglang", "cc"]
    raise BuildError("there is no C compiler ($CC, cc, gcc, clang); install one, or the package ziglang from PyPI")


def compile_core(core: Core, command: Sequence[str] | None = None, out: Path | None = None, options: Iterable[str] = ()) -> Path:
    """Compile a core; the file appears whole or not at all.

    Args:
        command: Command of the compiler; None: that of `compiler`.
        out: File to write; None: where the core is looked for.

    Raises:
        BuildError: There is no compiler, or it ended with an error, which the message quotes.
    """
    import subprocess  # noqa: PLC0415 - a core that is built loads without them
    import tempfile  # noqa: PLC0415

    given, path = list(command or compiler()), out or core.library
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(prefix=f".{path.name}-", dir=path.parent)
    os.close(handle)
    sources = [str(each.relative_to(ROOT)) for each in core.files(".c")]
    words = [
        *given,
        *STRICT,
        *WARNINGS,
        *SHARED,
        f'-DCORE_SOURCES="{core.digest()}"',
        "-I.",
        *options,
        "-o",
        name,
        *sources,
        "-lm",
    ]
    try:
        done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)  # noqa: S603 - the user's own compiler
        if done.returncode:
            raise BuildError(f"{' '.join(given)} ended with {done.returncode}:\n{done.stderr.strip()}")
        Path(name).chmod(0o755)
        Path(name).replace(path)
    except OSError as error:
        raise BuildError(f"{given[0]} cannot be started ({error.strerror}); set CC to a C compiler") from None
    finally:
        Path(name).unlink(missing_ok=True)
    return path


def build(core: Core) -> None:
    """Build library and declarations of a core where they are looked for.

    Raises:
        BuildError: There is no compiler, or it refused the sources, or cffi is not installed.
    """
    try:
        from hil.core.declarations import module_text  # noqa: PLC0415 - it asks for cffi's parser

        text = module_text(ROOT, core.header, core.digest())
    except ImportError as error:
        raise BuildError(f"{error}; install cffi") from None
    compile_core(core)
    new = core.declarations.with_suffix(f".{os.getpid()}.new")
    new.write_text(text, encoding="utf-8")
    new.replace(core.declarations)
