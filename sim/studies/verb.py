"""Study stability, designs and the paper's figures: one sub-verb per study.

A study is a module of sim.studies with the same shape as a verb: its docstring's first line is its help, ``add(parser)``
declares its arguments and sets ``run``. Only the one asked for is imported.
"""

from __future__ import annotations

import argparse

from nodes.cli.dispatch import dispatch

STUDIES: dict[str, str] = {
    "analyse": "sim.studies.analyse",
    "curved": "sim.studies.curved",
    "design": "sim.studies.design",
    "detail": "sim.studies.detail",
    "edge": "sim.studies.edge",
    "chart": "sim.studies.chart",
    "failures": "sim.studies.failures",
    "fig2": "sim.studies.fig2",
    "fig3": "sim.studies.fig3",
    "fig4": "sim.studies.fig4",
    "needs": "sim.studies.needs",
    "guard": "sim.studies.guard",
    "identify": "sim.studies.identify",
    "coverage": "sim.studies.coverage",
    "kmax": "sim.studies.kmax",
    "optimise": "sim.studies.optimise",
    "price": "sim.studies.price",
    "proxies": "sim.studies.proxies",
    "tuned": "sim.studies.tuned",
    "relatives": "sim.studies.relatives",
    "two_rate": "sim.studies.two_rate",
}


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the studies."""
    dispatch(parser, STUDIES, "study")
