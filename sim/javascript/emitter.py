"""Statements and functions of the rules as JavaScript.

An `Emitter` starts from a function and follows all that it calls, by the globals of each function.
Rules use floats, ints, bools, tuples, arrays and attributes of a state; anything else is refused
with file and line.
"""

from __future__ import annotations

import ast
import inspect
import textwrap
import types
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, Final

from sim.javascript.expressions import Expressions, Scope
from sim.javascript.names import PRELUDE, identifier, unwrapped

_TRANSPARENT: Final = frozenset(("compilable", "kernel", "made", "rule"))
"""Decorators that leave a function as it is."""


class Emitter(Expressions):
    """Emits functions and all that they call."""

    def __init__(self, host: Mapping[Callable[..., Any], str] | None = None) -> None:
        """Begin without functions.

        Parameters
        ----------
        host : mapping
            Functions that the surrounding JavaScript defines, with their names there.
        """
        super().__init__()
        self._host = dict(host or {})
        self._reserved: dict[Callable[..., Any], str] = {}
        self._names: dict[Callable[..., Any], str] = {}
        self._texts: list[str] = []

    @property
    def functions(self) -> tuple[str, ...]:
        """Names of the emitted functions."""
        return tuple(self._names.values())

    @property
    def text(self) -> str:
        """The emitted code, with its helpers."""
        return PRELUDE + "".join(self._texts)

    def is_emitted(self, value: Any) -> bool:
        """Return whether a value is a function in Python, or one that the host defines."""
        try:
            return isinstance(value, types.FunctionType) or value in self._host
        except TypeError:  # what has no hash is no function
            return False

    def function(self, function: Callable[..., Any]) -> str:
        """Emit a function, if that is not done yet; return its name.

        Raises
        ------
        NotEmittedError
            For Python that has no form in JavaScript.
        """
        if function in self._host:
            return self._host[function]
        if function not in self._names:
            self._names[function] = self._new_name(function)
            lines, first = inspect.getsourcelines(function)
            (node,) = ast.parse(textwrap.dedent("".join(lines))).body
            ast.increment_lineno(node, first - 1)
            before, self.module = self.module, function.__module__
            if not isinstance(node, ast.FunctionDef):
                raise self.refusal(node, "no function definition")
            outside = inspect.unwrap(function).__globals__
            text = self._definition(node, None, outside, self._names[function])
            self.module = before
            self._texts.append(text)
        return self._names[function]

    def reserve(self, functions: Iterable[Callable[..., Any]]) -> None:
        """Reserve the plain names of functions that scripts call; ValueError if one is taken."""
        for function in functions:
            name = identifier(function.__name__)
            if name in {*self._reserved.values(), *self._names.values()}:
                raise ValueError(
                    f"two functions are named {name}; scripts call one of them"
                )
            self._reserved[function] = name

    def _new_name(self, function: Callable[..., Any]) -> str:
        if function in self._reserved:
            return self._reserved[function]
        name = identifier(function.__name__.lstrip("_"))
        if function.__name__.startswith("_"):
            name += "$"  # its name without the underscore may be that of a variable
        taken = {*self._names.values(), *self._host.values(), *self._reserved.values()}
        return (
            name
            if name not in taken
            else f"{name}_{function.__module__.rpartition('.')[2]}"
        )

    def _definition(
        self,
        node: ast.FunctionDef,
        outer: Scope | None,
        outside: dict[str, Any],
        name: str,
    ) -> str:
        if node.args.vararg or node.args.kwarg or node.args.kwonlyargs:
            raise self.refusal(node, "star arguments")
        for decorator in node.decorator_list:
            if ast.unparse(decorator) not in _TRANSPARENT:
                raise self.refusal(decorator, "a decorator")
        given = [argument.arg for argument in node.args.args]
        scope = Scope(given, outer, outside)
        variables = sorted(_variables(node) - set(given))
        scope.names |= {*variables, *_inner_functions(node)}
        defaults = [None] * (len(given) - len(node.args.defaults)) + node.args.defaults
        arguments = ", ".join(
            identifier(one)
            + ("" if default is None else f" = {self.expression(default, scope)}")
            for one, default in zip(given, defaults, strict=True)
        )
        body = self._block(node.body, scope)
        declared = ", ".join([*map(identifier, variables), *scope.temporaries])
        lets = f"let {declared};\n" if declared else ""
        return f"function {name}({arguments}) {{\n{lets}{body}}}\n"

    def _block(self, body: Sequence[ast.stmt], scope: Scope) -> str:
        return "".join(self._statement(node, scope) for node in body)

    def _statement(self, node: ast.stmt, scope: Scope) -> str:
        match node:
            case (
                ast.Expr(value=ast.Constant()) | ast.Pass() | ast.AnnAssign(value=None)
            ):
                return ""
            case ast.Expr(value=value):
                return self.expression(value, scope) + ";\n"
            case ast.Return(value=None):
                return "return;\n"
            case ast.Return(value=value) if value is not None:
                return f"return {unwrapped(self.expression(value, scope))};\n"
            case ast.Break():
                return "break;\n"
            case ast.Continue():
                return "continue;\n"
            case ast.If(test=test, body=body, orelse=other):
                rest = f" else {{\n{self._block(other, scope)}}}\n" if other else "\n"
                return f"if {self._test(test, scope)} {{\n{self._block(body, scope)}}}{rest}"
            case ast.While(test=test, body=body, orelse=[]):
                return f"while {self._test(test, scope)} {{\n{self._block(body, scope)}}}\n"
            case ast.For(orelse=[]):
                return self._for(node, scope)
            case ast.AnnAssign(target=target, value=value) if value is not None:
                return self._assign([target], value, scope)
            case ast.Assign(targets=targets, value=value):
                return self._assign(targets, value, scope)
            case ast.AugAssign(target=target, op=op, value=value):
                place = self.expression(target, scope)
                sum_ = self.binary(node, op, place, self.expression(value, scope))
                return f"{place} = {unwrapped(sum_)};\n"
            case ast.FunctionDef(name=name):
                return self._definition(node, scope, scope.outside, identifier(name))
        raise self.refusal(node, f"statement {type(node).__name__}")

    def _test(self, node: ast.expr, scope: Scope) -> str:
        return f"({unwrapped(self.expression(node, scope))})"

    def _for(self, node: ast.For, scope: Scope) -> str:
        body = self._block(node.body, scope)
        match node.target, node.iter:
            case ast.Name(id=name), ast.Call(
                func=ast.Name(id="range"), args=args, keywords=[]
            ):
                ends = [self.expression(one, scope) for one in args]
                start, stop = ("0", ends[0]) if len(ends) == 1 else (ends[0], ends[1])
                step = ends[2] if len(ends) == 3 else "1"
                if len(ends) == 3 and not isinstance(
                    args[2], ast.Constant | ast.UnaryOp
                ):
                    raise self.refusal(node, "a step that is no constant")
                sign = ">" if step.startswith(("-", "(-")) else "<"
                i, end = scope.temporary(), scope.temporary()
                head = f"{i} = {start}, {end} = {stop}; {i} {sign} {end}; {i} += {step}"
                return f"for ({head}) {{\n{identifier(name)} = {i};\n{body}}}\n"
        item = scope.temporary()
        values = self.expression(node.iter, scope)
        return f"for ({item} of {values}) {{\n{self._spread(node.target, item, scope)}{body}}}\n"

    def _spread(self, target: ast.expr, item: str, scope: Scope) -> str:
        """Assign a variable to a target, or its parts to those of a tuple."""
        if not isinstance(target, ast.Tuple):
            return f"{self.expression(target, scope)} = {item};\n"
        return "".join(
            self._spread(part, f"{item}[{n}]", scope)
            for n, part in enumerate(target.elts)
        )

    def _assign(
        self, targets: Sequence[ast.expr], value: ast.expr, scope: Scope
    ) -> str:
        if not any(isinstance(target, ast.Tuple) for target in targets):
            places = " = ".join(self.expression(target, scope) for target in targets)
            return f"{places} = {unwrapped(self.expression(value, scope))};\n"
        if len(targets) != 1:
            raise self.refusal(value, "several targets with a tuple")
        (target,) = targets
        if isinstance(value, ast.Tuple) and isinstance(target, ast.Tuple):
            # All values before the first target, as in ``a, b = b, a``.
            parts = [self.expression(part, scope) for part in value.elts]
            names = [scope.temporary() for _ in parts]
            stored = "".join(
                f"{name} = {unwrapped(part)};\n"
                for name, part in zip(names, parts, strict=True)
            )
            return stored + "".join(
                self._spread(part, name, scope)
                for part, name in zip(target.elts, names, strict=True)
            )
        item = scope.temporary()
        text = unwrapped(self.expression(value, scope))
        return f"{item} = {text};\n{self._spread(target, item, scope)}"


def _own_nodes(function: ast.FunctionDef) -> Iterator[ast.AST]:
    """Iterate over the nodes of a function, without those of functions inside it."""
    pending: list[ast.AST] = list(function.body)
    while pending:
        node = pending.pop()
        yield node
        if not isinstance(node, ast.FunctionDef | ast.Lambda):
            pending += ast.iter_child_nodes(node)


def _variables(function: ast.FunctionDef) -> set[str]:
    return {
        node.id
        for node in _own_nodes(function)
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)
    }


def _inner_functions(function: ast.FunctionDef) -> set[str]:
    return {
        node.name for node in _own_nodes(function) if isinstance(node, ast.FunctionDef)
    }
