"""Speed charted against accuracy."""
