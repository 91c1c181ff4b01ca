"""The paper's figures and claims, each judged."""
