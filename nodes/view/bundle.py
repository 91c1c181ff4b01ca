"""Bundle the page's JavaScript modules into one file, to save a connection per module.

On one processor thirty requests cost a browser a second. The sources stay separate modules, which a
browser can also load one by one. The bundle contains the first module and all its imports, each in
its own function, in order of dependence.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

_IMPORT = re.compile(r'^import \{ (.+?) \} from "\./(\w+)\.js";$', re.MULTILINE)
_EXPORT = re.compile(
    r"^export (?=(?:class|(?:async )?function\*?|const) (\w+))", re.MULTILINE
)
_OTHER = re.compile(r"^(?:import|export)\b.*", re.MULTILINE)


def bundle(sources: Mapping[str, str], first: str) -> str:
    """Return module `first` and all its imports as one script.

    Raises
    ------
    ValueError
        If modules import each other, if an import or export has another form than these, or if a
        module imports a name that is not exported: ``export const A = 1, B = 2;`` exports A only.
    """
    parts: list[str] = []
    done: dict[str, list[str]] = {}  # exports of each module

    def add(name: str, above: tuple[str, ...]) -> None:
        if name in above:
            raise ValueError(
                f"circular imports of page modules: {' > '.join([*above, name])}"
            )
        if name in done:
            return
        source = sources[f"{name}.js"]
        for names, other in _IMPORT.findall(source):
            add(other, (*above, name))
            if missing := set(names.split(", ")) - set(done[other]):
                raise ValueError(
                    f"{name}.js imports {', '.join(sorted(missing))}, which {other}.js does not"
                    " export by the first name of a declaration; give each name its own export"
                )
        done[name] = _EXPORT.findall(source)
        body = _EXPORT.sub("", _IMPORT.sub(r"const { \1 } = $\2;", source))
        if left := _OTHER.search(body):
            raise ValueError(
                f"{name}.js: only named imports and exports can be bundled, not {left[0]}"
            )
        parts.append(
            f"const ${name} = (() => {{\n{body}\nreturn {{ {', '.join(done[name])} }};\n}})();\n"
        )

    add(first, ())
    return "".join(parts)
