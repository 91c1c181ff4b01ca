"""Expressions of a rule as JavaScript."""

from __future__ import annotations

import ast
import builtins
import math
import types
from collections.abc import Callable, Sequence
from typing import Any, Final

from sim.javascript.names import (
    INEXACT,
    NotEmittedError,
    identifier,
    literal,
    unwrapped,
)

_COMPARED: Final[dict[type[ast.cmpop], str]] = {
    ast.Lt: "<",
    ast.LtE: "<=",
    ast.Gt: ">",
    ast.GtE: ">=",
    ast.Eq: "===",
    ast.NotEq: "!==",
    ast.Is: "===",
    ast.IsNot: "!==",
}
_SIGNS: Final[dict[type[ast.unaryop], str]] = {
    ast.USub: "-",
    ast.UAdd: "+",
    ast.Not: "!",
}
_OPERATORS: Final[dict[type[ast.operator], str]] = {
    ast.Add: "({} + {})",
    ast.Sub: "({} - {})",
    ast.Mult: "({} * {})",
    ast.Div: "({} / {})",
    ast.FloorDiv: "div_({}, {})",
    ast.Mod: "mod_({}, {})",
    ast.BitAnd: "and_({}, {})",
    ast.RShift: "Math.floor({} / 2 ** {})",
    ast.Pow: "Math.pow({}, {})",
}
_CALLS: Final[dict[Any, str]] = {
    abs: "Math.abs({})",
    bool: "({} ? true : false)",
    float: "(+{})",
    int: "int_({})",
    len: "{}.length",
    math.ceil: "whole_(Math.ceil({}))",
    math.copysign: "copysign_({}, {})",
    math.floor: "whole_(Math.floor({}))",
    math.isfinite: "Number.isFinite({})",
    math.isinf: "(Math.abs({}) === Infinity)",
    math.isnan: "Number.isNaN({})",
    math.sqrt: "Math.sqrt({})",
}


class Scope:
    """Names of one function, inside the functions around it."""

    def __init__(
        self, arguments: Sequence[str], outer: Scope | None, outside: dict[str, Any]
    ) -> None:
        self.outer, self.outside = outer, outside
        self.names = set(arguments)  # arguments, variables and inner functions
        self.temporaries: list[str] = []

    def knows(self, name: str) -> bool:
        """Return whether a name is one of this function or one around it."""
        return name in self.names or (self.outer is not None and self.outer.knows(name))

    def temporary(self) -> str:
        """Return the name of a new variable."""
        self.temporaries.append(f"t{len(self.temporaries)}_")
        return self.temporaries[-1]


class Expressions:
    """Emits expressions; functions that they name are emitted by a subclass."""

    module = ""  # module of the function being emitted

    def __init__(self) -> None:
        # places that call what engines round differently
        self.inexact: dict[str, str] = {}

    def function(self, function: Callable[..., Any]) -> str:
        """Return the name of a function in the emitted code."""
        raise NotImplementedError

    def is_emitted(self, value: Any) -> bool:
        """Return whether a value is a function that can be called in emitted code."""
        raise NotImplementedError

    def refusal(self, node: ast.AST, why: str) -> NotEmittedError:
        """Return the error for a node, with its place and its text."""
        line = getattr(node, "lineno", "?")
        path = self.module.replace(".", "/")
        return NotEmittedError(f"{path}.py:{line}: {why}: {ast.unparse(node)[:80]}")

    def expression(self, node: ast.expr, scope: Scope) -> str:
        """Return an expression as JavaScript."""
        is_known, value = self._outside(node, scope)
        if is_known:
            return self._of_module(node, value, scope)
        match node:
            case ast.Constant(value=value):
                return self._of_module(node, value, scope)
            case ast.Name(id=name):
                return identifier(name)
            case ast.Attribute(value=base, attr=name):
                return f"{self.expression(base, scope)}.{name}"
            case ast.Subscript():
                return self._subscript(node, scope)
            case ast.Tuple(elts=parts) | ast.List(elts=parts):
                return f"[{', '.join(self.expression(part, scope) for part in parts)}]"
            case ast.UnaryOp(op=op, operand=operand) if type(op) in _SIGNS:
                return f"({_SIGNS[type(op)]}{self.expression(operand, scope)})"
            case ast.BinOp(left=left, op=op, right=right):
                return self.binary(
                    node,
                    op,
                    self.expression(left, scope),
                    self.expression(right, scope),
                )
            case ast.BoolOp(op=op, values=values):
                sign = " && " if isinstance(op, ast.And) else " || "
                return f"({sign.join(self.expression(part, scope) for part in values)})"
            case ast.IfExp(test=test, body=body, orelse=other):
                parts = [test, body, other]
                return "({} ? {} : {})".format(
                    *(self.expression(part, scope) for part in parts)
                )
            case ast.Compare():
                return self._compare(node, scope)
            case ast.Lambda(args=args, body=body):
                names = [argument.arg for argument in args.args]
                inner = Scope(names, scope, scope.outside)
                return f"(({', '.join(map(identifier, names))}) => {self.expression(body, inner)})"
            case ast.Call(keywords=[]):
                return self._call(node, scope)
        raise self.refusal(node, f"expression {type(node).__name__}")

    def binary(self, node: ast.AST, op: ast.operator, left: str, right: str) -> str:
        """Return an operator between two emitted operands."""
        if type(op) not in _OPERATORS:
            raise self.refusal(node, f"operator {type(op).__name__}")
        if isinstance(op, ast.Pow):
            self._note_inexact(node, "**")
        return _OPERATORS[type(op)].format(left, right)

    def _note_inexact(self, node: ast.AST, what: str) -> None:
        self.inexact[f"{self.module}:{getattr(node, 'lineno', '?')}"] = what

    def _of_module(self, node: ast.expr, value: Any, scope: Scope) -> str:
        if self.is_emitted(value):
            return self._function_at(node, value, scope)
        try:
            return literal(value)
        except NotEmittedError as error:
            raise self.refusal(node, str(error)) from error

    def _outside(self, node: ast.expr, scope: Scope) -> tuple[bool, Any]:
        """Return whether a name stands outside of all functions, and what it stands for."""
        if isinstance(node, ast.Name) and not scope.knows(node.id):
            for names in (scope.outside, vars(builtins)):
                if node.id in names:
                    return True, names[node.id]
        if isinstance(node, ast.Attribute):
            is_known, value = self._outside(node.value, scope)
            if is_known and isinstance(value, types.ModuleType):
                return True, getattr(value, node.attr)
        return False, None

    def _function_at(self, node: ast.expr, function: Any, scope: Scope) -> str:
        """Return the name of an emitted function where no variable hides it."""
        name = self.function(function)
        if scope.knows(name):
            raise self.refusal(
                node, f"a variable that has the name of a function called, {name},"
            )
        return name

    def _subscript(self, node: ast.Subscript, scope: Scope) -> str:
        base = self.expression(node.value, scope)
        match node.slice:
            case ast.Slice(lower=low, upper=high, step=None):
                ends = [
                    ast.Constant(0) if low is None else low,
                    *([] if high is None else [high]),
                ]
                return f"{base}.subarray({', '.join(self.expression(e, scope) for e in ends)})"
            case ast.Tuple(elts=parts):
                return base + "".join(
                    f"[{self.expression(part, scope)}]" for part in parts
                )
            case ast.UnaryOp():
                raise self.refusal(node, "an index from the end")
        return f"{base}[{unwrapped(self.expression(node.slice, scope))}]"

    def _compare(self, node: ast.Compare, scope: Scope) -> str:
        parts, left = [], node.left
        for op, right in zip(node.ops, node.comparators, strict=True):
            if isinstance(op, ast.In | ast.NotIn):
                if not isinstance(right, ast.Tuple):
                    raise self.refusal(node, "in what is no tuple")
                same = ast.Eq() if isinstance(op, ast.In) else ast.NotEq()
                sign = " || " if isinstance(op, ast.In) else " && "
                each = [self._relation(left, same, one, scope) for one in right.elts]
                parts.append(f"({sign.join(each)})")
            else:
                parts.append(self._relation(left, op, right, scope))
            if right is not node.comparators[-1] and isinstance(right, ast.Call):
                raise self.refusal(node, "a call in a chain of comparisons")
            left = right
        return f"({' && '.join(parts)})"

    def _relation(
        self, left: ast.expr, op: ast.cmpop, right: ast.expr, scope: Scope
    ) -> str:
        sign = _COMPARED[type(op)]
        return f"{self.expression(left, scope)} {sign} {self.expression(right, scope)}"

    def _call(self, node: ast.Call, scope: Scope) -> str:
        if any(isinstance(argument, ast.Starred) for argument in node.args):
            raise self.refusal(node, "star arguments")
        given = [self.expression(argument, scope) for argument in node.args]
        is_known, called = self._outside(node.func, scope)
        if not is_known:
            return f"{self.expression(node.func, scope)}({', '.join(given)})"
        if called in (min, max) and len(given) > 1:
            text = given[0]
            for other in given[1:]:
                text = f"{called.__name__}_({text}, {other})"
            return text
        if self.is_emitted(called):
            return f"{self._function_at(node, called, scope)}({', '.join(given)})"
        if isinstance(called, type) and hasattr(called, "_fields"):
            names = ", ".join(f'"{name}"' for name in called._fields[: len(given)])
            return f"named_([{names}], [{', '.join(given)}])"
        if called in _CALLS and _CALLS[called].count("{}") == len(given):
            return _CALLS[called].format(*given)
        if getattr(called, "__module__", "") == "math" and called.__name__ in INEXACT:
            self._note_inexact(node, called.__name__)
            return f"Math.{called.__name__}({', '.join(given)})"
        raise self.refusal(node, "a call of what has no form in JavaScript")
