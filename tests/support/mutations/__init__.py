"""Mutations: lines of the product that are changed, one at a time, in a copy, to see whether a test notices.

``python -m tests.support.mutations`` tries those that are named, `safety` and `rooms`;
``--drawn 20`` draws others from the syntax (`drawn`). See .github/CONTRIBUTING.md.
"""
