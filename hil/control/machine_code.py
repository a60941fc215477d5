"""Machine code on disk: made once with numba, then loaded and called without it.

Importing numba and getting it ready takes one to two seconds before it has loaded anything. What it has compiled does not need
it: an object file with one entry point, which llvmlite puts into memory in 60 ms and ctypes calls.
"""

import ctypes
import hashlib
import json
import os
import struct
import tempfile
import threading
from collections.abc import Callable
from functools import cache
from importlib.metadata import version
from operator import itemgetter
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm  # type: ignore[import-untyped]
import numpy as np

_ARGUMENTS = 17
"""The slot of 8 bytes in an entry's block at which the arguments begin; before it 16 for the result, one for an exception."""

_RETURNED = (0, -2)
"""numba's status of a function that returned a value, and of one that returned None."""

_LIBRARY = {"sin", "cos", "sincos", "tan", "exp", "log", "pow", "floor", "ceil", "rint", "sqrt", "memset", "memcpy", "memmove"}
"""The only functions from outside that machine code may call: those of the C library, which every Python process has."""

_NEVER_FREED = """
define void @NRT_MemInfo_call_dtor(ptr %owner) {
  ret void
}
"""
"""The arrays that an entry gets belong to nobody as far as numba's reference counts go, so that nothing is ever freed."""

_LETTERS = {"float64": "d", "int64": "q"}
"""What numba calls the results that an entry can give back, in the letters of `struct`."""

_KEPT = 64
"""Blocks that an entry keeps, with their arrays, before it forgets them all."""


@cache
def platform() -> str:
    """What machine code depends on besides the sources: both halves of the compiler, and the processor."""
    return f"{version('numba')} {version('llvmlite')} {llvm.get_host_cpu_name()} {llvm.get_host_cpu_features().flatten()}"


@cache
def _described(dtype: np.dtype[Any]) -> str:
    return str(dtype.descr)


def kind(argument: object) -> str | None:
    """What of an argument decides which machine code serves it; None for what only numba takes.

    A letter of `struct` for a number; dimensions and dtype for an array that lies in memory in one piece; dtype for a record.
    """
    if isinstance(argument, float):
        return "d"
    if isinstance(argument, (bool, np.bool_)):
        return "?"
    if isinstance(argument, (int, np.integer)):
        return "q"
    if isinstance(argument, np.ndarray) and argument.flags.c_contiguous and argument.flags.writeable:
        return f"{argument.ndim} {_described(argument.dtype)}"
    if isinstance(argument, np.void):
        return f"record {_described(argument.dtype)}"
    return None


class OtherKindError(TypeError):
    """Arguments for which other machine code has to be loaded, or made."""


class Entry:
    """A function in machine code, for arguments of certain kinds."""

    def __init__(self, address: int, kinds: tuple[str, ...], result: str) -> None:
        """At this address; `result` has one letter of `struct` for each value that comes back."""
        self._call = ctypes.PYFUNCTYPE(ctypes.c_int32, ctypes.c_void_p)(address)
        self._kinds = kinds
        numbers = [place for place, each in enumerate(kinds) if len(each) == 1]
        arrays = [place for place, each in enumerate(kinds) if len(each) > 1]
        self._numbers, self._arrays = _picker(numbers), _picker(arrays)
        self._array_kinds = tuple(kinds[place] for place in arrays)
        self._first_array = _ARGUMENTS + len(numbers)
        self._pack = struct.Struct("=" + "".join(kinds[place].replace("?", "?7x") for place in numbers)).pack_into
        self._unpack = struct.Struct(f"={result}").unpack_from
        self._values = len(result)
        self._blocks: dict[tuple[int, ...], tuple[Any, int, tuple[Any, ...]]] = {}
        self._lock = threading.Lock()  # between arguments in and result out

    def _block(self, key: tuple[int, ...], arrays: tuple[Any, ...]) -> tuple[Any, int, tuple[Any, ...]]:
        """A block with these arrays in it; it keeps them, so that their identities and addresses do not pass to others."""
        if tuple(map(kind, arrays)) != self._array_kinds:
            raise OtherKindError
        slots = [0] * self._first_array
        for array in arrays:
            address = array.__array_interface__["data"][0]
            if isinstance(array, np.void):
                slots.append(address)
            else:  # as numba hands it over: no owner, no parent, items, bytes per item, address, shape, strides
                slots += [0, 0, array.size, array.itemsize, address, *array.shape, *array.strides]
        block = (ctypes.c_int64 * len(slots))(*slots)
        if len(self._blocks) >= _KEPT:
            self._blocks.clear()
        self._blocks[key] = found = (block, ctypes.addressof(block), arrays)
        return found

    def __call__(self, *arguments: Any) -> Any:
        """Call it.

        Raises:
            OtherKindError: These arguments need other machine code.
        """
        if len(arguments) != len(self._kinds):
            raise OtherKindError
        arrays = self._arrays(arguments)
        key = tuple(map(id, arrays))
        with self._lock:
            block, address, _ = self._blocks.get(key) or self._block(key, arrays)
            try:
                self._pack(block, 8 * _ARGUMENTS, *self._numbers(arguments))
            except struct.error as error:
                raise OtherKindError from error
            status = self._call(address)
            if status not in _RETURNED:
                raise RuntimeError(f"machine code returned with status {status}")
            values = self._unpack(block)
        return values if self._values > 1 else values[0] if values else None


def _picker(places: list[int]) -> Callable[[tuple[Any, ...]], tuple[Any, ...]]:
    """What takes the values at these places."""
    if len(places) > 1:
        return itemgetter(*places)
    return itemgetter(slice(places[0], places[0] + 1)) if places else itemgetter(slice(0))


@cache
def _engine() -> Any:
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    machine = llvm.Target.from_default_triple().create_target_machine(jit=True, codemodel="jitdefault")
    return llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)


def file_name(name: str, kinds: tuple[str, ...]) -> str:
    """Of the machine code of a function for arguments of these kinds, on this machine."""
    return f"{name}-{hashlib.sha256(repr((kinds, platform())).encode()).hexdigest()[:16]}.o"


def load(path: Path, kinds: tuple[str, ...]) -> Entry | None:
    """What `save` has written; None where there is nothing, or nothing whole."""
    try:
        head, code = path.read_bytes().split(b"\n", 1)
        symbol, result, digest = json.loads(head)
    except (OSError, ValueError):
        return None
    return _entry(symbol, code, kinds, result) if digest == hashlib.sha256(code).hexdigest() else None


def _entry(symbol: str, code: bytes, kinds: tuple[str, ...], result: str) -> Entry:
    engine = _engine()
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    return Entry(engine.get_function_address(symbol), kinds, result)


def _trampoline(symbol: str, function: Any, kinds: tuple[str, ...]) -> str:
    """An entry point in LLVM's language: takes the arguments out of the block, numbers first, and calls numba's function."""
    numbers = sum(len(each) == 1 for each in kinds)
    number, array = _ARGUMENTS, _ARGUMENTS + numbers
    slots: list[int] = []
    for each in kinds:
        if len(each) == 1:
            slots.append(number)
            number += 1
        else:
            dimensions = each.split()[0]
            width = 1 if dimensions == "record" else 5 + 2 * int(dimensions)
            slots += range(array, array + width)
            array += width
    result, exception, *types = [str(argument.type) for argument in function.arguments]
    if len(types) != len(slots):
        raise NotImplementedError(f"{function.name} takes {len(types)} values instead of {len(slots)}")
    lines = [f"define i32 @{symbol}(ptr %block) {{", f"%exception = getelementptr i64, ptr %block, i64 {_ARGUMENTS - 1}"]
    for place, (slot, each) in enumerate(zip(slots, types, strict=True)):
        lines += [f"%p{place} = getelementptr i64, ptr %block, i64 {slot}", f"%a{place} = load {each}, ptr %p{place}"]
    passed = ", ".join(f"{each} %a{place}" for place, each in enumerate(types))
    lines += [f'%status = call i32 @"{function.name}"({result} %block, {exception} %exception, {passed})', "ret i32 %status", "}"]
    return "\n".join(lines)


def save(path: Path, kinds: tuple[str, ...], compiled: Any) -> Entry | None:
    """Write numba's result (`CompileResult`) to disk as an object file, and load it.

    Returns:
        None where the function needs more than the C library, or gives back what is no number: it stays with numba.
    """
    returned = compiled.signature.return_type
    each = [] if str(returned) == "none" else list(getattr(returned, "types", (returned,)))
    if not all(str(one) in _LETTERS for one in each):
        return None
    result = "".join(_LETTERS[str(one)] for one in each)
    library = compiled.library
    symbol = "entry_" + hashlib.sha256(f"{path}{kinds}".encode()).hexdigest()[:24]
    text = library.get_llvm_str()
    function = llvm.parse_assembly(text).get_function(compiled.fndesc.llvm_func_name)
    try:
        module = llvm.parse_assembly(text + "\n" + _trampoline(symbol, function, kinds))
    except NotImplementedError:
        return None
    module.link_in(llvm.parse_assembly(_NEVER_FREED))
    for one in [*module.functions, *module.global_variables]:
        if not one.is_declaration and one.name != symbol:
            one.linkage = "internal"
    passes = llvm.create_new_module_pass_manager()
    passes.add_global_dead_code_eliminate_pass()
    machine = library.codegen._tm
    passes.run(module, llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options()))
    wanted = {one.name for one in [*module.functions, *module.global_variables] if one.is_declaration}
    if any(name not in _LIBRARY and not name.startswith("llvm.") for name in wanted):
        return None
    code = machine.emit_object(module)
    head = json.dumps([symbol, result, hashlib.sha256(code).hexdigest()]).encode()
    _write(path, head + b"\n" + code)
    return _entry(symbol, code, kinds, result)


def _write(path: Path, content: bytes) -> None:
    """Whole or not at all; where nothing can be written it is made anew by each process."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent)
        with os.fdopen(handle, "wb") as file:
            file.write(content)
        os.replace(name, path)
    except OSError:
        return
