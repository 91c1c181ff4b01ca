"""Work that numba does for each function and a kernel does not need, left out.

Only the process that compiles kernels calls `make_lean`, and it compiles nothing else. Each change
leaves the machine code as it is; together they save a third of the time.
"""

from __future__ import annotations

from typing import Any, Final

# versions of numba whose kernels compile alike with it and without
TRIED: Final = ((0, 68),)


def make_lean() -> None:
    """Change numba in this process: no counting of references, and nothing computed twice."""
    import numba
    from numba.core import ir, targetconfig, typed_passes, types
    from numba.core.cpu import CPUContext
    from numba.core.runtime.context import NRTContext

    # numba is not typed here: what a type checker knows of these classes is not all of them.
    counts: Any = NRTContext
    options: Any = targetconfig.TargetConfig
    record: Any = types.Record
    context: Any = CPUContext
    function: Any = types.functions.BaseFunction
    passes: Any = typed_passes
    instruction: Any = ir.Inst

    # A kernel's memory belongs to Python, which holds it: there is nothing to count.
    counts.incref = counts.decref = lambda *_: None
    # The rest only saves time, and changes internals: not in a version it was not tried with.
    if numba.version_info.short not in TRIED:
        return

    # Registries are complete after the first function; what is imported later is still refreshed.
    load = context.load_additional_registries
    loaded = set[int]()

    def load_once(self: Any) -> None:
        if id(self) not in loaded:
            loaded.add(id(self))
            load(self)

    context.load_additional_registries = load_once

    # A state has some two hundred variables, and its type is written as text thousands of times.
    write = record.__repr__
    texts: dict[int, tuple[Any, str]] = {}

    def text_of(self: Any) -> str:
        if id(self) not in texts:
            texts[id(self)] = self, write(self)
        return texts[id(self)][1]

    record.__repr__ = text_of

    # Options are compared at each call that is typed, each of forty looked up by its name.
    compare = options.__eq__

    def same(self: Any, other: Any) -> Any:
        if type(self) is type(other) and self._values == other._values:
            return True
        return compare(self, other)

    options.__eq__ = same
    options.__hash__ = lambda self: hash(type(self))

    # An operator on numbers is tried on lists, sets and texts each time, and each failure worded.
    resolve = function.get_call_type
    resolved: dict[Any, Any] = {}
    plain = types.Number, types.Boolean, types.Literal

    def resolve_once(self: Any, typing: Any, args: Any, kws: Any) -> Any:
        if kws or not all(isinstance(kind, plain) for kind in args):
            return resolve(self, typing, args, kws)
        key = id(self), tuple(args)
        if key not in resolved:
            resolved[key] = self, resolve(self, typing, args, kws)
        return resolved[key][1]

    function.get_call_type = resolve_once

    # Expressions of whole arrays are joined into one loop; a kernel has none.
    passes.NopythonRewrites.run_pass = lambda *_: False

    # Which variables an expression has is asked for eight times, of names and numbers too.
    list_vars = instruction._rec_list_vars
    without = {str, int, float, bool, type(None), ir.Loc}

    def list_vars_of(self: Any, value: Any) -> Any:
        kind = type(value)
        if kind is ir.Var:
            return [value]
        return [] if kind in without else list_vars(self, value)

    instruction._rec_list_vars = list_vars_of
