"""Machine code on disk: compiled once with numba, then loaded and called without it.

Importing numba takes one to two seconds before anything is loaded. Its compiled code does not need it: an object file with one
entry point, which llvmlite puts into memory in 60 ms and ctypes calls.

Nothing guarantees that this works: it reads numba's internals, and the object file is compiled separately from the code that
numba runs. So each object file is tested before it is stored: one call with either code, and every bit of the results compared.
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
"""Index of the first argument among the 8-byte slots of a block, behind 16 for the result and one for an exception."""

_RETURNED = (0, -2)
"""numba's status of a function that returned a value, and of one that returned None."""

_LIBRARY = {"sin", "cos", "sincos", "tan", "exp", "log", "pow", "floor", "ceil", "rint", "sqrt", "memset", "memcpy", "memmove"}
"""Outside functions that machine code may call: those of the C library, which every Python process has."""

_NEVER_FREED = """
define void @NRT_MemInfo_call_dtor(ptr %owner) {
  ret void
}
"""
"""Destructor that numba's reference counts would call. The arrays have no owner there, so it has nothing to free."""

_LETTERS = {"float64": "d", "int64": "q"}
"""Letter of `struct` for each of numba's types that an entry point can return."""

_IN_MEMORY = (np.ndarray, np.void)
"""Types of arguments that are passed by address and may be written to."""

_KEPT = 64
"""Blocks that an entry point keeps with their arrays before it forgets them all."""


@cache
def platform() -> str:
    """Versions of the compiler and name of the processor: machine code depends on them besides the sources."""
    return f"{version('numba')} {version('llvmlite')} {llvm.get_host_cpu_name()} {llvm.get_host_cpu_features().flatten()}"


@cache
def _described(dtype: np.dtype[Any]) -> str:
    return str(dtype.descr)


def kind(argument: object) -> str | None:
    """Type key of an argument, which selects the machine code; None if only numba can take the argument.

    The key is a letter of `struct` for a number, dimensions and dtype for an array that is contiguous in memory, and the dtype
    for a record.
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


class NotSavedError(Exception):
    """A function cannot be saved as machine code; numba serves it."""


class DifferentBitsError(NotSavedError):
    """Machine code gives other bits than numba, which therefore serves the function."""


class OtherKindError(TypeError):
    """Arguments of other types than those of the machine code at hand."""


class EntryPoint:
    """A function in machine code, for arguments with certain type keys."""

    def __init__(self, address: int, kinds: tuple[str, ...], result: str) -> None:
        """Take the code at an address; `result` has one letter of `struct` for each returned value."""
        self._call = ctypes.PYFUNCTYPE(ctypes.c_int32, ctypes.c_void_p)(address)
        self._kinds = kinds
        numbers = [index for index, each in enumerate(kinds) if len(each) == 1]
        arrays = [index for index, each in enumerate(kinds) if len(each) > 1]
        self._numbers, self._arrays = _picker(numbers), _picker(arrays)
        self._array_kinds = tuple(kinds[index] for index in arrays)
        self._first_array = _ARGUMENTS + len(numbers)
        self._pack = struct.Struct("=" + "".join(kinds[index].replace("?", "?7x") for index in numbers)).pack_into
        self._unpack = struct.Struct(f"={result}").unpack_from
        self._values = len(result)
        self._blocks: dict[tuple[int, ...], tuple[Any, int, tuple[Any, ...]]] = {}
        self._lock = threading.Lock()  # between arguments in and result out

    def _block(self, key: tuple[int, ...], arrays: tuple[Any, ...]) -> tuple[Any, int, tuple[Any, ...]]:
        """A block for these arrays, which are kept alive, so that other arrays cannot get their identities and addresses."""
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
        self._blocks[key] = kept_block = (block, ctypes.addressof(block), arrays)
        return kept_block

    def __call__(self, *arguments: Any) -> Any:
        """Call the function.

        Raises:
            OtherKindError: The arguments need other machine code.
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


def _picker(indices: list[int]) -> Callable[[tuple[Any, ...]], tuple[Any, ...]]:
    """A function that returns the values at these indices, always as a tuple."""
    if len(indices) > 1:
        return itemgetter(*indices)
    return itemgetter(slice(indices[0], indices[0] + 1)) if indices else itemgetter(slice(0))


@cache
def _engine() -> Any:
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    machine = llvm.Target.from_default_triple().create_target_machine(jit=True, codemodel="jitdefault")
    return llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)


def file_name(name: str, kinds: tuple[str, ...]) -> str:
    """File name of the machine code of a function for these type keys, on this machine."""
    return f"{name}-{hashlib.sha256(repr((kinds, platform())).encode()).hexdigest()[:16]}.o"


def load(path: Path, kinds: tuple[str, ...]) -> EntryPoint | None:
    """Load the machine code that `save` has written; None if the file is missing or damaged."""
    try:
        head, code = path.read_bytes().split(b"\n", 1)
        symbol, result, digest = json.loads(head)
    except (OSError, ValueError):
        return None
    return _entry(symbol, code, kinds, result) if digest == hashlib.sha256(code).hexdigest() else None


def _entry(symbol: str, code: bytes, kinds: tuple[str, ...], result: str) -> EntryPoint:
    engine = _engine()
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    return EntryPoint(engine.get_function_address(symbol), kinds, result)


def _trampoline(symbol: str, function: Any, kinds: tuple[str, ...]) -> str:
    """LLVM code of an entry point: it takes the arguments out of the block, numbers first, and calls numba's function."""
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
        raise NotSavedError(f"{function.name} takes {len(types)} values instead of {len(slots)}")
    lines = [f"define i32 @{symbol}(ptr %block) {{", f"%exception = getelementptr i64, ptr %block, i64 {_ARGUMENTS - 1}"]
    for index, (slot, each) in enumerate(zip(slots, types, strict=True)):
        lines += [f"%p{index} = getelementptr i64, ptr %block, i64 {slot}", f"%a{index} = load {each}, ptr %p{index}"]
    passed = ", ".join(f"{each} %a{index}" for index, each in enumerate(types))
    lines += [f'%status = call i32 @"{function.name}"({result} %block, {exception} %exception, {passed})', "ret i32 %status", "}"]
    return "\n".join(lines)


def save(path: Path, kinds: tuple[str, ...], compiled: Any, arguments: tuple[Any, ...]) -> EntryPoint:
    """Write numba's result (`CompileResult`) to disk as an object file, after a call has given the same bits as numba.

    Args:
        path: The file.
        kinds: Type key of each argument, from `kind`.
        compiled: The result of numba's compiler.
        arguments: Arguments of the call for which it was compiled; the test call gets copies of their arrays.

    Raises:
        NotSavedError: The function needs more than the C library, or returns something else than numbers.
        DifferentBitsError: The machine code gave other results than numba.
    """
    result = _letters(compiled.signature.return_type)
    symbol = "entry_" + hashlib.sha256(f"{path}{kinds}".encode()).hexdigest()[:24]
    code = _object(symbol, kinds, compiled)
    entry = _entry(symbol, code, kinds, result)
    _judge(entry, compiled.entry_point, arguments)
    head = json.dumps([symbol, result, hashlib.sha256(code).hexdigest()]).encode()
    _write(path, head + b"\n" + code)
    return entry


def _letters(returned: Any) -> str:
    """Letters of `struct` for a function's return type: nothing, a number, or several in a plain tuple."""
    each = [] if str(returned) == "none" else list(getattr(returned, "types", (returned,)))
    if each == [returned] or (len(each) != 1 and not hasattr(returned, "fields")):
        letters = [_LETTERS.get(str(one)) for one in each]
        if None not in letters:
            return "".join(letter for letter in letters if letter)
    raise NotSavedError(f"it gives back {returned}")


def _object(symbol: str, kinds: tuple[str, ...], compiled: Any) -> bytes:
    """The object file of numba's function and its entry point, with no other visible symbol and no other dependency."""
    library = compiled.library
    text = library.get_llvm_str()
    function = llvm.parse_assembly(text).get_function(compiled.fndesc.llvm_func_name)
    module = llvm.parse_assembly(text + "\n" + _trampoline(symbol, function, kinds))
    module.link_in(llvm.parse_assembly(_NEVER_FREED))
    for one in [*module.functions, *module.global_variables]:
        if not one.is_declaration and one.name != symbol:
            one.linkage = "internal"
    passes = llvm.create_new_module_pass_manager()
    passes.add_global_dead_code_eliminate_pass()
    machine = library.codegen._tm
    passes.run(module, llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options()))
    wanted = {one.name for one in [*module.functions, *module.global_variables] if one.is_declaration}
    foreign = sorted(name for name in wanted if name not in _LIBRARY and not name.startswith("llvm."))
    if foreign:
        raise NotSavedError(f"it needs {', '.join(foreign)}")
    code: bytes = machine.emit_object(module)
    return code


def _judge(entry: EntryPoint, reference: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
    """Compare one call of the machine code with one of numba, each on copies of the arguments.

    Raises:
        DifferentBitsError: A result, or an array after the call, differs in a bit.
    """
    ours, theirs = _copies(arguments), _copies(arguments)
    given, wanted = entry(*ours), reference(*theirs)
    if _bits(given) != _bits(wanted):
        raise DifferentBitsError(f"it gives {given!r} where numba gives {wanted!r}")
    for index, (one, other) in enumerate(zip(ours, theirs, strict=True)):
        if isinstance(one, _IN_MEMORY) and one.tobytes() != other.tobytes():
            raise DifferentBitsError(f"it leaves argument {index} otherwise than numba does")


def _copies(arguments: tuple[Any, ...]) -> tuple[Any, ...]:
    """The arguments with their arrays copied; an array that is given twice stays one."""
    copies = {id(each): each.copy() for each in arguments if isinstance(each, _IN_MEMORY)}
    return tuple(copies.get(id(each), each) for each in arguments)


def _bits(value: Any) -> object:
    """A value's type and bit pattern; two results are equal in both, or differ. NaN equals NaN of the same bits."""
    if isinstance(value, tuple):
        return type(value), *map(_bits, value)
    return type(value), struct.pack("=d", value) if isinstance(value, float) else value


def _write(path: Path, content: bytes) -> None:
    """Write a file whole or not at all; where it cannot be written, each process compiles anew."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent)
        with os.fdopen(handle, "wb") as file:
            file.write(content)
        os.replace(name, path)
    except OSError:
        return
