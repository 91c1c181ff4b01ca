"""Memory access and calls by address, which numba lacks.

Nothing here uses Python objects: a compiled kernel refers to no symbol but libm's, and needs no
GIL.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeAlias, TypeVar

import numba
from llvmlite import ir
from numba.core import typing
from numba.extending import intrinsic, overload
from numba.np import arrayobj

from nodes.compiled.memory import pairs_at, shared_real, shared_whole
from nodes.compiled.memory import reals_at as reals_at
from nodes.compiled.memory import wholes_at as wholes_at

# a type checker knows only a part of numba
types: Any = numba.types
arrays: Any = arrayobj
extending: Any = numba.extending
signature: Any = getattr(typing, "signature")  # noqa: B009

Intrinsic: TypeAlias = Any  # a function that exists in compiled code only
Function = TypeVar("Function", bound=Callable[..., Any])


def compilable(function: Function) -> Function:
    """Compile a function into its callers; type checkers see it unchanged."""
    # Neither the interpreter nor C calls it: without wrappers, which would be compiled for each.
    compile_: Any = numba.njit  # a type checker knows only numba's common options
    made: Function = compile_(no_cpython_wrapper=True, no_cfunc_wrapper=True)(function)
    return made


def _made(result: Any, takes: Sequence[Any], generate: Callable[..., Any]) -> Intrinsic:
    """Return an intrinsic function of one or two arguments, written by `generate`."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        made = generate(context, builder, *arguments)
        return (
            context.get_dummy_value() if signature.return_type == types.void else made
        )

    def _of_one(typing: Any, value: Any) -> Any:  # noqa: ARG001
        return result(*takes), build

    def _of_two(typing: Any, value: Any, other: Any) -> Any:  # noqa: ARG001
        return result(*takes), build

    chosen: Any = _of_one if len(takes) == 1 else _of_two
    return intrinsic(chosen)


def _load(bits: int, result: Any) -> Intrinsic:
    """Return a load of a big-endian number, at any address."""

    def generate(_: Any, builder: Any, address: Any) -> Any:
        whole = ir.IntType(bits)
        value = builder.load(builder.inttoptr(address, whole.as_pointer()))
        value.align = 1
        if bits > 8:
            value = builder.bswap(value)
        if result == types.int64:
            return value if bits == 64 else builder.zext(value, ir.IntType(64))
        if bits == 32:
            return builder.fpext(
                builder.bitcast(value, ir.FloatType()), ir.DoubleType()
            )
        return builder.bitcast(value, ir.DoubleType())

    return _made(result, [types.int64], generate)


def _store(bits: int, takes: Any) -> Intrinsic:
    """Return a store of a big-endian number, at any address."""

    def generate(_: Any, builder: Any, address: Any, value: Any) -> None:
        whole = ir.IntType(bits)
        if takes == types.float64:
            value = builder.bitcast(value, whole)
        elif bits < 64:
            value = builder.trunc(value, whole)
        if bits > 8:
            value = builder.bswap(value)
        builder.store(value, builder.inttoptr(address, whole.as_pointer())).align = 1

    return _made(types.void, [types.int64, takes], generate)


byte, be16, be32, be64 = (_load(bits, types.int64) for bits in (8, 16, 32, 64))
real32 = _load(32, types.float64)
real64 = _load(64, types.float64)
put_byte, put_be16, put_be32, put_be64 = (
    _store(bits, types.int64) for bits in (8, 16, 32, 64)
)
put_real = _store(64, types.float64)


def _shared(result: Any) -> Intrinsic:
    """Return an atomic load (acquire) of 8 bytes that another process may be writing."""

    def generate(_: Any, builder: Any, address: Any) -> Any:
        value = builder.load_atomic(
            builder.inttoptr(address, ir.IntType(64).as_pointer()), "acquire", 8
        )
        return (
            value if result == types.int64 else builder.bitcast(value, ir.DoubleType())
        )

    return _made(result, [types.int64], generate)


_whole = _shared(types.int64)
_real = _shared(types.float64)
overload(shared_whole)(lambda address: lambda address: _whole(address))  # noqa: ARG005
overload(shared_real)(lambda address: lambda address: _real(address))  # noqa: ARG005


def _copy(_: Any, builder: Any, target: Any, source: Any) -> None:
    """Copy 16 bytes, at any addresses; the excess of a shorter piece is overwritten later."""
    block = ir.VectorType(ir.IntType(8), 16)
    value = builder.load(builder.inttoptr(source, block.as_pointer()))
    value.align = 1
    builder.store(value, builder.inttoptr(target, block.as_pointer())).align = 1


copy16 = _made(types.void, [types.int64, types.int64], _copy)


def record_at(record: Any) -> Intrinsic:
    """Return an intrinsic that views memory as a type."""

    def generate(context: Any, builder: Any, address: Any) -> Any:
        return builder.inttoptr(address, context.get_value_type(record))

    return _made(record, [types.int64], generate)


def _look_at(function: Callable[..., Any], item: Any, *others: int) -> None:
    """Register an array at an address with numba, built in place of a call."""
    array = types.Array(item, 1 + len(others), "C")
    count = [types.int64, types.int64]

    def lower(context: Any, builder: Any, _: Any, arguments: Any) -> Any:
        address, length = arguments
        made = arrays.make_array(array)(context, builder)
        size = context.get_abi_sizeof(context.get_data_type(item))
        shape = [length, *(context.get_constant(types.intp, n) for n in others)]
        steps = [size]
        for n in others:
            steps.insert(0, steps[0] * n)
        arrays.populate_array(
            made,
            data=builder.inttoptr(address, made.data.type),
            shape=shape,
            strides=[context.get_constant(types.intp, step) for step in steps],
            itemsize=context.get_constant(types.intp, size),
            meminfo=None,
        )
        return made._getvalue()

    typed = extending.type_callable(function)
    typed(lambda _: lambda address, length: signature(array, *count))  # noqa: ARG005
    extending.lower_builtin(function, *count)(lower)


_look_at(reals_at, types.float64)
_look_at(wholes_at, types.int64)
_look_at(pairs_at, types.float64, 2)


def _foreign(*takes: Any) -> Intrinsic:
    """Return a call of a C function that returns an int, by address and a tuple of arguments."""
    result = types.int32

    def generate(context: Any, builder: Any, address: Any, arguments: Any) -> Any:
        kinds = [context.get_value_type(kind) for kind in takes]
        function = ir.FunctionType(context.get_value_type(result), kinds)
        given = [builder.extract_value(arguments, n) for n in range(len(takes))]
        wanted = [
            (
                builder.trunc(value, kind)
                if isinstance(kind, ir.IntType) and value.type.width > kind.width
                else value
            )
            for value, kind in zip(given, kinds, strict=True)
        ]
        return builder.call(builder.inttoptr(address, function.as_pointer()), wanted)

    widest = [types.float64 if kind == types.float64 else types.int64 for kind in takes]
    return _made(result, [types.int64, types.BaseTuple.from_types(widest)], generate)


# int zmq_recv (void *socket, void *buffer, size_t size, int flags), and zmq_send
call_pass = _foreign(types.int64, types.int64, types.int64, types.int32)
# int zmq_getsockopt (void *socket, int option, void *value, size_t *size)
call_option = _foreign(types.int64, types.int32, types.int64, types.int64)
# int clock_gettime (clockid_t clock, struct timespec *now)
call_clock = _foreign(types.int32, types.int64)
# int clock_nanosleep (clockid_t clock, int flags, const struct timespec *until, struct timespec
# *left)
call_sleep = _foreign(types.int32, types.int32, types.int64, types.int64)
# int ppoll (struct pollfd *descriptors, nfds_t count, const struct timespec *longest, const
# sigset_t *mask)
call_poll = _foreign(types.int64, types.int64, types.int64, types.int64)
# int sched_yield (void), which ignores the argument
call_yield = _foreign(types.int64)
# int read (int64_t context, int64_t seq, double *out) of a device, and int write (…, double *force,
# int64_t seq, double offset)
call_read = _foreign(types.int64, types.int64, types.int64)
call_write = _foreign(types.int64, types.int64, types.int64, types.float64)
