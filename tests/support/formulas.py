"""Numbered formulas of THEORY.md, converted from display maths to Python."""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import cache

from tests.support import ROOT

PAGE = (ROOT / "sim" / "THEORY.md").read_text(encoding="utf-8")
DISPLAYED = re.compile(
    r"^\$\$\n(.*?)\\tag\{(\d+\.\d+)\}\n?\s*\$\$$", re.MULTILINE | re.DOTALL
)
TOKEN = re.compile(r"\\[a-zA-Z]+|[A-Za-z]|\d+(?:\.\d+)?|<|>|[-+=/(){}\[\]|^_*]")
IGNORED = {r"\left", r"\right"}
RELATIONS = {r"\le": "<=", r"\ge": ">=", r"\to": "=", "<": "<", ">": ">", "=": "="}
FUNCTIONS = {r"\cos": "cos", r"\sin": "sin", r"\tan": "tan", r"\sqrt": "sqrt"}
CLOSING = {"(": ")", "[": "]", "{": "}", "|": "|"}


@cache
def formulas() -> dict[str, list[str]]:
    """Return the statements of each formula in Python, by number; the page is read once."""
    return {
        number: [python(part) for part in re.split(r",\s*\\quad", text) if part.strip()]
        for text, number in DISPLAYED.findall(PAGE)
        if readable(text)
    }


def readable(text: str) -> bool:
    """Whether a formula is plain arithmetic: no sums, integrals, matrices or accents."""
    return not re.search(
        r"\\(?:sum|int|max|begin|approx|binom|Gamma|mathbf|ldots)|''|!|\\cos"
        r" j|\[k\]|L\(|mathsf|sgn|atan2|physical",
        text,
    )


def python(text: str) -> str:
    """Convert a formula from LaTeX to Python."""
    text = text.replace(r"\mathrm{Re}", r"\Re").replace(r"\mathrm{Im}", r"\Im")
    text = text.replace("H(1)", "H_{at1}").replace(r"f(\omega_c)", "f_{omega}")
    return _Reader(TOKEN.findall(text)).whole()


class _Reader:
    """Parser of one formula; adjacent factors are multiplied."""

    def __init__(self, tokens: list[str]) -> None:
        self.tokens = [mark for mark in tokens if mark not in IGNORED]
        self.at = 0

    def whole(self) -> str:
        return "".join(self._terms(""))

    def _next(self) -> str:
        self.at += 1
        return self.tokens[self.at - 1]

    def _peek(self) -> str:
        return self.tokens[self.at] if self.at < len(self.tokens) else ""

    def _terms(self, end: str) -> Iterator[str]:
        factor = False
        while self._peek() not in ("", end):
            mark = self._next()
            if mark in RELATIONS or mark in ("+", "-", "/"):
                yield RELATIONS.get(mark, mark)
                factor = False
                continue
            yield ("*" if factor else "") + self._factor(mark)
            factor = True
        if end:
            assert self._next() == end

    def _group(self) -> str:
        """Read an argument in braces, or of one mark."""
        mark = self._next()
        return "".join(self._terms("}")) if mark == "{" else self._factor(mark)

    def _factor(self, mark: str) -> str:
        if mark == r"\frac":
            read = f"(({self._group()})/({self._group()}))"
        elif mark in FUNCTIONS or mark in (r"\Re", r"\Im"):
            name = {r"\Re": "real", r"\Im": "imag"}.get(mark) or FUNCTIONS[mark]
            opened = self._next()
            inner = (
                "".join(self._terms(CLOSING[opened]))
                if opened in CLOSING
                else self._factor(opened)
            )
            read = f"{name}({inner})"
        elif mark in CLOSING:
            inner = "".join(self._terms(CLOSING[mark]))
            read = f"abs({inner})" if mark == "|" else f"({inner})"
        else:
            read = mark.lstrip("\\").replace("lambda", "lambda_")
        if self._peek() == "_":
            self._next()
            read += "_" + re.sub(r"\W", "", self._group())
        if self._peek() == "^":
            self._next()
            power = self._group_or_star()
            read = f"conj({read})" if power == "*" else f"{read}**({power})"
        return read

    def _group_or_star(self) -> str:
        if self.tokens[self.at : self.at + 3] == ["{", "*", "}"]:
            self.at += 3
            return "*"
        return self._group()
