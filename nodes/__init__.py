"""The processes: node base, driver, environment, coupling and its laws, logger, launcher, command line."""
