"""Bundled modules: each once, after its imports, without changes of meaning."""

from __future__ import annotations

import pytest

from nodes.view.bundle import bundle
from nodes.view.server import _files


def test_each_module_stands_once_before_what_needs_it() -> None:
    sources = {
        "main.js": (
            'import { Scene } from "./scene.js";\nimport { fixed } from "./format.js";\nnew'
            " Scene(fixed);\n"
        ),
        "scene.js": 'import { fixed, figure } from "./format.js";\nexport class Scene {}\n',
        "format.js": "const THIN = 1;\nexport function fixed() {}\nexport const figure = THIN;\n",
        "other.js": "nobody asks for it",
    }
    made = bundle(sources, "main")
    assert [
        made.count(f"const ${name} = ") for name in ("format", "scene", "main", "other")
    ] == [1, 1, 1, 0]
    assert (
        made.index("const $format")
        < made.index("const $scene")
        < made.index("const $main")
    )
    assert "const { fixed, figure } = $format;" in made
    assert "return { fixed, figure };" in made


def test_what_would_not_mean_the_same_is_refused() -> None:
    with pytest.raises(
        ValueError, match="circular imports of page modules: main > a > main"
    ):
        bundle(
            {
                "main.js": 'import { a } from "./a.js";',
                "a.js": 'import { b } from "./main.js";',
            },
            "main",
        )
    for line in (
        "export default 3;",
        'import * as a from "./a.js";',
        'export { a } from "./a.js";',
    ):
        with pytest.raises(ValueError, match="only named imports and exports"):
            bundle({"main.js": line, "a.js": ""}, "main")


def test_a_name_that_no_export_gives_is_refused() -> None:
    """The second name of a declaration was undefined in the bundle, and in the bundle only."""
    sources = {
        "main.js": 'import { A, B } from "./a.js";',
        "a.js": "export const A = 1, B = 2;\n",
    }
    with pytest.raises(ValueError, match=r"main\.js imports B, which a\.js does not"):
        bundle(sources, "main")
    sources["a.js"] = "export const A = 1;\nexport async function B() {}\n"
    assert "return { A, B };" in bundle(sources, "main")


def test_the_page_is_served_as_one_module() -> None:
    served = _files()["main.js"][1].decode()
    for name in ("scene", "plots", "theme", "main"):
        assert served.count(f"const ${name} = ") == 1
