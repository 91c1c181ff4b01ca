"""Machine code of a kernel: numba writes each function, LLVM optimises the whole once.

For a function that Python calls, numba optimises and emits its own machine code, and again within
each function that calls it. Nothing calls the parts of a kernel, so they stay text until the kernel
is complete. numba's own output, a lowered module per function, is unchanged, and LLVM gets the same
instructions: without fastmath it may not change their results.
"""

from __future__ import annotations

import gc
import importlib
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Any, Final

from nodes.compiled.lean_numba import make_lean

ENTRY: Final = "haptic_tick"  # name of a kernel in its file
_LINKERS: Final = ("cc", "gcc", "clang")


def object_file(module: str) -> bytes:
    """Return the object code of a kernel, which refers only to libm.

    Raises
    ------
    Exception
        Raised by numba for a function that it cannot compile.
    RuntimeError
        For a kernel that allocates memory.
    """
    import llvmlite.binding as llvm

    loaded: Any = importlib.import_module(module)
    # The compiler's objects live until this process ends: searching them for garbage takes 8 % of
    # the time.
    gc.disable()
    called = getattr(loaded, "ENTRIES", None)
    entries = {ENTRY: (loaded.ticks, "int64(int64)")} if called is None else called
    names, unit = _whole(entries)
    if called is not None:
        signatures = {name: signature for name, (_, signature) in entries.items()}
        unit.link_in(
            llvm.parse_assembly(
                "\n".join(_by_c(n, names[n], signatures[n]) for n in entries)
            )
        )
    for function in unit.functions:
        if not function.is_declaration and function.name not in (
            *entries,
            *names.values(),
        ):
            function.linkage = "internal"
    for name, made_name in names.items():
        if called is None:
            unit.get_function(made_name).name = name
        else:
            unit.get_function(made_name).linkage = "internal"
    target = llvm.Target.from_triple(llvm.get_process_triple()).create_target_machine(
        cpu=llvm.get_host_cpu_name(),
        features=llvm.get_host_cpu_features().flatten(),
        opt=3,
        reloc="pic",
        codemodel="default",
    )
    llvm.initialize_native_asmprinter()
    options = llvm.create_pipeline_tuning_options(speed_level=3)
    builder = llvm.create_pass_builder(target, options)
    builder.getModulePassManager().run(unit, builder)
    wanted = [
        f.name for f in unit.functions if f.is_declaration and f.name.startswith("NRT_")
    ]
    if wanted:
        raise RuntimeError(
            f"{module}: a kernel allocates no memory, and this one calls {wanted[0]}"
        )
    made: bytes = target.emit_object(unit)
    return made


def _whole(entries: dict[str, Any]) -> tuple[dict[str, str], Any]:
    """Compile functions and their callees; return LLVM names and one unoptimised module."""
    import llvmlite.binding as llvm
    import numba
    from numba.core import cgutils
    from numba.core.codegen import JITCodeLibrary
    from numba.core.registry import cpu_target

    class Parts(JITCodeLibrary):
        """numba's output for one function, as text: neither optimised nor emitted."""

        def add_ir_module(self, ir_module: Any) -> None:
            self._written = [*getattr(self, "_written", ()), ir_module]

        def add_linking_library(self, library: Any) -> None:
            self._linking_libraries.append(library)

        def finalize(self) -> None:
            self._finalized = True

    make_lean()
    context = cpu_target.target_context
    context.refresh()
    codegen = context.codegen()
    codegen._library_class = Parts
    # Python calls none of them. numba identifies a function by its executable, so each needs a
    # builtin.
    context.get_executable = lambda *_: [].append
    # a type checker knows only numba's common options
    compile_: Any = numba.njit
    names = {}
    waiting = []
    for name, (function, signature) in entries.items():
        compiled = compile_(
            [signature], no_cpython_wrapper=True, no_cfunc_wrapper=True
        )(function.py_func)
        (result,) = compiled.overloads.values()
        names[name] = result.fndesc.llvm_func_name
        waiting.append(result.library)
    unit = llvm.parse_assembly("")
    unit.triple, unit.data_layout = llvm.get_process_triple(), str(codegen.target_data)
    seen: set[Any] = set()
    while waiting:
        library = waiting.pop()
        if library in seen:
            continue
        seen.add(library)
        waiting += library._linking_libraries
        # numba's own library, which existed before, only counts references
        for written in getattr(library, "_written", ()):
            text: Any = cgutils.normalize_ir_text
            unit.link_in(llvm.parse_assembly(text(str(written))))
    return names, unit


def _by_c(name: str, made: str, signature: str) -> str:
    """Return a C wrapper of a numba function, which takes result and error first."""
    kinds = [
        "double" if kind == "float64" else "i64"
        for kind in signature[:-1].split("(")[1].split(",")
    ]
    given = ", ".join(f"{kind} %a{n}" for n, kind in enumerate(kinds))
    return f"""
        declare i32 @"{made}"(ptr, ptr, {", ".join(kinds)})
        define i32 @{name}({given}) {{
            %result = alloca i64
            %error = alloca ptr
            %failed = call i32 @"{made}"(ptr %result, ptr %error, {given})
            %told = load i64, ptr %result
            %status = trunc i64 %told to i32
            %good = icmp eq i32 %failed, 0
            %out = select i1 %good, i32 %status, i32 -1
            ret i32 %out
        }}
    """


def linked(made: bytes) -> tuple[str, bytes]:
    """Link an object file to a shared library, if there is a linker. Return kind and bytes."""
    linker = next(filter(None, map(shutil.which, _LINKERS)), None)
    if linker is not None:
        with tempfile.TemporaryDirectory(prefix="haptic-tick-") as folder:
            draft = Path(folder) / "tick.o"
            library = Path(folder) / "tick.so"
            draft.write_bytes(made)
            command = [linker, "-shared", "-o", str(library), str(draft), "-lm"]
            done = subprocess.run(command, capture_output=True, check=False)
            if done.returncode == 0:
                return "so", library.read_bytes()
    return "o", made
