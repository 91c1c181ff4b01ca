"""Processes of a launch: node base, driver, environment, coupling, logger, launcher, CLI."""
