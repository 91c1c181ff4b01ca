"""The page of a scenario as plain files: a worker in the browser plays the loop."""
