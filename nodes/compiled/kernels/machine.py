"""What a kernel needs of the machine and numba does not give: bytes at an address, and functions that are called there.

Nothing here knows of Python's objects: compiled, a kernel refers to no symbol but libm's, and needs no interpreter lock.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias, TypeVar

import numba
from llvmlite import ir
from numba.extending import intrinsic, overload

from nodes.compiled.memory import pairs_at, shared_real, shared_whole
from nodes.compiled.memory import reals_at as reals_at
from nodes.compiled.memory import wholes_at as wholes_at

# Of numba a type checker sees only a part.
types: Any = numba.types
carray: Any = getattr(numba, "carray")  # noqa: B009

Intrinsic: TypeAlias = Any
"""A function that exists in compiled code only."""

Function = TypeVar("Function", bound=Callable[..., Any])


def compilable(function: Function) -> Function:
    """Let a function be compiled into those that call it; to a type checker it stays what it is."""
    # Neither the interpreter nor C calls it: a way of calling it from there would be compiled for each.
    # Of numba's options a type checker knows only the common ones.
    compile_: Any = numba.njit
    made: Function = compile_(no_cpython_wrapper=True, no_cfunc_wrapper=True)(function)
    return made


def _load(bits: int, result: Any) -> Intrinsic:
    """Make a load of a big-endian number, at any address."""

    @intrinsic
    def load(typing: Any, address: Any) -> Any:  # noqa: ARG001
        """Load a number."""

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001
            whole = ir.IntType(bits)
            value = builder.load(builder.inttoptr(arguments[0], whole.as_pointer()))
            value.align = 1
            if bits > 8:
                value = builder.bswap(value)
            if result == types.int64:
                return value if bits == 64 else builder.zext(value, ir.IntType(64))
            if bits == 32:
                return builder.fpext(builder.bitcast(value, ir.FloatType()), ir.DoubleType())
            return builder.bitcast(value, ir.DoubleType())

        return result(types.int64), generate

    return load


def _store(bits: int, takes: Any) -> Intrinsic:
    """Make a store of a big-endian number, at any address."""

    @intrinsic
    def store(typing: Any, address: Any, value: Any) -> Any:  # noqa: ARG001
        """Store a number."""

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001
            address, value = arguments
            whole = ir.IntType(bits)
            if takes == types.float64:
                value = builder.bitcast(value, whole)
            elif bits < 64:
                value = builder.trunc(value, whole)
            if bits > 8:
                value = builder.bswap(value)
            builder.store(value, builder.inttoptr(address, whole.as_pointer())).align = 1
            return context.get_dummy_value()

        return types.void(types.int64, takes), generate

    return store


byte, be16, be32, be64 = (_load(bits, types.int64) for bits in (8, 16, 32, 64))
real32, real64 = _load(32, types.float64), _load(64, types.float64)
put_byte, put_be16, put_be32, put_be64 = (_store(bits, types.int64) for bits in (8, 16, 32, 64))
put_real = _store(64, types.float64)


def _shared(result: Any) -> Intrinsic:
    """Make a load of 8 bytes that another process may be writing: it happens before every later one."""

    @intrinsic
    def load(typing: Any, address: Any) -> Any:  # noqa: ARG001
        """Load a number."""

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001
            at = builder.inttoptr(arguments[0], ir.IntType(64).as_pointer())
            value = builder.load_atomic(at, "acquire", 8)
            return value if result == types.int64 else builder.bitcast(value, ir.DoubleType())

        return result(types.int64), generate

    return load


_whole, _real = _shared(types.int64), _shared(types.float64)
overload(shared_whole)(lambda address: lambda address: _whole(address))  # noqa: ARG005
overload(shared_real)(lambda address: lambda address: _real(address))  # noqa: ARG005


def _copy() -> Intrinsic:
    """Make a copy of 16 bytes, at any addresses: what is shorter is overwritten by what follows."""

    @intrinsic
    def copy(typing: Any, target: Any, source: Any) -> Any:  # noqa: ARG001
        """Copy a block."""

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001
            block = ir.VectorType(ir.IntType(8), 16)
            value = builder.load(builder.inttoptr(arguments[1], block.as_pointer()))
            value.align = 1
            builder.store(value, builder.inttoptr(arguments[0], block.as_pointer())).align = 1
            return context.get_dummy_value()

        return types.void(types.int64, types.int64), generate

    return copy


copy16 = _copy()


def _pointer(pointed: Any) -> Intrinsic:
    @intrinsic
    def cast(typing: Any, address: Any) -> Any:  # noqa: ARG001
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return builder.inttoptr(arguments[0], context.get_value_type(signature.return_type))

        return types.CPointer(pointed)(types.int64), generate

    return cast


_to_reals, _to_wholes = _pointer(types.float64), _pointer(types.int64)
overload(reals_at)(lambda address, count: lambda address, count: carray(_to_reals(address), count))  # noqa: ARG005
overload(wholes_at)(lambda address, count: lambda address, count: carray(_to_wholes(address), count))  # noqa: ARG005
overload(pairs_at)(lambda address, count: lambda address, count: carray(_to_reals(address), (count, 2)))  # noqa: ARG005


def record_at(record: Any) -> Intrinsic:
    """Make a look at a struct that somebody else holds."""

    @intrinsic
    def look(typing: Any, address: Any) -> Any:  # noqa: ARG001
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return builder.inttoptr(arguments[0], context.get_value_type(signature.return_type))

        return record(types.int64), generate

    return look


def _foreign(*takes: Any) -> Intrinsic:
    """Make a call of a C function that returns an int, by its address and a tuple of arguments."""
    result = types.int32

    @intrinsic
    def call(typing: Any, address: Any, arguments: Any) -> Any:  # noqa: ARG001
        """Call what is at an address."""

        def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:  # noqa: ARG001
            kinds = [context.get_value_type(kind) for kind in takes]
            function = ir.FunctionType(context.get_value_type(result), kinds)
            given = [builder.extract_value(values[1], n) for n in range(len(takes))]
            wanted = [
                builder.trunc(value, kind) if isinstance(kind, ir.IntType) and value.type.width > kind.width else value
                for value, kind in zip(given, kinds, strict=True)
            ]
            return builder.call(builder.inttoptr(values[0], function.as_pointer()), wanted)

        widest = [types.float64 if kind == types.float64 else types.int64 for kind in takes]
        return result(types.int64, types.BaseTuple.from_types(widest)), generate

    return call


# int zmq_recv (void *socket, void *buffer, size_t size, int flags), and zmq_send
call_pass = _foreign(types.int64, types.int64, types.int64, types.int32)
# int zmq_getsockopt (void *socket, int option, void *value, size_t *size)
call_option = _foreign(types.int64, types.int32, types.int64, types.int64)
# int clock_gettime (clockid_t clock, struct timespec *now)
call_clock = _foreign(types.int32, types.int64)
# int clock_nanosleep (clockid_t clock, int flags, const struct timespec *until, struct timespec *left)
call_sleep = _foreign(types.int32, types.int32, types.int64, types.int64)
# int ppoll (struct pollfd *descriptors, nfds_t count, const struct timespec *longest, const sigset_t *mask)
call_poll = _foreign(types.int64, types.int64, types.int64, types.int64)
# int sched_yield (void), which takes no notice of an argument
call_yield = _foreign(types.int64)
# int read (int64_t context, int64_t seq, double *out) of a device, and int write (…, double *force, int64_t seq, double offset)
call_read = _foreign(types.int64, types.int64, types.int64)
call_write = _foreign(types.int64, types.int64, types.int64, types.float64)
