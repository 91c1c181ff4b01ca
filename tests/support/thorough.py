"""The marker ``thorough``: CI runs such a test, README's line a quicker one in its place.

``@pytest.mark.thorough("test_quick")`` names a test of the same rule that README's line does run;
one of another file is named by path and ``::``, as pytest does. `tests.support.thoroughly` marks
some values of a parameter; the test with the other values is then the quicker one. A name that
README's line does not run is an error, so no rule is left to CI alone.
"""

from __future__ import annotations

import pytest


def is_default(item: pytest.Item) -> bool:
    """Return whether README's line runs a test."""
    marks = {mark.name for mark in item.iter_markers()}
    return not marks & {"slow", "thorough"} and (
        "process" not in marks or "smoke" in marks
    )


def unfounded(items: list[pytest.Item]) -> list[str]:
    """Return what is wrong with each thorough test whose file and quicker test were collected."""
    default: dict[str, bool] = {}
    for item in items:
        test = item.nodeid.partition("[")[0]
        default[test] = default.get(test, False) or is_default(item)
    files = {test.partition("::")[0] for test in default}
    wrong = {}
    for item in items:
        test = item.nodeid.partition("[")[0]
        own = test.partition("::")[0]
        for mark in item.iter_markers("thorough"):
            name = str(mark.args[0]) if mark.args else ""
            quick = name if "::" in name else f"{own}::{name}"
            if quick.partition("::")[0] in files and not default.get(quick, False):
                wrong[test] = f"{test} names {name or 'no test'}"
    return list(wrong.values())


# Before any test is deselected.
@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(
    config: pytest.Config, items: list[pytest.Item]
) -> None:
    """Refuse a thorough test whose quicker one README's line does not run."""
    if any("::" in argument for argument in config.args):
        return
    if wrong := unfounded(items):
        raise pytest.UsageError(
            "thorough(quick) needs the name of a test of the same rule that README's line runs: "
            + "; ".join(wrong)
        )
