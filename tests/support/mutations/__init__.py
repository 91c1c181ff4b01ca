"""Mutations: lines of the product changed one at a time in a copy, to test the tests.

``python -m tests.support.mutations`` tries the named ones, `safety` and `rooms`; ``--drawn 20``
draws others from the syntax (`drawn`). See .github/CONTRIBUTING.md.
"""
