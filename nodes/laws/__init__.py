"""Laws: penetration to force, each compiled to taps over one history of deflections."""

from nodes.laws.base import CompiledLaw, Law, law_kinds, law_names, load_law, with_gain

__all__ = ["CompiledLaw", "Law", "law_kinds", "law_names", "load_law", "with_gain"]
