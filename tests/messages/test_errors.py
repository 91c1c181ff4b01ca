"""One documented tree of exceptions."""

from __future__ import annotations

import importlib
import inspect
import pkgutil

import messages
import nodes
import sim
from messages import errors


def test_every_exception_is_in_the_tree_and_on_its_page() -> None:
    found: dict[str, type[BaseException]] = {}
    for package in (messages, nodes, sim):
        for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
            if module.name != "nodes.__main__":  # starts a node when imported
                for name, thing in vars(importlib.import_module(module.name)).items():
                    if (
                        inspect.isclass(thing)
                        and issubclass(thing, Exception)
                        and thing.__module__ == module.name
                    ):
                        assert found.setdefault(name, thing) is thing, (
                            f"two exceptions are called {name}"
                        )
    assert len(found) > 10  # the walk itself works
    stray = [
        name
        for name, thing in found.items()
        if not issubclass(thing, (errors.HapticError, Warning)) and name[0] != "_"
    ]
    assert stray == []
    page = errors.__doc__ or ""
    assert [name for name in found if name[0] != "_" and f"`{name}`" not in page] == []
