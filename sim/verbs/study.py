"""Study stability, designs and the paper's figures: one sub-verb per study.

A study is a module of sim.verbs with the same shape as a verb: its docstring's first line is its help, ``add(parser)``
declares its arguments and sets ``run``. Only the one asked for is imported.
"""

from __future__ import annotations

import argparse

from sim.verbs.dispatch import dispatch

STUDIES: dict[str, str] = {
    "analyse": "sim.verbs.study_analyse",
    "design": "sim.verbs.study_design",
    "chart": "sim.verbs.study_chart",
    "failures": "sim.verbs.study_failures",
    "fig2": "sim.verbs.study_fig2",
    "fig3": "sim.verbs.study_fig3",
    "fig4": "sim.verbs.study_fig4",
    "needs": "sim.verbs.study_needs",
    "guard": "sim.verbs.study_guard",
    "kmax": "sim.verbs.study_kmax",
    "optimise": "sim.verbs.study_optimise",
}


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the studies.

    Parameters
    ----------
    parser : argparse.ArgumentParser
        Parser of the verb ``study``.
    """
    dispatch(parser, STUDIES, "study")
