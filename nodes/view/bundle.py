"""The page's modules as one file: each answer costs a connection, and thirty of them cost a browser on one processor a second.

The sources stay modules of their own, which a browser can load one by one as well. What is served
as the first of them is that one and all that it imports, each in a function of its own, in the
order in which they need each other.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

_IMPORT = re.compile(r'^import \{ (.+?) \} from "\./(\w+)\.js";$', re.MULTILINE)
_EXPORT = re.compile(r"^export (?=(?:class|function\*?|const) (\w+))", re.MULTILINE)
_OTHER = re.compile(r"^(?:import|export)\b.*", re.MULTILINE)


def bundle(sources: Mapping[str, str], first: str) -> str:
    """Put a module and all that it imports into one."""
    parts: list[str] = []
    done: set[str] = set()

    def add(name: str, above: tuple[str, ...]) -> None:
        if name in above:
            raise ValueError(
                f"modules of the page import each other in a circle: {' > '.join([*above, name])}"
            )
        if name in done:
            return
        done.add(name)
        source = sources[f"{name}.js"]
        for _, other in _IMPORT.findall(source):
            add(other, (*above, name))
        exports = ", ".join(_EXPORT.findall(source))
        body = _EXPORT.sub("", _IMPORT.sub(r"const { \1 } = $\2;", source))
        if left := _OTHER.search(body):
            raise ValueError(
                f"{name}.js: only named imports and exports are put together, not {left[0]}"
            )
        parts.append(f"const ${name} = (() => {{\n{body}\nreturn {{ {exports} }};\n}})();\n")

    add(first, ())
    return "".join(parts)
